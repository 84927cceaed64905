"""Errors of free oscillations: of one step, as a function of dt over the period, and of a run, mode by mode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.resources import afford
from ..basics.validation import InputError, number, numbers, one_of
from ..march.propagator import components
from ..model.equations import Equation
from ..model.modes import modes
from ..schemes import Scheme
from ..schemes.scheme import require_scheme
from ..trajectory.trajectory import Trajectory

SOURCES = ("kernel", "closed form")
EPS = float(np.finfo(float).eps)
SHORTEST, LONGEST = 1e-12, 1e12  # dt/T: beyond it the square of omega dt is rounding, or all there is
STABLE = 1e-9  # a radius above 1 by less is rounding


@dataclass(frozen=True, eq=False)
class Amplification:
    """One step on q'' + 2 xi w q' + w^2 q = 0, T = 2 pi/w; every array has the shape of ``dt_over_period``.

    lambda is the principal root, the complex one of largest modulus, and its frequency is W dt = |arg lambda| in
    (0, pi). Beyond dt/T = 1/2 the sampled oscillation is aliased, and W is that of the alias.

    Parameters
    ----------
    scheme : Scheme
    dt_over_period : array
    spectral_radius : array
        max |root|: a scheme is unstable where it exceeds 1.
    period_elongation : array
        w_d/W - 1 with w_d = w sqrt(1 - xi^2): positive means a longer period, so the scheme lags. NaN where the
        principal roots are real, 0 below their rounding.
    damping_ratio : array
        -ln |lambda|/sqrt(ln^2 |lambda| + (W dt)^2): xi itself for the exact flow. NaN where the principal roots are
        real.

    References
    ----------
    Hughes, The Finite Element Method (1987), Section 9.3.
    """

    scheme: Scheme
    dt_over_period: Array
    spectral_radius: Array
    period_elongation: Array
    damping_ratio: Array

    def __repr__(self) -> str:
        x = np.atleast_1d(self.dt_over_period)
        return f"<Amplification of {self.scheme} at {x.size} dt/T, {np.min(x):g} to {np.max(x):g}>"

    @property
    def stable_to(self) -> float:
        """The largest of dt_over_period up to which the radius stays <= 1; inf: at all of them."""
        order = np.argsort(self.dt_over_period)
        x, unstable = self.dt_over_period[order], self.spectral_radius[order] > 1.0 + STABLE
        if not np.any(unstable):
            return float("inf")
        first = int(np.argmax(unstable))
        return float(x[first - 1]) if first else 0.0


def amplification(
    scheme: Scheme, dt_over_period: ArrayLike, damping_ratio: float = 0.0, source: str = "kernel"
) -> Amplification:
    """Return spectral radius, period elongation and damping ratio of a scheme on the linear oscillator.

    Parameters
    ----------
    scheme : Scheme
    dt_over_period : array_like
        dt/T > 0.
    damping_ratio : float
        Physical damping xi in [0, 1).
    source : {"kernel", "closed form"}
        "kernel": eigenvalues of the step that the march uses. "closed form": roots of the scheme's
        characteristic polynomial, for schemes that state one.

    Returns
    -------
    Amplification
        Arrays of the shape of ``dt_over_period``.

    Raises
    ------
    InputError
        For steps that are not positive, a damping ratio outside [0, 1), and a closed form that is not stated.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> answer = sb.amplification(sb.Trapezoidal(), [0.1])
    >>> float(answer.spectral_radius[0].round(12)), float(answer.period_elongation[0].round(4))
    (1.0, 0.0321)
    """
    rule = f"be one or more positive numbers from {SHORTEST:g} to {LONGEST:g}, in one dimension"
    x = np.atleast_1d(numbers("dt_over_period", dt_over_period, rule))
    if x.ndim != 1 or not x.size or not np.all((x >= SHORTEST) & (x <= LONGEST)):
        raise InputError("dt_over_period", dt_over_period, rule, "for example [0.01, 0.1]")
    xi = number("damping_ratio", damping_ratio)
    if not 0.0 <= xi < 1.0:
        raise InputError("damping_ratio", damping_ratio, "lie in [0, 1)", "for example 0.02")
    one_of("source", source, SOURCES)
    require_scheme(scheme)
    afford("dt_over_period", f"{x.size} numbers", "ask for fewer at once", floats=200.0 * x.size)
    roots = _kernel_roots(scheme, x, xi) if source == "kernel" else _closed_roots(scheme, x, xi)
    # A real pair may leave the axis by the square root of rounding.
    complex_ones = np.abs(np.imag(roots)) > 1e-7 * np.abs(roots)
    # A real root counts only where no root is complex.
    principal = roots[np.arange(len(x)), np.argmax(np.where(complex_ones, np.abs(roots), -1.0), axis=1)]
    with np.errstate(divide="ignore", invalid="ignore"):
        phase = np.where(np.any(complex_ones, axis=1), np.abs(np.angle(principal)), np.nan)
        decay = -np.log(np.abs(principal))
        elongation = 2.0 * np.pi * x * np.sqrt(1.0 - xi**2) / phase - 1.0
        ratio = decay / np.hypot(decay, phase)
        # Roots near one are known to EPS/phase: what is less than they round is none.
        elongation = np.where(np.abs(elongation) <= EPS / phase**2, 0.0, elongation)
        ratio = np.where(np.abs(ratio) <= 4.0 * EPS / phase, 0.0, ratio)
    return Amplification(scheme, x, np.max(np.abs(roots), axis=1), elongation, ratio)


def _kernel_roots(scheme: Scheme, x: Array, xi: float) -> Array:
    """Eigenvalues (len(x), a) of a step with dt = 1 on independent oscillators, from unit states."""
    omega = 2.0 * np.pi * x
    equation, n = Equation(np.ones_like(omega), 2.0 * xi * omega, omega**2), len(x)
    units = np.eye(components(scheme, equation, n))[..., None] * np.ones(n)
    none = [np.zeros(units.shape[1:])] * len(scheme.nodes)
    return np.linalg.eigvals(np.transpose(scheme.step(equation, 1.0, units, none, none)[0], (2, 0, 1)))


def _closed_roots(scheme: Scheme, x: Array, xi: float) -> Array:
    """Roots (len(x), degree) of the characteristic polynomial."""
    polynomials: list[Any] = [scheme.characteristic(value, xi) for value in 2.0 * np.pi * x]
    if polynomials[0] is None:
        raise InputError("scheme", str(scheme), "state its characteristic polynomial", "use source='kernel'")
    return np.array([np.roots(coefficients) for coefficients in polynomials])


START = 0.1  # the share of the run left out, in which a scheme's parasitic roots die
FLOOR = 1e-8  # of its first amplitude: below it a mode is rounding


@dataclass(frozen=True, eq=False)
class ModeErrors:
    """A run's free oscillations against w, xi of its system; every array (n,), ascending in omega.

    For a mode x with (lambda^2 M + lambda C + K) x = 0, lambda = -xi w + i w_d, let z = x^T (M q' + lambda M q + C q).
    The exact flow is z(t) = z(0) e^{lambda t}, whether the damping couples the modes or not;
    ln(z_run/z_ref) of the run is a straight line with slope s - i m:

        period_elongation  m/(w_d - m)                              > 0: late
        damping_ratio      (xi w - s)/hypot(xi w - s, w_d - m)      the exact flow has xi

    NaN if the mode is not excited, dies within a few steps, turns by more than half a circle per step against the exact
    one, or is not followed for half a period. A scheme adds to z a part that turns like e^{-2 i w t}, and less than one
    turn of it would count as slope.
    """

    omega: Array
    period_elongation: Array
    damping_ratio: Array


def free_mode_errors(run: Trajectory) -> ModeErrors:
    """The ModeErrors of a run without loads, whose contacts (if any) stay open, with every step on output.

    Raises InputError where loads or impacts drive the modes.
    """
    system = run.system
    if system is None:
        raise InputError("run", "a loaded file", "come from integrate", "integrate again")
    if system.loads or any(contact.fraction for contact in run.contacts):
        raise InputError("run", "a run with loads or impacts", "be free", "take the loads and stops away")
    if system.gyroscopic:  # the left eigenvectors, which filter a mode out, are not the shapes
        rule = "have a symmetric damping matrix for the errors of each mode"
        raise InputError("damping", "an unsymmetric matrix", rule, "compare the run with a reference")
    natural, (q, v) = modes(system), run.states
    ratio = np.nan_to_num(natural.damping_ratio)
    decay, omega_d = ratio * natural.omega, np.sqrt(np.maximum(1.0 - ratio**2, 0.0)) * natural.omega
    inertia = system.mass @ natural.shapes
    z = v @ inertia + q @ (inertia * (-decay + 1j * omega_d) + system.damping @ natural.shapes)
    n = len(natural.omega)
    slopes = np.full((2, n), np.nan)
    scale = float(np.max(np.abs(z[0])))
    for j in range(n):
        # A mode that is hardly excited is rounding, and so is what is left of it when it has died.
        ratio = z[:, j] / z[0, j] if abs(z[0, j]) > FLOOR * scale else np.zeros(0)
        alive = int(np.argmin(np.abs(ratio) > FLOOR)) if np.any(~(np.abs(ratio) > FLOOR)) else len(ratio)
        first = int(np.ceil(START * alive))
        t = run.t[first:alive]
        # Over less than half a period, a turn of e^{-2 i w t}, the part of z that a scheme adds would count as slope.
        if len(t) < 20 or not omega_d[j] * (t[-1] - t[0]) >= np.pi:
            continue
        ratio = ratio[first:alive]
        phase = np.unwrap(np.angle(ratio * np.exp(-1j * omega_d[j] * t)))
        # A phase that turns by about half a circle a step cannot be unwrapped.
        if np.max(np.abs(np.diff(phase))) > 0.9 * np.pi:
            continue
        lines = np.log(np.abs(ratio)) + decay[j] * t, phase  # ln(z_run/z_ref)
        slopes[:, j] = np.polyfit(t, np.transpose(lines), 1)[0]
    frequency = omega_d + slopes[1]  # the phase falls behind: slope -m
    loss = decay - slopes[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return ModeErrors(natural.omega, omega_d / frequency - 1.0, loss / np.hypot(loss, frequency))
