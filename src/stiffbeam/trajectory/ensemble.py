"""Ensemble: the runs of many members of one system, of a scheme or of a reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.validation import InputError, non_negative
from ..model.members import Members
from .dataset import ensemble_dataset, save_ensemble
from .impacts import Impacts
from .ledger import Ledger
from .recorder import Seen
from .tables import table
from .trajectory import Work

if TYPE_CHECKING:
    import pandas
    import xarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Records:
    """What M runs have seen with their m contacts.

    tip, tip_velocity: (M, k) at the output times. fraction, peak_force, impulse: (M, m), see ContactRecord. impacts: of
    every contact those of all runs, one run after the other; whose: of every contact the run of each. diverged: (M,),
    NaN for none. marches: how the runs were made.
    """

    tip: Array
    tip_velocity: Array
    fraction: Array
    peak_force: Array
    impulse: Array
    impacts: tuple[Impacts, ...]
    whose: tuple[NDArray[np.int64], ...]
    diverged: Array
    marches: frozenset[str]

    def __len__(self) -> int:
        return len(self.diverged)

    @classmethod
    def of(cls, seen: Sequence[Seen]) -> Records:
        """Of runs that were recorded one by one, at least one."""
        runs, m = [one.contacts for one in seen], len(seen[0].contacts)
        numbers = [[[r.fraction, r.peak_force, r.impulse] for r in records] for records in runs]
        fraction, peak_force, impulse = np.array(numbers, float).reshape(len(seen), m, 3).transpose(2, 0, 1)
        impacts = [[records[c].impacts for records in runs] for c in range(m)]
        return cls(
            tip=np.array([one.tip for one in seen]),
            tip_velocity=np.array([one.tip_velocity for one in seen]),
            fraction=fraction,
            peak_force=peak_force,
            impulse=impulse,
            impacts=tuple(Impacts.concatenate(each) for each in impacts),
            whose=tuple(np.repeat(np.arange(len(seen)), [one.count for one in each]) for each in impacts),
            diverged=np.array([one.diverged for one in seen]),
            marches=frozenset(one.march for one in seen),
        )

    @classmethod
    def joined(cls, parts: Sequence[Records], places: Sequence[int] | None = None) -> Records:
        """One after the other; places: where each run then belongs, (M,), None for there."""
        if len(parts) == 1:
            return parts[0]
        names = ("tip", "tip_velocity", "fraction", "peak_force", "impulse", "diverged")
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        first = np.cumsum([0, *(len(part) for part in parts[:-1])])
        whose, impacts = [], []
        for c in range(len(parts[0].impacts)):
            whose.append(np.concatenate([part.whose[c] + k for part, k in zip(parts, first, strict=True)]))
            impacts.append(Impacts.concatenate([part.impacts[c] for part in parts]))
        if places is not None:
            place = np.array(places)
            arrays = {name: values[np.argsort(place)] for name, values in arrays.items()}
            for c, of in enumerate(whose):
                order = np.argsort(place[of], kind="stable")
                whose[c], impacts[c] = place[of][order], impacts[c].take(order)
        marches = frozenset[str]().union(*(part.marches for part in parts))
        return cls(**arrays, whose=tuple(whose), impacts=tuple(impacts), marches=marches)


MEMBERS_PER_SLICE = 64  # made by one thread in one go
Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class ContactStatistics:
    """One contact in all members, see ContactRecord.

    fraction, peak_force, impulse: (M,). impacts: those of all members, one member after the other;
    member i has the rows offsets[i] to offsets[i + 1].
    """

    fraction: Array
    peak_force: Array
    impulse: Array
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
        and of every contact the impacts, share of time, peak force and impulse."""
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
