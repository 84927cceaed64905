"""The members of an ensemble, and systems with other values of their parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from decimal import Decimal
from functools import reduce
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array, same
from ..basics.resources import afford
from ..basics.text import path_of, walk
from ..basics.validation import InputError, Rng, generator, instance, integer, near, number, numbers, positive, sequence
from .contact import Stops
from .modes import undamped_modes
from .problem import BeamProblem
from .scales import scales
from .semidiscretisation import semidiscretise
from .system import Origin, System, require_system
from .time_functions import Harmonic, LoadFunction, Sampled, Superposition, TimeFunction, evaluate

LISTED = "be EnsembleMembers or a list of systems", "make them with perturbed_members or varied_members"
# How far the starts of an ensemble's members are apart, relative to the motion. Its means stand for all motions of that
# kind only where members part before a scheme leaves the exact motion, else they share what it has strayed to. With
# 1e-12 the counts of Table 10 that HHT, the trapezoidal rule and the exponential flow make at fine steps were 4 to 10 %
# below the exact ones, of which +-3 % was said; with 1e-3 they agree.
SPREAD = 1e-3
STARTS, SYSTEMS = "initial data", "systems"  # what differs where a member has a number and no value
SCALE = "scale"  # the last name of a path to a time function or an array: a factor on it


@dataclass(frozen=True, eq=False)
class EnsembleMembers(Sequence[System]):
    """Members of an ensemble: systems with the numbers of unknowns and contacts of ``system``.

    Parameters
    ----------
    system : System
    parameter : str
        Name of the parameter that differs.
    values : array or sequence
        One value of the parameter per member, or a row of those of several parameters.
    systems : sequence of System
        The members.

    Raises
    ------
    InputError
        For other numbers of unknowns, contacts or values.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> members = sb.varied_members(sb.paper_case(10).system(), {"stops.stiffness": [1e6, 5e6]})
    >>> len(members), members[0].contacts[0].stops.stiffness
    (2, 1000000.0)
    """

    system: System
    parameter: str
    values: Any
    systems: Sequence[System]

    def __post_init__(self) -> None:
        counts = lambda system: (system.size, len(system.contacts), len(system.channels))  # noqa: E731
        wanted = counts(require_system(self.system))
        for member in sequence("members", self.systems, *LISTED):
            require_system(member, "members")
            if counts(member) != wanted:
                rule = "have the unknowns and contacts of the system"
                raise InputError("members", repr(member), rule, "integrate such systems one by one")
        if len(sequence("members.values", self.values, "be one value per member")) != len(self.systems):
            raise InputError("members.values", len(self.values), f"be one per member, {len(self)}", "give as many")

    def __repr__(self) -> str:
        return f"<EnsembleMembers: {len(self)} of {self.system!r}, {self.parameter}>"

    def __len__(self) -> int:
        return len(self.systems)

    def __getitem__(self, i: Any) -> Any:
        """The system of member i, or a list of those of a slice."""
        return self.systems[i]


def as_members(system: System, members: EnsembleMembers | Sequence[System]) -> EnsembleMembers:
    """``members`` checked against ``system``: at least one."""
    require_system(system)
    if not isinstance(members, EnsembleMembers):
        systems = sequence("members", members, *LISTED)
        members = EnsembleMembers(system, SYSTEMS, np.arange(len(systems)), systems)
    # By fingerprint: a copy from another process is equal without being the same object.
    elif members.system.fingerprint != system.fingerprint:
        remedy = "make the members anew from this system, or integrate members.system"
        raise InputError("members", members.parameter, "be made from the system that is integrated", remedy)
    if not len(members):
        raise InputError("members", 0, "be at least one", "give one value or more")
    return members


def march_apart(members: EnsembleMembers) -> bool:
    """Return True if each member is set up by itself: a member has other matrices, contact rows or vectors of loads
    than the system, or functions of time that differ in more than harmonics and constants."""
    arrays, functions = _setup(members.system)
    return any(
        others != functions or len(mine) != len(arrays) or not all(map(same, mine, arrays))
        for mine, others in map(_setup, members)
    )


def _setup(system: System) -> tuple[list[Array], tuple[LoadFunction, ...]]:
    """The matrices, the rows and vectors, and the shares of the functions of time that are neither Harmonic nor
    Constant; and these functions."""
    drive, rows = system.drive, [row for row, _ in (*system.channels, *system.loads)]
    shares = drive.amplitudes(system.time_functions)[drive.size :]
    return [system.mass, system.damping, system.stiffness, *rows, shares], drive.others


def perturbed_members(
    system: System, members: int, size: float = SPREAD, rng: Rng = 1, t_end: float = np.inf
) -> EnsembleMembers:
    """Return copies of a system whose initial data differ by a small random part of its motion.

        r_j eta_j and eta_j' of every mode j each change by size V x, x uniform in [-1, 1],

    in undamped modal coordinates with unit mass, eta = shapes^T M q. The speed V and the rates r_j are those of
    ``scales.Scales``, so a system that starts at rest is perturbed in proportion to what drives it. A mode without
    restoring force is perturbed in its speed alone.

    Parameters
    ----------
    system : System
    members : int
    size : float
        Relative to the motion. With the default, members diverge before a scheme leaves the exact motion. A start that
        would be beyond a rigid stop differs in its velocities alone.
    rng : None, int, Generator, BitGenerator or SeedSequence
        For ``numpy.random.default_rng``. The members of a smaller ensemble are the first of a larger one.
    t_end : float
        Length of the runs. A motion that is slower counts as none. Needed where only callables drive the system.

    Returns
    -------
    EnsembleMembers

    Raises
    ------
    InputError
        For a system whose motion has no scale.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> many = sb.integrate_ensemble(system, sb.HHT(alpha=-0.1), 1e-4, 0.5, sb.perturbed_members(system, 16))
    >>> many.contacts[0].impact_count.shape
    (16,)
    """
    require_system(system)
    integer("members", members, 1)
    number("size", size, least=0.0)
    afford("members", members, "take fewer", floats=6.0 * members * (system.size + 60))  # a system is an object
    span = t_end if isinstance(t_end, float) and t_end == np.inf else positive("t_end", t_end)
    basis, motion = undamped_modes(system), scales(system, span)
    if not 0.0 < motion.speed < np.inf:
        rule = "be known for a system at rest, and for one that nothing stops"
        raise InputError("the speed of the motion", motion.speed, rule, "give t_end, the length of the runs")
    noise = generator(rng).uniform(-1.0, 1.0, (members, 2, system.size))
    eta = np.divide(noise[:, 0], motion.rates, out=np.zeros_like(noise[:, 0]), where=motion.rates > 0.0)
    speed = size * motion.speed
    q0 = (off_rigid_stops(system, system.q0 + speed * basis.to_nodal(x)) for x in eta)
    v0 = (system.v0 + speed * basis.to_nodal(x) for x in noise[:, 1])
    systems = [replace(system, q0=q, v0=v) for q, v in zip(q0, v0, strict=True)]
    return EnsembleMembers(system, STARTS, np.arange(members), systems)


def off_rigid_stops(system: System, q: Array) -> Array:
    """q (n,), or the start of the system where q is beyond a rigid stop."""
    for contact in system.contacts:
        shift = float(evaluate(contact.offset, 0.0))
        if contact.stops.rigid and contact.stops.penetration(contact.row @ q + shift) != 0.0:
            return system.q0
    return q


def varied_members(system: System, parameters: Mapping[str, ArrayLike]) -> EnsembleMembers:
    """Return one member per value of a parameter, or of several that vary together.

    Parameters
    ----------
    system : System
    parameters : mapping of path to values
        For example ``{"stops.stiffness": [1e4, 1e5]}``, see ``with_values``. All paths have one number of values;
        ``{"frequency": w, "amplitude": c * w**2}`` couples an amplitude to the square of the frequency.

    Returns
    -------
    EnsembleMembers

    Raises
    ------
    InputError
        Also for a path that the system does not have; the message lists those that it has.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> members = sb.varied_members(sb.paper_case(10).system(), {"frequency": [9.0, 10.0, 11.0]})
    >>> len(members)
    3
    """
    require_system(system)
    remedy = 'for example {"frequency": [9.0, 10.0]}'
    columns = dict(instance("parameters", parameters, Mapping, remedy))
    if not columns:
        raise InputError("parameters", columns, "name a parameter", remedy)
    # Values of every path, as many for each.
    grid = {name: np.atleast_1d(numbers(name, x)).ravel() for name, x in columns.items()}
    name, values = next(iter(grid.items()))
    for other, along in grid.items():
        if not len(along):
            raise InputError(other, columns[other], "name at least one member", "give one value or more")
        if len(along) != len(values):
            raise InputError(other, f"{len(along)} values", f"have as many as {name}, {len(values)}", "give as many")
    size = len(values)
    afford(name, f"{size} values", "take fewer", floats=20.0 * size * (system.size + 20))  # every member is made here
    rows = zip(*(along.tolist() for along in grid.values()), strict=True)
    members = [with_values(system, dict(zip(grid, row, strict=True))) for row in rows]
    several = np.transpose([*grid.values()]) if len(grid) > 1 else values
    return EnsembleMembers(system, ", ".join(grid), several, members)


def with_values(system: System, values: Mapping[str, float]) -> System:
    """System with other values of the parameters at these paths, for example ``{"stops[1].damping": 2.0}``.

    A path leads through attributes and indexes from the problem of a beam ("base.frequency",
    "loads[0].time.amplitude", "viscosity") or from a system of matrices ("loads[0].time.phase",
    "initial_velocity[2]").
    "contacts[i].stops" and "stops[i]" are the same, and "stops" without an index means all contacts.
    "loads[0].time.scale" and "base.scale" are factors on a time function, with nominal value 1: the level of a record.
    So are "mass.scale", "damping.scale" and "stiffness.scale" of matrices. Three names are short: "frequency" is that
    of every Harmonic with the drive's frequency, in loads, base, stop motions and sums; "amplitude" is that of the
    drive; "clearance" is the distance of every stop from zero.
    The drive is the base motion, else the loads, else the motion of the stops. Raises InputError, also for another
    drive of a beam that starts with the speed of its base.
    """
    if system.problem is not None and not system.keeps("q0", "v0"):
        remedy = "give the beam its initial data in the problem, or build the systems one by one"
        raise InputError(", ".join(values), "a beam with other initial data", "be varied with its problem", remedy)
    root: Any = system.problem or system
    placed: dict[tuple[Any, ...], float] = {}
    for path, value in values.items():
        (positive if path in ("frequency", CLEARANCE) else number)(path, value)
        try:
            for keys, sign in _keys_of(root, path):
                if placed.setdefault(keys, sign * value) != sign * value:
                    raise InputError("parameter", path, "be the only one to set its number", "leave out the other path")
                root = _replaced(root, keys, sign * value)
        except LookupError as error:
            known = list(dict.fromkeys([*DRIVE, CLEARANCE, *paths_of(system)]))
            raise InputError("parameter", path, "be a path to a number of the system", near(path, known)) from error
    return root if system.problem is None else _rebuilt(system, system.problem, root)


def _rebuilt(system: System, problem: BeamProblem, changed: BeamProblem) -> System:
    """The system of the changed problem on the grid of a system. Raises InputError for a start with the speed of the
    base, which would be one against the changed base."""
    if problem.base is not None and problem.initial_velocity is not None and changed.base != problem.base:
        speed, before, after = (float(np.squeeze(f(np.zeros(1)))) for f in (
            problem.initial_velocity, problem.base.rate, changed.base.rate))  # type: ignore[union-attr]  # fmt: skip
        if before != after and speed != 0.0 and abs(speed - before) <= 1e-6 * abs(before):
            rule = "be kept where the beam starts with the speed of its base"
            raise InputError("base", "another speed at the start", rule, "build the systems one by one")
    assert system.origin is not None
    return semidiscretise(changed, system.origin.cells, system.form)


DRIVE, CLEARANCE = ("frequency", "amplitude"), "clearance"
CLOSED = (Sampled, Origin)  # what holds no numbers to vary
# Other names in a path to a system of matrices: those of ``System.from_matrices``, and a load's function as in a beam.
AS_GIVEN = {"initial_displacement": "q0", "initial_velocity": "v0", "time": 1}
_KEY = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")


def paths_of(system: System) -> list[str]:
    """The paths to all numbers of the problem or the system outside matrices and vectors."""
    return [
        re.sub(r"^(loads\[\d+\])\[1\]", r"\1.time", path_of((*keys, SCALE) if isinstance(x, Sampled) else keys))
        for keys, x in walk(system.problem or system, leaves=CLOSED)
        if isinstance(x, (Sampled, Real, Decimal)) and not isinstance(x, bool)
    ]


def value_at(system: System, path: str) -> float:
    """The number at a path or a short name. Raises LookupError where there is none, or different ones behind it."""
    root: Any = system.problem or system
    ends = [(reduce(_part, keys, root), sign) for keys, sign in _keys_of(root, path)]
    found = {sign * float(end) if isinstance(end, Real) else None for end, sign in ends}
    if len(found) != 1 or None in found:
        raise LookupError(path)
    return found.pop()  # type: ignore[return-value]


def _keys_of(root: Any, path: str) -> list[tuple[tuple[Any, ...], float]]:
    """Names and indexes from a problem or a system to each number that a path stands for, and its sign there."""
    beam = isinstance(root, BeamProblem)
    stops = root.all_stops if beam else [contact.stops for contact in root.contacts]
    # Where the problem or the system keeps them.
    places = [("stops", i) if beam else ("contacts", i, "stops") for i in range(len(stops))]
    if beam and isinstance(root.stops, Stops):
        places = [("stops",)]
    if path in DRIVE:
        return [(keys, 1.0) for keys in _drive(root, path)]
    if path == CLEARANCE:
        if not stops:
            remedy = "vary another parameter, or give the case stops"
            raise InputError("parameter", CLEARANCE, "be asked of a case with stops", remedy)
        sides = [(i, side, sign) for i in range(len(stops)) for side, sign in (("lower", -1.0), ("upper", 1.0))]
        return [((*places[i], side), sign) for i, side, sign in sides if getattr(stops[i], side) is not None]
    keys: tuple[Any, ...] = tuple(int(index) if index else name for name, index in _KEY.findall(path))
    # findall skips what it cannot read. Such a path does not read back as it was.
    if not keys or path_of(keys) != path:
        raise LookupError(path)
    if keys[0] == "contacts" and keys[2:3] == ("stops",):
        keys = ("stops", keys[1], *keys[3:])
    if keys[0] != "stops":
        return [(keys if beam else tuple(AS_GIVEN.get(key, key) for key in keys), 1.0)]
    # The stops of one contact or of all.
    index = [key for key in keys[1:2] if isinstance(key, int)]
    each, rest = index or list(range(len(stops))), keys[1 + len(index) :]
    if not each or max(each) >= len(stops):
        raise LookupError(path)
    return [((*places[i], *rest), 1.0) for i in each]


def _part(thing: Any, key: Any) -> Any:
    """The part of a path's object that a key names; a scale is 1. Raises LookupError where there is none."""
    if key == SCALE and isinstance(thing, (TimeFunction, np.ndarray)):
        return 1.0
    if isinstance(key, int) and isinstance(thing, (tuple, list, np.ndarray)):
        return thing[key]
    if is_dataclass(thing) and key in [x.name for x in fields(thing)]:
        return getattr(thing, key)
    raise LookupError(key)


def _replaced(thing: Any, keys: Sequence[Any], value: float) -> Any:
    """The object with a value at the end of the keys."""
    if not keys:
        if thing is not None and (isinstance(thing, bool) or not isinstance(thing, (Real, str, Decimal))):
            raise LookupError(thing)
        return value
    key, *others = keys
    new = _replaced(_part(thing, key), others, value)
    if key == SCALE and isinstance(thing, np.ndarray):
        return value * thing
    if key == SCALE and isinstance(thing, TimeFunction):
        return Superposition(terms=[(value, thing)])
    if isinstance(key, int):
        entries = [new if i == key else x for i, x in enumerate(thing)]
        return np.array(entries) if isinstance(thing, np.ndarray) else tuple(entries)
    return replace(thing, **{key: new})


def _drive(root: Any, name: str) -> list[tuple[Any, ...]]:
    """The keys of the frequency or the amplitude of the drive."""
    found = [(keys, f) for keys, f in walk(root, leaves=CLOSED) if isinstance(f, Harmonic)]
    # The drive: the first place in this order that has a Harmonic.
    places = ([f for keys, f in found if keys[0] == x] for x in ("base", "loads", "stops", "contacts"))
    drive = next((place for place in places if place), [])
    distinct = {h.frequency if name == "frequency" else (h.frequency, h.amplitude) for h in drive}
    if len(distinct) != 1:
        by_path = f"name one by its path, for example loads[0].time.{name}"
        remedy = by_path if distinct else "vary a number that it has: loads[0].time.scale, stops.stiffness"
        raise InputError(name, f"{len(distinct)} drives", "vary exactly one Harmonic drive", remedy)
    shared = [(keys, f) for keys, f in found if f.frequency == drive[0].frequency]
    loaded = any(keys[0] == "loads" for keys, _ in found)
    if name == "amplitude" and loaded and any(keys[0] == "contacts" for keys, _ in shared):
        rule = "have no stops that move at the drive's frequency"
        raise InputError("system", "moving stops", rule, "name one by its path: loads[0].time.amplitude")
    return [(*keys, name) for keys, f in shared if name == "frequency" or f in drive]
