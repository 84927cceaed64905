"""The march in blocks, its energy balance, and the steps on rigid stops: the functions of march.h.

Every array is checked here: one of another type, shape or order raises TypeError.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from ..basics.arrays import Array, IntArray
from .library import INTEGER, Int, Real, address, filled, library, structure

LINEAR, BY_LAW, MEAN = range(3)  # how a node finds its force: of springs, any law, or its mean over the step
LAW, TALLY, EVENT, SUMS = 6, 8, 7, 10  # numbers of a law, a tally, an impact and the energy balance
OVERFLOW = 1e100  # A position beyond this ends the run. Its square, in an energy, is still a float64.
AT_A_STOP, WHERE_PREDICTED, WHERE_CLOSED = range(3)  # when a node can press; the first in a position, else a velocity

_Block = structure(
    "_Block",
    "R D N a n C K nodes rule rated",
    "",
    "reading transition push velocity velocity_push end_first end_stride rates",
)
_Drive = structure("_Drive", "F V", "constant", "frequencies rows velocity")
_Run = structure(
    "_Run",
    "M m first steps every outputs room inflows",
    "dt",
    "law inflow inflow_velocity z position velocity tally diverged times positions velocities node_forces "
    "contact_forces starts forces events cursor",
)
_Account = structure(
    "_Account",
    "a n m L F d steps carried first every outputs moving damped",
    "dt",
    "transition push driven forces g squares damping loads load_values rows offsets offset_rates law node_forces "
    "start place y contacts balance kept",
)
_Rigid = structure(
    "_Rigid",
    "a n D S m K",
    "",
    "blocks matrix reading predicting responses compliance kinds bounds stops driven shifts predicted z path reactions",
)


@cache
def _functions() -> ctypes.CDLL:
    """The library, with the arguments of its functions declared."""
    lib, at = library(), ctypes.POINTER
    lib.march.argtypes = [at(_Block), at(_Drive), at(_Run)]
    lib.account.argtypes = [at(_Account)]
    lib.states.argtypes = [at(_Account), ctypes.c_void_p]
    lib.rigid_steps.argtypes = [at(_Rigid)]
    for function in (lib.march, lib.account, lib.states, lib.rigid_steps):
        function.restype = Int
    lib.switch_time.argtypes, lib.switch_time.restype = [*5 * [Real], ctypes.c_void_p, Real], Real
    return lib


@dataclass(frozen=True, eq=False)
class Block:
    """K steps as one linear map, see Propagator; the same for every member.

    N force nodes, rounded up to a multiple of eight by rows of zeros; R entries, the nodes first; D = a n numbers of
    the state, a components of n modes; C channels. A row of R + D numbers acts on the entries and on the new state
    together. A state is held as z (D + (a - 1) n,), component by component and from the start again, so that z[e n + d]
    is what is e components after z[d].
    """

    reading: Array  # (D, R)
    transition: Array  # (a, D): z_new[d] = sum_e transition[e, d] z[e n + d]
    push: Array  # (N, R + D)
    end_first: IntArray  # (C,): the entry that holds a channel at the end of the first step,
    end_stride: IntArray  # (C,): and how many entries later the next one is
    velocity: Array  # (K, C, D): the channels' velocities at the ends of the steps
    velocity_push: Array  # (K, C, N)
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
        (D, R), a, (N, _), (K, C, _) = self.reading.shape, len(self.transition), self.push.shape, self.velocity.shape
        rated = len(self.rates) > 0
        return _Block(
            R, D, N, a, D // a, C, K, self.nodes, self.rule, rated,
            address(self.reading, (D, R)), address(self.transition, (a, D)), address(self.push, (N, R + D)),
            address(self.velocity, (K, C, D)), address(self.velocity_push, (K, C, N)),
            address(self.end_first, (C,), INTEGER), address(self.end_stride, (C,), INTEGER),
            address(self.rates, (N,), INTEGER, rated),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Forcing:
    """Response of a block to the drive g = (1, sin w1 t, cos w1 t, ...) at its start; V = 1 or one per member."""

    constant: float  # 1, or 0 where nothing is constant in time
    frequencies: Array  # (V, F)
    rows: Array  # (V, d, R + D)
    velocity: Array  # (V, K, C, d)

    @cached_property
    def c(self) -> Any:
        """The drive for C."""
        (V, F), (_, K, C, d), wide = self.frequencies.shape, self.velocity.shape, self.rows.shape[2]
        return _Drive(
            F, V, self.constant, address(self.frequencies, (V, F)), address(self.rows, (V, 1 + 2 * F, wide)),
            address(self.velocity, (V, K, C, d)),
        )  # fmt: skip


class Inflow(NamedTuple):
    """Share of sampled loads and offsets in the blocks of a range of steps; no rows without any."""

    rows: Array  # (B, R + D)
    velocity: Array  # (B, K, C)


class Marchers(NamedTuple):
    """State of all ensemble members and their contact statistics. Updated in place."""

    z: Array  # (M, D + (a - 1) n)
    position: Array  # (M, C) at the last step
    velocity: Array  # (M, C)
    tally: Array  # (M, m, 8), see sampling
    diverged: IntArray  # (M,): the step that overflowed, minus that whose forces were not found, 0 for none


class Kept(NamedTuple):
    """Output buffers for a range of steps. An empty array disables that output."""

    times: Array  # (outputs,)
    positions: Array  # (M, outputs, C) at every ``every``-th step
    velocities: Array  # (M, outputs, C)
    node_forces: Array  # (M, outputs, m): the forces that nodes found, NaN where the end of a step is no node
    contact_forces: Array  # (M, outputs, m): the forces of linear stops
    starts: Array  # (B, D + (a - 1) n): the state of the only member at the start of each block
    forces: Array  # (B, N)


def run(
    block: Block, law: Array, forcing: Forcing, inflow: Inflow, marchers: Marchers, kept: Kept, events: Array,
    first: int, steps: int, dt: float, every: int, cursor: IntArray,
) -> bool:  # fmt: skip
    """Compute ``steps`` steps of every member from step ``first``. Returns True if all are done.

    law: (M, m, 6), the laws of every contact, see contact_law. events: the list of impacts, see sampling.
    cursor: (member, block, free row of events), advanced in place; where the list may not hold another
    block's impacts, False is returned and the call can be made again with a longer one. A member has the bits of its
    solo run.
    """
    c, drive, (M, m, _) = block.c, forcing.c, law.shape
    z, position, velocity, tally, diverged = marchers
    times, positions, velocities, node_forces, contact_forces, starts, forces = kept
    outputs, blocks, B, width = positions.shape[1], -(-steps // c.K), len(inflow.rows), c.D + (c.a - 1) * c.n
    if (
        B not in (0, blocks)
        or 0 < outputs <= (first + steps) // every
        or drive.V not in (1, M)
        or min(first, steps) < 0
    ):
        raise ValueError("sampled loads, outputs or drives do not fit the steps")
    if c.nodes % max(1, c.K * m) or forcing.velocity.shape[1:3] != (c.K, c.C) or forcing.rows.shape[2] != c.R + c.D:
        raise ValueError("contacts or drives do not fit the block")
    if len(starts) and M != 1:
        raise ValueError("the energy balance is of one member")
    x = _Run(
        M, m, first, steps, every, outputs, len(events), B, dt,
        address(law, (M, m, LAW)), address(inflow.rows, (B, c.R + c.D), wanted=B),
        address(inflow.velocity, (B, c.K, c.C), wanted=B), address(z, (M, width)), address(position, (M, c.C)),
        address(velocity, (M, c.C)), address(tally, (M, m, TALLY)), address(diverged, (M,), INTEGER),
        address(times, (outputs,), wanted=outputs and len(times)),
        address(positions, (M, outputs, c.C), wanted=outputs), address(velocities, (M, outputs, c.C), wanted=outputs),
        address(node_forces, (M, outputs, m), wanted=outputs and node_forces.shape[1]),
        address(contact_forces, (M, outputs, m), wanted=outputs and contact_forces.shape[1]),
        address(starts, (blocks, width), wanted=len(starts)), address(forces, (blocks, c.N), wanted=len(starts)),
        address(events, (len(events), EVENT)), address(cursor, (3,), INTEGER),
    )  # fmt: skip
    return bool(filled(_functions().march(c, drive, x)))


def switch_time(u0: float, v0: float, u1: float, v1: float, side: float, law: Array, dt: float) -> float:
    """Fraction of the step, 0 to 1, at which contact with the stop on ``side`` begins or ends, from positions and
    velocities at both ends; law (6,).

    That is where the cubic Hermite interpolant crosses the stop. At a damped stop that is penetrated, or held on to
    rounding, contact ends, and begins again, where the force changes sign.
    """
    return _functions().switch_time(u0, v0, u1, v1, side, address(law, (LAW,)), dt)


class Step(NamedTuple):
    """One step of a scheme on a whole state (a, n), and the inputs of a range of steps. Forces are known here; the
    other names are those of Block and Forcing."""

    transition: Array  # (a, a n)
    push: Array  # (F, a n), of contacts and sampled loads at every node
    driven: Array  # (d, a n), of the constant, then sine and cosine of every frequency
    forces: Array  # (steps, F)
    g: Array  # (steps + 1, d) at the starts of the steps and the last one's end


class Energies(NamedTuple):
    """Terms of the energy balance of a system with unit modal masses; values at k = 0..steps."""

    squares: Array  # (n,): omega_j^2
    damping: Array  # (n,), or none
    loads: Array  # (L, n)
    load_values: Array  # (steps + 1, L)
    rows: Array  # (m, n), of the contacts
    offsets: Array  # (steps + 1, C) of the channels, the contacts first, or no rows
    offset_rates: Array  # (steps + 1, C), or no rows
    law: Array  # (m, 6), see contact_law
    node_forces: Array  # (steps + 1, m): the forces that nodes found, NaN for none


def _steps_of(step: Step, n: int, start: Array, place: IntArray) -> dict[str, Any]:
    """The part of the energy balance that ``states`` has too."""
    (F, D), d, steps = step.push.shape, len(step.driven), len(step.forces)
    a = D // n
    if len(start) < len(place) * n or (len(place) and not 0 <= place.min() <= place.max() < a):
        raise ValueError("components do not fit the states")
    return {
        "a": a, "n": n, "F": F, "d": d, "steps": steps, "carried": len(place), "every": 1,
        "transition": address(step.transition, (a, D)), "push": address(step.push, (F, D)),
        "driven": address(step.driven, (d, D)), "forces": address(step.forces, (steps, F)),
        "g": address(step.g, (steps + 1, d)), "start": address(start, start.shape),
        "place": address(place, (len(place),), INTEGER),
    }  # fmt: skip


def states(step: Step, n: int, start: Array, place: IntArray) -> Array:
    """The states (steps, a n) at the ends of the steps from ``start``, whose components have their ``place``."""
    out = np.empty((len(step.forces), step.push.shape[1]))
    x = _Account(**_steps_of(step, n, start, place))
    filled(_functions().states(x, address(out, out.shape)))
    return out


def account(
    step: Step, energies: Energies, place: IntArray, start: Array, y: Array, contacts: Array, balance: Array,
    first: int, every: int, dt: float, kept: Array,
) -> None:  # fmt: skip
    """Add a range of steps from step ``first`` to the balance; columns of ``kept`` (10, outputs) at every ``every``-th.

    start: the state before the steps, whose components have their ``place``. y (2 n,) = (q, q') at the start; a
    continued state may begin differently. contacts (2, m): their positions and rates there, with the given values
    at t = 0, where rounding would decide the side of a stop. balance (10,); all three are updated in place. The loss is
    computed over a range of consecutive steps in contact, or of consecutive steps without: between its ends no energy
    is needed, and outputs do not end it.
    """
    squares, damping, loads, load_values, rows, offsets, offset_rates, law, node_forces = energies
    n, m, L, steps, outputs = len(squares), len(law), len(loads), len(step.forces), kept.shape[1]
    damped, moving = len(damping) > 0, offsets.shape[1] if len(offsets) else 0
    if outputs <= (first + steps) // every or (moving and moving < m):
        raise ValueError("outputs or offsets do not fit the steps")
    x = _Account(
        **_steps_of(step, n, start, place) | {
            "m": m, "L": L, "first": first, "every": every, "outputs": outputs, "moving": moving, "damped": damped,
            "dt": dt,
        },
        squares=address(squares, (n,)), damping=address(damping, (n,), wanted=damped), loads=address(loads, (L, n)),
        load_values=address(load_values, (steps + 1, L)), rows=address(rows, (m, n)),
        offsets=address(offsets, (steps + 1, moving), wanted=moving),
        offset_rates=address(offset_rates, (steps + 1, moving), wanted=moving), law=address(law, (m, LAW)),
        node_forces=address(node_forces, (steps + 1, m)), y=address(y, (2 * n,)), contacts=address(contacts, (2, m)),
        balance=address(balance, (SUMS,)), kept=address(kept, (SUMS, outputs)),
    )  # fmt: skip
    filled(_functions().account(x))


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
    (S, m, D), (a, _, n), K = linear.reading.shape, linear.blocks.shape, len(driven)
    path, reactions = np.empty((K, D)), np.empty((K, S, m))
    x = _Rigid(
        a, n, D, S, m, K, address(linear.blocks, (a, a, n)), address(linear.matrix, (D, D), wanted=not a),
        address(linear.reading, (S, m, D)), address(linear.predicting, (m, D)), address(linear.responses, (S, m, D)),
        address(linear.compliance, (S, S, m, m)), address(linear.kinds, (S,), INTEGER),
        address(linear.bounds, (S, m, 2)), address(linear.stops, (m, 2)), address(driven, (K, D)),
        address(shifts, (K, S, m)), address(predicted, (K, m)), address(z, (D,)), address(path, (K, D)),
        address(reactions, (K, S, m)),
    )  # fmt: skip
    filled(_functions().rigid_steps(x))
    return path, reactions
