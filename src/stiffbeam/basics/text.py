"""Results as text: messages, plain values for JSON, units, paths to the parts of an object, and pictures by name."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

# Labels of length, time and force, or () where none are given; nothing is converted.
Units = tuple[str, ...]
SI: Units = ("m", "s", "N")


class _Short(reprlib.Repr):
    def __init__(self) -> None:
        super().__init__()
        self.maxlist = self.maxtuple = self.maxdict = self.maxset = 12
        self.maxlevel, self.maxstring, self.maxother = 3, 200, 200

    def repr_instance(self, x: Any, level: int) -> str:
        # NumPy's numbers as plain ones: 1.0, not np.float64(1.0).
        return super().repr_instance(x.item() if isinstance(x, np.generic) else x, level)

    repr_int = repr_instance  # which takes an integer of thousands of digits


def shown(value: Any) -> str:
    """The shortened repr of ``value``; also works for a value whose repr fails."""
    return printable(_Short().repr(value))


def printable(text: str) -> str:
    """``text`` on one line. Terminal control characters are written as their escapes, "\x1b"."""
    # ascii() writes what cannot be printed as an escape, in quotes that are cut off.
    return "".join(x if x.isprintable() else ascii(x)[1:-1] for x in " ".join(text.split()))


def several(count: int, noun: str) -> str:
    """A number of things: "1 contact", "2 contacts"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def plain(value: Any) -> Any:
    """``value`` without NumPy's types; JSON has no NaN and no infinity, None stands for them."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def walk(thing: Any, *keys: Any, leaves: tuple[type, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Everything in dataclasses, tuples and lists but not in ``leaves``, with the names and indexes that lead to it."""
    yield keys, thing
    inner: Iterable[tuple[Any, Any]] = ()
    if isinstance(thing, (tuple, list)):
        inner = enumerate(thing)
    elif is_dataclass(thing) and not isinstance(thing, (type, *leaves)):
        inner = ((field.name, getattr(thing, field.name)) for field in fields(thing))
    for key, part in inner:
        yield from walk(part, *keys, key, leaves=leaves)


def path_of(keys: Iterable[Any]) -> str:
    """These names and indexes as Python writes them, "stops[0].upper"."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


UNITS = {  # of quantities, in the units L of length, T of time and F of force
    "length": "L", "time": "T", "force": "F", "velocity": "L/T", "frequency": "rad/T", "rate": "1/T", "impulse": "F T",
    "energy": "F L", "stop stiffness": "F/L", "stop damping": "F T/L", "stop dissipation": "T/L",
    "mass per length": "F T²/L²", "bending stiffness": "F L²", "bending viscosity": "F L² T",
}  # fmt: skip


def unit_of(units: Units, quantity: str) -> str:
    """The unit of a quantity, "" where it has none: ``unit_of(("m", "s", "N"), "velocity")`` is "m/s"."""
    if not units or not quantity:
        return ""
    length, _, force = units
    if quantity == "energy" and (force, length) in (("N", "m"), ("N m", "rad")):
        return "J"
    if quantity == "mass per length" and units == SI:
        return "kg/m"
    return UNITS[quantity].translate(dict(zip(map(ord, "LTF"), units, strict=True)))


def with_unit(units: Units, text: str, quantity: str) -> str:
    """``text`` with the unit of its quantity behind it, as on an axis: "time $t$ (s)"."""
    unit = unit_of(units, quantity)
    return f"{text} ({unit})" if unit else text


DRAW: dict[str, Callable[..., Any]] = {}  # by name: "run", "comparison", "film"
