"""Ensemble: the runs of many members of one system, of a scheme or of a reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, BoolArray
from ..basics.text import several
from ..basics.validation import InputError, number
from ..model.contact import Stops
from ..model.members import EnsembleMembers
from .records import ContactRecord, Impacts, Ledger
from .schema import Saved
from .trajectory import Trajectory, Work


@dataclass(frozen=True, eq=False, kw_only=True)
class ContactStatistics:
    """Record of one contact in all members, see ContactRecord.

    fraction, peak_force, impulse: (M,). open_at_start: (M,), True if the contact exists at t = 0, which is no impact
    but is part of the other numbers. impacts: those of all members, one member after the other; member i has the rows
    offsets[i] to offsets[i + 1].
    """

    fraction: Array
    peak_force: Array
    impulse: Array
    open_at_start: BoolArray
    impacts: Impacts
    offsets: NDArray[np.int64]

    @classmethod
    def of(cls, records: Sequence[ContactRecord]) -> ContactStatistics:
        """Statistics of the records of one contact, one a member."""
        return cls(
            **{name: np.array([getattr(r, name) for r in records]) for name in ("fraction", "peak_force", "impulse")},
            open_at_start=np.array([r.open_at_start for r in records]),
            impacts=Impacts.concatenate([r.impacts for r in records]),
            offsets=np.cumsum([0, *(r.impacts.count for r in records)]),
        )

    @property
    def impact_count(self) -> NDArray[np.int64]:
        """(M,)."""
        return np.diff(self.offsets)

    def __repr__(self) -> str:
        return f"<ContactStatistics: {several(len(self.fraction), 'member')}, {several(self.impacts.count, 'impact')}>"

    def impacts_of(self, member: int) -> Impacts:
        """The impacts of one member."""
        rows = slice(self.offsets[member], self.offsets[member + 1])
        return self.impacts.take(rows)


def slim(run: Trajectory, outputs: int | None = None) -> Trajectory:
    """The part of a run that an ensemble keeps: tip and velocity at the first ``outputs`` times, and its statistics."""
    none = np.zeros(0)
    contacts = tuple(replace(c, position=none, velocity=none, force=none) for c in run.contacts)
    motion = {name: getattr(run, name)[:outputs].copy() for name in ("t", "tip", "tip_velocity")}
    return Trajectory(**motion, contacts=contacts, work=run.work, provenance={}, diverged=run.diverged)


@dataclass(frozen=True, eq=False, kw_only=True)
class Ensemble(Saved):
    """Runs of M members of an ensemble.

    Parameters
    ----------
    tip, tip_velocity : array (M, k)
    contacts : sequence of ContactStatistics
        One per contact, arrays over the members.
    diverged : array (M,)
        The time at which a member overflowed, else NaN.
    members : EnsembleMembers
    t : array (k,)
        Output times; k = 0 unless they were asked for.
    work : Work
        ``steps`` counts member-steps.
    provenance : dict
    ledger : callable
        ledger(i): the energy ledger of member i at the output times, or at start and end, from a second run.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> many = sb.integrate_ensemble(system, sb.BDF2(), 1e-4, 0.5, sb.perturbed_members(system, 8), every=100)
    >>> many.tip.shape
    (8, 51)
    """

    tip: Array
    tip_velocity: Array
    contacts: tuple[ContactStatistics, ...]
    diverged: Array
    members: EnsembleMembers
    t: Array
    work: Work
    provenance: dict[str, Any]
    ledger: Callable[[int], Ledger] = field(repr=False)

    @classmethod
    def of(cls, runs: Sequence[Trajectory], **others: Any) -> Ensemble:
        """The records of single runs, at least one; others: the other fields."""
        return cls(
            tip=np.array([run.tip for run in runs]),
            tip_velocity=np.array([run.tip_velocity for run in runs]),
            contacts=tuple(map(ContactStatistics.of, zip(*(run.contacts for run in runs), strict=True))),
            diverged=np.array([run.diverged for run in runs]),
            **others,
        )

    def __len__(self) -> int:
        return len(self.diverged)

    def __repr__(self) -> str:
        return f"<Ensemble {self.label}: {several(len(self), 'member')}>"

    kind = "ensemble"  # in files

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the system, see ``System.fingerprint``."""
        return self.members.system.fingerprint

    @property
    def stops(self) -> list[Stops]:
        """The stops of every contact of the system; those of members may differ."""
        return [contact.stops for contact in self.members.system.contacts]


def record_from(since: float, t_end: float) -> float:
    """``since``, the time after which contacts are recorded. Raises InputError outside [0, t_end)."""
    if not number("since", since, least=0.0) < t_end:
        remedy = "for example 0.0, to record from the start"
        raise InputError("since", since, f"be a time before t_end = {t_end:g}", remedy)
    return since
