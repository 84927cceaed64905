"""At which drive frequency does a scheme put a bifurcation, as a function of its step?

    python studies/how-to/scheme_flips.py

The beam of 8 cells with viscosity 0.05 between stops of 5e6 has a periodic orbit that loses its stability near w = 33:
a multiplier passes -1 there, and an orbit of twice the period begins. ``sb.periodic_orbit`` gives the exact frequency.
For every scheme, contact and step the script finds the scheme's own periodic orbit by Newton's method on its period
map, its multipliers by central differences, and the frequency at which one of them is -1. It prints the distance to the
exact frequency. HHT and BDF2 start anew in each period. It takes three minutes.

With implicit contact the period map has kinks on the scale of the step, so that its multipliers depend on the width of
the differences. The script prints how far two widths are apart, and no frequency where they differ by more than 0.01.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar

import stiffbeam as sb

Array = NDArray[np.float64]
METHODS: tuple[tuple[sb.Scheme, str], ...] = (
    (sb.Trapezoidal(), "implicit"),
    (sb.Trapezoidal(), "conserving"),
    (sb.HHT(alpha=-0.1), "implicit"),
    (sb.ExponentialFlow(), "conserving"),
)
CELLS, RANGE = 8, (32.9, 33.0)
WIDTHS = (1e-6, 1e-7)  # of differences, over the largest displacement and velocity
KNOWN = 0.01  # distance of multipliers with two widths, above which they are none


def beam(frequency: float) -> sb.System:
    """The damped beam at a drive frequency, at rest."""
    base, stops = sb.Harmonic(amplitude=0.2, frequency=frequency), sb.Stops(-0.1, 0.1, stiffness=5e6)
    return sb.semidiscretise(sb.BeamProblem(stiffness=300.0, viscosity=0.05, stops=stops, base=base), CELLS)


@dataclass
class PeriodMap:
    """State after one period of the drive, as a scheme computes it, from the state before."""

    scheme: sb.Scheme
    contact: str
    steps: int
    scale: Array  # of the state
    state: Array  # the last periodic one
    last: Array = field(default_factory=lambda: np.zeros(0))  # the last derivative

    def __call__(self, frequency: float, z: Array) -> Array:
        """Return the state one period later."""
        n, period = CELLS, 2.0 * np.pi / frequency
        system = replace(beam(frequency), q0=z[:n].copy(), v0=z[n:].copy())
        run = sb.integrate(system, self.scheme, period / self.steps, period, contact=self.contact, every=self.steps)
        return np.concatenate([states[-1] for states in run.states])

    def slopes(self, frequency: float, z: Array, width: float) -> Array:
        """Return the derivative of the map by central differences."""
        moves = width * np.diag(self.scale)
        columns = [(self(frequency, z + h) - self(frequency, z - h)) / (2.0 * width * s)
                   for h, s in zip(moves, self.scale, strict=True)]  # fmt: skip
        return np.column_stack(columns)

    def periodic(self, frequency: float) -> tuple[Array, Array]:
        """Return the periodic state near the last one, and the derivative there. Raises ArithmeticError."""
        z = self.state
        if not len(self.last):
            self.last = self.slopes(frequency, z, WIDTHS[0])
        for k in range(30):
            off = self(frequency, z) - z
            if np.max(np.abs(off / self.scale)) < 1e-10:
                self.state, self.last = z, self.slopes(frequency, z, WIDTHS[0])
                return z, self.last
            if k % 6 == 5:  # Newton's method with the derivative nearby converges in a few steps
                self.last = self.slopes(frequency, z, WIDTHS[0])
            z = z - np.linalg.solve(self.last - np.eye(len(z)), off)
        raise ArithmeticError("no periodic orbit found")

    def above_flip(self, frequency: float) -> float:
        """Return the least real multiplier plus 1."""
        return float(np.min(np.linalg.eigvals(self.periodic(frequency)[1]).real)) + 1.0


def orbit_near(frequency: float, guess: sb.Orbit) -> sb.Orbit:
    """The exact orbit at a frequency."""
    return sb.periodic_orbit(beam(frequency), 2.0 * np.pi / frequency, guess)


def above(orbit: sb.Orbit) -> float:
    """The least real multiplier plus 1."""
    return float(np.min(orbit.multipliers.real)) + 1.0


def exact_flip() -> tuple[float, Array]:
    """Frequency of the flip and the state of the periodic orbit there."""
    start, orbit = RANGE[0], sb.periodic_orbit(beam(RANGE[0]), 2.0 * np.pi / RANGE[0])
    for end in np.linspace(*RANGE, 3)[1:]:  # from where the orbit is stable, in steps that stay on its branch
        following = orbit_near(end, orbit)
        if above(orbit) * above(following) < 0.0:
            break
        start, orbit = end, following
    flip = float(root_scalar(lambda w: above(orbit_near(w, orbit)), bracket=(start, end), xtol=1e-12).root)
    orbit = orbit_near(flip, orbit)
    return flip, np.concatenate([orbit.q, orbit.v])


def line(scheme: sb.Scheme, contact: str, steps: int, flip: float, state: Array) -> str:
    """What a scheme makes of the flip with so many steps a period."""
    n = CELLS
    scale = np.repeat([np.max(np.abs(state[:n])), np.max(np.abs(state[n:]))], n)
    found = PeriodMap(scheme, contact, steps, scale, state)
    try:
        z, wide = found.periodic(flip)
        narrow = found.slopes(flip, z, WIDTHS[1])
        apart = abs(np.min(np.linalg.eigvals(wide).real) - np.min(np.linalg.eigvals(narrow).real))
        if apart > KNOWN:
            return f"multipliers with two widths are {apart:.2g} apart"
        root = root_scalar(found.above_flip, x0=flip, x1=flip - 0.01, xtol=1e-6)
    except ArithmeticError as error:
        return str(error)
    return f"{root.root - flip:+.5f}" if root.converged else "no flip found"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--steps", type=int, nargs="+", default=[8000, 16000, 32000], help="a period")
    steps = parser.parse_args().steps
    flip, state = exact_flip()
    print(f"exact flip at w = {flip:.12f}; the flip of a scheme minus that, by steps a period")
    for scheme, contact in METHODS:
        for count in steps:
            print(f"{scheme!s:20} {contact:11} {count:6d}  {line(scheme, contact, count, flip, state)}", flush=True)


if __name__ == "__main__":
    main()
