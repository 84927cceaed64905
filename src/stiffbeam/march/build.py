"""Building a Propagator: K steps of a scheme with unit inputs, arranged as the arrays of a Block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, aligned, padded
from ..model.drive import Drive
from ..model.modes import Modes
from ..model.stage import BY_LAW, LINEAR, MEAN
from ..model.system import System
from ..schemes import Scheme
from .kernels.layout import Block
from .probe import Probe, probe_units, turned
from .propagator import Propagator, entries_of, modal_rows

INDEPENDENT = 1e-13  # of what a component does, beyond rounding


def build(
    scheme: Scheme,
    system: System,
    basis: Modes,
    dt: float,
    steps: int,
    contact: str,
    reduced: bool = True,
    rule: int = LINEAR,
) -> Propagator:
    """Probe ``steps`` steps of ``scheme`` on the modes of ``system`` and arrange what they say.

    ``rule``: how a node finds its force, see Block; BY_LAW has the velocities at the nodes among its entries.

    ``reduced``: leave out the components of the state that only add to others, see ``independent``.
    """
    K, S, m, n = steps, len(scheme.nodes), len(system.contacts), system.size
    rows = modal_rows(system, basis)
    drive = Drive.of(system)
    samples, offset_samples = drive.split(system.loads, n)[1], drive.offsets(system)[1]
    sampled = np.array([basis.force(p) for p, _ in samples]).reshape(-1, n)
    extrapolated, rated = contact == "extrapolated", rule == BY_LAW
    probed = probe_units(scheme, basis.equation, dt, K, rows[:m], sampled, extrapolated, rated)
    if rule == MEAN:
        probed = turned(probed, basis)
    a = probed.states.shape[1]
    keep, mix = independent(probed) if reduced else (np.arange(a), np.eye(a))
    at_node = not extrapolated and probed.ends_at_last_node
    end_channels = np.arange(m if at_node else 0, len(rows))
    N = padded(K * S * m, least=0)
    end_first, end_stride = N + np.arange(len(rows)), np.full(len(rows), len(end_channels))
    if at_node:
        end_first[:m], end_stride[:m] = (S - 1) * m + np.arange(m), S * m
        end_first[m:] = N + np.arange(len(rows) - m)

    # What entries, velocities and the end state read from the unit states: one term per mode.
    first_rate = N + K * len(end_channels)
    width, used = first_rate + (K * S * m if rated else 0), len(keep) * n
    R, D = padded(width), padded(used)
    reading, velocity = aligned((R, D)), np.zeros((K, len(rows), D))
    at_nodes = np.einsum("ksbj,cj->kscbj", probed.arguments[:, :, keep], rows[:m]).reshape(-1, used)
    at_ends = np.einsum("kbj,cj->kcbj", probed.states[:, 0][:, keep], rows[end_channels]).reshape(-1, used)
    reading[: len(at_nodes), :used], reading[N:first_rate, :used] = at_nodes, at_ends
    if rated:
        moving = np.einsum("ksbj,cj->kscbj", probed.velocities[:, :, keep], rows[:m])
        reading[first_rate:width, :used] = moving.reshape(-1, used)
    velocity[..., :used] = np.einsum("kbj,cj->kcbj", probed.states[:, 1][:, keep], rows).reshape(K, -1, used)
    mixed = np.einsum("cd,kdbj->kcbj", mix, probed.states)  # packed states, (K, kept, batch, n)

    # A force in step k acts as one in step 0, k steps later.
    P, C = m + len(sampled), len(rows)
    of_pulses = slice(a, None)
    response = entries_of(probed, rows, m, end_channels)[of_pulses].reshape(P, S, width)
    speeds = np.einsum("kbj,cj->bkc", probed.states[:, 1, of_pulses], rows).reshape(P, S, K, C)
    ended = np.moveaxis(mixed[:, :, of_pulses], 2, 0).reshape(P, S, K, used)
    pushed = np.zeros((P, K, S, R + D))
    for part in (slice(0, K * S * m), slice(N, first_rate), slice(first_rate, width)):
        pushed[..., part] = _later(response[..., part], K)
    pushed[..., R : R + used] = np.moveaxis(ended[:, :, ::-1], 2, 1)
    rates = _later(speeds.reshape(P, S, K * C), K).reshape(P, K, S, K, C)

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
        rates=np.pad(first_rate + node, (0, N - nodes)) if rated else np.zeros(0, np.int64),
        rule=rule,
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
        units=probed,
        samples=tuple(samples),
        sample_rows=by_node(pushed, of_samples, kind_by_kind),
        sample_velocity=by_node(rates, of_samples, kind_by_kind),
        offset_samples=tuple(offset_samples),
    )


def _later(x: Array, K: int) -> Array:
    """(P, S, K w) by step -> (P, K, S, K w): what an input in step k does is zero before it, then x."""
    padded_x = np.concatenate([np.zeros_like(x), x], axis=-1)
    size, width = x.shape[-1], x.shape[-1] // K
    windows = np.lib.stride_tricks.sliding_window_view(padded_x, size, axis=-1)  # (P, S, size + 1, size)
    return np.moveaxis(windows[:, :, size - width * np.arange(K)], 2, 1)


def _shifted(matrix: Array, D: int) -> Array:
    """Mode by mode matrices (a, a, n) as the transition of a Block: the e-th cyclic diagonals."""
    a, _, n = matrix.shape
    shifted = aligned((a, D))
    for e, c in np.ndindex(a, a):
        shifted[e, c * n : (c + 1) * n] = matrix[c, (c + e) % a]
    return shifted


def independent(probed: Probe) -> tuple[NDArray[np.int64], Array]:
    """The components of the state that a run needs, and what each of them has to hold.

    If a unit of component e does to all that follows what x_ec units of the components c do, in every
    mode alike, then e need not be carried: c becomes c + x_ec e. (HHT's acceleration enters by q + dt v
    + dt^2 (1/2 - beta) a and v + dt (1 - gamma) a only.) Returns (keep, mix), mix of shape (kept, a).
    """
    a = probed.states.shape[1]
    raw = probed.states[0, :, :a]
    # Two ways to weigh what they do, and a mix has to do by both: every output by its largest share, which is right
    # for the fast modes; and each component in units of what it does to the position, as q, dt v and dt^2 a, next
    # to which at a small dt the rounding of the first is larger than what a component does.
    units = np.max(np.abs(raw[0]), axis=-1)
    units = np.where(units > 0.0, units, 1.0)
    by_share = _outputs(raw, probed.arguments[0, :, :a])
    scale = np.max(np.abs(by_share), axis=1)
    by_share = by_share[scale > 0.0] / scale[scale > 0.0, None]
    by_unit = _outputs(raw * units[:, None, None], probed.arguments[0, :, :a]) / units
    by_unit /= np.maximum(1.0, np.max(np.abs(by_unit), axis=1))[:, None]
    weighed = [(by_share, np.ones(a)), (by_unit, units)]
    keep: list[int] = []
    mix = np.eye(a)
    for e in range(a):
        for effects, own in weighed:
            size = np.max(np.abs(effects), axis=0)
            x = np.linalg.lstsq(effects[:, keep] / size[keep], effects[:, e], rcond=None)[0] / size[keep]
            x *= own[e] / own[keep]
            if all(_does(seen, x * (unit[keep] / unit[e]), keep, e) for seen, unit in weighed):
                mix[keep, e] = x
                break
        else:
            keep.append(e)
    return np.array(keep), mix[keep]


def _outputs(*fields: Array) -> Array:
    """(outputs, a) from fields (..., a, n)."""
    return np.concatenate([np.moveaxis(x, 1, -1).reshape(-1, x.shape[1]) for x in fields])


def _does(effects: Array, x: Array, keep: list[int], e: int) -> bool:
    """Whether x units of the components kept do what a unit of e does."""
    return bool(np.max(np.abs(effects[:, keep] @ x - effects[:, e])) <= INDEPENDENT * np.max(np.abs(effects[:, e])))
