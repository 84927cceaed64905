"""Events of stops with damping in the exact solution: unilateral Kelvin-Voigt, F = -(kappa d + c d')_+, piecewise
linear.

A contact is short of its stop (side 0), pressed (+-1), or beyond a stop that has let go (+-LET_GO). Of d, > 0 into
the stop, and y = d + (c/kappa) d', which has the sign of the force without its cut,

    0 -> 1    where d = 0: the force jumps to c d'          1 -> 2    where y = 0: no adhesion
    2 -> 1    where y = 0 again                             2 -> 0    where d = 0

Only the first event turns tangent vectors: a neighbour enters later by -(row dq)/d', without the force c d' until then,

    dq'+ = dq'- - c M^-1 row^T (row dq)

Source: the saltation matrix of Filippov's theory, as in di Bernardo et al., Piecewise-smooth Dynamical Systems (2008),
section 2.5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array
from ..basics.compiled import formula
from ..model.contact import Stops
from ..model.system import System

LET_GO = 2  # times the side: beyond a damped stop that does not press
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
SECTIONS = 40  # of the golden section: 4e-9 of two samples' distance, where the force is flat


def side_of(stops: Stops, u: float, velocity: float) -> int:
    """The side of a contact at u, as in the table above."""
    pressed = int(stops.state(u, velocity))
    return pressed if pressed else LET_GO * int(np.sign(stops.penetration(u))) if stops.dissipative else 0


def pressed(sides: ArrayLike) -> NDArray[np.int64]:
    """chi, 0 where nothing presses."""
    sides = np.asarray(sides, np.int64)
    return np.where(np.abs(sides) == LET_GO, 0, sides)


@formula
def next_side(old: int, met: int, force: bool) -> int:
    """The side after an event of a contact; met: the stop; force: True if y became 0, not d."""
    if old == 0:
        return met
    if not force:
        return 0
    # y = 0: a pressed contact lets go, one that has let go is pressed again.
    return LET_GO * old if abs(old) == 1 else old // LET_GO


def switched_by_force(old: int, new: int) -> bool:
    """Return True if y became 0."""
    return {abs(old), abs(new)} == {1, LET_GO}


def watched(sides: Sequence[int], lags: Array) -> list[tuple[int, float, int, bool]]:
    """Quantity that has to stay positive, (contact, lag, chi, own): d or y = d + lag d', as of a contact on chi.

    own: only the stop it is beyond counts. A contact that has let go is watched twice.
    """
    found = []
    for i, (side, lag) in enumerate(zip(sides, lags.tolist(), strict=True)):
        if abs(side) == LET_GO:
            # Past its stop without pressing: it leaves where d = 0 or presses again where y = 0.
            found += [(i, 0.0, side // LET_GO, False), (i, lag, 0, True)]
        else:
            found.append((i, lag if side else 0.0, side, False))
    return found


def entry(system: System, before: NDArray[np.int64], after: NDArray[np.int64], dq: Array, dv: Array) -> Array:
    """dq' (n, k) after an event from the sides ``before`` to those ``after`` (m,)."""
    # Only an entry makes the force jump: all other events leave tangent vectors as they are.
    for contact, old, new in zip(system.contacts, before.tolist(), after.tolist(), strict=True):
        if contact.stops.damping > 0.0 and old == 0 and new:
            kick = np.linalg.solve(system.mass, contact.row)
            dv = dv - float(contact.stops.damping) * np.outer(kick, contact.row @ dq)
    return dv


def pressure(stops: Stops, side: NDArray[np.int64], u: Array, velocity: Array) -> Array:
    """kappa d + c d' on the given sides, which are pressed: of size c d' at the entry too, where d is rounding."""
    depth = u - np.where(side > 0, stops.upper_bound, stops.lower_bound)
    return np.maximum(side * (float(stops.stiffness) * depth + float(stops.damping) * velocity), 0.0)


def peak_between(force: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """The largest value of ``force`` inside every [low, high], by the golden section."""
    for _ in range(SECTIONS):
        step = GOLDEN * (high - low)
        left, right = high - step, low + step
        rises = force(right) > force(left)
        low, high = np.where(rises, left, low), np.where(rises, high, right)
    return force(0.5 * (low + high))
