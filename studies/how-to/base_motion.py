"""A beam on a shaking table with a measured motion.

    python studies/how-to/base_motion.py

The record is as a displacement sensor gives it: 2 kHz, a sweep from 4 to 14 Hz of 1.5 mm with noise of 2 micrometres.
The beam needs the acceleration of its base. A polygon has none, and the acceleration of a spline through the noise is
mostly noise. The script therefore smooths the record by a least-squares spline with a knot every 8 ms, prints what this
removes, and samples the result as kind="cubic".
"""

import numpy as np
from scipy.interpolate import make_lsq_spline

import stiffbeam as sb

RATE, T_END, KNOT, NOISE = 2000.0, 1.0, 8e-3, 2e-6  # 1/s, s, s, m


def record() -> tuple[np.ndarray, np.ndarray]:
    """Return times in s and displacements in m; for a file of your own see ``np.loadtxt``."""
    t = np.arange(0.0, T_END + 0.5 / RATE, 1.0 / RATE)
    begin = np.clip(t / 0.1, 0.0, 1.0)
    sweep = 1.5e-3 * begin**3 * (10.0 - 15.0 * begin + 6.0 * begin**2) * np.sin(2.0 * np.pi * (4.0 * t + 5.0 * t**2))
    return t, sweep + NOISE * np.random.default_rng(5).normal(size=len(t))


def smoothed(t: np.ndarray, values: np.ndarray) -> sb.Sampled:
    """Return the motion of the base, at rest with its velocity at t = 0, as the beam is."""
    inner = np.arange(KNOT, t[-1] - 0.5 * KNOT, KNOT)
    spline = make_lsq_spline(t, values, np.r_[[t[0]] * 4, inner, [t[-1]] * 4], 3)
    places = np.r_[t[0], inner, t[-1]]
    return sb.Sampled(places, spline(places), "cubic")


if __name__ == "__main__":
    t, values = record()
    base = smoothed(t, values)
    off = np.std(values - base.value(t))
    print(f"smoothing removes {1e6 * off:.2f} micrometres rms")
    assert abs(off / (NOISE * np.sqrt(1 - 1 / (RATE * KNOT))) - 1.0) < 0.1  # a knot every 16 samples keeps a 16th
    beam = sb.BeamProblem(
        length=0.4,
        stiffness=1.1,
        mass_per_length=0.16,
        viscosity=1e-4,
        stops=sb.Stops(lower=-4e-3, upper=4e-3, stiffness=5e3),
        base=base,
        units=("m", "s", "N"),
    )
    system = sb.semidiscretise(beam, 10)
    exact = sb.reference(system, T_END)
    contact = exact.contacts[0]
    print(f"{contact.impacts.count} impacts to t = {exact.horizon:.3g} s, the hardest {contact.peak_force:.2f} N")
    for scheme in (sb.HHT(alpha=-0.1), sb.Trapezoidal()):
        run = sb.integrate(system, scheme, 1.0 / RATE / 10, T_END)
        print(f"{run.label}: impacts match to t = {sb.compare(run, exact).matched_until:.3f} s")
