"""Eigenvalues of one regime in groups, each with a well-conditioned basis; chains for eigenvalues that meet.

    z' = A z,  z = (s eta, eta'),  A = [[0, S], [-Omega^2/S, -D]],   z = sum over groups of V y,  y' = T y,  y = L z

in the undamped modes eta, D their damping and s = omega, or 1/span for a motion that has none. A group is one
eigenvalue, or those that are close to each other, or the same over the span, with vectors that are almost one: a mode
that is damped critically, or nearly. Such a group keeps a basis of the space that its vectors span, and T is a matrix.

Where eigenvalues of modes meet each other, or a drive in resonance, there are Jordan chains and secular terms:

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
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse.csgraph
import scipy.sparse.linalg
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.compiled import compiled
from ..basics.validation import InputError
from ..model.natural_modes import eigenvalues_off

CONDITION_LIMIT = 1e8  # of the bases: beyond it eight digits are lost
SENSITIVE = 300.0  # 1/|cosine| between left and right eigenvector: from there on the pair has a partner to be found
KEPT = 100  # modes up to which groups are kept for the next system
TOGETHER = 0.05  # |difference|/|eigenvalue| of two sensitive ones that are one group
Complex = Any  # arrays of complex128


@dataclass(frozen=True, eq=False)
class Group:
    """T: (k, k). V: (2n, k), L: (k, 2n). paired: z = 2 Re(V y), the conjugates being left out; else z = V y, real."""

    T: Complex
    V: Complex
    L: Complex
    paired: bool

    @cached_property
    def values(self) -> Complex:
        """The eigenvalues (k,)."""
        return self.T[0] if len(self.T) == 1 else np.linalg.eigvals(self.T)


def groups(
    omega: Array, damping: Array, span: float, size: float = 0.0, rng: np.random.Generator | None = None
) -> tuple[Array, list[Group]]:
    """s (n,) and the groups, of undamped frequencies (n,) and ``damping`` (n, n); span: the time of interest.

    Modes that no damping joins are apart. size: of a random change, relative to the norm of each matrix of which the
    eigenvalues are taken: what the algorithm loses, in small entries as in large. Raises InputError where no
    such bases are well-conditioned.
    """
    if rng is None and len(omega) <= KEPT:  # systems that differ by their loads share them
        return _exact_groups(omega.tobytes(), damping.tobytes(), span)
    return _groups(omega, damping, span, size, rng)


@lru_cache(maxsize=16)
def _exact_groups(omega: bytes, damping: bytes, span: float) -> tuple[Array, list[Group]]:
    n = len(omega) // 8
    return _groups(np.frombuffer(omega), np.frombuffer(damping).reshape(n, n), span, 0.0, None)


def _groups(
    omega: Array, damping: Array, span: float, size: float, rng: np.random.Generator | None
) -> tuple[Array, list[Group]]:
    n = len(omega)
    joined = damping != 0.0
    damped = np.any(joined, axis=0) | np.any(joined, axis=1)
    s = np.where(omega * span >= 1.0, omega, 1.0 / span)
    found: list[Group] = []
    # Undamped modes in closed form; one slower than the span keeps the real basis (s eta, eta').
    for j in np.flatnonzero(~damped):
        V = np.zeros((2 * n, 2), complex)
        V[j, 0], V[n + j, 1] = 1.0, 1.0
        if omega[j] * span >= 1.0:
            left = np.array([[1.0, -1.0j]]) / 2.0
            found.append(Group(np.array([[1j * omega[j]]]), V @ np.array([[1.0], [1.0j]]), left @ V.T, True))
        else:
            found.append(Group(np.array([[0.0, s[j]], [-(omega[j] ** 2) / s[j], 0.0]], complex), V, V.T, False))
    # Damped modes: one eigenproblem for each set that the damping joins.
    part = np.zeros(n, np.int64)
    if not np.all(joined):
        _, part = scipy.sparse.csgraph.connected_components(joined, directed=False)
    for k in np.unique(part[damped]):
        here = np.flatnonzero(part == k)
        m, w, place = len(here), omega[here], np.append(here, n + here)
        A = np.block([[np.zeros((m, m)), np.diag(s[here])], [-np.diag(w**2 / s[here]), -damping[np.ix_(here, here)]]])
        if rng is not None and m > 1:  # of one mode the vectors are its eigenvalues, see ``known_until``
            A += size * _norm(A) * rng.uniform(-1.0, 1.0, A.shape)
        for group in (_of_one(float(s[here[0]]), float(w[0]), float(A[1, 1]), span) if m == 1 else []) or _of(A, span):
            # From the coordinates of the set to those of all modes.
            V, L = np.zeros((2 * n, len(group.T)), complex), np.zeros((len(group.T), 2 * n), complex)
            V[place], L[:, place] = group.V, group.L
            found.append(Group(group.T, V, L, group.paired))
    return s, found


def _norm(A: Array) -> float:
    """The largest singular value of A, to a thousandth by Lanczos' method where all of them would take long."""
    if len(A) <= 2 * KEPT:
        return float(np.linalg.norm(A, 2))
    start = np.random.default_rng(0).normal(size=len(A))  # a fixed one, for the same value in every process
    largest: Any = scipy.sparse.linalg.eigsh(A.T @ A, 1, v0=start, tol=1e-3, return_eigenvectors=False)  # type: ignore[arg-type]
    return float(np.sqrt(largest[0]))


def _of_one(s: float, w: float, rate: float, span: float) -> list[Group]:
    """The groups of one mode, A = [[0, s], [-w^2/s, rate]], in closed form; none where its eigenvalues are close, or
    one of them is zero."""
    if w * w / s == 0.0:
        return []
    root = np.sqrt(complex(0.25 * rate * rate - w * w))
    large = 0.5 * rate + (root if rate > 0.0 else -root)
    # The small one is no difference of large ones.
    values = [large, w * w / large] if root.real else [complex(large.real, abs(large.imag))]
    found = []
    for value in values:
        # [s, lambda] and [-w^2/s, lambda] are the right and left eigenvectors of A.
        right, left = np.array([[s], [value]]), np.array([[-w * w / s, value]])
        cosine = abs((left @ right)[0, 0]) / (np.linalg.norm(left) * np.linalg.norm(right))
        if cosine * SENSITIVE < 1.0 or (abs(value) * span < 1.0 and value.imag != 0.0):
            return []
        V = right / np.linalg.norm(right)
        found.append(Group(np.array([[value]]), V + 0j, left / (left @ V) + 0j, value.imag != 0.0))
    return found


def _of(A: Array, span: float) -> list[Group]:
    """The groups of the real matrix A of which no conjugate is kept twice. Those slower than the span are together, in
    a real basis: their answer to a constant is the small difference of large ones."""
    values, right = (x.astype(complex) for x in scipy.linalg.eig(A))
    # Left and right eigenvectors become orthogonal where eigenvalues meet. The left ones are the rows of the inverse,
    # which is as good as it is well-conditioned.
    inverse = _inverse(right)
    left = inverse.conj().T
    if not _condition(right, inverse) < CONDITION_LIMIT:
        values, left, right = (x.astype(complex) for x in scipy.linalg.eig(A, left=True))  # type: ignore[misc]
    cosine = np.abs(np.sum(left.conj() * right, axis=0))
    cosine /= np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0)
    sensitive = cosine * SENSITIVE < 1.0
    sensitive |= (np.abs(values) * span < 1.0) & (np.imag(values) != 0.0)
    # A basis for every set: an eigenvector, or the space of those that meet.
    sets = [[int(j)] for j in np.flatnonzero(~sensitive)] + _together(values, np.flatnonzero(sensitive), span)
    spaces = [right[:, own] if len(own) == 1 else _space(A, values, own) for own in sets]
    basis = np.hstack(spaces)
    inverse = _inverse(basis) if np.any(sensitive) else inverse
    # The bound first: the condition itself takes long and is asked for where that does not decide.
    condition = _condition(basis, inverse)
    if not condition < CONDITION_LIMIT:
        condition = float(np.linalg.cond(basis))
    if not condition < CONDITION_LIMIT:
        raise InputError(
            "damping", f"eigenvectors of condition {condition:.1g}", f"keep it below {CONDITION_LIMIT:g}",
            "its modes are further apart than float64 holds together: use the adaptive solver cvode",
        )  # fmt: skip
    # Of conjugate sets the one above the real axis stays; a set with its own conjugates is real.
    found: list[Group] = []
    begin = 0
    for own, V in zip(sets, spaces, strict=True):
        L = inverse[begin : begin + len(own)]
        begin += len(own)
        side = np.imag(values[own])
        if np.all(side < 0.0):
            continue
        paired = bool(np.all(side > 0.0))
        T = np.diag(values[own]) if len(own) == 1 else L @ A @ V
        found.append(
            Group(T, V, L, paired) if paired else Group(np.real(T) + 0j, np.real(V) + 0j, np.real(L) + 0j, False)
        )
    return found


def _inverse(basis: Complex) -> Complex:
    """The inverse of a basis, inf where it is none."""
    try:
        return np.linalg.inv(basis)
    except np.linalg.LinAlgError:
        return np.full_like(basis, np.inf)


@np.errstate(over="ignore", invalid="ignore")
def _condition(basis: Complex, inverse: Complex) -> float:
    """A bound of the condition by Frobenius' norms; inf or NaN where they overflow."""
    return float(np.linalg.norm(basis) * np.linalg.norm(inverse))


def known_until(omega: Array, damping: Array, tolerance: float) -> float:
    """The time to which every eigenvalue lambda is known: to ``tolerance`` over that time, or over its own 1/|lambda|.

    The algorithm errs by eps |A| in each of them, in those of slow motions too; see ``eigenvalues_off``.
    """
    if not np.any(damping):
        return np.inf
    n, s = len(omega), np.where(omega > 0.0, omega, np.max(omega, initial=0.0) or 1.0)
    A = np.block([[np.zeros((n, n)), np.diag(s)], [-np.diag(omega**2 / s), -damping]])
    values, right = (np.asarray(x) for x in scipy.linalg.eig(A)[:2])
    # Newton's step measures the error of each eigenvalue, which over the time t changes the motion by |off| t.
    off = eigenvalues_off(values, right[:n] / s[:, None], damping, omega)
    lost = np.abs(off) > tolerance * np.abs(values + off)
    return float(tolerance / np.max(np.abs(off[lost]))) if np.any(lost) else np.inf


def _together(values: Complex, sensitive: NDArray[np.int64], span: float) -> list[list[int]]:
    """The sensitive eigenvalues in sets of neighbours, conjugates in sets that are conjugate."""
    sets: list[list[int]] = []
    for j in sensitive.tolist():
        size = max(TOGETHER * abs(values[j]), 1.0 / span)
        # All sets near the new value become one with it.
        near = [own for own in sets if np.min(np.abs(values[own] - values[j])) <= size]
        sets = [own for own in sets if own not in near] + [[j, *(i for own in near for i in own)]]
    return sets


def _space(A: Array, values: Complex, own: list[int]) -> Complex:
    """An orthonormal basis (n, k) of the invariant subspace of the eigenvalues ``own``, real where these are
    their own conjugates."""
    inside = values[own]
    others = np.delete(values, own)

    # Schur's eigenvalues differ from ``values`` by rounding: the nearest one decides.
    def chosen(value: complex) -> bool:
        return bool(np.min(np.abs(inside - value)) < np.min(np.abs(others - value), initial=np.inf))

    made: Any = scipy.linalg.schur(A.astype(complex), output="complex", sort=chosen)
    _, Q, count = made
    # These eigenvalues are too close to others: Schur's form does not split as the sets do.
    if count != len(own):
        raise InputError(
            "damping", f"{len(own)} eigenvalues that meet", "keep them apart from the others",
            "change the damping a little or use the solver cvode",
        )  # fmt: skip
    Q = Q[:, :count]
    if np.all(inside.imag > 0.0) or np.all(inside.imag < 0.0):
        return Q
    # The complex space is its own conjugate: real and imaginary parts of its basis span it, of rank k.
    return np.linalg.svd(np.hstack([Q.real, Q.imag]))[0][:, :count]


TERMS = 24  # of Taylor's series where nodes lie within 1 of each other: the next is below 2^24/25!, 1e-18


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
    # Relative to the largest real part no exponential exceeds 1; the mean imaginary part keeps the nodes small.
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
    # Within 1 of the centre the series converges in TERMS terms.
    halvings = 0
    while widest > 1.0 and halvings < 1000:
        widest *= 0.5
        halvings += 1
    scale = 0.5**halvings
    # exp(Z) by Taylor's series; nodes and ones of Z are divided by 2^halvings.
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
            # From the right, since term[i, j] needs the old term[i, j - 1].
            for j in range(K - 1, i - 1, -1):
                x = term[i, j] * Z[j, j]
                if j > i:
                    x += term[i, j - 1] * Z[j - 1, j]
                term[i, j] = x / m
                E[i, j] += x / m
    # Squared as often as it was halved; products of triangular matrices stay triangular.
    for _ in range(halvings):
        for i in range(K):
            for j in range(K - 1, i - 1, -1):
                x = 0.0j
                for k in range(i, j + 1):
                    x += E[i, k] * E[k, j]
                term[i, j] = x
        E[:] = term
    # The ones of Z lack tau: D_j gains tau^j. The exponential of the centre comes back.
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
            # s^n exp(sigma s) is largest at s = -n/sigma, or at the nearer end of the interval.
            if decay[i] * end < -n:
                s = max(tau, -n / decay[i])
            size = s**n / factorial * math.exp(decay[i] * s)
            # Where nodes lie far apart, the bound by their quotient is smaller.
            apart = abs(nodes[i] - nodes[i + n])
            if apart * size > row[i] + row[i + 1]:
                size = (row[i] + row[i + 1]) / apart
            row[i] = size
        out[n] = row[0]
