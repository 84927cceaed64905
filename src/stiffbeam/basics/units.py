"""Labels of units on axes, in tables and in files: (length, time, force), or () where none are given."""

from __future__ import annotations

from typing import Any

from .validation import InputError

Units = tuple[str, ...]  # nothing but the times of a record is converted
SI: Units = ("m", "s", "N")
MOST = 20  # letters of a label


def units_labels(units: Any) -> Units:
    """``units`` as a tuple. Raises InputError unless it is empty or three short texts."""
    names = list(units) if isinstance(units, (tuple, list)) else [""]
    if len(names) in (0, 3) and all(isinstance(x, str) and 0 < len(x) <= MOST and x.isprintable() for x in names):
        return tuple(names)
    rule = "be the names of the units of length, time and force"
    raise InputError("units", units, rule, 'for example ("mm", "s", "N"), and ("rad", "s", "N m") for rotations')


def unit_of(units: Units, quantity: str) -> str:
    """The unit of a quantity, "" where it has none: ``unit_of(("m", "s", "N"), "velocity")`` is "m/s"."""
    if not units or not quantity:
        return ""
    L, T, F = units
    return {
        "length": L,
        "time": T,
        "force": F,
        "velocity": f"{L}/{T}",
        "frequency": f"rad/{T}",
        "rate": f"1/{T}",
        "stop stiffness": f"{F}/{L}",
        "stop damping": f"{F} {T}/{L}",
        "stop dissipation": f"{T}/{L}",
        "impulse": f"{F} {T}",
        "energy": "J" if (F, L) in (("N", "m"), ("N m", "rad")) else f"{F} {L}",
        "power": f"{F} {L}/{T}",
        "force per length": f"{F}/{L}",
        "mass per length": "kg/m" if units == SI else f"{F} {T}²/{L}²",
        "bending stiffness": f"{F} {L}²",
        "bending viscosity": f"{F} {L}² {T}",
    }[quantity]


def with_unit(units: Units, text: str, quantity: str) -> str:
    """``text`` with the unit of its quantity behind it, as on an axis: "time $t$ (s)"."""
    unit = unit_of(units, quantity)
    return f"{text} ({unit})" if unit else text
