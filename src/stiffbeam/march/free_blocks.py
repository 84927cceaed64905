"""Blocks that no contact meets, in closed form: what the energy ledger asks of them.

Without contact the positions p q_k at the ends of the steps k = 1..K of a block are linear in the state z and the
drive g at its start, and g itself turns with T: g_k = T^k g. So the work of a load p f(t), f = F g,

    sum_k s_k (p q_(k+1) - p q_k),   s_k = (F g_k + F g_(k+1))/2,   k = 0..K-1

is a quadratic form in (z, g), but for s_0 p q_0: q_0 belongs to the block before.
"""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array, aligned
from .kernels.single_steps import Energies, FreeBlock, Step
from .kernels.single_steps import states as states_of
from .propagator import Propagator


def no_block(contacts: int, loads: int) -> FreeBlock:
    """Where no block is known in closed form."""
    per_contact, square = np.zeros((contacts, 0, 0)), np.zeros((0, 0))
    return FreeBlock(per_contact, per_contact, np.zeros((2, 0, 0)), square, square, square, np.zeros((loads, 0)))


def free_block(
    one: Propagator, step: Step, K: int, T: Array, energies: Energies, load_basis: Array, offset_basis: Array
) -> FreeBlock:
    """K steps of undamped modes under harmonic loads. one: the propagator of ``step``. T: (d, d), the drive's
    transition over a step. load_basis: (d, L); offset_basis: (d, m)."""
    n, d, a = one.coordinates.parts, len(T), len(one.keep)
    g = np.empty((K + 1, d, d))  # T^k
    g[0] = np.eye(d)
    for k in range(K):
        g[k + 1] = T @ g[k]
    quiet = step._replace(forces=np.zeros((K, step.forces.shape[1])), inflow=np.zeros((0, step.transition.shape[1])))
    D = step.transition.shape[1]
    from_state, from_drive = aligned((a, K, D)), aligned((d, K, D))
    units = aligned((a, one.block.reading.shape[1] + one.used - n))
    for c in range(a):  # of all modes at once, which do not see each other
        units[c, c * n : (c + 1) * n] = 1.0
    one.repeat(units)
    for c in range(a):
        states_of(quiet._replace(g=np.zeros((K + 1, d))), n, units[c], from_state[c])
    for e in range(d):
        states_of(quiet._replace(g=np.ascontiguousarray(g[:, :, e])), n, np.zeros(units.shape[1]), from_drive[e])

    def seen(rows: Array) -> tuple[Array, Array]:
        """rows (r, n) of q at the ends of the steps, of z (r, K, D) and of g (r, K, d)."""
        of_state = aligned((len(rows), K, D))
        of_state[..., : a * n] = np.einsum("rj,ckj->rkcj", rows, from_state[..., :n]).reshape(len(rows), K, a * n)
        return of_state, np.einsum("rj,ekj->rke", rows, from_drive[..., :n])

    contacts, contacts_driven = seen(energies.rows)
    loads, loads_driven = seen(energies.loads)
    weights = 0.5 * np.einsum("eL,kef->Lkf", load_basis, g[:-1] + g[1:])  # s_k of every load, (L, K, d)
    moves = (np.diff(of, axis=1, prepend=0.0) for of in (loads, loads_driven))  # the first from q = 0, see above
    work, work_driven = (np.einsum("Lkf,Lkx->fx", weights, moved) for moved in moves)
    ends = from_state[:, -1, : 2 * n].reshape(a, 2, n).swapaxes(0, 1)
    return FreeBlock(
        seen=contacts,
        seen_driven=contacts_driven + np.einsum("em,kef->mkf", offset_basis, g[1:]),
        end=np.ascontiguousarray(ends),
        end_driven=np.ascontiguousarray(from_drive[:, -1, : 2 * n]),
        work=np.ascontiguousarray(work),  # of another order, the kernel would be compiled again
        work_driven=np.ascontiguousarray(work_driven),
        begun=weights[:, 0].copy(),
    )
