"""Amplitude spectra over whole periods of the drive."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from ..basics.arrays import Array

EVEN = 1e-6  # of the mean step: steps that differ by less are of one length


def amplitude_spectrum(t: Array, u: Array, drive: float, v: Array | None = None) -> tuple[Array, Array]:
    """Angular frequencies and amplitudes of u over as many whole drive periods as fit, counted from the end.

    A sinusoid A sin(w t) on a bin shows the amplitude A. Where times are not equidistant u is resampled, as often, from
    the cubic through it and its velocity v (k,), by default a spline's.
    """
    t, u = _equidistant(t, u, v)
    n = whole_periods(t, drive)
    signal, dt = u[-n:], float(t[1] - t[0])
    amplitude = np.abs(np.fft.rfft(signal)) * 2.0 / n
    amplitude[0] /= 2.0
    return 2.0 * np.pi * np.fft.rfftfreq(n, dt), amplitude


def _equidistant(t: Array, u: Array, v: Array | None) -> tuple[Array, Array]:
    """t and u (k,), resampled where the steps are not of one length."""
    if np.ptp(np.diff(t)) <= EVEN * (t[-1] - t[0]) / (len(t) - 1):
        return t, u
    even = np.linspace(t[0], t[-1], len(t))
    return even, (CubicSpline(t, u) if v is None else CubicHermiteSpline(t, u, v))(even)


def whole_periods(t: Array, drive: float) -> int:
    """The samples of as many whole drive periods as fit into t, all intervals where not one does."""
    n = len(t) - 1
    if not drive:
        return n
    period, dt = 2.0 * np.pi / drive, float(t[1] - t[0])
    return round(np.floor((t[-1] - t[0]) / period * (1 + 1e-12)) * period / dt) or n


def drive_amplitude(t: Array, u: Array, drive: float) -> Array:
    """The complex amplitude (M,) of every tip u (M, k) at the drive frequency, over whole periods counted from the end.

    NaN where t (k,) does not hold a period, and without a drive.
    """
    if not drive or t[-1] * drive < 2.0 * np.pi:
        return np.full(len(u), np.nan + 0j)
    periods = np.floor(t[-1] * drive / (2.0 * np.pi) * (1.0 + 1e-12))
    here = t > t[-1] - 2.0 * np.pi * periods / drive * (1.0 + 1e-12)
    return 2.0 * np.mean(u[:, here] * np.exp(-1j * drive * t[here]), axis=1)
