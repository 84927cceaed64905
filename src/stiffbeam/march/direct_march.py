"""The direct march: any scheme on any System or FirstOrderSystem, with factorised matrices."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import clock
from ..model.contact import laws, polar
from ..model.equations import FirstOrderSystem
from ..model.stage import AVERAGED, BY_LAW, LINEAR, MEAN, RATED, solve_several, solve_stage, solve_turning, turned
from ..model.system import System
from ..model.time_functions import offset_rate, offset_values
from ..schemes import Scheme
from .block_march import initial_channels
from .choice import require_averages, require_giving_way, require_moved, rule_of, unsolved
from .probe import Together, ends_there

STEPS_PER_PIECE = 4096
MINUTES = 60.0  # seconds from which on it is worth a warning


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
    starter = scheme.starter
    # A multistep scheme begins with its starter, whose states are its history, newest first.
    if starter is not None:
        count = min(steps, scheme.history - 1)
        for piece, z in _direct_blocks(view, starter, dt, history, 0, count, contact, 1):
            history.insert(0, z[: view.equation.order])
            done += 1
            yield piece
    if done < steps:
        for piece, _ in _direct_blocks(view, scheme, dt, history, done, steps - done, contact, STEPS_PER_PIECE // 4):
            yield piece


def _direct_blocks(
    view: Together, scheme: Scheme, dt: float, history: list[Array], first: int, steps: int, contact: str, length: int
) -> Iterator[tuple[Piece, Array]]:
    equation, system, order = view.equation, view.system, view.equation.order
    nodes, stops = scheme.nodes, [c.stops for c in system.contacts]
    S, m, holes = len(nodes), len(stops), [c for c, each in enumerate(system.contacts) if each.radial]
    # Rows of the contacts, two of a hole; ``heads`` is the first row of each channel.
    owners = np.repeat(np.arange(m), [len(c.rows) for c in system.contacts])
    R = len(owners)
    heads = [*np.searchsorted(owners, np.arange(m)), *range(R, len(view.rows))]
    rule, law = rule_of(system.contacts, contact), laws(system.contacts)
    way = 0.5 * dt if rule == AVERAGED else 1.0  # see Block
    offsets = [offset for row, offset in system.channels for _ in np.atleast_2d(row)]
    t0 = np.asarray(first * dt)
    if first:
        # After the starter the contacts follow from the computed state.
        shift, rate = (np.array([of(o, t0) for o in offsets]) for of in (offset_values, offset_rate))
        at_start, moving = view.rows @ history[0][0] + shift, view.rows @ equation.velocity(history[0]) + rate
        at_start, moving = _of_channels(at_start, moving, heads, holes)
    else:  # as given: on a stop, rounding would tell the side
        own = system if isinstance(system, System) else system.system
        at_start, moving = (x[0] for x in initial_channels([own], own.q0[None], own.v0[None]))
    force = view.load(system, t0)
    if rule != MEAN:  # whose reactions are means over a step, not there at a time
        columns = turned(view.rows[:R] @ history[0][0], owners).T @ view.columns if holes else view.columns
        force = force + sum(
            s.force(x, v) * column for s, x, v, column in zip(stops, at_start, moving, columns, strict=False)
        )
    z = scheme.initial(equation, history, force)

    # Responses to a unit force of contact c at node s: state and contact positions at the nodes.
    zero = np.zeros_like(z)
    none = [np.zeros_like(history[0][0])] * S
    response_z = np.empty((S, R, *z.shape))
    response = np.zeros((S, R, S, R))  # [node, row] of the force, [node, row] of the position
    rates = np.zeros((S, R, S, R))  # and of the velocity
    ends_at_node = True
    for s in range(S):
        for c in range(R):
            reactions = list(none)
            reactions[s] = view.columns[c]
            response_z[s, c], stages = scheme.step(equation, dt, zero, none, reactions)
            ends_at_node = ends_at_node and ends_there(stages[-1][0], response_z[s, c][0])
            # Predicted positions do not depend on the forces of their step: their responses stay zero.
            if contact != "extrapolated":
                response[s, c] = np.array([y[0] for y in stages]) @ view.rows[:R].T
                rates[s, c] = way * np.array([equation.velocity(y) for y in stages]) @ view.rows[:R].T
    # A force that depends on velocity is unique only where these hold.
    if rule in RATED:
        compliances = [np.array([x[s, :, s].T for s in range(S)]) for x in (response, rates)]
        require_giving_way(scheme, *compliances)
        if rule == AVERAGED:
            require_averages(scheme, *compliances)
        if any(stop.jumps for stop in stops):
            require_moved(scheme, np.array([response[s, :, s] for s in range(S)]))
    # Positions at the node before: the mean rule takes the force between both ends of the step.
    before = at_start[:m].copy()

    for start in range(first, first + steps, length):
        begun = clock()
        # Loads and moving stops at the nodes of all these steps at once.
        count = min(length, first + steps - start)
        times = (start + np.arange(count))[:, None] * dt + np.array(nodes) * dt
        loads = view.load(system, times)
        shifts = np.stack([offset_values(o, times) for o in offsets[:R]], axis=-1) if m else np.zeros((count, S, 0))
        shift_rates = (
            np.stack([offset_rate(o, times) for o in offsets[:R]], axis=-1) if rule in RATED else np.zeros_like(shifts)
        )
        path, node_forces = np.empty((count, *z.shape)), np.zeros((count, m))
        for k in range(count):
            # The step without contact forces, then the forces node by node, each with its response.
            predicted = scheme.predict(equation, dt, z) if contact == "extrapolated" else None
            z, stages = scheme.step(equation, dt, z, list(loads[k]), none)
            if m:
                arguments = np.array(predicted or [y[0] for y in stages]) @ view.rows[:R].T + shifts[k]
                speeds = np.zeros((S, R))
                if rule in RATED:
                    moved = np.array([equation.velocity(y) for y in stages]) @ view.rows[:R].T + shift_rates[k]
                    speeds = way * moved
                for s in range(S):
                    if rule != LINEAR:
                        own = (arguments[s], response[s, :, s].T, rates[s, :, s].T)
                        r, S_r, S_v = (np.ascontiguousarray(x) for x in own)
                        if holes:
                            f, F = solve_turning(r, speeds[s], S_r, S_v, law, owners)
                        else:
                            F = f = solve_stage(r, speeds[s].copy(), S_r, S_v, before, rule, law)
                        # An overflow makes r NaN too, and is reported by the caller.
                        if np.any(np.isnan(f)) and not np.any(np.isnan(r)):
                            raise unsolved(scheme, float(times[k, s]))
                    elif m == 1:
                        F = f = stops[0].solve(arguments[s], response[s, 0, s, 0])
                    else:
                        F = f = solve_several(arguments[s], response[s, :, s].T, stops)
                    node_forces[k] = f
                    # A force moves its node and all later ones, and the state at the end.
                    if np.any(f):
                        arguments = arguments + np.tensordot(F, response[s], 1)
                        if rule in RATED:
                            speeds = speeds + np.tensordot(F, rates[s], 1)
                        z = z + np.tensordot(F, response_z[s], 1)
                before = arguments[-1].copy()
            path[k] = z
        seconds = clock() - begun
        left = seconds * (first + steps - start - count) / count
        if holes and start == first and length > 1 and left >= MINUTES:
            advice = "flat stops, such as a polygon of them, take a fraction of it"
            warnings.warn(f"the march with a round hole will take about {left:.0f} s more: {advice}", stacklevel=2)
        # Positions and velocities of all channels at the ends of the steps.
        y = path[:, :order]
        ends = (start + 1 + np.arange(count)) * dt
        positions = np.stack(
            [y[:, 0] @ row + offset_values(o, ends) for row, o in zip(view.rows, offsets, strict=True)], axis=-1
        )

        velocities = equation.velocity(np.moveaxis(y, 1, 0)) @ view.rows.T
        velocities = velocities + np.stack([offset_rate(o, ends) for o in offsets], axis=-1)
        positions, velocities = _of_channels(positions, velocities, heads, holes)
        yield (
            Piece(
                start,
                positions,
                velocities,
                lambda y=y: view.states(np.moveaxis(y, 1, 0)),
                seconds,
                # Means over the steps, or forces at the last node where that is the end of the step.
                node_forces if rule == MEAN else None,
                node_forces if rule == BY_LAW and ends_at_node else None,
            ),
            z,
        )


def _of_channels(x: Array, v: Array, heads: list[int], holes: list[int]) -> tuple[Array, Array]:
    """Positions and velocities of the channels (..., C) from those of the rows (..., R)."""
    if not holes:
        return x, v
    u, rate = x[..., heads], v[..., heads]
    for c in holes:
        both = slice(heads[c], heads[c] + 2)
        u[..., c], rate[..., c] = polar(x[..., both], v[..., both])
    return u, rate
