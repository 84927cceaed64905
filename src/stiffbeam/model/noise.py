"""Noise as records: reproducible from a seed, so that it can be given to schemes, references and ensembles alike."""

from __future__ import annotations

import numpy as np

from ..basics.budget import afford
from ..basics.validation import InputError, integer, non_negative, positive
from .sampled import Sampled

NUMBERS = 24.0  # kept for each sample at most, with the coefficients of its cubic
PER_PERIOD = 16  # samples in the shortest period: the spline between them is off by 1e-4 of it


def noise(t_end: float, rms: float, band: tuple[float, float], seed: int) -> Sampled:
    """f(t) = rms sqrt(2/n) sum_k cos(w_k t + phase_k) on [0, t_end], as a cubic record.

    w_k: the n multiples of 2 pi/t_end in ``band`` = (low, high), angular frequencies; phases uniform, from ``seed``.
    Its spectrum is flat in the band and nothing outside, its mean square over t_end rms^2. Raises InputError for a
    band without a multiple of 2 pi/t_end.
    """
    base = 2.0 * np.pi / positive("t_end", t_end)
    low, high = non_negative("band", band[0]), positive("band", band[1])
    count = PER_PERIOD * np.floor(high / base * (1 + 1e-12))
    afford("band", tuple(band), "lower its upper end, or shorten t_end", floats=NUMBERS * count)
    count = int(count)
    k = np.arange(max(1, int(np.ceil(low / base))), count // PER_PERIOD + 1)
    if not len(k):
        raise InputError("band", tuple(band), f"hold a multiple of 2 pi/t_end = {base:.6g}", "widen it")
    phases = np.random.default_rng(integer("seed", seed, 0)).uniform(0.0, 2.0 * np.pi, len(k))
    spectrum = np.zeros(count // 2 + 1, complex)
    spectrum[k] = 0.5 * count * np.exp(1j * phases)  # irfft gives sum_k cos(2 pi j k/count + phase_k) at sample j
    values = positive("rms", rms) * np.sqrt(2.0 / len(k)) * np.fft.irfft(spectrum, count)
    return Sampled(np.linspace(0.0, t_end, count + 1), np.append(values, values[0]), "cubic")


def random_phases(record: Sampled, seed: int) -> Sampled:
    """Another record with the amplitude spectrum of an equidistant one, and phases from ``seed``.

    The mean and the mean square of its values are the record's; its last sample repeats the first. Raises InputError
    for times that are not equidistant.
    """
    step = np.diff(record.t)
    if len(step) < 3 or np.ptp(step) > 1e-6 * step[0]:
        raise InputError("record", record, "have equidistant samples", "sample it: Sampled(t, record.value(t), kind)")
    values = record.value(record.t)[:-1]
    spectrum = np.fft.rfft(values)
    phases = np.random.default_rng(integer("seed", seed, 0)).uniform(0.0, 2.0 * np.pi, len(spectrum))
    phases[0] = 0.0
    if len(values) % 2 == 0:
        phases[-1] = 0.0  # a real record has a real last line
    new = np.fft.irfft(spectrum * np.exp(1j * phases), len(values))
    return Sampled(record.t, np.append(new, new[0]), record.kind)
