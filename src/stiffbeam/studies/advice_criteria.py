"""The errors of a run: one motion against the exact one, or means of an ensemble against those of exact motions."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..march.ensemble import integrate_ensemble
from ..march.integrate import integrate
from ..measures.errors import tip_error
from ..model.members import SPREAD, perturbed
from ..model.system import System
from ..references.ensemble import reference_ensemble
from ..schemes import Scheme
from ..trajectory.trajectory import Diverged, Reference
from .ensemble import difference

COLUMNS = (("impacts", "impact_count"), ("peak_force", "peak_force"), ("impulse", "impulse"))  # of an ensemble


class Criterion:
    """The errors of a run with this scheme, contact treatment and step, and what it cost."""

    def __init__(self) -> None:
        self.scatter: dict[str, float] = {}
        self.point = {"members": 0}  # what tells its runs from those of another criterion

    def errors(
        self, system: System, scheme: Scheme, contact: str, dt: float, t_end: float
    ) -> tuple[dict[str, Any], float]:
        """(relative errors by name, seconds of one run); Diverged where a run overflows."""
        raise NotImplementedError


class Motion(Criterion):
    """One motion against the exact one."""

    def __init__(self, exact: Reference) -> None:
        super().__init__()
        self.exact = exact

    def errors(
        self, system: System, scheme: Scheme, contact: str, dt: float, t_end: float
    ) -> tuple[dict[str, Any], float]:
        """Of tip (rms), impact count, peak force and impulse, the worst over the contacts."""
        run = integrate(system, scheme, dt, t_end, contact)
        found = {"tip": tip_error(run.tip, self.exact.at(run.t)[0]).rms}
        pairs = list(zip(run.contacts, self.exact.contacts, strict=True))
        found["impacts"] = max(
            (abs(a.impacts.count - b.impacts.count) / max(b.impacts.count, 1) for a, b in pairs), default=0.0
        )
        for name in ("peak_force", "impulse"):
            found[name] = max((_relative(getattr(a, name), getattr(b, name)) for a, b in pairs), default=0.0)
        return found, run.work.march_seconds


def _relative(found: float, wanted: float) -> float:
    if wanted == 0.0:
        return 0.0 if found == 0.0 else np.inf
    return abs(found / wanted - 1.0)


class Statistics(Criterion):
    """Means over perturbed members against those of the exact ensemble, with the interval of the difference."""

    def __init__(self, system: System, t_end: float, members: int) -> None:
        super().__init__()
        self.point = {"members": members}
        self.members = perturbed(system, members, SPREAD, t_end=t_end)
        self.exact = reference_ensemble(system, t_end, self.members)
        self.scatter = {
            name: max((_deviation(getattr(contact, own)) for contact in self.exact.contacts), default=0.0)
            for name, own in COLUMNS
        }

    def errors(
        self, system: System, scheme: Scheme, contact: str, dt: float, t_end: float
    ) -> tuple[dict[str, Any], float]:
        """Of the means over all members, with the interval that their spread leaves, the worst over the contacts."""
        many = integrate_ensemble(system, scheme, dt, t_end, self.members, contact)
        if np.any(np.isfinite(many.diverged)):
            raise Diverged(str(scheme), float(np.nanmin(many.diverged)), "use a smaller dt")
        found: dict[str, float] = {}
        for name, own in COLUMNS:
            pairs = zip(many.contacts, self.exact.contacts, strict=True)
            found[name] = max(_mean_off(getattr(a, own), getattr(b, own)) for a, b in pairs)
        return found, many.work.march_seconds / len(self.members)


def _deviation(values: Array) -> float:
    mean = float(np.mean(values))
    return float(np.std(values, ddof=1)) / mean if mean else 0.0


def _mean_off(found: Array, wanted: Array) -> float:
    """|difference of the means| and its 95 % interval, over the wanted mean."""
    off, interval = difference(np.asarray(found, float), np.asarray(wanted, float))
    mean = float(np.mean(wanted))
    if mean == 0.0:
        return 0.0 if off == 0.0 else np.inf
    return (abs(off) + interval) / mean
