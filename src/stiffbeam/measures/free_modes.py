"""Mode by mode on a free run: by how much each frequency is too low and each amplitude decays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.natural_modes import modes
from ..trajectory.trajectory import Trajectory

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

    *_error: the possible error of the fit, 3 max|residual|/(span) for a slope. NaN where the mode is not
    excited, dies within a few steps, turns by more than half a circle per step against the exact one or is not followed
    for half a period: what a scheme adds to z turns like e^{-2 i w t}, and less than one turn of it is taken for slope.
    """

    omega: Array
    period_elongation: Array
    elongation_error: Array
    damping_ratio: Array
    damping_error: Array


def free_mode_errors(run: Trajectory) -> ModeErrors:
    """The ModeErrors of a run without loads, whose contacts (if any) stay open, with every step on output.

    Raises InputError where loads or impacts drive the modes.
    """
    system = run.system
    if system is None:
        raise InputError("run", "a loaded file", "come from integrate", "integrate again")
    if system.loads or any(contact.fraction for contact in run.contacts):
        raise InputError("run", "a run with loads or impacts", "be free", "take the loads and stops away")
    natural, (q, v) = modes(system), run.states
    ratio = np.nan_to_num(natural.damping_ratio)
    decay, omega_d = ratio * natural.omega, np.sqrt(np.maximum(1.0 - ratio**2, 0.0)) * natural.omega
    inertia = system.mass @ natural.shapes
    z = v @ inertia + q @ (inertia * (-decay + 1j * omega_d) + system.damping @ natural.shapes)
    n = len(natural.omega)
    slopes, errors = np.full((2, n), np.nan), np.full((2, n), np.nan)
    scale = float(np.max(np.abs(z[0])))
    for j in range(n):
        ratio = z[:, j] / z[0, j] if abs(z[0, j]) > FLOOR * scale else np.zeros(0)
        alive = int(np.argmin(np.abs(ratio) > FLOOR)) if np.any(~(np.abs(ratio) > FLOOR)) else len(ratio)
        first = int(np.ceil(START * alive))
        t = run.t[first:alive]
        if len(t) < 20 or not omega_d[j] * (t[-1] - t[0]) >= np.pi:
            continue
        ratio = ratio[first:alive]
        phase = np.unwrap(np.angle(ratio * np.exp(-1j * omega_d[j] * t)))
        if np.max(np.abs(np.diff(phase))) > 0.9 * np.pi:
            continue
        lines = np.log(np.abs(ratio)) + decay[j] * t, phase  # ln(z_run/z_ref)
        for i, y in enumerate(lines):
            slope, at_zero = np.polyfit(t, y, 1)
            slopes[i, j] = slope
            errors[i, j] = 3.0 * float(np.max(np.abs(y - at_zero - slope * t))) / (t[-1] - t[0])
    frequency = omega_d + slopes[1]  # the phase falls behind: slope -m
    loss = decay - slopes[0]
    size = np.hypot(loss, frequency)
    with np.errstate(divide="ignore", invalid="ignore"):
        return ModeErrors(
            omega=natural.omega,
            period_elongation=omega_d / frequency - 1.0,
            elongation_error=omega_d / frequency**2 * errors[1],
            damping_ratio=loss / size,
            damping_error=(errors[0] + errors[1] * np.abs(loss) / size) / size,
        )
