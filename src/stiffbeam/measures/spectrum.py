"""Amplitude spectra over whole periods of the drive."""

from __future__ import annotations

import numpy as np

from ..arrays import Array


def amplitude_spectrum(t: Array, u: Array, drive: float) -> tuple[Array, Array]:
    """Angular frequencies and amplitudes of u over as many whole drive periods as fit, counted from the end.

    A sinusoid A sin(w t) on a bin shows the amplitude A.
    """
    dt = float(t[1] - t[0])
    n = len(t) - 1
    if drive:
        period = 2.0 * np.pi / drive
        n = round(np.floor((t[-1] - t[0]) / period * (1 + 1e-12)) * period / dt) or n
    signal = u[-n:]
    amplitude = np.abs(np.fft.rfft(signal)) * 2.0 / n
    amplitude[0] /= 2.0
    return 2.0 * np.pi * np.fft.rfftfreq(n, dt), amplitude
