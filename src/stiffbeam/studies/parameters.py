"""Parameters of a sweep: those of the beam, its stops and its drive, the time step, and a scheme's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..basics.arrays import content
from ..basics.units import with_unit
from ..basics.validation import InputError, integer, positive
from ..files.cases import Case
from ..model.contact import Stops
from ..model.members import require_kept, value_at, with_values
from ..model.problem import PointLoad
from ..model.semidiscretisation import semidiscretise
from ..model.system import System
from ..model.time_functions import Drive, Harmonic
from ..schemes import Scheme
from .base import Row
from .common import chosen_schemes

EXACT = "exact"


def _stops(system: System, change: Callable[[Stops], Stops]) -> System:
    if not system.contacts:
        remedy = "vary another parameter, or give the case stops"
        raise InputError("parameter", "one of the stops", "be asked of a case with stops", remedy)
    return replace(system, contacts=tuple(replace(x, stops=change(x.stops)) for x in system.contacts))


def _clearance(system: System, value: float) -> System:
    """Every stop the system has at this distance from zero."""
    positive("clearance", value)

    def move(stops: Stops) -> Stops:
        lower, upper = stops.lower is not None, stops.upper is not None
        return replace(stops, lower=-value if lower else None, upper=value if upper else None)

    return _stops(system, move)


def _cells(system: System, value: float) -> System:
    """The beam on another grid, h = L/value."""
    if system.problem is None:
        remedy = "vary another parameter, or describe a beam with a number of cells"
        raise InputError("parameter", "cells", "be asked of a beam", remedy)
    return semidiscretise(
        system.problem, integer("cells", int(value) if value == int(value) else value, 1), system.form
    )


PARAMETERS: dict[str, Callable[[System, float], System]] = {
    "frequency": lambda system, value: with_values(system, {"frequency": value}),
    "amplitude": lambda system, value: with_values(system, {"amplitude": value}),
    "clearance": _clearance,
    "stop-stiffness": lambda system, value: _stops(system, lambda stops: replace(stops, stiffness=value)),
    "stiffness": lambda system, value: with_values(system, {"stiffness": value}),
    "viscosity": lambda system, value: with_values(system, {"viscosity": value}),
    "cells": _cells,
}
IN_STEP = ("amplitude", "clearance", "stop-stiffness")  # members of one ensemble


@dataclass(frozen=True)
class Setup:
    """A value of the parameters, ready to run. scheme: None for the exact solution. period: T of the drive, or the
    whole run where the case has no such period."""

    system: System
    scheme: Scheme | None
    dt: float
    period: float

    @property
    def kind(self) -> tuple[Any, ...]:
        """Key that is equal for setups that can run together."""
        system = self.system
        arrays = system.mass, system.stiffness, system.damping, *(contact.row for contact in system.contacts)
        return str(self.scheme), self.dt, self.period, *map(content, arrays)


QUANTITIES = {
    "frequency": "frequency", "clearance": "length", "stop-stiffness": "stop stiffness",
    "stiffness": "bending stiffness", "viscosity": "bending viscosity", "dt": "time",
}  # fmt: skip


AT_STOP = {"stiffness": "stop stiffness", "damping": "stop damping", "dissipation": "stop dissipation"}


def quantity_of(case: Case, parameter: str) -> str:
    """Return the quantity of a parameter, whose unit the case knows; "" for one of a scheme, without dimension.

    The amplitude is the base's, else that of the loads.
    """
    if is_path(parameter):
        first, last = parameter.split(".")[0].split("[")[0], parameter.rsplit(".", 1)[-1]
        at_stop = first in ("contacts", "stops")
        if last in ("lower", "upper", "position") or (last == "amplitude" and at_stop):
            return "length"
        if at_stop and any(c.stops.exponent != 1.0 for c in case.system(case.forms[0]).contacts):
            return ""  # a force per length to the exponent
        if last != "amplitude":
            return AT_STOP[last] if at_stop and last in AT_STOP else "frequency" if last == "frequency" else ""
    elif parameter != "amplitude":
        return QUANTITIES.get(parameter, "")
    if case.beam is None:
        return ""
    if case.problem.base is not None:
        return "length"
    point = {isinstance(load, PointLoad) for load in case.problem.loads if isinstance(load.time, Harmonic)}
    return "force" if point == {True} else "force per length" if point == {False} else ""


def is_path(parameter: str) -> bool:
    """Return True where a parameter is named by its path in the system, as in "stops[0].damping"."""
    return "." in parameter or "[" in parameter


def parameters_of(scheme: Scheme | None) -> list[str]:
    """The names that can be varied with this method; None: the exact solution."""
    if scheme is None:
        return list(PARAMETERS)
    own = (name for name, value in scheme.parameters.items() if not isinstance(value, bool))
    return [*PARAMETERS, "dt", *own]


def scheme_of(case: Case, method: Any) -> Scheme | None:
    """The scheme of a method, None for the exact solution."""
    return None if method == EXACT else next(iter(chosen_schemes(case, [method]).values()))


def setup_of(system: System, point: Row, value: Sequence[float], scheme: Scheme | None) -> Setup:
    """Setup with one value on the case's system; scheme: None for the exact solution. Raises InputError for a value
    that is not possible."""
    dt = point["dt"]
    for name, x in zip(names_of(point), value, strict=True):
        if name in PARAMETERS:
            system = PARAMETERS[name](system, x)
        elif is_path(name):
            system = with_values(system, {name: x})
        elif name == "dt":
            dt = positive("dt", x)
        else:
            assert scheme is not None
            changed = type(scheme)(**(scheme.parameters | {name: x}))
            scheme = changed.printed(scheme.erratum) if scheme.erratum else changed
    if len(value) > 1:
        pairs = zip(names_of(point), value, strict=True)
        require_kept(system, {name: x for name, x in pairs if is_path(name)})
    whole = point.get("t_end")
    period = drive_period(system, point["parameter"]) if whole is None else whole
    assert period is not None
    if dt is None:
        return Setup(system, None, 0.0, period)
    if dt > 0.5 * period:
        half = f"{'half a period of the drive' if whole is None else 'half the run'}, {0.5 * period:.6g}"
        raise InputError("dt", dt, f"be at most {half}", "take a smaller dt")
    return Setup(system, scheme, period / round(period / dt), period)


def names_of(point: Row) -> list[str]:
    """The names of a value's numbers."""
    return [name for name in (point["parameter"], point["second"]) if name is not None]


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
    "stop-stiffness": r"stop stiffness $\kappa$", "stiffness": "bending stiffness $k^2$", "viscosity": "viscosity $d$",
    "cells": "cells $L/h$",
    "dt": r"time step $\Delta t$", "alpha": r"$\alpha$", "gamma": r"$\gamma$", "rho": r"$\rho_\infty$",
}  # fmt: skip
PHYSICAL = {"stiffness": "bending stiffness $EI$", "viscosity": r"bending viscosity $\eta$"}


def named(case: Case, name: str) -> str:
    """A parameter on an axis, with its unit where it has one."""
    names = NAMES | (PHYSICAL if case.units else {})
    return with_unit(case.units, names.get(name, name), quantity_of(case, name))
