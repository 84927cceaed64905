"""Ensemble: the runs of many members of one system, of a scheme or of a reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, BoolArray
from ..basics.validation import InputError, non_negative
from ..model.members import Members
from .ensemble_dataset import ensemble_dataset, save_ensemble
from .impacts import Impacts
from .ledger import Ledger
from .records import Records
from .tables import table
from .trajectory import Work

if TYPE_CHECKING:
    import pandas
    import xarray

MEMBERS_PER_SLICE = 64  # made by one thread in one go
Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class ContactStatistics:
    """One contact in all members, see ContactRecord.

    fraction, peak_force, impulse: (M,). open_at_start: (M,), whether the contact is there at t = 0, which is no impact
    and belongs to the other numbers all the same. impacts: those of all members, one member after the other;
    member i has the rows offsets[i] to offsets[i + 1].
    """

    fraction: Array
    peak_force: Array
    impulse: Array
    open_at_start: BoolArray
    impacts: Impacts
    offsets: NDArray[np.int64]

    @property
    def impact_count(self) -> NDArray[np.int64]:
        """(M,)."""
        return np.diff(self.offsets)

    def __repr__(self) -> str:
        return f"<ContactStatistics: {len(self.fraction)} members, {self.impacts.count} impacts>"

    def impacts_of(self, member: int) -> Impacts:
        """The impacts of one member."""
        rows = slice(self.offsets[member], self.offsets[member + 1])
        return self.impacts.take(rows)


@dataclass(frozen=True, eq=False, kw_only=True)
class Ensemble:
    """What M members have done.

    contacts: one record per contact; the arrays over members of the first stand on the ensemble itself.
    t: (k,) output times, tip and tip_velocity: (M, k); k = 0 unless they were asked for. diverged:
    (M,), the time at which a member overflowed, NaN for none; nothing is recorded after it. work.steps
    counts member-steps. ledger(i): the energy ledger of member i at the output times, at the start and
    the end where there are none, made by going through the member once more.
    """

    members: Members
    contacts: tuple[ContactStatistics, ...]
    t: Array
    tip: Array
    tip_velocity: Array
    diverged: Array
    work: Work
    provenance: dict[str, Any]
    ledger: Callable[[int], Ledger] = field(repr=False)

    def __len__(self) -> int:
        return len(self.members)

    def __repr__(self) -> str:
        return f"<Ensemble {self.label}: {len(self)} members, {self.members.parameter}>"

    @property
    def label(self) -> str:
        """Method and form, e.g. ``hht(alpha=-0.1)@displacement``."""
        return f"{self.provenance['method']}@{self.provenance['form']}"

    def to_dataframe(self) -> pandas.DataFrame:
        """One line per member: its value of ``members.parameter`` where that is a number, when it diverged (NaN: not),
        and of every contact the impacts, share of time, peak force, impulse and whether it is open at the start."""
        columns: dict[str, Any] = {"member": np.arange(len(self))}
        values = np.asarray(self.members.values, object)
        if values.ndim == 1 and all(isinstance(x, (int, float, np.number)) for x in values.tolist()):
            columns["value"] = values.astype(float)
        columns["diverged"] = self.diverged
        for i, contact in enumerate(self.contacts):
            columns |= {
                f"contact{i}_impacts": contact.impact_count,
                f"contact{i}_fraction": contact.fraction,
                f"contact{i}_peak_force": contact.peak_force,
                f"contact{i}_impulse": contact.impulse,
                f"contact{i}_open_at_start": contact.open_at_start,
            }
        return table(columns, {"parameter": self.members.parameter, "provenance": self.provenance})

    def to_xarray(self) -> xarray.Dataset:
        """Dimensions member, contact, impact, time; every variable with its unit; provenance as attributes."""
        return ensemble_dataset(self)

    def save(self, file: str | Path) -> Path:
        """Write it in the format that the suffix names: .nc (all of ``to_xarray``) or .csv (``to_dataframe``), whole
        or not at all. Raises InputError for any other."""
        return save_ensemble(self, file)

    @property
    def contact(self) -> ContactStatistics:
        """The first contact's record; InputError without contact."""
        if not self.contacts:
            remedy = "give the system contacts"
            raise InputError("contact", "a system without contacts", "be asked of one with stops", remedy)
        return self.contacts[0]

    @property
    def impact_count(self) -> NDArray[np.int64]:
        """(M,) at the first contact."""
        return self.contact.impact_count

    @property
    def contact_fraction(self) -> Array:
        """(M,) share of the steps in contact, of the time for an exact ensemble."""
        return self.contact.fraction

    @property
    def peak_force(self) -> Array:
        """(M,) max |sigma|."""
        return self.contact.peak_force

    @property
    def impulse(self) -> Array:
        """(M,) integral of |sigma|."""
        return self.contact.impulse

    @property
    def impacts(self) -> Impacts:
        """All impacts at the first contact, one member after the other, see ``contact.offsets``."""
        return self.contact.impacts


def gathered(
    members: Members,
    parts: list[Records],
    t: Array,
    work: Work,
    provenance: dict[str, Any],
    ledger: Callable[[int], Ledger],
) -> Ensemble:
    """The Ensemble of the records of its members, ``parts`` in their order."""
    seen = Records.joined(parts)
    contacts = [
        ContactStatistics(
            fraction=seen.fraction[:, c],
            peak_force=seen.peak_force[:, c],
            impulse=seen.impulse[:, c],
            open_at_start=seen.open_at_start[:, c],
            impacts=seen.impacts[c],
            offsets=np.concatenate([[0], np.cumsum(np.bincount(whose, minlength=len(seen)))]),
        )
        for c, whose in enumerate(seen.whose)
    ]
    return Ensemble(
        members=members,
        contacts=tuple(contacts),
        t=t,
        tip=seen.tip,
        tip_velocity=seen.tip_velocity,
        diverged=seen.diverged,
        work=work,
        provenance=provenance | ({"march": " and ".join(sorted(seen.marches))} if any(seen.marches) else {}),
        ledger=ledger,
    )


def record_from(since: float, t_end: float) -> float:
    """``since``, the time after which contacts are recorded. Raises InputError outside [0, t_end)."""
    if not non_negative("since", since) < t_end:
        remedy = "for example 0.0, to record from the start"
        raise InputError("since", since, f"be a time before t_end = {t_end:g}", remedy)
    return since
