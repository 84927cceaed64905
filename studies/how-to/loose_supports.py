"""A tube in two loose supports under a measured force: how far is each answer known?

    python studies/how-to/loose_supports.py --out FOLDER [--record force.csv]

A steel tube of 19 x 1.5 mm and 1.2 m length is clamped at one end. Two supports leave it 0.3 mm of play to either side,
one at half its length and one at its end. A record of 0.25 s drives it, here one made of two tones and noise. The
script writes a case file with ranges and the record. It prints where the uncertainty of every quantity comes from,
on a coarse mesh and on a fine one. For each support it prints the rates of impacts and of work, and writes a table of
all impacts. The sliding at a support comes from the rotation of the tube's section, at its outer
radius; there is no friction. It takes half a minute. The same budget on the command line:

    stiffbeam doubt FOLDER/tube.toml
"""

from __future__ import annotations

import argparse
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from noise import noise

import stiffbeam as sb
from stiffbeam.figures.chart import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CASE = """[[case]]
name = "tube"
cells = 8
dt = 2e-5
t_end = 0.25
runs = ["HHT(alpha=-0.1)"]
[case.problem]
units = { length = "m", time = "s", force = "N" }
length = 1.2                # m
stiffness = 668.0           # N m2, 210 GPa times pi (0.019^4 - 0.016^4)/64 m4
mass_per_length = 0.647     # kg/m
viscosity = 0.15            # N m2 s, 1 % of critical damping in the first mode
stops = [
    { position = 0.6, lower = -3e-4, upper = 3e-4, stiffness = 1e6 },
    { position = 1.2, lower = -3e-4, upper = 3e-4, stiffness = 1e6 },
]
loads = [{ position = 0.9, sampled = "force.csv", kind = "cubic" }]
[case.uncertain]
stiffness = [661, 675]      # 1 % to either side
"stops[0].upper" = [285e-6, 315e-6]
"stops[1].upper" = [285e-6, 315e-6]
"loads[0].time.scale" = [0.98, 1.02]
"""
SOURCES = {"scheme": "#0072b2", "mesh": "#d55e00", "data": "#009e73"}


def made(file: Path) -> Path:
    """A reproducible record of 2 kHz: two tones and noise of 5 to 200 rad/s, in N."""
    t = np.arange(0.0, 0.25 + 1e-9, 5e-4)
    rough = noise(0.25, rms=3.0, band=(5.0, 200.0), rng=19)
    force = 12.0 * np.sin(2 * np.pi * 22.0 * t) + 6.0 * np.sin(2 * np.pi * 61.0 * t + 1.0) + rough.value(t)
    lines = [f"{a:.4f},{b:.4f}" for a, b in zip(t, force, strict=True)]
    file.write_text("time (s),force (N)\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return file


def picture(doubts: dict[int, pd.DataFrame], exact: sb.Reference) -> Figure:
    """Record and forces at the supports; how often an impact exceeds a force; uncertainties by source and mesh."""
    assert exact.system is not None
    last = list(doubts)[-1]
    shares = doubts[last].loc["impacts at contact 1"]
    title = f"{last} cells: impacts at the end support are uncertain by {shares.max():.0%}"
    figure = new_figure(7.6, f"{title}, most of it from the {shares.idxmax()}", 9.6)
    record, force, often, bars = figure.subplots(2, 2).ravel()
    (_, load), *_ = exact.system.loads
    assert isinstance(load, sb.Sampled)
    record.plot(load.t, load.values, color="black", lw=0.8)
    record.set(xlabel="time, s", ylabel="measured force, N")
    for number, (contact, colour) in enumerate(zip(exact.contacts, ("#0072b2", "#d55e00"), strict=True), 1):
        force.plot(exact.t, contact.force, lw=0.8, color=colour, label=f"support {number}")
        peaks = np.sort(contact.impacts.peaks[np.isfinite(contact.impacts.peaks)])[::-1]
        often.step(peaks, np.arange(1, len(peaks) + 1) / exact.t[-1], where="post", color=colour)
    force.set(xlabel="time, s", ylabel="contact force, N")
    force.legend(frameon=False, fontsize=8.5)
    often.set(xlabel="largest force of an impact, N", ylabel="impacts a second above it", yscale="log")
    names = list(doubts[last].index)
    for i, (cells, doubt) in enumerate(doubts.items()):
        for part, colour in SOURCES.items():
            look = {"color": colour, "mfc": "white" if i == 0 else colour, "label": f"{part}, {cells} cells"}
            bars.plot(100.0 * doubt[part], np.arange(len(names)), "os"[i], **look)
    bars.set_xscale("symlog", linthresh=0.1)
    bars.set_yticks(range(len(names)), [name.replace("at contact", "at support") for name in names], fontsize=8)
    bars.invert_yaxis()
    bars.set_xlabel("uncertainty, %")
    bars.legend(frameon=False, fontsize=7.5, ncols=2, loc="upper center", bbox_to_anchor=(0.3, 1.22))
    return figure


def sliding(cells: int, position: float) -> np.ndarray:
    """Row of the axial displacement of the outer fibre at a support: outer radius times slope, by differences."""
    row, node, h = np.zeros(cells), round(position / 1.2 * cells), 1.2 / cells  # entry k - 1 is u at node k
    after = min(node + 1, cells)
    row[after - 1], row[node - 2] = np.array([1.0, -1.0]) * 0.0095 / ((after - node + 1) * h)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("stiffbeam-output/loose_supports"))
    parser.add_argument("--record", type=Path, help="time in s and force in N, in two columns, to 0.25 s at least")
    parser.add_argument("--cells", type=int, nargs=2, default=(8, 24), help="a coarse mesh and a fine one")
    parser.add_argument("--members", type=int, default=12, help="tubes that are drawn from the tolerances")
    given = parser.parse_args()
    out: Path = given.out
    out.mkdir(parents=True, exist_ok=True)
    record = out / "force.csv"
    shutil.copy(given.record, record) if given.record else made(record)
    (out / "tube.toml").write_text(CASE, encoding="utf-8")

    case = sb.load_cases(out / "tube.toml")["tube"]
    doubts = {}
    for cells in given.cells:
        case = replace(case, cells=cells)
        records = sb.study("doubt", case, members=given.members)
        doubts[cells] = records.table.pivot(index="quantity", columns="source", values="value")
        print(f"{cells} cells\n{records}\n")
    exact = sb.reference(case.system(), case.t_end)
    print(f"The exact motion of the nominal tube is known to {exact.horizon:g} s.")
    rates = sb.contact_rates(exact, tangents=[sliding(case.cells, x) for x in (0.6, 1.2)])
    for i, (contact, each) in enumerate(zip(exact.contacts, rates.rates, strict=True)):
        contact.impacts.to_dataframe().to_csv(out / f"impacts-{i + 1}.csv")
        impacts, impulse, normal, along = (each[x] for x in ("impact", "impulse", "normal_work", "sliding_work"))
        print(
            f"support {i + 1}: {impacts.value:g} impacts a second ({impacts.low:.0f} to {impacts.high:.0f}), the "
            f"hardest {contact.peak_force:.1f} N, in contact {contact.fraction:.1%} of the time, impulse "
            f"{impulse.value:.3g} N s a second, normal work {1e3 * normal.value:.3g} mW, sliding work "
            f"{1e3 * along.value:.3g} mW"
        )
    picture(doubts, exact).savefig(out / "loose_supports.png", dpi=100)


if __name__ == "__main__":
    main()
