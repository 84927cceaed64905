"""Modes whose eigenvalues meet each other, or a drive in resonance: Jordan chains and secular terms.

    z' = B z,  z(tau) = sum_j D_j(tau) g_j,  g_0 = z(0),  g_{j+1} = (B - mu_j) g_j,
    D_j(tau) = exp[mu_0, ..., mu_j](tau),  the divided differences of exp(mu tau)

Newton's form of exp(B tau), with the eigenvalues mu of B in any order. It stays regular where they meet: D_1 becomes
tau exp(mu tau), D_2 becomes tau^2/2 exp(mu tau). z holds the coefficients y of the modes, y' = T y + pull spin(t) +
force(t), behind them the drives in resonance with them, exp(i Omega t), and powers of time for the force of the
records. So critical damping, a rigid-body motion under a constant load, and a resonance are one thing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.compiled import compiled

TERMS = 24  # of Taylor's series where nodes lie within 1 of each other: the next is below 2^24/25!, 1e-18
Complex = Any  # arrays of complex128


@dataclass(frozen=True, eq=False)
class Chain:
    """y' = T y + pull exp(i Omega t). modes: (k,), the places of y among a regime's coefficients. T: (k, k).
    drives: (d,), which of (1, exp(i Omega t), ...) force it in resonance; rates: (d,), their i Omega. pull: (k, d)."""

    modes: NDArray[np.int64]
    T: Complex
    drives: NDArray[np.int64]
    rates: Complex
    pull: Complex

    def system(self, c: Complex, spin: Complex, force: Complex) -> tuple[Complex, Complex, Complex]:
        """(B, mu, z(0)) of pieces: (p, K, K), (K,), (p, K). c: (p, modes of the regime). spin: (p, 1 + F) at their
        starts. force: (p, modes of the regime, P), the coefficients of tau^j."""
        k, d, P = len(self.T), len(self.drives), force.shape[2]
        frame, nodes = self.frame(P)
        B = np.repeat(frame[None], len(c), axis=0)
        B[:, :k, k + d :] = force[:, self.modes]
        z = np.zeros((len(c), k + d + P), complex)
        z[:, :k], z[:, k : k + d] = c[:, self.modes], spin[:, self.drives]
        z[:, k + d : k + d + 1] = 1.0
        return B, nodes, z

    def frame(self, P: int) -> tuple[Complex, Complex]:
        """B (K, K) under polynomials of P terms that push nothing, and mu (K,)."""
        k, d = len(self.T), len(self.drives)
        B = np.zeros((k + d + P, k + d + P), complex)
        B[:k, :k], B[:k, k : k + d] = self.T, self.pull
        B[range(k, k + d), range(k, k + d)] = self.rates
        for j in range(1, P):
            B[k + d + j, k + d + j - 1] = j  # (tau^j)' = j tau^(j - 1)
        return B, np.concatenate([np.linalg.eigvals(self.T), self.rates, np.zeros(P)])

    def ahead(self, c: Complex, spin: Complex, force: Complex, tau: Array) -> Complex:
        """y at tau (p,) after the starts of the pieces, see ``system``; (p, k)."""
        B, nodes, z = self.system(c, spin, force)
        weights = np.empty((len(tau), len(nodes)), complex)
        all_differences(nodes, np.ascontiguousarray(tau, float), weights)
        return np.einsum("pj,pjk->pk", weights, newton(B, nodes, z)[:, :, : len(self.T)])


def newton(B: Complex, nodes: Complex, z: Complex) -> Complex:
    """g_j of every piece, (p, K, K)."""
    g = [z]
    for node in nodes[:-1]:
        g.append(np.einsum("pab,pb->pa", B, g[-1]) - node * g[-1])
    return np.stack(g, axis=1)


def seen_by(
    chains: tuple[Chain, ...], rows: Complex, c: Complex, spin: Complex, force: Complex, order: int
) -> tuple[Complex, NDArray[np.int64], Complex]:
    """Search arguments of a segment: the nodes (b, K), how many each of b chains has, and G (m, b, order + 1, K):

    the i-th derivative of what ``rows`` (m, modes) see of a chain is Re sum_j D_j(tau) G_ij.
    """
    parts = [chain.system(c[None], spin[None], force[None]) for chain in chains]
    counts = np.array([len(nodes) for _, nodes, _ in parts], np.int64)
    most = int(np.max(counts, initial=0))
    all_nodes = np.zeros((len(chains), most), complex)
    G = np.zeros((len(rows), len(chains), order + 1, most), complex)
    for b, (chain, (B, nodes, z)) in enumerate(zip(chains, parts, strict=True)):
        all_nodes[b, : len(nodes)] = nodes
        g = newton(B, nodes, z)[0]
        for i in range(order + 1):
            G[:, b, i, : len(nodes)] = rows[:, chain.modes] @ g[:, : len(chain.T)].T
            g = g @ B[0].T
    return all_nodes, counts, G


@compiled
def differences(nodes: Array, tau: float, out: Array) -> None:
    """D_j(tau) of the nodes (K,) into out (K,).

    The first row of exp(tau Z), Z with the nodes on its diagonal and ones above: Taylor's series of the matrix
    divided by 2^s, squared s times (McCurdy, Ng and Parlett, Math. Comp. 43, 1984). All of it relative to the
    largest real part, so that nothing overflows.
    """
    K = nodes.size
    top = -math.inf
    middle = 0.0
    for k in range(K):
        top = max(top, nodes[k].real)
        middle += nodes[k].imag / K
    centre = complex(top, middle)
    widest = 0.0
    for k in range(K):
        widest = max(widest, abs(nodes[k] - centre) * tau)
    halvings = 0
    while widest > 1.0 and halvings < 1000:
        widest *= 0.5
        halvings += 1
    scale = 0.5**halvings
    Z = np.zeros((K, K), np.complex128)
    E = np.zeros((K, K), np.complex128)
    term = np.zeros((K, K), np.complex128)
    for i in range(K):
        Z[i, i] = (nodes[i] - centre) * tau * scale
        if i + 1 < K:
            Z[i, i + 1] = scale
        E[i, i] = 1.0
        term[i, i] = 1.0
    for m in range(1, TERMS):
        for i in range(K):
            for j in range(K - 1, i - 1, -1):
                x = term[i, j] * Z[j, j]
                if j > i:
                    x += term[i, j - 1] * Z[j - 1, j]
                term[i, j] = x / m
                E[i, j] += x / m
    for _ in range(halvings):
        for i in range(K):
            for j in range(K - 1, i - 1, -1):
                x = 0.0j
                for k in range(i, j + 1):
                    x += E[i, k] * E[k, j]
                term[i, j] = x
        E[:] = term
    factor = np.exp(centre * tau)
    for j in range(K):
        out[j] = factor * E[0, j]
        factor *= tau


@compiled
def all_differences(nodes: Array, tau: Array, out: Array) -> None:
    """``differences`` at times tau (p,) into out (p, K)."""
    for i in range(tau.size):
        differences(nodes, tau[i], out[i])


@compiled
def largest(nodes: Array, count: int, tau: float, ahead: float, out: Array) -> None:
    """Bounds of |D_j| on [tau, tau + ahead] into out (count,), of the first ``count`` nodes.

    |exp[mu_i..mu_j](s)| <= s^(j-i)/(j-i)! exp(sigma s) with the largest real part sigma, and by its definition
    <= (|exp[mu_i..mu_(j-1)]| + |exp[mu_(i+1)..mu_j]|)/|mu_i - mu_j|.
    """
    end = tau + ahead
    row = np.empty(count)
    decay = np.empty(count)  # the largest real part of mu_i..mu_j, by i
    for i in range(count):
        decay[i] = nodes[i].real
        row[i] = math.exp(max(decay[i] * tau, decay[i] * end))
    out[0] = row[0]
    factorial = 1.0
    for n in range(1, count):
        factorial *= n
        for i in range(count - n):
            decay[i] = max(decay[i], nodes[i + n].real)
            s = end
            if decay[i] * end < -n:
                s = max(tau, -n / decay[i])
            size = s**n / factorial * math.exp(decay[i] * s)
            apart = abs(nodes[i] - nodes[i + n])
            if apart * size > row[i] + row[i + 1]:
                size = (row[i] + row[i + 1]) / apart
            row[i] = size
        out[n] = row[0]
