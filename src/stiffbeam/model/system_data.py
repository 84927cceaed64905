"""All numbers of a system as arrays, and their derivatives with respect to a parameter.

    theta -> (M, C, K, rows, stops, loads, offsets, q0, v0)

Most of these are linear or quadratic in a parameter; then central differences of any width are exact, and two widths
agree to rounding. Of the others a difference of order 8 is taken, and the distance to that of order 6 is its bound.
Only the data are differenced, never a motion.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from .members import value_at, with_values
from .sampled import Sampled
from .system import System
from .time_functions import Constant, Harmonic, LoadFunction, parts, require_closed_form

EXACT = 1e-13  # of the largest entry per width: two differences of a quadratic agree to that
WIDTHS = tuple(2.0**-k for k in (2, 5, 8, 12, 16))  # of the parameter: the largest at which the system exists
NARROW = tuple(2.0**-k for k in (6, 9, 12, 16, 20, 24))  # of the parameter, for data that are no quadratic
ORDER_8 = np.array([4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0])
ORDER_6 = np.array([3.0 / 4.0, -3.0 / 20.0, 1.0 / 60.0, 0.0])
ONE_SIDED = np.array([4.0, -3.0, 4.0 / 3.0, -1.0 / 4.0])  # of the values less that at the middle
SMOOTH = 1e-6  # relative bound above which a dependence counts as not smooth
OF_STOPS = re.compile(r"(?:contacts\[(\d+)\]\.stops|stops(?:\[(\d+)\])?)\.(lower|upper|stiffness|damping|restitution)")
DATA_OF_STOPS = {"stiffness": "kappa", "damping": "c"}  # names in SystemData, where they differ
VECTORS = {"initial_displacement": "q0", "initial_velocity": "v0"}


@dataclass(frozen=True, eq=False)
class SystemData:
    """Numbers of a system, or their derivatives in a parameter, n unknowns, m contacts.

    mass, damping, stiffness: (n, n). rows: (m, n). kappa, c, restitution: (m,). lower, upper: (m,), 0 for a side
    without stop. observe: (n,), zero where the first contact is the tip. loads: (L, n), one vector for each term of a
    load. harmonics: (H, 3), amplitude, frequency and phase of each harmonic term, of loads and then of offsets.
    constants: (k,). records: (pieces, 4) of all records, one below the other. factors: (F,), of the terms of offsets.
    """

    mass: Array
    damping: Array
    stiffness: Array
    rows: Array
    kappa: Array
    c: Array
    lower: Array
    upper: Array
    restitution: Array
    observe: Array
    loads: Array
    factors: Array
    harmonics: Array
    constants: Array
    records: Array
    q0: Array
    v0: Array

    def vector(self) -> Array:
        """All numbers as one vector."""
        return np.concatenate([getattr(self, x.name).ravel() for x in fields(self)])

    def of_vector(self, numbers: Array) -> SystemData:
        """Arrays of the same shapes with the numbers of a vector."""
        arrays, k = {}, 0
        for x in fields(self):
            old = getattr(self, x.name)
            arrays[x.name] = numbers[k : k + old.size].reshape(old.shape)
            k += old.size
        return SystemData(**arrays)

    def zeros(self) -> SystemData:
        """Derivative of data that do not depend on a parameter."""
        return self.of_vector(np.zeros(len(self.vector())))


def load_terms(system: System) -> list[tuple[Array, LoadFunction]]:
    """(vector, leaf) of every term of every load."""
    return [(factor * vector, leaf) for vector, f in system.loads for factor, leaf in parts(f)]


def offset_terms(system: System) -> list[tuple[int, float, LoadFunction]]:
    """(contact, factor, leaf) of every term of every offset."""
    return [(i, x, leaf) for i, contact in enumerate(system.contacts) for x, leaf in parts(contact.offset)]


def data_of(system: System) -> SystemData:
    """The numbers of a system. Raises InputError for functions of time that are not in closed form."""
    n, m = system.size, len(system.contacts)
    loads, offsets = load_terms(system), offset_terms(system)
    leaves = [leaf for _, leaf in loads] + [leaf for _, _, leaf in offsets]
    require_closed_form(leaves, "a derivative", "sample it with stiffbeam.Sampled")
    stops = [contact.stops for contact in system.contacts]
    finite = lambda g: g if np.isfinite(g) else 0.0  # noqa: E731
    harmonics = [(f.amplitude, f.frequency, f.phase) for f in leaves if isinstance(f, Harmonic)]
    records = [f.pieces for f in leaves if isinstance(f, Sampled)]
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
        constants=np.array([f.level for f in leaves if isinstance(f, Constant)], float),
        records=np.concatenate(records) if records else np.zeros((0, 4)),
        q0=system.q0,
        v0=system.v0,
    )


def _structure(system: System) -> list[object]:
    """All data of a system that are not numbers. With respect to these there is no derivative."""
    leaves = [leaf for _, leaf in load_terms(system)] + [leaf for _, _, leaf in offset_terms(system)]
    kinds = [(type(f), f.t.tobytes(), f.degree) if isinstance(f, Sampled) else type(f) for f in leaves]
    sides = [
        (np.isfinite(c.stops.lower_bound), np.isfinite(c.stops.upper_bound), c.stops.rigid) for c in system.contacts
    ]
    return [*kinds, *sides, system.size]


def slopes(system: System, wrt: Sequence[str]) -> tuple[list[str], list[SystemData], Array]:
    """Names of the columns, derivatives of the data in each, and their relative bounds (columns,).

    wrt: paths as ``varied_members`` takes them; "initial_displacement" and "initial_velocity" alone are all their n
    entries, named q0[i] and v0[i]. Raises InputError for a path that the system does not have, and for a
    parameter in which its data have no derivative.
    """
    base = data_of(system)
    names: list[str] = []
    columns: list[SystemData] = []
    bounds: list[float] = []
    for path in wrt:
        # Initial data: the derivative is a unit vector, exact.
        start = re.fullmatch(r"(q0|v0)(?:\[(\d+)\])?", VECTORS.get(path, path))
        if start and (start[2] is None or int(start[2]) < system.size):
            for i in range(system.size) if start[2] is None else [int(start[2])]:
                unit = base.zeros()
                getattr(unit, start[1])[i] = 1.0
                names.append(f"{start[1]}[{i}]")
                columns.append(unit)
                bounds.append(0.0)
        else:
            column, bound = _slope(system, base, path)
            names.append(path)
            columns.append(column)
            bounds.append(bound)
    return names, columns, np.array(bounds)


def _value(system: System, path: str) -> tuple[float, bool]:
    """The number at a path, of the drive's short names that of the first; and whether the path stands for it alone."""
    if path in ("frequency", "amplitude"):
        leaves = [leaf for _, leaf in load_terms(system)] + [leaf for _, _, leaf in offset_terms(system)]
        drives = [leaf for leaf in leaves if isinstance(leaf, Harmonic)]
        if system.problem is not None and isinstance(system.problem.base, Harmonic):
            drives = [system.problem.base]
        return float(getattr(drives[0], path)) if drives else 1.0, False
    try:
        return value_at(system, path), True
    except (LookupError, TypeError):
        return 0.0, False  # with_values says what is wrong with it, or the number is a text


def _slope(system: System, base: SystemData, path: str) -> tuple[SystemData, float]:
    """Derivative of the data at a path, and its relative bound."""
    value, alone = _value(system, path)
    if of_stops := OF_STOPS.fullmatch(path):
        index, name = of_stops[1] or of_stops[2], of_stops[3]
        which = list(range(len(system.contacts))) if index is None else [int(index)]
        # A number of stops is an entry of the data: the derivative is a unit vector, exact. Rigid ones have no damping.
        if (
            alone
            and np.isfinite(value)
            and (name != "damping" or not any(system.contacts[i].stops.rigid for i in which))
        ):
            unit = base.zeros()
            getattr(unit, DATA_OF_STOPS.get(name, name))[which] = 1.0
            return unit, 0.0
        system = replace(system, origin=None)  # no beam has to be made anew
    # A path such as "stops.stiffness" may stand for contacts with different values, which have no common derivative.
    if not alone and not np.allclose(
        data_of(with_values(system, {path: value})).vector(), base.vector(), rtol=1e-12, atol=0.0
    ):
        raise InputError("wrt", path, "have one value where it stands for several", "name one of them, stops[0]")
    return slope_of(lambda x: with_values(system, {path: x}), system, value, path, base)


def slope_of(
    make_system: Callable[[float], System], system: System, value: float, name: str, base: SystemData
) -> tuple[SystemData, float]:
    """Derivative of the data of ``make_system`` at a value, where they are those of ``system``, and its bound.

    base: the data of ``system``. Raises InputError where the system there has other terms.
    """
    structure = _structure(system)
    scale, centre, largest = abs(value) if value else 1.0, base.vector(), np.array([])

    def at(step: float) -> Array:
        member = make_system(value + step)
        if _structure(member) != structure:
            rule = "keep the terms of the loads, the observed points, the times of samples and the sides of the stops"
            raise InputError("wrt", name, rule, "take a value beside it, or another parameter")
        return data_of(member).vector()

    problem: InputError | None = None
    # Widest first: the rounding of a difference falls as the width grows.
    for width in WIDTHS:
        h = width * scale
        try:
            # The slope at the middle of three values, and that of the parabola through the outer one and a fourth.
            right, left, beyond = at(h), at(-h), at(2.0 * h)
            near = (right - left) / (2.0 * h)
            far = (beyond - centre) / (2.0 * h) - (right + left - 2.0 * centre) / h
        except InputError as error:
            # Outside the range of the parameter there is no system: a narrower width may fit.
            problem = error
            continue
        largest = np.maximum(np.abs(centre), h * np.abs(near)) / h
        # Both agree for data that are linear or quadratic: the difference is exact.
        if np.all(np.abs(near - far) <= EXACT * largest):
            return base.of_vector(near), float(np.finfo(float).eps / width)
        break
    else:
        # No width fits on both sides: the value is at the end of the range.
        return _one_sided(base, at, centre, scale, name, problem)
    # Data that are smooth only close to the value, as within an element, need narrower steps.
    bound = bend = np.inf
    for narrow in NARROW:
        # Four steps to each side, the last as far as the width at which the system exists.
        steps = np.arange(1, 5) * min(narrow, width / 4.0) * scale
        ahead, behind = (np.array([at(way * h) - centre for h in steps]) / steps[0] for way in (1.0, -1.0))
        best, other, kink = ORDER_8 @ (ahead - behind), ORDER_6 @ (ahead - behind), ONE_SIDED @ (ahead + behind)
        size = np.max(np.abs(best), initial=1e-300)
        bound = float(np.max(np.abs(best - other)) / size)
        # At a kink, such as a node of linear elements, all symmetric differences agree on the mean of its two slopes.
        bend = float(np.max(np.abs(kink)) / size)
        if max(bound, bend) <= SMOOTH:
            return base.of_vector(best), bound
    rule = f"be a parameter in which the system's data are smooth (two differences disagree by {max(bound, bend):.1g})"
    raise InputError("wrt", name, rule, "take a value beside it, or another parameter")


def _one_sided(
    base: SystemData, at: Callable[[float], Array], centre: Array, scale: float, path: str, problem: InputError | None
) -> tuple[SystemData, float]:
    """Derivative at the end of a parameter's range, where the data are linear or quadratic in it."""
    for direction in (1.0, -1.0):
        for width in WIDTHS:
            h = direction * width * scale
            try:
                # From one side, where three values are exact for a quadratic, and four check it.
                y = [centre, *(at(k * h) for k in (1, 2, 3))]
            except InputError as error:
                # What is wrong inside the range tells more than where it ends.
                problem = error if problem is None or error.field == "wrt" else problem
                continue
            slope = (-3.0 * y[0] + 4.0 * y[1] - y[2]) / (2.0 * h)
            other = (-11.0 * y[0] + 18.0 * y[1] - 9.0 * y[2] + 2.0 * y[3]) / (6.0 * h)
            largest = np.maximum(np.abs(centre), np.abs(y[3])) / abs(h)
            if np.all(np.abs(slope - other) <= 10.0 * EXACT * largest):
                return base.of_vector(slope), float(np.finfo(float).eps / width)
    if problem is not None:
        raise problem
    rule = "be a parameter in which the system's data are linear or quadratic at the end of its range"
    raise InputError("wrt", path, rule, "take a value inside the range")
