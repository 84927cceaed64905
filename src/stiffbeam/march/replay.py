"""What a block march passes over: states and the energy ledger at every step.

A second march keeps the state at the start of each block and the forces in it; from these the single
steps are taken once more, linear now. A run that nobody asks pays nothing for this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ..basics.arrays import Array, aligned
from ..model.contact import laws
from ..model.drive import Drive, Term
from ..model.system import System
from ..model.time_functions import evaluate, offset_rate
from ..trajectory.ledger import Ledger, step_ledger
from .block_march import Segment, Stepper, initial_channels
from .build import build
from .coordinates import InModes
from .free_blocks import free_block, no_block
from .kernels.single_steps import Energies, Step, account
from .kernels.single_steps import states as states_of
from .leap import start
from .propagator import Propagator

SHORT = 3200  # steps that are sooner taken one by one
STEPS = 32  # that are passed over at once; of longer ones contact meets too many


def step_of(segment: Segment, one: Propagator, apart: int) -> tuple[Step, Array]:
    """The steps of a segment with all they are given, and the packed states (B, ..) at the start of every ``apart``-th
    of its blocks; ``one``: the scheme's propagator of a single step."""
    march, dt = segment.march, segment.march.stepper.dt
    times = (segment.first + np.arange(segment.steps)) * dt
    forcing = march.forcing(one)
    nodes = len(segment.block.block.compliance)
    by_step = segment.forces[:, :nodes].reshape(len(segment.forces) * segment.block.steps, -1)[: segment.steps]
    of_state = slice(one.block.reading.shape[0], None)
    step = Step(
        transition=one.block.transition,
        push=np.ascontiguousarray(one.block.push[:, of_state]),
        driven=np.ascontiguousarray(forcing.rows[0][0 if forcing.constant else 1 :, of_state]),
        forces=by_step,
        g=Drive(tuple(forcing.frequencies[0])).at_steps(segment.first, segment.steps + 1, dt),
        inflow=one.inflow(times, march.steps * dt).rows[:, of_state],
    )
    return step, one.pack(segment.block.unpack(segment.starts[::apart]))


def _segments(stepper: Stepper, system: System, steps: int) -> Iterator[tuple[Segment, Propagator]]:
    """The run once more, segment by segment, with the propagator of its single steps."""
    one = build(stepper.scheme, stepper.coordinates, stepper.dt, 1, stepper.contact, reduced=False, rule=stepper.rule)
    found: list[Segment] = []
    for _ in start(stepper, [system], steps, None).advance(found.append):
        segment = found.pop()
        yield segment, one if segment.block is not stepper.starter else segment.block


def found_at_ends(segment: Segment, step: Step, contacts: int) -> Array:
    """The forces (steps, contacts) that nodes found at the ends of the steps; NaN where the last node is not there."""
    block = segment.block.block
    if contacts and block.end_first[0] >= len(block.push):
        return np.full((segment.steps, contacts), np.nan)
    return np.ascontiguousarray(step.forces[:, step.forces.shape[1] - contacts :])


def replay(stepper: Stepper, system: System, steps: int) -> Iterator[tuple[Array, Array, Array, Array]]:
    """A run at every step, see ``Pieces``."""
    m = len(system.contacts)
    coordinates, last = stepper.coordinates, (system.q0[None], system.v0[None], np.full((1, m), np.nan))
    for segment, one in _segments(stepper, system, steps):
        step, starts = step_of(segment, one, len(segment.starts))
        out = aligned((segment.steps, one.block.reading.shape[1]))
        states_of(step, coordinates.parts, starts[0], out)
        q, v = coordinates.states(one.unpack(out)[: coordinates.equation.order])
        new = q, v, found_at_ends(segment, step, m)
        q, v, found = (np.concatenate(both) for both in zip(last, new, strict=True))
        yield (segment.first + np.arange(len(q))) * stepper.dt, q, v, found
        last = q[-1:], v[-1:], found[-1:]


def block_ledger(stepper: Stepper, system: System, steps: int, every: int) -> Ledger:
    """The ledger of a run, added up at every step and kept at every ``every``-th.

    In modal coordinates the same sums as ``step_ledger``, which takes them in the system's own.
    """
    if not isinstance(stepper.coordinates, InModes):
        return step_ledger(system, replay(stepper, system, steps), np.arange(0, steps + 1, every) * stepper.dt)
    basis, contacts, dt = stepper.coordinates.basis, system.contacts, stepper.dt
    moving = any(contact.offset is not None for contact in contacts)
    kept, balance = np.zeros((steps // every + 1, 10)), np.zeros(10)
    start = np.array(system.energies(0.0, system.q0, system.v0))
    kept[0, :3] = balance[:3] = start
    y = basis.to_modal(np.stack([system.q0, system.v0])).ravel()
    met = np.concatenate(initial_channels([system], system.q0[None], system.v0[None]))[:, : len(contacts)].copy()
    shared = {
        "squares": basis.omega**2,
        "damping": basis.damping if np.any(basis.damping > 0.0) else basis.damping[:0],
        "loads": basis.force(np.array([vector for vector, _ in system.loads]).reshape(-1, system.size)),
        "rows": stepper.coordinates.columns,
        "law": laws(contacts),
    }
    drive = Drive.of(system)
    units = np.eye(len(system.loads))
    loads = drive.split([(units[k], f) for k, (_, f) in enumerate(system.loads)], len(units))
    offsets = drive.offsets(system)
    # A damped stop that has let go still holds energy: its block is not one without contact.
    damped = len(shared["damping"]) or any(contact.stops.dissipative for contact in contacts)
    closed = steps > SHORT and not (damped or loads[1] or offsets[1])
    free, last = None, np.full((1, len(contacts)), np.nan)
    for segment, one in _segments(stepper, system, steps):
        t = (segment.first + np.arange(segment.steps + 1)) * dt
        K = segment.block.steps
        apart = max(1, STEPS // K) if closed and K > 1 else len(segment.starts)
        step, starts = step_of(segment, one, apart)
        o, o_rate = np.zeros((2, 0, len(contacts)))
        if moving:
            o, o_rate = _sum(offsets, step.g, t, evaluate), _sum(offsets, step.g @ drive.derivative().T, t, offset_rate)
        found = np.concatenate([last, found_at_ends(segment, step, len(contacts))])
        last = found[-1:]
        energies = Energies(
            **shared, found=found, load_values=_sum(loads, step.g, t, evaluate), offsets=o, offset_rates=o_rate
        )
        if closed and free is None and K > 1:
            turn, moved = drive.transition(dt), offsets[0][:, : len(contacts)]
            free = free_block(one, step, apart * K, turn, energies, loads[0], moved)
        known = free if free is not None and K > 1 else no_block(len(contacts), len(system.loads))
        account(step, energies, known, starts, apart * K, system.size, y, met, balance, segment.first, every, dt, kept)
    return Ledger(np.arange(0, steps + 1, every) * dt, *kept.T)


def _sum(terms: tuple[Array, list[Term]], g: Array, t: Array, value: Callable[..., Array]) -> Array:
    """A ``split`` at times t with the functions g there, (times, width)."""
    basis, rest = terms
    total = g @ basis
    for vector, function in rest:
        total += np.multiply.outer(value(function, t), vector)
    return total
