"""Peaks and multiples on signals whose lines are known."""

from __future__ import annotations

import numpy as np
import pytest

from dumont2002.peaks import THRESHOLD, band, even_over_odd, find_peaks, multiple_amplitudes, share_off_multiples
from stiffbeam.measures.frequencies import amplitude_spectrum

DRIVE = 10.0


def spectrum(lines, noise=0.0, periods=12, seed=0):
    """Of sum A sin(k a t + 1) over (k, A) in ``lines``, with white noise."""
    t = np.linspace(0.0, periods * 2 * np.pi / DRIVE, periods * 800 + 1)
    u = sum(size * np.sin(k * DRIVE * t + 1.0) for k, size in lines)
    return amplitude_spectrum(t, u + noise * np.random.default_rng(seed).normal(size=len(t)), DRIVE)


def test_every_line_is_found_named_and_measured():
    lines = [(1, 1.0), (3, 0.3), (5, 0.1), (6, 0.02)]
    peaks = find_peaks(*spectrum(lines, noise=1e-3), DRIVE)
    assert [p.name for p in peaks] == ["a", "3a", "5a", "6a"]
    # White noise of deviation s has amplitude s sqrt(2/n) a bin: 2e-5 with 9600 samples.
    assert [p.amplitude for p in peaks] == pytest.approx([size for _, size in lines], abs=1e-4)


def test_a_line_between_the_multiples_is_named_by_its_ratio():
    peaks = find_peaks(*spectrum([(1, 1.0), (6.25, 0.2)], noise=1e-3), DRIVE)
    assert [p.name for p in peaks] == ["a", "6.2a"]
    assert [p.order for p in peaks] == [1, 0]


def test_noise_alone_has_no_peak_but_by_its_tail():
    # A Rayleigh amplitude exceeds 4 medians in one bin of 2^16; the median of 49 bins is itself 10 % uncertain,
    # which makes it 1.1e-4. 50 spectra of 186 bins: 1.0 expected, and 6 or more in one of 1700 trials.
    counts = [len(find_peaks(*spectrum([], noise=1.0, seed=seed), DRIVE)) for seed in range(50)]
    assert sum(counts) <= 5
    assert pytest.approx(4.0) == THRESHOLD


def test_multiples_are_read_off_their_bins():
    omega, amplitude = spectrum([(1, 1.0), (2, 0.5), (4, 0.25), (7.5, 3.0)])
    found = multiple_amplitudes(omega, amplitude, DRIVE, 5)
    assert found == pytest.approx([1.0, 0.5, 0.0, 0.25, 0.0], abs=1e-12)


def test_even_over_odd_is_one_for_a_geometric_decay_and_shows_a_preference():
    # (2, 3), (4, 5), ...: with a ratio r between neighbours every pair gives 1/r.
    decay = 0.8 ** np.arange(15)
    assert even_over_odd(decay) == pytest.approx(1 / 0.8)
    odd_only = np.where(np.arange(1, 16) % 2 == 1, decay, 1e-6 * decay)
    assert even_over_odd(odd_only) == pytest.approx(1e-6 / 0.8)


def test_share_off_multiples_is_that_of_the_lines_beside_them():
    assert share_off_multiples(*spectrum([(1, 1.0), (3, 0.5)]), DRIVE) < 1e-20
    assert share_off_multiples(*spectrum([(1, 1.0), (3.5, 0.5)]), DRIVE) == pytest.approx(0.25 / 1.25)
    noise = np.mean([share_off_multiples(*spectrum([], noise=1.0, seed=seed), DRIVE) for seed in range(20)])
    assert noise == pytest.approx(11 / 12, abs=0.02)  # 12 bins a multiple, one of them on it


def test_a_band_is_filled_by_noise_and_not_by_lines():
    # 12 bins a multiple, 186 to 15.5 of them: three lines are 3/186.
    assert band(*spectrum([(1, 1.0), (3, 0.3), (5.25, 0.1)]), DRIVE) == pytest.approx(3 / 186)
    # Rayleigh amplitudes: the largest of 186 is near sqrt(ln 186) = 2.3 rms, below a hundredth of it are 5e-4.
    assert band(*spectrum([], noise=1.0), DRIVE) > 0.98
    assert band(*spectrum([(1, 1.0)], noise=1e-4), DRIVE) == pytest.approx(1 / 186)
