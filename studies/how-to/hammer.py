"""A strip hit by a hammer whose force was recorded.

    python studies/how-to/hammer.py

The record is as a data logger writes it: 25.6 kHz, a hit of 60 N for 4 ms, a second one as the hammer bounces, noise of
0.1 N and an offset of 0.05 N. The script does what every record needs: it removes the offset and the noise between the
hits, so that the strip is at rest at the start. DOP853, which starts anew at every sample, solves it again.
"""

import numpy as np

import stiffbeam as sb

RATE, T_END = 25_600.0, 0.08  # 1/s, s


def record() -> tuple[np.ndarray, np.ndarray]:
    """Return times in s and forces in N; for a file of your own: ``np.loadtxt(file, delimiter=",", unpack=True)``."""
    t = np.arange(0.0, T_END + 0.5 / RATE, 1.0 / RATE)
    force = 0.05 + 0.1 * np.random.default_rng(3).normal(size=len(t))
    for begin, length, peak in ((0.01, 0.004, 60.0), (0.035, 0.003, 12.0)):
        inside = (t >= begin) & (t <= begin + length)
        force[inside] += peak * np.sin(np.pi * (t[inside] - begin) / length) ** 2
    return t, force


def hit(t: np.ndarray, force: np.ndarray) -> sb.Sampled:
    """Take the offset before the hit off, and what is below five times the noise."""
    quiet = force[t < 0.009]
    cleaned = force - np.mean(quiet)
    cleaned[np.abs(cleaned) < 5.0 * np.std(quiet)] = 0.0
    return sb.Sampled(t, cleaned)


if __name__ == "__main__":
    force = hit(*record())
    impulse = np.trapezoid(force.values, force.t)
    print(f"impulse of the record {impulse:.5f} N s")
    assert abs(impulse / (0.5 * (60.0 * 0.004 + 12.0 * 0.003)) - 1.0) < 5e-3  # of two squared half sines
    strip = sb.BeamProblem(
        length=0.4,
        stiffness=4.2,
        mass_per_length=0.16,
        viscosity=1e-4,
        stops=sb.Stops(upper=1.5e-3, stiffness=2e5),
        loads=sb.PointLoad(position=0.25, time=force),
        units=("m", "s", "N"),
    )
    system = sb.semidiscretise(strip, 8, form="hermite")
    exact = sb.reference(system, T_END)
    print(f"{exact.impacts.count} impacts, the hardest {exact.contacts[0].peak_force:.2f} N")
    other = sb.reference(system, T_END, "dop853", t_eval=exact.t)
    assert np.max(np.abs(other.tip - exact.tip)) < 1e-6 * np.max(np.abs(exact.tip))
    for scheme in (sb.HHT(alpha=-0.1), sb.Bathe(), sb.BDF2()):
        run = sb.integrate(system, scheme, 1.0 / RATE, T_END)
        print(f"{run.label} at the logger's rate: {sb.compare(run, exact).tip_error_rms:.2%} rms")
