"""The contacts of a fixed-step run, as records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..basics.arrays import Array
from ..model.contact import Stops
from ..model.system import System
from ..model.time_functions import offset_rate, offset_values
from .impacts import ContactRecord, Impacts
from .sampling import (
    END,
    EVENT,
    IMPACT_IMPULSE,
    IMPACT_PEAK,
    IMPULSE,
    PEAK,
    ROW,
    SIDE,
    SINCE,
    STOP,
    TIME,
    TOUCHING,
    new_tally,
    observe,
)

Motion = tuple[float, float]  # u and u' at a time


def impacts_of(events: Array) -> Impacts:
    """Rows of a list of events as sampled impacts."""
    columns = (events[:, column].copy() for column in (TIME, END, STOP, IMPACT_PEAK, IMPACT_IMPULSE))
    times, ends, stops, peaks, impulses = columns
    return Impacts(times=times, ends=ends, stops=stops.astype(np.int64), peaks=peaks, impulses=impulses, kind="sampled")


def with_ends(tally: Array, stops: Stops, dt: float, first: Motion, last: Motion, means: bool) -> Array:
    """The tally of steps 1 to n as that of a whole run, with (u, u') at t = 0 and at the last step: the largest force
    may be that at the start, and the impulse is the trapezoidal rule's, but of means. One that begins later stays."""
    if tally[SINCE]:
        return tally
    with np.errstate(over="ignore", invalid="ignore"):
        begin, end = (float(abs(stops.force(*motion))) for motion in (first, last))
        tally = tally.copy()
        tally[PEAK] = max(begin, tally[PEAK])
        tally[IMPULSE] += 0.0 if means else 0.5 * dt * (begin - end)
    return tally


def record(stops: Stops, position: Array, velocity: Array, tally: Array, events: Array, steps: int) -> ContactRecord:
    """With position and velocity at the output times; ``steps`` of the whole run."""
    with np.errstate(over="ignore", invalid="ignore"):  # of which ``overflow`` tells
        force = stops.force(position, velocity)
    return ContactRecord(
        stops=stops,
        position=position,
        velocity=velocity,
        force=force,
        impacts=impacts_of(events),
        fraction=float(tally[TOUCHING]) / max(1, steps - int(tally[SINCE])),
        peak_force=float(tally[PEAK]),
        impulse=float(tally[IMPULSE]),
    )


def overflow(contacts: Sequence[ContactRecord], t_end: float) -> float:
    """When a force overflowed though no position did: at the first impact whose impulse is beyond float64, or at the
    latest at t_end; NaN where none did."""
    if all(np.isfinite(contact.impulse) for contact in contacts):
        return float("nan")
    return min((float(t) for c in contacts for t in c.impacts.times[np.isinf(c.impacts.impulses)]), default=t_end)


@dataclass(frozen=True, eq=False)
class Seen:
    """The record of one run: tip and tip velocity at the output times, its contacts, when it overflowed, how it was
    marched."""

    tip: Array
    tip_velocity: Array
    contacts: tuple[ContactRecord, ...]
    diverged: float = float("nan")
    march: str = ""


class SampledImpacts:
    """The sampled impacts of one contact after step ``since``, fed with consecutive pieces of positions."""

    def __init__(self, stops: Stops, dt: float, u0: float, v0: float, since: int = 0) -> None:
        self.stops, self.dt, self.steps = stops, dt, 0
        self._first, self._means = (u0, v0), False
        self._last = np.array([[u0]]), np.array([[v0]])
        self._tally = new_tally(*self._last, stops.law, since)
        self._events, self._rows = np.empty((64, EVENT)), 0

    def feed(self, u: Array, v: Array, means: Array | None = None) -> None:
        """Positions u and velocities v at the ends of the next steps, (k,), and the reactions where they are means."""
        self._means = means is not None
        reactions = np.zeros((0, 0, 0)) if means is None else np.array(means, float).reshape(1, -1, 1)
        if self._rows + len(u) > len(self._events):
            self._events = np.concatenate([self._events, np.empty((len(self._events) + len(u), EVENT))])
        u, v = (np.array(x, float).reshape(1, -1, 1) for x in (u, v))
        law = self.stops.law[None, None]
        never = np.zeros(1, np.int64)
        self._rows = observe(
            u, v, reactions, law, self.dt, self.steps, *self._last, self._tally, never, self._events, self._rows
        )
        self.steps += u.shape[1]

    @property
    def tally(self) -> Array:
        """What has been counted so far at this contact, a row laid out as in sampling."""
        last = float(self._last[0][0, 0]), float(self._last[1][0, 0])
        return with_ends(self._tally[0, 0], self.stops, self.dt, self._first, last, self._means)

    @property
    def events(self) -> Array:
        """The list of impacts so far, the open one without peak and impulse."""
        events = self._events[: self._rows].copy()
        if self.tally[SIDE] and self.tally[ROW] >= 0:
            events[int(self.tally[ROW]), [IMPACT_PEAK, IMPACT_IMPULSE, END]] = np.nan
        return events


def sampled_impacts(u: Array, v: Array, dt: float, stops: Stops) -> Impacts:
    """The sampled impacts in positions u_0..u_n with velocities v_0..v_n."""
    sampler = SampledImpacts(stops, dt, float(u[0]), float(v[0]))
    sampler.feed(u[1:], v[1:])
    return impacts_of(sampler.events)


def as_it_starts(system: System, channel: int, t: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """u and v of a channel at the times t with what is given at t = 0: on a stop, rounding would tell the side. The
    velocity of rigid stops is left, which a blow may have turned."""
    begins = t == 0.0
    if not np.any(begins):
        return u, v
    row, offset = system.channels[channel]
    u = np.where(begins, row @ system.q0 + offset_values(offset, 0.0), u)
    if not any(contact.stops.rigid for contact in system.contacts):
        v = np.where(begins, row @ system.v0 + offset_rate(offset, 0.0), v)
    return u, v
