"""The members of an ensemble, and systems with other values of their parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import reduce
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array, same
from ..basics.resources import afford
from ..basics.text import path_of, walk
from ..basics.validation import InputError, Rng, instance, integer, near, number, numbers, positive, sequence
from .contact import Stops, on_rigid_stops
from .modes import undamped_modes
from .problem import BeamProblem
from .scales import scales
from .semidiscretisation import semidiscretise
from .system import Origin, System, require_system
from .time_functions import Harmonic, LoadFunction, Sampled, Superposition, TimeFunction

LISTED = "be EnsembleMembers or a list of systems", "make them with perturbed_members or varied_members"
# How far the starts of an ensemble's members are apart, relative to the motion. Its means stand for all motions of that
# kind only where members part before a scheme leaves the exact motion, else they share what it has strayed to. With
# 1e-12 the counts of Table 10 that HHT, the trapezoidal rule and the exponential flow make at fine steps were 4 to 10 %
# below the exact ones, of which +-3 % was said; with 1e-3 they agree.
SPREAD = 1e-3
SCALE = "scale"  # the last name of a path to a time function or an array: a factor on it


@dataclass(frozen=True, eq=False)
class EnsembleMembers(Sequence[System]):
    """Members of an ensemble: systems with the numbers of unknowns and contacts of ``system``.

    Parameters
    ----------
    system : System
    systems : sequence of System
        The members.
    parameters : mapping of path to values
        The parameters that were varied, with a value for each member.

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
    systems: Sequence[System] = field(repr=False)
    parameters: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        counts = lambda system: (system.size, len(system.contacts), len(system.channels))  # noqa: E731
        wanted = counts(require_system(self.system))
        for member in sequence("members", self.systems, *LISTED):
            require_system(member, "members")
            if counts(member) != wanted:
                rule = "have the unknowns and contacts of the system"
                raise InputError("members", repr(member), rule, "integrate such systems one by one")
        for name, values in instance("members.parameters", self.parameters, Mapping, "leave them out").items():
            if numbers(name, values).shape != (len(self),):
                raise InputError(name, values, f"be one value per member, {len(self)}", "give as many")

    def __len__(self) -> int:
        return len(self.systems)

    def __getitem__(self, i: Any) -> Any:
        """The system of member i, or a list of those of a slice."""
        return self.systems[i]


def as_members(system: System, members: EnsembleMembers | Sequence[System]) -> EnsembleMembers:
    """``members`` checked against ``system``: at least one."""
    require_system(system)
    if not isinstance(members, EnsembleMembers):
        members = EnsembleMembers(system, sequence("members", members, *LISTED))
    # By fingerprint: a copy from another process is equal without being the same object.
    elif members.system.fingerprint != system.fingerprint:
        remedy = "make the members anew from this system, or integrate members.system"
        raise InputError("members", members, "be made from the system that is integrated", remedy)
    if not len(members):
        raise InputError("members", 0, "be at least one", "give one value or more")
    return members


def march_apart(members: EnsembleMembers) -> bool:
    """Return True if each member is set up by itself: a member has other matrices, contact rows or vectors of loads
    than the system, or functions of time that differ in more than harmonics and constants."""

    def setup(system: System) -> tuple[list[Array], tuple[LoadFunction, ...]]:
        drive, rows = system.drive, [row for row, _ in (*system.channels, *system.loads)]
        shares = drive.amplitudes(system.time_functions)[drive.size :]
        return [system.mass, system.damping, system.stiffness, *rows, shares], drive.others

    arrays, functions = setup(members.system)
    return any(
        others != functions or len(mine) != len(arrays) or not all(map(same, mine, arrays))
        for mine, others in map(setup, members)
    )


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
    noise = np.random.default_rng(rng).uniform(-1.0, 1.0, (members, 2, system.size))
    eta = np.divide(noise[:, 0], motion.rates, out=np.zeros_like(noise[:, 0]), where=motion.rates > 0.0)
    speed = size * motion.speed
    q0 = (off_rigid_stops(system, system.q0 + speed * basis.to_nodal(x)) for x in eta)
    v0 = (system.v0 + speed * basis.to_nodal(x) for x in noise[:, 1])
    systems = [replace(system, q0=q, v0=v) for q, v in zip(q0, v0, strict=True)]
    return EnsembleMembers(system, systems)


def off_rigid_stops(system: System, q: Array) -> Array:
    """q (n,), or the start of the system where q is beyond a rigid stop."""
    try:
        on_rigid_stops(system.contacts, q)
    except InputError:
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
    grid = {name: numbers(name, x).ravel() for name, x in instance("parameters", parameters, Mapping, remedy).items()}
    counts = {name: len(along) for name, along in grid.items()}
    size = max(counts.values(), default=0)
    if size == 0 or min(counts.values()) != size:
        raise InputError("parameters", counts, "have one value or more each, and as many for each", remedy)
    # Every member is made here.
    afford("parameters", f"{size} values", "take fewer", floats=20.0 * size * (system.size + 20))
    rows = zip(*(along.tolist() for along in grid.values()), strict=True)
    return EnsembleMembers(system, [with_values(system, dict(zip(grid, row, strict=True))) for row in rows], grid)


def with_values(system: System, values: Mapping[str, float]) -> System:
    """System with other values of the parameters at these paths, for example ``{"stops[1].damping": 2.0}``.

    A path leads through attributes and indexes from the problem of a beam ("base.frequency",
    "loads[0].time.amplitude", "viscosity") or from a system of matrices ("loads[0].time.phase",
    "initial_velocity[2]").
    "contacts[i].stops" and "stops[i]" are the same, and "stops" without an index means all contacts.
    "loads[0].time.scale" and "base.scale" are factors on a time function, with nominal value 1: the level of a record.
    So are "mass.scale", "damping.scale" and "stiffness.scale" of matrices. Three names are short: "frequency" and
    "amplitude" are those of every Harmonic, if all have the same; "clearance" is the distance of every stop from zero.
    Raises InputError, also for another base motion of a beam with an initial velocity.
    """
    if system.problem is not None and not system.keeps("q0", "v0"):
        remedy = "give the beam its initial data in the problem, or build the systems one by one"
        raise InputError(", ".join(values), "a beam with other initial data", "be varied with its problem", remedy)
    root: Any = system.problem or system
    placed: dict[tuple[Any, ...], float] = {}
    for path, value in values.items():
        if path == CLEARANCE:
            positive(path, value)
        try:
            for keys, sign in _keys_of(root, path):
                if placed.setdefault(keys, sign * value) != sign * value:
                    raise InputError("parameter", path, "be the only one to set its number", "leave out the other path")
                root = _replaced(root, keys, sign * value)
        except LookupError as error:
            known = list(dict.fromkeys([*DRIVE, CLEARANCE, *paths_of(system)]))
            raise InputError("parameter", path, "be a path to a number of the system", near(path, known)) from error
    if system.problem is None or system.origin is None:
        return root
    problem = system.problem
    if problem.initial_velocity is not None and root.base != problem.base:
        rule = "be kept where the beam has an initial velocity, which may be that of its base"
        raise InputError("base", "another base motion", rule, "build the systems one by one")
    return semidiscretise(root, system.origin.cells, system.form)


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
        if isinstance(x, (Sampled, Real))
    ]


def value_at(system: System, path: str) -> float:
    """The number at a path or a short name. LookupError or TypeError where there is none, or different ones behind
    it."""
    root: Any = system.problem or system
    found = {sign * reduce(_part, keys, root) for keys, sign in _keys_of(root, path)}
    if len(found) != 1:
        raise LookupError(path)
    return float(found.pop())


def _keys_of(root: Any, path: str) -> list[tuple[tuple[Any, ...], float]]:
    """Names and indexes from a problem or a system to each number that a path stands for, and its sign there."""
    parts = list(walk(root, leaves=CLOSED))
    stops = [(keys, x) for keys, x in parts if isinstance(x, Stops)]
    if path in DRIVE:
        # The amplitude of a load is none of a motion of base or stops.
        drives = {
            (*keys, path): f.frequency if path == "frequency" else (f.frequency, f.amplitude, keys[0] == "loads")
            for keys, f in parts
            if isinstance(f, Harmonic)
        }
        if (count := len({*drives.values()})) != 1:
            remedy = f"name one by its path, for example loads[0].time.{path}" if count else "vary stops.stiffness"
            raise InputError(path, f"{count} drives", "vary exactly one Harmonic drive", remedy)
        return [(keys, 1.0) for keys in drives]
    if path == CLEARANCE:
        sides = [((*keys, side), sign) for keys, _ in stops for side, sign in (("lower", -1.0), ("upper", 1.0))]
        if not stops:
            raise InputError("parameter", path, "be asked of a case with stops", "vary another parameter")
        return [(keys, sign) for keys, sign in sides if reduce(_part, keys, root) is not None]
    keys: tuple[Any, ...] = tuple(int(index) if index else name for name, index in _KEY.findall(path))
    # findall skips what it cannot read. Such a path does not read back as it was.
    if not keys or path_of(keys) != path:
        raise LookupError(path)
    if keys[0] == "contacts" and keys[2:3] == ("stops",):
        keys = ("stops", keys[1], *keys[3:])
    if keys[0] != "stops":
        return [(keys if isinstance(root, BeamProblem) else tuple(AS_GIVEN.get(key, key) for key in keys), 1.0)]
    # The stops of one contact or of all.
    index = [key for key in keys[1:2] if isinstance(key, int)]
    if not stops:
        raise LookupError(path)
    return [((*stops[i][0], *keys[1 + len(index) :]), 1.0) for i in index or range(len(stops))]


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
        if not isinstance(thing, Real | None):
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
