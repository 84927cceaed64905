"""The energy balance of a run, step by step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.deprecation import Renamed
from ..model.contact import channel_motion
from ..model.system import System
from ..model.time_functions import offset_rate, offset_values
from .schema import LEDGER_FIELDS, frame_of

if TYPE_CHECKING:
    import pandas


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
    stop_dissipation: Array = None  # type: ignore[assignment]  # zero unless given
    spread: Array = None  # type: ignore[assignment]  # likewise
    contact: ClassVar = Renamed("loss_in_contact")
    free: ClassVar = Renamed("loss_without_contact")
    given: ClassVar = Renamed("supplied")
    sure: ClassVar = Renamed("is_resolved")

    def __post_init__(self) -> None:
        for name in ("stop_dissipation", "spread"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros_like(self.t))

    def __repr__(self) -> str:
        return (
            f"<Ledger: {len(self.t)} times to {self.t[-1]:g}, energy {self.energy[0]:.4g} to {self.energy[-1]:.4g}, "
            f"input {self.input[-1]:.4g}, viscous {self.viscous[-1]:.4g}, loss {self.loss[-1]:.4g}>"
        )

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each time, the index: the columns ``energy_kinetic`` to ``energy_spread``."""
        columns = {name: (("time",), getattr(self, field)) for field, name in LEDGER_FIELDS.items()}
        return frame_of({"time": (("time",), self.t)} | columns, "time")

    @property
    def energy(self) -> Array:
        """E = kinetic + elastic + stops."""
        return self.kinetic + self.elastic + self.stops

    @property
    def supplied(self) -> Array:
        """E_0 + the largest input so far, at these times: the most that start, loads and moving stops have supplied.

        The input at one time would not do: it returns to zero whenever a load takes back its work.
        """
        return supplied(self.energy[0], self.input)

    def is_resolved(self, k: int = -1) -> bool:
        """Return True where the ``spread`` leaves the loss at index k known: to a thousandth of the energy supplied, or
        to a tenth of itself."""
        return bool(self.spread[k] <= max(RESOLVED * self.supplied[k], 0.1 * abs(self.loss[k])))

    def lost_fraction(self, k: int = -1) -> float:
        """loss/supplied at index k; NaN where nothing was supplied, or the step does not resolve the loss."""
        most = self.supplied[k]
        return float(self.loss[k] / most) if most > 0.0 and self.is_resolved(k) else float("nan")


def supplied(start: float, work: Array) -> Array:
    """See ``Ledger.supplied``; start: E_0, work: the input (k,)."""
    return start + np.maximum.accumulate(np.maximum(work, 0.0))


def step_ledger(
    system: System, pieces: Iterator[tuple[Array, Array, Array, Array]], outputs: Array, impacts: bool | None = None
) -> Ledger:
    """The energy balance of a run from its states at every step, see ``Pieces``, stored at the times ``outputs``.

    impacts: None for compliant stops. Against rigid ones the pieces hold the mean reactions R of the steps instead of
    forces, and stop_dissipation is the sum of -dt R (U^n + U^{n+1})/2, U the velocity against the stop: what an impulse
    dt R takes in turning U round, (1 - e)/2 |U| of it by Newton's law. It is zero unless ``impacts``: a scheme without
    an impact law has it all in ``loss``. A stop that moves by do puts in -R do.
    """
    columns: list[Array] = []
    times: list[Array] = []
    total = np.zeros(7)  # input, viscous, loss, contact, free, stop_dissipation, spread
    # Pieces share end points; every piece adds its steps to the totals of those before.
    for t, q, v, forces in pieces:
        energies = np.stack(system.energies(t, q, v))
        load = system.load(t)
        dq = np.diff(q, axis=0)
        if impacts is None:
            of_stops, d_stops, d_spread = _work_of_stops(system, t, q, v, forces)
            touching = in_contact(system, t, q, v, forces)
            # A step counts as contact if either of its ends does.
            either = touching[1:] | touching[:-1]
        else:
            of_stops, d_stops = _work_of_reactions(system, t, v, forces, impacts)
            d_spread = np.zeros(len(dq))
            # Reactions are means over the steps, one a step, and zero without contact.
            either = np.any(forces != 0.0, axis=1)
        d_input = 0.5 * np.sum((load[1:] + load[:-1]) * dq, axis=1) + of_stops
        d_viscous = np.zeros(len(dq))
        if system.damped:
            # Two rules for the dampers: by the displacement and by the mean velocity. They differ by the spread.
            mean, dt = 0.5 * (v[1:] + v[:-1]), np.diff(t)
            d_viscous = np.sum(dq * (dq @ system.damping), axis=1) / dt
            d_spread += np.abs(d_viscous - dt * np.sum(mean * (mean @ system.damping), axis=1))
        # The loss is what the balance of energies and works leaves.
        d_loss = -np.diff(np.sum(energies, axis=0)) + d_input - d_viscous - d_stops
        parts = (np.where(either, d_loss, 0.0), np.where(either, 0.0, d_loss))
        steps = np.stack([d_input, d_viscous, d_loss, *parts, d_stops, d_spread])
        cumulative = np.concatenate([total[:, None], total[:, None] + np.cumsum(steps, axis=1)], axis=1)
        total = cumulative[:, -1]
        # The first time of a later piece is the last of the piece before it.
        keep = slice(1 if times else 0, None)
        # Outputs in this piece, each at the nearest step: rounding of the times must not drop one.
        inside = (outputs >= t[0] - 0.25 * (t[1] - t[0])) & (outputs <= t[-1] + 0.25 * (t[-1] - t[-2]))
        wanted = np.zeros(len(t), bool)
        wanted[np.searchsorted(0.5 * (t[1:] + t[:-1]), outputs[inside])] = True
        wanted = wanted[keep]
        times.append(t[keep][wanted])
        columns.append(np.concatenate([energies[:, keep], cumulative[:, keep]])[:, wanted])
    data = np.concatenate(columns, axis=1)
    return Ledger(np.concatenate(times), *data)


def _work_of_stops(system: System, t: Array, q: Array, v: Array, node_forces: Array) -> tuple[Array, Array, Array]:
    """-1/2 (F^n + F^{n+1}) do of the contacts whose stops move, -1/2 (D^n + D^{n+1}) du of those that damp, and the
    spread of that."""
    work, taken, spread = np.zeros((3, len(t) - 1))
    for c, contact in enumerate(system.contacts):
        stops, o = contact.stops, offset_values(contact.offset, t)
        # The whole work of a stop that neither moves nor damps is in its energy.
        if contact.offset is None and not stops.dissipative:
            continue
        u, rate = _motion(system, c, t, q, v)
        beyond, force = stops.dissipated(u, rate), stops.force(u, rate)
        # A force that jumps does not follow from the state: the node's counts where it is known.
        if stops.jumps:
            known = ~np.isnan(node_forces[:, c])
            beyond[known] += node_forces[known, c] - force[known]
            force[known] = node_forces[known, c]
        work -= 0.5 * (force[1:] + force[:-1]) * np.diff(o)
        if stops.dissipative:
            dissipated, power = 0.5 * (beyond[1:] + beyond[:-1]) * np.diff(u), beyond * rate
            taken -= dissipated
            # Where the force begins or ends within the step, its mean power has no meaning.
            at_ends = (beyond[1:] == 0.0) != (beyond[:-1] == 0.0)
            spread += np.abs(dissipated - np.where(at_ends, 0.0, 0.5 * np.diff(t) * (power[1:] + power[:-1])))
    return work, taken, spread


def _work_of_reactions(system: System, t: Array, v: Array, reactions: Array, impacts: bool) -> tuple[Array, Array]:
    """Work and dissipation of rigid stops, see ``step_ledger``."""
    work, taken = np.zeros((2, len(t) - 1))
    for c, contact in enumerate(system.contacts):
        work -= reactions[:, c] * np.diff(offset_values(contact.offset, t))
        if impacts:
            rate = v @ contact.row + offset_rate(contact.offset, t)
            taken -= 0.5 * np.diff(t) * reactions[:, c] * (rate[1:] + rate[:-1])
    return work, taken


def as_it_starts(system: System, channel: int, t: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """u and v of a channel at the times t with the given values at t = 0: on a stop, rounding would decide the side.
    The velocity of rigid stops stays, because an impact may have turned it."""
    begins = t == 0.0
    if not np.any(begins):
        return u, v
    row, offset = system.channels[channel]
    at_start, moving = channel_motion(row, offset, 0.0, system.q0, system.v0)
    u = np.where(begins, at_start, u)
    if not any(contact.stops.rigid for contact in system.contacts):
        v = np.where(begins, moving, v)
    return u, v


def _motion(system: System, c: int, t: Array, q: Array, v: Array) -> tuple[Array, Array]:
    """Position and rate of contact c; those of the given start as given, see ``as_it_starts``."""
    contact = system.contacts[c]
    u, rate = channel_motion(contact.row, contact.offset, t, q, v)
    # Only a run from the system's initial data begins with these values.
    if np.array_equal(q[0], system.q0) and np.array_equal(v[0], system.v0):
        u, rate = as_it_starts(system, c, t, u, rate)
    return u, rate


def in_contact(system: System, t: Array, q: Array, v: Array, node_forces: Array | None = None) -> NDArray[np.bool_]:
    """Boolean (k,), True if any contact is closed at the times t (k,) with states q, v (k, n); node_forces: see
    ``Pieces``."""
    touching = np.zeros(len(t), bool)
    for c, contact in enumerate(system.contacts):
        closed = contact.stops.state(*_motion(system, c, t, q, v)) != 0
        if node_forces is not None and contact.stops.jumps:
            closed = np.where(np.isnan(node_forces[:, c]), closed, node_forces[:, c] != 0.0)
        touching |= closed
    return touching
