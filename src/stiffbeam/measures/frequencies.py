"""Frequencies of a motion: of the drives, and of the smooth motion without contact."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.modes import decoupled_modes, modes, undamped_modes
from ..model.scales import UNNOTICED
from ..model.system import System
from ..model.time_functions import Sampled


def smooth_period(system: System, t_end: float = np.inf) -> float:
    """The longest period of the drives and of the modes that oscillate without contact in a run to t_end; 0 where the
    body flies freely away from its stops. Raises InputError where there are no stops either."""
    free = without_contact(system)
    omega = undamped_modes(free).omega
    rates = [*omega[(omega > 0.0) & (omega * t_end >= UNNOTICED)], *free.drive.frequencies]
    if not rates and not system.contacts:
        remedy = "give it stiffness or a Harmonic load, or a longer run"
        raise InputError("system", "no oscillation", "have a frequency without its stops", remedy)
    return 2.0 * np.pi / min(rates) if rates else 0.0


def without_contact(system: System) -> System:
    """The system without its stops; ``tip`` is unchanged."""
    row = system.channels[system.tip_channel][0]
    return replace(system, contacts=(), observe=row)


def smooth_motion(system: System) -> System:
    """The system without contact on its slow motion: the steady response to the drive plus the lowest mode.

    Initial data at rest excite every mode of the grid, and no step of interest resolves the highest. The
    lowest mode that swings starts with the size of the steady motion, or 1 where nothing drives the system. Sampled
    loads, which excite every mode and have no steady response, are left out.
    """
    system = without_contact(system)
    loads = [(p, f) for p, f in system.load_terms if np.any(p) and not isinstance(f, Sampled)]
    system = replace(system, loads=tuple(loads))
    y = steady_state(system)
    # The steady motion at t = 0.
    q, v = y[0] + np.sum(y[2::2], axis=0), np.array(system.drive.frequencies) @ y[1::2]
    # Its amplitude, whatever the phase of the drive: a sine starts at 0.
    size = float(np.max(np.abs(y[0]) + np.sum(np.hypot(y[1::2], y[2::2]), axis=0))) or 1.0
    natural = modes(system)
    lowest = int(np.argmax((natural.omega > 0.0) & ~(natural.damping_ratio >= 1.0)))
    shape = size * natural.shapes[:, lowest] / np.max(np.abs(natural.shapes[:, lowest]))
    if natural.coupled:  # a complex shape swings in one phase with its velocity only
        omega, ratio = natural.omega[lowest], natural.damping_ratio[lowest]
        v = v + np.real(omega * (1j * np.sqrt(max(0.0, 1.0 - ratio**2)) - ratio) * shape)
    return replace(system, q0=q + np.real(shape), v0=v)


def steady_state(system: System) -> Array:
    """Y of q = Y^T g(t): the motion in which every load excites its own frequency only; Y is (d, n).

    A mode that a load meets in resonance, or pushes on without holding it, has no steady response to it: none is taken.
    Raises InputError for a sampled load.
    """
    drive = system.drive
    if drive.others:
        remedy = "replace the samples by a Harmonic"
        raise InputError("loads", "a sampled load", "be harmonic or constant for the steady motion", remedy)
    basis, apart = undamped_modes(system), decoupled_modes(system)
    damping = basis.shapes.T @ system.damping @ basis.shapes if apart is None else np.diag(apart.damping)
    forces = basis.force(system.load_amplitudes[: drive.size])
    y = np.zeros_like(forces)
    # The constant loads, then every frequency.
    y[0] = np.real(_response(basis.omega, damping, 0.0, forces[0]))
    for k, frequency in enumerate(drive.frequencies):  # s sin wt + c cos wt = Im (s + i c) e^{iwt}
        sine, cosine = 1 + 2 * k, 2 + 2 * k
        response = _response(basis.omega, damping, frequency, forces[sine] + 1j * forces[cosine])
        y[sine], y[cosine] = np.real(response), np.imag(response)
    return basis.to_nodal(y)


def _response(omega: Array, damping: Array, frequency: float, force: Any) -> Any:
    """x of (Omega^2 - w^2 + i w D) x = force, scaled: rows of stiff modes do not hide soft ones."""
    impedance = np.diag(omega**2 - frequency**2) + 1j * frequency * damping
    size = np.abs(np.diag(impedance))
    # A mode in resonance, or a free one, has no steady response: its empty row becomes that of the identity.
    none = size == 0.0
    scale = 1.0 / np.sqrt(np.where(none, 1.0, size))
    impedance = scale[:, None] * impedance * scale
    impedance[np.diag_indices_from(impedance)] += none
    return np.where(none, 0.0, scale * np.linalg.solve(impedance, scale * force))
