"""The compiled energy balance of a block march, step by step, or for all steps of a block without contact force at
once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import inlined
from ...model.contact_law import damps, elastic_force, force_of_node, law_energy, law_of, state_of_node


class Step(NamedTuple):
    """One step of a scheme on a whole state (a, n), and the inputs of a range of steps.

    Forces are known here, so that no stop is asked; the other names are those of Block and Forcing. Component e of part
    j stands at e P + j, P >= n of whole vector registers, and a state is held twice, so that z[e P + d] is what is e
    components after z[d].
    """

    transition: Array  # (a + a % 2, a P): row e times what is e components later; those beyond a are zero
    push: Array  # (F, a P), of contacts and sampled loads at every node
    driven: Array  # (d, a P), of the constant, then sine and cosine of every frequency
    forces: Array  # (steps, F)
    g: Array  # (steps + 1, d) at the starts of the steps and the last one's end


@inlined
def begin(start: Array, place: IntArray, n: int, P: int, z: Array) -> None:
    """Write the state z of the components that are carried in their ``place`` (see Propagator.unpack); the others are
    zero."""
    for j in range(z.size):
        z[j] = 0.0
    half = z.size // 2
    for c in range(place.size):
        at = place[c] * P
        for j in range(n):
            z[at + j] = start[c * n + j]
            z[half + at + j] = start[c * n + j]


@inlined
def take_step(
    transition: Array, push: Array, driven: Array, forces: Array, g: Array, k: int, P: int, z: Array, new: Array
) -> None:  # fmt: skip
    """``new``, the whole state after step k from z."""
    # Two rows at a time: half as often to ``new`` and back.
    D = np.uint64(transition.shape[1])
    next_one = np.uint64(P)
    for j in range(D):
        new[j] = driven[0, j] + (transition[0, j] * z[j] + transition[1, j] * z[next_one + j])
    for e in range(2, transition.shape[0], 2):
        one, two = np.uint64(e * P), np.uint64(e * P + P)
        for j in range(D):
            new[j] += transition[e, j] * z[one + j] + transition[e + 1, j] * z[two + j]
    for e in range(1, driven.shape[0], 2):
        sine, cosine = g[k, e], g[k, e + 1]
        for j in range(D):
            new[j] += sine * driven[e, j] + cosine * driven[e + 1, j]
    for i in range(forces.shape[1]):
        force = forces[k, i]
        if force != 0.0:
            for j in range(D):
                new[j] += force * push[i, j]
    for j in range(D):
        new[D + j] = new[j]


@inlined
def states(step: Step, n: int, P: int, start: Array, place: IntArray, z: Array, new: Array, out: Array) -> None:
    """The states (steps, a P) at the ends of the steps from ``start``, see ``begin``. z, new: memory, (2 a P,)."""
    transition, push, driven, forces, g = step
    begin(start, place, n, P, z)
    for k in range(out.shape[0]):
        take_step(transition, push, driven, forces, g, k, P, z, new)
        for j in range(np.uint64(out.shape[1])):
            out[k, j] = new[j]
        z, new = new, z


# What the ledger has added up, in the order of Ledger's fields after t: three energies, seven sums.
KINETIC, ELASTIC, STOPS, INPUT, VISCOUS, LOSS, CONTACT, FREE, TAKEN, SPREAD = range(10)


class Energies(NamedTuple):
    """Terms of the ledger of a system with unit modal masses; values at k = 0..steps."""

    squares: Array  # (n,): omega_j^2
    damping: Array  # (n,), or none
    loads: Array  # (L, n), L > 0, zero where there are none
    load_values: Array  # (steps + 1, L)
    rows: Array  # (m, n), of the contacts
    offsets: Array  # (steps + 1, m), or no rows
    offset_rates: Array  # (steps + 1, m), or no rows
    law: Array  # (m, 6), see contact_law
    node_forces: Array  # (steps + 1, m): the forces that nodes found, see force_of_node


class FreeBlock(NamedTuple):
    """All K steps of a block of n modes without forces, from its state of k components and the drive at its start."""

    paths: Array  # (2 n T, K), row (2 j + i) T + t: q (i = 0) or q' of mode j at the ends of the steps, of a unit of
    # component t, then of a function of the drive; T = k + acting.size made even by zeros
    acting: IntArray  # the functions of the drive that do anything


class Work(NamedTuple):
    """Memory of ``account``."""

    z: Array  # (2 a P,), see Step
    new: Array
    sums: Array  # (4 + m + m + L, K), see _pass_free
    q: Array  # (K,), of a mode
    v: Array
    x: Array  # (T,)
    force: Array  # (m,), of every contact at the last step: its force,
    beyond: Array  # what of it is not from the energy,
    power: Array  # that times its velocity,
    last: Array  # and its position
    pulled: Array  # (L,): what the loads see of q


def work_for(step: Step, energies: Energies, free: FreeBlock) -> Work:
    """Memory for as many unknowns, contacts, loads and steps."""
    n, m, L, size = len(energies.squares), len(energies.law), len(energies.loads), 2 * step.transition.shape[1]
    terms, K = len(free.paths) // (2 * n), free.paths.shape[1]
    shapes = (size, size, (4 + 2 * m + L, K), K, K, terms, m, m, m, m, L)
    return Work(*(np.zeros(shape) for shape in shapes))


@inlined
def account(
    step: Step, energies: Energies, free: FreeBlock, place: IntArray, starts: Array, block: int, P: int, y: Array,
    met: Array, balance: Array, first: int, every: int, dt: float, kept: Array, work: Work,
) -> None:  # fmt: skip
    """The ledger over a stretch of steps from step ``first``; columns of ``kept`` (10, outputs) at every ``every``-th.

    starts: (B, ..), the state at the starts of blocks of ``block`` steps, in its ``place``, see ``begin``. Blocks in
    ``free`` that no force meets are computed at once, the others step by step. y (2 n,) = (q, q') at the start; a
    continued state may begin differently. met (2, m): positions and rates of the contacts there, with the given values
    at t = 0, where rounding would decide the side of a stop. balance (10,), see KINETIC..; all three are updated in
    place. The loss is computed over a range of consecutive steps in contact, or of consecutive steps without: between
    its ends no energy is needed, and outputs do not end it.
    """
    transition, push, driven, forces, g = step
    squares, damping, loads, load_values, rows, offsets, offset_rates, law, node_forces = energies
    paths, acting = free
    z, new, sums, q, v, x, force, beyond, power, last, pulled = work
    n, m, L, steps = squares.size, law.shape[0], loads.shape[0], forces.shape[0]
    # Forces, energies and sides at the start of the first step.
    stops, touching, rated = 0.0, 0, False
    for c in range(m):
        rated |= damps(law_of(law, c))
        last[c] = met[0, c]
        force[c], beyond[c], held, pressed = _at_stop(law, node_forces, c, 0, met[0, c], met[1, c])
        power[c] = beyond[c] * met[1, c]
        stops += held
        touching += pressed
    for e in range(L):
        pulled[e] = _seen(loads, e, y, 0, n)
    kinetic, elastic = _of_modes(squares, y, n)
    within, given, viscous, taken = CONTACT, 0.0, 0.0, 0.0
    until = every - first % every  # steps to the next output
    row = first // every
    for b in range(starts.shape[0]):
        begun = b * block
        count = min(block, steps - begun)
        # Without forces the motion of each mode over the whole block is a fixed linear map: no step is taken.
        quiet = paths.shape[1] > 0
        for i in range(begun, begun + count):
            for f in range(forces.shape[1]):
                quiet = quiet and forces[i, f] == 0.0
        if quiet:
            _pass_free(
                paths, acting, squares, damping, loads, rows, rated, starts, b, place.size, g, begun, y, sums, q, v, x,
                count,
            )  # fmt: skip
        else:
            begin(starts[b], place, n, P, z)
        for i in range(count):
            at = begun + i
            k = at + 1
            # Two rules for what dashpots take in the step: by the displacement, and by the mean velocity. Their
            # difference is the spread.
            lost = again = 0.0
            if quiet:
                new_kinetic, new_elastic = 0.5 * sums[0, i], 0.5 * sums[1, i]
                lost, again = sums[2, i], sums[3, i]
            else:
                take_step(transition, push, driven, forces, g, at, P, z, new)
                new_kinetic, new_elastic = _of_modes(squares, new, P)
                if damping.size:
                    for j in range(n):
                        lost += damping[j] * (new[j] - y[j]) * (new[j] - y[j])
                        again += damping[j] * (new[P + j] + y[n + j]) * (new[P + j] + y[n + j])
            held_before, touched = stops, touching
            stops, touching = 0.0, 0
            moved = dissipated = rate = 0.0
            for c in range(m):
                u = sums[4 + c, i] if quiet else _seen(rows, c, new, 0, n)
                if offsets.shape[0]:
                    u += offsets[k, c]
                if rated:
                    rate = sums[4 + m + c, i] if quiet else _seen(rows, c, new, P, n)
                    if offset_rates.shape[0]:
                        rate += offset_rates[k, c]
                new_force, new_beyond, held, pressed = _at_stop(law, node_forces, c, k, u, rate)
                stops += held
                touching += pressed
                # What a damped stop takes, again by two rules: force times way, and force times velocity. Where the
                # force begins or ends within the step, the second one has no meaning.
                spread = by_way = 0.5 * (beyond[c] + new_beyond) * (u - last[c])
                dissipated -= by_way
                if (beyond[c] == 0.0) == (new_beyond == 0.0):
                    spread -= 0.5 * dt * (power[c] + new_beyond * rate)
                balance[SPREAD] += abs(spread)
                if offsets.shape[0]:
                    moved -= 0.5 * (force[c] + new_force) * (offsets[k, c] - offsets[k - 1, c])
                force[c], beyond[c], power[c], last[c] = new_force, new_beyond, new_beyond * rate, u
            # The loss of a range of steps is settled where contact begins or ends.
            kind = CONTACT if touched + touching else FREE
            if kind != within:
                _settle(balance, kinetic, elastic, held_before, given, viscous, taken, within)
                within, given, viscous, taken = kind, 0.0, 0.0, 0.0
            given += moved
            taken += dissipated
            for e in range(L):
                now = sums[4 + 2 * m + e, i] if quiet else _seen(loads, e, new, 0, n)
                given += 0.5 * (load_values[at, e] + load_values[k, e]) * (now - pulled[e])
                pulled[e] = now
            if damping.size:
                viscous += lost / dt
                balance[SPREAD] += abs(lost / dt - 0.25 * dt * again)
            kinetic, elastic = new_kinetic, new_elastic
            if not quiet:
                # Only dampers read y at every step; else its last value in the block is enough.
                if damping.size or i == count - 1:
                    for j in range(n):
                        y[j] = new[j]
                        y[n + j] = new[P + j]
                z, new = new, z
            # An output in the middle of a range: the loss so far, without settling it.
            until -= 1
            if until == 0:
                until = every
                row += 1
                lost = _lost(balance, kinetic, elastic, stops, given, viscous, taken)
                kept[KINETIC, row], kept[ELASTIC, row], kept[STOPS, row] = kinetic, elastic, stops
                kept[INPUT, row], kept[VISCOUS, row] = balance[INPUT] + given, balance[VISCOUS] + viscous
                kept[LOSS, row], kept[TAKEN, row] = balance[LOSS] + lost, balance[TAKEN] + taken
                kept[CONTACT, row], kept[FREE, row] = balance[CONTACT], balance[FREE]
                kept[within, row] += lost
                kept[SPREAD, row] = balance[SPREAD]
    _settle(balance, kinetic, elastic, stops, given, viscous, taken, within)
    for c in range(m):
        met[0, c], met[1, c] = last[c], _seen(rows, c, y, n, n)
        if offset_rates.shape[0]:
            met[1, c] += offset_rates[steps, c]


@inlined
def _pass_free(
    paths: Array, acting: IntArray, squares: Array, damping: Array, loads: Array, rows: Array, rated: bool,
    starts: Array, b: int, carried: int, g: Array, at: int, y: Array, sums: Array, q: Array, v: Array, x: Array,
    count: int,
) -> None:  # fmt: skip
    """Sums over the modes at the ends of all steps of block b, which begins at step ``at``.

    sums: q'^2, omega^2 q^2, damping times the square of what q moves in the step and of q' before and after, what
    every contact sees of q, where its force depends on it of q', and every load of q.
    y = (q, q') at the start goes to the end of ``count`` steps.
    """
    n, m, T = squares.size, rows.shape[0], x.size
    K = np.uint64(paths.shape[1])
    for r in range(sums.shape[0]):
        for i in range(K):
            sums[r, i] = 0.0
    for e in range(acting.size):
        x[carried + e] = g[at, acting[e]]
    for j in range(n):
        for t in range(carried):
            x[t] = starts[b, t * n + j]
        of_q, of_v, one, two = 2 * j * T, (2 * j + 1) * T, x[0], x[1]
        for i in range(K):
            q[i] = one * paths[of_q, i] + two * paths[of_q + 1, i]
            v[i] = one * paths[of_v, i] + two * paths[of_v + 1, i]
        for t in range(2, T, 2):
            at_q, at_v, one, two = of_q + t, of_v + t, x[t], x[t + 1]
            for i in range(K):
                q[i] += one * paths[at_q, i] + two * paths[at_q + 1, i]
                v[i] += one * paths[at_v, i] + two * paths[at_v + 1, i]
        square, load, first = squares[j], loads[0, j], 4 + 2 * m
        for i in range(K):
            sums[0, i] += v[i] * v[i]
            sums[1, i] += square * q[i] * q[i]
            sums[first, i] += load * q[i]
        for e in range(1, loads.shape[0]):
            load = loads[e, j]
            for i in range(K):
                sums[first + e, i] += load * q[i]
        for c in range(m):
            row = rows[c, j]
            for i in range(K):
                sums[4 + c, i] += row * q[i]
            if rated:
                for i in range(K):
                    sums[4 + m + c, i] += row * v[i]
        if damping.size:
            # The first step starts from y, which is not among the ends of steps.
            sums[2, 0] += damping[j] * (q[0] - y[j]) ** 2
            sums[3, 0] += damping[j] * (v[0] + y[n + j]) ** 2
            for i in range(1, paths.shape[1]):
                sums[2, i] += damping[j] * (q[i] - q[i - 1]) ** 2
                sums[3, i] += damping[j] * (v[i] + v[i - 1]) ** 2
        y[j], y[n + j] = q[count - 1], v[count - 1]


@inlined
def _of_modes(squares: Array, z: Array, at: int) -> tuple[float, float]:
    """Kinetic and elastic energy of q and, from ``at`` on, q' in z."""
    kinetic = elastic = 0.0
    n, shift = np.uint64(squares.size), np.uint64(at)
    for j in range(n):
        elastic += squares[j] * z[j] * z[j]
    for j in range(n):
        kinetic += z[shift + j] * z[shift + j]
    return 0.5 * kinetic, 0.5 * elastic


@inlined
def _lost(
    balance: Array, kinetic: float, elastic: float, stops: float, given: float, viscous: float, taken: float
) -> float:
    """Loss in a range of steps that begins with ``balance`` and ends with these energies."""
    before = balance[KINETIC] + balance[ELASTIC] + balance[STOPS]
    return before - (kinetic + elastic + stops) + given - viscous - taken


@inlined
def _settle(
    balance: Array, kinetic: float, elastic: float, stops: float, given: float, viscous: float, taken: float, kind: int
) -> None:
    """The balance at the end of a stretch of one kind, with what was given and taken in it."""
    lost = _lost(balance, kinetic, elastic, stops, given, viscous, taken)
    balance[KINETIC], balance[ELASTIC], balance[STOPS] = kinetic, elastic, stops
    balance[INPUT] += given
    balance[VISCOUS] += viscous
    balance[LOSS] += lost
    balance[TAKEN] += taken
    balance[kind] += lost


@inlined
def _at_stop(law: Array, node_forces: Array, c: int, k: int, u: float, rate: float) -> tuple[float, float, float, bool]:
    """Force, what of it is not from the energy, the energy, and whether the stop presses."""
    stop = law_of(law, c)
    force = force_of_node(u, rate, node_forces[k, c], stop)
    pressed = state_of_node(u, rate, node_forces[k, c], stop) != 0.0
    # Contracted to one rounding, the difference of equal forces is not zero.
    beyond = force - elastic_force(u, stop) if damps(stop) else 0.0
    return force, beyond, law_energy(u, stop), pressed


@inlined
def _seen(rows: Array, c: int, z: Array, at: int, n: int) -> float:
    """row_c of z[at : at + n]."""
    total = 0.0
    shift = np.uint64(at)
    for j in range(np.uint64(n)):
        total += rows[c, j] * z[shift + j]
    return total
