"""The law of contact as compiled scalars; ``Stops`` holds its numbers, ``Stops.law`` is the row of them.

    F = -(kappa d^p (1 + lambda d') + c d')_+  into the upper stop, d = u - g2 > 0, mirrored below

U = kappa d^(p+1)/(p+1) is the energy that the stop holds; what F takes beyond -U' it dissipates. The force
lets go where it would turn to a pull. Everything compiled that touches a stop calls these. The linear law
(2.4), p = 1, lambda = c = 0, has closed forms of its own: the march of the paper's tables is made of them.
"""

from __future__ import annotations

import math

from ..basics.compiled import compiled, inlined

# The row of numbers that a law is; side s has its stop at G1 or G2.
KAPPA, G1, G2, EXPONENT, DAMPING, DISSIPATION = range(6)
LAW = 6
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


@inlined
def is_linear(p: float, c: float, lam: float) -> bool:
    """Whether F = -kappa d."""
    return p == 1.0 and c == 0.0 and lam == 0.0


@inlined
def power(d: float, p: float) -> float:
    """d^p for d > 0, odd in d, so that it goes on smoothly where a root is sought beyond the stop."""
    return d if p == 1.0 else math.copysign(abs(d) ** p, d)


@inlined
def pressure(d: float, rate: float, kappa: float, p: float, c: float, lam: float) -> float:
    """kappa d^p (1 + lambda d') + c d', not yet cut off at zero."""
    return kappa * power(d, p) * (1.0 + lam * rate) + c * rate


@inlined
def press(d: float, rate: float, kappa: float, p: float, c: float, lam: float) -> float:
    """|F| at penetration d: the positive part of ``pressure`` where d > 0, else 0."""
    return max(0.0, pressure(d, rate, kappa, p, c, lam)) if d > 0.0 else 0.0


@inlined
def law_state(u: float, v: float, kappa: float, g1: float, g2: float, p: float, c: float, lam: float) -> float:
    """chi: the side on which the stop presses, 0 where it does not. Without damping that is beyond the stop."""
    if u > g2:
        return 1.0 if pressure(u - g2, v, kappa, p, c, lam) > 0.0 else 0.0
    if u < g1:
        return -1.0 if pressure(g1 - u, -v, kappa, p, c, lam) > 0.0 else 0.0
    return 0.0


@inlined
def law_force(u: float, v: float, kappa: float, g1: float, g2: float, p: float, c: float, lam: float) -> float:
    """F(u, u') on the beam."""
    if u > g2:
        return -press(u - g2, v, kappa, p, c, lam)
    if u < g1:
        return press(g1 - u, -v, kappa, p, c, lam)
    return 0.0


@inlined
def law_energy(u: float, kappa: float, g1: float, g2: float, p: float) -> float:
    """U(u) = kappa |d|^(p+1)/(p+1)."""
    return kappa * abs(depth(u, g1, g2)) ** (p + 1.0) / (p + 1.0)


@inlined
def elastic_force(u: float, kappa: float, g1: float, g2: float, p: float) -> float:
    """-U'(u); F less it is what dissipates."""
    return -kappa * power(depth(u, g1, g2), p)


@inlined
def side_force(
    u: float, v: float, chi: float, kappa: float, g1: float, g2: float, p: float, c: float, lam: float
) -> float:
    """F of the contact on side chi, +1 upper, -1 lower, 0 free, smooth across the stop and where F = 0."""
    if chi > 0:
        return -pressure(u - g2, v, kappa, p, c, lam)
    if chi < 0:
        return pressure(g1 - u, -v, kappa, p, c, lam)
    return 0.0


@inlined
def side_slopes(
    u: float, v: float, chi: float, kappa: float, g1: float, g2: float, p: float, c: float, lam: float
) -> tuple[float, float]:
    """-dF/du and -dF/du' of ``side_force``, both >= 0 where F presses."""
    if chi == 0:
        return 0.0, 0.0
    d, rate = (u - g2, v) if chi > 0 else (g1 - u, -v)
    stiff = kappa if p == 1.0 else kappa * p * abs(d) ** (p - 1.0)
    return stiff * (1.0 + lam * rate), kappa * power(d, p) * lam + c


@compiled
def stage_press(
    d0: float, rate0: float, s: float, s_rate: float, kappa: float, p: float, c: float, lam: float
) -> tuple[float, float, float]:
    """(P, dP/dd0, dP/dd0') with P = |F|(d0 - s P, d0' - s' P), compliances s and s' >= 0.

    |F| grows with d and d', so there is one P; a law with c > 0 jumps at d = 0, where P may be all that lies
    in the jump and the node stays on the stop. In closed form for p = 1, lambda = 0. Else by Newton's method
    from P = 0: |F| is convex along the line that the node takes, so the iterates rise to the root.
    """
    if not d0 > 0.0:
        return 0.0, 0.0, 0.0
    if p == 1.0 and lam == 0.0:
        below = 1.0 + kappa * s + c * s_rate
        P, slope, slope_rate = (kappa * d0 + c * rate0) / below, kappa / below, c / below
        if not P > 0.0:
            return (0.0, 0.0, 0.0) if P <= 0.0 else (P, slope, slope_rate)  # NaN stays NaN
    else:
        if pressure(d0, rate0, kappa, p, c, lam) <= 0.0:
            return 0.0, 0.0, 0.0
        P, left = 0.0, 0.0
        right = pressure(d0, rate0, kappa, p, c, lam)
        if s * right > d0:
            right = d0 / s
        slope = slope_rate = 0.0
        for _ in range(NEWTON):
            d, rate = d0 - s * P, rate0 - s_rate * P
            found = pressure(d, rate, kappa, p, c, lam)
            stiff = kappa if p == 1.0 else kappa * p * abs(d) ** (p - 1.0)
            to_depth, to_rate = stiff * (1.0 + lam * rate), kappa * power(d, p) * lam + c
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
def stage_law(
    r: float, w: float, s: float, s_rate: float, kappa: float, g1: float, g2: float, p: float, c: float, lam: float
) -> tuple[float, float, float]:
    """(F, dF/dr, dF/dw) with u = r + s F, u' = w + s' F and F = F(u, u')."""
    if r > g2:
        P, slope, slope_rate = stage_press(r - g2, w, s, s_rate, kappa, p, c, lam)
        return -P, -slope, -slope_rate
    if r < g1:
        P, slope, slope_rate = stage_press(g1 - r, -w, s, s_rate, kappa, p, c, lam)
        return P, -slope, -slope_rate
    return 0.0, 0.0, 0.0
