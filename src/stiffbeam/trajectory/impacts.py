"""The record of a contact: its impacts, position and force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array, BoolArray
from ..basics.notebook import DRAW, html_table
from ..basics.validation import bound
from ..model.contact import Stops
from .schema import IMPACT_FIELDS, frame_of

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 20  # rows in a notebook
COLUMNS = tuple(IMPACT_FIELDS)  # attributes of Impacts: times, ends, stops, peaks, impulses


@dataclass(frozen=True, eq=False, kw_only=True)
class Impacts:
    """Entries into a stop, in order of time; one array (count,) for each column.

    An impact of kind "event" is a time t* > 0 where the contact state chi goes from 0 to +-1. One of kind "sampled" is
    a step n >= 1 with chi_n != 0 and chi_n != chi_{n-1}; its time is the first crossing of the stop by the cubic
    Hermite interpolant of (u, u'), and so is its end, in the first step that leaves the stop. Against rigid stops a
    scheme's impact is a row of steps with a reaction.

    Contact at t = 0 is no impact, in either kind and with every law. This holds for a motion that begins beyond a stop,
    or exactly on one without leaving it, and for the impact of a rigid stop at t = 0. That contact ends when the gap
    first opens, and later entries count. Its force and impulse belong to the contact, and ``at_start`` holds them in a
    row of its own, which tables and files list first and mark as open at the start. Touching without penetration does
    not count either. Limitation: for a start at rest on a stop whose force is exactly zero, rounding decides.

    Parameters
    ----------
    times, ends : array (count,)
        Of entry and of exit.
    stops : array (count,)
        +1 upper, -1 lower.
    peaks, impulses : array (count,)
        max |sigma| and the integral of |sigma|. Ends, peaks and impulses are NaN for an impact still open at the end,
        and where the solver does not measure them.
    kind : {"event", "sampled"}
    at_start : Impacts, optional
        The contact at t = 0, a table of one row with time 0; None where there is none or where it never presses.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> impacts = sb.reference(sb.paper_case(10).system(), t_end=0.2).impacts
    >>> impacts.count, impacts.kind
    (42, 'event')
    """

    times: Array
    ends: Array
    stops: NDArray[np.int64]
    peaks: Array
    impulses: Array
    kind: str
    at_start: Impacts | None = None

    @property
    def count(self) -> int:
        """The number of impacts, at t > 0: one still open at the end counts, contact at t = 0 does not."""
        return len(self.times)

    @property
    def durations(self) -> Array:
        """Durations of the contacts, from entry to exit, (count,)."""
        return self.ends - self.times

    @property
    def median_peak(self) -> float:
        """Median of the peaks that are known, NaN for none."""
        peaks = self.peaks[np.isfinite(self.peaks)]
        return float(np.median(peaks)) if len(peaks) else float("nan")

    def take(self, rows: Any) -> Impacts:
        """The impacts of these rows: a slice, numbers, or a mask (count,)."""
        return replace(self, **{name: getattr(self, name)[rows] for name in COLUMNS})

    def until(self, t: float) -> Impacts:
        """The impacts at times <= t."""
        return self.take(self.times <= bound("t", t))

    def listed(self) -> tuple[Impacts, BoolArray]:
        """Rows of the contact at t = 0, if any, and of the impacts; which of them are open at the start."""
        rows = [table for table in (self.at_start, self) if table is not None]
        return Impacts.concatenate(rows), np.arange(sum(table.count for table in rows)) < len(rows) - 1

    def started(self, first: BoolArray) -> Impacts:
        """The impacts of these rows without the ``first`` (count,) ones, which are a contact that exists at t = 0."""
        held, others = self.take(first), self.take(~first)
        # A contact at t = 0 that never presses has no row.
        if not held.count or np.all(held.impulses == 0.0):
            return others
        # Several rows before the gap first opens are one contact.
        largest, total = np.array([np.max(held.peaks)]), np.array([np.sum(held.impulses)])
        whole = replace(held.take(slice(0, 1)), times=np.zeros(1), ends=held.ends[-1:], peaks=largest, impulses=total)
        return replace(others, at_start=whole)

    @staticmethod
    def concatenate(tables: Sequence[Impacts]) -> Impacts:
        """One table of the rows of several tables of one kind, in their order, without their ``at_start``."""
        columns: Any = {name: np.concatenate([getattr(table, name) for table in tables]) for name in COLUMNS}
        return Impacts(**columns, kind=tables[0].kind)

    @staticmethod
    def at(times: ArrayLike, stops: ArrayLike, kind: str, **columns: ArrayLike) -> Impacts:
        """Impacts with some columns given; the others are NaN. Events at t = 0 are the contact at the start."""
        times = np.asarray(times, float)
        others: Any = {name: np.asarray(columns.get(name, np.full(len(times), np.nan)), float)
                       for name in ("ends", "peaks", "impulses")}  # fmt: skip
        impacts = Impacts(times=times, stops=np.asarray(stops, np.int64), **others, kind=kind)
        return impacts.started(times <= 0.0) if kind == "event" else impacts

    def __repr__(self) -> str:
        span = f", t = {self.times[0]:g} to {self.times[-1]:g}" if self.count else ""
        return f"<Impacts: {self.count} {self.kind}{span}{', open at the start' if self.at_start else ''}>"

    def plot(self, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
        """Draw the largest force, or of rigid stops the impulse, of every impact against its time; return ``ax``, or
        the new Figure. kwargs: of ``Axes.plot``."""
        return DRAW["impacts"](self, ax, **kwargs)

    def _repr_html_(self) -> str:
        rows, flags = self.listed()
        most = slice(0, SHOWN)
        lines = [
            ["at t = 0" if first else str(number), f"{t:.6g}", f"{end:.6g}", f"{stop:+d}", f"{peak:.4g}",
             f"{impulse:.4g}"]
            for number, (first, t, end, stop, peak, impulse) in enumerate(
                zip(flags[most], rows.times[most], rows.ends[most], rows.stops[most], rows.peaks[most],
                    rows.impulses[most], strict=True),
                start=int(not np.any(flags)),
            )
        ]  # fmt: skip
        first = f", the first {SHOWN}" if rows.count > SHOWN else ""
        heads = ["impact", *IMPACT_FIELDS.values()]
        return html_table(heads, lines, f"{self.count} {self.kind} impacts{first}")

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each impact: ``impact_time`` to ``impact_impulse``, ``impact_open_at_start`` for the contact
        at t = 0."""
        rows, flags = self.listed()
        columns = {name: (("impact",), getattr(rows, field)) for field, name in IMPACT_FIELDS.items()}
        return frame_of(columns | {"impact_open_at_start": (("impact",), flags)}, "impact")

    @staticmethod
    def none(kind: str) -> Impacts:
        """An empty table, of ``kind`` "event" or "sampled"."""
        return Impacts.at([], [], kind)


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """The record of one contact.

    position, velocity: relative to its stops, row q + offset, for a beam u(x, t) - m(t), at the output times. force:
    sigma on the beam, < 0 on the upper stop. impacts, share of time in contact, peak |sigma| and impulse: over every
    step; peak and impulse include the force at t = 0, the impulse by the trapezoidal rule. For rigid stops force is the
    reaction: in a scheme's run the mean over the previous step, in the exact solution that of a held contact without
    its impulses. Rigid stops have impulses and no peak, NaN.
    """

    stops: Stops
    position: Array
    velocity: Array
    force: Array
    impacts: Impacts
    fraction: float
    peak_force: float
    impulse: float

    @property
    def impact_count(self) -> int:
        """Number of impacts."""
        return self.impacts.count

    @property
    def open_at_start(self) -> bool:
        """True for a contact that is there at t = 0, which is no impact."""
        return self.impacts.at_start is not None

    @property
    def scale(self) -> float:
        """Scale of an error of ``position``: max |position|, or the gap to the nearer stop."""
        nearer = min((abs(g) for g in (self.stops.lower_bound, self.stops.upper_bound) if np.isfinite(g)), default=0.0)
        return max(float(np.max(np.abs(self.position))), nearer)

    def __repr__(self) -> str:
        return (
            f"<ContactRecord {self.stops}: {self.impacts.count} impacts, in contact {100 * self.fraction:.3g} % of "
            f"the time, peak force {self.peak_force:.4g}, impulse {self.impulse:.4g}>"
        )
