"""Independent answers: closed forms and plain loops on arrays and numbers, with NumPy, SciPy and mpmath alone."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import scipy.linalg
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


def exact_linear(
    mass, damping, stiffness, q0, v0, t: np.ndarray, frequency: float, sine, cosine, constant
) -> tuple[np.ndarray, np.ndarray]:
    """q(t), q'(t) of M q'' + C q' + K q = constant + sine sin + cosine cos, by the matrix exponential."""
    n = len(mass)
    A = np.zeros((2 * n + 3, 2 * n + 3))
    inverse = np.linalg.inv(mass)
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n, :n], A[n : 2 * n, n : 2 * n] = -inverse @ stiffness, -inverse @ damping
    A[n : 2 * n, 2 * n :] = np.stack([inverse @ constant, inverse @ sine, inverse @ cosine], axis=1)
    A[2 * n + 1, 2 * n + 2], A[2 * n + 2, 2 * n + 1] = frequency, -frequency
    y0 = np.concatenate([q0, v0, [1.0, 0.0, 1.0]])
    y = np.array([scipy.linalg.expm(A * s) @ y0 for s in t])
    return y[:, :n], y[:, n : 2 * n]


def harmonic_piece(w2, a, w, phase, t_end):
    """What ``between_rigid_walls`` takes of the load a sin(w t + phase) on an undamped oscillator."""
    w2, a, w, phase = map(mp.mpf, (w2, a, w, phase))
    a /= w2 - w**2
    return [(t_end, lambda t: a * mp.sin(w * t + phase), lambda t: a * w * mp.cos(w * t + phase))]


def record_pieces(w2, c, t, values, t_end):
    """What ``between_rigid_walls`` takes of straight lines through samples."""
    w2, c, t, values = mp.mpf(w2), mp.mpf(c), [mp.mpf(float(x)) for x in t], [mp.mpf(float(x)) for x in values]
    pieces = []
    for k in range(len(t) - 1):
        if t[k] < t_end:
            slope = (values[k + 1] - values[k]) / (t[k + 1] - t[k])
            at = lambda s, k=k, m=slope: (values[k] + m * (s - t[k]) - c * m / w2) / w2  # noqa: E731
            pieces.append((min(t[k + 1], mp.mpf(t_end)), at, lambda s, m=slope: m / w2))
    return pieces


def between_rigid_walls(w2, c, walls, e, pieces, x, v, times, digits=60, grid=0.01):
    """x(times) and the times of impacts of x'' + c x' + w2 x = f between walls (None for none), u'+ = -e u'-.

    In mpmath, in closed form from event to event; pieces: (end, p, p'), one after another, with p'' + c p' + w2 p = f.
    Pieces are to be made in as many digits. A motion that comes to rest on a wall is refused.
    """
    w2, c, e, x, v = map(mp.mpf, (w2, c, e, x, v))
    walls = [(side, mp.mpf(wall)) for side, wall in zip((-1, 1), walls, strict=True) if wall is not None]
    beta, damped = c / 2, mp.sqrt(w2 - c**2 / 4)
    t, out, impacts = mp.mpf(0), [], []
    for end, p, dp in pieces:
        while t < end:
            A = x - p(t)
            B = (v - dp(t) + beta * A) / damped

            def path(s, t=t, p=p, A=A, B=B):
                return p(t + s) + mp.exp(-beta * s) * (A * mp.cos(damped * s) + B * mp.sin(damped * s))

            def rate(s, t=t, dp=dp, A=A, B=B):
                turned = (damped * B - beta * A) * mp.cos(damped * s) - (damped * A + beta * B) * mp.sin(damped * s)
                return dp(t + s) + mp.exp(-beta * s) * turned

            h, before, hit = mp.mpf(0), mp.mpf(1e-12), False
            while h < end - t and not hit:
                h = min(h + grid, end - t)
                u = path(h)
                for side, wall in walls:
                    if side * (u - wall) > 0:
                        h = mp.findroot(lambda s, wall=wall: path(s) - wall, (before, h), solver="anderson")
                        hit = True
                        break
                before = h
            while len(out) < len(times) and times[len(out)] <= t + h:
                out.append(float(path(mp.mpf(float(times[len(out)])) - t)))
            x, v, t = path(h), rate(h), t + h
            if hit:
                assert abs(v) > 1e-6, "at rest on a wall"
                x, v = wall, -e * v
                impacts.append(float(t))
    return np.array(out), np.array(impacts)
