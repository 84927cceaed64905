"""All numbers of a system as arrays, and their derivatives with respect to a parameter.

    theta -> (M, C, K, rows, stops, loads, offsets, q0, v0)

Only the data are differenced, never a motion. Most are linear or quadratic in a parameter, of which differences are
exact at any width.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, numbers, one_of
from .members import value_at, with_values
from .system import System
from .time_functions import Constant, Harmonic, LoadFunction, Sampled, leaves, parts

WIDTHS = (2.0**-4, 2.0**-12, 2.0**-18)  # steps, of the parameter: for linear data, smooth ones, and beside a kink
# Weights of the slopes over 1 to 4 steps for the slope over none, by a cubic and by a quadratic.
TO_NO_STEP = np.array([[4.0, -6.0, 4.0, -1.0], [3.0, -3.0, 1.0, 0.0]])
EXACT = 1e-12  # relative: differences that agree to that are taken
EPS = float(np.finfo(float).eps)
ROUNDING = 64.0 * EPS  # of an array's numbers, in their differences
SMOOTH = 1e-6  # relative bound above which a dependence counts as not smooth
VECTORS = {"initial_displacement": "q0", "initial_velocity": "v0"}


class SystemData(SimpleNamespace):
    """Numbers of a system, or their derivatives in a parameter, n unknowns, m contacts: arrays by name.

    mass, damping, stiffness: (n, n). rows: (m, n). kappa, c, restitution: (m,). lower, upper: (m,), 0 for a side
    without stop. observe: (n,), zero where the first contact is the tip. loads: (L, n), one vector for each term of a
    load. harmonics: (H, 3), amplitude, frequency and phase of each harmonic term, of loads and then of offsets.
    constants: (k,). records: (pieces, 4) of all records, one below the other. factors: (F,), of the terms of offsets.
    q0, v0: (n,).
    """

    def vector(self) -> Array:
        """All numbers as one vector."""
        return np.concatenate([array.ravel() for array in vars(self).values()])

    def of_vector(self, numbers: Array) -> SystemData:
        """Arrays of the same shapes with the numbers of a vector."""
        ends = np.cumsum([array.size for array in vars(self).values()])
        pieces = zip(vars(self).items(), np.split(numbers, ends), strict=False)
        return SystemData(**{name: piece.reshape(old.shape) for (name, old), piece in pieces})

    def along(self, name: str, direction: Array) -> SystemData:
        """Derivative of the data as one array changes along a direction."""
        return SystemData(**{x: direction if x == name else np.zeros_like(y) for x, y in vars(self).items()})


def offset_terms(system: System) -> list[tuple[int, float, LoadFunction]]:
    """(contact, factor, leaf) of every term of every offset."""
    return [(i, x, leaf) for i, contact in enumerate(system.contacts) for x, leaf in parts(contact.offset)]


def data_of(system: System) -> SystemData:
    """The numbers of a system. Raises InputError for functions of time that are not in closed form."""
    n, m = system.size, len(system.contacts)
    loads, offsets = system.load_terms, offset_terms(system)
    terms = leaves(*system.time_functions)
    system.drive.require_closed_form("a derivative")
    stops = [contact.stops for contact in system.contacts]
    harmonics = [(f.amplitude, f.frequency, f.phase) for f in terms if isinstance(f, Harmonic)]
    records = [f.taylor(f.t[:-1]) for f in terms if isinstance(f, Sampled)]
    return SystemData(
        mass=system.mass,
        damping=system.damping,
        stiffness=system.stiffness,
        rows=np.array([contact.row for contact in system.contacts]).reshape(m, n),
        kappa=np.array([0.0 if s.rigid else float(s.stiffness) for s in stops]),
        c=np.array([float(s.damping) for s in stops]),
        lower=np.array([s.sides.get(-1, 0.0) for s in stops]),
        upper=np.array([s.sides.get(1, 0.0) for s in stops]),
        restitution=np.array([s.restitution or 0.0 for s in stops], float),
        observe=np.zeros(n) if system.observe is None else system.observe,
        loads=np.array([vector for vector, _ in loads]).reshape(len(loads), n),
        factors=np.array([factor for _, factor, _ in offsets], float),
        harmonics=np.array(harmonics, float).reshape(-1, 3),
        constants=np.array([f.level for f in terms if isinstance(f, Constant)], float),
        records=np.concatenate(records) if records else np.zeros((0, 4)),
        q0=system.q0,
        v0=system.v0,
    )


def _structure(system: System) -> list[object]:
    """All data of a system that are not numbers. With respect to these there is no derivative."""
    terms = leaves(*system.time_functions)
    kinds = [(type(f), f.t.tobytes(), f.degree) if isinstance(f, Sampled) else type(f) for f in terms]
    laws = [(c.stops.law.p, c.stops.law.lam, c.stops.rigid) for c in system.contacts]
    return [*kinds, *laws, *(list(c.stops.sides) for c in system.contacts), system.size]


def slopes(system: System, wrt: Sequence[Any]) -> tuple[list[str], list[SystemData], Array]:
    """Names of the columns, derivatives of the data in each, and their relative bounds (columns,).

    wrt: paths as ``varied_members`` takes them; "initial_displacement" and "initial_velocity" alone are all their n
    entries, named q0[i] and v0[i]; a pair ("stiffness", dK) is a direction in which a matrix changes. Raises InputError
    for a path that the system does not have, and for a parameter in which its data have no derivative.
    """
    base, n = data_of(system), system.size
    found: list[tuple[str, SystemData, float]] = []
    for path in wrt:
        start = re.fullmatch(r"(q0|v0)(?:\[(\d+)\])?", VECTORS.get(path, path)) if isinstance(path, str) else None
        if not isinstance(path, str):
            found.append((f"{path[0]} along a direction", base.along(path[0], _direction(n, *path)), 0.0))
        elif start and int(start[2] or 0) < n:
            entries = range(n) if start[2] is None else [int(start[2])]
            found += [(f"{start[1]}[{i}]", base.along(start[1], np.eye(n)[i]), 0.0) for i in entries]
        else:
            found.append((path, *_slope(system, base, path)))
    return [x for x, _, _ in found], [x for _, x, _ in found], np.array([x for _, _, x in found])


def _direction(n: int, name: str, direction: Any) -> Array:
    """The direction (n, n) in which a matrix of the system changes."""
    one_of("wrt", name, ("mass", "damping", "stiffness"))
    matrix = numbers("wrt", direction)
    if matrix.shape != (n, n) or not (name == "damping" or np.array_equal(matrix, matrix.T)):
        rule = f"be along a matrix {n} x {n}, symmetric but for damping"
        raise InputError("wrt", f"{name} along shape {matrix.shape}", rule, 'for example ("stiffness", K1 - K0)')
    return matrix


def _slope(system: System, base: SystemData, path: str) -> tuple[SystemData, float]:
    """Derivative of the data ``base`` of a system at a path, and its relative bound.

    The mean of one-sided differences of order 4 on both sides, and their distance; at the end of a parameter's range
    that of one side, and its distance to order 3.
    """
    try:
        value = value_at(system, path)
    except (LookupError, TypeError):
        with_values(system, {path: 1.0})  # which says what is wrong with the path
        # A path such as "stops.stiffness" may stand for contacts with different values: no common derivative.
        rule = "be a number, and one value where it stands for several"
        raise InputError("wrt", path, rule, "name one of them, stops[0]") from None
    if not np.isfinite(value):
        raise InputError("wrt", path, "be finite: a rigid stop has no stiffness", "take another parameter")
    scale, centre = abs(value) or 1.0, base.vector()

    def numbers_at(x: float) -> Array:
        """The data with the parameter at x, NaN outside its range. InputError where they have other terms."""
        try:
            member = with_values(system, {path: x})
        except InputError:
            return np.full(len(centre), np.nan)
        if _structure(member) != _structure(system):
            rule = "keep the terms of the loads, the observed points, times of samples, sides and exponents of stops"
            raise InputError("wrt", path, rule, "take a value beside it, or another parameter")
        return data_of(member).vector()

    def largest(numbers: Array) -> Array:
        """Largest of its array, for each number: a stiffness may have a far larger slope than a row."""
        sizes = vars(base.of_vector(numbers)).values()
        return np.concatenate([np.full(x.size, np.max(np.abs(x), initial=1e-300)) for x in sizes])

    found, error = centre, np.inf
    for width in WIDTHS:
        steps = value + width * scale * np.array([[1, 2, 3, 4], [-1, -2, -3, -4]]) - value  # as they are rounded
        changes = np.array([[numbers_at(value + x) for x in side] for side in steps.tolist()]) - centre
        sides = TO_NO_STEP @ (changes / steps[..., None])  # (2, orders 4 and 3, numbers)
        sides = sides[np.all(np.isfinite(sides), axis=(1, 2))]
        if not len(sides):
            continue
        # At a kink, such as a node of linear elements, the two sides differ.
        slope, off = np.mean(sides[:, 0], axis=0), sides[0, 0] - (sides[1, 0] if len(sides) == 2 else sides[0, 1])
        rounding = ROUNDING * largest(centre) / (width * scale)
        apart = np.max((np.abs(off) - rounding) / np.maximum(largest(slope), rounding), initial=EPS / width)
        if apart < error:
            found, error = slope, float(apart)
        if error <= EXACT:
            break
    if np.isinf(error):
        with_values(system, {path: value + WIDTHS[-1] * scale})  # which says what is wrong with it
    if error > SMOOTH:
        rule = f"be a parameter in which the system's data are smooth (two differences disagree by {error:.1g})"
        raise InputError("wrt", path, rule, "take a value beside it, or another parameter")
    return base.of_vector(found), error
