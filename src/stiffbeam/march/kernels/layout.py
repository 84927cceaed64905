"""What the kernels march with: arrays in the order they are read, nothing that knows a scheme."""

from __future__ import annotations

from typing import NamedTuple

from ...basics.arrays import Array

OVERFLOW = 1e100


class Block(NamedTuple):
    """K steps as one linear map, see Propagator; the same for every member.

    N force nodes, R entries (the nodes first) and D state components, each padded to eight with zeros;
    C channels. A row of R + D numbers acts on the entries and on the new state together. A state of a
    components and n modes is held as z (D + (a - 1) n,), component by component and from the start
    again, so that z[e n + d] is what is e components after z[d].
    """

    reading: Array  # (R, D)
    transition: Array  # (a, D): z_new[d] = sum_e transition[e, d] z[e n + d]
    push: Array  # (N, R + D)
    compliance: Array  # (K S m, m): of the contacts of a node on each other
    end_first: Array  # (C,) integers: the entry that holds a channel at the end of the first step,
    end_stride: Array  # (C,) and how many entries later the next one is
    velocity: Array  # (K, C, D): the channels' velocities at the ends of the steps
    velocity_push: Array  # (K, C, N)
    rates: Array  # (N,) integers: the entry that holds the velocity at a node; none where no force depends on it
    rule: int  # how a node finds its force: LINEAR, BY_LAW or MEAN, see stage


class Forcing(NamedTuple):
    """What the drive g = (1, sin w1 t, cos w1 t, ...) at a block's start does; V = 1 or one per member."""

    constant: float  # 1, or 0 where nothing is constant in time
    frequencies: Array  # (V, F)
    rows: Array  # (V, d, R + D)
    velocity: Array  # (V, K, C, d)


class Inflow(NamedTuple):
    """What sampled loads and offsets add to the blocks of a stretch; no rows without any."""

    rows: Array  # (B, R + D)
    velocity: Array  # (B, K, C)


class Marchers(NamedTuple):
    """Where the members are and what they have seen; advanced in place."""

    z: Array  # (M, D + (a - 1) n)
    position: Array  # (M, C) at the last step
    velocity: Array  # (M, C)
    tally: Array  # (M, m, 8), see sampling
    diverged: Array  # (M,) integers: the step that overflowed, 0 for none


class Kept(NamedTuple):
    """What is kept of a stretch of steps. Empty arrays are not wanted."""

    positions: Array  # (M, outputs, C) at every ``every``-th step
    velocities: Array  # (M, outputs, C)
    found: Array  # (M, outputs, m): the forces that nodes found, NaN where the end of a step is no node
    starts: Array  # (B, D + (a - 1) n): the state of the only member at the start of each block
    forces: Array  # (B, N)
