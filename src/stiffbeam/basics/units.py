"""The names of the units that a problem is written in. Labels only: nothing is ever converted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .validation import InputError

CYCLES = {"s": "Hz", "ms": "kHz", "µs": "MHz", "us": "MHz", "ns": "GHz"}  # one period in each unit of time
ONE = "1"  # the unit of a number without dimension, as netCDF writes it
KNOWN = {
    "length": ("m", "mm", "cm", "dm", "km", "µm", "um", "nm", "in", "ft", "yd", "rad", ONE, "?"),
    "time": ("s", "ms", "µs", "us", "ns", "min", "h", ONE, "?"),
    "force": (
        "N", "mN", "µN", "uN", "kN", "MN", "dyn", "gf", "kgf", "tf", "lbf", "kip", "N m", "mN m", "kN m", ONE, "?",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Units:
    """Units of lengths, times and forces; every other unit follows from these three.

    A beam is integrated in its own units: u is in ``length``, t in ``time``, sigma in ``force`` and an energy in force
    times length. A mass is in force time^2/length: kg for metres, tonnes for millimetres, seconds and newtons.

    Parameters
    ----------
    length, time, force : str
        Such as "mm", "ms" and "kN"; for rotations "rad", "s" and "N m"; "1" is no dimension.

    Raises
    ------
    InputError
        For any other name; the message lists them all.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.Units(length="mm").length
    'mm'
    """

    length: str = "m"
    time: str = "s"
    force: str = "N"

    def __post_init__(self) -> None:
        for field in ("length", "time", "force"):
            name = getattr(self, field)
            if not isinstance(name, str) or name not in KNOWN[field]:
                known = [x for x in KNOWN[field] if x not in (ONE, "?")]
                raise InputError(
                    f"units.{field}", name, f"be the name of a unit of {field}", f"one of {', '.join(known)}"
                )

    @cached_property
    def _names(self) -> dict[str, str]:
        L, T, F = self.length, self.time, self.force
        return {
            "length": L,
            "time": T,
            "force": F,
            "velocity": f"{L}/{T}",
            "frequency": f"rad/{T}",
            "cyclic frequency": CYCLES.get(T, f"1/{T}"),
            "rate": f"1/{T}",
            "stop stiffness": f"{F}/{L}",
            "stop damping": f"{F} {T}/{L}",
            "stop dissipation": f"{T}/{L}",
            "impulse": f"{F} {T}",
            "energy": "J" if (F, L) in (("N", "m"), ("N m", "rad")) else f"{F} {L}",
            "force per length": f"{F}/{L}",
            "mass per length": "kg/m" if (L, T, F) == ("m", "s", "N") else f"{F} {T}²/{L}²",
            "bending stiffness": f"{F} {L}²",
            "bending viscosity": f"{F} {L}² {T}",
        }

    def of(self, quantity: str) -> str:
        """The unit of a quantity, "" where it has none and for the quantity "": ``of("velocity")`` is "m/s"."""
        return self._names[quantity] if self.known and quantity else ""

    def label(self, text: str, quantity: str) -> str:
        """``text`` with the unit of its quantity behind it, as on an axis: "time $t$ (s)"."""
        unit = self.of(quantity)
        return f"{text} ({unit})" if unit else text

    def measure(self, value: str | float, quantity: str, form: str = "") -> str:
        """A number with its unit, as in a sentence: ``measure(70.21, "force", ".3g")`` is "70.2 N"."""
        unit = self.of(quantity)
        return f"{value:{form}} {unit}" if unit else f"{value:{form}}"

    def __str__(self) -> str:
        return self.note or f"{self.length}, {self.time}, {self.force}"

    @property
    def known(self) -> bool:
        """Return True if the units of the quantities have names."""
        return self not in (NON_DIMENSIONAL, UNKNOWN)

    def cycles(self, omega: ArrayLike) -> tuple[Array, str, str]:
        """An axis of frequencies: values, label and quantity for ``of``; angular where there is no unit of time."""
        values = np.asarray(omega, float)
        if not self.known:
            return values, r"angular frequency $\omega$", "frequency"
        return values / (2.0 * np.pi), "frequency", "cyclic frequency"

    @property
    def note(self) -> str:
        """Note for tables whose numbers have no units; "" if every number has its own."""
        return {NON_DIMENSIONAL: "non-dimensional", UNKNOWN: "in the units of the matrices"}.get(self, "")


SI = Units()
NON_DIMENSIONAL = Units(ONE, ONE, ONE)
UNKNOWN = Units("?", "?", "?")  # of matrices that somebody else made
