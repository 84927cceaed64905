"""Rigid stops at t = 0: which contacts are on theirs, and which of these as they are written, not but for rounding."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from ...basics.arrays import Array
from ...basics.exact_float import exact_value
from ...basics.validation import InputError
from .taylor import Model

LEFT = 1e-12  # of the distance between a stop and a start, relative: the start is on the stop


def on_stops(model: Model) -> dict[int, int]:
    """The contacts on their stops at t = 0, by their sides. Raises InputError for one beyond its stop."""
    closed = {}
    for contact, each in enumerate(model.system.contacts):
        moved = float(model.shift(contact, 0.0)[0])
        u = float(model.rows[contact] @ model.system.q0) + moved
        for side, g in ((1, each.stops.upper_bound), (-1, each.stops.lower_bound)):
            if math.isfinite(g) and side * (u - g) >= -LEFT * max(abs(g), abs(moved)):
                if side * (u - g) > LEFT * max(abs(g), abs(moved)):
                    remedy = "move the stop or the start"
                    raise InputError("initial displacement", u, "lie between rigid stops", remedy)
                closed[contact] = side
    return closed


def off_stop(model: Model, contact: int, side: int) -> bool:
    """Whether the start, as it is written, is not exactly on the stop of a contact."""
    each = model.system.contacts[contact]
    ratio, pi = exact_value(each.stops.upper if side > 0 else each.stops.lower)  # type: ignore[arg-type]
    terms = zip(model.rows[contact].tolist(), model.system.q0.tolist(), strict=True)
    shifted = model.shift(contact, 0.0)[0] != 0.0
    return pi or shifted or sum(Fraction(row) * Fraction(q) for row, q in terms) != ratio


def together_but_for_rounding(model: Model, compliance: Array, closed: dict[int, int], going: dict[int, int]) -> bool:
    """Whether contacts that move each other start on their stops but for rounding, so that who is hit first is not
    known."""
    joined = {c for c in closed for x in going if c != x and compliance[c, x]}
    return any(off_stop(model, c, closed[c]) for c in joined | (going.keys() if joined else set()))


def at_rest(model: Model) -> list[int]:
    """Contacts that start at rest on their stops as they are written, not but for rounding."""
    found = []
    for contact, each in enumerate(model.system.contacts):
        still = each.offset is None and not np.any(model.rows[contact] * model.system.v0)
        stops = (1, each.stops.upper_bound), (-1, each.stops.lower_bound)
        if still and any(math.isfinite(g) and not off_stop(model, contact, side) for side, g in stops):
            found.append(contact)
    return found
