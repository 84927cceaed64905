"""The march in blocks, the states that it passes, the steps on rigid stops, and contacts: march.h.

Every array is checked here: one of another type, shape or order raises TypeError.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..basics.arrays import Array, IntArray, aligned, padded
from .library import Structure, address, filled, library

LINEAR, BY_LAW, MEAN = range(3)  # how a node finds its force: of springs, any law, or its mean over the step
LAW, TALLY, EVENT = 6, 8, 6  # numbers of a law, a tally and an impact
OVERFLOW = 1e100  # A position beyond this ends the run. Its square, in an energy, is still a float64.
AT_A_STOP, WHERE_PREDICTED, WHERE_CLOSED = range(3)  # when a node can press; the first in a position, else a velocity

_Block = Structure(
    "R D N a n C K nodes rule rated",
    "",
    "reading: D R; transition: a D; push: N width; end_first int: C; end_stride int: C; rates? int: N",
)
_Drive = Structure("F", "constant", "frequencies: F; rows: d width")
_Run = Structure(
    "m W first steps every outputs room inflows",
    "dt",
    f"law: m {LAW}; effects: C K W; inflow?: inflows width; inflow_velocity?: inflows C K; z: state; "
    f"position: C; velocity: C; tally: m {TALLY}; diverged int: 1; times?: outputs; positions?: outputs C; "
    "velocities?: outputs C; "
    "node_forces?: outputs m; contact_forces?: outputs m; starts?: blocks state; forces?: blocks N; "
    f"events: room {EVENT}; cursor int: 2",
)
_Rigid = Structure(
    "a n D S m K",
    "",
    "blocks?: a a n; matrix?: D D; reading: S m D; predicting: m D; responses: S m D; compliance: S S m m; "
    "kinds int: S; bounds: S m 2; stops: m 2; driven: K D; shifts: K S m; predicted: K m; z: D; path: K D; "
    "reactions: K S m",
)


@dataclass(frozen=True, eq=False)
class Block:
    """K steps as one linear map, see Propagator.

    N force nodes, rounded up to a multiple of eight by rows of zeros; R entries, the nodes first; D = a n numbers of
    the state, a components of n modes; C channels. A row of R + D numbers acts on the entries and on the new state
    together. A state is held as z (D + (a - 1) n,), component by component and from the start again, so that z[e n + d]
    is what is e components after z[d].
    """

    reading: Array  # (D, R)
    transition: Array  # (a, D): z_new[d] = sum_e transition[e, d] z[e n + d]
    push: Array  # (N, R + D)
    velocity: Array  # (C, K, D): the channels' velocities at the ends of the steps
    velocity_push: Array  # (C, K, N)
    end_first: IntArray  # (C,): the entry that holds a channel at the end of the first step,
    end_stride: IntArray  # (C,): and how many entries later the next one is
    rates: IntArray  # (N,): the entry that holds the velocity at a node; none where no force depends on it
    nodes: int  # forces that there are: K times nodes of a step times contacts
    rule: int  # how a node finds its force: LINEAR, BY_LAW or MEAN

    def compliance(self, contacts: int) -> Array:
        """(nodes, m): of the force in every row the effect on the contacts at its own node."""
        node = np.arange(self.nodes)
        return self.push[node[:, None], (node - node % max(1, contacts))[:, None] + np.arange(contacts)]

    @cached_property
    def c(self) -> Any:
        """The block for C."""
        (D, R), a, (C, K, _) = self.reading.shape, len(self.transition), self.velocity.shape
        sizes = {"R": R, "D": D, "a": a, "n": D // a, "C": C, "K": K, "width": R + D, "nodes": self.nodes}
        return _Block(vars(self), **sizes, rule=self.rule, rated=len(self.rates) > 0)


@dataclass(frozen=True, eq=False)
class Forcing:
    """Response of a block to the drive g = (1, sin w1 t, cos w1 t, ...) at its start."""

    constant: float  # 1, or 0 where nothing is constant in time
    frequencies: Array  # (F,)
    rows: Array  # (d, R + D)
    velocity: Array  # (C, K, d)

    @cached_property
    def c(self) -> Any:
        """The drive for C."""
        return _Drive(vars(self), constant=self.constant, d=1 + 2 * len(self.frequencies))


class Inflow(NamedTuple):
    """Share of sampled loads and offsets in the blocks of a range of steps; no rows without any."""

    inflow: Array  # (B, R + D)
    inflow_velocity: Array  # (B, C, K)


class Progress(NamedTuple):
    """State of a run and its contact statistics. Updated in place."""

    law: Array  # (m, 6), the laws of every contact, see contact.Law
    z: Array  # (D + (a - 1) n,)
    position: Array  # (C,) at the last step
    velocity: Array  # (C,)
    tally: Array  # (m, 8), see recorder
    diverged: IntArray  # (1,): the step that overflowed, minus that whose forces were not found, 0 for none


class Kept(NamedTuple):
    """Output buffers for a range of steps. An empty array disables that output."""

    times: Array  # (outputs,)
    positions: Array  # (outputs, C) at every ``every``-th step
    velocities: Array  # (outputs, C)
    node_forces: Array  # (outputs, m): the forces that nodes found, NaN where the end of a step is no node
    contact_forces: Array  # (outputs, m): the forces of linear stops
    starts: Array  # (B, D + (a - 1) n): the state at the start of each block
    forces: Array  # (B, N)
    events: Array  # (rows, 6): the list of impacts, see recorder
    cursor: IntArray  # (2,): block, free row of events, advanced in place


class Span(NamedTuple):
    """A range of steps, and every how many of the run there is an output."""

    first: int
    steps: int
    every: int
    dt: float


def run(block: Block, forcing: Forcing, inflow: Inflow, progress: Progress, kept: Kept, span: Span) -> bool:
    """Compute a range of steps. Returns True if all are done; where the list of impacts may not hold another block's,
    False is returned and the call can be made again with a longer one."""
    c, drive, m, B = block.c, forcing.c, len(progress.law), len(inflow.inflow)
    outputs, blocks, width = len(kept.positions), -(-span.steps // c.K), c.R + c.D
    if (
        B not in (0, blocks)
        or 0 < outputs <= (span.first + span.steps) // span.every
        or min(span.first, span.steps) < 0
    ):
        raise ValueError("sampled loads or outputs do not fit the steps")
    if (
        c.nodes % max(1, c.K * m)
        or forcing.velocity.shape != (c.C, c.K, 1 + 2 * drive.F)
        or forcing.rows.shape[1] != width
    ):
        raise ValueError("contacts or drives do not fit the block")
    # Of what a block begins with, in a multiple of 8 numbers, and of its forces.
    start = np.concatenate([block.velocity, forcing.velocity], axis=2)
    effects = aligned((c.C, c.K, padded(start.shape[2]) + c.N))
    effects[..., : start.shape[2]], effects[..., effects.shape[2] - c.N :] = start, block.velocity_push
    x = _Run(
        {"effects": effects} | inflow._asdict() | progress._asdict() | kept._asdict(), **span._asdict(), blocks=blocks,
        width=width, C=c.C, K=c.K, N=c.N, state=c.D + (c.a - 1) * c.n,
    )  # fmt: skip
    return bool(filled(library().march(c, drive, x)))


def switch_time(u0: float, v0: float, u1: float, v1: float, side: float, law: Array, dt: float) -> float:
    """Fraction of the step, 0 to 1, at which contact with the stop on ``side`` begins or ends, from positions and
    velocities at both ends; law (6,).

    That is where the cubic Hermite interpolant crosses the stop. At a damped stop that is penetrated, or held on to
    rounding, contact ends, and begins again, where the force changes sign.
    """
    return library().switch_time(u0, v0, u1, v1, side, address(law, (LAW,)), dt)


def states(transition: Array, push: Array, forces: Array, starts: Array, K: int) -> Array:
    """q and q' (2, 1 + steps, n) at the ends of single steps under known forces, every K steps from one of the starts.
    The first row, before the steps, is zero.

    transition: (a, a n), see Block; push: (F, a n); forces: (steps, F); starts: (B, a n).
    """
    (a, D), (steps, F), B = transition.shape, forces.shape, -(-len(forces) // K)
    out, z, n = np.empty((2, 1 + steps, D // a)), np.empty((3, D)), D // a
    out[:, 0] = 0.0
    arrays = (transition, (a, a * n)), (push, (F, D)), (forces, (steps, F)), (starts, (B, D))
    at = (address(x, shape) for x, shape in (*arrays, (z, z.shape), (out, out.shape)))
    library().states(a, n, F, steps, K, *at)
    return out


class Linear(NamedTuple):
    """A step on states of D numbers, with S nodes and m contacts."""

    blocks: Array  # (a, a, n) where every mode steps by itself, else no rows
    matrix: Array  # (D, D) where they do not
    reading: Array  # (S, m, D): the argument of each node from the old state
    predicting: Array  # (m, D)
    responses: Array  # (S, m, D): of the new state to unit reactions
    compliance: Array  # (S, S, m, m): [node of the reaction, node of the argument, reaction, argument]
    kinds: IntArray  # (S,): AT_A_STOP, WHERE_PREDICTED or WHERE_CLOSED
    bounds: Array  # (S, m, 2): where the stops stand in the arguments
    stops: Array  # (m, 2), in positions


def rigid_steps(linear: Linear, driven: Array, shifts: Array, predicted: Array, z: Array) -> tuple[Array, Array]:
    """States (K, D) at the ends of K steps from z (D,), advanced in place, and reactions (K, S, m).

    driven: (K, D), what loads add to the states; shifts: (K, S, m), what loads and offsets add to the arguments;
    predicted: (K, m), and to the predicted positions.
    """
    (S, m, D), K = linear.reading.shape, len(driven)
    path, reactions = np.empty((K, D)), np.empty((K, S, m))
    given = {"driven": driven, "shifts": shifts, "predicted": predicted, "z": z, "path": path, "reactions": reactions}
    filled(library().rigid_steps(_Rigid(linear._asdict() | given)))
    return path, reactions


def contact_forces(u: Array, v: Array, law: Array, energy: Array | None = None) -> Array:
    """F(u, u') on the beam, of the shape of u and v; law (.., 6), of each or of all. ``energy`` takes U(u)."""
    shape = np.shape(u)
    law = law if law.shape == (*shape, LAW) else np.broadcast_to(law, (*shape, LAW))
    u, v, law, F = *(np.asarray(x, float, order="C") for x in (u, v, law)), np.empty(shape)
    at = address(u, shape), address(v, shape), address(law, (*shape, LAW)), address(F, shape)
    library().contact_forces(F.size, *at, None if energy is None else address(energy, shape))
    return F
