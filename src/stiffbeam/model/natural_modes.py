"""Natural modes with damping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg

from ..basics.validation import InputError, integer
from . import modes as decoupled
from .modes import Modes
from .system import System, require_system


def modes(system: System, count: int | None = None) -> Modes:
    """Return the natural modes of a system away from its stops, whatever its damping.

    Parameters
    ----------
    system : System
    count : int, optional
        Number of the slowest modes; by default all. For models of thousands of unknowns see ``reduce_model``.

    Returns
    -------
    Modes

    Raises
    ------
    InputError
        For anything but a System, and for more modes than there are.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.modes(sb.System.from_matrices([[2.0]], [[8.0]], damping=[[0.4]], observe=[1.0])).omega
    array([2.])
    """
    require_system(system)
    if count is not None:
        integer("count", count, 1)
    found = decoupled.modes(system) or _complex_modes(system)
    if count is not None and count > len(found.omega):
        raise InputError("count", count, f"be at most {len(found.omega)}, all modes", "leave it out for all")
    return replace(found, omega=found.omega[:count], shapes=found.shapes[:, :count], damping=found.damping[:count])


def _complex_modes(system: System) -> Modes:
    """The modes by the first-order form in undamped modal coordinates, scaled by their frequencies."""
    # In undamped modes the matrices are diagonal but for the damping.
    basis = decoupled.undamped_modes(system)
    n, scale = system.size, np.where(basis.omega > 0.0, basis.omega, 1.0)
    # z = (scale eta, eta'): entries of one size, so that the slow eigenvalues are as good as the fast ones.
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.diag(scale)
    A[n:, :n] = -np.diag(basis.omega**2 / scale)
    A[n:, n:] = -basis.shapes.T @ system.damping @ basis.shapes
    values, left, vectors = (np.asarray(part, complex) for part in scipy.linalg.eig(A, left=True))
    # One of each conjugate pair, and the real ones.
    kept = np.imag(values) >= 0.0
    values, vectors = values[kept], vectors[:, kept]
    x, y = vectors[:n] / scale[:, None], np.conj(left[n:, kept])
    # An algorithm errs by eps of the largest eigenvalue in all of them: two of Newton's steps on the stationary form
    # y^T (lambda^2 + lambda D + Omega^2) x, which is as good as a slow motion is slow; none where it is flat.
    a, b, c = (np.sum(y * z, axis=0) for z in (x, -A[n:, n:] @ x, basis.omega[:, None] ** 2 * x))
    for _ in range(2):
        slope = 2.0 * a * values + b
        single = np.abs(slope) > 1e-2 * (2.0 * np.abs(a * values) + np.abs(b))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            off = -((a * values + b) * values + c) / slope
        values = values + np.where(single & np.isfinite(off), off, 0.0)
    order = np.argsort(np.abs(values), kind="stable")
    values, shapes = values[order], basis.shapes @ (vectors[:n, order] / scale[:, None])
    # Unit norm in M, and the phase at which the largest entry is real and positive.
    norms = np.sqrt(np.real(np.sum(np.conj(shapes) * (system.mass @ shapes), axis=0)))
    largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(shapes.shape[1])]
    shapes = shapes / np.where(norms > 0.0, norms, 1.0) * np.conj(largest) / np.where(largest == 0, 1, np.abs(largest))
    return Modes(np.abs(values), shapes, -2.0 * np.real(values), system.mass, coupled=True)
