"""Newton's law where contacts close together, and the method that finds which of them take part.

    0 <= P _|_ U+ + e U- >= 0,   U+ = U- + A P,   A = row M^-1 row^T

towards the inside. A is positive definite, so that there is one answer, and Murty's least-index method ends with it:
change the first contact that violates its condition, again and again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from flint import arb, arb_mat

from .first_zero import Undecided
from .linear_flow import LinearFlow

MOST_CHANGES = 10_000


def least_index(start: set[int], violated: Callable[[set[int]], Iterable[int]]) -> set[int]:
    """The set that violates nothing; ``violated`` names what a set does violate. Raises Undecided for no end."""
    taking = set(start)
    for _ in range(MOST_CHANGES):
        wrong = min(violated(taking), default=None)
        if wrong is None:
            return taking
        taking ^= {wrong}
    raise Undecided


def newton(
    flow: LinearFlow, e: list[Any], closed: dict[int, int], before: dict[int, Any]
) -> tuple[dict[int, Any], dict[int, Any]]:
    """P of the contacts that take part, and U+ - U- of all ``closed`` (contact: side), U- = ``before``, as balls."""
    wanted = {c: -(1 + e[c]) * before[c] for c in closed}

    def violated(taking: set[int]) -> Iterable[int]:
        P, jump = solve(flow, taking, wanted, closed)
        for c, side in closed.items():
            if side * P[c] > 0 if c in taking else side * (jump[c] - wanted[c]) > 0:
                yield c

    taking = least_index(set(closed), violated)
    P, jump = solve(flow, taking, wanted, closed)
    return {c: P[c] for c in taking if not P[c].contains(0)}, jump


def solve(flow: LinearFlow, taking: set[int], wanted: dict[int, Any], closed: Iterable[int]) -> tuple[Any, Any]:
    """Impulses that change the velocities of ``taking`` as ``wanted``, and the changes of all ``closed``, as balls."""
    at = tuple(sorted(taking))
    noise = (sum((abs(x) for x in wanted.values()), arb(0)) * arb(2) ** -flow.bits).mid()
    P = dict.fromkeys(closed, arb(0))
    if at:
        solved = flow.among(at).solve(arb_mat([[wanted[c]] for c in at])).entries()
        for c, x in zip(at, solved, strict=True):
            P[c] = arb(x.mid(), (noise / flow.compliance[c, c]).mid())
    jump = {c: arb(sum((flow.compliance[c, k] * P[k].mid() for k in at), arb(0)).mid(), noise) for c in closed}
    return P, jump
