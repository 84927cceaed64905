"""Natural modes with damping, and the static equilibrium under constant loads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from scipy.optimize import brentq

from ..basics.arrays import Array
from ..basics.validation import InputError, integer, number
from . import modes as decoupled
from .system import System, require_system
from .time_functions import Constant, evaluate, offset_values

STEPS = 200  # of Newton's method on closed and open stops; a handful for linear stops
FARTHEST = 2.0**200  # times a step: nothing stops a motion that long


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


def static_equilibrium(system: System, t: float | None = None) -> Array:
    """Return q (n,) with K q = sum_k p_k f_k + sum_c row_c^T F_c(row_c q + o_c): at rest, contact included.

    It is the least of the convex energy 1/2 q^T K q - sum_k f_k p_k^T q + sum_c U_c, unique where K, or K with the
    springs of the closed stops, is positive definite. To start from it: ``replace(system, q0=q, v0=0 * q)``, or
    ``initial_displacement=q`` of ``System.from_matrices``. The q of a beam is in v = u - phi (1 - (x/L)^2).

    Parameters
    ----------
    system : System
    t : float, optional
        The time at which loads and offsets are taken. Not needed where all are Constant.

    Returns
    -------
    array (n,)

    Raises
    ------
    InputError
        For loads that are not constant without ``t``, for rigid stops, and for a system that neither its stiffness nor
        its closed stops hold.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> floor = sb.Contact([1.0], sb.Stops(lower=0.0, stiffness=1000.0))
    >>> ball = sb.System.from_matrices([[2.0]], [[0.0]], loads=[([1.0], sb.Constant(-20.0))], contacts=[floor])
    >>> sb.static_equilibrium(ball)
    array([-0.02])
    """
    require_system(system)
    for function in system.time_functions if t is None else ():
        if function is not None and not isinstance(function, Constant):
            rule = "be Constant for an equilibrium"
            raise InputError("time function", function, rule, "pass t=0.0 to take every load as it is at that time")
    at = 0.0 if t is None else number("t", t)
    load = sum((p * evaluate(f, at) for p, f in system.loads), np.zeros(system.size))
    rows = np.array([contact.row for contact in system.contacts]).reshape(-1, system.size)
    offsets = np.array([float(offset_values(contact.offset, at)) for contact in system.contacts])
    stops = [contact.stops for contact in system.contacts]

    def force(q: Array) -> Array:
        contact = [float(stop.force(u, 0.0)) for stop, u in zip(stops, rows @ q + offsets, strict=True)]
        return load - system.stiffness @ q + rows.T @ np.array(contact).reshape(-1)

    # Newton's method with the stiffness of the closed stops, each step to the least energy along it: a step through
    # open gaps goes on until stops close.
    q, last = system.q0, np.inf
    for _ in range(STEPS):
        # The springs of the closed stops: a motion that neither they nor K hold has frequency zero.
        slopes = [float(stop.tangent(u)[0]) for stop, u in zip(stops, rows @ q + offsets, strict=True)]
        basis = decoupled.undamped_modes(system, tuple((row, x) for row, x in zip(rows, slopes, strict=True) if x))
        values, shapes, rigid = basis.omega**2, basis.shapes, basis.omega == 0.0
        # Forces on the modes, and the sizes that they sum: a force below their rounding is none.
        pushed = shapes.T @ force(q)
        push = np.sum(np.abs(shapes.T) * (np.abs(load) + np.abs(system.stiffness @ q)), axis=1)
        # A force on a free motion drives along it until a stop closes; otherwise Newton's step.
        free = rigid & (np.abs(pushed) > 1e-12 * push)
        step = shapes @ (np.where(free, pushed, 0.0) if np.any(free) else pushed / np.where(rigid, np.inf, values))
        size, whole = float(np.max(np.abs(step))), float(np.max(np.abs(q + step)))
        # Below 1e-6 of the motion the steps fall with their square, until they are rounding and fall no further.
        if not np.any(free) and size <= 1e-6 * whole and (size <= 1e-14 * whole or size >= 0.1 * last):
            if np.any(rigid):
                break
            return q + step
        last = size

        def along(share: float, q: Array = q, step: Array = step) -> float:
            return float(step @ force(q + share * step))

        # Twice as far until the energy rises: its least point is bracketed then.
        far = 1.0
        while along(far) > 0.0 and far < FARTHEST:
            far *= 2.0
        if far >= FARTHEST:
            break
        newton = abs(along(1.0)) <= 1e-3 * along(0.0)  # the least to that already
        share: Any = 1.0 if newton else brentq(along, 0.0, far)
        q = q + share * step
    rule, remedy = "hold the system, alone or with the stops that the loads close", "support it"
    raise InputError("stiffness", "a rigid motion", rule, f"{remedy}, or march it to rest with damping")
