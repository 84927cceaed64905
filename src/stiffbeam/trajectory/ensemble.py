"""Ensemble: the runs of many members of one system, of a scheme or of a reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, BoolArray
from ..basics.text import DRAW, html_facts, several
from ..basics.units import Units
from ..basics.validation import InputError, non_negative
from ..model.contact import Stops
from ..model.members import EnsembleMembers
from .records import Impacts, Ledger
from .schema import dataset_of, frame_of, named, save, values_of
from .trajectory import Trajectory, Work

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MEMBERS_PER_SLICE = 64  # made by one thread in one go
Progress = Callable[[int], None]


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
    def of(cls, totals: Array, impacts: Impacts, member: NDArray[np.int64]) -> ContactStatistics:
        """Statistics from (fraction, peak_force, impulse, open_at_start) by member, (4, M), and the member of every
        impact."""
        fraction, peak_force, impulse, begun = totals
        offsets = np.concatenate([[0], np.cumsum(np.bincount(member, minlength=len(fraction)))])
        # The sort is stable, so that the impacts of a member stay in order of time.
        impacts = impacts.take(np.argsort(member, kind="stable"))
        return cls(
            fraction=fraction, peak_force=peak_force, impulse=impulse, open_at_start=begun > 0.0,
            impacts=impacts, offsets=offsets,
        )  # fmt: skip

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


@dataclass(frozen=True, eq=False, kw_only=True)
class Runs:
    """Records of M runs with their contacts, the parts of an ensemble.

    tip, tip_velocity: (M, k) at the output times. diverged: (M,), the time at which a run overflowed, NaN for none;
    nothing is recorded after it.
    """

    tip: Array
    tip_velocity: Array
    contacts: tuple[ContactStatistics, ...]
    diverged: Array

    def __len__(self) -> int:
        return len(self.diverged)

    @classmethod
    def of(cls, runs: Sequence[Trajectory], outputs: int | None = None) -> Runs:
        """Runs that were recorded one by one, at least one, with the first ``outputs`` of their output times."""
        contacts = []
        for records in zip(*(run.contacts for run in runs), strict=True):
            begun = [r.impacts.at_start is not None for r in records]
            totals = np.array([(r.fraction, r.peak_force, r.impulse, x) for r, x in zip(records, begun, strict=True)]).T
            member = np.repeat(np.arange(len(runs)), [r.impacts.count for r in records])
            contacts.append(ContactStatistics.of(totals, Impacts.concatenate([r.impacts for r in records]), member))
        return cls(
            tip=np.array([run.tip[:outputs] for run in runs]),
            tip_velocity=np.array([run.tip_velocity[:outputs] for run in runs]),
            contacts=tuple(contacts),
            diverged=np.array([run.diverged for run in runs]),
        )

    @classmethod
    def joined(cls, parts: Sequence[Runs], places: Sequence[int] | None = None) -> Runs:
        """Several Runs as one. places: member numbers (M,) of each, None to keep their order."""
        if len(parts) == 1:
            return parts[0]
        place = np.arange(sum(map(len, parts))) if places is None else np.array(places)
        # ``order`` lists the members of all parts by their numbers.
        order = np.argsort(place)
        contacts = []
        for contact in zip(*(part.contacts for part in parts), strict=True):
            each = [(c.fraction, c.peak_force, c.impulse, c.open_at_start) for c in contact]
            totals = np.concatenate(each, axis=1)[:, order]
            member = np.repeat(place, np.concatenate([c.impact_count for c in contact]))
            contacts.append(ContactStatistics.of(totals, Impacts.concatenate([c.impacts for c in contact]), member))
        names = ("tip", "tip_velocity", "diverged")
        arrays = {name: np.concatenate([getattr(part, name) for part in parts])[order] for name in names}
        return cls(**arrays, contacts=tuple(contacts))


@dataclass(frozen=True, eq=False, kw_only=True)
class Ensemble(Runs):
    """Runs of M members of an ensemble.

    The arrays over the members of the first contact are attributes of the ensemble itself, such as ``impact_count``.

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
        ledger(i): the energy ledger of member i at the output times, or at start and end where there are none, from a
        second run of the member.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> many = sb.integrate_ensemble(system, sb.BDF2(), 1e-4, 0.5, sb.perturbed_members(system, 8), every=100)
    >>> many.tip.shape
    (8, 51)
    """

    members: EnsembleMembers
    t: Array
    work: Work
    provenance: dict[str, Any]
    ledger: Callable[[int], Ledger] = field(repr=False)

    def __repr__(self) -> str:
        return f"<Ensemble {self.label}: {several(len(self), 'member')}, {self.members.parameter}>"

    @property
    def label(self) -> str:
        """Method and form, e.g. ``HHT(alpha=-0.1)@displacement``."""
        return f"{self.provenance['method']}@{self.provenance['form']}"

    @property
    def values(self) -> Array | None:
        """(M,), the value of ``members.parameter`` in every member; None where it is no number."""
        values = np.asarray(self.members.values, object)
        numeric = values.ndim == 1 and all(isinstance(x, (int, float, np.number)) for x in values.tolist())
        return values.astype(float) if numeric else None

    kind = "ensemble"  # in files

    @property
    def units(self) -> Units:
        """Names of the units of length, time and force."""
        return self.members.system.units

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the system, see ``System.fingerprint``."""
        return self.members.system.fingerprint

    @property
    def stops(self) -> list[Stops]:
        """The stops of every contact of the system; those of members may differ."""
        return [contact.stops for contact in self.members.system.contacts]

    def further_attributes(self) -> dict[str, Any]:
        """Attributes of a file of an ensemble beside those of every file."""
        return {"parameter": self.members.parameter}

    def __getitem__(self, name: str) -> Array:
        """The values of a variable by its name in the schema: ``ensemble["contact_fraction"]``, (contacts, M)."""
        return named(self, name)

    def plot(self, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
        """Draw the tip of every member, or where it was not kept what the first contact bears; return ``ax``, or the
        new Figure. kwargs: of ``Axes.plot``."""
        return DRAW["ensemble"](self, ax, **kwargs)

    def _repr_html_(self) -> str:
        facts = [("members", f"{len(self)}, {self.members.parameter}")]
        for i, contact in enumerate(self.contacts):
            counts = contact.impact_count
            text = f"{np.mean(counts):.4g} impacts in the mean, {np.min(counts)} to {np.max(counts)}"
            facts.append((f"contact {i + 1}" if len(self.contacts) > 1 else "contact", text))
        return html_facts(self.label, facts)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each member, the index: the varied parameter by its name where it is a number,
        ``diverged``, and ``impact_count_0``, ``contact_fraction_0``, ... of every contact. Units in ``attrs``."""
        notes = {"parameter": self.members.parameter, "provenance": self.provenance}
        return frame_of(values_of(self), "member", self.units, **notes)

    def to_xarray(self) -> xarray.Dataset:
        """Dimensions member, contact, impact, time; every variable with its unit; provenance as attributes."""
        return dataset_of(self)

    def save(self, file: str | Path) -> Path:
        """Write it in the format that the suffix names: .nc, .json or .mat (all of ``to_xarray``) or .csv
        (``to_dataframe``), whole or not at all. Raises InputError for any other."""
        return save(self, file)

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
    members: EnsembleMembers,
    parts: list[Runs],
    t: Array,
    work: Work,
    provenance: dict[str, Any],
    ledger: Callable[[int], Ledger],
) -> Ensemble:
    """The Ensemble of the runs of its members, ``parts`` in their order."""
    runs = Runs.joined(parts)
    return Ensemble(**vars(runs), members=members, t=t, work=work, provenance=provenance, ledger=ledger)


def record_from(since: float, t_end: float) -> float:
    """``since``, the time after which contacts are recorded. Raises InputError outside [0, t_end)."""
    if not non_negative("since", since) < t_end:
        remedy = "for example 0.0, to record from the start"
        raise InputError("since", since, f"be a time before t_end = {t_end:g}", remedy)
    return since
