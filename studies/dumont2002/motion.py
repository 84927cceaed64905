"""Spectrum, regularity and fast motion of one tip."""

from __future__ import annotations

from typing import Any

import numpy as np

from stiffbeam.basics.arrays import Array
from stiffbeam.measures.frequencies import amplitude_spectrum
from stiffbeam.model.beam import natural_frequencies

from .peaks import band, even_over_odd, find_peaks, multiple_amplitudes, share_off_multiples
from .table import Made


def motion(t: Array, u: Array, v: Array, made: Made) -> dict[str, Any]:
    """Measures of a tip u and its velocity v at equally spaced times, over whole drive periods.

    aperiodicity: rms of u(t + T) - u(t) over sqrt(2) times the rms of u about its mean, over the second
    half, T the drive's period: 0 for a periodic motion, about 1 where nothing is left of it; rate_ and
    stress_aperiodicity: the same of v and of the stops' force. rms: of u. fast: the rms tip velocity from
    frequencies above the second natural one; resolved and beyond: its parts below and above the frequency
    of mode M/4, up to which the grid's modes are the beam's to a tenth. fast_share: its share of the whole.
    """
    drive = made.drive
    omega, amplitude = amplitude_spectrum(t, u, drive)
    multiples = multiple_amplitudes(omega, amplitude, drive)
    rates, speed = amplitude_spectrum(t, v, drive)
    natural = natural_frequencies(made.case.problem, max(2, made.case.cells // 4))
    second, limit = float(natural[1]), float(natural[-1])

    def rms(chosen: Array) -> float:
        return float(np.sqrt(np.sum(speed[chosen] ** 2) / 2.0))

    fast = rms(rates > second)
    return {
        "peaks": [
            {"name": p.name, "multiple": p.multiple, "amplitude": p.amplitude, "above": p.above}
            for p in find_peaks(omega, amplitude, drive)
        ],
        "multiples": multiples.tolist(),
        "even_over_odd": even_over_odd(multiples),
        "band": band(omega, amplitude, drive),
        "off_multiples": share_off_multiples(omega, amplitude, drive),
        "aperiodicity": _change(t, u, drive),
        "rate_aperiodicity": _change(t, v, drive),
        "stress_aperiodicity": _change(t, made.stops.force(u), drive),
        "rms": float(np.sqrt(np.mean(u**2))),
        "fast": fast,
        "resolved": rms((rates > second) & (rates <= limit)),
        "beyond": rms(rates > limit),
        "fast_share": fast / rms(rates > 0.0),
    }


def _change(t: Array, u: Array, drive: float) -> float:
    """The aperiodicity of ``u``; NaN where half of it is hardly longer than a period."""
    shift = round(2.0 * np.pi / drive / float(t[1] - t[0]))
    late = u[len(u) // 2 :]
    if len(late) <= 1.5 * shift:
        return float("nan")
    spread = float(np.std(late))
    if not spread:
        return float("nan")
    return float(np.sqrt(np.mean((late[shift:] - late[:-shift]) ** 2))) / (np.sqrt(2.0) * spread)
