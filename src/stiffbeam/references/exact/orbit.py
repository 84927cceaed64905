"""Periodic orbits of exact motions, stable or not, by shooting, with their Floquet multipliers.

    P(z) = z,   z <- z - (D - I)^-1 (P(z) - z),   D the derivative of the exact flow over a period

Source: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems (2004), ch. 7.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...basics.resources import working
from ...basics.text import several
from ...basics.validation import InputError, numbers, positive
from ...model.system import System, require_system
from ...trajectory.trajectory import Reference, SolverFailure
from .derivative import chatter_ends, ends_of
from .motion import Motion, Solver
from .solution import refuse, solve_exact, within_float64
from .tangent import GRAZE, Tangent, Variation

LEAST = 0.01  # of the position that one turn in the period gives at the velocity of the motion: its least size
NEWTON = 40  # iterations of shooting
HOPELESS, ASTRAY = 15, 0.1  # iterations after which a larger relative defect is given up
APART = 1e13  # growth of a distance in a period, of which shooting can make nothing
HALVINGS = 8  # of a step that makes the defect larger
CLOSED = 1e-9  # largest relative defect of an orbit
ROUNDING = 1e-13  # relative: below it shooting is not improved
REPEATS = 1e-9  # of a turn, by which a load may miss the period
NEAR_GRAZE = 1e3  # times the closure: a graze of a rigid or damped stop that is closer is one
ALONE = 1e-9  # distance of a multiplier from 1 below which an orbit has neighbours of its period, or is none
NOT_ALONE = "a multiplier is 1 but for rounding: a fold, a free (rigid-body) motion, or a drive in resonance"
FREE = "hold what is free, damp or change the system"
SETTLE = 60  # periods that are run for a guess where none is stated


@dataclass(frozen=True, eq=False)
class Orbit:
    """A periodic motion of the exact flow: q(t + period) = q(t).

    Parameters
    ----------
    system : System
    period : float
    q, v : array (n,)
        State at t = 0.
    closure : float
        Largest relative difference of the state after a period of the exact flow.
    multipliers : array (2n,)
        Floquet multipliers, the largest first; those below 1e-14 of the largest are rounding.
    monodromy : array (2n, 2n)
        Derivative of (q, q') after a period with respect to (q, q') at its start.
    events : array (k,)
        Times in [0, period) at which a contact opens, closes or is hit.
    sizes : array (2n,)
        The largest |q| and |q'| at the events, for each entry of a state.
    """

    system: System
    period: float
    q: Array
    v: Array
    closure: float
    multipliers: NDArray[np.complex128]
    monodromy: Array
    events: Array
    sizes: Array

    def __repr__(self) -> str:
        first, events = self.multipliers[0], several(len(self.events), "event")
        kind = "marginal" if abs(abs(first) - 1.0) <= ALONE else "stable" if self.stable else "unstable"
        return (f"<Orbit, {kind}: period {self.period:.6g}, {events}, largest multiplier {first:.6g}, "
                f"closed to {self.closure:.1e}>")  # fmt: skip

    @property
    def stable(self) -> bool:
        """Return True where all multipliers lie inside the unit circle, by more than rounding."""
        return bool(np.abs(self.multipliers[0]) < 1.0 - ALONE)

    def reference(self, periods: float = 1.0, t_eval: Any = None) -> Reference:
        """The exact motion from the orbit's start. An unstable orbit is left after ln(1e16)/ln|multiplier| periods."""
        t_end = positive("periods", periods) * self.period
        system = replace(self.system, q0=self.q, v0=self.v, origin=None)
        return solve_exact(system, t_end, None if t_eval is None else np.atleast_1d(numbers("t_eval", t_eval)))


class PeriodMap:
    """The exact flow of a system over a period, with its derivative."""

    def __init__(self, system: System, period: float) -> None:
        self.system, self.period = system, period
        self.variation = Variation(system)

    def solve(self, z: Array) -> Motion:
        """The exact motion over a period from the state z (2n,)."""
        n = self.system.size
        moved = replace(self.system, q0=z[:n].copy(), v0=z[n:].copy(), origin=None)
        try:
            solution = Solver(moved, self.variation.free).solve(self.period)
        except InputError as error:  # a state of Newton's method beyond a stop, or on it but for rounding
            reason = f"a state on the way has no motion: {error}"
            raise SolverFailure("periodic_orbit", 0.0, reason, "shift the phase, or give a closer guess") from error
        if ends := chatter_ends(solution):
            reason = "a chatter ends on the way, where the flow has no derivative"
            raise SolverFailure("periodic_orbit", ends[0], reason, "take restitution 0, or another guess")
        return solution

    def ahead(self, z: Array, periods: int) -> Array:
        """The state so many periods after z (2n,)."""
        for _ in range(periods):
            q, v = self.solve(z).states(np.array([self.period]))
            z = np.concatenate([q[0], v[0]])
        return z

    def flow(self, z: Array, graze: float = GRAZE) -> tuple[Array, Array, Tangent]:
        """State after a period, its derivative (2n, 2n), and the tangent along the way."""
        tangent = Tangent(self.variation, self.solve(z), self.period, np.eye(len(z)), graze)
        if 0 in tangent.hits:
            reason = "the period starts with an impact"
            raise SolverFailure("periodic_orbit", 0.0, reason, "shift the phase of the loads")
        q, v = tangent.motion.states(np.array([self.period]))
        return np.concatenate([q[0], v[0]]), tangent.monodromy, tangent


def _sizes(motion: Motion, period: float) -> Array:
    """The largest |q| and |q'| where the segments of a period start, for each entry of a state, (2n,).

    Where all starts are near zeros of one of them it counts as a share of what one turn in the period gives.
    """
    turn, states = period / (2.0 * np.pi), motion.states(motion.times, np.arange(len(motion.times)))
    q, v = (float(np.max(np.abs(x))) for x in states)
    q = max(q, LEAST * turn * v, 1e-300)
    return np.repeat([q, max(v, q / turn)], states[0].shape[1])


@working("looking for an orbit")
def periodic_orbit(system: System, period: float, guess: Any = None) -> Orbit:
    """The periodic orbit of the exact flow near a guess, stable or unstable.

    Parameters
    ----------
    system : System
        Between linear stops, compliant, damped or rigid with restitution; loads repeat after ``period``.
    period : float
        A multiple of the periods of all loads and stop motions.
    guess : Orbit, pair (q, v), or None
        A neighbour; a state at t = 0. None: the state after 60 periods from the system's own start.

    Returns
    -------
    Orbit
        ``.closure .multipliers .stable .events .q .v .monodromy``

    Raises
    ------
    InputError
        For loads that do not repeat, and for stops that the exact solution does not take.
    SolverFailure
        If Newton's method does not converge from the guess.

    Examples
    --------
    >>> import numpy as np, stiffbeam as sb
    >>> stop = sb.Contact([1.0], sb.Stops(upper=0.0, stiffness=float("inf"), restitution=0.8))
    >>> load = ([1.0], sb.Harmonic(1.0, 2.8, phase=7.8))
    >>> oscillator = sb.System.from_matrices([[1.0]], [[1.0]], loads=[load], contacts=[stop])
    >>> orbit = sb.periodic_orbit(oscillator, 2 * np.pi / 2.8, ([-0.5], [0.0]))
    >>> round(float(np.linalg.det(orbit.monodromy)), 9)  # e^2
    0.64
    """
    require_periodic(system, period)
    period = float(period)
    with within_float64("periodic_orbit", period):
        mapping = PeriodMap(system, period)
        return _orbit(mapping, *shoot(mapping, _guessed(mapping, guess)))


def require_periodic(system: System, period: float) -> None:
    """Raise InputError for loads that do not repeat after a period, and for stops without an exact solution."""
    require_system(system)
    period = positive("period", period)
    drive = system.drive
    for function in drive.others:
        rule = "be made of Harmonic and Constant for a periodic orbit"
        raise InputError("time function", function, rule, "write it as a sum of harmonics")
    for frequency in drive.frequencies:
        turns = period * float(frequency) / (2.0 * np.pi)
        if abs(turns - round(turns)) > REPEATS * turns or round(turns) < 1:
            rule = f"be a multiple of 2 pi/{frequency!r}, the period of a load"
            raise InputError("period", period, rule, f"for example {2.0 * np.pi / frequency!r}")
    refuse(system, period, "")


def _orbit(mapping: PeriodMap, z: Array, closure: float) -> Orbit:
    """The Orbit that starts at z. Raises SolverFailure where its multipliers do not exist, or one of them is 1."""
    system, n = mapping.system, mapping.system.size
    # The orbit is known to its closure only: so near to a graze it may be one.
    _, D, tangent = mapping.flow(z, max(GRAZE, NEAR_GRAZE * closure))
    time, reason = min(ends_of(tangent), default=(np.inf, ""))
    if np.isfinite(time):
        reason = f"the orbit has no multipliers: {reason}"
        raise SolverFailure("periodic_orbit", time, reason, "change a parameter or a phase")
    multipliers = np.asarray(np.linalg.eigvals(D), complex)
    # At a fold the defect is quadratic in the distance from the orbit, and the multiplier linear.
    if np.min(np.abs(multipliers - 1.0)) < max(ALONE, closure**0.5):
        raise SolverFailure("periodic_orbit", mapping.period, NOT_ALONE, FREE)
    multipliers = multipliers[np.argsort(-np.abs(multipliers), kind="stable")]
    motion, start = tangent.motion, (z[:n].copy(), z[n:].copy())
    events = motion.events[0][(motion.events[0] > 0.0) & (motion.events[0] < mapping.period)]
    return Orbit(system, mapping.period, *start, closure, multipliers, D, events, _sizes(motion, mapping.period))


def shoot(mapping: PeriodMap, z: Array) -> tuple[Array, float]:
    """A fixed point of the period map near z, and its relative defect."""
    defect = np.inf
    # Newton's method, with steps halved until the defect falls.
    for iteration in range(NEWTON):
        end, D, tangent = mapping.flow(z)
        scale = _sizes(tangent.motion, mapping.period)
        defect = float(np.max(np.abs(end - z) / scale))
        if defect < ROUNDING or (iteration >= HOPELESS and defect > ASTRAY):
            break
        # A rounding that grows so much is 2e-3 of the motion: too few digits for Newton's method.
        if (growth := float(np.linalg.norm(D * scale / scale[:, None]))) > APART:
            reason = f"neighbouring motions diverge by {growth:.0e} in a period, more than float64 has digits"
            raise SolverFailure("periodic_orbit", mapping.period, reason, "damp the system, or drive it faster")
        # Unknowns in units of the motion, since positions and velocities differ in size.
        try:
            step = np.linalg.solve((D - np.eye(len(z))) * scale, -(end - z)) * scale
        except np.linalg.LinAlgError as error:
            raise SolverFailure("periodic_orbit", mapping.period, NOT_ALONE, FREE) from error
        trials = list[tuple[float, Array]]()
        for trial in (z + step * 0.5**halving for halving in range(HALVINGS)):
            with suppress(SolverFailure):
                trials.append((float(np.max(np.abs(mapping.ahead(trial, 1) - trial) / scale)), trial))
                if trials[-1][0] < defect:
                    break
        best, z_new = min(trials, key=lambda each: each[0], default=(np.inf, z))
        # A closed orbit that does not improve is at rounding. Before that even a worse trial may lead on.
        if not trials or (best >= defect and defect < CLOSED):
            break
        z = z_new
    if not defect < CLOSED:
        reason = f"Newton's method does not close the orbit: {defect:.1e} of it is left"
        raise SolverFailure("periodic_orbit", mapping.period, reason, "give a closer guess, as a neighbouring orbit")
    return z, defect


def _guessed(mapping: PeriodMap, guess: Any) -> Array:
    """The state (2n,) from which Newton's method starts."""
    system, n = mapping.system, mapping.system.size
    if guess is None:
        return mapping.ahead(np.concatenate([system.q0, system.v0]), SETTLE)
    try:
        pair = (guess.q, guess.v) if isinstance(guess, Orbit) else guess
        z = np.concatenate([np.asarray(x, float).ravel() for x in pair])
    except (TypeError, ValueError):
        z = np.zeros(0)
    if z.shape != (2 * n,) or not np.all(np.isfinite(z)):
        rule = f"be an Orbit or a pair (q, v) of {n} finite numbers each"
        raise InputError("guess", guess, rule, "leave it out for the state after 60 periods")
    return z
