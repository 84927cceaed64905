"""The pictures of the README: the beam between its stops, and the contacts of the paper's schemes.

python studies/pictures.py        # writes studies/beam.svg and studies/contact.png, half a minute
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import stiffbeam as sb
from stiffbeam.figures.chart import look

HERE = Path(__file__).parent
MANIFEST = json.loads((HERE.parent / "reference" / "MANIFEST.json").read_text(encoding="utf-8"))["references"]
TABLES = range(10, 18)  # those of HHT on the displacement form


def beam() -> Figure:
    """Return a drawing of the beam, clamped in a base that moves, its tip between two stops."""
    figure = Figure(figsize=(5.6, 1.9), layout="constrained")
    axis = figure.subplots()
    x = np.linspace(0.0, 1.0, 200)
    for amplitude, style in ((0.13, {"color": "black", "lw": 2.5}), (-0.1, {"color": "0.75", "lw": 1.2, "ls": "--"})):
        axis.plot(x, amplitude * x**2 * (3.0 - x) / 2.0, **style)
    axis.add_patch(Rectangle((-0.1, -0.12), 0.1, 0.24, color="0.6"))
    for side in (1, -1):
        axis.plot([0.955, 1.045], [0.15 * side] * 2, color=look("hht")["color"], lw=4.0)
        zigzag = np.linspace(0.15, 0.26, 9) * side
        axis.plot(1.0 + 0.02 * np.array([0, 0, 1, -1, 1, -1, 1, 0, 0]), zigzag, color=look("hht")["color"], lw=1.3)
    axis.annotate("", (-0.16, 0.1), (-0.16, -0.1), arrowprops={"arrowstyle": "<->"})
    axis.text(-0.19, 0.0, r"$\varphi(t)$", ha="right", va="center", fontsize=12)
    axis.text(1.08, 0.2, r"stop, stiffness $\kappa$", va="center", fontsize=12)
    axis.text(0.45, 0.1, r"$u(x, t)$", ha="center", fontsize=12)
    axis.set(xlim=(-0.35, 1.55), ylim=(-0.3, 0.3))
    axis.axis("off")
    return figure


def contact() -> Figure:
    """Return two panels: the tip at its stop, and the time in contact on every table, the true ones in black."""
    case = sb.paper_case(10)
    system = case.system("displacement")
    exact, run = sb.reference(system, 0.25), sb.integrate(system, sb.HHT(-0.1), case.dt, 0.25)
    figure = Figure(figsize=(6.0, 6.2), layout="constrained")
    above, below = figure.subplots(2)
    t = np.linspace(0.196, 0.22, 4000)
    above.axhline(0.1, color="0.6", lw=0.8, ls=":")
    above.plot(1e3 * t, exact.at(t)[0], color="black", lw=2.0, label="exact")
    inside = (run.t >= t[0]) & (run.t <= t[-1])
    above.plot(1e3 * run.t[inside], run.tip[inside], ".-", color=look("hht")["color"], lw=1.2, ms=3.0, label="HHT")
    above.set(xlabel="time, $10^{-3}$", ylabel="tip $u(1, t)$", ylim=(0.0945, 0.1008))
    above.set_title("The exact tip bounces off its stop, HHT's rests on it", fontsize=13)
    above.legend(frameon=False, fontsize=11)
    shares = []
    for number in TABLES:
        case = sb.paper_case(number)
        scheme = next(scheme for scheme, form in case.runs if form == "displacement" and scheme.name == "hht")
        true = next(entry for entry in MANIFEST if f"table{number}" in entry["tables"])["contact_fraction"]
        run = sb.integrate(case.system("displacement"), scheme, case.dt, case.t_end)
        shares.append((true, run.contacts[0].fraction))
    place = np.arange(len(shares))
    for k, (color, name) in enumerate((("black", "exact"), (look("hht")["color"], "HHT"))):
        below.bar(place + 0.4 * k - 0.2, [100.0 * share[k] for share in shares], 0.38, color=color, label=name)
    below.set_xticks(place, [str(number) for number in TABLES])
    below.set(xlabel="table of the paper", ylabel="time in contact, %")
    below.set_title(f"Time in contact: up to {max(b / a for a, b in shares):.0f} times too long", fontsize=13)
    below.legend(frameon=False, fontsize=11)
    return figure


def main() -> None:
    beam().savefig(HERE / "beam.svg", metadata={"Date": None})
    contact().savefig(HERE / "contact.png", dpi=110)


if __name__ == "__main__":
    main()
