"""The error type for invalid input, with the field, the value, the rule and a fix; and the checks that raise it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from decimal import Decimal
from difflib import get_close_matches
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import Array
from .exact_float import ExactFloat, exact_float
from .text import sentence, shown

MOST = 2**53  # integers up to here are floats as well


class InputError(ValueError):
    """Bad input: ``field`` must obey ``rule`` but is ``value``; ``remedy`` proposes a fix.

    A ValueError. The message is one line of at most 300 letters.

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
        super().__init__(sentence([field, rule, shown(value), remedy], (" must ", ", got ", ": ")))

    def __reduce__(self) -> tuple[Any, ...]:
        """Arguments to rebuild the error in another process, without loss."""
        return type(self), (self.field, self.value, self.rule, self.remedy)


def number(field: str, value: Any, exact: bool = False) -> float:
    """``value`` as a finite float; an ExactFloat stays one.

    exact: for a parameter of the problem, which may also be a text such as "0.001" or "pi/2", a Fraction
    or a Decimal, and then keeps its exact value for multiprecision.
    """
    if exact and isinstance(value, (str, Fraction, Decimal, int)) and not isinstance(value, bool):
        try:
            value = exact_float(value)
        except (ValueError, ZeroDivisionError) as error:
            remedy = str(error) if isinstance(value, str) and len(value) < 80 else "give one below 1e308"
            raise InputError(field, value, "be a number in the range of float64", remedy) from None
    # True and False are integers in Python, and no numbers here.
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise InputError(field, value, "be a number", "give one real number, for example 0.5")
    try:
        result = value if isinstance(value, ExactFloat) else float(value)
    except OverflowError:
        raise InputError(field, value, "be a number in the range of float64", "give one below 1e308") from None
    if not math.isfinite(result):
        raise InputError(field, value, "be finite", "look at what it was computed from")
    return result


def numbers(field: str, value: Any, rule: str = "be finite numbers", remedy: str = "give them as a list") -> Array:
    """``value`` as finite floats in an array of its shape. Raises InputError for what is not real, for texts,
    for rows of different lengths, and for masked numbers."""
    unmasked(field, value)
    try:
        # Integers, floats, and objects that may be numbers: no texts, no truth values, no complex numbers.
        array = value if isinstance(value, np.ndarray) else np.asarray(value)
        result = array.astype(float) if array.dtype.kind in "iufO" else None
    except Exception:  # whatever the objects of others raise when they are made an array
        result = None
    if result is None or not np.all(np.isfinite(result)):
        raise InputError(field, value, rule, remedy)
    return result


def unmasked(field: str, *values: Any) -> None:
    """Raise InputError for an array, or a list of rows, with masked numbers: NumPy would read what lies under the
    mask."""
    for value in values:
        rows = value if isinstance(value, (list, tuple)) else [value]
        if any(np.ma.is_masked(row) for row in rows):
            remedy = "leave the masked ones out, or fill them in with numpy.ma.filled"
            raise InputError(field, "an array with masked numbers", "hold a number everywhere", remedy)


def sequence(field: str, value: Any, rule: str, remedy: str = "give a list") -> list[Any]:
    """The items of a list, tuple or array. Raises InputError for anything else, texts and dictionaries included."""
    if isinstance(value, (list, tuple, np.ndarray, Sequence)) and not isinstance(value, (str, bytes, bytearray)):
        try:
            return list(value)
        except Exception:  # an array without dimensions, or whatever the objects of others raise
            pass
    raise InputError(field, value, rule, remedy)


def positive(field: str, value: Any, exact: bool = False) -> float:
    """``value`` as a finite float > 0; ``exact`` as in ``number``."""
    result = number(field, value, exact)
    if result <= 0:
        raise InputError(field, value, "be > 0", "for example 1.0")
    return result


def non_negative(field: str, value: Any, exact: bool = False) -> float:
    """``value`` as a finite float >= 0; ``exact`` as in ``number``."""
    result = number(field, value, exact)
    if result < 0:
        raise InputError(field, value, "be >= 0", "for example 0.0")
    return result


def bound(field: str, value: Any) -> float:
    """``value`` as a float that may be infinite."""
    if isinstance(value, (float, np.floating)) and math.isinf(value):
        return float(value)
    return number(field, value)


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


def file_path(field: str, value: Any, remedy: str = "give a shorter one") -> Path:
    """``value`` as the path of a file or folder. Raises InputError for what no file system could hold."""
    # 255 bytes is what common file systems allow for a name.
    names = str(value).split("/") if isinstance(value, (str, Path)) else []
    if not names or any("\0" in name or len(name.encode("utf-8", "replace")) > 255 for name in names):
        rule = "be the path of a file, each name in it at most 255 bytes"
        raise InputError(field, value, rule, remedy)
    return Path(value)


def itself(field: str, value: Any, known: type) -> None:
    """Raise InputError for a subclass of ``known``: the computation uses its fields only and would ignore overrides."""
    if type(value) is not known:
        name = known.__name__
        if not isinstance(value, known):
            raise InputError(field, value, f"be a {name}", f"make one with stiffbeam.{name}")
        remedy = f"what a subclass overrides would be ignored: give a {name}"
        raise InputError(field, f"a {type(value).__name__}", f"be a {name} itself", remedy)


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
    """A remedy that lists the known names closest to ``name``, or all of them."""
    names = list(known)
    by_letters = {each.lower(): each for each in names}
    # The search takes time with the square of the length: 100 letters are enough for a name.
    letters = get_close_matches(name[:100].lower(), by_letters, n=3, cutoff=0.5) if isinstance(name, str) else []
    close = [by_letters[each] for each in letters]
    return "did you mean " + " or ".join(close) + "?" if close else "known: " + ", ".join(names)


def require_jax_float64() -> None:
    """Raise InputError if JAX works in single precision."""
    import jax

    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        remedy = 'call jax.config.update("jax_enable_x64", True) first'
        raise InputError("jax_enable_x64", False, "be True: double precision", remedy)
