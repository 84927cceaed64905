"""Response of one mode to a polynomial force: from rest, in a form that does not cancel where it is slow.

    c' = lambda c + sum_{j<P} f_j tau^j   has   c(tau) = exp(lambda tau) c(0) + sum_j f_j psi_j(lambda, tau),
    psi_j(lambda, tau) = int_0^tau exp(lambda (tau - s)) s^j ds = j! tau^(j+1) phi_{j+1}(lambda tau)

with the functions phi_l(z) = sum_i z^i/(i + l)! of the exponential integrators. A particular solution that is
a polynomial would hold j! f_j/lambda^(j+1), without bound for slow modes, and the free motion beside it would
take all of it away again. Re(lambda) <= 0.
"""

from __future__ import annotations

import math

import numpy as np

from ..basics.arrays import Array
from ..basics.compiled import compiled

TERMS = 24  # of the series for |z| <= 2: the next is below 2^24/28!, 5e-23
MOST = 4  # P at most: cubics
SERIES = 2.0  # up to this |z|
LEAST = 1e-19  # the series ends with a term below this: the sum is above 1/40, and each term below half of the last


@compiled
def answers(eigenvalue: complex, tau: float, psi: Array) -> None:
    """psi_j(eigenvalue, tau) into psi (P,), P <= 4.

    Series and downward recursion phi_l = z phi_{l+1} + 1/l! for |z| <= 2, else upward phi_{l+1} = (phi_l - 1/l!)/z:
    either loses a few roundings.
    """
    z = eigenvalue * tau
    phi = np.empty(MOST + 1, np.complex128)
    if abs(z) <= SERIES:
        term = 1.0 / 24.0 + 0.0j
        total = term
        for i in range(1, TERMS):
            term *= z * (1.0 / (i + MOST))
            total += term
            if abs(term.real) + abs(term.imag) < LEAST:
                break
        phi[4] = total
        phi[3] = z * phi[4] + 1.0 / 6.0
        phi[2] = z * phi[3] + 0.5
        phi[1] = z * phi[2] + 1.0
    else:
        decay, inverse = math.exp(z.real), 1.0 / z
        phi[1] = (decay * complex(math.cos(z.imag), math.sin(z.imag)) - 1.0) * inverse
        phi[2] = (phi[1] - 1.0) * inverse
        phi[3] = (phi[2] - 0.5) * inverse
        phi[4] = (phi[3] - 1.0 / 6.0) * inverse
    scale = tau
    for j in range(psi.size):
        psi[j] = scale * phi[j + 1]
        scale *= tau * (j + 1)


@compiled
def forced(eigenvalues: Array, tau: Array, force: Array, out: Array) -> None:
    """sum_j force[i, k, j] psi_j(eigenvalues[k], tau[i]) into out (times, k)."""
    psi = np.empty(force.shape[2], np.complex128)
    for i in range(tau.size):
        for k in range(eigenvalues.size):
            answers(eigenvalues[k], tau[i], psi)
            total = 0.0 + 0.0j
            for j in range(psi.size):
                total += force[i, k, j] * psi[j]
            out[i, k] = total


@compiled
def forced_derivatives(eigenvalues: Array, seen: Array, shift: Array, tau: float, d: Array) -> None:
    """Add to d (ORDER + 1,) the derivatives at tau of Re sum_kj seen_kj psi_j(lambda_k, .) + sum_j shift_j tau^j.

    ``seen`` are the forces as a row sees them. A position's row has Re sum_k seen_kj = 0: a force makes no speed.
    """
    P = seen.shape[1]
    psi = np.empty(P, np.complex128)
    for k in range(eigenvalues.size):
        answers(eigenvalues[k], tau, psi)
        for j in range(P):
            x = psi[j]
            d[0] += (seen[k, j] * x).real
            power, factor = tau**j, 1.0 * j  # (tau^j)^(i), and what the next derivative multiplies it by
            for i in range(1, d.size):
                x = eigenvalues[k] * x + power
                d[i] += (seen[k, j] * x).real
                power = factor * tau ** (j - i) if factor > 0.0 else 0.0
                factor = factor * (j - i) if factor > 0.0 else 0.0
    for j in range(shift.size):
        value = shift[j]
        for i in range(min(j + 1, d.size)):
            d[i] += value * tau ** (j - i)
            value *= j - i


@compiled
def forced_sizes(eigenvalues: Array, seen: Array, shift: Array, rest: float, b: Array) -> None:
    """Bounds of the same derivatives over [0, rest], into b (ORDER + 1,).

    |psi_j| <= rest^(j+1)/(j+1), and by parts 2 rest^j/|lambda|; then psi' = lambda psi + tau^j.
    """
    b[:] = 0.0
    P = seen.shape[1]
    for k in range(eigenvalues.size):
        size = abs(eigenvalues[k])
        for j in range(P):
            amplitude = abs(seen[k, j])
            if amplitude == 0.0:
                continue
            x = rest ** (j + 1) / (j + 1)
            if x * size > 2.0 * rest**j:
                x = 2.0 * rest**j / size
            b[0] += amplitude * x
            power, factor = rest**j, 1.0 * j
            for i in range(1, b.size):
                x = size * x + power
                b[i] += amplitude * x
                power = factor * rest ** (j - i) if factor > 0.0 else 0.0
                factor = factor * (j - i) if factor > 0.0 else 0.0
    for j in range(shift.size):
        value = abs(shift[j])
        for i in range(min(j + 1, b.size)):
            b[i] += value * rest ** (j - i)
            value *= j - i
