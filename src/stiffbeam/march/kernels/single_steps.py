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
    driven: Array  # (d, D), or (d - 1, D) without the constant
    forces: Array  # (steps, S m)
    g: Array  # (steps + 1, d) at the starts of the steps and the last one's end
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
    """``new``, the whole state after step k from z."""
    transition, push, driven, forces, g, inflow = step
    a, D = transition.shape
    advance(transition, n, z, new)
    skipped = g.shape[1] - driven.shape[0]
    for e in range(driven.shape[0]):
        drive = g[k, skipped + e]
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
    again = np.uint64(a * n)
    for j in range(np.uint64((a - 1) * n)):
        new[again + j] = new[j]


@compiled
def states(step: Step, n: int, z: Array, out: Array) -> None:
    """The states (steps, D) at the ends of the steps from z."""
    new = np.empty(z.size)
    for k in range(out.shape[0]):
        take_step(step, k, n, z, new)
        for j in range(out.shape[1]):
            out[k, j] = new[j]
        z, new = new, z


@compiled
def account(
    step: Step, energies: Energies, n: int, z: Array, y: Array, balance: Array, first: int, every: int, dt: float,
    kept: Array,
) -> None:  # fmt: skip
    """The ledger over ``steps`` steps from step ``first``; rows of ``kept`` (outputs, 9) at every ``every``-th.

    z as in ``states``. y (2 n,) = (q, q') at the start, which a z that goes on as the run does need not begin with.
    balance (9,), see KINETIC..; both are advanced in place. What is lost is the balance of a stretch of steps
    in contact, or of one without, as long as it lasts: between its ends no energy is asked, and outputs do not end it.
    """
    squares, damping, offsets = energies.squares, energies.damping, energies.offsets
    loads, load_values = energies.loads, energies.load_values
    steps, L, m = step[3].shape[0], loads.shape[0], energies.law.shape[0]
    new, old, damped = np.empty(z.size), y, np.any(damping > 0.0)
    force, beyond, last = np.zeros(m), np.zeros(m), np.zeros(m)
    stops, touching = 0.0, 0
    for c in range(m):
        u, force[c], beyond[c], held, pressed = _at_stop(energies, y, n, c, 0)
        last[c] = u
        stops += held
        touching += pressed
    within, given, viscous, taken = CONTACT, 0.0, 0.0, 0.0
    for k in range(steps):
        take_step(step, k, n, z, new)
        held_before, touched = stops, touching
        stops, touching = 0.0, 0
        moved = dissipated = 0.0
        for c in range(m):
            u, new_force, new_beyond, held, pressed = _at_stop(energies, new, n, c, k + 1)
            stops += held
            touching += pressed
            dissipated -= 0.5 * (beyond[c] + new_beyond) * (u - last[c])
            if offsets.shape[0]:
                moved -= 0.5 * (force[c] + new_force) * (offsets[k + 1, c] - offsets[k, c])
            force[c], beyond[c], last[c] = new_force, new_beyond, u
        kind = CONTACT if touched + touching else FREE
        if kind != within:
            _settle(squares, n, old, held_before, given, viscous, taken, within, balance, balance)
            within, given, viscous, taken = kind, 0.0, 0.0, 0.0
        given += moved
        taken += dissipated
        for e in range(L):
            work = 0.0
            for j in range(n):
                work += loads[e, j] * (new[j] - old[j])
            given += 0.5 * (load_values[k, e] + load_values[k + 1, e]) * work
        if damped:
            lost = 0.0
            for j in range(n):
                lost += damping[j] * (new[j] - old[j]) * (new[j] - old[j])
            viscous += lost / dt
        z, new = new, z
        old = z
        at = first + k + 1
        if at % every == 0:
            _settle(squares, n, z, stops, given, viscous, taken, within, balance, kept[at // every])
    _settle(squares, n, old, stops, given, viscous, taken, within, balance, balance)
    for j in range(2 * n):
        y[j] = old[j]


@inlined
def _settle(
    squares: Array, n: int, y: Array, stops: float, given: float, viscous: float, taken: float, kind: int,
    balance: Array, new: Array,
) -> None:  # fmt: skip
    """The ``new`` balance at the end y of a stretch of one kind, with what was given and taken in it."""
    kinetic = elastic = 0.0
    for j in range(n):
        kinetic += y[n + j] * y[n + j]
        elastic += squares[j] * y[j] * y[j]
    before = balance[KINETIC] + balance[ELASTIC] + balance[STOPS]
    lost = before - (0.5 * (kinetic + elastic) + stops) + given - viscous - taken
    for i in range(balance.size):
        new[i] = balance[i]
    new[KINETIC], new[ELASTIC], new[STOPS] = 0.5 * kinetic, 0.5 * elastic, stops
    new[INPUT] += given
    new[VISCOUS] += viscous
    new[LOSS] += lost
    new[TAKEN] += taken
    new[kind] += lost


@inlined
def _at_stop(energies: Energies, z: Array, n: int, c: int, k: int) -> tuple[float, float, float, float, bool]:
    """Position, force, what of it is not from the energy, the energy, and whether the stop presses."""
    stop = law_of(energies.law, c)
    u = _position(energies.rows, energies.offsets, z, 0, n, c, k)
    if is_linear(stop):
        kappa, g1, g2 = stop[:3]
        force, beyond, held = linear_force(u, kappa, g1, g2), 0.0, linear_energy(u, kappa, g1, g2)
        pressed = state(u, g1, g2) != 0.0
    else:
        rate = _position(energies.rows, energies.offset_rates, z, n, n, c, k)
        force, held = law_force(u, rate, stop), law_energy(u, stop)
        beyond = force - elastic_force(u, stop)
        pressed = law_state(u, rate, stop) != 0.0
    return u, force, beyond, held, pressed


@inlined
def _position(rows: Array, offsets: Array, z: Array, at: int, n: int, c: int, k: int) -> float:
    """row_c q + o_c, or the rates of them, from z[at : at + n]."""
    total = 0.0
    shift = np.uint64(at)
    for j in range(np.uint64(n)):
        total += rows[c, j] * z[shift + j]
    if offsets.shape[0]:
        total += offsets[k, c]
    return total
