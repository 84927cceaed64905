"""The records of a run: impacts, position and force of each contact, and the energy balance step by step."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array, BoolArray
from ..basics.text import several
from ..basics.validation import number
from ..model.contact import Stops, channel_motion
from ..model.modes import Modes
from ..model.system import System
from ..model.time_functions import evaluate
from .schema import IMPACT_FIELDS

if TYPE_CHECKING:
    import pandas


COLUMNS = tuple(IMPACT_FIELDS)  # attributes of Impacts: times, ends, stops, peaks, impulses


STILL = 1e-9  # of the motion: that of a point which stands still is rounding


def last_before(t: Array, wrong: BoolArray, end: float) -> float:
    """The output time before the first that is ``wrong``, 0.0 where that is the first of all; ``end`` if none is."""
    first = np.flatnonzero(wrong)[:1]
    return end if not len(first) else float(t[first[0] - 1]) if first[0] else 0.0


def at_rest_until(t: Array, u: Array, scale: float) -> float:
    """The last output time before a contact has moved from its start, by STILL of the ``scale``; 0.0 if t[0] > 0."""
    return 0.0 if t[0] > 0.0 else last_before(t, np.abs(u - u[0]) > STILL * scale, float(t[-1]))


@dataclass(frozen=True, eq=False, kw_only=True)
class Impacts:
    """Entries into a stop, in order of time; one array (count,) for each column.

    An impact of kind "event" is a time t* > 0 where the contact state chi goes from 0 to +-1. One of kind "sampled" is
    a step n >= 1 with chi_n != 0 and chi_n != chi_{n-1}; its time is the first crossing of the stop by the cubic
    Hermite interpolant of (u, u'), and so is its end, in the first step that leaves the stop. A damped stop lets go
    before that, where the secant of its force is zero. At rigid stops it is a row of steps with a reaction.

    Contact at t = 0 is no impact, in either kind and with every law. This holds for a motion that begins beyond a stop,
    or exactly on one without leaving it, and for the impact of a rigid stop at t = 0. That contact ends when the gap
    first opens, and later entries count. Its force and impulse belong to the contact, and ``at_start`` holds them in a
    row of its own, which tables and files list first and mark as open at the start. Touching without penetration does
    not count either. Limitation: rounding decides for a start at rest on a stop without force, and until a motion from
    elsewhere arrives. Horizons and ``compare`` count impacts from where the contact has moved by 1e-9 of its motion.

    Parameters
    ----------
    times, ends : array (count,)
        Times of entry and of exit.
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

    def take(self, rows: Any) -> Impacts:
        """The impacts of these rows: a slice, numbers, or a mask (count,)."""
        return replace(self, **{name: getattr(self, name)[rows] for name in COLUMNS})

    def until(self, t: float) -> Impacts:
        """The impacts at times <= t."""
        return self.take(self.times <= (np.inf if t == np.inf else number("t", t)))

    def listed(self) -> tuple[Impacts, BoolArray]:
        """Rows of the contact at t = 0, if any, and of the impacts; which of them are open at the start."""
        rows = [table for table in (self.at_start, self) if table is not None]
        return Impacts.concatenate(rows), np.arange(sum(table.count for table in rows)) < len(rows) - 1

    def started(self, first: BoolArray) -> Impacts:
        """The impacts of these rows without the ``first`` (count,) ones, which are a contact that exists at t = 0."""
        if not first.any():
            return self
        held, others = self.take(first), self.take(~first)
        # A contact at t = 0 that never presses has no row.
        if np.all(held.impulses == 0.0):
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
        how = "by events" if self.kind == "event" else self.kind
        return f"<Impacts: {self.count} {how}{span}{', in contact at t = 0' if self.at_start else ''}>"

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each impact: ``impact_time`` to ``impact_impulse``, ``impact_open_at_start`` for the contact
        at t = 0."""
        import pandas

        rows, flags = self.listed()
        columns = {name: getattr(rows, field) for field, name in IMPACT_FIELDS.items()}
        return pandas.DataFrame(columns | {"impact_open_at_start": flags}).rename_axis("impact")


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
        nearer = min(map(abs, self.stops.sides.values()), default=0.0)
        return max(float(np.max(np.abs(self.position))), nearer)

    def __repr__(self) -> str:
        return (
            f"<ContactRecord {self.stops}: {several(self.impacts.count, 'impact')}, in contact "
            f"{100 * self.fraction:.3g} % of the time, peak force {self.peak_force:.4g}, impulse {self.impulse:.4g}>"
        )


RESOLVED = 1e-3  # of the energy supplied: what a loss may be off by where it is known


@dataclass(frozen=True, eq=False)
class Ledger:
    """Energy balance: energies at times t (k,), and work, dissipation and loss since t = 0; every array (k,).

        kinetic, elastic, stops    1/2 q'^T M q', 1/2 q^T K q (bending) and sum U; energy E is their sum
        input    sum over steps of 1/2 (F^n + F^{n+1}) . dq,  F the load vector; a stop that moves
                 against its contact by do_c puts in -1/2 (F_c^n + F_c^{n+1}) do_c
        viscous  sum over steps of dq^T C dq / dt
        stop_dissipation   sum over steps of -1/2 (D^n + D^{n+1}) du, D = F + U' what a damped stop takes beyond
                 the force of its energy U; the energy left in it when the contact ends counts as dissipated while the
                 gap opens;
                 of rigid stops what impacts take, see ``step_ledger``
        spread   by how much two rules for what dashpots and damped stops take differ, sum over steps of
                 |dq^T C dq / dt - dt v^T C v|, v = (q'^n + q'^{n+1})/2, and of |(D^n + D^{n+1}) du - dt (D u'|^n +
                 D u'|^{n+1})|/2, of a step in which D begins or ends all of it; large where a step does not resolve
                 them, and what they take then counts as loss, or loss as that
        loss     E_n - E_{n+1} + d_input - d_viscous - d_stop_dissipation, summed; > 0: lost by the scheme
        loss_in_contact, loss_without_contact   the part of ``loss`` in steps with a contact at either end, and without

    The trapezoidal rule loses energy only at the kink of the contact law, the exact flow none.
    """

    t: Array
    kinetic: Array
    elastic: Array
    stops: Array
    input: Array
    viscous: Array
    loss: Array
    loss_in_contact: Array
    loss_without_contact: Array
    stop_dissipation: Array
    spread: Array

    def __repr__(self) -> str:
        return (
            f"<Ledger: {len(self.t)} times to {self.t[-1]:g}, energy {self.energy[0]:.4g} to {self.energy[-1]:.4g}, "
            f"input {self.input[-1]:.4g}, viscous {self.viscous[-1]:.4g}, loss {self.loss[-1]:.4g}>"
        )

    @property
    def energy(self) -> Array:
        """E = kinetic + elastic + stops."""
        return self.kinetic + self.elastic + self.stops

    @property
    def supplied(self) -> Array:
        """E_0 + the largest input so far, at these times: the most that start, loads and moving stops have supplied.

        The input at one time would not do: it returns to zero whenever a load takes back its work. Its largest between
        two times is not seen: outputs at every step (``every=1``) leave out least.
        """
        return self.energy[0] + np.maximum.accumulate(np.maximum(self.input, 0.0))

    def is_resolved(self, k: int = -1) -> bool:
        """Return True where the ``spread`` leaves the loss at index k known: to a thousandth of the energy supplied, or
        to a tenth of itself."""
        return bool(self.spread[k] <= max(RESOLVED * self.supplied[k], 0.1 * abs(self.loss[k])))

    def lost_fraction(self, k: int = -1) -> float:
        """loss/supplied at index k; NaN where nothing was supplied, or the step does not resolve the loss."""
        most = self.supplied[k]
        return float(self.loss[k] / most) if most > 0.0 and self.is_resolved(k) else float("nan")


@np.errstate(over="ignore", invalid="ignore")  # an energy beyond float64 is refused by ``Trajectory.energy``
def step_ledger(
    system: System,
    pieces: Iterable[tuple[Array, Array, Array, Array]],
    outputs: Array,
    impacts: bool = False,
    basis: Modes | None = None,
) -> Ledger:
    """The energy balance of a run from its states at every step, see ``Pieces``, stored at the times ``outputs``.

    Against rigid stops the forces are the mean reactions R of the steps that end there. A stop that moves by do puts in
    -R do, and stop_dissipation is the sum of -dt R (U^n + U^{n+1})/2, U the velocity against the stop: what an impulse
    dt R takes in turning U round, (1 - e)/2 |U| of it by Newton's law. It is zero unless ``impacts``: a scheme without
    an impact law has it all in ``loss``.

    basis: the modes of the system, where the pieces have q and q' in these.
    """
    kept: list[list[Array]] = []
    total, start = np.zeros(5), None  # input, viscous, loss in contact, stop_dissipation, spread
    squares, damping = (None, system.damping) if basis is None else (basis.omega**2, basis.damping)
    # Pieces share end points; every piece adds its steps to the totals of those before.
    for t, q, v, forces in pieces:
        motions, dt = _motions(system, t, q, v, basis), np.diff(t)
        free = system.free_energies(q, v) if squares is None else (0.5 * _squares(v), 0.5 * _squares(q, squares))
        stored = sum((x.stops.energy(u) for x, (u, _) in zip(system.contacts, motions, strict=True)), np.zeros(len(t)))
        d_input, d_stops, d_spread = _work_of_stops(system, t, motions, forces, impacts)
        # A step counts as contact if either of its ends does, or if it has a reaction.
        touching = _touching(system, t, motions, forces)
        either = np.any(forces[1:] != 0.0, axis=1) if system.rigid else touching[1:] | touching[:-1]
        for vector, function in system.loads:
            f, along = evaluate(function, t), q @ (vector if basis is None else basis.force(vector))
            d_input += 0.5 * (f[1:] + f[:-1]) * np.diff(along)
        d_viscous = np.zeros(len(dt))
        if system.damped:
            d_viscous, unresolved = _work_of_dampers(damping, dt, q, v)
            d_spread += unresolved
        # The loss is what the balance of energies and works leaves: of the whole run, without a sum of its roundings.
        energy = free[0] + free[1] + stored
        start = energy[0] if start is None else start
        d_contact = np.where(either, -np.diff(energy) + d_input - d_viscous - d_stops, 0.0)
        sums = np.empty((5, len(t)))
        sums[:, 0], sums[:, 1:] = total, (d_input, d_viscous, d_contact, d_stops, d_spread)
        work, viscous, contact, dissipated, spread = np.cumsum(sums, axis=1, out=sums)
        total = sums[:, -1].copy()
        loss = start - energy + work - viscous - dissipated
        # Outputs in this piece, each at the nearest step: rounding of the times must not drop one.
        inside = (outputs >= t[0] - 0.25 * dt[0]) & (outputs <= t[-1] + 0.25 * dt[-1])
        at = np.searchsorted(0.5 * (t[1:] + t[:-1]), outputs[inside])
        at = at[at > 0] if kept else at  # the first time of a later piece is the last of the piece before it
        rows = (t, *free, stored, work, viscous, loss, contact, loss - contact, dissipated, spread)
        kept.append([row.take(at) for row in rows])
    return Ledger(*map(np.concatenate, zip(*kept, strict=True)))


def _work_of_dampers(damping: Array, dt: Array, q: Array, v: Array) -> tuple[Array, Array]:
    """Work of the damping, a matrix or one number for each mode, in steps dt, by the displacement, and its distance
    from that by the mean velocity; (steps,) each."""
    by_way, by_mean = (
        np.sum(x * (x @ damping), axis=1) if damping.ndim == 2 else _squares(x, damping)
        for x in (np.diff(q, axis=0), 0.5 * (v[1:] + v[:-1]))
    )
    return by_way / dt, np.abs(by_way / dt - dt * by_mean)


def _squares(x: Array, weights: Array | None = None) -> Array:
    """sum_j weights_j x_ij^2 of every row of x."""
    return np.einsum("ij,ij->i", x, x) if weights is None else np.einsum("ij,ij,j->i", x, x, weights)


def _work_of_stops(
    system: System, t: Array, motions: list[tuple[Array, Array]], forces: Array, impacts: bool
) -> tuple[Array, Array, Array]:
    """-1/2 (F^n + F^{n+1}) do of the contacts whose stops move, -1/2 (D^n + D^{n+1}) du of those that damp, and the
    spread of that; of rigid stops see ``step_ledger``."""
    work, taken, spread = np.zeros((3, len(t) - 1))
    for c, (contact, (u, rate)) in enumerate(zip(system.contacts, motions, strict=True)):
        stops = contact.stops
        if stops.rigid:
            work -= forces[1:, c] * np.diff(evaluate(contact.offset, t))
            taken -= 0.5 * impacts * np.diff(t) * forces[1:, c] * (rate[1:] + rate[:-1])
        # The whole work of a stop that neither moves nor damps is in its energy.
        if stops.rigid or (contact.offset is None and not stops.law.damps):
            continue
        force = stops.force(u, rate)
        beyond = force - stops.force(u, 0.0)
        # A force that jumps does not follow from the state: the node's counts where it is known.
        if stops.law.jumps:
            known = ~np.isnan(forces[:, c])
            beyond[known] += forces[known, c] - force[known]
            force[known] = forces[known, c]
        work -= 0.5 * (force[1:] + force[:-1]) * np.diff(evaluate(contact.offset, t))
        if stops.law.damps:
            dissipated, power = 0.5 * (beyond[1:] + beyond[:-1]) * np.diff(u), beyond * rate
            taken -= dissipated
            # Where the force begins or ends within the step, its mean power has no meaning.
            at_ends = (beyond[1:] == 0.0) != (beyond[:-1] == 0.0)
            spread += np.abs(dissipated - np.where(at_ends, 0.0, 0.5 * np.diff(t) * (power[1:] + power[:-1])))
    return work, taken, spread


def as_it_starts(system: System, channel: int, t: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """u and v of a channel at the times t with those of the system's start at t = 0: on a stop, rounding would decide
    the side. The velocity of rigid stops stays, because an impact may have turned it."""
    begins = t == 0.0
    if not np.any(begins):
        return u, v
    row, offset = system.channels[channel]
    at_start, moving = channel_motion(row, offset, 0.0, system.q0, system.v0)
    u = np.where(begins, at_start, u)
    if not system.rigid:
        v = np.where(begins, moving, v)
    return u, v


def _motions(system: System, t: Array, q: Array, v: Array, basis: Modes | None = None) -> list[tuple[Array, Array]]:
    """Position and rate of every contact; those of the given start as given, see ``as_it_starts``. basis: q and v are
    coordinates in these modes, of a march."""
    # Only a run from the system's initial data begins with these values.
    given = basis is not None or (np.array_equal(q[0], system.q0) and np.array_equal(v[0], system.v0))
    motions = []
    for c, contact in enumerate(system.contacts):
        row = contact.row if basis is None else basis.force(contact.row)
        seen = channel_motion(row, contact.offset, t, q, v)
        motions.append(as_it_starts(system, c, t, *seen) if given else seen)
    return motions


def _touching(
    system: System, t: Array, motions: list[tuple[Array, Array]], node_forces: Array | None = None
) -> BoolArray:
    """True where any contact is closed (k,); node_forces: see ``Pieces``."""
    touching = np.zeros(len(t), bool)
    for c, (contact, motion) in enumerate(zip(system.contacts, motions, strict=True)):
        closed = contact.stops.state(*motion) != 0
        if node_forces is not None and contact.stops.law.jumps:
            closed = np.where(np.isnan(node_forces[:, c]), closed, node_forces[:, c] != 0.0)
        touching |= closed
    return touching


def in_contact(system: System, t: Array, q: Array, v: Array) -> BoolArray:
    """Boolean (k,), True if any contact is closed at the times t (k,) with states q, v (k, n)."""
    return _touching(system, t, _motions(system, t, q, v))
