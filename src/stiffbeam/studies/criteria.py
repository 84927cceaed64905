"""Errors by which ``advise`` judges a run: of one motion, and past the horizon of means over perturbed members."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..march.ensemble import integrate_ensemble
from ..march.integrate import integrate
from ..measures.errors import tip_error
from ..measures.rates import contact_rates
from ..model.members import SPREAD, perturbed_members
from ..model.system import System
from ..references import best_reference
from ..references.ensemble import reference_ensemble
from ..schemes import Scheme
from ..trajectory.trajectory import Diverged, Reference, Trajectory
from .ensemble import difference

COLUMNS = (("impacts", "impact_count"), ("peak_force", "peak_force"), ("impulse", "impulse"))  # of an ensemble
WORK = "normal_work"  # a run that is asked for it is integrated twice, for the force at every step


class Motion:
    """Errors of one motion against the exact one."""

    members = 0
    scatter: Mapping[str, float] = {}

    def __init__(self, exact: Reference, work: bool) -> None:
        self.exact = exact
        self.work = _work_rates(exact) if work else None

    def errors(
        self, system: System, scheme: Scheme, contact: str, dt: float, t_end: float
    ) -> tuple[dict[str, Any], float]:
        """Errors of tip (rms), impact count, peak force and impulse, the worst over the contacts, and seconds."""
        run = integrate(system, scheme, dt, t_end, contact)
        pairs = list(zip(run.contacts, self.exact.contacts, strict=True))
        counts = (abs(a.impacts.count - b.impacts.count) / max(b.impacts.count, 1) for a, b in pairs)
        errors = {"tip": tip_error(run.tip, self.exact.at(run.t)[0]).rms, "impacts": max(counts, default=0.0)}
        for name in ("peak_force", "impulse"):
            errors[name] = max((_relative(getattr(a, name), getattr(b, name)) for a, b in pairs), default=0.0)
        if self.work is not None:
            errors[WORK] = max(map(_relative, _work_rates(run), self.work), default=0.0)
        return errors, run.work.march_seconds


class Statistics:
    """Errors of means over perturbed members against those of the exact ensemble."""

    def __init__(self, system: System, t_end: float, members: int, work: bool) -> None:
        self.members = members
        self.systems = perturbed_members(system, members, SPREAD, t_end=t_end)
        self.exact = reference_ensemble(system, t_end, self.systems)
        self.scatter = {
            name: max((_deviation(getattr(contact, column)) for contact in self.exact.contacts), default=0.0)
            for name, column in COLUMNS
        }
        # By contact and member.
        self.work = np.transpose([_work_rates(best_reference(x, t_end)) for x in self.systems]) if work else None
        if self.work is not None:
            self.scatter[WORK] = max(map(_deviation, self.work), default=0.0)

    def errors(
        self, system: System, scheme: Scheme, contact: str, dt: float, t_end: float
    ) -> tuple[dict[str, Any], float]:
        """Errors of the means with the 95 % intervals of the differences, the worst over the contacts, and seconds of
        a member; Diverged where one overflows."""
        many = integrate_ensemble(system, scheme, dt, t_end, self.systems, contact)
        if np.any(np.isfinite(many.diverged)):
            raise Diverged(str(scheme), float(np.nanmin(many.diverged)), "use a smaller dt")
        errors: dict[str, float] = {}
        for name, column in COLUMNS:
            pairs = zip(many.contacts, self.exact.contacts, strict=True)
            errors[name] = max(_mean_error(getattr(a, column), getattr(b, column)) for a, b in pairs)
        if self.work is not None:
            rates = np.transpose([_work_rates(integrate(x, scheme, dt, t_end, contact)) for x in self.systems])
            with np.errstate(all="ignore"):  # a run may have grown to 1e200
                errors[WORK] = float(np.nan_to_num(max(map(_mean_error, rates, self.work)), nan=np.inf))
        return errors, many.work.march_seconds / len(self.systems)


def _work_rates(run: Trajectory) -> list[float]:
    """Normal work rate at every contact, infinite where the run has grown beyond numbers."""
    with np.errstate(all="ignore"):
        return [float(np.nan_to_num(each[WORK].value, nan=np.inf)) for each in contact_rates(run).rates]


def _relative(value: float, exact: float) -> float:
    """|value - exact| over the exact value; where that is 0, infinite unless the value is 0 too."""
    if exact == 0.0:
        return 0.0 if value == 0.0 else np.inf
    return abs(value / exact - 1.0)


def _deviation(values: Array) -> float:
    mean = float(np.mean(values))
    return float(np.std(values, ddof=1)) / mean if mean else 0.0


def _mean_error(values: Array, exact: Array) -> float:
    """|difference of the means| with its 95 % interval, over the exact mean."""
    off, interval = difference(np.asarray(values, float), np.asarray(exact, float))
    mean = float(np.mean(exact))
    return _relative(off, mean) if mean == 0.0 else (abs(off) + interval) / mean
