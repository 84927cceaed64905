"""Compiled loops over the single steps inside blocks: states and energies that a block march passes over."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array
from ...basics.compiled import compiled, inlined
from ...model.contact_law import elastic_force, is_linear, law_energy, law_force, law_of, law_state, state
from ...model.contact_law import energy as linear_energy
from ...model.contact_law import force as linear_force
from .blocks import advance

# What the ledger has added up, in the order of Ledger's fields after t: three energies, six sums.
KINETIC, ELASTIC, STOPS, INPUT, VISCOUS, LOSS, CONTACT, FREE, TAKEN = range(9)


class Step(NamedTuple):
    """One step of a scheme on a whole state (a, n), and what a stretch of them is given.

    Forces are known here, so that no stop is asked; the other names are those of Block and Forcing.
    """

    transition: Array  # (a, D)
    push: Array  # (S m, D)
    driven: Array  # (d, D)
    forces: Array  # (steps, S m)
    g: Array  # (steps, d) at the starts of the steps
    inflow: Array  # (steps, D) or no rows


class Energies(NamedTuple):
    """What the ledger of a system with unit modal masses is made of; values at k = 0..steps."""

    squares: Array  # (n,): omega_j^2
    damping: Array  # (n,)
    loads: Array  # (L, n)
    load_values: Array  # (steps + 1, L)
    rows: Array  # (m, n), of the contacts
    offsets: Array  # (steps + 1, m)
    offset_rates: Array  # (steps + 1, m)
    law: Array  # (m, 6), see contact_law


@inlined
def take_step(step: Step, k: int, n: int, z: Array, new: Array) -> None:
    """``new``, the first D numbers of the state after step k, and z advanced to it."""
    transition, push, driven, forces, g, inflow = step
    a, D = transition.shape
    advance(transition, n, z, new)
    for e in range(g.shape[1]):
        drive = g[k, e]
        if drive != 0.0:
            for j in range(D):
                new[j] += drive * driven[e, j]
    if inflow.shape[0]:
        for j in range(D):
            new[j] += inflow[k, j]
    for i in range(forces.shape[1]):
        force = forces[k, i]
        if force != 0.0:
            for j in range(D):
                new[j] += force * push[i, j]
    for j in range(D):
        z[j] = new[j]
    for j in range((a - 1) * n):
        z[a * n + j] = z[j]


@compiled
def states(step: Step, n: int, z: Array, out: Array) -> None:
    """The states (steps, D) at the ends of the steps from z, which is advanced in place."""
    for k in range(out.shape[0]):
        take_step(step, k, n, z, out[k])


@compiled
def account(
    step: Step, energies: Energies, n: int, z: Array, q: Array, v: Array, balance: Array, first: int, every: int,
    dt: float, kept: Array,
) -> None:  # fmt: skip
    """The ledger over ``steps`` steps from step ``first``; rows of ``kept`` (outputs, 9) at every ``every``-th.

    z as in ``states``. q, v (n,): at the start. balance (9,), see KINETIC..: all four advanced in place.
    """
    squares, damping, loads, load_values, rows, offsets, offset_rates, law = energies
    steps, L, m = step[3].shape[0], loads.shape[0], law.shape[0]
    new, dq = np.empty(z.size), np.empty(n)
    force, before, beyond, last, touching = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), 0
    energy = balance[KINETIC] + balance[ELASTIC] + balance[STOPS]
    for c in range(m):
        u = _position(rows, offsets, q, c, 0)
        rate = _position(rows, offset_rates, v, c, 0)
        force[c], beyond[c], _, pressed = _of_stop(u, rate, law, c)
        last[c] = u
        touching += pressed
    for k in range(steps):
        take_step(step, k, n, z, new)
        kinetic = elastic = viscous = 0.0
        for j in range(n):
            kinetic += new[n + j] * new[n + j]
            elastic += squares[j] * new[j] * new[j]
            d = new[j] - q[j]
            viscous += damping[j] * d * d
            dq[j] = d
            q[j] = new[j]
        given = 0.0
        for e in range(L):
            work = 0.0
            for j in range(n):
                work += loads[e, j] * dq[j]
            given += 0.5 * (load_values[k, e] + load_values[k + 1, e]) * work
        for j in range(n):
            v[j] = new[n + j]
        stops, taken, touched = 0.0, 0.0, touching
        touching = 0
        for c in range(m):
            before[c] = force[c]
            u = _position(rows, offsets, q, c, k + 1)
            rate = _position(rows, offset_rates, v, c, k + 1)
            force[c], new_beyond, held, pressed = _of_stop(u, rate, law, c)
            stops += held
            touching += pressed
            taken -= 0.5 * (beyond[c] + new_beyond) * (u - last[c])
            beyond[c], last[c] = new_beyond, u
            if offsets.shape[0]:
                given -= 0.5 * (before[c] + force[c]) * (offsets[k + 1, c] - offsets[k, c])
        balance[KINETIC], balance[ELASTIC], balance[STOPS] = 0.5 * kinetic, 0.5 * elastic, stops
        now = 0.5 * (kinetic + elastic) + stops
        lost = energy - now + given - viscous / dt - taken
        energy = now
        balance[INPUT] += given
        balance[VISCOUS] += viscous / dt
        balance[LOSS] += lost
        balance[TAKEN] += taken
        if touched + touching:
            balance[CONTACT] += lost
        else:
            balance[FREE] += lost
        at = first + k + 1
        if at % every == 0:
            kept[at // every] = balance


@inlined
def _of_stop(u: float, rate: float, law: Array, c: int) -> tuple[float, float, float, bool]:
    """Force, what of it is not from the energy, the energy, and whether the stop presses."""
    stop = law_of(law, c)
    if is_linear(stop):
        kappa, g1, g2 = stop[:3]
        force, beyond, held = linear_force(u, kappa, g1, g2), 0.0, linear_energy(u, kappa, g1, g2)
        pressed = state(u, g1, g2) != 0.0
    else:
        force, held = law_force(u, rate, stop), law_energy(u, stop)
        beyond = force - elastic_force(u, stop)
        pressed = law_state(u, rate, stop) != 0.0
    return force, beyond, held, pressed


@inlined
def _position(rows: Array, offsets: Array, q: Array, c: int, k: int) -> float:
    """row_c q + o_c, or the rates of them."""
    total = 0.0
    for j in range(q.size):
        total += rows[c, j] * q[j]
    if offsets.shape[0]:
        total += offsets[k, c]
    return total
