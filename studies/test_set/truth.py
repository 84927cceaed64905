"""What is known of a motion, in 30 digits: by the package's multiprecision, or from pieces in closed form by mpmath."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import mpmath as mp
import numpy as np
from flint import arb, arb_mat, ctx
from scipy.optimize import brentq

import stiffbeam as sb
from stiffbeam.references.multiprecision import BITS, NO_TIMES, PreciseSolver

DIGITS = 30
mp.mp.dps = 60


def text(x: Any) -> str:
    """30 significant digits; what is below 1e-40 is 0."""
    x = mp.mpf(x)
    return "0.0" if abs(x) < mp.mpf(10) ** -40 else mp.nstr(x, DIGITS, strip_zeros=True, min_fixed=-6, max_fixed=30)


@dataclass
class Truth:
    """Tip and velocity at the sample times; impacts, releases and peak force of the first contact; energy."""

    how: str
    tip: list[Any]
    velocity: list[Any]
    impacts: list[Any] | None  # none where contact begins without speed
    releases: list[Any]
    peak: Any = None
    energy: tuple[Any, Any, str] | None = None  # energy at t_end, its scale, and how
    more: dict[str, tuple[Any, str]] = field(default_factory=dict)


def sample_times(t_end: float, samples: int) -> np.ndarray:
    return np.arange(1, samples + 1) * t_end / samples


def energy_of(system: sb.System, q: Sequence[Any], v: Sequence[Any]) -> Any:
    """1/2 v M v + 1/2 q K q + kappa d^(p+1)/(p+1) of every contact, in mpmath."""
    n = system.size
    total = mp.mpf(0)
    for matrix, x in ((system.mass, v), (system.stiffness, q)):
        for i, j in zip(*np.nonzero(matrix), strict=True):
            total += mp.mpf(matrix[i, j]) * x[i] * x[j] / 2
    for contact in system.contacts:
        u = mp.fsum(mp.mpf(contact.row[i]) * q[i] for i in range(n))
        stops, p = contact.stops, mp.mpf(float(contact.stops.exponent))
        for depth in (u - mp.mpf(stops.law.g2), mp.mpf(stops.law.g1) - u):
            if depth > 0:
                total += mp.mpf(float(stops.stiffness)) * depth ** (p + 1) / (p + 1)
    return total


def piecewise(system: sb.System, t_end: float, samples: int, digits: int = 70, guard: int = 220) -> Truth:
    """A piecewise-linear system by the package's multiprecision, twice; the runs agree to 30 digits or it fails."""
    once, again = (_piecewise(system, t_end, samples, d, g) for d, g in ((digits, guard), (2 * digits, 2 * guard)))
    for name in ("tip", "velocity", "impacts", "releases", "peak"):
        a, b = (np.atleast_1d(getattr(x, name)) for x in (once, again))
        assert len(a) == len(b), name
        scale = max((abs(x) for x in b), default=1)
        assert all(abs(x - y) <= mp.mpf(10) ** -DIGITS * scale for x, y in zip(a, b, strict=True)), name
    return again


def _piecewise(system: sb.System, t_end: float, samples: int, digits: int, guard: int) -> Truth:
    full = math.ceil(digits * BITS) + guard
    with ctx.workprec(full + guard):
        solver = PreciseSolver(system, t_end, full, guard)
        pieces = solver.follow()
        solution, flow = solver.motion(pieces, NO_TIMES), solver.flow
        forms = [*flow.forms]
        if system.observe is not None:
            forms.append(arb_mat([[*map(arb, system.observe.tolist()), *(flow.N - flow.n) * [0]]]))
        rates = [form * flow.G for form in forms]
    tip, stops = system.tip_channel, system.contacts[0].stops
    begun = np.array([float(piece.t) for piece in pieces])

    def at(t: Any, channel: int) -> tuple[list[Any], list[Any]]:
        """Position and velocity at times that are doubles, as mpf."""
        # flint writes what it knows; a little more than mpmath carries.
        value = lambda x: mp.mpf(x.mid().str(mp.mp.dps + 5, radius=False))  # noqa: E731
        times = np.atleast_1d(t)
        of = np.maximum(np.searchsorted(begun, times, "right") - 1, 0)
        states = [pieces[k].whole(when) for k, when in zip(of.tolist(), times.tolist(), strict=True)]
        rows = forms[channel], rates[channel]
        with ctx.workprec(pieces[0].bits):
            u, v = ([value((row * z)[0, 0]) for z in states] for row in rows)
        return u, v

    def near(t: float) -> tuple[Any, Any, Any]:
        """Position, velocity and acceleration of the first contact at a double: what is sought is nearer than 1e-16."""
        beside = t * (1.0 + 2.0**-40)
        x, w = at([t, beside], 0)
        return x[0], w[0], (w[1] - w[0]) / (mp.mpf(beside) - mp.mpf(t))

    u, v = at(sample_times(t_end, samples), tip)
    switches: dict[bool, list[Any]] = {True: [], False: []}
    sides = solution.sides[:, 0]
    for k in range(1, len(solution.times)):
        if sides[k] != sides[k - 1] and solution.times[k] > 0.0:  # contact that is there at the start is no impact
            side, t = int(sides[k] or sides[k - 1]), float(solution.times[k])
            x, w, a = near(t)
            s = (x - mp.mpf(stops.law.g2 if side > 0 else stops.law.g1)) / w
            switches[bool(sides[k])].append(mp.mpf(t) - s - a * s**2 / (2 * w))
    edges = np.append(solution.times, t_end)
    peak = mp.mpf(0)
    for k in range(len(solution.times)):
        if not sides[k]:
            continue
        grid = np.linspace(edges[k], edges[k + 1], 65)
        rate = np.array([float(x) for x in at(grid, 0)[1]])
        turns = np.flatnonzero(rate[1:] * rate[:-1] < 0.0)
        found = [brentq(lambda t: float(at(t, 0)[1][0]), grid[i], grid[i + 1], xtol=1e-300, rtol=1e-15) for i in turns]
        tops = [at(edge, 0)[0][0] for edge in edges[k : k + 2]]
        tops += [x - w**2 / (2 * a) for x, w, a in map(near, found)]
        for x in tops:
            depth = x - mp.mpf(stops.law.g2) if sides[k] > 0 else mp.mpf(stops.law.g1) - x
            peak = max(peak, mp.mpf(float(stops.stiffness)) * depth)
    return Truth("multiprecision (python-flint), twice with different precision", u, v, switches[True], switches[False],
                 peak, _energy(system, t_end))  # fmt: skip


def _energy(system: sb.System, t_end: float) -> tuple[Any, Any, str]:
    if not system.loads and not system.damped:
        conserved = energy_of(system, [mp.mpf(x) for x in system.q0], [mp.mpf(x) for x in system.v0])
        return conserved, conserved, "that of the start: nothing is put in or dissipated"
    ledger = sb.reference(system, t_end, "multiprecision", t_eval=[0.0, t_end]).energy
    start = float(sum(system.energies(0.0, system.q0, system.v0)))
    end = float(ledger.kinetic[-1] + ledger.elastic[-1] + ledger.stops[-1])
    how = "float64 from the multiprecision state, to 11 digits"
    return mp.mpf(f"{end:.11g}"), mp.mpf(f"{start + abs(float(ledger.input[-1])):.11g}"), how


@dataclass(frozen=True)
class Span:
    """From ``begin`` on the motion is ``path(t - begin)``, which gives position and velocity."""

    begin: Any
    path: Callable[[Any], tuple[Any, Any]]


def from_spans(spans: Sequence[Span], t_end: float, samples: int) -> tuple[list[Any], list[Any]]:
    """Positions and velocities at the sample times; at a switch those after it."""
    u, v = [], []
    for t in map(mp.mpf, sample_times(t_end, samples)):
        span = [s for s in spans if s.begin <= t][-1]
        a, b = span.path(t - span.begin)
        u.append(a)
        v.append(b)
    return u, v


def free(u: Any, v: Any, a: Any = 0) -> Callable[[Any], tuple[Any, Any]]:
    """u + v s + a s^2/2."""
    return lambda s: (u + v * s + a * s * s / 2, v + a * s)
