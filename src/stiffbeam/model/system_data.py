"""All numbers of a system as arrays, and their derivatives with respect to a parameter.

    theta -> (M, C, K, rows, stops, loads, offsets, q0, v0)

The derivative is a central difference of order 8, at the end of a parameter's range a one-sided one of order 4; its
distance to a difference of lower order is its bound. Most data are linear or quadratic in a parameter; then both are
exact at any width. Only the data are differenced, never a motion.
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

WIDTHS = tuple(2.0**-k for k in (2, 5, 8, 12, 16, 20, 24))  # steps of differences, of the parameter
# Weights of the changes over 1 to 4 steps, by the sides on which there are systems: of orders 8 and 6, or 4 and 3.
WEIGHTS = {
    2: np.array([[4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0], [3.0 / 4.0, -3.0 / 20.0, 1.0 / 60.0, 0.0]]),
    1: np.array([[4.0, -3.0, 4.0 / 3.0, -1.0 / 4.0], [3.0, -1.5, 1.0 / 3.0, 0.0]]),
}
EXACT = 1e-12  # relative: differences that agree to that are taken
ROUNDING = 64.0 * float(np.finfo(float).eps)  # of an array's numbers, in their differences
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

    def zeros(self) -> SystemData:
        """Derivative of data that do not depend on a parameter."""
        return self.of_vector(np.zeros(len(self.vector())))


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
    finite = lambda g: g if np.isfinite(g) else 0.0  # noqa: E731
    harmonics = [(f.amplitude, f.frequency, f.phase) for f in terms if isinstance(f, Harmonic)]
    records = [f.taylor(f.t[:-1]) for f in terms if isinstance(f, Sampled)]
    return SystemData(
        mass=system.mass,
        damping=system.damping,
        stiffness=system.stiffness,
        rows=np.array([contact.row for contact in system.contacts]).reshape(m, n),
        kappa=np.array([0.0 if s.rigid else float(s.stiffness) for s in stops]),
        c=np.array([float(s.damping) for s in stops]),
        lower=np.array([finite(s.lower_bound) for s in stops]),
        upper=np.array([finite(s.upper_bound) for s in stops]),
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
    sides = [([side for side, _ in c.stops.sides], c.stops.rigid) for c in system.contacts]
    return [*kinds, *sides, system.size]


def slopes(system: System, wrt: Sequence[Any]) -> tuple[list[str], list[SystemData], Array]:
    """Names of the columns, derivatives of the data in each, and their relative bounds (columns,).

    wrt: paths as ``varied_members`` takes them; "initial_displacement" and "initial_velocity" alone are all their n
    entries, named q0[i] and v0[i]; a pair ("stiffness", dK) is a direction in which a matrix changes. Raises InputError
    for a path that the system does not have, and for a parameter in which its data have no derivative.
    """
    base = data_of(system)
    found: list[tuple[str, SystemData, float]] = []
    for path in wrt:
        if not isinstance(path, str):
            found.append((f"{path[0]} along a direction", _along(system, base, *path), 0.0))
            continue
        start = re.fullmatch(r"(q0|v0)(?:\[(\d+)\])?", VECTORS.get(path, path))
        if not start or (start[2] and int(start[2]) >= system.size):
            found.append((path, *_slope(system, base, path)))
            continue
        # Initial data: the derivative is a unit vector, exact.
        for i in range(system.size) if start[2] is None else [int(start[2])]:
            unit = base.zeros()
            getattr(unit, start[1])[i] = 1.0
            found.append((f"{start[1]}[{i}]", unit, 0.0))
    return [x for x, _, _ in found], [x for _, x, _ in found], np.array([x for _, _, x in found])


def _along(system: System, base: SystemData, name: str, direction: Any) -> SystemData:
    """Derivative of the data ``base`` as a matrix of the system changes along a direction (n, n)."""
    one_of("wrt", name, ("mass", "damping", "stiffness"))
    matrix = numbers("wrt", direction)
    if matrix.shape != base.mass.shape or not (name == "damping" or np.array_equal(matrix, matrix.T)):
        rule = f"be along a matrix {system.size} x {system.size}, symmetric but for damping"
        raise InputError("wrt", f"{name} along shape {matrix.shape}", rule, 'for example ("stiffness", K1 - K0)')
    column = base.zeros()
    getattr(column, name)[:] = matrix
    return column


def _slope(system: System, base: SystemData, path: str) -> tuple[SystemData, float]:
    """Derivative of the data ``base`` of a system at a path, and its relative bound.

    Raises InputError where the system beside it has other terms.
    """
    try:
        value = value_at(system, path)
    except (LookupError, TypeError):
        with_values(system, {path: 1.0})  # which says what is wrong with the path
        # A path such as "stops.stiffness" may stand for contacts with different values: no common derivative.
        rule = "be a number, and one value where it stands for several"
        raise InputError("wrt", path, rule, "name one of them, stops[0]") from None
    structure = _structure(system)
    scale, centre = abs(value) if value else 1.0, base.vector()

    def secants(step: float) -> Array:
        """Changes of the data over 1 to 4 steps, per step."""
        members = [with_values(system, {path: value + k * step}) for k in range(1, 5)]
        if any(_structure(member) != structure for member in members):
            rule = "keep the terms of the loads, the observed points, the times of samples and the sides of the stops"
            raise InputError("wrt", path, rule, "take a value beside it, or another parameter")
        return (np.array([data_of(member).vector() for member in members]) - centre) / step

    def largest(numbers: Array) -> Array:
        sizes = vars(base.of_vector(numbers)).values()
        return np.concatenate([np.full(x.size, np.max(np.abs(x), initial=1e-300)) for x in sizes])

    found, error, bound = centre, np.inf, np.inf
    problem: InputError | None = None
    # Widest first: the rounding of a difference falls as the width grows.
    for width in WIDTHS:
        sides = []
        for way in (1.0, -1.0):
            try:
                sides.append(secants(way * width * scale))
            except InputError as refused:
                # Outside the range of the parameter there is no system: a narrower width may fit, or one side alone.
                # What is wrong inside the range tells more than where it ends.
                problem = refused if problem is None or refused.field == "wrt" else problem
        if not sides:
            continue
        slope, other = WEIGHTS[len(sides)] @ sum(sides)
        # At a kink, such as a node of linear elements, all symmetric differences agree on the mean of its two slopes.
        kink = WEIGHTS[1][0] @ (sides[0] - sides[-1])
        # Each array by its own largest slope: a stiffness may have a far larger one than a row. Beside rounding.
        rounding = ROUNDING * largest(centre) / (width * scale)
        size = np.maximum(largest(slope), rounding)
        off, bend = (float(np.max((np.abs(x) - rounding) / size, initial=0.0)) for x in (slope - other, kink))
        if max(off, bend) < error:
            found, error, bound = slope, max(off, bend), max(off, float(np.finfo(float).eps) / width)
        if error <= EXACT:
            break
    if np.isinf(error) and problem is not None:
        raise problem
    if error > SMOOTH:
        rule = f"be a parameter in which the system's data are smooth (two differences disagree by {error:.1g})"
        raise InputError("wrt", path, rule, "take a value beside it, or another parameter")
    return base.of_vector(found), bound
