"""Outputs and impacts of a fixed-step run, accumulated piece by piece in bounded memory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .arrays import Array
from .contact import Stops
from .kernel import crossing_times, scan
from .trajectory import ContactRecord, Impacts


class SampledImpacts:
    """The sampled impacts of one contact, fed with consecutive stretches of positions."""

    def __init__(self, stops: Stops, dt: float, u0: float) -> None:
        self.stops, self.dt, self.last, self.first_step = stops, dt, u0, 0
        self.chi = int(stops.state(u0))
        self.times: list[float] = []
        self.sides: list[int] = []
        self.peaks: list[float] = []
        self.impulses: list[float] = []
        self.peak, self.impulse, self.touching = 0.0, 0.0, 0

    def feed(self, u: Array, velocity: Callable[[NDArray[np.int64]], Array]) -> None:
        """The positions u of the next steps; ``velocity(k)`` gives u' after k of them, k = 0 the last known."""
        path = np.concatenate([[self.last], u])
        steps, sides = np.zeros(len(path), np.int64), np.zeros(len(path), np.int64)
        peaks, impulses = np.zeros(len(path)), np.zeros(len(path))
        g1, g2 = self.stops.g1, self.stops.g2
        count, touching, self.chi = scan(
            path, g1, g2, self.stops.stiffness, self.dt, self.chi, steps, sides, peaks, impulses
        )
        self.touching += touching
        if self.peaks:
            self.peaks[-1] = max(self.peaks[-1], peaks[0])
            self.impulses[-1] += impulses[0]
        self.peak = max(self.peak, float(np.max(peaks[: count + 1])))
        self.impulse += float(np.sum(impulses[: count + 1]))
        if count:
            k, stops, inside = steps[1 : count + 1], sides[1 : count + 1], np.empty(count)
            crossing_times(path, velocity(k - 1), velocity(k), k, stops, g1, g2, self.dt, inside)
            self.times += ((self.first_step + inside) * self.dt).tolist()
            self.sides += stops.tolist()
            self.peaks += peaks[1 : count + 1].tolist()
            self.impulses += impulses[1 : count + 1].tolist()
        self.last = float(u[-1])
        self.first_step += len(u)

    def impacts(self) -> Impacts:
        peaks, impulses = np.array(self.peaks), np.array(self.impulses)
        if self.chi and len(peaks):
            peaks[-1] = impulses[-1] = np.nan  # still open
        return Impacts(np.array(self.times), np.array(self.sides, np.int64), peaks, impulses, "sampled")

    def record(self, position: Array, velocity: Array) -> ContactRecord:
        """With position and velocity at the output times."""
        return ContactRecord(
            stops=self.stops,
            position=position,
            velocity=velocity,
            force=self.stops.force(position),
            impacts=self.impacts(),
            fraction=self.touching / max(1, self.first_step),
            peak_force=self.peak,
            impulse=self.impulse,
        )


def sampled_impacts(u: Array, v: Array, dt: float, stops: Stops) -> Impacts:
    """The sampled impacts in positions u_0..u_n with velocities v_0..v_n."""
    sampler = SampledImpacts(stops, dt, float(u[0]))
    sampler.feed(u[1:], lambda k: v[k])
    return sampler.impacts()
