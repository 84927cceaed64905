"""A steel strip in millimetres and newtons.

    python studies/how-to/steel_strip.py --out FOLDER

Millimetre, second and newton are consistent units: the unit of mass is the tonne and E is in N/mm^2. The script checks
that the same strip in metres gives the same forces.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import stiffbeam as sb
from stiffbeam.studies.advise import advised

LENGTH, WIDTH, THICKNESS = 400.0, 20.0, 1.0  # mm
YOUNG, DENSITY = 210e3, 7.85e-9  # N/mm^2, t/mm^3
BENDING = YOUNG * WIDTH * THICKNESS**3 / 12.0  # N mm^2
LINE_MASS = DENSITY * WIDTH * THICKNESS  # t/mm
T_END = 0.5  # s


def strip() -> sb.BeamProblem:
    """Shaken at 12 Hz by 1.5 mm, between rubber stops 2 mm to either side of the tip."""
    return sb.BeamProblem(
        length=LENGTH,
        stiffness=BENDING,
        mass_per_length=LINE_MASS,
        stops=sb.Stops(lower=-2.0, upper=2.0, stiffness=20.0),  # mm, mm, N/mm
        base=sb.Harmonic(amplitude=1.5, frequency=2.0 * np.pi * 12.0),  # mm, rad/s
        units=("mm", "s", "N"),
    )


def in_metres() -> sb.BeamProblem:
    return sb.BeamProblem(
        length=LENGTH / 1e3,
        stiffness=BENDING / 1e6,
        mass_per_length=LINE_MASS * 1e6,
        stops=sb.Stops(lower=-2e-3, upper=2e-3, stiffness=20e3),
        base=sb.Harmonic(amplitude=1.5e-3, frequency=2.0 * np.pi * 12.0),
        units=("m", "s", "N"),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("stiffbeam-output/steel-strip"))
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    system = sb.semidiscretise(strip(), 20)
    hertz = sb.modes(system).omega[:3] / (2.0 * np.pi)
    print(f"frequencies {', '.join(f'{f:.2f}' for f in hertz)} Hz")
    exact = sb.reference(system, T_END)
    metres = sb.reference(sb.semidiscretise(in_metres(), 20), T_END)
    force, same = exact.contacts[0].peak_force, metres.contacts[0].peak_force
    print(f"largest contact force {force:.4f} N in millimetres, {same:.4f} N in metres")
    print(f"{exact.impacts.count} impacts, known to t = {exact.horizon:.3g} s")
    span = min(exact.horizon, T_END)
    want = {"tip": 0.02, "impacts": 0.1, "peak_force": 0.1}
    records = sb.study("advise", system, t_end=round(0.5 * span, 3), want=want)
    print(records)
    run = advised(records)
    comparison = sb.compare(run, sb.reference(system, float(run.t[-1])))
    print(comparison)
    comparison.figure().savefig(out / "steel_strip.png", dpi=100)


if __name__ == "__main__":
    main()
