"""A small driven system with rigid stops, as the package takes it and as plain loops do."""

from __future__ import annotations

import numpy as np
from rigid_loops import Loop

import stiffbeam as sb

INF = float("inf")


def chain(contacts=1, damping="none", moving=False, e=None):
    """Four masses in a row, driven, with stops at one or two of them: the System and the same as a Loop."""
    M, n = np.diag([1.0, 0.7, 1.3, 0.8]), 4
    K = 40.0 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    C = {"none": np.zeros((n, n)), "stiffness": 0.004 * K, "coupling": np.diag([0.0, 0.0, 0.0, 1.5])}[damping]
    B = np.eye(n)[[3, 1][:contacts]]
    lower, upper = np.array([-0.3, -0.25][:contacts]), np.array([0.2, INF][:contacts])
    motion = sb.Harmonic(0.03, 5.0, 0.3)
    load, drive = np.array([0.0, 6.0, 0.0, -3.0]), sb.Harmonic(3.0, 4.0, 1.0)
    stops = [
        sb.Stops(lower=lo, upper=None if hi == INF else hi, stiffness=INF, restitution=e)
        for lo, hi in zip(lower, upper, strict=True)
    ]
    offsets = [motion if moving else None, None][:contacts]
    system = sb.System.from_matrices(
        M, K, C, loads=[(load, drive)], initial_velocity=[0.0, 0.5, 1.0, -0.5],
        contacts=[sb.Contact(*x) for x in zip(B, stops, offsets, strict=True)],
    )  # fmt: skip
    on = np.array([1.0, 0.0][:contacts]) * moving
    loop = Loop(
        M, C, K, B, lower, upper, np.full(contacts, e or 0.0), lambda t: load * float(drive.value(t)),
        lambda t: on * float(motion.value(t)), lambda t: on * float(motion.rate(t)),
    )  # fmt: skip
    return system, loop
