"""A strip hit by a hammer whose force was recorded.

    python studies/how-to/hammer.py --out FOLDER [--record hammer.csv]

Without a record the script makes one as a data logger writes it: 25.6 kHz, a hit of 60 N for 4 ms, a second one as the
hammer bounces, noise of 0.1 N and an offset of 0.05 N. It then does what every record needs: it removes the offset and
ends the record with zeros.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import stiffbeam as sb
from stiffbeam.figures.chart import new_figure, short
from stiffbeam.figures.runs import line_of
from stiffbeam.files.columns import read_samples

RATE, T_END = 25_600.0, 0.15  # 1/s, s


def made(file: Path) -> Path:
    """A record as a logger writes it, reproducible."""
    t = np.arange(0.0, T_END + 0.5 / RATE, 1.0 / RATE)
    force = 0.05 + 0.1 * np.random.default_rng(3).normal(size=len(t))
    for begin, length, peak in ((0.01, 0.004, 60.0), (0.035, 0.003, 12.0)):
        inside = (t >= begin) & (t <= begin + length)
        force[inside] += peak * np.sin(np.pi * (t[inside] - begin) / length) ** 2
    lines = [f"{time:.8f};{x:.4f}" for time, x in zip(t, force, strict=True)]
    file.write_text("time (s);force (N)\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return file


def hit(file: Path) -> sb.Sampled:
    """The force in N: the offset before the hit taken off, and nothing where it is below five times the noise."""
    times, values = read_samples(file)
    quiet = values[times < 0.009]
    force = values - np.mean(quiet)
    force[np.abs(force) < 5.0 * np.std(quiet)] = 0.0
    return sb.Sampled(times, force)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("stiffbeam-output/hammer"))
    parser.add_argument("--record", type=Path, help="time in s and force in N, in two columns")
    given = parser.parse_args()
    out: Path = given.out
    out.mkdir(parents=True, exist_ok=True)
    force = hit(given.record or made(out / "hammer.csv"))
    strip = sb.BeamProblem.from_physical(
        length=0.4,
        bending_stiffness=4.2,
        mass_per_length=0.16,
        bending_viscosity=1e-4,
        stops=sb.Stops(upper=1.5e-3, stiffness=2e5),
        loads=sb.PointLoad(position=0.25, time=force),
    )
    system = sb.semidiscretise(strip, 8, form="hermite")
    exact = sb.reference(system, T_END)
    print(f"impulse of the record {np.trapezoid(force.values, force.t):.5f} N s")
    print(
        f"{exact.impacts.count} impacts, the hardest {exact.contacts[0].peak_force:.2f} N, known to {exact.horizon:g} s"
    )
    other = sb.reference(system, T_END, "dop853", t_eval=exact.t)
    off = np.max(np.abs(other.tip - exact.tip)) / np.max(np.abs(exact.tip))
    print(f"DOP853, which starts anew at every sample, differs by {off:.1e} of the largest displacement")
    runs = [sb.integrate(system, scheme, 1.0 / RATE, T_END) for scheme in (sb.HHT(alpha=-0.1), sb.Bathe(), sb.BDF2())]
    for run in runs:
        print(f"{run.label} at the logger's rate: {sb.compare(run, exact).tip_error_rms:.2%} rms")

    figure = new_figure(7.0, "A strip hit by a hammer, against a stop", 9.0)
    record, tip, contact = figure.subplots(3, 1, sharex=True)
    record.plot(1e3 * force.t, force.values, color="black", lw=1.0)
    tip.plot(1e3 * exact.t, 1e3 * exact.tip, color="0.6", lw=3.0, label="exact")
    for run in runs:
        tip.plot(1e3 * run.t, 1e3 * run.tip, lw=1.0, label=short(run.provenance["method"]), **line_of(run))
    tip.axhline(1.5, color="0.45", ls=":")
    contact.plot(1e3 * exact.t, exact.contact_force, color="black", lw=1.0)
    record.set_ylabel("hammer, N")
    tip.set_ylabel("tip, mm")
    contact.set(xlabel="time, ms", ylabel="contact force, N")
    tip.legend(frameon=False, ncols=4, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    figure.savefig(out / "hammer.png", dpi=100)


if __name__ == "__main__":
    main()
