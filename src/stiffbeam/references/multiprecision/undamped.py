"""The undamped solution with at most one contact in many digits: the regimes of undamped.py."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx

from ...basics.resources import Forecast
from ...model.contact import Stops
from ...model.drive import Drive
from ...model.modes import Modes
from ...model.system import System
from ..exact.following import Regimes, follow
from ..exact.undamped import Solution
from ..exact.undamped_regimes import SIDES, Parts, assembled
from ..exact.undamped_tracer import QUIET, Tracer
from .grazes import Switch
from .modes import Sampler, UndampedPencil, channels, dot, double, locate, precision_at, refine, sampler
from .rational import Exact, exact_problem, number


@dataclass(eq=False)
class PreciseRegime:
    """Modes of one regime at full precision: omega, omega^2 (n,), X (n, n), level (n,), P (n, d); the
    contact's row in them (n,), and row P + offset (d,). channels: (channels, n) and (channels, d), the same
    of every observed row. close: mode, drive frequency and modal force of sine and cosine of the pairs
    that answer from rest, see ``following.Regimes``."""

    omega: list[Any]
    squares: list[Any]
    shapes: Any
    level: list[Any]
    particular: list[list[Any]]
    row: list[Any]
    drive_row: list[Any]
    channels: tuple[list[list[Any]], list[list[Any]]]
    close: list[tuple[int, int, Any, Any]]


class Piece(NamedTuple):
    """Where a piece begins: the time, side, h and h', the drive coefficients there, and the bits carried."""

    t: Any
    side: int
    h: list[Any]
    h_rate: list[Any]
    g: list[Any]
    bits: int


def precise_undamped(
    system: System, t_end: float, full: int, guard: int, told: Sequence[Switch] = ()
) -> tuple[Solution, Sampler, Solution]:
    """The solution on [0, t_end] carried with ``full`` bits at the start and ``guard`` at the end, rounded to
    float64, what samples its channels before it is rounded, and the first again, whose sums do not cancel;
    ctx.prec has room to spare. told: switches that float64 does not see, in order.
    """
    drive = Drive.of(system)
    problem = exact_problem(system, drive)
    frequencies = [arb(number(f)) for f in drive.frequencies]
    start = Tracer(Parts(system, span=t_end))  # refuses what float64 refuses
    bases, close = start.bases, start.regimes.close
    regimes: dict[int, PreciseRegime] = {}
    for side in (0, 1, -1) if system.contacts else (0,):
        regimes[side] = _regime(bases[side], problem, system, drive, frequencies, close, side, regimes.get(1))
    cross = None
    if 1 in regimes:
        cross = regimes[0].shapes.transpose() * problem.mass * regimes[1].shapes  # eta_free = cross eta_contact
    n, stops = system.size, system.contacts[0].stops if system.contacts else None
    args = _rounded([regimes.get(side, regimes[0]) for side in SIDES], cross, problem, drive, close, stops)
    fastest = max(1e-300, float(np.max(args.omegas)))
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
    pieces = [Piece(t, side, h, h_rate, g, precision_at(full, guard, 0.0, t_end))]
    out_t, out_side, out_h = np.empty(1), np.empty(1, np.int64), np.empty((1, n))
    forecast, untold = Forecast(t_end), list(told)
    while True:
        ctx.prec = precision_at(full, guard, float(t), t_end)
        count, used = follow(
            args, side, hs[-1], rates[-1], float(t), t_end, len(times) > 1, QUIET, 0.0,
            out_t, out_side, out_h, out_h.copy(),
        )  # fmt: skip
        evaluations += used
        if untold and untold[0].t < (out_t[0] if count else t_end):
            count, out_t[0], out_side[0] = 1, untold[0].t, 0 if side else untold[0].side
            del untold[0]
        if not count:
            break
        forecast.check(times[-1], len(times) * (full / 32.0 + 20.0) * system.size)
        regime, new = regimes[side], int(out_side[0])
        stop = problem.contacts[0].stop(side or new)
        start = float(arb(float(out_t[0])) - t)
        tau, shift, (q, v) = locate(
            partial(_gap, regime, frequencies, pieces[-1], stop), start, fastest, shortest, float(t)
        )
        t = (t + tau + shift).mid()
        g, g_rate = _coefficients(frequencies, t)
        eta, rate = _taylor(regime, q, v, shift, g, g_rate)
        eta, rate = _change(cross, eta, rate, to_contact=side == 0)
        h, h_rate = _homogeneous(regimes[new], eta, rate, g, g_rate)
        side = new
        pieces.append(Piece(t, side, h, h_rate, g, ctx.prec))
        times.append(float(t))
        sides.append(side)
        hs.append(_doubles(h))
        rates.append(_doubles(h_rate))
    free, contact = (
        Modes(args.omegas[side], double(regimes.get(side, regimes[0]).shapes), np.zeros(n), system.mass)
        for side in (0, 1)
    )
    solution = Solution(
        drive, (free, contact), args, np.array(times), np.array(sides, np.int64), np.array(hs), np.array(rates),
        evaluations,
    )  # fmt: skip
    return solution, sampler(times, pieces, partial(_sample, regimes, frequencies)), solution


def _sample(
    regimes: dict[int, PreciseRegime], frequencies: list[Any], piece: Piece, t: float
) -> tuple[list[Any], list[Any]]:
    """Positions and velocities of the channels at t inside a piece."""
    regime = regimes[piece.side]
    q, v = _oscillators(regime, frequencies, piece, arb(t) - piece.t)
    g, g_rate = _coefficients(frequencies, arb(t))
    modal, wave = regime.channels
    u = [dot(row, q) + dot(seen, g) for row, seen in zip(modal, wave, strict=True)]
    return u, [dot(row, v) + dot(seen, g_rate) for row, seen in zip(modal, wave, strict=True)]


def _regime(
    base: Modes,
    problem: Exact,
    system: System,
    drive: Drive,
    frequencies: list[Any],
    close: Any,
    side: int,
    other: PreciseRegime | None,
) -> PreciseRegime:
    """The regime of ``side``; on the lower stop the modes are those of the ``other``, on the upper."""
    n = len(base.omega)
    _, stiffness, basis, _ = problem.closed([side] * len(problem.contacts))
    if other is None:
        start = arb_mat([[arb(float(x)) for x in line] for line in base.shapes])
        shapes, squares = refine(UndampedPencil(problem.mass, stiffness), start, [])
        least = abs(squares[-1]) * arb(2) ** (-ctx.prec // 2)
        squares = [arb(0) if abs(x) < least else x for x in squares]  # a rigid-body mode
    else:
        squares, shapes = other.squares, other.shapes
    force = (shapes.transpose() * arb_mat(basis).transpose()).tolist()  # (n, d)
    particular = [[arb(0)] * drive.size for _ in range(n)]
    pairs = {(mode, k) for mode, k in close.tolist()}
    for k, frequency in enumerate(frequencies):
        for j in range(n):
            if (j, k) not in pairs:
                for i in (1 + 2 * k, 2 + 2 * k):
                    particular[j][i] = (force[j][i] / (squares[j] - frequency * frequency)).mid()
    seen = [_seen(row, offset, shapes, particular) for row, offset, _ in channels(system, problem, drive)]
    modal, wave = ([x[k] for x in seen] for k in (0, 1))
    omega, level = [x.sqrt().mid() for x in squares], [force[j][0].mid() for j in range(n)]
    close_forces = [(j, k, force[j][1 + 2 * k].mid(), force[j][2 + 2 * k].mid()) for j, k in close.tolist()]
    return PreciseRegime(omega, squares, shapes, level, particular, modal[0], wave[0], (modal, wave), close_forces)


def _seen(row: list[Any], offset: list[Any], shapes: Any, particular: list[list[Any]]) -> tuple[list[Any], list[Any]]:
    """What a channel sees of the modes (n,) and of the drive (d,)."""
    modal = [x.mid() for x in (arb_mat([row]) * shapes).tolist()[0]]
    moved = (arb_mat([modal]) * arb_mat(particular)).tolist()[0]
    return modal, [(a + b).mid() for a, b in zip(moved, offset, strict=True)]


def _rounded(
    three: list[PreciseRegime], cross: Any, problem: Exact, drive: Drive, close: Any, stops: Stops | None
) -> Regimes:
    """The regimes in float64, from those in the order of SIDES."""
    n, d = len(three[0].omega), drive.size
    return assembled(
        omegas=np.stack([_doubles(regime.omega) for regime in three[:2]]),
        rows=np.stack([_doubles(regime.row) if stops else np.zeros(n) for regime in three[:2]]),
        levels=np.stack([_doubles(regime.level) for regime in three]),
        particulars=np.stack([np.array([_doubles(line) for line in x.particular]).reshape(n, d) for x in three]),
        close=close,
        close_forces=np.stack([np.array([_doubles(pair[2:]) for pair in x.close]).reshape(-1, 2) for x in three]),
        cross=np.eye(n) if cross is None else double(cross),
        offset=_doubles(problem.contacts[0].offset) if stops else np.zeros(d),
        drive=drive,
        stops=stops,
    )


def _doubles(values: Sequence[Any]) -> Any:
    return np.array([float(x) for x in values])


def _coefficients(frequencies: list[Any], t: Any) -> tuple[list[Any], list[Any]]:
    """g(t) and g'(t)."""
    g, g_rate = [arb(1)], [arb(0)]
    for w in frequencies:
        s, c = (w * t).sin_cos()
        g += [s, c]
        g_rate += [w * c, -w * s]
    return g, g_rate


def _homogeneous(
    regime: PreciseRegime, eta: list[Any], rate: list[Any], g: list[Any], g_rate: list[Any]
) -> tuple[list[Any], list[Any]]:
    """h = eta - P g and its rate, midpoints."""
    h, h_rate = [], []
    for j, p in enumerate(regime.particular):
        h.append((eta[j] - dot(p, g)).mid())
        h_rate.append((rate[j] - dot(p, g_rate)).mid())
    return h, h_rate


def _oscillators(regime: PreciseRegime, frequencies: list[Any], piece: Piece, tau: Any) -> tuple[list[Any], list[Any]]:
    """What is not P g and its rate at tau: h cos + h'/w sin + level (1 - cos)/w^2, or its limit; the close pairs."""
    q, v = [], []
    for w, w2, x, y, level in zip(regime.omega, regime.squares, piece.h, piece.h_rate, regime.level, strict=True):
        if w2 == 0:
            q.append(x + tau * (y + tau * level / 2))
            v.append(y + tau * level)
            continue
        s, c = (w * tau).sin_cos()
        rest = level / w2
        q.append((x - rest) * c + y * s / w + rest)
        v.append(y * c - (x - rest) * w * s)
    for j, k, sine, cosine in regime.close:
        s, c = piece.g[1 + 2 * k], piece.g[2 + 2 * k]
        a, b = sine * s + cosine * c, sine * c - cosine * s
        w, frequency = regime.omega[j], frequencies[k]
        from_cosine, from_sine = _from_rest(w, frequency, tau)
        over = tau if w == 0 else (w * tau).sin() / w
        q[j] += a * from_cosine + b * from_sine
        v[j] += a * (over - frequency * from_sine) + b * frequency * from_cosine
    return q, v


def _from_rest(w: Any, frequency: Any, tau: Any) -> tuple[Any, Any]:
    """C and S of ``oscillation.from_rest``; at a distance below the square root of the rounding those of resonance."""
    gain = ((w - frequency) * (w + frequency)).mid()
    s, c = (frequency * tau).sin_cos()
    if abs(gain) <= frequency * frequency * arb(2) ** (-ctx.prec // 2):
        return tau * s / (2 * frequency), (s / frequency - tau * c) / (2 * frequency)
    own, cosine = (w * tau).sin_cos()
    return (c - cosine) / gain, (s - frequency * (tau if w == 0 else own / w)) / gain


def _gap(
    regime: PreciseRegime, frequencies: list[Any], piece: Piece, stop: Any, tau: Any
) -> tuple[Any, Any, tuple[list[Any], list[Any]]]:
    """u - stop and u' at tau after the start of a piece, and what is not P g and its rate there."""
    q, v = _oscillators(regime, frequencies, piece, tau)
    g, g_rate = _coefficients(frequencies, piece.t + tau)
    u = dot(regime.row, q) + dot(regime.drive_row, g) - stop
    return u.mid(), (dot(regime.row, v) + dot(regime.drive_row, g_rate)).mid(), (q, v)


def _taylor(
    regime: PreciseRegime, q: list[Any], v: list[Any], shift: Any, g: list[Any], g_rate: list[Any]
) -> tuple[list[Any], list[Any]]:
    """eta and eta' at the switch, a Taylor step of ``shift`` to it from q, v of ``_oscillators``; g, g_rate: there."""
    half = shift * shift / 2
    close_force, close_rate = [arb(0)] * len(q), [arb(0)] * len(q)
    for j, k, sine, cosine in regime.close:
        rate = sine * g_rate[1 + 2 * k] + cosine * g_rate[2 + 2 * k]
        close_force[j] += sine * g[1 + 2 * k] + cosine * g[2 + 2 * k] - shift * rate
        close_rate[j] += rate
    eta, rate = [], []
    for j, p in enumerate(regime.particular):
        acceleration = regime.level[j] + close_force[j] - regime.squares[j] * q[j]
        jerk = close_rate[j] - regime.squares[j] * v[j]
        eta.append(q[j] + shift * v[j] + half * acceleration + dot(p, g))
        rate.append(v[j] + shift * acceleration + half * jerk + dot(p, g_rate))
    return eta, rate


def _change(cross: Any, eta: list[Any], rate: list[Any], to_contact: bool) -> tuple[list[Any], list[Any]]:
    """Between the modes of the free and of the contact state."""
    columns = arb_mat([[a, b] for a, b in zip(eta, rate, strict=True)]).mid()
    both = ((cross.transpose() if to_contact else cross) * columns).tolist()
    return [line[0].mid() for line in both], [line[1].mid() for line in both]
