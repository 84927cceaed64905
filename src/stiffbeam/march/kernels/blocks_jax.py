"""``kernel.run`` in JAX: all members at once, on the CPU or on whatever device JAX has.

The same arrays and the same results to rounding. A step of the scan is a block of every member; the
impacts, whose number is not known beforehand, are sampled on the host from the positions and velocities
that come back. At most one contact.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from ...basics.arrays import Array, double_precision
from ...basics.validation import InputError
from ...model.contact_law import G1, G2, KAPPA, stage_stiffness
from ...model.stage import LINEAR
from ...trajectory.sampling import SIDE, observe
from .blocks import OVERFLOW, Block, Forcing, Inflow, Kept, Marchers

NONE = np.zeros((0, 0, 0))  # contact="conserving" and other laws than the linear one are refused
REMEDY = "use engine='numba'"
NUMBERS_BACK = 1 << 22  # positions and velocities that come back from the device at a time


def run(
    block: Block, law: Array, forcing: Forcing, inflow: Inflow, marchers: Marchers, kept: Kept, events: Array,
    first: int, steps: int, dt: float, every: int, cursor: Array, linear: int | None = 1,
    by_law: int | None = None,
) -> bool:  # fmt: skip
    """See ``kernel.run``; states are not kept."""
    if block.rule != LINEAR:
        raise InputError("engine", "jax", "be given linear stops and contact='implicit' or 'extrapolated'", REMEDY)
    if law.shape[1] > 1:
        raise InputError("engine", "jax", "be given at most one contact", REMEDY)
    M, m = law.shape[:2]
    K, C = block.velocity.shape[:2]
    blocks = -(-steps // K)
    length = max(1, min(blocks, NUMBERS_BACK // (M * K * C)))
    compliance = block.compliance[:, 0] if m else np.zeros(0)
    stiff = stage_stiffness.py_func(law[:, :1, KAPPA], compliance) if m else np.zeros((M, 0))
    stops = law[:, 0, [G1, G2]] if m else np.zeros((M, 2))
    with double_precision():
        for b in range(int(cursor[1]), blocks, length):
            here = np.minimum(np.arange(b, b + length), blocks - 1)  # the last stretch is filled up
            phase = np.multiply.outer((first + here * K) * dt, forcing.frequencies)
            g = np.full((length, len(forcing.rows), forcing.rows.shape[1]), forcing.constant)
            g[..., 1::2], g[..., 2::2] = np.sin(phase), np.cos(phase)
            extra = (x[here] if len(x) else np.zeros((length, *x.shape[1:])) for x in inflow)
            z, u, v = _march()(
                block, forcing.rows, forcing.velocity, stiff, stops, marchers.z, g, *extra
            )  # u, v: (length, M, K, C)
            count = min(length * K, steps - b * K)
            u, v = (np.ascontiguousarray(np.moveaxis(np.asarray(x), 1, 0).reshape(M, -1, C)[:, :count]) for x in (u, v))
            if cursor[2] + _begun(u[..., :m], law, marchers.tally) > len(events):
                cursor[1] = b
                return False
            at = first + b * K
            bad = ~np.all(np.abs(u) < OVERFLOW, axis=2)
            fresh = np.any(bad, axis=1) & (marchers.diverged == 0)
            marchers.diverged[fresh] = at + 1 + np.argmax(bad[fresh], axis=1)
            if kept.positions.shape[1]:
                n = np.arange(at // every + 1, (at + count) // every + 1)
                kept.positions[:, n], kept.velocities[:, n] = u[:, n * every - at - 1], v[:, n * every - at - 1]
            cursor[2] = observe(
                u, v, NONE, NONE, law, dt, at, marchers.position, marchers.velocity, marchers.tally, marchers.diverged,
                events, cursor[2],
            )  # fmt: skip
            marchers.z[:] = np.asarray(z)
    cursor[:2] = 0
    return True


def _begun(u: Array, law: Array, tally: Array) -> int:
    """Number of impacts that begin in u (M, steps, m)."""
    chi = (u > law[:, None, :, G2]) * 1 - (u < law[:, None, :, G1]) * 1
    before = np.concatenate([tally[:, None, :, SIDE], chi[:, :-1]], axis=1)
    return int(np.count_nonzero((chi != 0) & (chi != before)))


@cache
def _march() -> Any:
    """The compiled stretch of blocks."""
    import jax
    import jax.numpy as jnp

    @jax.jit
    def stretch(
        block: Block, rows: Any, forced_velocity: Any, stiff: Any, stops: Any, z: Any, g: Any, inflow: Any,
        inflow_velocity: Any,
    ) -> tuple[Any, Any, Any]:  # fmt: skip
        (R, D), a = block.reading.shape, len(block.transition)
        nodes, n = stiff.shape[1], (z.shape[1] - D) // max(1, a - 1)
        g1, g2 = stops[:, 0], stops[:, 1]
        push = block.push[:nodes]

        def one_block(z: Any, given: Any) -> tuple[Any, Any]:
            g, inflow, inflow_velocity = given
            row = jnp.einsum("ve,ver->vr", g, rows) + inflow  # (V, R + D)
            w = z[:, :D] @ block.reading.T + row[:, :R]
            z_new = sum(block.transition[e] * z[:, e * n : e * n + D] for e in range(a)) + row[:, R:]

            def one_node(w: Any, node: Any) -> tuple[Any, Any]:
                i, stiff, push = node
                r = w[:, i]
                force = stiff * (jnp.clip(r, g1, g2) - r)
                return w + force[:, None] * push, force

            w, forces = jax.lax.scan(one_node, w, (jnp.arange(nodes), stiff.T, push[:, :R]))
            z_new = z_new + forces.T @ push[:, R:]
            steps = jnp.arange(block.velocity.shape[0])
            u = w[:, block.end_first + steps[:, None] * block.end_stride]
            v = jnp.einsum("md,kcd->mkc", z[:, :D], block.velocity)
            v = v + jnp.einsum("im,kci->mkc", forces, block.velocity_push[..., :nodes])
            v = v + jnp.einsum("ve,vkce->vkc", g, forced_velocity) + inflow_velocity
            z = z.at[:, :D].set(z_new)
            z = z.at[:, a * n : (2 * a - 1) * n].set(z_new[:, : (a - 1) * n])
            return z, (u, v)

        z, (u, v) = jax.lax.scan(one_block, z, (g, inflow, inflow_velocity))
        return z, u, v

    return stretch
