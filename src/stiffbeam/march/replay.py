"""States and energy balance at every step of a block march, computed on demand.

A second march keeps the state at the start of each block and the forces in it. With known forces the single steps are
linear, and are computed from these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ..basics.arrays import Array
from ..kernels.march import SUMS, Balance, Energies, Span, Step, account
from ..kernels.march import states as states_of
from ..model.contact import laws
from ..model.system import System
from ..model.time_functions import Drive, Term, evaluate, offset_rate
from ..trajectory.records import Ledger, step_ledger
from .block_march import March, Segment, Stepper, initial_channels
from .propagator import Propagator, load_terms


def step_of(segment: Segment, one: Propagator) -> Step:
    """The steps of a segment with all they are given; ``one``: the scheme's propagator of a single step."""
    march, block, dt = segment.march, segment.block, segment.march.stepper.dt
    times = (segment.first + np.arange(segment.steps)) * dt
    forcing = march.forcing(one)
    by_step = segment.forces[:, : block.block.nodes].reshape(len(segment.forces) * block.steps, -1)[: segment.steps]
    n, of_state = one.coordinates.parts, one.block.reading.shape[1]
    N = one.coordinates.rows.shape[1]
    return Step(
        transition=one.block.transition,
        push=np.concatenate([one.block.push[: by_step.shape[1], of_state:], one.sampled_rows[:, of_state:]]),
        driven=np.ascontiguousarray(forcing.rows[0][:, of_state:]),
        forces=np.concatenate([by_step, one.samples_at(times, march.steps * dt)], axis=1),
        g=Drive(tuple(forcing.frequencies[0])).at_steps(segment.first, segment.steps + 1, dt),
        start=segment.starts[0],
        # Blocks carry the components in ``keep`` only, single steps all of them.
        place=(block.one.keep[:, None] * (N // n) + np.arange(N // n)).ravel(),
    )


def _segments(stepper: Stepper, system: System, steps: int) -> Iterator[tuple[Segment, Propagator]]:
    """The run once more, segment by segment, with the propagator of its single steps."""
    one = stepper.single
    segments: list[Segment] = []
    for _ in March(stepper, [system], steps, None).advance(segments.append):
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
        step = step_of(segment, one)
        out = _states_together(step, segment.starts, segment.block.steps) if n == 1 else states_of(step, n)
        z = out.reshape(segment.steps, -1, N)
        q, v = coordinates.states(np.moveaxis(z, 1, 0)[:2])
        new = q, v, node_forces_at_ends(segment, step, m)
        q, v, node_forces = (np.concatenate(both) for both in zip(last, new, strict=True))
        yield (segment.first + np.arange(len(q))) * stepper.dt, q, v, node_forces
        last = q[-1:], v[-1:], node_forces[-1:]


def _states_together(step: Step, starts: Array, K: int) -> Array:
    """The states (steps, D) of unknowns that step together, at the ends of all steps: the blocks of K steps from their
    ``starts`` (B, ..) side by side, one product of matrices for all of them in place of B with vectors."""
    steps, D = len(step.forces), step.transition.shape[1]
    # Row e of the packed transition multiplies what is e components later, see Step.
    component, T = np.arange(D), np.zeros((D, D))
    for e, row in enumerate(step.transition[:D]):
        T[(component + e) % D, component] = row
    out = step.g[:steps] @ step.driven + step.forces @ step.push
    z = np.zeros((len(starts), D))
    z[:, step.place] = starts[:, : len(step.place)]
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
    basis = stepper.coordinates.basis
    if basis is None:
        return step_ledger(system, replay(stepper, system, steps), np.arange(0, steps + 1, every) * stepper.dt)
    contacts, dt = system.contacts, stepper.dt
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
    loads = drive.split(load_terms(system), len(system.loads))
    offsets = drive.offsets(system)
    last = np.full((1, len(contacts)), np.nan)
    for segment, one in _segments(stepper, system, steps):
        t = (segment.first + np.arange(segment.steps + 1)) * dt
        step = step_of(segment, one)
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
        account(step, energies, Balance(y, met, balance, kept), Span(segment.first, segment.steps, every, dt))
    return Ledger(np.arange(0, steps + 1, every) * dt, *kept)


def _sum(terms: tuple[Array, list[Term]], g: Array, t: Array, value: Callable[..., Array]) -> Array:
    """A ``split`` at times t with the functions g there, (times, width)."""
    basis, rest = terms
    total = g @ basis
    for vector, function in rest:
        total += np.multiply.outer(value(function, t), vector)
    return total
