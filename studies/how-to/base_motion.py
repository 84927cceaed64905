"""A beam on a shaking table with a measured motion.

    python studies/how-to/base_motion.py --out FOLDER [--record table.csv]

Without a record the script makes one: 2 kHz, a sweep from 4 to 14 Hz of 1.5 mm with noise of 2 micrometres, as a
displacement sensor gives it. The beam needs the acceleration of its base. A polygon has none, and the acceleration of a
spline through the noise is mostly noise. The script therefore smooths the record by a least-squares spline with a knot
every 8 ms, prints what this removes, and samples the result as kind="cubic".
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.interpolate import make_lsq_spline

import stiffbeam as sb
from stiffbeam.figures.chart import new_figure, short
from stiffbeam.figures.runs import line_of
from stiffbeam.files.columns import read_samples

RATE, T_END, KNOT = 2000.0, 1.0, 8e-3  # 1/s, s, s


def made(file: Path) -> Path:
    """A record as a logger writes it, reproducible."""
    t = np.arange(0.0, T_END + 0.5 / RATE, 1.0 / RATE)
    begin = np.clip(t / 0.1, 0.0, 1.0)
    sweep = 1.5e-3 * begin**3 * (10.0 - 15.0 * begin + 6.0 * begin**2) * np.sin(2.0 * np.pi * (4.0 * t + 5.0 * t**2))
    noise = 2e-6 * np.random.default_rng(5).normal(size=len(t))
    lines = [f"{time:.6f},{x:.9f}" for time, x in zip(t, sweep + noise, strict=True)]
    file.write_text("t,displacement\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return file


def smoothed(file: Path) -> tuple[np.ndarray, np.ndarray, sb.Sampled]:
    """(times, values) as recorded, and the motion: at rest with its velocity at t = 0, as the beam is."""
    t, values = read_samples(file)
    inner = np.arange(KNOT, t[-1] - 0.5 * KNOT, KNOT)
    spline = make_lsq_spline(t, values, np.r_[[t[0]] * 4, inner, [t[-1]] * 4], 3)
    places = np.r_[t[0], inner, t[-1]]
    return t, values, sb.Sampled(places, spline(places), "cubic")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("stiffbeam-output/base-motion"))
    parser.add_argument("--record", type=Path, help="time in s and displacement in m, in two columns")
    given = parser.parse_args()
    out: Path = given.out
    out.mkdir(parents=True, exist_ok=True)
    t, values, base = smoothed(given.record or made(out / "table.csv"))
    off = values - base.value(t)
    print(f"smoothing takes away {1e6 * np.std(off):.2f} micrometres rms")
    beam = sb.BeamProblem.from_physical(
        length=0.4,
        bending_stiffness=1.1,
        mass_per_length=0.16,
        bending_viscosity=1e-4,
        stops=sb.Stops(lower=-4e-3, upper=4e-3, stiffness=5e3),
        base=base,
    )
    system = sb.semidiscretise(beam, 10)
    print(f"first natural frequency {sb.modes(system).omega[0] / (2 * np.pi):.2f} Hz")
    exact = sb.reference(system, T_END)
    contact = exact.contacts[0]
    first = contact.impacts.times[0]
    print(f"{contact.impacts.count} impacts from t = {first:.3f} s on, the hardest {contact.peak_force:.2f} N")
    print(f"known to t = {exact.horizon:.3g} s")
    runs = [sb.integrate(system, scheme, 1.0 / RATE / 10, T_END) for scheme in (sb.HHT(alpha=-0.1), sb.Trapezoidal())]
    for run in runs:
        print(f"{run.label}: within 1 % to t = {sb.stays_within(run, exact, 0.01):.3f} s")

    figure = new_figure(7.0, "A beam between stops on a table whose motion was measured", 9.0)
    table, tip, force = figure.subplots(3, 1, sharex=True)
    table.plot(t, 1e3 * values, color="black", lw=0.8)
    tip.plot(exact.t, 1e3 * exact.tip, color="0.6", lw=3.0, label="exact")
    for run in runs:
        tip.plot(run.t, 1e3 * run.tip, lw=0.9, label=short(run.provenance["method"]), **line_of(run))
    for stop in (-4.0, 4.0):
        tip.axhline(stop, color="0.45", ls=":")
    if exact.horizon < T_END:
        tip.axvline(exact.horizon, color="0.4", ls="--", lw=0.9, label="horizon")
    force.plot(exact.t, exact.contact_force, color="black", lw=0.8)
    table.set_ylabel("table, mm")
    tip.set_ylabel("tip, mm")
    force.set(xlabel="time, s", ylabel="contact force, N")
    tip.legend(frameon=False, ncols=4, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    figure.savefig(out / "base_motion.png", dpi=100)


if __name__ == "__main__":
    main()
