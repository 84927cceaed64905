"""The block march: members of an ensemble in blocks of K steps through one compiled kernel."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..basics.arrays import Array, aligned
from ..model.contact import laws
from ..model.stage import LINEAR
from ..model.system import System
from ..model.time_functions import offset_rate
from ..schemes import Scheme
from ..trajectory.recorder import Seen, overflow, record, with_ends
from ..trajectory.sampling import CONTACT, END, EVENT, IMPACT_IMPULSE, IMPACT_PEAK, MEMBER, ROW, SIDE, new_tally
from .build import build
from .choice import nodes_per_block
from .coordinates import Coordinates, InModes
from .kernels import blocks as kernel
from .kernels import blocks_jax as kernel_jax
from .kernels import blocks_numpy as kernel_numpy
from .kernels.layout import Forcing, Kept, Marchers
from .propagator import Propagator
from .rules import require_giving_way, rule_of, unsolved

BLOCKS, DENSE = "modal blocks", "dense blocks"
STEPS_PER_CALL = 1 << 16  # between two reports of progress
STEPS_REPLAYED = 4096  # held in memory at once where states, or sampled loads, are wanted


RUNS = {"numba": kernel.run, "numpy": kernel_numpy.run, "jax": kernel_jax.run}


def block_length(coordinates: Coordinates, scheme: Scheme) -> int:
    """The largest power of two of steps that have no more force nodes than pay."""
    nodes = len(scheme.nodes) * max(1, len(coordinates.columns))
    return 2 ** max(0, int(np.log2(nodes_per_block(coordinates, scheme) / nodes)))


@dataclass(frozen=True, eq=False)
class Stepper:
    """A scheme on a system in coordinates: what every member shares, made once.

    The propagators of the starter and of the blocks know the linear part only. Members may differ in
    initial data, in their stops and in the frequencies and amplitudes of their harmonic loads.
    """

    coordinates: Coordinates
    scheme: Scheme
    dt: float
    contact: str
    starter: Propagator | None
    block: Propagator
    rule: int  # how nodes find their forces, see Block
    run: Callable[..., bool] = kernel.run  # or the same in NumPy
    _forcings: dict[Propagator, Forcing] = field(default_factory=dict, repr=False)
    leapers: list[Any] = field(default_factory=list, repr=False)  # what the leaping march has made, see leap

    @classmethod
    def of(
        cls,
        coordinates: Coordinates,
        scheme: Scheme,
        dt: float,
        contact: str,
        engine: str = "numba",
        rule: int | None = None,
    ) -> Stepper:
        """rule: for stops of that kind, the system's own unless given."""
        system, starter = coordinates.system, scheme.starter
        rule = rule_of(system.contacts, contact) if rule is None else rule
        one = None if starter is None else build(starter, coordinates, dt, 1, contact, reduced=False, rule=rule)
        block = build(scheme, coordinates, dt, block_length(coordinates, scheme), contact, rule=rule)
        for made in (one, block):
            if made is not None and len(made.block.rates):
                require_giving_way(made.scheme, *made.compliances)
        return cls(coordinates, scheme, dt, contact, one, block, rule, RUNS[engine])

    @property
    def system(self) -> System:
        """Whose matrices are marched."""
        return self.coordinates.system

    @property
    def kind(self) -> str:
        """What ``provenance["march"]`` says of it."""
        return BLOCKS if isinstance(self.coordinates, InModes) else DENSE

    def forcing(self, propagator: Propagator) -> Forcing:
        """What the loads and offsets of ``system`` itself do to one of the propagators; made once."""
        if propagator not in self._forcings:
            self._forcings[propagator] = propagator.forcing([self.system])
        return self._forcings[propagator]

    def start(self, members: Sequence[System], steps: int, every: int | None, since: int = 0) -> March:
        """The members at t = 0, ready for ``steps`` steps in blocks; contacts are recorded after step ``since``."""
        return March(self, tuple(members), steps, every, since)


@dataclass(eq=False)
class March:
    """Members on their way: they march in step, segment by segment."""

    stepper: Stepper
    members: tuple[System, ...]
    steps: int
    every: int | None  # outputs kept, None for none
    since: int = 0
    done: int = 0
    seconds: float = 0.0
    positions: Array = field(init=False)  # (M, outputs, C)
    velocities: Array = field(init=False)
    events: Array = field(init=False)  # (impacts, 7), see sampling; by member, in order of time
    state: Marchers = field(init=False)
    kind: str = ""  # of march; known at the end
    compile_seconds: float = 0.0  # of kernels that only some marches need

    def __post_init__(self) -> None:
        system, M = self.stepper.system, len(self.members)
        self.kind = self.stepper.kind
        self.law = np.stack([laws(member.contacts) for member in self.members])
        own = functions(system)
        self._alike = all(functions(member) == own for member in self.members)
        u, v = (np.array(x) for x in zip(*(initial_channels(member) for member in self.members), strict=True))
        m = len(system.contacts)
        tally = new_tally(u[:, :m], v[:, :m], self.law, self.since)
        self.state = Marchers(np.zeros((M, 0)), u, v, tally, np.zeros(M, np.int64))
        kept = 0 if self.every is None else self.steps // self.every + 1
        self.positions, self.velocities = np.zeros((2, M, kept, u.shape[1]))
        if kept:
            self.positions[:, 0], self.velocities[:, 0] = u, v
        self._rows, self.events = 0, np.empty((64 * M, EVENT))
        self._history = [np.stack([self.stepper.coordinates.start(member) for member in self.members], axis=1)]

    def advance(self, replayed: Callable[[Segment], None] | None = None) -> Iterator[int]:
        """March to the end; yields the number of steps done after every segment."""
        stepper, scheme, equation = self.stepper, self.stepper.scheme, self.stepper.coordinates.equation
        history = self._history
        if stepper.starter is not None:
            one = stepper.starter
            z = one.scheme.initial(equation, history, self._force())
            self.state = self.state._replace(z=one.pack(z))
            forcing = self.forcing(one)
            for _ in range(min(self.steps, scheme.history - 1)):
                self._segment(one, forcing, 1, replayed)
                history.insert(0, one.unpack(self.state.z)[: equation.order])
                yield self.done
        if self.done < self.steps:
            block = stepper.block
            z = scheme.initial(equation, history, self._force())
            self.state = self.state._replace(z=block.pack(z))
            yield from self._on(replayed)
        self._finish()

    def _on(self, replayed: Callable[[Segment], None] | None) -> Iterator[int]:
        """With the scheme's own propagator to the end."""
        block = self.stepper.block
        forcing = self.forcing(block)
        bounded = replayed is not None or not block.harmonic
        most = STEPS_REPLAYED if bounded else max(STEPS_REPLAYED, STEPS_PER_CALL // len(self.members))
        most = max(1, most // block.steps) * block.steps  # the blocks of a run do not depend on the company
        while self.done < self.steps:
            self._segment(block, forcing, min(most, self.steps - self.done), replayed)
            yield self.done

    def forcing(self, block: Propagator) -> Forcing:
        """What the loads and offsets of the members do to one of the propagators."""
        return self.stepper.forcing(block) if self._alike else block.forcing(self.members)

    def _segment(
        self, block: Propagator, forcing: Forcing, steps: int, replayed: Callable[[Segment], None] | None
    ) -> None:
        first, dt, K = self.done, self.stepper.dt, block.steps
        begun = time.perf_counter()
        starts_at = (first + K * np.arange(-(-steps // K))) * dt
        inflow = block.inflow(starts_at, self.steps * dt)
        rows = len(starts_at) if replayed is not None else 0
        starts = aligned((rows, self.state.z.shape[1]))
        forces = aligned((rows, len(block.block.push)))
        kept = Kept(self.positions, self.velocities, starts, forces)
        cursor, march_rule = np.array([0, 0, self._rows]), block.block.rule
        while not self.stepper.run(
            block.block, self.law, forcing, inflow, self.state, kept, self.events, first, steps, dt, self.every or 1,
            cursor, *(() if march_rule == LINEAR else (1,)),
        ):  # fmt: skip
            longer = max(2 * len(self.events), cursor[2] + 2 * K * max(1, self.law.shape[1]))
            self.events = np.concatenate([self.events, np.empty((longer - len(self.events), EVENT))])
        self._rows = int(cursor[2])
        self.done += steps
        self.seconds += time.perf_counter() - begun
        if replayed is not None:
            replayed(Segment(self, block, first, steps, starts, forces))

    def _force(self) -> Array:
        """Load plus contact force at this time, (members, N)."""
        coordinates, t = self.stepper.coordinates, self.done * self.stepper.dt
        total = np.zeros((len(self.members), coordinates.rows.shape[1]))
        loaded = self.members[:1] if self._alike else self.members
        total[:] = [coordinates.load(member, t) for member in loaded]
        for i, member in enumerate(self.members):
            if self.stepper.contact != "conserving":  # whose reactions are means over a step, not there at a time
                for c, contact in enumerate(member.contacts):
                    force = contact.stops.force(self.state.position[i, c], self.state.velocity[i, c])
                    total[i] += coordinates.columns[c] * force
        return total

    def seen(self, member: int) -> Seen:
        """What a member has seen, at the end."""
        first, last = np.searchsorted(self.events[:, MEMBER], [member, member + 1])
        own = self.events[first:last]
        positions, velocities, tip = self.positions[member], self.velocities[member], self.stepper.system.tip_channel
        ends = initial_channels(self.members[member]), (self.state.position[member], self.state.velocity[member])
        means, contacts = self.stepper.contact == "conserving", []
        for c, contact in enumerate(self.members[member].contacts):
            begin, end = ((float(u[c]), float(v[c])) for u, v in ends)
            tally = with_ends(self.state.tally[member, c], contact.stops, self.stepper.dt, begin, end, means)
            seen = own[own[:, CONTACT] == c]
            contacts.append(record(contact.stops, positions[:, c], velocities[:, c], tally, seen, self.steps))
        diverged = int(self.state.diverged[member])
        if diverged < 0:
            raise unsolved(self.stepper.scheme, -diverged * self.stepper.dt)
        dt = self.stepper.dt
        when = diverged * dt if diverged else overflow(contacts, self.steps * dt)
        return Seen(positions[:, tip].copy(), velocities[:, tip].copy(), tuple(contacts), when)

    def _finish(self) -> None:
        """Put the impacts in order, and leave open those that are."""
        tally, events = self.state.tally, self.events
        open_rows = tally[..., ROW][(tally[..., SIDE] != 0.0) & (tally[..., ROW] >= 0.0)].astype(int)
        events[open_rows[:, None], [IMPACT_PEAK, IMPACT_IMPULSE, END]] = np.nan
        events = events[: self._rows]
        self.events = events[np.lexsort((np.arange(len(events)), events[:, CONTACT], events[:, MEMBER]))]


@dataclass(frozen=True, eq=False)
class Segment:
    """Consecutive steps of the only member of a march, with what they can be made again from."""

    march: March
    block: Propagator
    first: int
    steps: int
    starts: Array  # (B, D): the state at the start of each block
    forces: Array  # (B, N)


def functions(system: System) -> list[object]:
    """What the loads and offsets of a system are made of; vectors count as equal to themselves only."""
    return [*((id(vector), f) for vector, f in system.loads), *(offset for _, offset in system.channels)]


def initial_channels(system: System) -> tuple[Array, Array]:
    """Positions and velocities of the channels at t = 0."""
    velocities = [system.v0 @ row + offset_rate(offset, 0.0) for row, offset in system.channels]
    return system.positions(0.0, system.q0), np.array(velocities)
