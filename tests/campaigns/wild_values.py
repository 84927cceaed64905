"""Wild values: what stands where a number, a sequence, a function, a name or a file was wanted."""

from __future__ import annotations

from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np

import stiffbeam as sb


class Unfriendly:
    """It has no text of its own, no length and no truth."""

    def __repr__(self) -> str:
        raise RuntimeError("no text")

    __str__ = __repr__

    def __bool__(self) -> bool:
        raise RuntimeError("no truth")

    def __len__(self) -> int:
        raise RuntimeError("no length")


NUMBERS: list[Any] = [
    0, 1, -1, 2, 3, 10**18, -(10**18), 10**400, -(10**400), 10**5000, 0.0, -0.0, 1e-320, 1e-300, -1e-300, 1e-12, 0.5,
    -0.5, 1.0, 1e12, 1e18, 1e30, 1e300, -1e300, 1.7e308, float("nan"), float("inf"), -float("inf"), True, False,
    np.float32(1e-3), np.float64("nan"), np.int8(-3), np.uint64(2**63), np.longdouble("1e4000"), np.bool_(True),
    Fraction(1, 3), Fraction(10**400, 3), Fraction(3, 10**400), Decimal("0.1"), Decimal("NaN"), Decimal("sNaN"),
    Decimal("1e999999"), Decimal("-Infinity"), 1j, 1 + 0j, np.complex128(1.0), np.datetime64("2002-01-01"),
]  # fmt: skip
TEXTS: list[Any] = [
    "", " ", "abc", "0.1", "1/3", "1/0", "pi/2", "pi*pi", "1e400", "1e-400", "1e999999999", "nan", "-" * 1000 + "1",
    "1*" * 1000 + "1", "1" * 5000, "(" * 500, "x" * 20000, "[/]", "[red]", "\x1b[31m", "a\nb", "\x00", "..", "../..",
    "/etc/passwd", "café", "\ud800", "hht", "HHT(alpha=-0.1)", "HHT(alpha=[1])", "@", "table10", "-", "None",
    "exact", "cvode", "linear", "conserving", "extrapolated", "hermite", "<b>", b"bytes", bytearray(3),
]  # fmt: skip
OTHERS: list[Any] = [
    None, (), [], {}, set(), {"a": 1}, [None], [1.0], [1.0, 2.0], [0.0, np.nan], [np.inf], ["a"], [[1.0], [2.0, 3.0]],
    [10**400], [1j], np.zeros(0), np.zeros((0, 0)), np.zeros((2, 2)), np.ones(3), np.array(1.0), np.array([1j]),
    np.array(["a"]), np.array([None]), np.eye(3), -np.eye(3), np.full((3, 3), np.nan), np.linspace(0.0, 1.0, 5),
    np.ma.array([0.0, 1.0, 2.0], mask=[0, 1, 0]), np.ma.array(np.eye(3), mask=np.eye(3) > 0.0), np.ones(3, np.float32),
    np.linspace(0.0, 1.0, 11) ** 2, np.linspace(0.0, 1.0, 11, dtype=np.float32),
    np.zeros((1, 1, 1)), np.eye(3, dtype=complex), np.arange(10**6), [[[[[]]]]], range(5), slice(None), object,
    object(), Unfriendly(), Ellipsis, float, sb.Stops, sb.Harmonic, sb.InputError, lambda: 0.0, lambda x: "text",
    lambda x, y: 0.0, lambda x: {}[0], lambda x: x, lambda x: x / 0.0, lambda x: np.full(np.shape(x), np.nan),
    lambda x: None, lambda x: [1.0],
    sb.Harmonic(1.0, 2.0), sb.Constant(0.0), sb.Constant(1e300), sb.Stops(upper=0.1, stiffness=1e3), sb.HHT(), sb.HHT,
    sb.Sampled([0.0, 1.0], [0.0, 1.0]), sb.PolynomialProfile((0.0,)), ("mm", "s", "N"), np, sb,
]  # fmt: skip


def wild(rng: np.random.Generator) -> Any:
    """One of the values, or a number of any size, or some of them in a row."""
    kind = rng.integers(8)
    if kind < 3:
        return _pick(rng, NUMBERS)
    if kind == 3:
        return _pick(rng, TEXTS)
    if kind == 4:
        return float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-320.0, 308.0))
    if kind == 5:
        items = [wild(rng) for _ in range(rng.integers(4))]
        return items if rng.random() < 0.7 else tuple(items)
    return _pick(rng, OTHERS)


def near(rng: np.random.Generator, good: Any) -> Any:
    """A number of another size or sign than ``good``; anything wild for what is no number."""
    if isinstance(good, (int, float)) and not isinstance(good, bool) and rng.random() < 0.8:
        changed = good * 10.0 ** rng.uniform(-6.0, 6.0) * rng.choice([1.0, 1.0, -1.0])
        return round(changed) if isinstance(good, int) else changed
    return wild(rng)


def _pick(rng: np.random.Generator, values: list[Any]) -> Any:
    return values[rng.integers(len(values))]
