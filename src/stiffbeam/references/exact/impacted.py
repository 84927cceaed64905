"""A motion with rigid stops as stretches between events: what ``impacting.Tracer`` finds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...basics.arrays import Array
from .taylor import Model


@dataclass(eq=False)
class Event:
    """An impact on ``side`` of a contact; ``end`` > ``time`` where the contact is then held."""

    contact: int
    side: int
    time: float
    impulse: float
    end: float = math.nan


@dataclass(eq=False)
class Solution:
    """Stretches from times (k,) on, with states and the contacts held in each; what impacts took."""

    model: Model
    times: list[float] = field(default_factory=list)
    states: list[tuple[Array, Array]] = field(default_factory=list)
    held: list[tuple[int, ...]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    struck: list[tuple[float, int, float]] = field(default_factory=list)  # time, contact, impulse that is no event's
    blows: list[tuple[int, int]] = field(default_factory=list)  # stretch at whose start it is, contact
    taken: list[tuple[float, float, float]] = field(default_factory=list)  # time, energy taken, put in by stops moving
    stuck: list[tuple[float, int]] = field(default_factory=list)  # where a contact's impacts ended, and which
    tie: float = math.inf  # where two contacts first close together but for rounding, and the order matters

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """q, q' (k, n) and reactions (k, m), of held contacts only, at times in any order."""
        t = np.asarray(t, float)
        q, v = np.empty((2, len(t), self.model.system.size))
        R = np.zeros((len(t), len(self.model.rows)))
        piece = self.stretch_at(t)
        for k in np.unique(piece):
            here = np.flatnonzero(piece == k)
            start, moving = self.states[k]
            c, reactions = self.model.stretch(self.times[k], start, moving, self.held[k])
            powers = (t[here] - self.times[k])[:, None] ** np.arange(len(c))
            q[here] = powers @ c
            v[here] = powers[:, :-1] @ (np.arange(1, len(c))[:, None] * c[1:])
            if len(self.held[k]):
                R[here[:, None], list(self.held[k])] = powers[:, : len(reactions)] @ reactions
        return q, v, R

    def stretch_at(self, t: Array) -> NDArray[np.int64]:
        """The stretch that each time (k,) lies in; a switch belongs to the one it begins."""
        return np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)

    def is_held(self, t: Array, contact: int) -> NDArray[np.bool_]:
        """Whether the contact is held at times t (k,)."""
        return np.array([contact in held for held in self.held])[self.stretch_at(t)]
