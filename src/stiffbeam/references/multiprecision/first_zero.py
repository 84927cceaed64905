"""The first zero of a power series, by Bernstein coefficients of balls: what it says is so, or it says nothing.

    p(a + w y) = sum_i b_i (K over i) y^i (1 - y)^(K - i),   b_i = sum_{k <= i} (i over k)/(K over k) p_k

No change of sign among the b_i: no zero in the interval. One: exactly one zero (Descartes). More: look at less of it.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from math import comb
from typing import Any

from flint import arb, arb_mat, arb_poly, ctx, fmpq

NARROWER, WIDER = 0.37, 1.7  # no fractions at which motions of simple numbers have their zeros


class Undecided(Exception):
    """Whether a gap closes is less than the digits carried can tell."""


def leading(p: list[Any]) -> tuple[int, int]:
    """(k, sign): the first coefficient that is not zero within its radius; (len(p), 0) where there is none."""
    for k, x in enumerate(p):
        if not x.contains(0):
            return k, 1 if x > 0 else -1
    return len(p), 0


def first_zero(p: list[Any], bits: int) -> Any | None:
    """The first x in [0, 1] at which a series p, balls (K + 1,), turns negative; None where it does not before 1.

    Leading coefficients that are zero within their radius are zeros at x = 0, not crossings. A zero at x = 1 is left
    to the series that follows. Raises Undecided for a double zero, or one too close to another.
    """
    zeros, sign = leading(p)
    if sign <= 0:
        return arb(0) if sign else None
    p = p[zeros:]
    if p[0].lower() > sum(((-x).abs_upper() for x in p[1:] if not x > 0), arb(0)):
        return None
    a, w = arb(0), arb(1)
    while a < 1:
        last = not a + w < 1
        w = 1 - a if last else w
        b = bernstein(p, a, w)
        if all(x > 0 for x in b[:-1]) and (b[-1] > 0 or (last and b[-1].contains(0))):
            a, w = (arb(1) if last else (a + w).mid()), WIDER * w
        elif b[0] > 0 and b[-1] < 0 and (_one_change(b) or w < arb(2) ** (-bits // 4)):
            return _root(p, a, (a + w).mid())
        elif w < arb(2) ** -bits:
            raise Undecided
        else:
            w = (NARROWER * w).mid()
    return None


def bernstein(p: list[Any], a: Any, w: Any) -> list[Any]:
    """The coefficients of p on [a, a + w]."""
    if a != 0 or w != 1:
        moved = arb_poly(p)(arb_poly([a, w])).coeffs()
        p = moved + [arb(0)] * (len(p) - len(moved))
    return (_weights(len(p), ctx.prec) * arb_mat([[x] for x in p])).entries()


@cache
def _weights(count: int, precision: int) -> Any:  # the precision they are kept for
    lines = [[fmpq(comb(i, k), comb(count - 1, k)) for k in range(count)] for i in range(count)]
    return arb_mat([[arb(x) for x in line] for line in lines])


def _one_change(b: list[Any]) -> bool:
    """Whether the signs go from + to - once, whatever those that are not known are."""
    known = [i for i, x in enumerate(b) if not x.contains(0)]
    changes = [(i, j) for i, j in pairwise(known) if (b[i] > 0) != (b[j] > 0)]
    unknown = len(b) - len(known)
    return len(changes) == 1 and unknown <= 1 and changes[0][1] - changes[0][0] == 1 + unknown


def _root(p: list[Any], low: Any, high: Any) -> Any:
    """The zero between ``low``, where p > 0, and ``high`` by Newton's method, by halves where that leads outside."""
    value = arb_poly([x.mid() for x in p])
    slope, x = value.derivative(), ((low + high) / 2).mid()
    for _ in range(4 * ctx.prec):
        here = value(x).mid()
        low, high = (x, high) if here > 0 else (low, x)
        steep = slope(x).mid()
        step = (here / steep).mid() if steep != 0 else high - low
        following = (x - step).mid()
        if not low <= following <= high:
            following = ((low + high) / 2).mid()
        if abs(following - x) <= abs(x) * arb(2) ** (8 - ctx.prec):
            return following
        x = following
    return x
