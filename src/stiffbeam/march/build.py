"""Building a Propagator: K steps of a scheme with unit inputs, arranged as the arrays of a Block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, aligned, padded
from ..drive import Drive
from ..modal import Modes
from ..schemes import Scheme
from ..system import System
from .layout import Block
from .probe import Probe, probe_units
from .propagator import Propagator, entries_of, modal_rows

INDEPENDENT = 1e-13  # of what a component does, beyond rounding


def build(
    scheme: Scheme, system: System, basis: Modes, dt: float, steps: int, contact: str, reduced: bool = True
) -> Propagator:
    """Probe ``steps`` steps of ``scheme`` on the modes of ``system`` and arrange what they say.

    ``reduced``: leave out the components of the state that only add to others, see ``independent``.
    """
    K, S, m, n = steps, len(scheme.nodes), len(system.contacts), system.size
    rows = modal_rows(system, basis)
    drive = Drive.of(system)
    samples, offset_samples = drive.split(system.loads, n)[1], drive.offsets(system)[1]
    pulses = np.array([*rows[:m], *(basis.force(p) for p, _ in samples)]).reshape(-1, n)
    probed = probe_units(scheme, basis.equation, dt, K, pulses)
    a, extrapolated = probed.states.shape[1], contact == "extrapolated"
    keep, mix = independent(probed, extrapolated) if reduced else (np.arange(a), np.eye(a))
    at_node = not extrapolated and probed.ends_at_last_node
    end_channels = np.arange(m if at_node else 0, len(rows))
    N = padded(K * S * m, least=0)
    end_first, end_stride = N + np.arange(len(rows)), np.full(len(rows), len(end_channels))
    if at_node:
        end_first[:m], end_stride[:m] = (S - 1) * m + np.arange(m), S * m
        end_first[m:] = N + np.arange(len(rows) - m)

    # What entries, velocities and the end state read from the unit states: one term per mode.
    width, used = N + K * len(end_channels), len(keep) * n
    R, D = padded(width), padded(used)
    reading, velocity = aligned((R, D)), np.zeros((K, len(rows), D))
    arguments = probed.predictions if extrapolated else probed.positions
    at_nodes = np.einsum("ksbj,cj->kscbj", arguments[:, :, keep], rows[:m]).reshape(-1, used)
    at_ends = np.einsum("kbj,cj->kcbj", probed.states[:, 0][:, keep], rows[end_channels]).reshape(-1, used)
    reading[: len(at_nodes), :used], reading[N:width, :used] = at_nodes, at_ends
    velocity[..., :used] = np.einsum("kbj,cj->kcbj", probed.states[:, 1][:, keep], rows).reshape(K, -1, used)
    mixed = np.einsum("cd,kdbj->kcbj", mix, probed.states)  # packed states, (K, kept, batch, n)

    # A force in step k acts as one in step 0, k steps later.
    P, C, E = len(pulses), len(rows), len(end_channels)
    of_pulses = slice(a, None)
    response = entries_of(probed, rows, m, end_channels, extrapolated)[of_pulses].reshape(P, S, width)
    speeds = np.einsum("kbj,cj->bkc", probed.states[:, 1, of_pulses], rows).reshape(P, S, K, C)
    ended = np.moveaxis(mixed[:, :, of_pulses], 2, 0).reshape(P, S, K, used)
    pushed, rates = np.zeros((P, K, S, R + D)), np.zeros((P, K, S, K, C))
    for k in range(K):
        pushed[:, k, :, k * S * m : K * S * m] = response[:, :, : (K - k) * S * m]
        pushed[:, k, :, N + k * E : width] = response[:, :, N : N + (K - k) * E]
        pushed[:, k, :, R : R + used] = ended[:, :, K - 1 - k]
        rates[:, k, :, k:] = speeds[:, :, : K - k]

    def by_node(x: Array, kinds: slice, order: tuple[int, ...]) -> Array:
        """(kinds, K, S, ...) -> (nodes, ...), kinds first or last among the first three axes."""
        moved = np.moveaxis(x[kinds], (0, 1, 2), order)
        return moved.reshape(-1, *x.shape[3:])

    of_contacts, of_samples = slice(0, m), slice(m, P)
    step_by_step, kind_by_kind = (2, 0, 1), (0, 1, 2)
    nodes = K * S * m
    push, velocity_push = aligned((N, R + D)), np.zeros((K, C, N))
    push[:nodes] = by_node(pushed, of_contacts, step_by_step)
    velocity_push[..., :nodes] = np.moveaxis(by_node(rates, of_contacts, step_by_step), 0, -1)
    node = np.arange(nodes)
    block = Block(
        reading=reading,
        transition=_shifted(mixed[-1][:, keep], D),
        push=push,
        compliance=push[node[:, None], (node - node % max(1, m))[:, None] + np.arange(m)],
        end_first=end_first,
        end_stride=end_stride,
        velocity=velocity,
        velocity_push=velocity_push,
    )
    return Propagator(
        scheme=scheme,
        dt=dt,
        steps=K,
        system=system,
        basis=basis,
        block=block,
        end_channels=end_channels,
        extrapolated=extrapolated,
        keep=keep,
        mix=mix,
        samples=tuple(samples),
        sample_rows=by_node(pushed, of_samples, kind_by_kind),
        sample_velocity=by_node(rates, of_samples, kind_by_kind),
        offset_samples=tuple(offset_samples),
    )


def _shifted(matrix: Array, D: int) -> Array:
    """Mode by mode matrices (a, a, n) as the transition of a Block: the e-th cyclic diagonals."""
    a, _, n = matrix.shape
    shifted = aligned((a, D))
    for e, c in np.ndindex(a, a):
        shifted[e, c * n : (c + 1) * n] = matrix[c, (c + e) % a]
    return shifted


def independent(probed: Probe, extrapolated: bool) -> tuple[NDArray[np.int64], Array]:
    """The components of the state that a run needs, and what each of them has to hold.

    If a unit of component e does to all that follows what x_ec units of the components c do, in every
    mode alike, then e need not be carried: c becomes c + x_ec e. (HHT's acceleration enters by q + dt v
    + dt^2 (1/2 - beta) a and v + dt (1 - gamma) a only.) Returns (keep, mix), mix of shape (kept, a).
    """
    a = probed.states.shape[1]
    fields = (probed.states[0], probed.predictions[0] if extrapolated else probed.positions[0])
    effects = np.concatenate([np.moveaxis(x[:, :a], 1, -1).reshape(-1, a) for x in fields])  # (outputs, a)
    scale = np.max(np.abs(effects), axis=1)
    effects = effects[scale > 0.0] / scale[scale > 0.0, None]
    size = np.max(np.abs(effects), axis=0)
    keep: list[int] = []
    mix = np.eye(a)
    for e in range(a):
        x = np.linalg.lstsq(effects[:, keep] / size[keep], effects[:, e], rcond=None)[0] / size[keep]
        if np.max(np.abs(effects[:, keep] @ x - effects[:, e])) <= INDEPENDENT * size[e]:
            mix[keep, e] = x
        else:
            keep.append(e)
    return np.array(keep), mix[keep]
