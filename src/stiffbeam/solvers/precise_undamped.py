"""The undamped solution with at most one contact in many digits: the regimes of undamped.py."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from flint import arb, arb_mat, ctx

from ..drive import Drive
from ..modal import Modes
from ..system import System
from .precise_modes import UndampedPencil, dot, double, locate, precision_at, refine, response
from .rational import Exact, exact_problem
from .switching import follow
from .undamped import Regime, Solution
from .undamped_tracer import Tracer, search_arguments


@dataclass(eq=False)
class PreciseRegime:
    """Modes of one regime at full precision: omega, omega^2 (n,), X (n, n), level (n,), P (n, d); the
    contact's row in them (n,), and row P + offset (d,)."""

    omega: list[Any]
    squares: list[Any]
    shapes: Any
    level: list[Any]
    particular: list[list[Any]]
    row: list[Any]
    drive_row: list[Any]


def precise_undamped(system: System, t_end: float, full: int) -> Solution:
    """The solution on [0, t_end] carried with ``full`` bits at the start; ctx.prec has room to spare."""
    drive = Drive.of(system)
    problem = exact_problem(system, drive)
    frequencies = [arb(f) for f in drive.frequencies]
    bases = Tracer(system).bases  # refuses what float64 refuses
    regimes: dict[int, PreciseRegime] = {}
    for side in (0, 1, -1) if system.contacts else (0,):
        regimes[side] = _regime(bases[side], problem, drive, frequencies, side, regimes.get(1))
    cross = None
    if 1 in regimes:
        cross = regimes[0].shapes.transpose() * problem.mass * regimes[1].shapes  # eta_free = cross eta_contact
    rounded = {side: _rounded(regime, problem, drive) for side, regime in regimes.items()}
    n = system.size
    stops = system.contacts[0].stops if system.contacts else None
    args = search_arguments(rounded, double(cross) if cross is not None else np.eye(n), drive, stops)
    fastest = max(1e-300, *(float(r.omega[-1]) for r in rounded.values()))
    shortest = 2.0 * np.pi / max(fastest, *drive.frequencies, 0.0)
    mass_shapes = problem.mass * regimes[0].shapes
    eta, rate = ((arb_mat([values]) * mass_shapes).tolist()[0] for values in (problem.q0, problem.v0))
    t, side = arb(0), 0
    g, g_rate = _coefficients(frequencies, t)
    if stops is not None:
        side = int(stops.state(float(dot(regimes[0].row, eta) + dot(problem.contacts[0].offset, g))))
        if side:
            eta, rate = _change(cross, eta, rate, to_contact=True)
    h, h_rate = _homogeneous(regimes[side], eta, rate, g, g_rate)
    times, sides, hs, rates, evaluations = [0.0], [side], [_doubles(h)], [_doubles(h_rate)], 0
    out_t, out_side, out_h = np.empty(1), np.empty(1, np.int64), np.empty((1, n))
    while True:
        ctx.prec = precision_at(full, float(t), t_end)
        count, used = follow(
            hs[-1].copy(), rates[-1].copy(), side, float(t), t_end, len(times) > 1,
            *args, out_t, out_side, out_h, out_h.copy(),
        )  # fmt: skip
        evaluations += used
        if not count:
            break
        regime, new = regimes[side], int(out_side[0])
        stop = problem.contacts[0].stop(side or new)
        start = float(arb(float(out_t[0])) - t)
        tau, shift, (q, v) = locate(
            partial(_gap, regime, frequencies, h, h_rate, t, stop), start, fastest, shortest, float(t)
        )
        t = (t + tau + shift).mid()
        g, g_rate = _coefficients(frequencies, t)
        eta, rate = _taylor(regime, q, v, shift, g, g_rate)
        eta, rate = _change(cross, eta, rate, to_contact=side == 0)
        h, h_rate = _homogeneous(regimes[new], eta, rate, g, g_rate)
        side = new
        times.append(float(t))
        sides.append(side)
        hs.append(_doubles(h))
        rates.append(_doubles(h_rate))
    bases = {k: Modes(rounded[k].omega, double(r.shapes), np.zeros(n), system.mass) for k, r in regimes.items()}
    return Solution(
        drive, bases, rounded, np.array(times), np.array(sides, np.int64), np.array(hs), np.array(rates), evaluations
    )


def _regime(
    base: Modes, problem: Exact, drive: Drive, frequencies: list[Any], side: int, other: PreciseRegime | None
) -> PreciseRegime:
    """The regime of ``side``; on the lower stop the modes are those of the ``other``, on the upper."""
    n = len(base.omega)
    stiffness, basis = problem.closed([side] * len(problem.contacts))
    if other is None:
        start = arb_mat([[arb(float(x)) for x in line] for line in base.shapes])
        shapes, squares = refine(UndampedPencil(problem.mass, stiffness), start, [])
        least = abs(squares[-1]) * arb(2) ** (-ctx.prec // 2)
        squares = [arb(0) if abs(x) < least else x for x in squares]  # a rigid-body mode
    else:
        squares, shapes = other.squares, other.shapes
    force = (shapes.transpose() * arb_mat(basis).transpose()).tolist()  # (n, d)
    particular = [[arb(0)] * drive.size for _ in range(n)]
    for k, frequency in enumerate(frequencies):
        for j in range(n):
            for i in (1 + 2 * k, 2 + 2 * k):
                square = frequency * frequency
                particular[j][i] = response(force[j][i], squares[j] - square, square)
    row, drive_row = [arb(0)] * n, [arb(0)] * drive.size
    if problem.contacts:
        row = [x.mid() for x in (arb_mat([problem.contacts[0].row]) * shapes).tolist()[0]]
        moved = (arb_mat([row]) * arb_mat(particular)).tolist()[0]
        drive_row = [(a + b).mid() for a, b in zip(moved, problem.contacts[0].offset, strict=True)]
    omega, level = [x.sqrt().mid() for x in squares], [force[j][0].mid() for j in range(n)]
    return PreciseRegime(omega, squares, shapes, level, particular, row, drive_row)


def _rounded(regime: PreciseRegime, problem: Exact, drive: Drive) -> Regime:
    particular = np.array([_doubles(line) for line in regime.particular]).reshape(len(regime.omega), drive.size)
    offset = _doubles(problem.contacts[0].offset) if problem.contacts else np.zeros(drive.size)
    return Regime(_doubles(regime.omega), _doubles(regime.level), particular, _doubles(regime.row), offset)


def _doubles(values: list[Any]) -> Any:
    return np.array([float(x) for x in values])


def _coefficients(frequencies: list[Any], t: Any) -> tuple[list[Any], list[Any]]:
    """g(t) and g'(t)."""
    g, g_rate = [arb(1)], [arb(0)]
    for w in frequencies:
        s, c = (w * t).sin_cos()
        g += [s, c]
        g_rate += [w * c, -w * s]
    return g, g_rate


def _homogeneous(regime: PreciseRegime, eta: list, rate: list, g: list, g_rate: list) -> tuple[list, list]:
    """h = eta - P g and its rate, midpoints."""
    h, h_rate = [], []
    for j, p in enumerate(regime.particular):
        h.append((eta[j] - dot(p, g)).mid())
        h_rate.append((rate[j] - dot(p, g_rate)).mid())
    return h, h_rate


def _oscillators(regime: PreciseRegime, h: list, h_rate: list, tau: Any) -> tuple[list, list]:
    """The homogeneous part and its rate at tau: h cos + h'/w sin + level (1 - cos)/w^2, or its limit."""
    q, v = [], []
    for w, w2, x, y, level in zip(regime.omega, regime.squares, h, h_rate, regime.level, strict=True):
        if w2 == 0:
            q.append(x + tau * (y + tau * level / 2))
            v.append(y + tau * level)
            continue
        s, c = (w * tau).sin_cos()
        rest = level / w2
        q.append((x - rest) * c + y * s / w + rest)
        v.append(y * c - (x - rest) * w * s)
    return q, v


def _gap(
    regime: PreciseRegime, frequencies: list[Any], h: list, h_rate: list, t: Any, stop: Any, tau: Any
) -> tuple[Any, Any, tuple[list, list]]:
    """u - stop and u' at t + tau, and the homogeneous part and its rate there."""
    q, v = _oscillators(regime, h, h_rate, tau)
    g, g_rate = _coefficients(frequencies, t + tau)
    u = dot(regime.row, q) + dot(regime.drive_row, g) - stop
    return u.mid(), (dot(regime.row, v) + dot(regime.drive_row, g_rate)).mid(), (q, v)


def _taylor(regime: PreciseRegime, q: list, v: list, shift: Any, g: list, g_rate: list) -> tuple[list, list]:
    """eta and eta' at the switch, a Taylor step of ``shift`` from the homogeneous part q, v."""
    half = shift * shift / 2
    eta, rate = [], []
    for j, p in enumerate(regime.particular):
        acceleration = regime.level[j] - regime.squares[j] * q[j]
        jerk = -regime.squares[j] * v[j]
        eta.append(q[j] + shift * v[j] + half * acceleration + dot(p, g))
        rate.append(v[j] + shift * acceleration + half * jerk + dot(p, g_rate))
    return eta, rate


def _change(cross: Any, eta: list, rate: list, to_contact: bool) -> tuple[list, list]:
    """Between the modes of the free and of the contact state."""
    columns = arb_mat([[a, b] for a, b in zip(eta, rate, strict=True)]).mid()
    both = ((cross.transpose() if to_contact else cross) * columns).tolist()
    return [line[0].mid() for line in both], [line[1].mid() for line in both]
