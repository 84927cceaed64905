"""Amplitude spectra over whole periods of the drive, and their peaks."""

from __future__ import annotations

from dataclasses import dataclass

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


THRESHOLD = 4.0  # times the local median: white noise exceeds it in one bin of 10^4
REACH = 2.0  # the median is taken over +- so many drive frequencies
MULTIPLES = 15
EXCITED = 0.01  # of the largest amplitude, from which on a frequency counts as excited


@dataclass(frozen=True)
class Peak:
    """A local maximum that stands THRESHOLD times above its surroundings.

    multiple: its frequency over the drive's. order: the whole number it is within half a bin, 0 for none.
    above: its amplitude over the local median.
    """

    multiple: float
    order: int
    amplitude: float
    above: float

    @property
    def name(self) -> str:
        """``a``, ``3a``, or ``6.1a`` for a peak between the multiples."""
        return ("" if self.order == 1 else f"{self.order}") + "a" if self.order else f"{self.multiple:.1f}a"


def find_peaks(omega: Array, amplitude: Array, drive: float, highest: float = MULTIPLES + 0.5) -> list[Peak]:
    """The peaks of a spectrum over whole drive periods below ``highest`` multiples, ascending in frequency.

    ``omega`` is equally spaced from 0 and the drive lies on a bin, as ``amplitude_spectrum`` makes it.
    """
    width = omega[1] / drive  # of a bin, in multiples
    last = min(len(omega) - 2, int(highest / width))
    floor = local_median(omega, amplitude, drive)
    found = []
    for i in range(1, last + 1):
        if amplitude[i] < amplitude[i - 1] or amplitude[i] <= amplitude[i + 1] or amplitude[i] < THRESHOLD * floor[i]:
            continue
        nearest = round(i * width)
        order = nearest if nearest >= 1 and abs(i * width - nearest) < 0.5 * width else 0
        above = float(amplitude[i] / floor[i]) if floor[i] > 0.0 else float("inf")
        found.append(Peak(float(i * width), order, float(amplitude[i]), above))
    return found


def local_median(omega: Array, amplitude: Array, drive: float) -> Array:
    """The median amplitude within REACH drive frequencies of each bin, the mean (bin 0) left out."""
    half = max(3, round(REACH * drive / omega[1]))
    padded = np.pad(amplitude[1:], half, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    return np.concatenate([[np.nan], np.median(windows, axis=1)])


def multiple_amplitudes(omega: Array, amplitude: Array, drive: float, count: int = MULTIPLES) -> Array:
    """Amplitudes (count,) at the drive frequency and its multiples 2 .. count."""
    return amplitude[np.round(np.arange(1, count + 1) * drive / omega[1]).astype(int)]


def even_over_odd(amplitudes: Array, first: int = 2) -> float:
    """Geometric mean of the even multiples over that of the odd ones, from multiple ``first`` on, in pairs.

    Of multiples first .. first + 2 m - 1, so that a decay with frequency weighs on both alike: 0 for a
    motion that changes sign with half a drive period, 1 where both are equal.
    """
    orders = np.arange(1, len(amplitudes) + 1)
    pairs = (len(amplitudes) - first + 1) // 2
    used = (orders >= first) & (orders < first + 2 * pairs)
    with np.errstate(divide="ignore"):
        logs = np.log(amplitudes)
    even, odd = logs[used & (orders % 2 == 0)], logs[used & (orders % 2 == 1)]
    return float(np.exp(np.mean(even) - np.mean(odd)))


def share_off_multiples(omega: Array, amplitude: Array, drive: float, count: int = MULTIPLES) -> float:
    """The share of sum A^2, from half the drive frequency to ``count`` + 1/2 of it, outside the multiples' bins.

    0 for a periodic motion; for noise without any line the share of the other bins, 1 - drive bin/period.
    """
    per_drive = round(drive / omega[1])
    bins = np.arange((per_drive + 1) // 2, min(len(amplitude), int((count + 0.5) * per_drive) + 1))
    power = amplitude[bins] ** 2
    total = float(np.sum(power))
    return float(np.sum(power[bins % per_drive != 0])) / total if total else 0.0


def band(omega: Array, amplitude: Array, drive: float, count: int = MULTIPLES) -> float:
    """The share of the bins up to ``count`` + 1/2 drive frequencies with more than EXCITED of the largest amplitude.

    1 over the bins per multiple for a few lines, towards 1 for a band that is filled.
    """
    bins = amplitude[1 : int((count + 0.5) * drive / omega[1]) + 1]
    return float(np.mean(bins > EXCITED * np.max(bins)))
