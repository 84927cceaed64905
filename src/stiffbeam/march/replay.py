"""States at every step of a block march, computed on demand.

A second march keeps the state at the start of each block and the forces in it. With known forces the single steps are
linear, and are computed from these.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..basics.arrays import Array
from ..kernels.march import states
from ..model.system import System
from ..model.time_functions import evaluate
from .block_march import March, Segment, Stepper
from .probe import StepMap
from .propagator import by_diagonals


def replay(
    stepper: Stepper, system: System, steps: int, modal: bool = False
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """A run at every step, see ``Pieces``; ``modal``: q and q' in the coordinates of the march."""
    coordinates, m = stepper.coordinates, len(system.contacts)
    last = coordinates.start(system.q0, system.v0) if modal else (system.q0, system.v0)
    node = np.full((1, m), np.nan)  # the forces of the last node
    for segment in March(stepper, system, steps, None).advance(replayed=True):
        of_starter = segment.block is stepper.starter
        y, forces = _motion(segment, segment.block.one if of_starter else stepper.single, system)
        if modal:
            (q, v), y[:, 0] = y, last
        else:  # by products of as many rows as there are steps, whose bits do not depend on the threads
            q, v = (np.concatenate([x[None], z]) for x, z in zip(last, coordinates.states(y[:, 1:]), strict=True))
        forces = np.concatenate([node, forces])
        yield (segment.first + np.arange(len(q))) * stepper.dt, q, v, forces
        last, node = (q[-1].copy(), v[-1].copy()), forces[-1:]


def _motion(segment: Segment, one: StepMap, system: System) -> tuple[Array, Array]:
    """y (2, 1 + steps, N) at the ends of a segment's steps, behind a row for what is before, and the forces (steps, m)
    that nodes found there, NaN where no node is; ``one``: the scheme's single step."""
    block, steps, (B, _), K = segment.block, segment.steps, segment.starts.shape, segment.block.steps
    S, m, n, N = len(one.readers.nodes), len(system.contacts), one.coordinates.parts, one.coordinates.rows.shape[1]
    at_nodes = segment.forces[:, : block.block.nodes].reshape(B * K, S, m)
    # What acts, in the order of a StepMap: the contacts, then the loads, each of them node by node.
    acting = np.zeros((B * K, (m + len(system.loads)) * S))
    acting[:, : m * S] = at_nodes.swapaxes(1, 2).reshape(B * K, m * S)
    times = ((segment.first + np.arange(steps))[:, None] + np.array(one.readers.nodes)) * one.dt
    for i, (_, function) in enumerate(system.loads, start=m):
        acting[:steps, i * S : (i + 1) * S] = evaluate(function, times)
    starts, push = block.unpack(segment.starts).swapaxes(0, 1).reshape(B, -1), one.push.transpose(2, 1, 0)
    if n > 1:
        y = states(by_diagonals(one.transition), push.reshape(-1, n * len(one.keep)), acting[:steps], starts, K)
    else:  # one matrix for all unknowns: the blocks side by side
        path, z = (acting @ push[..., 0]).reshape(B, K, -1), starts
        for k in range(K):
            path[:, k] += z @ one.transition[0].T
            z = path[:, k]
        y = np.pad(path.reshape(B * K, -1, N)[:steps, :2].swapaxes(0, 1), ((0, 0), (1, 0), (0, 0)))
    # Where no node lies at the end of a step the force there follows from the state.
    between = m and block.block.end_first[0] >= len(block.block.push)
    return y, np.full((steps, m), np.nan) if between else at_nodes[:steps, -1]
