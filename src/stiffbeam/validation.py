"""One error type for bad input: it names the field, the value, the rule and the remedy."""

from __future__ import annotations

import math
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

import numpy as np


class InputError(ValueError):
    """Bad input: ``field`` must obey ``rule`` but is ``value``; ``remedy`` says what to do."""

    def __init__(self, field: str, value: Any, rule: str, remedy: str = "") -> None:
        self.field, self.value, self.rule, self.remedy = field, value, rule, remedy
        message = f"{field} must {rule}, got {value!r}"
        super().__init__(f"{message}: {remedy}" if remedy else message)


def number(field: str, value: Any) -> float:
    """``value`` as a finite float."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise InputError(field, value, "be a number")
    if not math.isfinite(value):
        raise InputError(field, value, "be finite")
    return float(value)


def positive(field: str, value: Any) -> float:
    """``value`` as a finite float > 0."""
    if number(field, value) <= 0:
        raise InputError(field, value, "be > 0")
    return float(value)


def non_negative(field: str, value: Any) -> float:
    """``value`` as a finite float >= 0."""
    if number(field, value) < 0:
        raise InputError(field, value, "be >= 0")
    return float(value)


def integer(field: str, value: Any, least: int) -> int:
    """``value`` as a whole number >= ``least``."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(field, value, f"be an integer >= {least}")
    return int(value)


def step_count(dt: float, t_end: float) -> int:
    """t_end/dt, which must be whole to 1e-9."""
    steps = round(t_end / dt)
    if steps < 1 or abs(steps * dt - t_end) > 1e-9 * t_end:
        nearest = t_end / max(1, steps)
        raise InputError("dt", dt, f"divide t_end = {t_end:g} to 1e-9", f"the nearest step that does is {nearest:.12g}")
    return steps


def near(name: str, known: Iterable[str]) -> str:
    """A remedy that lists the known names closest to ``name``, or all of them."""
    names = list(known)
    close = get_close_matches(name, names, n=3, cutoff=0.5)
    return "did you mean " + " or ".join(close) + "?" if close else "known: " + ", ".join(names)
