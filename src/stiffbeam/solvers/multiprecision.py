"""The exact piecewise-linear solution in as many digits as the chaos eats, with python-flint.

The same three regimes as in float64 (undamped.py), with modes, states and switching times carried as
midpoints of multiprecision numbers. Most evaluations need few digits: the float64 search finds the next
switch, Newton's method doubles its digits, and only one evaluation of the sines and cosines per switch
is made at full precision. Digits that the motion has already used up are not carried any further.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import flint
import numpy as np
from flint import arb, arb_mat, ctx

from ..arrays import Array
from ..drive import Drive
from ..system import System
from ..trajectory import Reference, SolverFailure
from ..validation import InputError
from .agreement import with_horizon
from .piecewise import reference_of, refuse, solve_exact
from .precise_modes import PreciseRegime, dot, double, precise_regime, rounded_modes, rounded_regime
from .rational import Exact, exact_problem
from .switching import follow
from .undamped import Solution, search_arguments

BITS = math.log2(10.0)
GUARD_BITS = 100  # below the digits that are lost: two doubles' worth for the outputs
MAX_DIGITS = 20_000
AGREEMENT = 1e-12  # of max |u|: how closely two precisions have to agree, float64 evaluation included


def solve_multiprecision(system: System, t_end: float, t_eval: Array | None, digits: int | str = "auto") -> Reference:
    """The exact solution carried with ``digits`` decimal digits, and again with a quarter more.

    "auto" estimates the digits from the horizon of float64, which loses thirteen of them on the way
    there, and goes on until both runs agree to t_end. A fixed number gives the horizon to which both
    agree. The result holds the states at the switches rounded to float64, from which any time is
    evaluated to about 1e-12 of max |u|. Takes what the undamped exact solution takes: C = 0, at most one
    contact, Harmonic and Constant time functions; raises InputError otherwise, SolverFailure where
    even ``MAX_DIGITS`` do not suffice.
    """
    refuse(system)
    if system.damped or len(system.contacts) > 1:
        value = "damping" if system.damped else f"{len(system.contacts)} contacts"
        raise InputError("system", value, "be undamped with at most one contact", "use method='exact'")
    if digits != "auto" and (isinstance(digits, bool) or not isinstance(digits, int) or not 20 <= digits <= MAX_DIGITS):
        raise InputError("digits", digits, f"be 'auto' or an integer from 20 to {MAX_DIGITS}")
    begun = time.perf_counter()
    wanted = _estimate(system, t_end) if digits == "auto" else int(digits)
    previous: Reference | None = None
    while True:
        if wanted > MAX_DIGITS:
            raise SolverFailure("multiprecision", t_end, f"{wanted} digits are not enough", "shorten t_end")
        notes: dict[str, Any] = {"digits": wanted, "python-flint": flint.__version__}
        run = reference_of(system, _march(system, t_end, wanted), t_end, t_eval, begun, "multiprecision", notes)
        if previous is not None:
            horizon = _agreement(previous, run)
            if horizon >= t_end or digits != "auto":
                notes = {
                    "digits_confirmed_with": previous.provenance["digits"],
                    "horizon": horizon,
                    "horizon_against": f"itself with {previous.provenance['digits']} digits",
                    "horizon_tolerance": f"|du| <= {AGREEMENT:g} max|u|, the same switches",
                }
                return replace(run, horizon=horizon, provenance=run.provenance | notes)
        previous = run
        wanted = math.ceil(1.25 * wanted) + 15


def _estimate(system: System, t_end: float) -> int:
    """Digits for t_end: float64 starts with sixteen and has three left at its horizon."""
    short = with_horizon(solve_exact(system, t_end), system, t_end)
    rate = 13.0 / short.horizon
    return 30 + (math.ceil(1.1 * rate * t_end) if short.horizon < t_end else 0)


def _agreement(a: Reference, b: Reference) -> float:
    """The time to which two precisions agree in every switch and in the displacement."""
    x, y = a.solution, b.solution
    n = min(len(x.times), len(y.times))
    apart = (x.regime[:n] != y.regime[:n]) | (np.abs(x.times[:n] - y.times[:n]) > 1e-12 * (1.0 + y.times[:n]))
    end = float(b.provenance["t_end"])
    if np.any(apart):
        end = float(min(x.times[np.argmax(apart)], y.times[np.argmax(apart)]))
    elif len(x.times) != len(y.times):
        end = float((x if len(x.times) > n else y).times[n])
    scale = float(np.max(np.abs(b.tip)))
    wrong = np.flatnonzero(~(np.abs(a.tip - b.tip) <= AGREEMENT * scale) & (b.t <= end))
    return min(end, float(b.t[max(0, wrong[0] - 1)])) if len(wrong) else end


def _march(system: System, t_end: float, digits: int) -> Solution:
    """Follow the solution; precision falls linearly from ``digits`` to what the outputs need."""
    before = ctx.prec
    full = math.ceil(digits * BITS) + GUARD_BITS
    try:
        ctx.prec = full + 80  # cancellation in the eigenproblem: (w_max/w_1)^2 and some
        drive = Drive.of(system)
        problem = exact_problem(system, drive)
        frequencies = [arb(f) for f in drive.frequencies]
        regimes: dict[int, PreciseRegime] = {}
        for side in (0, 1, -1) if system.contacts else (0,):
            regimes[side] = precise_regime(system, problem, drive, frequencies, side, regimes.get(1))
        cross = None
        if 1 in regimes:
            cross = regimes[0].shapes.transpose() * problem.mass * regimes[1].shapes  # eta_free = cross eta_contact
        return _follow(system, t_end, full, drive, problem, frequencies, regimes, cross)
    finally:
        ctx.prec = before


def _follow(
    system: System, t_end: float, full: int, drive: Drive, problem: Exact, frequencies: list[Any],
    regimes: dict[int, PreciseRegime], cross: Any,
) -> Solution:  # fmt: skip
    n = system.size
    rounded = {side: rounded_regime(regime, drive, problem) for side, regime in regimes.items()}
    bases = {side: rounded_modes(regime, system) for side, regime in regimes.items()}
    stops = system.contacts[0].stops if system.contacts else None
    args = search_arguments(rounded, double(cross) if cross is not None else np.eye(n), drive, stops)
    mass_shapes = problem.mass * regimes[0].shapes
    eta, rate = ((arb_mat([values]) * mass_shapes).tolist()[0] for values in (problem.q0, problem.v0))
    t, side = arb(0), 0
    g, g_rate = _coefficients(frequencies, t)
    if stops is not None:
        u0 = dot(regimes[0].row, eta) + dot(problem.offset, g)
        side = int(stops.state(float(u0)))
        if side:
            eta, rate = _change(cross, eta, rate, to_contact=True)
    h, h_rate = _homogeneous(regimes[side], eta, rate, g, g_rate)
    times, sides, hs, rates, evaluations = [0.0], [side], [h], [h_rate], 0
    out_t, out_side, out_h = np.empty(1), np.empty(1, np.int64), np.empty((1, n))
    at_switch = False
    while True:
        ctx.prec = max(GUARD_BITS + 30, math.ceil(full - (full - GUARD_BITS) * min(1.0, float(t) / t_end)) + 30)
        start = float(t)
        count, used = follow(
            np.array([float(x) for x in h]), np.array([float(x) for x in h_rate]), side, start, t_end, at_switch,
            *args, out_t, out_side, out_h, out_h.copy(),
        )  # fmt: skip
        evaluations += used
        if not count:
            break
        tau = arb(float(out_t[0])) - t
        stop = _stop(problem, side, int(out_side[0]))
        tau = _newton(regimes[side], problem, frequencies, h, h_rate, t, tau, stop)
        eta, rate, g, g_rate, shift = _advance(regimes[side], problem, frequencies, h, h_rate, t, tau, stop)
        t = (t + tau + shift).mid()
        new = int(out_side[0])
        eta, rate = _change(cross, eta, rate, to_contact=side == 0)
        h, h_rate = _homogeneous(regimes[new], eta, rate, g, g_rate)
        side, at_switch = new, True
        times.append(float(t))
        sides.append(side)
        hs.append(h)
        rates.append(h_rate)
    return Solution(
        drive=drive,
        bases=bases,
        regimes=rounded,
        times=np.array(times),
        regime=np.array(sides, np.int64),
        h=np.array([[float(x) for x in h] for h in hs]),
        rate=np.array([[float(x) for x in r] for r in rates]),
        evaluations=evaluations,
    )


def _stop(problem: Exact, side: int, new: int) -> Any:
    """The position at which the contact switches between ``side`` and ``new``."""
    assert problem.stops is not None
    return problem.stops[2] if (side or new) > 0 else problem.stops[1]


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
    """The homogeneous part and its rate at tau: h cos + h'/w sin + level (1 - cos)/w^2."""
    q, v = [], []
    for w, w2, x, y, level in zip(regime.omega, regime.squares, h, h_rate, regime.level, strict=True):
        s, c = (w * tau).sin_cos()
        rest = level / w2
        q.append((x - rest) * c + y * s / w + rest)
        v.append(y * c - (x - rest) * w * s)
    return q, v


def _newton(
    regime: PreciseRegime, problem: Exact, frequencies: list, h: list, h_rate: list, t: Any, tau: Any, stop: Any
) -> Any:
    """Sharpen the switching time from float64 to half the current precision, doubling it at each turn."""
    full, accurate = ctx.prec, 28  # bits: what float64 knows of a time between two switches
    try:
        while accurate < full // 2:
            accurate = 2 * accurate - 8  # the ratio of gap'' to gap' costs a few bits at each turn
            ctx.prec = min(full, accurate + 70)
            gap, speed = _gap(regime, problem, frequencies, *_oscillators(regime, h, h_rate, tau), t + tau, stop)
            tau = (tau - gap / speed).mid()
    finally:
        ctx.prec = full
    return tau


def _gap(
    regime: PreciseRegime, problem: Exact, frequencies: list, q: list, v: list, t: Any, stop: Any
) -> tuple[Any, Any]:
    """u - stop and u' at time t, with the homogeneous parts q and rates v there."""
    g, g_rate = _coefficients(frequencies, t)
    drive = _drive_row(regime, problem)
    u = dot(regime.row, q) + dot(drive, g) - stop
    speed = dot(regime.row, v) + dot(drive, g_rate)
    return u.mid(), speed.mid()


def _drive_row(regime: PreciseRegime, problem: Exact) -> list[Any]:
    """row P + offset, (d,)."""
    total = list(problem.offset)
    for row, p in zip(regime.row, regime.particular, strict=True):
        total = [a + row * b for a, b in zip(total, p, strict=True)]
    return total


def _advance(
    regime: PreciseRegime, problem: Exact, frequencies: list, h: list, h_rate: list, t: Any, tau: Any, stop: Any
) -> tuple[list, list, list, list, Any]:
    """eta, eta' and g, g' at the switch: one full evaluation at tau, then a Taylor step of the last half
    of the digits, shift = -gap/u'."""
    q, v = _oscillators(regime, h, h_rate, tau)
    gap, speed = _gap(regime, problem, frequencies, q, v, t + tau, stop)
    shift = (-gap / speed).mid()
    half = shift * shift / 2
    eta, rate = [], []
    g_new, g_rate_new = _coefficients(frequencies, t + tau + shift)
    for j in range(len(q)):
        acceleration = regime.level[j] - regime.squares[j] * q[j]
        jerk = -regime.squares[j] * v[j]
        p = regime.particular[j]
        eta.append(q[j] + shift * v[j] + half * acceleration + dot(p, g_new))
        rate.append(v[j] + shift * acceleration + half * jerk + dot(p, g_rate_new))
    return eta, rate, g_new, g_rate_new, shift


def _change(cross: Any, eta: list, rate: list, to_contact: bool) -> tuple[list, list]:
    """Between the modes of the free and of the contact state."""
    columns = arb_mat([[a, b] for a, b in zip(eta, rate, strict=True)]).mid()
    both = ((cross.transpose() if to_contact else cross) * columns).tolist()
    return [line[0].mid() for line in both], [line[1].mid() for line in both]
