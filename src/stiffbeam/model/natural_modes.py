"""Natural modes with damping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from ..basics.arrays import Array
from ..basics.validation import InputError, integer
from . import modes as decoupled
from .system import System, require_system


@dataclass(frozen=True, eq=False)
class NaturalModes:
    """Free motions of a system away from its stops, slowest first.

    Where the damping does not couple the modes, k = n and

        q = shape eta,   eta'' + 2 ratio omega eta' + omega^2 eta = 0,

    with the undamped frequency omega; the ratio is NaN for a rigid motion, omega = 0. Where it does couple them, a mode
    is q = Re(shape e^(lambda t)) with (lambda^2 M + lambda C + K) shape = 0 and a complex shape,

        omega = |lambda|,   ratio = -Re lambda / |lambda|,

    one for every pair of conjugate lambda, and one of ratio 1 for every real lambda, a motion that only decays; then
    k > n. For one underdamped degree of freedom the two definitions agree.

    Parameters
    ----------
    omega : array (k,)
        Angular frequencies.
    shapes : array (n, k)
        A column per mode, shape^H M shape = 1, its largest entry positive.
    damping_ratio : array (k,)
    coupled : bool
        True where the damping couples the modes.
    """

    omega: Array
    shapes: Array
    damping_ratio: Array
    coupled: bool

    def __repr__(self) -> str:
        lines = [f"{'':4}{'omega':>14}{'damping ratio':>16}"]
        lines += [
            f"{j + 1:4d}{w:14.6g}{z:16.4g}" for j, (w, z) in enumerate(zip(self.omega, self.damping_ratio, strict=True))
        ]
        return "\n".join(lines if len(lines) <= 21 else [*lines[:20], f"    ... {len(self.omega)} modes"])


def modes(system: System, count: int | None = None) -> NaturalModes:
    """Return the natural modes of a system away from its stops, whatever its damping.

    Parameters
    ----------
    system : System
    count : int, optional
        Number of the slowest modes; by default all. For models of thousands of unknowns see ``reduce_model``.

    Returns
    -------
    NaturalModes

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
    basis = decoupled.modes(system)
    if basis is None:
        omega, shapes, decay = _complex_modes(system)
    else:
        omega, shapes, decay = basis.omega, basis.shapes, 0.5 * basis.damping
    if count is not None and count > len(omega):
        raise InputError("count", count, f"be at most {len(omega)}, all modes", "leave it out for all")
    ratio = np.divide(decay, omega, out=np.full(len(omega), np.nan), where=omega > 0.0)
    return NaturalModes(omega[:count], shapes[:, :count], ratio[:count], coupled=basis is None)


def _complex_modes(system: System) -> tuple[Array, Array, Array]:
    """|lambda|, shapes and -Re lambda by the first-order form in undamped modal coordinates, scaled by their
    frequencies."""
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
    return np.abs(values), shapes, -np.real(values)
