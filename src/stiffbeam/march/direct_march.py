"""The direct march: any scheme on any System or FirstOrderSystem, with factorised matrices."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import clock
from ..model.contact import laws
from ..model.equations import FirstOrderSystem
from ..model.stage import BY_LAW, LINEAR, MEAN, solve_several, solve_stage
from ..model.system import System
from ..model.time_functions import offset_rate, offset_values
from ..schemes import Scheme
from .block_march import initial_channels
from .choice import require_giving_way, require_moved, rule_of, unsolved
from .probe import Together, ends_there

STEPS_PER_PIECE = 4096


@dataclass(frozen=True, eq=False)
class Piece:
    """Consecutive steps first + 1 .. first + k of a run. Valid until the next piece is made."""

    first: int
    positions: Array  # (k, channels) at the ends of the steps
    velocities: Array  # (k, channels)
    states: Callable[[], tuple[Array, Array]]  # q, q' at the ends of the steps, each (k, n)
    seconds: float
    means: Array | None = None  # (k, contacts): the reactions, where they are means over the steps
    node_forces: Array | None = None  # (k, contacts): those that nodes found at the ends of steps, see force_of_node


def direct_pieces(
    system: System | FirstOrderSystem, scheme: Scheme, dt: float, steps: int, contact: str
) -> Iterator[Piece]:
    """Pieces of a run step by step, with the scheme's own ``step`` on matrices. Contact by superposition.

    A step is linear in the contact forces. It is first computed without them. The forces are then found node by node
    from the positions and the compliances, and their responses are added.
    """
    view = Together.of(system)
    history, done = [view.start(view.system.q0, view.system.v0)], 0
    # A multistep scheme begins with its starter, whose states are its history, newest first.
    if scheme.starter is not None:
        done = min(steps, scheme.history - 1)
        march = _March(view, scheme.starter, dt, contact, history, 0)
        for step in range(done):
            piece = march.piece(step, 1)
            history.insert(0, march.z[: view.equation.order])
            yield piece
    if done < steps:
        march = _March(view, scheme, dt, contact, history, done)
        length = STEPS_PER_PIECE // 4
        for step in range(done, steps, length):
            yield march.piece(step, min(length, steps - step))


class _March:
    """A one-step or multistep scheme on its way: the state ``z`` after the last step, and how a step answers forces."""

    def __init__(
        self, view: Together, scheme: Scheme, dt: float, contact: str, history: list[Array], first: int
    ) -> None:
        system = view.system
        self.view, self.scheme, self.dt, self.contact, self.equation = view, scheme, dt, contact, view.equation
        self.stops = [c.stops for c in system.contacts]
        self.rule, self.law = rule_of(system.contacts, contact), laws(system.contacts)
        self.contact_rows = view.rows[: len(self.stops)]
        self.offsets = [offset for _, offset in system.channels]
        self._begin(history, first)
        self._respond()

    def _begin(self, history: list[Array], first: int) -> None:
        """The state after step ``first``, from the states so far, newest first, and the forces there."""
        view, t0 = self.view, np.asarray(first * self.dt)
        if first:
            # After the starter the contacts follow from the computed state.
            shift, rate = (np.array([of(o, t0) for o in self.offsets]) for of in (offset_values, offset_rate))
            at_start = view.rows @ history[0][0] + shift
            moving = view.rows @ self.equation.velocity(history[0]) + rate
        else:  # as given: on a stop, rounding would tell the side
            own = view.system if isinstance(view.system, System) else view.system.system
            at_start, moving = (x[0] for x in initial_channels([own], own.q0[None], own.v0[None]))
        force = view.load(view.system, t0)
        if self.rule != MEAN:  # whose reactions are means over a step, not there at a time
            pressing = zip(self.stops, at_start, moving, view.columns, strict=False)
            force = force + sum(stop.force(x, v) * column for stop, x, v, column in pressing)
        self.z = self.scheme.initial(self.equation, history, force)
        # Positions at the node before: the mean rule takes the force between both ends of the step.
        self._before = at_start[: len(self.stops)].copy()

    def _respond(self) -> None:
        """The responses of a step to a unit force on each row at each node, which superposition needs."""
        S, R, equation = len(self.scheme.nodes), len(self.stops), self.equation
        zero, none = np.zeros_like(self.z), self._unloaded()
        self.of_state = np.empty((S, R, *zero.shape))
        self.of_position = np.zeros((S, R, S, R))  # [node, row] of the force, [node, row] of the position
        self.of_velocity = np.zeros((S, R, S, R))
        self.ends_at_node = True
        for s in range(S):
            for c in range(R):
                reactions = list(none)
                reactions[s] = self.view.columns[c]
                self.of_state[s, c], stages = self.scheme.step(equation, self.dt, zero, none, reactions)
                self.ends_at_node = self.ends_at_node and ends_there(stages[-1][0], self.of_state[s, c][0])
                # Predicted positions do not depend on the forces of their step: their responses stay zero.
                if self.contact != "extrapolated":
                    self.of_position[s, c] = np.array([y[0] for y in stages]) @ self.contact_rows.T
                    velocities = np.array([equation.velocity(y) for y in stages])
                    self.of_velocity[s, c] = velocities @ self.contact_rows.T
        # A force that depends on velocity is unique only where these hold.
        if self.rule == BY_LAW:
            compliances = [np.array([x[s, :, s].T for s in range(S)]) for x in (self.of_position, self.of_velocity)]
            require_giving_way(self.scheme, *compliances)
            if any(stop.jumps for stop in self.stops):
                require_moved(self.scheme, np.array([self.of_position[s, :, s] for s in range(S)]))

    def _unloaded(self) -> list[Array]:
        return [np.zeros_like(self.z[0])] * len(self.scheme.nodes)

    def piece(self, start: int, count: int) -> Piece:
        """The steps start + 1 .. start + count."""
        begun = clock()
        view, nodes, m = self.view, self.scheme.nodes, len(self.stops)
        # Loads and moving stops at the nodes of all these steps at once.
        times = (start + np.arange(count))[:, None] * self.dt + np.array(nodes) * self.dt
        loads = view.load(view.system, times)
        shifts = np.zeros((2, count, len(nodes), m))
        for c, offset in enumerate(self.offsets[:m]):
            shifts[0, ..., c] = offset_values(offset, times)
            if self.rule == BY_LAW:
                shifts[1, ..., c] = offset_rate(offset, times)
        path, node_forces, none = np.empty((count, *self.z.shape)), np.zeros((count, m)), self._unloaded()
        for k in range(count):
            # The step without contact forces, then the forces node by node, each with its response.
            predicted = self.scheme.predict(self.equation, self.dt, self.z) if self.contact == "extrapolated" else None
            self.z, stages = self.scheme.step(self.equation, self.dt, self.z, list(loads[k]), none)
            if m:
                node_forces[k] = self._press(stages, predicted, shifts[:, k], times[k])
            path[k] = self.z
        seconds = clock() - begun
        # Positions and velocities of all channels at the ends of the steps.
        y = path[:, : self.equation.order]
        ends = (start + 1 + np.arange(count)) * self.dt
        moves = zip(view.rows, self.offsets, strict=True)
        positions = np.stack([y[:, 0] @ row + offset_values(o, ends) for row, o in moves], axis=-1)
        velocities = self.equation.velocity(np.moveaxis(y, 1, 0)) @ view.rows.T
        velocities = velocities + np.stack([offset_rate(o, ends) for o in self.offsets], axis=-1)
        return Piece(
            start,
            positions,
            velocities,
            lambda: view.states(np.moveaxis(y, 1, 0)),
            seconds,
            # Means over the steps, or forces at the last node where that is the end of the step.
            node_forces if self.rule == MEAN else None,
            node_forces if self.rule == BY_LAW and self.ends_at_node else None,
        )

    def _press(self, stages: list[Array], predicted: list[Array] | None, shifts: Array, times: Array) -> Array:
        """Forces of the contacts at the last node, after the forces at all nodes have moved ``z``; ``stages`` are those
        of the step without contact forces, shifts (2, nodes, rows) those of the stops, and their rates."""
        x = np.array(predicted or [y[0] for y in stages]) @ self.contact_rows.T + shifts[0]
        v = np.zeros_like(x)
        if self.rule == BY_LAW:
            moved = np.array([self.equation.velocity(y) for y in stages]) @ self.contact_rows.T + shifts[1]
            v = moved
        forces = np.zeros(len(self.stops))
        for s in range(len(x)):
            forces = self._solved(s, x[s], v[s])
            # An overflow makes the position NaN too, and is reported by the caller.
            if np.any(np.isnan(forces)) and not np.any(np.isnan(x[s])):
                raise unsolved(self.scheme, float(times[s]))
            # A force moves its node and all later ones, and the state at the end.
            if np.any(forces):
                x = x + np.tensordot(forces, self.of_position[s], 1)
                if self.rule == BY_LAW:
                    v = v + np.tensordot(forces, self.of_velocity[s], 1)
                self.z = self.z + np.tensordot(forces, self.of_state[s], 1)
        self._before = x[-1].copy()
        return forces

    def _solved(self, s: int, x: Array, v: Array) -> Array:
        """Forces (m,) of the contacts at node ``s``, where without them the contacts move by x and v, (m,)."""
        compliance = self.of_position[s, :, s].T
        if self.rule != LINEAR:
            r, S_r, S_v = (np.ascontiguousarray(part) for part in (x, compliance, self.of_velocity[s, :, s].T))
            return solve_stage(r, v.copy(), S_r, S_v, self._before, self.rule, self.law)
        if len(self.stops) == 1:
            return self.stops[0].solve(x, compliance[0, 0])
        return solve_several(x, compliance, self.stops)
