"""Parameters of sweeps and branches: numbers of the system, its stops and its drive."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..basics.arrays import content
from ..basics.units import with_unit
from ..basics.validation import InputError, number, positive
from ..files.cases import Case
from ..model.members import value_at, with_values
from ..model.problem import PointLoad
from ..model.system import System
from ..model.time_functions import Drive, Harmonic
from ..schemes import Scheme
from .base import Row
from .common import chosen_schemes

EXACT = "exact"


def _clearance(system: System, value: float) -> System:
    """Every stop the system has at this distance from zero."""
    positive("clearance", value)
    if not system.contacts:
        remedy = "vary another parameter, or give the case stops"
        raise InputError("parameter", "clearance", "be asked of a case with stops", remedy)
    sides = [
        {side: sign * value for side, sign in (("lower", -1.0), ("upper", 1.0)) if getattr(x.stops, side) is not None}
        for x in system.contacts
    ]
    moved = (replace(x, stops=replace(x.stops, **to)) for x, to in zip(system.contacts, sides, strict=True))
    return replace(system, contacts=tuple(moved))


@dataclass(frozen=True)
class Setup:
    """A value of the parameter, ready to run. period: T of the drive, or the whole run where the case has no such
    period. dt: the step of a scheme, which divides it; 0 of the exact solution."""

    system: System
    dt: float
    period: float

    @property
    def kind(self) -> tuple[Any, ...]:
        """Key that is equal for setups that can run together."""
        system = self.system
        arrays = system.mass, system.stiffness, system.damping, *(contact.row for contact in system.contacts)
        return self.dt, self.period, *map(content, arrays)


QUANTITIES = {
    "frequency": "frequency", "clearance": "length", "lower": "length", "upper": "length", "position": "length",
    "stiffness": "bending stiffness", "viscosity": "bending viscosity",
}  # fmt: skip
AT_STOP = {"stiffness": "stop stiffness", "damping": "stop damping", "dissipation": "stop dissipation"}


def quantity_of(case: Case, parameter: str) -> str:
    """Return the quantity of a parameter, whose unit the case knows; "" for one without dimension.

    The amplitude is the base's, else that of the loads.
    """
    first, last = re.split(r"[.\[]", parameter)[0], parameter.rpartition(".")[2]
    at_stop = first in ("contacts", "stops")
    if at_stop and last in AT_STOP:
        linear = all(c.stops.exponent == 1.0 for c in case.system(case.forms[0]).contacts)
        return AT_STOP[last] if linear else ""  # a force per length to the exponent
    if last != "amplitude":
        return QUANTITIES.get(last, "")
    if at_stop or (case.problem is not None and case.problem.base is not None):
        return "length"
    loads = () if case.problem is None else case.problem.loads
    point = {isinstance(load, PointLoad) for load in loads if isinstance(load.time, Harmonic)}
    return "force" if point == {True} else "force per length" if point == {False} else ""


def values_of(parameter: str, values: Sequence[float] | None, count: int, period: float | None) -> list[float]:
    """The values of a parameter, by default ``count`` drive frequencies from 0.7 to 1.3 of the case's."""
    if values is None and parameter == "frequency" and period is not None:
        values = (np.linspace(0.7, 1.3, count) * 2.0 * np.pi / period).tolist()
    if not values:
        raise InputError("values", values, f"be given for {parameter}", "for example 8:14:400 or 8,9,10.5")
    return [number(parameter, x) for x in values]


def scheme_of(case: Case, method: Any) -> Scheme | None:
    """The scheme of a method, None for the exact solution."""
    return None if method == EXACT else next(iter(chosen_schemes(case, [method]).values()))


def setup_of(system: System, point: Row, value: float) -> Setup:
    """Setup with one value on the case's system. Raises InputError for a value that is not possible."""
    name, dt, whole = point["parameter"], point["dt"], point.get("t_end")
    system = _clearance(system, value) if name == "clearance" else with_values(system, {name: value})
    period = drive_period(system, name) if whole is None else whole
    assert period is not None
    if dt is None:
        return Setup(system, 0.0, period)
    if dt > 0.5 * period:
        half = f"{'half a period of the drive' if whole is None else 'half the run'}, {0.5 * period:.6g}"
        raise InputError("dt", dt, f"be at most {half}", "take a smaller dt")
    return Setup(system, period / round(period / dt), period)


def drive_period(system: System, parameter: str = "frequency") -> float | None:
    """T = 2 pi/a of the frequency that drives the system; of several, that of the drive whose parameter is varied.

    None where no drive has a period, or none of several is meant; or where a record drives the system.
    """
    drive = Drive.of(system)
    if drive.records:
        return None
    if len(drive.frequencies) == 1:
        return 2.0 * np.pi / drive.frequencies[0]
    try:
        return 2.0 * np.pi / value_at(system, f"{parameter.rpartition('.')[0]}.frequency")
    except LookupError:
        return None


NAMES = {
    "frequency": "drive frequency $a$", "amplitude": "drive amplitude $E$", "clearance": "clearance $g$",
    "stops.stiffness": r"stop stiffness $\kappa$", "stiffness": "bending stiffness", "viscosity": "viscosity",
}  # fmt: skip


def named(case: Case, name: str) -> str:
    """A parameter on an axis, with its unit where it has one."""
    return with_unit(case.units, NAMES.get(name, name), quantity_of(case, name))
