"""The contact law. Kernels, NumPy, JAX, the discrete gradient, the energy balance and files all use this module.

    F = -(f(d) (1 + lambda d') + c d')_+,  f = kappa d^p,  into the upper stop, d = u - g2 > 0, mirrored below

U = int f dd is the energy that the stop holds; what F takes beyond -U' it dissipates. The force lets go where it would
turn to a pull.

The functions under "the terms" are arithmetic alone: each is a plain function of numbers, NumPy arrays or JAX arrays,
and kernels call the same text. A new term is a field of ``Parameters``, its place in ``Law``, and a change of these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

from ..basics.arrays import Array
from ..basics.compiled import compiled, formula, inlined

NEWTON = 200  # iterations, of which a handful are used


@dataclass(frozen=True, repr=False)
class Parameters:
    """The numbers of a law, as ``Stops`` and files name them. Left at their defaults they make it linear."""

    stiffness: float = field(kw_only=True)
    exponent: float = field(default=1.0, kw_only=True)
    damping: float = field(default=0.0, kw_only=True)
    dissipation: float = field(default=0.0, kw_only=True)


# Those beside the stiffness, each with its value in the linear law.
LINEAR: dict[str, float] = {x.name: getattr(Parameters, x.name) for x in fields(Parameters) if x.name != "stiffness"}


class Law(NamedTuple):
    """The parameters of the law in the form for kernels, with the stops g1 and g2. An array of laws has them in this
    order.

    Those after g2 stand in the order of ``Parameters``.
    """

    kappa: float
    g1: float  # the lower stop, -inf for none
    g2: float
    p: float
    c: float
    lam: float


LAW = len(Law._fields)
KAPPA, G1, G2 = range(3)  # of a row, where the linear law alone is asked


@compiled
def law_of(law: Array, c: int) -> Law:
    """Row c of an array of laws (m, 6)."""
    return Law(law[c, 0], law[c, 1], law[c, 2], law[c, 3], law[c, 4], law[c, 5])


def all_laws(law: Array) -> Law:
    """An array of laws (.., 6) as one Law of arrays (..)."""
    return Law._make(law[..., i] for i in range(LAW))


# ---------------------------------------------------------------- the terms


@formula
def power(d: Any, p: float) -> Any:
    """d^p for d > 0, odd in d, so that it goes on smoothly where a root is sought beyond the stop."""
    # The sign by arithmetic: this line runs on floats, NumPy arrays and JAX arrays.
    return d if p == 1.0 else (2.0 * (d >= 0.0) - 1.0) * abs(d) ** p


@formula
def mean_power(d0: float, d1: float, p: float) -> float:
    """(d1^(p+1) - d0^(p+1))/((p + 1)(d1 - d0)) of two depths > 0, without cancellation."""
    if p == 1.0:
        return 0.5 * (d0 + d1)
    # The powers' difference by expm1 and log1p, which keep its digits.
    share = (d1 - d0) / d0
    # The quotient below is 0/0 as the depths meet. Two terms of its series are exact to rounding here.
    if abs(share) < 1e-12:
        return d0**p * (1.0 + 0.5 * p * share)
    return d0**p * math.expm1((p + 1.0) * math.log1p(share)) / ((p + 1.0) * share)


@formula
def elastic(d: Any, law: Law) -> Any:
    """f(d), odd in d."""
    return law.kappa * power(d, law.p)


@formula
def elastic_slope(d: Any, law: Law) -> Any:
    """f'(d)."""
    return law.kappa if law.p == 1.0 else law.kappa * law.p * abs(d) ** (law.p - 1.0)


@formula
def chord(d: Any, law: Law) -> Any:
    """f(d)/d of d > 0: the stiffness of a linear spring with the same force."""
    return law.kappa * d ** (law.p - 1.0)


@formula
def stored(d: Any, law: Law) -> Any:
    """U(d), even in d."""
    return 0.5 * law.kappa * d * d if law.p == 1.0 else law.kappa * abs(d) ** (law.p + 1.0) / (law.p + 1.0)


@formula
def mean_elastic(d0: float, d1: float, law: Law) -> float:
    """(U(d1) - U(d0))/(d1 - d0) of two depths > 0, without cancellation."""
    return law.kappa * mean_power(d0, d1, law.p)


def depth_under(force: Any, law: Law) -> Any:
    """The depth at which f is ``force``."""
    return (force / law.kappa) ** (1.0 / law.p)


def depth_holding(energy: Any, law: Law) -> Any:
    """The depth at which U is ``energy``."""
    return ((law.p + 1.0) * energy / law.kappa) ** (1.0 / (law.p + 1.0))


@formula
def pressure(d: Any, rate: Any, law: Law) -> Any:
    """f(d) (1 + lambda d') + c d', not yet cut off at zero."""
    return elastic(d, law) * (1.0 + law.lam * rate) + law.c * rate


@formula
def slopes(d: Any, rate: Any, law: Law) -> tuple[Any, Any]:
    """The derivatives of ``pressure`` by d and by d'; both >= 0 where it is."""
    return elastic_slope(d, law) * (1.0 + law.lam * rate), elastic(d, law) * law.lam + law.c


@formula
def is_spring(law: Law) -> Any:
    """Return True where f = kappa d: the discrete gradient has a closed form."""
    return law.p == 1.0


@formula
def is_affine(law: Law) -> Any:
    """Return True where ``pressure`` is linear in d and d': a stage equation has a closed form."""
    # & and | in place of ``and`` and ``or``: a Law may hold arrays.
    return is_spring(law) & (law.lam == 0.0)


@formula
def jumps(law: Law) -> Any:
    """Return True where F jumps when the gap closes with a velocity other than zero: a state on the stop does not tell
    the force."""
    return law.c > 0.0


@formula
def damps(law: Law) -> Any:
    """Return True where F depends on the velocity."""
    return jumps(law) | (law.lam > 0.0)


@formula
def is_linear(law: Law) -> Any:
    """Return True where F = -kappa d."""
    return is_affine(law) & (law.c == 0.0)


# ---------------------------------------------------------------- the linear law of the march's own blocks


@inlined
def state(u: float, g1: float, g2: float) -> float:
    """chi: +1 beyond g2, -1 beyond g1, else 0."""
    return 1.0 if u > g2 else (-1.0 if u < g1 else 0.0)


@inlined
def depth(u: float, g1: float, g2: float) -> float:
    """u - clip(u, g1, g2): > 0 into the upper stop, < 0 into the lower."""
    return u - g2 if u > g2 else (u - g1 if u < g1 else 0.0)


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


# ---------------------------------------------------------------- any law between two stops


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
def force_of_node(u: float, v: float, node_force: float, law: Law) -> float:
    """F at the end of a step whose node found ``node_force``, NaN for none.

    Where c > 0 the force jumps at d = 0. A node may end there, on the stop to rounding, under any force up to c u':
    its state does not tell which.
    """
    return law_force(u, v, law) if math.isnan(node_force) or not jumps(law) else node_force


@compiled
def state_of_node(u: float, v: float, node_force: float, law: Law) -> float:
    """chi there: where c > 0 the stop presses where a force was found."""
    if math.isnan(node_force) or not jumps(law):
        return law_state(u, v, law)
    return 0.0 if node_force == 0.0 else math.copysign(1.0, -node_force)


@compiled
def law_energy(u: float, law: Law) -> float:
    """U at position u."""
    return stored(depth(u, law.g1, law.g2), law)


@compiled
def elastic_force(u: float, law: Law) -> float:
    """-U'(u); F less it is what dissipates."""
    return -elastic(depth(u, law.g1, law.g2), law)


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
    if jumps(law):
        return pressure(d, rate, law) / chord(length, law)
    return length * (1.0 + law.lam * rate)  # f, which is zero on the stop itself, left out


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
    in the jump and the node stays on the stop. By Newton's method from P = 0: |F| is convex along the line that the
    node takes, so the iterates rise to the root; an affine law ends at the first.
    """
    if not d0 > 0.0:
        return 0.0, 0.0, 0.0
    # Linear in depth and rate: one division.
    if is_affine(law):
        to_depth, to_rate = slopes(d0, rate0, law)
        below = 1.0 + to_depth * s + to_rate * s_rate
        P, slope, slope_rate = pressure(d0, rate0, law) / below, to_depth / below, to_rate / below
        if not P > 0.0:
            return (0.0, 0.0, 0.0) if P <= 0.0 else (P, slope, slope_rate)  # NaN stays NaN
    else:
        # Any other law: Newton's method inside a bracket of P.
        if pressure(d0, rate0, law) <= 0.0:
            return 0.0, 0.0, 0.0
        P, left = 0.0, 0.0
        right = pressure(d0, rate0, law)
        # A larger force would move the node off the stop, where none acts.
        if s * right > d0:
            right = d0 / s
        slope = slope_rate = 0.0
        for _ in range(NEWTON):
            d, rate = d0 - s * P, rate0 - s_rate * P
            trial = pressure(d, rate, law)
            to_depth, to_rate = slopes(d, rate, law)
            below = 1.0 + s * to_depth + s_rate * to_rate
            slope, slope_rate = to_depth / below, to_rate / below
            # |F| at the trial falls as P grows, which gives the side of the root.
            if trial > P:
                left = P
            else:
                right = P
            new = P + (trial - P) / below
            # In exact arithmetic the iterates rise to the root. A step that rounding throws out becomes a bisection.
            if not left <= new <= right:
                new = 0.5 * (left + right)
            change, P = abs(new - P), new
            # The change is the rounding of P.
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
