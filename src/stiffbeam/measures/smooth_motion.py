"""A system's smooth motion without contact: the steady response to every load, and the lowest mode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.drive import Drive
from ..model.modes import uncoupled_modes
from ..model.system import System


def without_contact(system: System) -> System:
    """The same system with its stops taken away; ``tip`` stays what it was."""
    row = system.channels[system.tip_channel][0]
    return replace(system, contacts=(), observe=row)


def smooth_motion(system: System) -> System:
    """The system without contact on its slow motion: the steady response to the drive plus the lowest mode.

    Initial data at rest excite every mode of the grid, and no step of interest resolves the highest. The
    lowest mode starts with the size of the steady motion, or 1 where nothing drives the system. Raises
    InputError as ``steady_state`` does.
    """
    system = without_contact(system)
    y, g = steady_state(system)
    basis = uncoupled_modes(system)
    q, v = g @ y, Drive.of(system).derivative() @ g @ y
    size = float(np.max(np.abs(q))) or 1.0
    lowest = int(np.argmax(basis.omega > 0.0))
    shape = basis.shapes[:, lowest]
    return replace(system, q0=q + size * shape / np.max(np.abs(shape)), v0=v)


def steady_state(system: System) -> tuple[Array, Array]:
    """(Y, g(0)), q = Y^T g(t): the motion in which every load excites its own frequency only; Y is (d, n).

    Raises InputError where the damping couples the modes, and for a sampled load.
    """
    basis = uncoupled_modes(system)
    drive = Drive.of(system)
    unit, samples = drive.split(system.loads, system.size)
    if samples:
        remedy = "replace the samples by a Harmonic"
        raise InputError("loads", "a sampled load", "be harmonic or constant for the steady motion", remedy)
    # With the load unit^T g, g' = D g and eta = y^T g in a mode: (D^T D^T + c D^T + w^2) y = its force.
    forces, rate = basis.force(unit), drive.derivative().T
    y = np.empty_like(forces)
    for j, (omega, c) in enumerate(zip(basis.omega, basis.damping, strict=True)):
        matrix = rate @ rate + c * rate + omega**2 * np.eye(drive.size)
        y[:, j] = np.linalg.lstsq(matrix, forces[:, j])[0]  # a rigid-body mode has no steady response to a constant
    return basis.to_nodal(y), drive.coefficients(0.0)
