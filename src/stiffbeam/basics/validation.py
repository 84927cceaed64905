"""Arguments of callers: the error for invalid input, the checks that raise it, and exact numbers.

An exact number is a float64 value with the number as it was written, for multiprecision: 0.001 in a case file or in the
paper is the decimal 1/1000. The double next to it is another number, and past the horizon of float64 its problem is
another problem.
"""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields, is_dataclass
from decimal import Decimal
from difflib import get_close_matches
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from .arrays import Array, is_read_only, read_only
from .text import Units, path_of, printable, shown, walk

Known = TypeVar("Known")
Rng = int | np.random.Generator | np.random.BitGenerator | np.random.SeedSequence | None
MOST = 2**53  # integers up to here are floats as well
LEAST = 1e-300  # of exact numbers: smaller ones are plain floats


class InputError(ValueError):
    """Bad input: ``field`` must obey ``rule`` but is ``value``; ``remedy`` proposes a fix.

    A ValueError. The message is one line, in which a long value is shortened.

    Parameters
    ----------
    field : str
        Name of the argument, option or entry of a file.
    value : object
    rule, remedy : str

    Examples
    --------
    >>> import stiffbeam as sb
    >>> try:
    ...     sb.HHT(alpha=0.1)
    ... except sb.InputError as error:
    ...     print(error.field)
    alpha
    """

    def __init__(self, field: str, value: Any, rule: str, remedy: str) -> None:
        value = float(value) if isinstance(value, ExactFloat) else value
        self.field, self.value, self.rule, self.remedy = field, value, rule, remedy
        super().__init__(printable(f"{field} must {rule}, got {shown(value)}: {remedy}"))

    def __reduce__(self) -> tuple[Any, ...]:
        """Arguments to rebuild the error in another process, without loss."""
        return type(self), (self.field, self.value, self.rule, self.remedy)


def number(
    field: str, value: Any, exact: bool = False, least: float = -math.inf, most: float = math.inf, remedy: str = ""
) -> float:
    """``value`` as a finite float from ``least`` to ``most``; an ExactFloat stays one.

    exact: for a parameter of the problem, which may also be a text such as "0.001" or "pi/2", a Fraction
    or a Decimal, and then keeps its exact value for multiprecision.
    """
    written = (str, Fraction, Decimal, int) if exact else ()
    # True and False are integers in Python, and no numbers here.
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating, *written)):
        raise InputError(field, value, "be a number", "give one real number, for example 0.5")
    try:
        result = exact_float(value) if isinstance(value, written) else float(value)
        result = value if isinstance(value, ExactFloat) else result
    except (ValueError, ArithmeticError):
        raise InputError(field, value, "be a number in the range of float64", "for example 0.1") from None
    if not math.isfinite(result):
        raise InputError(field, value, "be finite", "look at what it was computed from")
    if not least <= result <= most:
        rule = f"be >= {least:g}" if most == math.inf else f"lie in [{least:.6g}, {most:.6g}]"
        raise InputError(field, value, rule, remedy or f"for example {max(least, min(most, 1.0)):g}")
    return result


def numbers(field: str, value: Any, rule: str = "be finite numbers", remedy: str = "give them as a list") -> Array:
    """``value`` as finite floats in an array of its shape. Raises InputError for what is not real, for texts,
    for rows of different lengths, and for masked numbers."""
    # NumPy would read what lies under a mask.
    if any(np.ma.is_masked(row) for row in (value if isinstance(value, (list, tuple)) else [value])):
        remedy = "leave the masked ones out, or fill them in with numpy.ma.filled"
        raise InputError(field, "an array with masked numbers", "hold a number everywhere", remedy)
    try:
        # Integers, floats, and objects that may be numbers: no texts, no truth values, no complex numbers.
        array = value if isinstance(value, np.ndarray) else np.asarray(value)
        result = array.astype(float) if array.dtype.kind in "iufO" else None
    except Exception:  # whatever the objects of others raise when they are made an array
        result = None
    if result is None or not np.isfinite(result).all():
        raise InputError(field, value, rule, remedy)
    return result


def constants(field: str, value: Any, rule: str = "be finite numbers", remedy: str = "give them as a list") -> Array:
    """``numbers`` in a read-only array; one that ``read_only`` made stays the same object."""
    if is_read_only(value) and np.isfinite(value).all():
        return value
    return read_only(numbers(field, value, rule, remedy))


def vector(field: str, value: Any, n: int | None = None) -> Array:
    """``constants`` in a row, of n numbers where n is given."""
    array = constants(field, value)
    array = array if array.ndim == 1 else read_only(array.ravel())
    if n not in (None, len(array)):
        raise InputError(field, array, f"be {n} finite numbers", "one per unknown")
    return array


def sequence(field: str, value: Any, rule: str, remedy: str = "give a list") -> list[Any]:
    """The items of a list, tuple or array. Raises InputError for anything else, texts and dictionaries included."""
    text = isinstance(value, (str, bytes, bytearray))
    if (isinstance(value, Sequence) and not text) or (isinstance(value, np.ndarray) and value.ndim):
        return list(value)
    raise InputError(field, value, rule, remedy)


def positive(field: str, value: Any, exact: bool = False) -> float:
    """``value`` as a finite float > 0; ``exact`` as in ``number``."""
    result = number(field, value, exact)
    if result <= 0:
        raise InputError(field, value, "be > 0", "for example 1.0")
    return result


def integer(field: str, value: Any, least: int) -> int:
    """``value`` as a whole number >= ``least``."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(field, value, f"be an integer >= {least}", f"for example {max(least, 1)}")
    if not -MOST <= value <= MOST:
        raise InputError(field, value, f"be an integer below {MOST}", "give a smaller one")
    return int(value)


def one_of(field: str, value: Any, known: Iterable[str], rule: str = "be one that there is") -> str:
    """``value`` if it is one of the ``known`` names; else raise InputError."""
    names = list(known)
    if not isinstance(value, str) or value not in names:
        raise InputError(field, value, rule, near(value, names))
    return value


def file_path(field: str, value: Any) -> Path:
    """``value`` as the path of a file or folder. Raises InputError for anything but a text or a Path."""
    if not isinstance(value, (str, Path)):
        raise InputError(field, value, "be the path of a file", 'for example "run.nc"')
    return Path(value)


def units_labels(units: Any) -> Units:
    """``units`` as a tuple. Raises InputError unless it is empty or three short texts."""
    names = list(units) if isinstance(units, (tuple, list)) else [""]
    if len(names) in (0, 3) and all(isinstance(x, str) and 0 < len(x) <= 20 and x.isprintable() for x in names):
        return tuple(names)
    rule = "be the names of the units of length, time and force"
    raise InputError("units", units, rule, 'for example ("mm", "s", "N"), and ("rad", "s", "N m") for rotations')


def instance(field: str, value: Any, known: type[Known], remedy: str, rule: str = "") -> Known:
    """``value`` if it is an object of the type ``known``; else raise InputError."""
    if not isinstance(value, known):
        raise InputError(field, value, rule or f"be a {known.__name__}", remedy)
    return value


class Frozen:
    """Base of the frozen dataclasses of a model. Their copies hold read-only arrays too, and they have no subclasses:
    the computation uses their fields only and would ignore what a subclass overrides."""

    def __init_subclass__(cls) -> None:
        for base in cls.__bases__:
            if is_dataclass(base):
                rule, remedy = f"be a {base.__name__} itself", "what a subclass overrides would be ignored"
                raise InputError(cls.__name__, "a subclass", rule, remedy)

    def __getstate__(self) -> dict[str, Any]:
        return {x.name: getattr(self, x.name) for x in fields(self)}  # type: ignore[arg-type]

    def __setstate__(self, state: dict[str, Any]) -> None:
        # A pickled array can be written to again.
        self.__dict__.update({name: _frozen(value) for name, value in state.items()})


def _frozen(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_frozen, value))
    return read_only(value) if isinstance(value, np.ndarray) else value


def step_count(dt: float, t_end: float) -> int:
    """t_end/dt, which must be whole to 1e-9, and small enough for n dt to be other than (n + 1) dt."""
    ratio = t_end / dt if t_end < dt * MOST else math.inf
    if ratio > MOST:
        raise InputError("dt", dt, f"divide t_end = {t_end:g} into less than {MOST:g} steps", "give a larger dt")
    steps = round(ratio)
    if steps < 1 or abs(steps * dt - t_end) > 1e-9 * t_end:
        nearest = t_end / max(1, steps)
        raise InputError("dt", dt, f"divide t_end = {t_end:g} to 1e-9", f"the nearest step that does is {nearest:.12g}")
    return steps


def near(name: Any, known: Iterable[str]) -> str:
    """A remedy that lists the known names closest to ``name``, or all of them where none is close."""
    names = list(known)
    by_letters = {each.lower(): each for each in names}
    letters = get_close_matches(name.lower(), by_letters) if isinstance(name, str) else []
    if letters:
        return "did you mean " + " or ".join(by_letters[each] for each in letters) + "?"
    return "known: " + ", ".join(names) if names else "there is none"


_FORKED = list[bool]()  # for each fork up to this process: JAX was loaded before
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=lambda: _FORKED.append("jax" in sys.modules))


def require_jax_threads() -> None:
    """Raise InputError in a fork of a process with JAX: its threads are not copied, and JAX would wait for them."""
    if any(_FORKED):
        remedy = 'start it by multiprocessing.get_context("spawn")'
        raise InputError("process", "a fork", "not be a fork of one that has loaded JAX", remedy)


def require_jax_float64() -> None:
    """Raise InputError if JAX works in single precision, or not at all."""
    require_jax_threads()
    import jax

    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        remedy = 'call jax.config.update("jax_enable_x64", True) first'
        raise InputError("jax_enable_x64", False, "be True: double precision", remedy)


Exact = str | Fraction | Decimal | int

_FACTOR = r"\s*(pi|(?:\d[\d_]*\.?[\d_]*|\.\d[\d_]*)(?:[eE][+-]?\d+)?)\s*"
_PRODUCT = re.compile(rf"\s*[+-]?{_FACTOR}(?:[*/]{_FACTOR})*")
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
    "0.001", "1/3", "pi/2", "2*pi*50", with pi at most once and not below a /. Raises ValueError for other texts,
    ArithmeticError for a product that is too large or divides by 0. Outside the range of normal doubles it is what
    float() makes of it.
    """
    try:
        nearest = float(value)
    except (ValueError, OverflowError):  # a product, or an integer too large, which is refused below
        nearest = 1.0
    if not LEAST <= abs(nearest) < math.inf:  # 0, infinity and NaN too, which have no ratio
        return nearest
    ratio, pi = _read(str(value))
    nearest = float(ratio * _PI if pi else ratio)
    # A plain float is enough where it is the number itself; with pi it never is.
    if not pi and Fraction(nearest) == ratio:
        return nearest
    number = ExactFloat(nearest)
    number.ratio, number.pi = ratio, pi
    return number


def exact_value(x: float) -> tuple[Fraction, bool]:
    """(ratio, pi): the exact number behind ``x``, ratio times pi where pi is true; of a plain float itself."""
    return (x.ratio, x.pi) if isinstance(x, ExactFloat) else (Fraction(x), False)


def exact_parts(thing: Any, *keys: Any) -> list[str]:
    """Path and text of every ExactFloat in ``walk``."""
    return [f"{path_of(keys)} = {x.text}" for keys, x in walk(thing, *keys) if isinstance(x, ExactFloat)]


def _read(text: str) -> tuple[Fraction, bool]:
    """(ratio, pi) of a product of decimals and pi."""
    if _PRODUCT.fullmatch(text) is None:
        raise ValueError(f"{text!r} is not a number")
    ratio, pis = Fraction(-1 if text.lstrip().startswith("-") else 1), 0
    for operation, factor in re.findall(rf"([*/]?){_FACTOR}", text):
        sign = -1 if operation == "/" else 1
        if factor == "pi":
            pis += sign
        elif LEAST <= float(factor) < math.inf:  # the Fraction of 1e999999999 fills the memory
            ratio *= Fraction(factor) ** sign
        else:
            raise ValueError(f"{text!r} leaves the range of float64")
    # ExactFloat is a ratio or a ratio times pi, nothing else.
    if pis not in (0, 1):
        raise ValueError(f"{text!r} is not a number or a number times pi")
    return ratio, bool(pis)
