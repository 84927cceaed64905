"""Sampled functions of time in many digits: their polynomials, and how a mode answers these."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from flint import acb, arb, ctx, fmpq

from ...model.sampled import Sampled


def taylor(record: Sampled, t: Any) -> list[Any]:
    """The coefficients (P,) of s^k in f(t + s), up to the next sample, exact in the doubles of the record."""
    i = int(np.clip(np.searchsorted(record.t, float(t), side="right") - 1, 0, len(record.t) - 2))
    if t < arb(_rational(record.t[i])) and i > 0:  # the double next to t is the sample after it
        i -= 1
    return moved([arb(c) for c in _piece(record, i)], t - arb(_rational(record.t[i])))


def _piece(record: Sampled, i: int) -> list[Any]:
    """The polynomial between samples i and i + 1: as ``Sampled.pieces``, without rounding."""
    t0, t1, v0, v1 = (_rational(x) for x in (*record.t[i : i + 2], *record.values[i : i + 2]))
    h = t1 - t0
    rise = (v1 - v0) / h
    c = [v0, rise]
    if record.kind == "cubic":
        m0, m1 = (_rational(x) for x in record.slopes[i : i + 2])
        c = [v0, m0, (3 * rise - 2 * m0 - m1) / h, (m0 + m1 - 2 * rise) / (h * h)]
    for _ in range(record.derivative):
        c = [k * c[k] for k in range(1, len(c))]
    return c


def _rational(x: float) -> Any:
    ratio = Fraction(float(x))
    return fmpq(ratio.numerator, ratio.denominator)


def moved(c: list[Any], s: Any) -> list[Any]:
    """The coefficients of p(s + .) from those of p."""
    c = list(c)
    for first in range(len(c) - 1):
        for k in range(len(c) - 2, first - 1, -1):
            c[k] += s * c[k + 1]
    return [x.mid() for x in c]


def answers(eigenvalue: Any, tau: Any, count: int) -> list[Any]:
    """psi_j(eigenvalue, tau), j < count, of ``exact.polynomial_answer``.

    phi_{l+1} = (phi_l - 1/l!)/z loses log2(1/|z|) bits at each turn for small z: so many more are carried.
    """
    if tau == 0:
        return [acb(0)] * count
    before = ctx.prec
    z = acb(eigenvalue) * tau
    try:
        size = float(abs(z).mid().log()) / math.log(2.0) if z != 0 else -math.inf
        if size < -before:
            return [acb(tau ** (j + 1) / (j + 1)) for j in range(count)]
        ctx.prec = before + math.ceil((count + 1) * max(0.0, -size)) + 20
        z = (acb(eigenvalue) * tau).mid()
        phi, found, scale = z.exp(), [], arb(1) * tau
        for j in range(count):
            phi = ((phi - fmpq(1, math.factorial(j))) / z).mid()
            found.append(scale * phi)
            scale *= tau * (j + 1)
    finally:
        ctx.prec = before
    return [acb(x).mid() for x in found]
