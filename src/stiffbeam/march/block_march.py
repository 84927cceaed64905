"""The block march: a run in blocks of K steps through one compiled kernel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ..basics.arrays import Array, aligned, copied
from ..basics.resources import afford
from ..kernels import library as kernel
from ..kernels.library import EVENT, LINEAR, TALLY, contact_forces
from ..kernels.library import states as single_steps
from ..model.contact import Law, laws, side_at_start
from ..model.system import System
from ..model.time_functions import evaluate
from ..schemes import Scheme
from ..trajectory.records import ContactRecord, Impacts, Ledger, step_ledger
from ..trajectory.trajectory import SolverFailure
from .propagator import Coordinates, Forcing, Propagator, StepMap, by_diagonals, independent
from .treatment import Treatment, require_giving_way, require_moved

STEPS_PER_CALL = 1 << 16  # between which Python sees an interruption
STEPS_REPLAYED = 1 << 14  # held in memory at once where states, or sampled loads, are wanted
NUMBERS_REPLAYED = 1 << 23  # of their states
LARGEST = 1 << 27  # numbers in the powers of a step and the rows of loads: 1 GiB
LEAST, LONGEST = 32, 256  # force nodes of a block

# A tally (..., 8) is what one contact has seen so far. The steps up to SINCE are passed over; SIDE is followed from the
# start. LAST is |F| at the last step, of laws that are not linear.
SIDE, TOUCHING, PEAK, IMPULSE, ROW, SINCE, LAST = range(7)
# An impact is one row of a list of events; ROW is the row of the one that is open, or -1, and its END is -1 too. A
# contact that is there at t = 0 has a row too, with TIME = AT_START.
CONTACT, TIME, STOP, IMPACT_PEAK, IMPACT_IMPULSE, END = range(6)
AT_START = -1.0


def block_length(coordinates: Coordinates, scheme: Scheme, steps: int) -> int:
    """Steps in a block, a power of two.

    A block of K steps is a product with (R + D) x D numbers, D = k N for the k components that a scheme carries of N
    unknowns, once the powers of one step are made. In modes these are few, and K is bounded by the contact alone: it
    takes longer to find the forces of more nodes than is saved elsewhere.
    """
    nodes = len(scheme.nodes) * max(1, len(coordinates.columns))  # in a step
    if coordinates.basis is not None:
        return 2 ** max(0, int(np.log2(LEAST / nodes)))
    N = coordinates.rows.shape[1]
    D = float(len(independent(scheme, 1.0)[0]) * N)
    # Single steps too take the matrix of one, and the unit states that it is probed with.
    afford("system", f"{N} unknowns", "reduce_model leaves the modes that matter", floats=10.0 * D**2)
    loads = max(1, len(coordinates.system.loads)) * len(scheme.nodes)
    longest = min(np.clip(D / 4, LEAST, LONGEST) / nodes, LARGEST / (loads * D))
    # The doubling to K costs a product of D x D matrices, and saves one of steps/K with D numbers each. In memory a
    # matrix is read at half the speed of that product.
    doublings = min(np.log2(min(longest, 2.0 * steps / D)), LARGEST / D**2 - 2.0)
    return 2 ** max(0, int(doublings))


class Stepper:
    """A scheme on a system in coordinates, in blocks of ``length`` steps: what the members of an ensemble share.

    The propagators of the starter and of the blocks contain the linear part only. Members may differ in initial data,
    in their stops and in the frequencies and amplitudes of their harmonic loads. rule: how nodes find their forces.
    """

    def __init__(
        self, coordinates: Coordinates, scheme: Scheme, dt: float, treatment: Treatment, length: int, rule: int
    ) -> None:
        self.coordinates, self.scheme, self.dt, self.treatment, self.rule = coordinates, scheme, dt, treatment, rule
        self.system = coordinates.system
        self.kind = "dense blocks" if coordinates.basis is None else "modal blocks"  # in ``provenance["march"]``
        self.block = Propagator(scheme, coordinates, dt, length, treatment, rule)
        self.propagators = [self.block]  # in the order of time
        # The starter hands over whole states, so that none of its components is left out.
        if scheme.starter is not None:
            starter = Propagator(scheme.starter, coordinates, dt, 1, treatment, rule, reduced=False)
            self.propagators.insert(0, starter)
        # A force that depends on velocity is unique only where these hold.
        for each in self.propagators:
            if len(each.entries.rates):
                require_giving_way(each.one.scheme, *each.compliances)
        self.own_launch = self.launch(self.system, 0)

    @cached_property
    def single(self) -> StepMap:
        """The single step with whole states, for all that a march passes over."""
        return StepMap(self.scheme, self.coordinates, self.dt, reduced=False)

    def run(self, member: System, steps: int, every: int | None, since: int) -> dict[str, Any]:
        """Fields of the Trajectory of a member, with contacts recorded after step ``since``."""
        march = March(self, member, steps, every, since)
        for _ in march.advance():
            pass
        return march.fields()

    def ledger(self, member: System, steps: int, outputs: Array) -> Ledger:
        """Energy balance of every step of a member at the times ``outputs``."""
        basis = self.coordinates.basis
        return step_ledger(member, self.states(member, steps, modal=basis is not None), outputs, basis=basis)

    def states(self, member: System, steps: int, modal: bool = False) -> Iterator[tuple[Array, Array, Array, Array]]:
        """A run at every step, see ``Pieces``; ``modal``: q and q' in the coordinates of the march.

        A second march keeps the state at the start of each block and the forces in it. With known forces the single
        steps are linear, and are computed from these.
        """
        coordinates, m = self.coordinates, len(member.contacts)
        last = coordinates.start(member.q0, member.v0) if modal else (member.q0, member.v0)
        node = np.full((1, m), np.nan)  # the forces of the last node
        # One room for all parts: pages that are given back and asked for again take as long as the steps.
        room = np.empty(2 * (1 + min(steps, STEPS_REPLAYED)) * len(coordinates.rows.T))
        for propagator, first, count, starts, known in March(self, member, steps, None).advance(replayed=True):
            y, forces = self._single_steps(member, propagator, first, count, starts, known, room)
            if modal:
                (q, v), y[:, 0] = y, last
            else:  # by products of as many rows as there are steps, whose bits do not depend on the threads
                q, v = (np.concatenate([x[None], z]) for x, z in zip(last, coordinates.states(y[:, 1:]), strict=True))
            forces = np.concatenate([node, forces])
            yield (first + np.arange(len(q))) * self.dt, q, v, forces
            last, node = (q[-1].copy(), v[-1].copy()), forces[-1:]

    def _single_steps(
        self, member: System, propagator: Propagator, first: int, steps: int, starts: Array, forces: Array, room: Array
    ) -> tuple[Array, Array]:
        """y (2, 1 + steps, N) at the ends of the steps from step ``first``, behind a row for what is before, and the
        forces (steps, m) that nodes found there, NaN where no node is.

        starts: (B, D + ...), the states at the start of each block; forces: (B, N), those in it.
        """
        one, (B, _), K = self.single if propagator is self.block else propagator.one, starts.shape, propagator.steps
        S, m, n, N = len(one.readers.nodes), len(member.contacts), one.coordinates.parts, one.coordinates.rows.shape[1]
        at_nodes = forces[:, : propagator.nodes].reshape(B * K, S, m)
        # What acts, in the order of a StepMap: the contacts, then the loads, each of them node by node.
        acting = np.zeros((B * K, (m + len(member.loads)) * S))
        acting[:, : m * S] = at_nodes.swapaxes(1, 2).reshape(B * K, m * S)
        times = ((first + np.arange(steps))[:, None] + np.array(one.readers.nodes)) * one.dt
        for i, (_, function) in enumerate(member.loads, start=m):
            acting[:steps, i * S : (i + 1) * S] = evaluate(function, times)
        z, push = propagator.unpack(starts).swapaxes(0, 1).reshape(B, -1), one.push.transpose(2, 1, 0)
        if n > 1:
            push, acting = push.reshape(-1, n * len(one.keep)), acting[:steps]
            y = single_steps(by_diagonals(one.transition), push, acting, z, K, room)
        else:  # one matrix for all unknowns: the blocks side by side
            path = (acting @ push[..., 0]).reshape(B, K, -1)
            for k in range(K):
                path[:, k] += z @ one.transition[0].T
                z = path[:, k]
            y = np.pad(path.reshape(B * K, -1, N)[:steps, :2].swapaxes(0, 1), ((0, 0), (1, 0), (0, 0)))
        # Where no node lies at the end of a step the force there follows from the state.
        between = m and propagator.entries.end_first[0] >= len(propagator.push)
        return y, np.full((steps, m), np.nan) if between else at_nodes[:steps, -1]

    def launch(self, member: System, since: int) -> tuple[dict[str, Array], Array]:
        """Arrays of a Run of a member at t = 0, with contacts recorded after step ``since``; and y in the coordinates.
        A march copies what it changes.

        The list of events begins with a row for each contact that is there, open. Peaks and impulses begin with those
        of the force at t = 0, half of which the trapezoidal rule takes, but of means.
        """
        law, (u, v) = laws(member.contacts), member.motions(0.0, member.q0, member.v0)
        tally = np.zeros((len(law), TALLY))
        tally[:, ROW], tally[:, SINCE] = -1.0, since
        tally[:, SIDE] = side_at_start(u[: len(law)], v[: len(law)], law)
        # A tally that begins later leaves out the contact at t = 0.
        contact = np.flatnonzero(tally[:, SIDE]) if not since else np.zeros(0, int)
        rows = np.zeros((len(contact), EVENT))
        if len(contact):
            size = np.abs(forces_at(u, v, law))[contact]
            rows[:, CONTACT], rows[:, TIME], rows[:, END] = contact, AT_START, -1.0
            rows[:, STOP], rows[:, IMPACT_PEAK] = tally[contact, SIDE], size
            rows[:, IMPACT_IMPULSE] = 0.0 if self.treatment.means else 0.5 * self.dt * size
            tally[contact, PEAK], tally[contact, IMPULSE] = size, rows[:, IMPACT_IMPULSE]
            tally[contact, ROW] = np.arange(len(contact))
        begun = {"law": law, "position": u, "velocity": v, "tally": tally, "events": rows}
        start = self.coordinates.start(member.q0, member.v0)
        begun["z"] = self.packed(self.propagators[0], member, 0.0, [start], begun)
        # Where a force jumps at its stop, every node must yield to it.
        for each in self.propagators if jumping(law) else ():
            require_moved(each.one.scheme, each.compliances[0])
        return begun, start

    def packed(
        self, propagator: Propagator, member: System, t: float, history: list[Array], now: dict[str, Array]
    ) -> Array:
        """The state of the propagator's scheme at time t from the past y, newest first, packed."""
        force = self.coordinates.load(member, t)
        # Of a treatment with means over a step no force is there at a time.
        if not self.treatment.means:
            force = force + forces_at(now["position"], now["velocity"], now["law"]) @ self.coordinates.columns
        return propagator.pack(propagator.one.scheme.initial(self.coordinates.equation, history, force))


# A propagator, the first of the steps, their number, and where wanted the state (B, D + ...) at the start of each block
# and the forces (B, N) in it.
Part = tuple[Propagator, int, int, Array, Array]


class March:
    """A run in progress, of the stepper's system or of another member.

    every: outputs kept, None for none. arrays: those of a Run that last from part to part, see march.h.
    """

    def __init__(self, stepper: Stepper, system: System, steps: int, every: int | None, since: int = 0) -> None:
        self.stepper, self.system, self.steps, self.every, self.done = stepper, system, steps, every, 0
        own, m = system is stepper.system, len(system.contacts)
        # Equal loads and offsets: the response to the drive is computed once for all members.
        self._alike = own or functions(system) == functions(stepper.system)
        begun, self._start = stepper.own_launch if own and not since else stepper.launch(system, since)
        law, rows = begun["law"], begun["events"]
        self.arrays = begun | {name: copied(begun[name]) for name in ("z", "position", "velocity", "tally")}
        u, v, kept = begun["position"], begun["velocity"], 0 if every is None else steps // every + 1
        times, (positions, velocities) = np.empty(kept), np.empty((2, kept, len(u)))
        # Where a force jumps at its stop, the state at the end of a step does not determine it: the nodes' is kept.
        node_forces = np.full((kept if jumping(law) else 0, m), np.nan)
        contact_forces = np.empty((kept if stepper.rule == LINEAR else 0, m))
        if kept:
            positions[0], velocities[0], times[0] = u, v, 0.0
        if len(contact_forces):
            contact_forces[0] = forces_at(u, v, law)
        self.arrays |= {
            "times": times, "positions": positions, "velocities": velocities, "node_forces": node_forces,
            "contact_forces": contact_forces, "diverged": np.zeros(1, np.int64), "cursor": np.array([0, len(rows)]),
            # Room for 64 to 1088 impacts; ``_part`` lengthens the list when it is full.
            "events": np.concatenate([rows, np.empty((64 + min(1024, steps // 16), EVENT))]),
        }  # fmt: skip

    def advance(self, replayed: bool = False) -> Iterator[Part]:
        """March to the end by the parts that are yielded; ``replayed``: with what computes them again."""
        stepper, scheme = self.stepper, self.stepper.scheme
        history = [self._start]
        # A multistep scheme begins with its starter, step by step; the states are its history, newest first.
        for one in stepper.propagators[:-1]:
            forcing = self.forcing(one)
            for _ in range(min(self.steps, scheme.history - 1)):
                yield self._part(one, forcing, 1, replayed)
                history.insert(0, one.unpack(self.arrays["z"])[:2])
        if self.done < self.steps:
            block = stepper.block
            # The scheme's state follows from that history.
            if self.done:
                t = self.done * stepper.dt
                self.arrays["z"] = stepper.packed(block, self.system, t, history, self.arrays)
            forcing = self.forcing(block)
            # States, or sampled loads, of a whole part are held in memory.
            most = STEPS_PER_CALL
            if replayed or not block.harmonic:
                most = min(STEPS_REPLAYED, NUMBERS_REPLAYED // len(self.arrays["z"]))
            most = max(1, most // block.steps) * block.steps
            while self.done < self.steps:
                yield self._part(block, forcing, min(most, self.steps - self.done), replayed)

    def forcing(self, block: Propagator) -> Forcing:
        """Response of one of the propagators to the loads and offsets of the system."""
        return block.own_forcing if self._alike else block.forcing(self.system)

    def _part(self, block: Propagator, forcing: Forcing, steps: int, replayed: bool) -> Part:
        first, dt, K = self.done, self.stepper.dt, block.steps
        starts_at = (first + K * np.arange(-(-steps // K))) * dt
        rows = len(starts_at) if replayed else 0
        starts, forces = aligned((rows, len(self.arrays["z"]))), aligned((rows, len(block.push)))
        others = {"effects": forcing.effects, "starts": starts, "forces": forces}
        others |= block.inflow(starts_at, self.steps * dt)
        # Where the list of impacts is full, the kernel returns False and goes on from ``cursor`` at the next call.
        while not kernel.run(block.c, forcing.c, self.arrays | others, first, steps, self.every or 1, dt):
            # Doubling keeps the number of copies small.
            events, used = self.arrays["events"], int(self.arrays["cursor"][1])
            longer = max(2 * len(events), used + 2 * K * max(1, len(self.system.contacts)))
            self.arrays["events"] = np.concatenate([events, np.empty((longer - len(events), EVENT))])
        self.done += steps
        return block, first, steps, starts, forces

    def fields(self) -> dict[str, Any]:
        """Fields of the Trajectory, at the end: outputs, contacts, and when it overflowed."""
        kept, tip, dt = self.arrays, self.stepper.system.tip_channel, self.stepper.dt
        diverged = int(kept["diverged"][0])
        # A negative step: the search for the forces of several contacts failed there.
        if diverged < 0:
            reason, remedy = "the forces of several contacts at once were not found", "use a smaller dt, or cvode"
            raise SolverFailure(str(self.stepper.scheme), -diverged * dt, reason, remedy)
        contacts = tuple(self._record(c, tally) for c, tally in enumerate(kept["tally"]))
        u, v = (np.ascontiguousarray(kept[name][:, tip]) for name in ("positions", "velocities"))
        when = diverged * dt if diverged else overflow(contacts, self.steps * dt)
        return {"t": kept["times"], "tip": u, "tip_velocity": v, "contacts": contacts, "diverged": when}

    def _record(self, c: int, tally: Array) -> ContactRecord:
        """The record of contact c with its tally."""
        kept, stops = self.arrays, self.system.contacts[c].stops
        position, velocity = kept["positions"][:, c], kept["velocities"][:, c]
        if len(kept["contact_forces"]):
            force = kept["contact_forces"][:, c]
        else:
            with np.errstate(over="ignore", invalid="ignore"):  # of which ``overflow`` tells
                force = stops.force(position, velocity)
        # A force that jumps does not follow from the state: the node's counts where there is one.
        if stops.law.jumps:
            at_nodes = kept["node_forces"][:, c]
            force = np.where(np.isnan(at_nodes), force, at_nodes)
        # The kernel wrote the rows of one contact in order of time.
        rows = kept["events"][: kept["cursor"][1]]
        times, sides, peaks, impulses, ends = rows[rows[:, CONTACT] == c, TIME : END + 1].T.copy()
        still = ends < 0.0  # open, without peak, impulse or end
        peaks[still] = impulses[still] = ends[still] = np.nan
        impacts = Impacts.at(times, sides, "sampled", ends=ends, peaks=peaks, impulses=impulses)
        impacts = impacts.started(times == AT_START)
        side, touching, peak, impulse, _, since, last, _ = tally.tolist()
        # The trapezoidal rule takes half of the force at the last step. A tally that begins later stays, as do means.
        if side and not since and not self.stepper.treatment.means:
            at_end = forces_at(kept["position"], kept["velocity"], kept["law"])[c]
            impulse -= 0.5 * self.stepper.dt * (last if stops.law.jumps else abs(float(at_end)))
        fraction = touching / max(1.0, self.steps - since)  # of the steps that it counts
        return ContactRecord(stops, position, velocity, force, impacts, fraction, peak, impulse)


def forces_at(u: Array, v: Array, law: Array) -> Array:
    """F (m,) on the bodies at positions and velocities (C,), the contacts first, under laws (m, 6)."""
    return contact_forces(u[: len(law)], v[: len(law)], law)


def overflow(contacts: Sequence[ContactRecord], t_end: float) -> float:
    """Time at which a force overflowed although no position did: the first impact whose impulse is beyond float64, at
    the latest t_end. NaN if none did."""
    if all(np.isfinite(contact.impulse) for contact in contacts):
        return float("nan")
    return min((float(t) for c in contacts for t in c.impacts.times[np.isinf(c.impacts.impulses)]), default=t_end)


def jumping(law: Array) -> bool:
    """Return True where the force of a stop jumps; law (m, 6)."""
    return bool(np.any(Law(*law.T).jumps))


def functions(system: System) -> list[object]:
    """Loads and offsets of a system; vectors count as equal to themselves only."""
    return [*((id(vector), f) for vector, f in system.loads), *(offset for _, offset in system.channels)]
