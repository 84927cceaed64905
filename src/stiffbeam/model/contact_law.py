"""The contact law for NumPy and JAX. ``kernels/law.h`` has it for C; a test holds both against each other.

    F = -(f(d) (1 + lambda d') + c d')_+,  f = kappa d^p,  into the upper stop, d = u - g2 > 0, mirrored below

U = int f dd is the energy that the stop holds; what F takes beyond -U' it dissipates. The force lets go where it would
turn to a pull.

The functions under "the terms" are arithmetic alone, on numbers, NumPy arrays or JAX arrays. A new term is a field of
``Stops``, its place in ``Law``, a change of these, and the same in C.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ..basics.arrays import Array

# Parameters beside the stiffness, in the order of ``Law``, each with its value in the linear law.
LINEAR = {"exponent": 1.0, "damping": 0.0, "dissipation": 0.0}


class Law(NamedTuple):
    """The parameters of the law in the form for kernels, with the stops g1 and g2. An array of laws has them in this
    order.

    Those after g2 stand in the order of ``LINEAR``.
    """

    kappa: float
    g1: float  # the lower stop, -inf for none
    g2: float
    p: float
    c: float
    lam: float


LAW = len(Law._fields)
KAPPA, G1, G2 = range(3)  # of a row, where the linear law alone is asked


def all_laws(law: Array) -> Law:
    """An array of laws (.., 6) as one Law of arrays (..)."""
    return Law._make(law[..., i] for i in range(LAW))


# ---------------------------------------------------------------- the terms


def power(d: Any, p: float) -> Any:
    """d^p for d > 0, odd in d, so that it goes on smoothly where a root is sought beyond the stop."""
    # The sign by arithmetic: this line runs on floats, NumPy arrays and JAX arrays.
    return d if p == 1.0 else (2.0 * (d >= 0.0) - 1.0) * abs(d) ** p


def elastic(d: Any, law: Law) -> Any:
    """f(d), odd in d."""
    return law.kappa * power(d, law.p)


def chord(d: Any, law: Law) -> Any:
    """f(d)/d of d > 0: the stiffness of a linear spring with the same force."""
    return law.kappa * d ** (law.p - 1.0)


def stored(d: Any, law: Law) -> Any:
    """U(d), even in d."""
    return 0.5 * law.kappa * d * d if law.p == 1.0 else law.kappa * abs(d) ** (law.p + 1.0) / (law.p + 1.0)


def depth_under(force: Any, law: Law) -> Any:
    """The depth at which f is ``force``."""
    return (force / law.kappa) ** (1.0 / law.p)


def depth_holding(energy: Any, law: Law) -> Any:
    """The depth at which U is ``energy``."""
    return ((law.p + 1.0) * energy / law.kappa) ** (1.0 / (law.p + 1.0))


def pressure(d: Any, rate: Any, law: Law) -> Any:
    """f(d) (1 + lambda d') + c d', not yet cut off at zero."""
    return elastic(d, law) * (1.0 + law.lam * rate) + law.c * rate


def jumps(law: Law) -> Any:
    """Return True where F jumps when the gap closes with a velocity other than zero: a state on the stop does not tell
    the force."""
    return law.c > 0.0


def damps(law: Law) -> Any:
    """Return True where F depends on the velocity."""
    return jumps(law) | (law.lam > 0.0)
