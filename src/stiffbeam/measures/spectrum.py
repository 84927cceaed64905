"""Amplitude spectra over whole periods of the drive."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array


def amplitude_spectrum(t: Array, u: Array, drive: float) -> tuple[Array, Array]:
    """Angular frequencies and amplitudes of u over as many whole drive periods as fit, counted from the end.

    A sinusoid A sin(w t) on a bin shows the amplitude A.
    """
    n = whole_periods(t, drive)
    signal, dt = u[-n:], float(t[1] - t[0])
    amplitude = np.abs(np.fft.rfft(signal)) * 2.0 / n
    amplitude[0] /= 2.0
    return 2.0 * np.pi * np.fft.rfftfreq(n, dt), amplitude


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
