"""States and energy balance at every step of a block march, computed on demand.

A second march keeps the state at the start of each block and the forces in it. With known forces the single steps are
linear, and are computed from these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ..basics.arrays import Array, IntArray, aligned
from ..kernels.march import SUMS, Energies, FreeBlock, Step, account
from ..kernels.march import states as states_of
from ..model.contact import laws
from ..model.system import System
from ..model.time_functions import Drive, Term, evaluate, offset_rate
from ..trajectory.records import Ledger, step_ledger
from .block_march import Segment, Stepper, initial_channels
from .probe import InModes
from .propagator import Propagator


def no_block() -> FreeBlock:
    """States of every block, step by step."""
    return FreeBlock(np.zeros((0, 0)), np.zeros(0, np.int64))


def free_block(step: Step, place: IntArray, n: int, K: int, T: Array) -> FreeBlock:
    """K of the ``step`` of n modes, probed with units of the components in their ``place`` and of the drive.

    T: (d, d), the drive's transition over a step, g_k = T^k g.
    """
    d, carried, width = len(T), len(place), step.transition.shape[1]
    acting = np.flatnonzero(np.any(step.driven != 0.0, axis=1))
    g = np.empty((K + 1, d, d))  # T^k
    g[0] = np.eye(d)
    for k in range(K):
        g[k + 1] = T @ g[k]
    undriven = np.zeros_like(step.driven)
    harmonics = step.driven.copy()
    harmonics[0] = 0.0  # the constant drives by itself, in every step
    made = np.empty((carried + len(acting), K, width))
    # One motion for every unit: of a carried component, then of a function of the drive.
    for t in range(len(made)):
        start, driven, drives = np.zeros(carried * n), undriven, np.zeros((K + 1, d))
        if t < carried:
            start[t * n : (t + 1) * n] = 1.0  # of all modes at once, which do not see each other
        else:
            e = acting[t - carried]
            driven, drives = (harmonics, np.ascontiguousarray(g[:, :, e])) if e else (step.driven, drives)
        quiet = step._replace(driven=driven, g=drives, forces=np.zeros((K, len(step.push))))
        made[t] = states_of(quiet, n, start, place)
    paths = aligned((n, 2, len(made), K))
    paths[:] = made[:, :, : 2 * n].reshape(len(made), K, 2, n).transpose(3, 2, 0, 1)
    return FreeBlock(paths.reshape(-1, K), acting)


SHORT = 3200  # steps that are sooner taken one by one
STEPS = 32  # that are taken at once; of longer ones contact meets too many


def step_of(segment: Segment, one: Propagator, apart: int) -> tuple[Step, IntArray, Array]:
    """The steps of a segment with all they are given, and the states (B, ..) at the start of every ``apart``-th of its
    blocks, with the places of their components; ``one``: the scheme's propagator of a single step."""
    march, block, dt = segment.march, segment.block, segment.march.stepper.dt
    times = (segment.first + np.arange(segment.steps)) * dt
    forcing = march.forcing(one)
    by_step = segment.forces[:, : block.block.nodes].reshape(len(segment.forces) * block.steps, -1)[: segment.steps]
    n, of_state = one.coordinates.parts, one.block.reading.shape[1]
    N = one.coordinates.rows.shape[1]
    # Blocks carry the components in ``keep`` only, single steps all of them.
    place = (block.one.keep[:, None] * (N // n) + np.arange(N // n)).ravel()
    step = Step(
        transition=one.block.transition,
        push=np.concatenate([one.block.push[: by_step.shape[1], of_state:], one.sample_rows[:, of_state:]]),
        driven=np.ascontiguousarray(forcing.rows[0][:, of_state:]),
        forces=np.concatenate([by_step, one.samples_at(times, march.steps * dt)], axis=1),
        g=Drive(tuple(forcing.frequencies[0])).at_steps(segment.first, segment.steps + 1, dt),
    )
    return step, place, np.ascontiguousarray(segment.starts[::apart])


def _segments(stepper: Stepper, system: System, steps: int) -> Iterator[tuple[Segment, Propagator]]:
    """The run once more, segment by segment, with the propagator of its single steps."""
    one = stepper.single
    segments: list[Segment] = []
    for _ in stepper.start([system], steps, None).advance(segments.append):
        segment = segments.pop()
        yield segment, one if segment.block is not stepper.starter else segment.block


def node_forces_at_ends(segment: Segment, step: Step, contacts: int) -> Array:
    """The forces (steps, contacts) that nodes found at the ends of the steps; NaN where the last node is not there."""
    block = segment.block.block
    # No node lies at the end of a step: the force there follows from the state.
    if contacts and block.end_first[0] >= len(block.push):
        return np.full((segment.steps, contacts), np.nan)
    last = block.nodes // segment.block.steps
    return np.ascontiguousarray(step.forces[:, last - contacts : last])


def replay(stepper: Stepper, system: System, steps: int) -> Iterator[tuple[Array, Array, Array, Array]]:
    """A run at every step, see ``Pieces``."""
    m = len(system.contacts)
    coordinates, last = stepper.coordinates, (system.q0[None], system.v0[None], np.full((1, m), np.nan))
    for segment, one in _segments(stepper, system, steps):
        n, N = coordinates.parts, coordinates.rows.shape[1]
        if n == 1:
            step, place, starts = step_of(segment, one, 1)
            out = _states_together(step, place, starts, segment.block.steps)
        else:
            step, place, starts = step_of(segment, one, len(segment.starts))
            out = states_of(step, n, starts[0], place)
        z = out.reshape(segment.steps, -1, N)
        q, v = coordinates.states(np.moveaxis(z, 1, 0)[:2])
        new = q, v, node_forces_at_ends(segment, step, m)
        q, v, node_forces = (np.concatenate(both) for both in zip(last, new, strict=True))
        yield (segment.first + np.arange(len(q))) * stepper.dt, q, v, node_forces
        last = q[-1:], v[-1:], node_forces[-1:]


def _states_together(step: Step, place: IntArray, starts: Array, K: int) -> Array:
    """The states (steps, D) of unknowns that step together, at the ends of all steps: the blocks of K steps from their
    ``starts`` (B, ..) side by side, one product of matrices for all of them in place of B with vectors."""
    steps, D = len(step.forces), step.transition.shape[1]
    # Row e of the packed transition multiplies what is e components later, see Step.
    component, T = np.arange(D), np.zeros((D, D))
    for e, row in enumerate(step.transition[:D]):
        T[(component + e) % D, component] = row
    out = step.g[:steps] @ step.driven + step.forces @ step.push
    z = np.zeros((len(starts), D))
    z[:, place] = starts[:, : len(place)]
    for k in range(min(K, steps)):
        rows = slice(k, steps, K)
        z = z[: len(out[rows])] @ T + out[rows]
        out[rows] = z
    return out


def block_ledger(stepper: Stepper, system: System, steps: int, every: int) -> Ledger:
    """The ledger of a run, added up at every step and kept at every ``every``-th.

    In modal coordinates the same sums as ``step_ledger``, which takes them in the system's own.
    """
    # Unknowns that step together have no modal energies.
    if not isinstance(stepper.coordinates, InModes):
        return step_ledger(system, replay(stepper, system, steps), np.arange(0, steps + 1, every) * stepper.dt)
    basis, contacts, dt = stepper.coordinates.basis, system.contacts, stepper.dt
    moving = any(contact.offset is not None for contact in contacts)
    # Ten sums each, in the order of Ledger's fields; the first output is the start.
    kept, balance = np.empty((SUMS, steps // every + 1)), np.zeros(SUMS)
    balance[:3] = system.energies(0.0, system.q0, system.v0)
    kept[:, 0] = balance
    y = basis.to_modal(np.stack([system.q0, system.v0])).ravel()
    met = np.concatenate(initial_channels([system], system.q0[None], system.v0[None]))[:, : len(contacts)].copy()
    shared = {
        "squares": basis.omega**2,
        "damping": basis.damping if np.any(basis.damping) else basis.damping[:0],
        "loads": basis.force(np.array([vector for vector, _ in system.loads]).reshape(-1, system.size)),
        "rows": stepper.coordinates.columns,
        "law": laws(contacts),
    }
    drive = Drive.of(system)
    units = np.eye(len(system.loads))
    loads = drive.split([(units[k], f) for k, (_, f) in enumerate(system.loads)], len(units))
    offsets = drive.offsets(system)
    last, n = np.full((1, len(contacts)), np.nan), len(basis.omega)
    free = None
    for segment, one in _segments(stepper, system, steps):
        t = (segment.first + np.arange(segment.steps + 1)) * dt
        K = segment.block.steps
        # Whole blocks without contact are passed at once, in long runs whose loads are all in the drive.
        passed = K > 1 and steps > SHORT and not loads[1]
        apart = max(1, STEPS // K) if passed else len(segment.starts)
        step, place, starts = step_of(segment, one, apart)
        o, o_rate = np.zeros((2, 0, len(contacts)))
        if moving:
            o, o_rate = _sum(offsets, step.g, t, evaluate), _sum(offsets, step.g @ drive.derivative().T, t, offset_rate)
        # The first row is the end of the segment before.
        node_forces = np.concatenate([last, node_forces_at_ends(segment, step, len(contacts))])
        last = node_forces[-1:]
        energies = Energies(
            **shared,
            node_forces=node_forces,
            load_values=_sum(loads, step.g, t, evaluate),
            offsets=o,
            offset_rates=o_rate,
        )
        # The map of a whole block is the same in all segments.
        if passed and free is None:
            free = free_block(step, place, n, apart * K, drive.transition(dt))
        known = free if passed and free is not None else no_block()
        account(
            step, energies, known, place, starts, apart * K, y, met, balance, segment.first, every, dt, kept
        )  # fmt: skip
    return Ledger(np.arange(0, steps + 1, every) * dt, *kept)


def _sum(terms: tuple[Array, list[Term]], g: Array, t: Array, value: Callable[..., Array]) -> Array:
    """A ``split`` at times t with the functions g there, (times, width)."""
    basis, rest = terms
    total = g @ basis
    for vector, function in rest:
        total += np.multiply.outer(value(function, t), vector)
    return total
