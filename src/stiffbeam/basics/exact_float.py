"""Numbers in their written form: a float64 value with the exact number attached, for multiprecision.

0.001 in a case file or in the paper is the decimal 1/1000; the double next to it is another number, and
past the horizon of float64 its problem is another problem.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from decimal import Decimal
from fractions import Fraction
from typing import Any

Exact = str | Fraction | Decimal | int

_DECIMAL = r"(?:\d[\d_]*\.?[\d_]*|\.\d[\d_]*)(?:[eE][+-]?\d+)?"
_FACTOR = rf"(?:pi|{_DECIMAL})"
_PI = Fraction("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")


class ExactFloat(float):
    """The double nearest to ``ratio``, or to ``ratio`` times pi where ``pi`` is true; both differ from it.

    It computes, compares and hashes as that double; what is computed from it is a plain float. ``repr``
    is the text, in quotes, that makes it again. Make one with ``exact_float``.
    """

    __slots__ = ("pi", "ratio")
    ratio: Fraction
    pi: bool

    @property
    def text(self) -> str:
        """The shortest text: '0.001', '1/3', '-3*pi/4'; equal numbers have equal texts."""
        if not self.pi:
            decimal = float.__repr__(self)
            return decimal if Fraction(decimal) == self.ratio else str(self.ratio)
        top, bottom = self.ratio.numerator, self.ratio.denominator
        times = {1: "", -1: "-"}.get(top, f"{top}*")
        return f"{times}pi" + (f"/{bottom}" if bottom > 1 else "")

    def __repr__(self) -> str:
        return repr(self.text)

    def __str__(self) -> str:
        return float.__repr__(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return exact_float, (self.text,)


def exact_float(value: Exact) -> float:
    """``value`` as an ExactFloat, or as a plain float where a double holds it.

    value: a Fraction, Decimal or integer, or a text of decimals and pi joined by * and /, such as
    "0.001", "1/3", "pi/2", "2*pi*50", with pi at most once and not below a /. Raises ValueError for other texts.
    Outside the range of normal doubles it is what float() makes of it.
    """
    ratio, pi = _read(value) if isinstance(value, (str, Decimal)) else (Fraction(value), False)
    if ratio is None:
        return float(value)
    try:
        nearest = float(ratio * _PI if pi else ratio)
    except OverflowError:
        raise ValueError(f"{value!r} is too large for float64") from None
    # A plain float is enough where it is the number itself; with pi it never is.
    if not pi and Fraction(nearest) == ratio:
        return nearest
    number = ExactFloat(nearest)
    number.ratio, number.pi = ratio, pi
    return number


def exact_value(x: float) -> tuple[Fraction, bool]:
    """(ratio, pi): the exact number behind ``x``, ratio times pi where pi is true; of a plain float itself."""
    return (x.ratio, x.pi) if isinstance(x, ExactFloat) else (Fraction(x), False)


def exact_parts(value: Any, name: str = "") -> Iterator[str]:
    """Name and text of every ExactFloat in a dataclass or tuple and in what they hold, in order."""
    if isinstance(value, ExactFloat):
        yield f"{name} = {value.text}"
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from exact_parts(getattr(value, field.name), f"{name}.{field.name}".lstrip("."))
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            yield from exact_parts(item, f"{name}[{i}]")


def as_doubles(value: Any) -> Any:
    """A dataclass or tuple with every ExactFloat in it replaced by the double that it computes as."""
    if isinstance(value, ExactFloat):
        return float(value)
    if isinstance(value, tuple):
        return tuple(map(as_doubles, value))
    # Fields that a class computes by itself are no arguments.
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{f.name: as_doubles(getattr(value, f.name)) for f in fields(value) if f.init})
    return value


def _read(value: str | Decimal) -> tuple[Fraction | None, bool]:
    """(ratio, pi) of a text, (None, False) where it is one number outside the range of normal doubles."""
    text = re.sub(r"\s*([*/])\s*", r"\1", str(value).strip())
    # Infinity and NaN have no ratio.
    if re.fullmatch(r"[+-]?(inf|nan)", text, re.IGNORECASE):
        return None, False
    match = re.fullmatch(rf"([+-]?)({_FACTOR}(?:[*/]{_FACTOR})*)", text)
    if match is None:
        raise ValueError(f"{value!r} is not a number")
    # A product of numbers, and of pi once.
    ratio, pis = Fraction(-1 if match[1] == "-" else 1), 0
    for operation, factor in re.findall(rf"([*/]?)({_FACTOR})", match[2]):
        if factor == "pi":
            pis += -1 if operation == "/" else 1
            continue
        nearest = float(factor)
        if not math.isfinite(nearest) or nearest < 1e-300:  # the Fraction of 1e999999999 fills the memory
            if match[2] == factor:
                return None, False
            raise ValueError(f"{value!r} leaves the range of float64")
        ratio = ratio / Fraction(factor) if operation == "/" else ratio * Fraction(factor)
    # ExactFloat is a ratio or a ratio times pi, nothing else.
    if pis not in (0, 1):
        raise ValueError(f"{value!r} is not a number or a number times pi")
    return ratio, bool(pis)
