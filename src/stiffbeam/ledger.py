"""The energy ledger: where a scheme's energy comes from and goes to, step by step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arrays import Array
from .system import System
from .time_functions import offset_values


@dataclass(frozen=True, eq=False)
class Ledger:
    """Energy at times t (k,) and its balance since t = 0, every array (k,).

        kinetic, elastic, stops    1/2 q'^T M q', 1/2 q^T K q (bending) and sum U; energy E is their sum
        input    sum over steps of 1/2 (F^n + F^{n+1}) . dq,  F the load vector; a stop that moves
                 against its contact by do_c puts in -1/2 (F_c^n + F_c^{n+1}) do_c
        viscous  sum over steps of dq^T C dq / dt
        loss     E_n - E_{n+1} + d_input - d_viscous, summed; > 0: lost by the scheme
        contact, free   the part of ``loss`` in steps with a contact at either end, and without

    The trapezoidal rule loses nothing but at the kink of the contact law, the exact flow nothing.
    """

    t: Array
    kinetic: Array
    elastic: Array
    stops: Array
    input: Array
    viscous: Array
    loss: Array
    contact: Array
    free: Array

    @property
    def energy(self) -> Array:
        """E = kinetic + elastic + stops."""
        return self.kinetic + self.elastic + self.stops

    def lost_fraction(self, k: int = -1) -> float:
        """loss/(E_0 + input) at index k: the share of all energy the system has had, NaN where that is <= 0.

        E_0 counts, since a run may live on it; the input alone is neither positive nor a scale then.
        """
        had = self.energy[0] + self.input[k]
        return float(self.loss[k] / had) if had > 0.0 else float("nan")


def step_ledger(system: System, pieces: Iterator[tuple[Array, Array, Array]], outputs: Array) -> Ledger:
    """The ledger of a run from its states at every step, kept at the times ``outputs``."""
    columns: list[Array] = []
    times: list[Array] = []
    total = np.zeros(5)  # input, viscous, loss, contact, free
    for t, q, v in pieces:
        energies = np.stack(system.energies(t, q, v))
        load = system.load(t)
        dq = np.diff(q, axis=0)
        d_input = 0.5 * np.sum((load[1:] + load[:-1]) * dq, axis=1) + _work_of_stops(system, t, q)
        d_viscous = np.sum(dq * (dq @ system.damping), axis=1) / np.diff(t) if system.damped else 0.0 * d_input
        d_loss = -np.diff(np.sum(energies, axis=0)) + d_input - d_viscous
        touching = _touching(system, t, q)
        in_contact = touching[1:] | touching[:-1]
        parts = (np.where(in_contact, d_loss, 0.0), np.where(in_contact, 0.0, d_loss))
        steps = np.stack([d_input, d_viscous, d_loss, *parts])
        cumulative = np.concatenate([total[:, None], total[:, None] + np.cumsum(steps, axis=1)], axis=1)
        total = cumulative[:, -1]
        keep = slice(1 if times else 0, None)
        half = 0.25 * (t[1] - t[0])
        wanted = np.zeros(len(t), bool)
        nearest = np.searchsorted(t, outputs[(outputs >= t[0] - half) & (outputs <= t[-1] + half)] - half)
        wanted[np.minimum(nearest, len(t) - 1)] = True
        wanted = wanted[keep]
        times.append(t[keep][wanted])
        columns.append(np.concatenate([energies[:, keep], cumulative[:, keep]])[:, wanted])
    data = np.concatenate(columns, axis=1)
    return Ledger(np.concatenate(times), *data)


def _work_of_stops(system: System, t: Array, q: Array) -> Array:
    """-1/2 (F^n + F^{n+1}) do of the contacts whose stops move."""
    work = np.zeros(len(t) - 1)
    for contact in system.contacts:
        if contact.offset is not None:
            o = offset_values(contact.offset, t)
            force = contact.stops.force(q @ contact.row + o)
            work -= 0.5 * (force[1:] + force[:-1]) * np.diff(o)
    return work


def _touching(system: System, t: Array, q: Array) -> NDArray[np.bool_]:
    """Whether any contact is closed."""
    touching = np.zeros(len(t), bool)
    positions = system.positions(t, q)
    for c, contact in enumerate(system.contacts):
        touching |= contact.stops.state(positions[:, c]) != 0
    return touching
