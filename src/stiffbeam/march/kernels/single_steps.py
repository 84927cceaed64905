"""Compiled single steps inside blocks: states that a block march passes over."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...basics.arrays import Array, IntArray
from ...basics.compiled import inlined


class Step(NamedTuple):
    """One step of a scheme on a whole state (a, n), and what a stretch of them is given.

    Forces are known here, so that no stop is asked; the other names are those of Block and Forcing. Component e of part
    j stands at e P + j, P >= n of whole vector registers, and a state is held twice, so that z[e P + d] is what is e
    components after z[d].
    """

    transition: Array  # (a + a % 2, a P): row e times what is e components later; those beyond a are zero
    push: Array  # (F, a P), of contacts and sampled loads at every node
    driven: Array  # (d, a P), of the constant, then sine and cosine of every frequency
    forces: Array  # (steps, F)
    g: Array  # (steps + 1, d) at the starts of the steps and the last one's end


@inlined
def begin(start: Array, place: IntArray, n: int, P: int, z: Array) -> None:
    """The state z of the components that are carried, in their ``place`` (see Propagator.unpack), the others zero."""
    for j in range(z.size):
        z[j] = 0.0
    half = z.size // 2
    for c in range(place.size):
        at = place[c] * P
        for j in range(n):
            z[at + j] = start[c * n + j]
            z[half + at + j] = start[c * n + j]


@inlined
def take_step(
    transition: Array, push: Array, driven: Array, forces: Array, g: Array, k: int, P: int, z: Array, new: Array
) -> None:  # fmt: skip
    """``new``, the whole state after step k from z."""
    # Two rows at a time: half as often to ``new`` and back.
    D = np.uint64(transition.shape[1])
    next_one = np.uint64(P)
    for j in range(D):
        new[j] = driven[0, j] + (transition[0, j] * z[j] + transition[1, j] * z[next_one + j])
    for e in range(2, transition.shape[0], 2):
        one, two = np.uint64(e * P), np.uint64(e * P + P)
        for j in range(D):
            new[j] += transition[e, j] * z[one + j] + transition[e + 1, j] * z[two + j]
    for e in range(1, driven.shape[0], 2):
        sine, cosine = g[k, e], g[k, e + 1]
        for j in range(D):
            new[j] += sine * driven[e, j] + cosine * driven[e + 1, j]
    for i in range(forces.shape[1]):
        force = forces[k, i]
        if force != 0.0:
            for j in range(D):
                new[j] += force * push[i, j]
    for j in range(D):
        new[D + j] = new[j]


@inlined
def states(step: Step, n: int, P: int, start: Array, place: IntArray, z: Array, new: Array, out: Array) -> None:
    """The states (steps, a P) at the ends of the steps from ``start``, see ``begin``. z, new: memory, (2 a P,)."""
    transition, push, driven, forces, g = step
    begin(start, place, n, P, z)
    for k in range(out.shape[0]):
        take_step(transition, push, driven, forces, g, k, P, z, new)
        for j in range(np.uint64(out.shape[1])):
            out[k, j] = new[j]
        z, new = new, z
