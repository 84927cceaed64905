"""Noise as a load: a record from a spectrum.

    python studies/how-to/noise.py

    f(t) = rms sqrt(2/n) sum_k cos(w_k t + phase_k)

The w_k are the n multiples of 2 pi/t_end in a band of angular frequencies, the phases are random. The spectrum is flat
in the band and zero outside, and the mean square over t_end is rms^2. For another spectrum give each line its own
amplitude. For a measured record keep the amplitudes of its FFT and draw new phases. The script drives an oscillator
between stops with six records of one spectrum and prints the scatter of the impacts.
"""

import numpy as np

import stiffbeam as sb

PER_PERIOD = 16  # samples in the shortest period: the spline between them is off by 1e-4 of it


def noise(t_end: float, rms: float, band: tuple[float, float], rng: int) -> sb.Sampled:
    """Return a cubic record on [0, t_end]; band: lowest and highest angular frequency."""
    base = 2.0 * np.pi / t_end
    last = int(band[1] / base * (1 + 1e-12))
    k = np.arange(max(1, int(np.ceil(band[0] / base))), last + 1)  # from 1: the mean is zero
    count = PER_PERIOD * last
    lines = np.zeros(count // 2 + 1, complex)
    lines[k] = 0.5 * count * np.exp(1j * np.random.default_rng(rng).uniform(0.0, 2.0 * np.pi, len(k)))
    values = rms * np.sqrt(2.0 / len(k)) * np.fft.irfft(lines, count)
    return sb.Sampled(np.linspace(0.0, t_end, count + 1), np.append(values, values[0]), "cubic")


if __name__ == "__main__":
    contact = sb.Contact([1.0], sb.Stops(lower=-0.3, upper=0.3, stiffness=400.0))
    systems = [
        sb.System.from_matrices(
            [[1.0]], [[4.0]], [[0.2]], loads=[([1.0], noise(100.0, 2.0, (0.5, 6.0), seed))], contacts=[contact]
        )
        for seed in range(6)
    ]
    many = sb.integrate_ensemble(systems[0], sb.Trapezoidal(), 2e-3, 100.0, systems)
    assert abs(np.std(noise(100.0, 2.0, (0.5, 6.0), 0).values[:-1]) / 2.0 - 1.0) < 1e-12  # rms
    count = many.contacts[0].impact_count
    print(f"{count.mean():.0f} impacts, from {count.min()} to {count.max()}")
