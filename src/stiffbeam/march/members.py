"""The members of an ensemble: systems with one linear part and small or planned differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..contact import Stops
from ..modal import undamped_modes
from ..semidiscretisation import semidiscretise
from ..system import System
from ..time_functions import Constant, Harmonic, LoadFunction
from ..validation import InputError, integer, non_negative, number, positive


@dataclass(frozen=True, eq=False)
class Members(Sequence[System]):
    """Systems that share mass, damping, stiffness and contact rows with ``system``.

    ``parameter`` says what differs and ``values`` holds its value for each member. ``fields``: for each
    field of System that differs, one value per member; ``members[i]`` is made on demand.
    """

    system: System
    parameter: str
    values: Any
    fields: Mapping[str, Sequence[Any]]

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, i: Any) -> Any:
        """The system of member i, or those of a slice as Members."""
        if isinstance(i, slice):
            fields = {name: values[i] for name, values in self.fields.items()}
            return Members(self.system, self.parameter, self.values[i], fields)
        if not -len(self) <= i < len(self):
            raise IndexError(i)
        return replace(self.system, **{name: values[i] for name, values in self.fields.items()})

    def __iter__(self) -> Iterator[System]:
        return (self[i] for i in range(len(self)))


def as_members(system: System, members: Members | Sequence[System]) -> Members:
    """``members`` checked against ``system``: at least one, and one linear part."""
    _system(system)
    if not isinstance(members, Members):
        given = list(members)
        names = ("loads", "contacts", "q0", "v0", "problem")
        for member in given:
            _system(member)
        fields = {name: [getattr(member, name) for member in given] for name in names}
        members = Members(system, "systems", np.arange(len(given)), fields)
        for member in given:
            shared = [(getattr(system, x), getattr(member, x)) for x in ("mass", "damping", "stiffness")]
            shared += [(a, b) for (a, _), (b, _) in zip(system.channels, member.channels, strict=False)]
            alike = len(system.channels) == len(member.channels) and len(system.contacts) == len(member.contacts)
            if not alike or not all(np.array_equal(a, b) for a, b in shared):
                raise InputError("members", member.form, "share matrices and contact rows with the system")
            if _sampled(member) != _sampled(system):
                rule = "share every callable load and offset with the system"
                raise InputError("members", member.form, rule, "integrate such systems one by one")
    elif members.system.fingerprint != system.fingerprint:
        raise InputError("members", members.parameter, "be made from the system that is integrated")
    if not len(members):
        raise InputError("members", 0, "be at least one")
    return members


def _sampled(system: System) -> list[tuple]:
    """The loads and offsets that are known by their values only."""
    terms = [*((f, vector.tobytes()) for vector, f in system.loads), *((o, b"") for _, o in system.channels)]
    known = (Harmonic, Constant, type(None))
    return [(i, id(f), vector) for i, (f, vector) in enumerate(terms) if not isinstance(f, known)]


def perturbed(system: System, members: int, size: float = 1e-12, seed: int = 1, scale: float | None = None) -> Members:
    """``members`` copies of ``system`` whose initial data differ by ``size`` of the motion's own scale.

        omega_j eta_j and eta_j' of every mode j each change by size V r, r uniform in [-1, 1],

    in undamped modal coordinates with unit mass, eta = shapes^T M q, and omega_1 in place of a smaller
    omega_j. V is the motion's scale, a modal velocity: the largest over the modes of hypot(omega_j
    eta_j, eta_j') at the start, and of the speed that a load can give a mode within a radian, sum_k
    |shapes_j . p_k| amplitude_k / max(omega_j, frequency_k). So a system that starts at rest at zero is
    perturbed in proportion to what drives it. ``scale`` sets V; it has to where time functions are
    callables and the start is at rest at zero. Reproducible from ``seed``; members k are the first k of
    any larger ensemble.
    """
    _system(system)
    integer("members", members, 1)
    non_negative("size", size)
    basis = undamped_modes(system)
    omega = basis.omega
    if scale is None:
        speeds = np.hypot(omega * basis.to_modal(system.q0), basis.to_modal(system.v0))
        driven = np.zeros(len(omega))
        for vector, function in system.loads:
            amplitude, frequency = _amplitude(function)
            if amplitude:
                driven += np.abs(basis.force(vector)) * amplitude / np.maximum(omega, max(frequency, 1e-300))
        scale = float(max(np.max(speeds), np.max(driven)))
        if not 0.0 < scale < np.inf:
            raise InputError("scale", scale, "be known for a system at rest", "pass scale=, a modal velocity")
    positive("scale", scale)
    noise = np.array([np.random.default_rng([seed, i]).uniform(-1.0, 1.0, (2, len(omega))) for i in range(members)])
    eta = noise[:, 0] / np.maximum(omega, omega[omega > 0.0][0] if np.any(omega) else 1.0)
    q0 = [system.q0 + size * scale * basis.to_nodal(x) for x in eta]
    v0 = [system.v0 + size * scale * basis.to_nodal(x) for x in noise[:, 1]]
    return Members(system, "initial data", np.arange(members), {"q0": q0, "v0": v0})


def varied(
    system: System,
    *,
    frequency: ArrayLike | None = None,
    amplitude: ArrayLike | None = None,
    stops: Sequence[Stops | Sequence[Stops]] | None = None,
) -> Members:
    """One member per value of one parameter.

    frequency, amplitude: of the drive, which is the base motion of a beam that has one, else every
    Harmonic among the loads; they must be one and the same then. stops: the Stops of each member, with
    several contacts a sequence of one per contact. Raises InputError.
    """
    _system(system)
    given = {"frequency": frequency, "amplitude": amplitude, "stops": stops}
    chosen = [name for name, value in given.items() if value is not None]
    if len(chosen) != 1:
        raise InputError("varied", chosen, f"be given exactly one of {sorted(given)}")
    if stops is not None:
        return _with_stops(system, stops)
    name = chosen[0]
    values = np.atleast_1d(np.asarray(given[name], float)).ravel()
    if not len(values):
        raise InputError(name, given[name], "name at least one member")
    for value in values:
        (positive if name == "frequency" else number)(name, float(value))
    drive = _drive(system, name)
    made = [_driven(system, replace(drive, **{name: float(value)}), drive) for value in values]
    names = ("loads", "contacts", "q0", "v0", "problem")
    return Members(system, name, values, {field: [getattr(member, field) for member in made] for field in names})


def _with_stops(system: System, stops: Sequence[Stops | Sequence[Stops]]) -> Members:
    contacts = []
    for entry in stops:
        each: list[Any] = list(entry) if isinstance(entry, (tuple, list)) else [entry]
        if len(each) != len(system.contacts) or not all(isinstance(stop, Stops) for stop in each):
            raise InputError("stops", entry, f"be {len(system.contacts)} Stops, one per contact")
        pairs = zip(system.contacts, each, strict=True)
        contacts.append(tuple(replace(contact, stops=stop) for contact, stop in pairs))
    if not contacts:
        raise InputError("stops", stops, "name at least one member")
    fields: dict[str, Sequence[Any]] = {"contacts": contacts}
    if system.problem is not None:
        fields["problem"] = [replace(system.problem, stops=each[0].stops) for each in contacts]
    return Members(system, "stops", list(stops), fields)


def _drive(system: System, name: str) -> Harmonic:
    """The one Harmonic that drives the system."""
    base = system.problem.base if system.problem is not None else None
    if base is not None:
        functions: set[LoadFunction] = {base}
    elif system.problem is not None:
        functions = {load.time for load in system.problem.loads}
    else:
        functions = {function for _, function in system.loads}
    harmonic = {function for function in functions if isinstance(function, Harmonic)}
    if len(harmonic) != 1:
        raise InputError(name, len(harmonic), "vary exactly one Harmonic drive", "build the systems one by one")
    return harmonic.pop()


def _driven(system: System, new: Harmonic, old: Harmonic) -> System:
    """``system`` with one drive for another, its matrices kept."""
    problem = system.problem
    if problem is None:
        loads = tuple((vector, new if function == old else function) for vector, function in system.loads)
        return replace(system, loads=loads)
    if problem.base is not None:
        problem = replace(problem, base=new)
    else:
        loads = tuple(replace(load, time=new) if load.time == old else load for load in problem.loads)
        problem = replace(problem, loads=loads)
    made = semidiscretise(problem, system.size, system.form)
    return replace(system, loads=made.loads, contacts=made.contacts, q0=made.q0, v0=made.v0, problem=problem)


def _amplitude(function: LoadFunction) -> tuple[float, float]:
    """Largest value and angular frequency; (0, 0) where they are not known."""
    if isinstance(function, Harmonic):
        return abs(function.amplitude), function.frequency
    return (abs(function.level), 0.0) if isinstance(function, Constant) else (0.0, 0.0)


def _system(system: object) -> None:
    if not isinstance(system, System):
        raise InputError("system", type(system).__name__, "be a System", "make it with semidiscretise or from_matrices")
