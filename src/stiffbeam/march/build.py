"""Building a Propagator: one step's map raised to powers, arranged as the arrays of a Block."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import aligned, padded
from ..model.drive import Drive
from ..model.stage import BY_LAW, LINEAR, MEAN
from ..schemes import Scheme
from .coordinates import Coordinates
from .entries import Entries
from .kernels.layout import Block
from .powers import Powers
from .probe import probe
from .propagator import Propagator


def build(
    scheme: Scheme,
    coordinates: Coordinates,
    dt: float,
    steps: int,
    contact: str,
    reduced: bool = True,
    rule: int = LINEAR,
) -> Propagator:
    """Probe a step of ``scheme`` and arrange what ``steps`` of them do.

    ``rule``: how a node finds its force, see Block; BY_LAW has the velocities at the nodes among its entries.
    ``reduced``: leave out the components of the state that only add to others, see ``probe.independent``.
    """
    system, drive = coordinates.system, Drive.of(coordinates.system)
    samples = drive.split(coordinates.loads(system), coordinates.rows.shape[1])[1]
    offset_samples = drive.offsets(system)[1]
    vectors = np.array([vector for vector, _ in samples]) if samples else None
    one = probe(scheme, coordinates, dt, contact == "extrapolated", rule == BY_LAW, vectors, reduced)
    powers, entries = Powers(one, steps, rule == MEAN), Entries.of(one.readers, steps, one.ends_at_last_node)
    K, S, m, P = steps, len(scheme.nodes), len(coordinates.columns), one.push.shape[-1] // len(scheme.nodes)
    n, g, k = one.reading.shape
    C = one.readers.channels
    used = k * n
    R, D = padded(len(entries.place)), padded(used)

    # What is read from the state, step by step, and from forces: one in step i acts as one in step 0, i steps later.
    flat = powers.readings(one.reading).transpose(1, 2, 3, 0).reshape(K, g, used)
    of_force = np.zeros((K + 1, g, P * S))  # the last for steps before the force
    of_force[0] = one.at_once
    of_force[1:K] = flat[:-1] @ one.push.transpose(1, 0, 2).reshape(used, P * S)
    step = np.arange(K)
    delay = step - step[:, None]
    seen = of_force[np.where(delay >= 0, delay, K)].transpose(3, 0, 1, 2).reshape(P, S, K, K, g)
    left = powers.pushes(one.push)[:, :, ::-1].transpose(3, 2, 1, 0).reshape(P, S, K, used)  # by step of the force
    pushed = np.zeros((P, S, K, R + D))
    pushed[..., :R] = entries.of_readings(seen, R)
    pushed[..., R : R + used] = left
    speeds = seen[..., one.readers.end_rates]

    reading, transition = aligned((R, D)), aligned((k, D))
    reading[:, :used] = np.moveaxis(entries.of_readings(np.moveaxis(flat, 2, 0), R), 0, 1)
    component = np.arange(k)
    shifted = powers.last[:, component, (component + component[:, None]) % k]  # cyclic diagonals, (n, e, c)
    transition[:, :used] = shifted.transpose(1, 2, 0).reshape(k, used)
    velocity = np.zeros((K, C, D))
    velocity[..., :used] = flat[:, one.readers.end_rates]

    nodes, N = K * S * m, entries.nodes
    push, velocity_push = aligned((N, R + D)), np.zeros((K, C, N))
    push[:nodes] = pushed[:m].transpose(2, 1, 0, 3).reshape(nodes, R + D)
    velocity_push[..., :nodes] = speeds[:m].transpose(3, 4, 2, 1, 0).reshape(K, C, nodes)
    node = np.arange(nodes)
    block = Block(
        reading=reading,
        transition=transition,
        push=push,
        compliance=push[node[:, None], (node - node % max(1, m))[:, None] + np.arange(m)],
        end_first=entries.end_first,
        end_stride=entries.end_stride,
        velocity=velocity,
        velocity_push=velocity_push,
        rates=entries.rates,
        rule=rule,
    )
    kind_by_kind = (0, 2, 1)
    return Propagator(
        one=one,
        powers=powers,
        steps=K,
        block=block,
        entries=entries,
        samples=tuple(samples),
        sample_rows=pushed[m:].transpose(*kind_by_kind, 3).reshape(-1, R + D),
        sample_velocity=speeds[m:].transpose(*kind_by_kind, 3, 4).reshape((P - m) * K * S, K, C),
        offset_samples=tuple(offset_samples),
    )
