"""Normal compliance: the stops' force, their energy, and the stage equation v = r + s F(v)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import Array
from .time_functions import LoadFunction, TimeFunction
from .validation import InputError, number, positive


@dataclass(frozen=True)
class Stops:
    """F(v) = -kappa [(v - g2)_+ - (g1 - v)_+], the force of the stops on the beam (2.4).

    ``lower`` is g1 and ``upper`` is g2 > g1 (displacements); ``None`` leaves that side free.
    ``stiffness`` is kappa > 0, force per displacement. F < 0 on the upper stop, F > 0 on the lower.
    Source: Dumont (2002), eq. (2.4).
    """

    lower: float | None = None
    upper: float | None = None
    stiffness: float = field(kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "stiffness", positive("stops.stiffness", self.stiffness))
        for side in ("lower", "upper"):
            if getattr(self, side) is not None:
                object.__setattr__(self, side, number(f"stops.{side}", getattr(self, side)))
        if self.lower is None and self.upper is None:
            raise InputError("stops", "no side", "have a lower or an upper stop", "for no contact leave stops out")
        if not self.g1 < self.g2:
            raise InputError("stops.upper", self.upper, f"be > stops.lower = {self.lower}")

    @property
    def g1(self) -> float:
        """The lower stop, -inf where that side is free."""
        return -math.inf if self.lower is None else float(self.lower)

    @property
    def g2(self) -> float:
        """The upper stop, +inf where that side is free."""
        return math.inf if self.upper is None else float(self.upper)

    def penetration(self, v: ArrayLike) -> Array:
        """v - clip(v, g1, g2): > 0 into the upper stop, < 0 into the lower, 0 between them."""
        v = np.asarray(v, float)
        return v - np.clip(v, self.g1, self.g2)

    def force(self, v: ArrayLike) -> Array:
        """F(v) on the beam (2.4)."""
        return -self.stiffness * self.penetration(v)

    def energy(self, v: ArrayLike) -> Array:
        """U(v) = kappa/2 [(v - g2)_+^2 + (g1 - v)_+^2], so F = -U'."""
        return 0.5 * self.stiffness * self.penetration(v) ** 2

    def state(self, v: ArrayLike) -> NDArray[np.int64]:
        """chi = +1 where v > g2, -1 where v < g1, else 0 (strict)."""
        v = np.asarray(v, float)
        return (v > self.g2).astype(np.int64) - (v < self.g1).astype(np.int64)

    def solve(self, r: ArrayLike, s: ArrayLike) -> Array:
        """The force F with v = r + s F = r + s F(v), for a compliance s >= 0; one solution, closed form.

        F = kappa/(1 + kappa s) (clip(r, g1, g2) - r). With s = 0 it is the extrapolated contact F(r).
        """
        return -self.stiffness / (1.0 + self.stiffness * np.asarray(s, float)) * self.penetration(r)


@dataclass(frozen=True, eq=False)
class Contact:
    """Stops that act on the position row @ q + offset(t), with the force row^T F(row @ q + offset(t)).

    ``row`` has shape (n,). ``offset`` (a time function or None) moves the contact point against the
    stops, as a moving support does in absolute coordinates.
    """

    row: Array
    stops: Stops
    offset: LoadFunction | None = None

    def __post_init__(self) -> None:
        row = np.array(self.row, float).ravel()
        if not np.all(np.isfinite(row)) or not np.any(row):
            raise InputError("contact.row", self.row, "be finite and not all zero")
        object.__setattr__(self, "row", row)
        if not isinstance(self.stops, Stops):
            raise InputError("contact.stops", self.stops, "be Stops", "for example Stops(upper=0.1, stiffness=1e4)")
        if self.offset is not None and not isinstance(self.offset, TimeFunction) and not callable(self.offset):
            raise InputError("contact.offset", self.offset, "be a function of time", "for example Constant(0.1)")


def solve_several(r: Array, compliance: Array, stops: Sequence[Stops]) -> Array:
    """The forces F with v = r + S F, F_c = F_c(v_c), for m contacts at once.

    r: (m,) positions without contact force; S = ``compliance``: (m, m), symmetric positive
    semidefinite. The forces minimise a strictly convex function, so there is one solution; it is found
    by a finite active-set method (see active_set.solve_node).
    """
    from .active_set import solve_node

    law = (np.array([getattr(stop, name) for stop in stops]) for name in ("stiffness", "g1", "g2"))
    return solve_node(np.ascontiguousarray(r), np.ascontiguousarray(compliance), *law)
