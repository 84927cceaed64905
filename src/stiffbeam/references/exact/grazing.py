"""Grazings along a branch of orbits: touches of a contact that are born or die, and the distance from such a birth."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ...piecewise.tangent import Tangent

FAR = 0.1  # of the distance between two points: how far from the second one goes on
SAMPLES = 401  # of a period, among which gaps turn
TURNS = 12  # iterations of the time at which a gap turns


def events(tangent: Tangent) -> list[tuple[float, int, int, int]]:
    """(time, contact, side before, side after) of every event of a period."""
    path = tangent.path
    steps = np.argwhere(path.sides[1:] != path.sides[:-1]).tolist()
    return [(float(path.times[i + 1]), c, int(path.sides[i, c]), int(path.sides[i + 1, c])) for i, c in steps]


def shallowest(tangent: Tangent, contact: int) -> list[tuple[float, int]]:
    """The middles and stops of the short touches and gaps of a contact, the shallowest first."""
    touches = [event for event in events(tangent) if event[1] == contact]
    touched = []
    for (t, _, before, during), (later, _, _, after) in pairwise(touches):
        if before == after and 0 in (before, during):
            side = during or before
            touched.append((abs(_gap(tangent, contact, side, 0.5 * (t + later))[0]), 0.5 * (t + later), side))
    return [(t, side) for _, t, side in sorted(touched)]


def _gap(tangent: Tangent, contact: int, side: int, t: float) -> tuple[float, float, float]:
    """A gap with its first and second derivatives at a time."""
    form = tangent.generators.gap(contact, int(np.sign(side)), 0)[0]
    i = int(tangent.segment_at(np.array([t]))[0])
    Z = tangent.regimes[i].ahead(tangent.Z[i][:, None], t - float(tangent.path.times[i]))[:, 0]
    rate = tangent.regimes[i].A @ Z
    return float(form @ Z), float(form @ rate), float(form @ (tangent.regimes[i].A @ rate))


def turn(tangent: Tangent, contact: int, side: int, t: float) -> float:
    """The gap where it turns near a time."""
    gap, rate, bend = _gap(tangent, contact, side, t)
    for _ in range(TURNS):
        if not bend:
            break
        t = float(np.clip(t - rate / bend, 0.0, tangent.path.t_end))
        gap, rate, bend = _gap(tangent, contact, side, t)
        if rate * rate <= 1e-24 * abs(bend * gap):
            break
    return gap


def rigid_grazing(values: Sequence[float], seen: Sequence[tuple[float, float]], near: float) -> float | None:
    """The parameter, ``near`` the last point, at which the weakest impact or the smallest distance from a stop vanishes
    if it goes on along the points. seen: both at each, see ``distances``. Close points have only rounding."""
    for which in (0, 1):
        b = seen[-1][which]
        for value, a in ((x, y[which]) for x, y in zip(values[-2::-1], seen[-2::-1], strict=True)):
            if not (np.isfinite(a) and b < a):
                continue
            ahead = b * (values[-1] - value) / (a - b)
            if abs(ahead) < FAR * abs(values[-1] - value):
                if abs(ahead) < near:
                    return values[-1] + ahead
                break
    return None


def distances(tangent: Tangent) -> tuple[float, float]:
    """The impulse of the weakest impact, and the smallest distance from a stop where a gap turns."""
    generators, t = tangent.generators, np.linspace(0.0, tangent.path.t_end, SAMPLES)
    impulses = [abs(x[0]) for of_segment in tangent.impulses.values() for x in of_segment.values()]
    turns = []
    for c, contact in enumerate(generators.system.contacts):
        for side, _ in contact.stops.sides:
            form = generators.gap(c, side, 0)[0]
            distance = -side * tangent.values(lambda _, form=form: (form[None], []), t, tangent.segment_at(t))[:, 0]
            inner = distance[1:-1]
            lowest = np.flatnonzero((inner < distance[:-2]) & (inner < distance[2:])) + 1
            turns += [abs(turn(tangent, c, side, float(t[i]))) for i in lowest]
    return min(impulses, default=np.inf), min(turns, default=np.inf)
