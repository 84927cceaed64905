"""What the adaptive solvers share: from states at the output times to a Reference."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..contact import Stops
from ..first_order import FirstOrderSystem
from ..ledger import step_ledger
from ..sampling import first_crossing
from ..system import System
from ..trajectory import ContactRecord, Impacts, Reference, Work, output_index, versions
from ..validation import InputError, positive
from .rhs import RightHandSide

LEAST_RTOL = 100.0 * float(np.finfo(float).eps)  # below it steps shrink without end instead of failing


class Solve(NamedTuple):
    """y (k, m) at the output times; events (time, index into rhs.sides) or None; counters; seconds of
    solving, and of compiling, apart."""

    y: Array
    events: list[tuple[float, int]] | None
    counters: dict[str, int]
    seconds: float
    compile_seconds: float = 0.0


def reference_from(
    system: System,
    t_end: float,
    t_eval: Array | None,
    rtol: float,
    atol: float | None,
    method: str,
    libraries: dict[str, str],
    solve: Callable[[RightHandSide, Array, float, float], Solve],
    first_order: FirstOrderSystem | None = None,
) -> Reference:
    """Run ``solve`` on the first-order system (its own unless given) and wrap its output.

    A solver without event detection leaves ``events`` None: its impacts are the sampled ones at the
    output times. atol defaults to rtol/100 for every component. Share of time in contact, peak force, impulse and
    the energy ledger are taken at the output times.
    """
    positive("t_end", t_end)
    rtol = positive("rtol", rtol)
    if rtol < LEAST_RTOL:
        raise InputError("rtol", rtol, f"be at least {LEAST_RTOL:.2g} in float64", "use method='multiprecision'")
    atol = rtol / 100.0 if atol is None else positive("atol", atol)
    t = output_times(t_eval, t_end)
    begun = time.perf_counter()
    rhs = RightHandSide(first_order or system.first_order())
    # A two-point span makes some solvers store every step: there is always a point in between.
    grid = np.unique(np.concatenate([[0.0, 0.5 * t_end, t_end], t]))
    result = solve(rhs, grid, rtol, atol)
    kept = np.searchsorted(grid, t)
    y = result.y[kept]
    positions, velocities = rhs.channels(t, y)
    tip = system.tip_channel
    states = (y @ rhs.first_order.to_q.T, y @ rhs.first_order.to_v.T)

    return Reference(
        t=t,
        tip=positions[:, tip],
        tip_velocity=velocities[:, tip],
        contacts=tuple(
            _record(system, i, t, positions[:, i], velocities[:, i], result.events, rhs.sides)
            for i in range(len(system.contacts))
        ),
        work=Work(
            steps=0,
            seconds=time.perf_counter() - begun - result.compile_seconds,
            march_seconds=result.seconds,
            counters=result.counters,
        ),
        provenance={
            "method": method,
            "form": system.form,
            "t_end": float(t_end),
            "rtol": rtol,
            "atol": atol,
            **({"compile_seconds": result.compile_seconds} if result.compile_seconds else {}),
            **versions(),
            **libraries,
        },
        system=system,
        fingerprint=system.fingerprint,
        evaluate=lambda times, channel: tuple(  # type: ignore[return-value]
            x[output_index(t, times, method), channel] for x in (positions, velocities)
        ),
        state_at=lambda times: tuple(s[output_index(t, times, method)] for s in states),  # type: ignore[return-value]
        ledger=lambda: step_ledger(system, iter([(t, *states)]), t),
    )


def output_times(t_eval: Array | None, t_end: float) -> Array:
    """t_eval, checked, or 2001 equidistant times."""
    if t_eval is None:
        return np.linspace(0.0, t_end, 2001)
    t = np.asarray(t_eval, float)
    if t.ndim != 1 or len(t) < 2 or np.any(np.diff(t) <= 0.0) or t[0] < 0.0 or t[-1] > t_end * (1 + 1e-12):
        raise InputError("t_eval", t, f"be two or more increasing times in [0, {t_end:g}]")
    return np.minimum(t, t_end)


def _record(
    system: System,
    i: int,
    t: Array,
    position: Array,
    velocity: Array,
    events: list[tuple[float, int]] | None,
    sides: list[tuple[int, int]],
) -> ContactRecord:
    stops = system.contacts[i].stops
    if events is None:
        mine, kind = _crossings(t, position, velocity, stops), "sampled"
    else:
        mine, kind = [(when, sides[k][1]) for when, k in events if sides[k][0] == i], "event"
    force = stops.force(position)
    unknown = np.full(len(mine), np.nan)
    return ContactRecord(
        stops=stops,
        position=position,
        velocity=velocity,
        force=force,
        impacts=Impacts(
            np.array([when for when, _ in mine]),
            np.array([side for _, side in mine], np.int64),
            unknown,
            unknown,
            kind,
        ),
        fraction=float(np.mean(stops.state(position) != 0)),
        peak_force=float(np.max(np.abs(force))),
        impulse=float(np.trapezoid(np.abs(force), t)),
    )


def _crossings(t: Array, u: Array, v: Array, stops: Stops) -> list[tuple[float, int]]:
    """The sampled impacts at output times that need not be equidistant."""
    chi = stops.state(u)
    found = []
    for k in np.flatnonzero((chi[1:] != 0) & (chi[1:] != chi[:-1])) + 1:
        side, length = int(chi[k]), t[k] - t[k - 1]
        stop = stops.g2 if side > 0 else stops.g1
        gap = side * (stop - u[k - 1 : k + 1])
        s = first_crossing(gap[0], -side * v[k - 1] * length, gap[1], -side * v[k] * length)
        found.append((float(t[k - 1] + s * length), side))
    return found
