"""Compiled loops over the single steps inside blocks: states and energies that a block march passes over."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array
from ...basics.compiled import compiled, inlined
from ...model.contact_law import G1, G2, elastic_force, found_force, found_state, is_linear, law_energy, law_of, state
from ...model.contact_law import energy as linear_energy
from ...model.contact_law import force as linear_force
from .blocks import advance

# What the ledger has added up, in the order of Ledger's fields after t: three energies, seven sums.
KINETIC, ELASTIC, STOPS, INPUT, VISCOUS, LOSS, CONTACT, FREE, TAKEN, SPREAD = range(10)


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
    damping: Array  # (n,), or none
    loads: Array  # (L, n)
    load_values: Array  # (steps + 1, L)
    rows: Array  # (m, n), of the contacts
    offsets: Array  # (steps + 1, m)
    offset_rates: Array  # (steps + 1, m)
    law: Array  # (m, 6), see contact_law
    found: Array  # (steps + 1, m): the forces that nodes found, see found_force


class FreeBlock(NamedTuple):
    """All K steps of a block that no contact meets, from the state z (D,) and the drive g (d,) at its start."""

    seen: Array  # (m, K, D): the contacts' positions at the ends of the steps,
    seen_driven: Array  # (m, K, d)
    end: Array  # (2, a, n): (q, q') at the end, of the components of every mode,
    end_driven: Array  # (d, 2 n)
    work: Array  # (d, D): g^T work z + g^T work_driven g is the loads' work but for
    work_driven: Array  # (d, d)
    begun: Array  # (L, d): of every load - begun g times p q, q at the start


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
def clear(free: FreeBlock, law: Array, z: Array, g: Array, ends: Array) -> bool:
    """Whether all contacts are off their stops at the ends of all steps; their positions at the last one into ends."""
    m, K, D = free.seen.shape
    for c in range(m):
        for k in range(K):
            u = 0.0
            for d in range(D):
                u += free.seen[c, k, d] * z[d]
            for e in range(g.size):
                u += free.seen_driven[c, k, e] * g[e]
            if state(u, law[c, G1], law[c, G2]) != 0.0:
                return False
            ends[c] = u
    return True


@compiled
def pass_over(free: FreeBlock, loads: Array, z: Array, g: Array, y: Array, new: Array) -> float:
    """The work of the loads in a block without contact from y = (q, q') on, and (q, q') at its end into ``new``."""
    _, a, n = free.end.shape
    given = 0.0
    for e in range(g.size):
        work = 0.0
        for d in range(free.work.shape[1]):
            work += free.work[e, d] * z[d]
        for d in range(g.size):
            work += free.work_driven[e, d] * g[d]
        given += g[e] * work
    for i in range(loads.shape[0]):
        at_start = 0.0
        for j in range(n):
            at_start += loads[i, j] * y[j]
        for e in range(g.size):
            given -= free.begun[i, e] * g[e] * at_start
    for part in range(2):
        for j in range(n):
            total = 0.0
            for c in range(a):
                total += free.end[part, c, j] * z[c * n + j]
            for e in range(g.size):
                total += free.end_driven[e, part * n + j] * g[e]
            new[part * n + j] = total
    return given


@compiled
def account(
    step: Step, energies: Energies, free: FreeBlock, starts: Array, block: int, n: int, y: Array, met: Array,
    balance: Array, first: int, every: int, dt: float, kept: Array,
) -> None:  # fmt: skip
    """The ledger over ``steps`` steps from step ``first``; rows of ``kept`` (outputs, 10) at every ``every``-th.

    starts: (B, ..), the z of ``states`` at the starts of blocks of ``block`` steps. Those that ``free`` knows, it has
    no rows where it does not, and no contact meets nor output divides are passed over in one, the others step by step.
    y (2 n,) = (q, q') at the start, which a z that goes on as the run does need not begin with. met (2, m): positions
    and rates of the contacts there, as given at t = 0, where rounding would tell the side of a stop.
    balance (10,), see KINETIC..; all three are advanced in place. What is lost is the balance of a stretch of steps
    in contact, or of one without, as long as it lasts: between its ends no energy is asked, and outputs do not end it.
    """
    squares, damping, offsets = energies.squares, energies.damping, energies.offsets
    loads, load_values = energies.loads, energies.load_values
    steps, L, m = step[3].shape[0], loads.shape[0], energies.law.shape[0]
    size, old = starts.shape[1], y
    z, new, spare = np.empty(size), np.empty(size), np.empty(size)
    force, beyond, last, power, ends = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    stops, touching = 0.0, 0
    for c in range(m):
        last[c] = met[0, c]
        force[c], beyond[c], held, pressed = _at_stop(energies, c, 0, met[0, c], met[1, c])
        power[c] = beyond[c] * met[1, c]
        stops += held
        touching += pressed
    within, given, viscous, taken = CONTACT, 0.0, 0.0, 0.0
    left = 0  # steps of this block
    for k in range(steps):
        if left == 0:
            start = starts[k // block]
            left = min(block, steps - k)
            whole = left == free.seen.shape[1] and touching == 0 and every - (first + k) % every >= block
            for i in range(k, k + left if whole else k):
                for c in range(step.forces.shape[1]):
                    whole = whole and step.forces[i, c] == 0.0
            if whole and clear(free, energies.law, start, step.g[k], ends):
                if within != FREE:
                    _settle(squares, n, old, stops, given, viscous, taken, within, balance, balance)
                    within, given, viscous, taken = FREE, 0.0, 0.0, 0.0
                given += pass_over(free, loads, start, step.g[k], old, new)
                z, new = new, z
                old = z
                left = -left
                for c in range(m):
                    force[c], beyond[c], power[c], last[c] = 0.0, 0.0, 0.0, ends[c]
            else:
                z, spare = spare, z  # which ``old`` may be
                for j in range(z.size):
                    z[j] = start[j]
        if left < 0:
            left += 1
            if left == 0 and (first + k + 1) % every == 0:
                _settle(squares, n, z, stops, given, viscous, taken, within, balance, kept[(first + k + 1) // every])
            continue
        left -= 1
        take_step(step, k, n, z, new)
        held_before, touched = stops, touching
        stops, touching = 0.0, 0
        moved = dissipated = 0.0
        for c in range(m):
            u = _position(energies.rows, energies.offsets, new, 0, n, c, k + 1)
            rate = 0.0 if is_linear(law_of(energies.law, c)) else _rate(energies, new, n, c, k + 1)
            new_force, new_beyond, held, pressed = _at_stop(energies, c, k + 1, u, rate)
            stops += held
            touching += pressed
            own = 0.5 * (beyond[c] + new_beyond) * (u - last[c])
            dissipated -= own
            if (beyond[c] == 0.0) == (new_beyond == 0.0):
                own -= 0.5 * dt * (power[c] + new_beyond * rate)
            balance[SPREAD] += abs(own)
            if offsets.shape[0]:
                moved -= 0.5 * (force[c] + new_force) * (offsets[k + 1, c] - offsets[k, c])
            force[c], beyond[c], power[c], last[c] = new_force, new_beyond, new_beyond * rate, u
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
        if damping.size:
            lost = 0.0
            again = 0.0
            for j in range(n):
                lost += damping[j] * (new[j] - old[j]) * (new[j] - old[j])
                again += damping[j] * (new[n + j] + old[n + j]) * (new[n + j] + old[n + j])
            viscous += lost / dt
            balance[SPREAD] += abs(lost / dt - 0.25 * dt * again)
        z, new = new, z
        old = z
        at = first + k + 1
        if at % every == 0:
            _settle(squares, n, z, stops, given, viscous, taken, within, balance, kept[at // every])
    _settle(squares, n, old, stops, given, viscous, taken, within, balance, balance)
    for j in range(2 * n):
        y[j] = old[j]
    for c in range(m):
        met[0, c], met[1, c] = last[c], _rate(energies, old, n, c, steps)


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
def _at_stop(energies: Energies, c: int, k: int, u: float, rate: float) -> tuple[float, float, float, bool]:
    """Force, what of it is not from the energy, the energy, and whether the stop presses."""
    stop = law_of(energies.law, c)
    if is_linear(stop):
        kappa, g1, g2 = stop[:3]
        force, beyond, held = linear_force(u, kappa, g1, g2), 0.0, linear_energy(u, kappa, g1, g2)
        pressed = state(u, g1, g2) != 0.0
    else:
        found = energies.found[k, c]
        force, held = found_force(u, rate, found, stop), law_energy(u, stop)
        beyond = force - elastic_force(u, stop)
        pressed = found_state(u, rate, found, stop) != 0.0
    return force, beyond, held, pressed


@inlined
def _rate(energies: Energies, z: Array, n: int, c: int, k: int) -> float:
    """row_c q' + o_c'."""
    return _position(energies.rows, energies.offset_rates, z, n, n, c, k)


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
