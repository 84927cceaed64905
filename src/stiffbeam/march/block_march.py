"""The block march: members of an ensemble in blocks of K steps through one compiled kernel."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..basics.arrays import Array, aligned
from ..basics.resources import afford
from ..kernels import march as kernel
from ..kernels.march import EVENT, LINEAR, Forcing, Kept, Marchers, Span
from ..model.contact import channel_motion, laws
from ..model.contact_law import all_laws
from ..model.contact_law import jumps as force_jumps
from ..model.system import System
from ..schemes import Scheme
from ..trajectory.recorder import end_tallies, forces_at, overflow, record, start_tallies
from ..trajectory.sampling import CONTACT, END, IMPACT_IMPULSE, IMPACT_PEAK, MEMBER, ROW, SIDE
from ..trajectory.trajectory import SolverFailure
from .probe import Coordinates, StepMap, independent
from .propagator import Propagator
from .treatment import Treatment, require_giving_way, require_moved

BLOCKS, DENSE = "modal blocks", "dense blocks"
STEPS_PER_CALL = 1 << 16  # between two reports of progress
STEPS_REPLAYED = 1 << 14  # held in memory at once where states, or sampled loads, are wanted
NUMBERS_REPLAYED = 1 << 23  # of their states
LARGEST = 1 << 27  # numbers in the powers of a step and the rows of loads: 1 GiB
LEAST, LONGEST = 32, 256  # force nodes of a block


def block_length(coordinates: Coordinates, scheme: Scheme, steps: int) -> int:
    """Steps in a block, a power of two.

    A block of K steps is a product with (R + D) x D numbers, D = k N for the k components that a scheme carries of N
    unknowns, once the powers of one step are made. In modes these are few, and K is bounded by the contact alone: it
    takes longer to find the forces of more nodes than is saved elsewhere.
    """
    nodes = len(scheme.nodes) * max(1, len(coordinates.columns))  # in a step
    if coordinates.basis is not None:
        return 2 ** max(0, int(np.log2(LEAST / nodes)))
    D = float(len(independent(scheme, 1.0)[0]) * coordinates.rows.shape[1])
    # Single steps too take the matrix of one, and the unit states that it is probed with.
    afford(
        "system",
        f"{coordinates.rows.shape[1]} unknowns",
        "reduce_model leaves the modes that matter",
        floats=10.0 * D**2,
    )
    loads = max(1, len(coordinates.system.loads)) * len(scheme.nodes)
    longest = min(np.clip(D / 4, LEAST, LONGEST) / nodes, LARGEST / (loads * D))
    # The doubling to K costs a product of D x D matrices, and saves one of steps/K with D numbers each. In memory a
    # matrix is read at half the speed of that product.
    doublings = min(np.log2(min(longest, 2.0 * steps / D)), LARGEST / D**2 - 2.0)
    return 2 ** max(0, int(doublings))


class Launch(NamedTuple):
    """M members at t = 0, before the first step. A march copies what it changes."""

    law: Array  # (M, m, 6)
    position: Array  # (M, C)
    velocity: Array
    tally: Array  # (M, m, 8)
    events: Array  # (rows, 7): the contacts that are there
    start: Array  # (2, M, N): y in the coordinates
    z: Array  # the packed state of the first propagator
    force: Array  # (M, m) of the contacts
    jumps: bool  # True where the force of a stop jumps


class Stepper:
    """A scheme on a system in coordinates, in blocks of ``length`` steps: what all members share, computed once.

    The propagators of the starter and of the blocks contain the linear part only. Members may differ in initial data,
    in their stops and in the frequencies and amplitudes of their harmonic loads. rule: how nodes find their forces, see
    Block.
    """

    def __init__(
        self, coordinates: Coordinates, scheme: Scheme, dt: float, treatment: Treatment, length: int, rule: int
    ) -> None:
        self.coordinates, self.scheme, self.dt, self.treatment, self.rule = coordinates, scheme, dt, treatment, rule
        given, starter = (coordinates, dt), scheme.starter
        # The starter hands over whole states, so that none of its components is left out.
        self.starter = None if starter is None else Propagator(starter, *given, 1, treatment, rule, reduced=False)
        self.block = Propagator(scheme, *given, length, treatment, rule)
        # A force that depends on velocity is unique only where these hold.
        for each in (self.starter, self.block):
            if each is not None and len(each.block.rates):
                require_giving_way(each.one.scheme, *each.compliances)

    @property
    def system(self) -> System:
        """The system whose matrices are used."""
        return self.coordinates.system

    @property
    def kind(self) -> str:
        """Name of the march in ``provenance["march"]``."""
        return DENSE if self.coordinates.basis is None else BLOCKS

    @cached_property
    def single(self) -> StepMap:
        """The single step with whole states, for all that a march passes over."""
        return StepMap(self.scheme, self.coordinates, self.dt, reduced=False)

    @cached_property
    def own_launch(self) -> Launch:
        """The launch of ``system`` itself, with contacts recorded from the start."""
        return self.launch([self.system], 0, True)

    def launch(self, systems: Sequence[System], since: int, alike: bool) -> Launch:
        """These members at t = 0. ``alike``: they have the loads of ``system``."""
        law = np.array([laws(each.contacts) for each in systems])
        first, coordinates, means = self.starter or self.block, self.coordinates, self.treatment.means
        u, v = initial_channels(systems)
        tally, events = start_tallies(u, v, law, self.dt, means, since)
        start = np.stack([coordinates.start(each.q0, each.v0) for each in systems], axis=1)
        force = self.force(systems[:1] if alike else systems, 0.0, (u, v), law)
        z = self.packed(first, first.one.scheme, [start], force)
        # Where a force jumps at its stop, every node must yield to it.
        jumping = bool(np.any(force_jumps(all_laws(law))))
        for each in (self.starter, self.block) if jumping else ():
            if each is not None:
                require_moved(each.one.scheme, each.compliances[0])
        return Launch(law, u, v, tally, events, start, z, forces_at(u, v, law), jumping)

    def force(self, systems: Sequence[System], t: float, motion: tuple[Array, Array], law: Array) -> Array:
        """Load plus contact force at time t, (members, N); systems: one a member, or one for all."""
        total = np.zeros((len(law), self.coordinates.rows.shape[1]))
        total[:] = [self.coordinates.load(each, t) for each in systems]
        if not self.treatment.means:  # whose reactions are means over a step, not there at a time
            forces = forces_at(*motion, law)
            for c in range(law.shape[1]):
                total += forces[:, c, None] * self.coordinates.columns[c]
        return total

    def packed(self, propagator: Propagator, scheme: Scheme, history: list[Array], force: Array) -> Array:
        """The scheme's states under forces (M, N), packed. Member by member: sums over a batch round otherwise."""
        each = [
            propagator.pack(
                scheme.initial(
                    self.coordinates.equation,
                    [np.ascontiguousarray(y[:, i : i + 1]) for y in history],
                    force[i : i + 1],
                )
            )
            for i in range(len(force))
        ]
        return copied(np.concatenate(each))


class March:
    """Ensemble members in progress. They advance together, segment by segment.

    every: outputs kept, None for none. positions, velocities: (M, outputs, C). node_forces: (M, outputs, m), see Kept;
    no outputs where no force jumps. t: (outputs,), and forces, (M, outputs, m) of linear stops; none of an ensemble,
    which has one grid for all members. events: (impacts, 7), see sampling; by member, in order of time. tally: (M, m,
    8) of the whole run, at the end.
    """

    tally: Array

    def __init__(
        self, stepper: Stepper, members: Sequence[System], steps: int, every: int | None, since: int = 0
    ) -> None:
        self.stepper, self.members, self.steps, self.every, self.done = stepper, members, steps, every, 0
        system, M = stepper.system, len(members)
        self._alike = True
        if M == 1 and members[0] is system and not since:
            self._launch = launch = stepper.own_launch
        else:
            # Equal loads and offsets: the response to the drive is computed once for all members.
            own = functions(system)
            self._alike = all(each is system or functions(each) == own for each in members)
            self._launch = launch = stepper.launch(members, since, self._alike)
        self.law, u, v, diverged = launch.law, launch.position, launch.velocity, np.zeros(M, np.int64)
        self.state = Marchers(launch.law, copied(launch.z), u.copy(), v.copy(), launch.tally.copy(), diverged)
        kept = 0 if every is None else steps // every + 1
        self.positions, self.velocities = np.empty((2, M, kept, u.shape[1]))
        # Where a force jumps at its stop, the state at the end of a step does not determine it: the nodes' is kept.
        m = len(system.contacts)
        self.node_forces = np.full((M, kept if launch.jumps else 0, m), np.nan)
        alone = kept if M == 1 else 0
        self.t, self.forces = np.empty(alone), np.empty((M, alone if stepper.rule == LINEAR else 0, m))
        if kept:
            self.positions[:, 0], self.velocities[:, 0], self.t[:1] = u, v, 0.0
        if self.forces.shape[1]:
            self.forces[:, 0] = launch.force
        # Room for 64 impacts a member, and for up to 1024 more; ``_segment`` lengthens the list when it is full.
        self._rows = len(launch.events)
        self.events = np.empty((self._rows + 64 * M + min(1024, steps // 16), EVENT))
        self.events[: self._rows] = launch.events

    def advance(self, replayed: Callable[[Segment], None] | None = None) -> Iterator[int]:
        """March to the end; yields the number of steps done after every segment."""
        stepper, scheme = self.stepper, self.stepper.scheme
        history = [self._launch.start]
        # A multistep scheme begins with its starter, step by step; the states are its history, newest first.
        if stepper.starter is not None:
            one = stepper.starter
            forcing = self.forcing(one)
            for _ in range(min(self.steps, scheme.history - 1)):
                self._segment(one, forcing, 1, replayed)
                history.insert(0, one.unpack(self.state.z)[:2])
                yield self.done
        if self.done < self.steps:
            block = stepper.block
            # The scheme's state follows from that history.
            if self.done:
                t, motion = self.done * stepper.dt, (self.state.position, self.state.velocity)
                force = stepper.force(self.members[:1] if self._alike else self.members, t, motion, self.law)
                self.state = self.state._replace(z=stepper.packed(block, scheme, history, force))
            forcing = self.forcing(block)
            # The more members, the fewer steps a call, down to a sixteenth: progress is reported between calls.
            most = STEPS_PER_CALL // min(16, len(self.members))
            # States, or sampled loads, of a whole segment are held in memory.
            if replayed is not None or not block.harmonic:
                most = min(STEPS_REPLAYED, NUMBERS_REPLAYED // self.state.z.shape[1])
            most = max(1, most // block.steps) * block.steps  # the blocks of a run do not depend on the company
            while self.done < self.steps:
                self._segment(block, forcing, min(most, self.steps - self.done), replayed)
                yield self.done
        self._finish()

    def forcing(self, block: Propagator) -> Forcing:
        """Response of one of the propagators to the loads and offsets of the members."""
        return block.own_forcing if self._alike else block.forcing(self.members)

    def _segment(
        self, block: Propagator, forcing: Forcing, steps: int, replayed: Callable[[Segment], None] | None
    ) -> None:
        first, dt, K = self.done, self.stepper.dt, block.steps
        starts_at = (first + K * np.arange(-(-steps // K))) * dt
        inflow = block.inflow(starts_at, self.steps * dt)
        rows, zeros = (len(starts_at), aligned) if replayed is not None else (0, np.empty)
        starts, forces = zeros((rows, self.state.z.shape[1])), zeros((rows, len(block.block.push)))
        outputs, cursor = (self.t, self.positions, self.velocities), np.array([0, 0, self._rows])
        kept = Kept(*outputs, self.node_forces, self.forces, starts, forces, self.events, cursor)
        span = Span(first, steps, self.every or 1, dt)
        # Where the list of impacts is full, the kernel returns False and goes on from ``cursor`` at the next call.
        while not kernel.run(block.block, forcing, inflow, self.state, kept, span):
            # Doubling keeps the number of copies small.
            longer = max(2 * len(self.events), cursor[2] + 2 * K * max(1, self.law.shape[1]))
            self.events = np.concatenate([self.events, np.empty((longer - len(self.events), EVENT))])
            kept = kept._replace(events=self.events)
        self._rows = int(cursor[2])
        self.done += steps
        if replayed is not None:
            replayed(Segment(self, block, first, steps, starts, forces))

    def fields(self, member: int, tip_only: bool = False) -> dict[str, Any]:
        """Fields of the Trajectory of a member, at the end: outputs, contacts, and when it overflowed. tip_only: of
        the contacts without positions and forces."""
        # Events are in the order of the members, see ``_finish``.
        own = self.events
        if len(self.members) > 1:
            first, last = np.searchsorted(self.events[:, MEMBER], [member, member + 1])
            own = self.events[first:last]
        positions, velocities, tip = self.positions[member], self.velocities[member], self.stepper.system.tip_channel
        u, v = np.ascontiguousarray(positions[:, tip]), np.ascontiguousarray(velocities[:, tip])  # of one contact views
        contacts, outputs = [], slice(0 if tip_only else None)
        for c, contact in enumerate(self.members[member].contacts):
            events = own[own[:, CONTACT] == c] if self.tally.shape[1] > 1 else own
            node_forces = self.node_forces[member, outputs, c] if self.node_forces.shape[1] else None
            forces = self.forces[member, outputs, c] if self.forces.shape[1] else None
            motion, tally = (positions[outputs, c], velocities[outputs, c]), self.tally[member, c]
            contacts.append(record(contact.stops, *motion, tally, events, self.steps, node_forces, forces))
        dt, diverged = self.stepper.dt, int(self.state.diverged[member])
        # A negative step: the search for the forces of several contacts failed there.
        if diverged < 0:
            reason, remedy = (
                "the forces of several contacts at once were not found",
                "use a smaller dt, or the solver cvode",
            )
            raise SolverFailure(str(self.stepper.scheme), -diverged * dt, reason, remedy)
        when = diverged * dt if diverged else overflow(contacts, self.steps * dt)
        return {"t": self.t, "tip": u, "tip_velocity": v, "contacts": tuple(contacts), "diverged": when}

    def _finish(self) -> None:
        """Sort the impacts, leave open contacts open, and include the forces at start and end."""
        tally, events = self.state.tally, self.events
        # An impact that is still open has no peak, impulse or end.
        open_rows = tally[..., ROW][(tally[..., SIDE] != 0.0) & (tally[..., ROW] >= 0.0)].astype(int)
        if len(open_rows):
            events[open_rows[:, None], [IMPACT_PEAK, IMPACT_IMPULSE, END]] = np.nan
        events = events[: self._rows]
        # By member, then contact; the kernel wrote the rows of one contact in order of time.
        several = tally[..., 0].size > 1
        order = np.lexsort((np.arange(len(events)), events[:, CONTACT], events[:, MEMBER])) if several else slice(None)
        self.events = events[order]
        last, means = (self.state.position, self.state.velocity), self.stepper.treatment.means
        self.tally = tally if means else end_tallies(tally, self.law, self.stepper.dt, last)


@dataclass(frozen=True, eq=False)
class Segment:
    """Consecutive steps of the only member of a march, with the data to compute them again."""

    march: March
    block: Propagator
    first: int
    steps: int
    starts: Array  # (B, D): the state at the start of each block
    forces: Array  # (B, N)


def copied(values: Array) -> Array:
    """A copy at a 64-byte boundary."""
    copy = aligned(values.shape)
    copy[:] = values
    return copy


def functions(system: System) -> list[object]:
    """Loads and offsets of a system; vectors count as equal to themselves only."""
    return [*((id(vector), f) for vector, f in system.loads), *(offset for _, offset in system.channels)]


def initial_channels(systems: Sequence[System]) -> tuple[Array, Array]:
    """Positions and velocities (M, C) of the channels of M systems at t = 0."""
    each = [[channel_motion(row, o, 0.0, x.q0, x.v0) for row, o in x.channels] for x in systems]
    u, v = np.moveaxis(np.array(each, float).reshape(len(systems), -1, 2), 2, 0)
    return np.ascontiguousarray(u), np.ascontiguousarray(v)
