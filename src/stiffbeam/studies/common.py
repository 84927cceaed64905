"""What several studies need: schemes by label, a system's smooth motion, a reference solved once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..arrays import Array
from ..cases import Case, parse_run
from ..contact import Contact
from ..drive import Drive
from ..modal import modes
from ..schemes import SCHEMES, Scheme, make
from ..semidiscretisation import semidiscretise
from ..solvers import reference
from ..system import System
from ..time_functions import Harmonic, LoadFunction
from ..trajectory import Reference
from ..validation import InputError, positive

_REFERENCES: dict[tuple[str, float, str], Reference] = {}
_KEPT = 4


def scheme_labels(case: Case, schemes: Sequence[str] | None = None) -> list[str]:
    """The given labels in one spelling, or the case's own schemes and every other registered one.

    A scheme that the case runs on several forms counts once; ``theta`` with its default is the
    trapezoidal rule, which stands under that name.
    """
    if schemes is not None:
        for label in schemes:
            if not isinstance(label, (str, Scheme)):
                raise InputError("schemes", label, "be labels of registered schemes", "for example 'hht(alpha=-0.1)'")
        return [str(parse_run(str(label))[0]) for label in schemes]
    own: dict[str, Scheme] = {}
    for scheme, _ in case.runs:
        own.setdefault(scheme.name, scheme)
    return [str(own.get(name) or make(name)) for name in SCHEMES if name != "theta"]


def scheme_of(label: str) -> Scheme:
    """The scheme with this label."""
    return parse_run(label)[0]


def system_of(case: Case, form: str) -> System:
    return semidiscretise(case.problem, case.cells, form)


def solve_once(system: System, t_end: float, method: str = "exact") -> Reference:
    """``reference``, remembered for the next points of the same process."""
    key = (system.fingerprint, t_end, method)
    if key not in _REFERENCES:
        while len(_REFERENCES) >= _KEPT:
            del _REFERENCES[next(iter(_REFERENCES))]
        _REFERENCES[key] = reference(system, t_end, method)
    return _REFERENCES[key]


def first_impacts(case: Case, form: str, impacts: int) -> float:
    """The end of a window that holds ``impacts`` impacts and stays far from the horizon.

    It ends half-way to the next impact, so that whether a scheme counts the last one does not hang on
    rounding; a case without so many ends at half the horizon.
    """
    positive("impacts", impacts)
    exact = solve_once(system_of(case, form), case.t_end)
    times = exact.impacts.times
    end = 0.5 * min(exact.horizon, case.t_end)
    if len(times) > impacts:
        end = min(end, 0.5 * float(times[impacts - 1] + times[impacts]))
    return end


def later(system: System, t: float, q: Array, v: Array) -> System:
    """The system as it is from time ``t`` on, with t as its new zero and (q, v) its initial data."""

    def shift(function: LoadFunction) -> LoadFunction:
        if isinstance(function, Harmonic):
            return replace(function, phase=(function.phase + function.frequency * t) % (2.0 * np.pi))
        return function

    return replace(
        system,
        q0=q,
        v0=v,
        loads=tuple((vector, shift(function)) for vector, function in system.loads),
        contacts=tuple(c if c.offset is None else Contact(c.row, c.stops, shift(c.offset)) for c in system.contacts),
    )


def without_contact(system: System) -> System:
    """The same system with its stops taken away; ``tip`` stays what it was."""
    row = system.channels[system.tip_channel][0]
    return replace(system, contacts=(), observe=row)


def smooth(system: System) -> System:
    """The system without contact on its slow motion: the steady answer to the drive plus the lowest mode.

    Initial data at rest shake every mode of the grid, and no step of interest resolves the highest. The
    lowest mode starts with the size of the steady motion, or 1 where nothing drives the system.
    """
    system = without_contact(system)
    y, g = steady_state(system)
    basis = modes(system)
    assert basis is not None
    q, v = g @ y, Drive.of(system).derivative() @ g @ y
    size = float(np.max(np.abs(q))) or 1.0
    lowest = int(np.argmax(basis.omega > 0.0))
    shape = basis.shapes[:, lowest]
    return replace(system, q0=q + size * shape / np.max(np.abs(shape)), v0=v)


def steady_state(system: System) -> tuple[Array, Array]:
    """(Y, g(0)), q = Y^T g(t): the motion in which every load only rings at its own frequency; Y is (d, n)."""
    basis = modes(system)
    if basis is None:
        raise InputError("damping", "a matrix that couples the modes", "decouple for the steady motion")
    drive = Drive.of(system)
    unit, samples = drive.split(system.loads, system.size)
    if samples:
        raise InputError("loads", "a sampled load", "be harmonic or constant for the steady motion")
    # With the load unit^T g, g' = D g and eta = y^T g in a mode: (D^T D^T + c D^T + w^2) y = its force.
    forces, rate = basis.force(unit), drive.derivative().T
    y = np.empty_like(forces)
    for j, (omega, c) in enumerate(zip(basis.omega, basis.damping, strict=True)):
        matrix = rate @ rate + c * rate + omega**2 * np.eye(drive.size)
        y[:, j] = np.linalg.lstsq(matrix, forces[:, j])[0]  # a rigid-body mode has no steady answer to a constant
    return basis.to_nodal(y), drive.coefficients(0.0)
