"""Uncertain parameters: members of an ensemble whose parameters are drawn from tolerances and distributions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import afford
from ..basics.validation import InputError, integer, near, number, positive
from .members import EnsembleMembers, members_of, value_at, varied_members
from .system import System, require_system

KINDS = ("tolerance", "deviation", "between")


@dataclass(frozen=True)
class Uncertain:
    """Distribution of one parameter with the nominal value x, by one of these arguments:

        tolerance = r       uniform in x (1 - r), x (1 + r)
        deviation = s       normal, mean x and standard deviation s |x|
        between = (a, b)    uniform in a, b

    Parameters
    ----------
    tolerance, deviation : float, optional
        Relative to x, positive; a tolerance is below 1.
    between : (float, float), optional
        Two values in the parameter's own unit, for example of a phase, whose nominal value may be 0.

    Raises
    ------
    InputError
        If none or several are given, and for numbers that state no distribution.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.Uncertain(tolerance=0.1)
    Uncertain(tolerance=0.1)
    """

    tolerance: float | None = None
    deviation: float | None = None
    between: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        stated = [name for name in KINDS if getattr(self, name) is not None]
        if len(stated) != 1:
            remedy = "for example tolerance=0.01, 1 % of the value to either side"
            raise InputError("uncertain", " and ".join(stated) or None, f"state one of {', '.join(KINDS)}", remedy)
        # A tolerance of 1 or more would let a value reach zero or change its sign.
        if self.tolerance is not None and not positive("tolerance", self.tolerance) < 1.0:
            raise InputError("tolerance", self.tolerance, "be below 1, relative to the value", "1 % is 0.01")
        for name in ("tolerance", "deviation"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, float(positive(name, getattr(self, name))))
        if self.between is not None:
            ends = self.between
            if not isinstance(ends, (tuple, list)) or len(ends) != 2:
                raise InputError("between", ends, "be two numbers", "for example between=(0.0, 6.283)")
            low, high = (number("between", x) for x in ends)
            if not low < high:
                raise InputError("between", ends, "be two increasing numbers", "write the lower one first")
            object.__setattr__(self, "between", (float(low), float(high)))

    def __repr__(self) -> str:
        kind = self.kind
        return f"Uncertain({kind}={getattr(self, kind)!r})"

    @property
    def kind(self) -> str:
        """Name of the argument that was given: "tolerance", "deviation" or "between"."""
        return next(name for name in KINDS if getattr(self, name) is not None)

    @property
    def text(self) -> str:
        """The distribution in words: "±1 %"."""
        if self.between is not None:
            return f"{self.between[0]:g} to {self.between[1]:g}"
        return f"±{100 * self.tolerance:g} %" if self.tolerance else f"deviation {100 * (self.deviation or 0.0):g} %"

    def draw(self, rng: np.random.Generator) -> float:
        """A random value: a factor on the nominal value, or the value itself for ``between``."""
        if self.between is not None:
            return float(rng.uniform(*self.between))
        if self.tolerance is not None:
            return float(rng.uniform(1.0 - self.tolerance, 1.0 + self.tolerance))
        assert self.deviation is not None
        return float(rng.normal(1.0, self.deviation))


def uncertain_members(
    system: System | Callable[[dict[str, float]], System],
    parameters: Mapping[str, Uncertain | float],
    members: int,
    seed: int = 1,
    nominal: Mapping[str, float] | None = None,
) -> EnsembleMembers:
    """Members whose parameters are drawn independently of each other, for ``integrate_ensemble`` and
    ``reference_ensemble``.

    Parameters
    ----------
    system : System or function
        A function takes a dictionary of the drawn values and returns a System, for matrices of your own; its systems
        have one size.
    parameters : mapping of path to Uncertain or number
        Paths as in ``varied_members``: of a beam "stiffness", "mass_per_length", "viscosity", "stops[0].upper",
        "stops[0].position", "loads[0].time.scale", "loads[0].time.phase", of matrices "stiffness.scale". A number is a
        tolerance. "stops.stiffness", without an index, is one draw for all contacts: a common factor on their values.
    members : int
    seed : int
        Members k are the first k of any larger ensemble.
    nominal : mapping of name to value, optional
        Nominal values of the parameters of a function.

    Returns
    -------
    EnsembleMembers
        ``values`` are the draws, (members, parameters), in the order of ``parameters``: factors, or the values of
        ``between``. Members that share their matrices march side by side, others one by one.

    Raises
    ------
    InputError
        For a path that the system does not have, and a tolerance of a value that is 0.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> members = sb.uncertain_members(system, {"stiffness": 0.001, "stops.stiffness": 0.1}, 8)
    >>> many = sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, 0.1, members)
    >>> len(many.impact_count)
    8
    """
    integer("members", members, 1)
    integer("seed", seed, 0)
    known = _checked(parameters)
    draws = _draws(known, members, seed)
    if not isinstance(system, System):
        return _built(system, known, draws, nominal or {})
    require_system(system)
    if nominal is not None:
        raise InputError("nominal", nominal, "be left out with a System, which has its values", "leave it out")
    afford("members", members, "take fewer", floats=4.0 * members * system.size * (system.size + 20))
    # One column of values for each number, though one draw may stand for several.
    columns: dict[str, Array] = {}
    for (path, one), drawn in zip(known.items(), draws.T, strict=True):
        for place in _places(system, path):
            if place in columns:
                raise InputError("uncertain", path, "name each number once", f"{place} has a distribution already")
            columns[place] = drawn if one.between is not None else drawn * _nominal(system, place, one)
    try:
        members_drawn = varied_members(system, columns)
    except InputError as error:
        if error.field == "parameter":  # a path that is none
            raise
        remedy = "its distribution draws such values: narrow it, or state it between two"
        raise InputError(error.field, error.value, error.rule, remedy) from None
    return EnsembleMembers(system, ", ".join(known), draws, members_drawn.fields)


def _checked(parameters: Mapping[str, Uncertain | float]) -> dict[str, Uncertain]:
    if not isinstance(parameters, Mapping) or not parameters:
        remedy = 'for example {"stops.stiffness": 0.1}'
        raise InputError("uncertain", parameters, "name at least one parameter by its path", remedy)
    known: dict[str, Uncertain] = {}
    for path, one in parameters.items():
        try:
            known[path] = one if isinstance(one, Uncertain) else Uncertain(tolerance=one)
        except InputError as error:
            raise InputError(f"uncertain {path}: {error.field}", error.value, error.rule, error.remedy) from None
    return known


def _draws(known: Mapping[str, Uncertain], members: int, seed: int) -> Array:
    """(members, parameters); a stream for each member, so that more members leave the first ones as they are."""
    streams = [np.random.default_rng([seed, i]) for i in range(members)]
    return np.array([[one.draw(rng) for one in known.values()] for rng in streams])


def _places(system: System, path: str) -> list[str]:
    """The paths to the numbers of a path: "stops.stiffness" is that of every contact, where it has one."""
    first, _, rest = path.partition(".")
    if first != "stops" or not rest:
        return [path]
    places = [f"stops[{i}].{rest}" for i in range(len(system.contacts))]
    return [place for place in places if _value(system, place) is not None] or [path]


def _value(system: System, path: str) -> float | None:
    try:
        return value_at(system, path)
    except LookupError:
        return None


def _nominal(system: System, path: str, one: Uncertain) -> float:
    if path in ("frequency", "amplitude"):
        remedy = f"name it by its path, for example base.{path} or loads[0].time.{path}"
        raise InputError("uncertain", path, "be the path to one number", remedy)
    value = _value(system, path)
    if value is None:
        varied_members(system, {path: [1.0]})  # which lists the paths that there are, where it is none
        raise InputError("uncertain", path, "have a value that a tolerance is relative to", "state it between two")
    if value == 0.0 or not np.isfinite(value):
        remedy = "state it between two values, or leave it out"
        raise InputError(f"uncertain {path}", value, f"be finite and not 0 for a {one.kind}", remedy)
    return value


def _built(
    build: Callable[[dict[str, float]], System],
    known: Mapping[str, Uncertain],
    draws: Array,
    nominal: Mapping[str, Any],
) -> EnsembleMembers:
    """Members that a function builds, and the one of the nominal values as their system."""
    if not callable(build):
        raise InputError("system", type(build).__name__, "be a System or a function that builds one", "pass a System")
    wanted = [name for name, one in known.items() if one.between is None]
    for name in nominal:
        if name not in known:
            raise InputError("nominal", name, "be of an uncertain parameter", near(name, list(known)))
    for name in wanted:
        if name not in nominal:
            remedy = f"pass nominal={{{name!r}: ...}}, or state it between two values"
            raise InputError("nominal", name, "be given for a parameter of a function", remedy)
    # The nominal system is the centre: a distribution between two values has its middle there.
    middle = {name: 0.5 * sum(one.between) for name, one in known.items() if one.between is not None}
    centre = middle | {name: number(f"nominal {name}", x) for name, x in nominal.items()}
    factors = np.array([1.0 if one.between is not None else centre[name] for name, one in known.items()])
    rows = (draws * factors).tolist()
    # The nominal system first, then one for each draw.
    systems = [build(dict(zip(known, row, strict=True))) for row in [[centre[name] for name in known], *rows]]
    for each in systems:
        require_system(each, "what the function builds")
        if each.size != systems[0].size or len(each.contacts) != len(systems[0].contacts):
            remedy = "build every system on one grid, with the same contacts"
            raise InputError("system", f"{each.size} unknowns", f"have {systems[0].size} as the others", remedy)
    return members_of(systems[0], ", ".join(known), draws, systems[1:])
