"""The leaping march: its cost goes with the changes of regime, not with the steps.

A regime (which contacts are closed) is a linear motion, so that its state any number of steps on is known at
once, see regimes; a bound that holds at every step between shows that no contact opens or closes there, see
kernels.sums. The step in which one does is an ordinary step of the scheme. Impacts, peaks, impulses and outputs
are those of the block march to rounding: nothing is skipped, the sums over leapt steps are in closed form.

It is for implicit contact under the linear law, harmonic and constant loads, and damping that the closed
contacts do not couple; anything else is marched in blocks, as is what changes regime too often to pay.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from threading import Lock

import numpy as np

from ..basics.arrays import Array, aligned
from ..basics.compiled import clock
from ..basics.resources import afford
from ..model.contact_law import G1, G2
from ..model.stage import LINEAR
from ..model.system import System
from ..trajectory.sampling import EVENT, ROW, SIDE
from .block_march import BLOCKS, STEPS_REPLAYED, March, Segment, Stepper, functions
from .kernels import blocks, leaps
from .kernels.blocks import Marchers
from .kernels.sums import Regimes
from .probe import InModes
from .propagator import Propagator, build
from .regimes import EXTENDED, NoRegime, Sum, regime, tables

LEAPS = "modal leaps"
MOST_CONTACTS = 8
SPACING = 4096  # steps, at least, between two states that blocks start from anew: what these stray is of no more
DENSE = 8  # outputs closer than so many steps are made in blocks, from states that the leaps pass through
STATES_AT_ONCE = 1 << 15


def start(stepper: Stepper, members: Sequence[System], steps: int, every: int | None, since: int = 0) -> March:
    """The members at t = 0, ready for ``steps`` steps; one alone goes in leaps where that can pay."""
    kind = LeapMarch if len(members) == 1 and can_leap(stepper, steps) else March
    return kind(stepper, members, steps, every, since)


def can_leap(stepper: Stepper, steps: int) -> bool:
    """True where a run may be leapt over, as far as its arguments say; the march itself finds whether it pays."""
    contacts = stepper.system.contacts
    return bool(
        EXTENDED
        and isinstance(stepper.coordinates, InModes)
        and stepper.contact == "implicit"
        and stepper.rule == LINEAR
        and stepper.run is blocks.run
        and stepper.block.harmonic
        and len(contacts) <= MOST_CONTACTS
        and steps * costs(stepper)[2] > setup(stepper)
    )


def setup(stepper: Stepper) -> float:
    """ns that making the regimes takes, a few times over: below, blocks are done before leaps begin."""
    return 6e6 + 60.0 * stepper.system.size**3


def costs(stepper: Stepper) -> Array:
    """ns of a leap tried, of an ordinary step with the change of regime, and of a step of the block march."""
    (R, D), K = stepper.block.block.reading.shape, stepper.block.steps
    return np.array([600.0 + 1.2 * D, 300.0 + 0.36 * D * D, 2.0 + 0.12 * R * D / K])


@dataclass(eq=False)
class Leaper:
    """The regimes of a march on one system, made as they are met; members on other threads may share them."""

    stepper: Stepper
    system: System
    one: Propagator = field(init=False)  # a single step
    _made: list[Sum] = field(init=False, default_factory=list)
    _of: Array = field(init=False)  # (2^m,), see kernels.leaps.advance
    _tables: dict[tuple[int, int, int], Regimes] = field(init=False, default_factory=dict)
    _lock: Lock = field(init=False, default_factory=Lock)

    def __post_init__(self) -> None:
        stepper = self.stepper
        self.one = build(stepper.scheme, stepper.coordinates, stepper.dt, 1, stepper.contact)
        self._of = np.full(1 << len(self.system.contacts), -1)
        for mask in range(min(2, len(self._of))):  # more than these are not met by all
            self.make(mask)

    def make(self, mask: int) -> None:
        """The regime whose closed contacts are the bits of ``mask``, or the fact that there is none."""
        with self._lock:
            if self._of[mask] != -1:
                return
            try:
                self._made.append(
                    regime(self.one, self.system, [c for c in range(len(self.system.contacts)) if mask >> c & 1])
                )
                self._of[mask] = len(self._made) - 1
            except NoRegime:
                self._of[mask] = -2

    def tables(self, steps: int, every: int, size: float) -> tuple[Regimes, Array] | None:
        """All that have been made, and where each is; None where even free march cannot be leapt over in so many
        steps, see ``Sum.holds``."""
        with self._lock:
            of = self._of.copy()
            for i, made in enumerate(self._made):
                if not made.holds(steps, size):
                    of[of == i] = -2
            if of[0] < 0:
                return None
            given = steps.bit_length(), every, len(self._made)
            if given not in self._tables:
                nodes, D = len(self.stepper.scheme.nodes), self.one.block.reading.shape[1]
                self._tables = {given: tables(self._made, steps, every, nodes, D)}
            return self._tables[given], of


_making = Lock()


def _leaper(stepper: Stepper, member: System) -> Leaper:
    """The regimes of a member: shared where its loads and stiffnesses are the march's own."""
    alike = functions(member) == functions(stepper.system) and all(
        a.stops.stiffness == b.stops.stiffness for a, b in zip(member.contacts, stepper.system.contacts, strict=True)
    )
    if not alike:
        return Leaper(stepper, member)
    with _making:
        if not stepper.leapers:
            stepper.leapers.append(Leaper(stepper, stepper.system))
    return stepper.leapers[0]


@dataclass(eq=False)
class LeapMarch(March):
    """One member on its way in leaps, or in blocks where they turn out not to pay."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.kind = LEAPS

    def _on(self, replayed: Callable[[Segment], None] | None) -> Iterator[int]:
        """From the scheme's own start, see March."""
        start = Marchers(*(x.copy() for x in self.state))
        events, rows, done = self.events.copy(), self._rows, self.done
        dense = self.every is not None and self.every < DENSE
        spacing = max(SPACING, self.steps // STATES_AT_ONCE) if dense or replayed is not None else 0
        states = yield from self._leap(spacing)
        if states is None:  # the same from the start, in blocks
            self.kind = BLOCKS
            seconds = 1e-9 * float(costs(self.stepper)[2]) * self.steps
            afford("dt", self.stepper.dt, "give a larger dt: contact changes too often to leap", seconds=seconds)
            self.state, self.events, self._rows, self.done = start, events, rows, done
            yield from super()._on(replayed)
        elif spacing:
            yield from self._between(start, done, states, spacing, replayed)

    def _leap(self, spacing: int) -> Generator[int, None, Array | None]:
        """Leap to the end; the states at every ``spacing``-th step where that is not 0, None where it does not pay."""
        stepper, system, begun = self.stepper, self.members[0], clock()
        leaper = _leaper(stepper, system)
        one, m, every = leaper.one, len(system.contacts), spacing or self.every or self.steps
        ends = self.law[0, :, [G1, G2]]
        size = float(np.max(np.abs([*ends[np.isfinite(ends)], *self._begun[0][0, :m]]), initial=0.0))
        found = leaper.tables(self.steps, every, size)
        if found is None:
            return None
        states = aligned((self.steps // spacing + 1 if spacing else 0, one.block.reading.shape[1]))
        none = np.zeros((1, 0, self.positions.shape[2]))
        outputs = (none, none) if spacing else (self.positions, self.velocities)
        forcing = stepper.forcing(one) if leaper.system is stepper.system else one.forcing([system])
        side, guess = np.zeros(m), np.full(1 << m, 3)
        cursor, cost = np.array([self.done, self._rows, 0, 0, 0]), costs(stepper)

        def leap(steps: int, found: tuple[Regimes, Array]) -> int:
            return leaps.advance(
                one.block, self.law, forcing, *found, self.state, (*outputs, states), self.events, cursor, side,
                guess, steps, stepper.dt, every, self.since, self.done + max(1 << 16, self.steps // 50), cost,
            )  # fmt: skip

        while True:
            ended = leap(self.steps, found)
            self.done, self._rows = int(cursor[leaps.STEP]), int(cursor[leaps.FREE_ROW])
            if ended == leaps.FULL:
                self.events = np.concatenate([self.events, np.empty((len(self.events) + m, EVENT))])
            elif ended == leaps.UNKNOWN:
                leaper.make(int(np.sum((side != 0.0) << np.arange(m))))
                found = leaper.tables(self.steps, every, size)
                assert found is not None
            elif ended == leaps.PAUSED:
                if not spacing:  # where there is more to come, that is what takes the time
                    yield self.done
            else:
                break
        self.seconds += clock() - begun
        if not spacing and ended != leaps.ABANDONED:
            yield self.done
        return None if ended == leaps.ABANDONED else states

    def _between(
        self, start: Marchers, done: int, states: Array, spacing: int, replayed: Callable[[Segment], None] | None
    ) -> Iterator[int]:
        """The steps between the states, in blocks that start afresh from each of them."""
        stepper, block = self.stepper, self.stepper.block
        beside = March(stepper, self.members, self.steps, self.every)
        beside.state, beside.done = start, done
        beside.positions, beside.velocities = self.positions, self.velocities
        forcing = beside.forcing(block)
        last = self.state.diverged[0] or self.steps
        while beside.done < last:
            if beside.done % spacing == 0 and beside.done > done:
                D = states.shape[1]
                start.z[0, :D] = states[beside.done // spacing]
                block.repeat(start.z)
            beside._rows = 0
            beside.state.tally[..., SIDE] = 0.0
            beside.state.tally[..., ROW] = -1.0
            most = min(last, (beside.done // spacing + 1) * spacing) - beside.done
            beside._segment(block, forcing, min(most, STEPS_REPLAYED), replayed)
            yield beside.done
        self.seconds += beside.seconds
