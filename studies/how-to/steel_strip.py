"""A steel strip in millimetres and newtons.

    python studies/how-to/steel_strip.py

Millimetre, second and newton are consistent units: the unit of mass is the tonne and E is in N/mm^2. The script prints
the natural frequencies, checks that the same strip in metres has the same contact force, and finds the cheapest scheme
and time step for the errors that are admitted.
"""

import numpy as np

import stiffbeam as sb

WIDTH, THICKNESS = 20.0, 1.0  # mm
YOUNG, DENSITY = 210e3, 7.85e-9  # N/mm^2, t/mm^3
T_END = 0.5  # s


def strip(mm: float) -> sb.System:
    """Shaken at 12 Hz by 1.5 mm, between rubber stops 2 mm to either side of the tip; mm: in the unit of length."""
    problem = sb.BeamProblem(
        length=400.0 * mm,
        stiffness=YOUNG * WIDTH * THICKNESS**3 / 12.0 * mm**2,  # N mm^2
        mass_per_length=DENSITY * WIDTH * THICKNESS / mm**2,  # t/mm
        stops=sb.Stops(lower=-2.0 * mm, upper=2.0 * mm, stiffness=20.0 / mm),  # mm, mm, N/mm
        base=sb.Harmonic(amplitude=1.5 * mm, frequency=2.0 * np.pi * 12.0),  # mm, rad/s
        units=("mm" if mm == 1.0 else "m", "s", "N"),
    )
    return sb.semidiscretise(problem, cells=20)


if __name__ == "__main__":
    system = strip(mm=1.0)
    hertz = sb.modes(system).omega[:3] / (2.0 * np.pi)
    print(f"frequencies {', '.join(f'{f:.2f}' for f in hertz)} Hz")
    exact, metres = (sb.reference(each, T_END) for each in (system, strip(mm=1e-3)))
    force, same = exact.contacts[0].peak_force, metres.contacts[0].peak_force
    assert abs(force / same - 1.0) < 1e-3
    print(f"{exact.impacts.count} impacts of at most {force:.2f} N to t = {min(exact.horizon, T_END):.3g} s")
    want = {"tip": 0.02, "impacts": 0.1, "peak_force": 0.1}
    print(sb.study("advise", system, t_end=0.25, want=want))
