"""The modal march: blocks of K steps of any scheme through one compiled kernel."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from . import kernel
from .arrays import LANES, Array, aligned
from .modal import Modes
from .pieces import STEPS_PER_PIECE, Piece
from .propagator import Propagator, build
from .schemes import Scheme
from .system import System, offset_rate

NODES_PER_BLOCK = 48  # longer blocks pay more for the contact than they save


def block_length(scheme: Scheme, contacts: int) -> int:
    """The largest power of two of steps with at most NODES_PER_BLOCK force nodes."""
    nodes = len(scheme.nodes) * max(1, contacts)
    return 2 ** max(0, int(np.log2(NODES_PER_BLOCK / nodes)))


def modal_pieces(system: System, basis: Modes, scheme: Scheme, dt: float, steps: int, contact: str) -> Iterator[Piece]:
    """The starter's steps one by one, then blocks."""
    y = np.stack([basis.to_modal(system.q0), basis.to_modal(system.v0)])
    history, first = [y], 0
    positions = system.positions(0.0, system.q0)
    force = basis.force(_total_force(system, 0.0, positions))
    starter = scheme.starter
    if starter is not None:
        one = build(starter, system, basis, dt, 1, contact)
        z = one.pack(starter.initial(basis.equation, history, force))
        for piece in _blocks(one, lambda: one, basis, z, 0, min(steps, scheme.history - 1)):
            yield piece
            history.insert(0, one.unpack(z)[:2].copy())
            first += 1
            force = basis.force(_total_force(system, first * dt, piece.positions[-1]))
    if first < steps:
        z0 = scheme.initial(basis.equation, history, force)
        block = build(scheme, system, basis, dt, block_length(scheme, len(system.contacts)), contact)
        single_step = cache(lambda: build(scheme, system, basis, dt, 1, contact))  # for states only
        yield from _blocks(block, single_step, basis, block.pack(z0), first, steps - first)


def _total_force(system: System, t: float, positions: Array) -> Array:
    """Load plus contact force at time t."""
    force = system.load(t)
    for c, contact in enumerate(system.contacts):
        force = force + contact.row * contact.stops.force(positions[c])
    return force


def _blocks(
    block: Propagator,
    one: Callable[[], Propagator],
    basis: Modes,
    z: Array,
    first: int,
    steps: int,
) -> Iterator[Piece]:
    """``steps`` steps from the packed state z (advanced in place) at step ``first``."""
    K, dt = block.steps, block.dt
    per_piece = max(1, STEPS_PER_PIECE // K) if K > 1 else 1
    R, N, D = block.reading.shape[0], block.push.shape[0], z.size
    g1 = np.array([s.g1 for s in block.stops])
    g2 = np.array([s.g2 for s in block.stops])
    kappa = np.array([s.stiffness for s in block.stops])
    single = block.contacts <= 1
    march = kernel.march if single else kernel.march_several
    law = tuple(x[0] if len(x) else default for x, default in ((kappa, 0.0), (g1, -np.inf), (g2, np.inf)))
    law = law if single else (kappa, g1, g2)
    last = (first + steps) * dt
    most = min(per_piece, -(-steps // K))
    buffers = [aligned((most, width)) for width in (R, N, D)]
    done = 0
    while done < steps:
        begun = time.perf_counter()
        blocks = min(most, -(-(steps - done) // K))
        starts_at = (first + done + K * np.arange(blocks)) * dt
        entries, forces, starts = (buffer[:blocks] for buffer in buffers)
        inflow, inflow_state, values = block.inflow(starts_at, last)
        march(
            z, block.reading, block.transition, block.push, block.push_state, *law,
            block.drive.coefficients(starts_at), block.drive_state, inflow, inflow_state, entries, forces, starts,
        )  # fmt: skip
        valid = min(blocks * K, steps - done)
        positions = entries[:, block.end_entry].reshape(blocks * K, -1)[:valid]
        seconds = time.perf_counter() - begun

        def velocities(k, values=values, forces=forces, starts=starts, starts_at=starts_at):
            rows, inside = np.divmod(np.asarray(k) - 1, K)
            used, where = np.unique(rows, return_inverse=True)
            of_blocks = (
                np.tensordot(starts[used], block.velocity, (1, 2))
                + np.tensordot(forces[used], block.velocity_push, (1, 2))
                + np.tensordot(values[used], block.velocity_samples, (1, 2))
            )
            speeds = of_blocks[where, inside]
            for unit, offset in block.offset_samples:
                speeds[:, np.argmax(unit)] += offset_rate(offset, starts_at[rows] + (inside + 1) * dt)
            return speeds

        def states(forces=forces, starts=starts, valid=valid, at=first + done):
            single_step = one()
            times = (at + np.arange(valid)) * dt
            _, inflow_one, _ = single_step.inflow(times, last)
            out = aligned((valid, D))
            by_step = np.ascontiguousarray(forces.reshape(len(forces) * K, N // K)[:valid])
            kernel.fill(
                starts[0].copy(), single_step.transition, single_step.push_state, by_step,
                block.drive.coefficients(times), single_step.drive_state, inflow_one, out,
            )  # fmt: skip
            z_all = single_step.unpack(out)
            return basis.to_nodal(z_all[:, 0]), basis.to_nodal(z_all[:, 1])

        yield Piece(first + done, positions, velocities, states, seconds)
        done += valid


def warm_up(contacts: int) -> float:
    """Compile or load the kernels on empty input; the seconds it took."""
    begun = time.perf_counter()
    empty, cube = np.zeros((0, LANES)), np.zeros((1, 1, LANES))
    state, law = np.zeros(LANES), np.ones(2)
    square = np.zeros((LANES, LANES))
    if contacts <= 1:
        kernel.march(state, square, cube, square, square, 1.0, 0.0, 0.0, *[empty] * 7)
    else:
        kernel.march_several(state, square, cube, square, square, law, law, law, *[empty] * 7)
    index = np.zeros(1, np.int64)
    kernel.scan(np.zeros(1), 0.0, 0.0, 1.0, 1.0, 0, index, index, np.zeros(1), np.zeros(1))
    none = np.zeros(0, np.int64)
    kernel.crossing_times(np.zeros(1), np.zeros(0), np.zeros(0), none, none, 0.0, 0.0, 1.0, np.zeros(0))
    return time.perf_counter() - begun
