"""The law of contact as compiled scalars; ``Stops`` holds its numbers, ``Stops.law`` is the row of them.

    F = -(kappa d^p (1 + lambda d') + c d')_+  into the upper stop, d = u - g2 > 0, mirrored below

U = kappa d^(p+1)/(p+1) is the energy that the stop holds; what F takes beyond -U' it dissipates. The force
lets go where it would turn to a pull. Everything compiled that touches a stop calls these. The linear law
(2.4), p = 1, lambda = c = 0, has closed forms of its own: the march of the paper's tables is made of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..basics.arrays import Array
from ..basics.compiled import compiled, inlined


class Law(NamedTuple):
    """The numbers of a law; the rows of an array of laws hold them in this order."""

    kappa: float
    g1: float  # the lower stop, -inf for none
    g2: float
    p: float
    c: float
    lam: float


LAW = len(Law._fields)
KAPPA, G1, G2 = range(3)  # of a row, where the linear law alone is asked
DAMPING = Law._fields.index("c")
NEWTON = 200  # iterations, of which a handful are used


# ---------------------------------------------------------------- the linear law


@inlined
def state(u: float, g1: float, g2: float) -> float:
    """chi: +1 beyond g2, -1 beyond g1, else 0."""
    return 1.0 if u > g2 else (-1.0 if u < g1 else 0.0)


@inlined
def depth(u: float, g1: float, g2: float) -> float:
    """u - clip(u, g1, g2): > 0 into the upper stop, < 0 into the lower."""
    return u - g2 if u > g2 else (u - g1 if u < g1 else 0.0)


@inlined
def force(u: float, kappa: float, g1: float, g2: float) -> float:
    """F(u), on the beam: < 0 on the upper stop."""
    return -kappa * depth(u, g1, g2)


@inlined
def energy(u: float, kappa: float, g1: float, g2: float) -> float:
    """U(u), so F = -U'."""
    d = depth(u, g1, g2)
    return 0.5 * kappa * d * d


@inlined
def stage_stiffness(kappa: float, compliance: float) -> float:
    """kappa/(1 + kappa s): what a stop looks like to a node that gives way by s per unit of force."""
    return kappa / (1.0 + kappa * compliance)


@inlined
def stage_force(r: float, stage: float, g1: float, g2: float) -> float:
    """F with u = r + s F and F = F(u); ``stage`` is ``stage_stiffness(kappa, s)``. With s = 0 it is F(r)."""
    if r > g2:
        return stage * (g2 - r)
    if r < g1:
        return stage * (g1 - r)
    return 0.0


# ---------------------------------------------------------------- any law


@compiled
def law_of(law: Array, c: int) -> Law:
    """Row c of an array of laws (m, 6)."""
    return Law(law[c, 0], law[c, 1], law[c, 2], law[c, 3], law[c, 4], law[c, 5])


@compiled
def damps(law: Law) -> bool:
    """Whether F depends on the velocity."""
    return (law.c > 0.0) | (law.lam > 0.0)


@compiled
def is_linear(law: Law) -> bool:
    """Whether F = -kappa d."""
    return law.p == 1.0 and not damps(law)


@compiled
def power(d: float, p: float) -> float:
    """d^p for d > 0, odd in d, so that it goes on smoothly where a root is sought beyond the stop."""
    return d if p == 1.0 else math.copysign(abs(d) ** p, d)


@compiled
def pressure(d: float, rate: float, law: Law) -> float:
    """kappa d^p (1 + lambda d') + c d', not yet cut off at zero."""
    return law.kappa * power(d, law.p) * (1.0 + law.lam * rate) + law.c * rate


@compiled
def slopes(d: float, rate: float, law: Law) -> tuple[float, float]:
    """The derivatives of ``pressure`` by d and by d'; both >= 0 where it is."""
    stiff = law.kappa if law.p == 1.0 else law.kappa * law.p * abs(d) ** (law.p - 1.0)
    return stiff * (1.0 + law.lam * rate), law.kappa * power(d, law.p) * law.lam + law.c


@compiled
def press(d: float, rate: float, law: Law) -> float:
    """|F| at penetration d: the positive part of ``pressure`` where d > 0, else 0."""
    return max(0.0, pressure(d, rate, law)) if d > 0.0 else 0.0


@compiled
def law_state(u: float, v: float, law: Law) -> float:
    """chi: the side on which the stop presses, 0 where it does not. Without damping that is beyond the stop."""
    if u > law.g2:
        return 1.0 if pressure(u - law.g2, v, law) > 0.0 else 0.0
    if u < law.g1:
        return -1.0 if pressure(law.g1 - u, -v, law) > 0.0 else 0.0
    return 0.0


@compiled
def law_force(u: float, v: float, law: Law) -> float:
    """F(u, u') on the beam."""
    if u > law.g2:
        return -press(u - law.g2, v, law)
    if u < law.g1:
        return press(law.g1 - u, -v, law)
    return 0.0


@compiled
def found_force(u: float, v: float, found: float, law: Law) -> float:
    """F at the end of a step whose node found the force ``found``, NaN for none.

    Where c > 0 the force jumps at d = 0. A node may end there, on the stop to rounding, under any force up to c u':
    its state does not tell which.
    """
    return law_force(u, v, law) if math.isnan(found) or law.c == 0.0 else found


@compiled
def found_state(u: float, v: float, found: float, law: Law) -> float:
    """chi there: where c > 0 the stop presses where a force was found."""
    if math.isnan(found) or law.c == 0.0:
        return law_state(u, v, law)
    return 0.0 if found == 0.0 else math.copysign(1.0, -found)


@compiled
def law_energy(u: float, law: Law) -> float:
    """U(u) = kappa |d|^(p+1)/(p+1)."""
    return law.kappa * abs(depth(u, law.g1, law.g2)) ** (law.p + 1.0) / (law.p + 1.0)


@compiled
def elastic_force(u: float, law: Law) -> float:
    """-U'(u); F less it is what dissipates."""
    return -law.kappa * power(depth(u, law.g1, law.g2), law.p)


@compiled
def side_force(u: float, v: float, chi: float, law: Law) -> float:
    """F of the contact on side chi, +1 upper, -1 lower, 0 free, smooth across the stop and where F = 0."""
    if chi > 0:
        return -pressure(u - law.g2, v, law)
    if chi < 0:
        return pressure(law.g1 - u, -v, law)
    return 0.0


@compiled
def pull(d: float, rate: float, length: float, law: Law) -> float:
    """A length with the sign of ``pressure`` at d > 0, smooth across the stop: its root is where a stop lets go."""
    if law.c > 0.0:
        return pressure(d, rate, law) / (law.kappa * length ** (law.p - 1.0))
    return length * (1.0 + law.lam * rate)  # kappa d^p, which is zero on the stop itself, left out


@compiled
def side_slopes(u: float, v: float, chi: float, law: Law) -> tuple[float, float]:
    """-dF/du and -dF/du' of ``side_force``."""
    if chi == 0:
        return 0.0, 0.0
    return slopes(u - law.g2, v, law) if chi > 0 else slopes(law.g1 - u, -v, law)


@compiled
def stage_press(d0: float, rate0: float, s: float, s_rate: float, law: Law) -> tuple[float, float, float]:
    """(P, dP/dd0, dP/dd0') with P = |F|(d0 - s P, d0' - s' P), compliances s and s' >= 0.

    |F| grows with d and d', so there is one P; a law with c > 0 jumps at d = 0, where P may be all that lies
    in the jump and the node stays on the stop. In closed form for p = 1, lambda = 0. Else by Newton's method
    from P = 0: |F| is convex along the line that the node takes, so the iterates rise to the root.
    """
    if not d0 > 0.0:
        return 0.0, 0.0, 0.0
    if law.p == 1.0 and law.lam == 0.0:
        below = 1.0 + law.kappa * s + law.c * s_rate
        P, slope, slope_rate = (law.kappa * d0 + law.c * rate0) / below, law.kappa / below, law.c / below
        if not P > 0.0:
            return (0.0, 0.0, 0.0) if P <= 0.0 else (P, slope, slope_rate)  # NaN stays NaN
    else:
        if pressure(d0, rate0, law) <= 0.0:
            return 0.0, 0.0, 0.0
        P, left = 0.0, 0.0
        right = pressure(d0, rate0, law)
        if s * right > d0:
            right = d0 / s
        slope = slope_rate = 0.0
        for _ in range(NEWTON):
            d, rate = d0 - s * P, rate0 - s_rate * P
            found = pressure(d, rate, law)
            to_depth, to_rate = slopes(d, rate, law)
            below = 1.0 + s * to_depth + s_rate * to_rate
            slope, slope_rate = to_depth / below, to_rate / below
            if found > P:
                left = P
            else:
                right = P
            new = P + (found - P) / below
            if not left <= new <= right:
                new = 0.5 * (left + right)
            change, P = abs(new - P), new
            if change <= 2e-16 * P or left >= right:
                break
    if s * P >= d0:  # in the jump at d = 0
        return d0 / s, 1.0 / s, 0.0
    return P, slope, slope_rate


@compiled
def stage_law(r: float, w: float, s: float, s_rate: float, law: Law) -> tuple[float, float, float]:
    """(F, dF/dr, dF/dw) with u = r + s F, u' = w + s' F and F = F(u, u')."""
    if r > law.g2:
        P, slope, slope_rate = stage_press(r - law.g2, w, s, s_rate, law)
        return -P, -slope, -slope_rate
    if r < law.g1:
        P, slope, slope_rate = stage_press(law.g1 - r, -w, s, s_rate, law)
        return P, -slope, -slope_rate
    return 0.0, 0.0, 0.0
