"""What is read of a block: its entries, and the velocities of its channels; eight rows at a time."""

from __future__ import annotations

from ...basics.arrays import Array
from ...basics.compiled import inlined


@inlined
def read(reading: Array, z: Array, w: Array) -> None:
    """w = reading z."""
    R, D = reading.shape
    for r in range(0, R, 8):
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
        for d in range(D):
            x = z[d]
            s0 += x * reading[r, d]
            s1 += x * reading[r + 1, d]
            s2 += x * reading[r + 2, d]
            s3 += x * reading[r + 3, d]
            s4 += x * reading[r + 4, d]
            s5 += x * reading[r + 5, d]
            s6 += x * reading[r + 6, d]
            s7 += x * reading[r + 7, d]
        w[r] = s0
        w[r + 1] = s1
        w[r + 2] = s2
        w[r + 3] = s3
        w[r + 4] = s4
        w[r + 5] = s5
        w[r + 6] = s6
        w[r + 7] = s7


@inlined
def speed(
    velocity: Array, velocity_push: Array, forced: Array, inflow: Array, v: int, b: int, k: int, c: int, z: Array,
    g: Array, forces: Array,
) -> float:  # fmt: skip
    """The velocity of channel c at the end of step k of a block."""
    total = 0.0
    for d in range(velocity.shape[2]):
        total += z[d] * velocity[k, c, d]
    for i in range(forces.size):
        total += forces[i] * velocity_push[k, c, i]
    for e in range(g.size):
        total += g[e] * forced[v, k, c, e]
    if inflow.shape[0]:
        total += inflow[b, k, c]
    return total


@inlined
def eight_speeds(
    velocity: Array, velocity_push: Array, forced: Array, inflow: Array, v: int, b: int, first: int, c: int, z: Array,
    g: Array, forces: Array, touched: bool, speeds: Array,
) -> None:  # fmt: skip
    """``speed`` at the ends of eight steps from ``first`` on, beyond the block its last one."""
    end = velocity.shape[0] - 1
    k0, k1, k2, k3 = min(first, end), min(first + 1, end), min(first + 2, end), min(first + 3, end)
    k4, k5, k6, k7 = min(first + 4, end), min(first + 5, end), min(first + 6, end), min(first + 7, end)
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    for d in range(velocity.shape[2]):
        x = z[d]
        s0 += x * velocity[k0, c, d]
        s1 += x * velocity[k1, c, d]
        s2 += x * velocity[k2, c, d]
        s3 += x * velocity[k3, c, d]
        s4 += x * velocity[k4, c, d]
        s5 += x * velocity[k5, c, d]
        s6 += x * velocity[k6, c, d]
        s7 += x * velocity[k7, c, d]
    if touched:
        for i in range(forces.size):
            f = forces[i]
            s0 += f * velocity_push[k0, c, i]
            s1 += f * velocity_push[k1, c, i]
            s2 += f * velocity_push[k2, c, i]
            s3 += f * velocity_push[k3, c, i]
            s4 += f * velocity_push[k4, c, i]
            s5 += f * velocity_push[k5, c, i]
            s6 += f * velocity_push[k6, c, i]
            s7 += f * velocity_push[k7, c, i]
    speeds[0], speeds[1], speeds[2], speeds[3] = s0, s1, s2, s3
    speeds[4], speeds[5], speeds[6], speeds[7] = s4, s5, s6, s7
    for j in range(8):
        k = min(first + j, end)
        for e in range(g.size):
            speeds[j] += g[e] * forced[v, k, c, e]
        if inflow.shape[0]:
            speeds[j] += inflow[b, k, c]
