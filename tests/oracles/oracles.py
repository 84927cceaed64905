"""Closed forms of the beam without contact."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq


def beam_roots(count: int) -> np.ndarray:
    """The roots of cos l + 1/cosh l = 0, the clamped-free beam's eigenvalues."""
    f = lambda x: np.cos(x) + 1.0 / np.cosh(x)  # noqa: E731
    return np.array(
        [brentq(f, (i - 0.5) * np.pi - 0.6, (i - 0.5) * np.pi + 0.6, xtol=1e-15) for i in range(1, count + 1)]
    )


def beam_mode(root: float, x: np.ndarray) -> np.ndarray:
    """X(x) = ((sin l + sinh l)/(cos l + cosh l)) (cosh lx - cos lx) + sin lx - sinh lx (Section 5.1).

    Written with decaying exponentials: cosh - sinh cancels for large l.
    """
    r = (np.sin(root) + np.sinh(root)) / (np.cos(root) + np.cosh(root))
    # r cosh(lx) - sinh(lx) = ((r - 1) e^{lx} + (r + 1) e^{-lx})/2, and r - 1 is of size e^{-l}.
    r_minus_1 = (np.sin(root) - np.cos(root) - np.exp(-root)) / (np.cos(root) + np.cosh(root))
    return (
        0.5 * r_minus_1 * np.exp(root * x)
        + 0.5 * (r + 1.0) * np.exp(-root * x)
        - r * np.cos(root * x)
        + np.sin(root * x)
    )


def moving_support_series(k2: float, amplitude: float, a: float, t: np.ndarray, modes: int) -> np.ndarray:
    """Tip of a beam without contact whose clamp moves by E (1 - cos a t), from rest: u = phi + sum X_i T_i.

    T_i'' + l_i^4 k^2 T_i = -phi'' int X_i / int X_i^2, T_i(0) = T_i'(0) = 0, with phi'' = E a^2 cos a t.
    """
    x, w = np.polynomial.legendre.leggauss(400)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    u = amplitude * (1.0 - np.cos(a * t))
    for root in beam_roots(modes):
        X = beam_mode(root, x)
        omega = root**2 * np.sqrt(k2)
        gain = -amplitude * a**2 * (w @ X) / (w @ X**2) / (omega**2 - a**2)
        u = u + beam_mode(root, np.array([1.0]))[0] * gain * (np.cos(a * t) - np.cos(omega * t))
    return u
