"""Peaks of an amplitude spectrum, named as multiples of the driving frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffbeam.basics.arrays import Array

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
    peaks = []
    for i in range(1, last + 1):
        if amplitude[i] < amplitude[i - 1] or amplitude[i] <= amplitude[i + 1] or amplitude[i] < THRESHOLD * floor[i]:
            continue
        nearest = round(i * width)
        order = nearest if nearest >= 1 and abs(i * width - nearest) < 0.5 * width else 0
        above = float(amplitude[i] / floor[i]) if floor[i] > 0.0 else float("inf")
        peaks.append(Peak(float(i * width), order, float(amplitude[i]), above))
    return peaks


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
