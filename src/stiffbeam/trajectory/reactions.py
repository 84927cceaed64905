"""The reactions of a rigid stop in a run, step by step."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array
from ..model.contact import Stops
from .impacts import ContactRecord, Impacts


class Reactions:
    """One contact, fed with the mean reactions R of consecutive steps; the impacts are those after step ``since``.

    An impact is a row of steps with R of one sign: it begins with the first of them and ends with the last. One that
    begins before a contact that is there at t = 0 has opened is part of that contact. A rigid stop has no largest
    force, its impulse is what an impact leaves: peaks are NaN. The largest mean of a step, ``max(abs(force))``, grows
    like 1/dt.
    """

    def __init__(self, stops: Stops, dt: float, u0: float, v0: float, since: int = 0) -> None:
        self.stops, self.dt, self.since = stops, dt, since
        self._fed: list[Array] = []
        self._closed = bool(u0 <= stops.g1 or u0 >= stops.g2)  # since t = 0
        self._last = -1  # the step in which that contact opens

    def feed(self, u: Array, v: Array, means: Array | None = None, found: Array | None = None) -> None:
        """Positions and velocities at the ends of the next steps (k,), and their reactions."""
        assert means is not None
        if self._closed:
            free = np.flatnonzero((u > self.stops.g1) & (u < self.stops.g2))
            self._closed = not len(free)
            self._last += len(u) if self._closed else 1 + int(free[0])
        self._fed.append(np.array(means, float))

    def record(self, position: Array, velocity: Array, every: int) -> ContactRecord:
        """With position, velocity and the reaction of the step before at every ``every``-th step."""
        R = np.concatenate([[0.0], *self._fed])
        force = R[::every][: len(position)]
        R = R[1 + self.since :]
        size = np.abs(R)
        return ContactRecord(
            stops=self.stops,
            position=position,
            velocity=velocity,
            force=force,
            impacts=self._impacts(R),
            fraction=float(np.mean(R != 0.0)) if len(R) else 0.0,
            peak_force=float("nan") if np.any(size) else 0.0,
            impulse=float(np.sum(size) * self.dt),
        )

    def _impacts(self, R: Array) -> Impacts:
        before = np.concatenate([[0.0], *self._fed])[self.since]  # in the last step that does not count
        side = np.concatenate([[np.sign(before)], np.sign(R)])
        enters = np.flatnonzero((side[1:] != 0.0) & (side[1:] != side[:-1]))
        first = enters + self.since <= self._last
        if self.since:
            enters, first = enters[~first], first[~first]
        leaves = np.flatnonzero((side[:-1] != 0.0) & (side[1:] != side[:-1]))
        sizes = np.concatenate([[0.0], np.cumsum(np.abs(R))]) * self.dt
        ends = np.full(len(enters), len(R))
        nearest = np.searchsorted(leaves, enters, side="right")
        found = nearest < len(leaves)
        ends[found] = leaves[nearest[found]]
        start = self.since
        return Impacts.at(
            (start + enters) * self.dt,
            -side[1:][enters],
            "sampled",
            ends=np.where(found, (start + ends) * self.dt, np.nan),
            impulses=np.where(found, sizes[ends] - sizes[enters], np.nan),
        ).started(first)
