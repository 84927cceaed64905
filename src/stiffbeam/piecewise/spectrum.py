"""The contact state of one regime in groups of its eigenvalues, each with a basis that holds its digits.

    z' = A z,  z = (s eta, eta'),  A = [[0, S], [-Omega^2/S, -D]],   z = sum over groups of V y,  y' = T y,  y = L z

in the undamped modes eta, D their damping and s = omega, or 1/span for a motion that has none. A group is one
eigenvalue, or those that are close to each other, or the same over the span, with vectors that are almost one: a mode
that is damped critically, or nearly. Such a group keeps a basis of the space that its vectors span, and T is a matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse.csgraph
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.natural_modes import eigenvalues_off

CONDITION_LIMIT = 1e8  # of the bases: beyond it eight digits are lost
SENSITIVE = 300.0  # 1/|cosine| between left and right eigenvector: from there on the pair has a partner to be found
TOGETHER = 0.05  # |difference|/|eigenvalue| of two sensitive ones that are one group
Complex = Any  # arrays of complex128


@dataclass(frozen=True, eq=False)
class Group:
    """T: (k, k). V: (2n, k), L: (k, 2n). paired: z = 2 Re(V y), the conjugates being left out; else z = V y, real."""

    T: Complex
    V: Complex
    L: Complex
    paired: bool


def groups(
    omega: Array, damping: Array, span: float, size: float = 0.0, rng: np.random.Generator | None = None
) -> tuple[Array, list[Group]]:
    """s (n,) and the groups, of undamped frequencies (n,) and ``damping`` (n, n); span: the time of interest.

    Modes that no damping joins are apart. size: of a random change, relative to the norm of each matrix of which the
    eigenvalues are taken: what the algorithm loses, in small entries as in large. Raises InputError where no
    such bases are well-conditioned.
    """
    n = len(omega)
    joined = damping != 0.0
    damped = np.any(joined, axis=0) | np.any(joined, axis=1)
    s = np.where(omega * span >= 1.0, omega, 1.0 / span)
    found: list[Group] = []
    for j in np.flatnonzero(~damped):
        V = np.zeros((2 * n, 2), complex)
        V[j, 0], V[n + j, 1] = 1.0, 1.0
        if omega[j] * span >= 1.0:
            left = np.array([[1.0, -1.0j]]) / 2.0
            found.append(Group(np.array([[1j * omega[j]]]), V @ np.array([[1.0], [1.0j]]), left @ V.T, True))
        else:
            found.append(Group(np.array([[0.0, s[j]], [-(omega[j] ** 2) / s[j], 0.0]], complex), V, V.T, False))
    _, part = scipy.sparse.csgraph.connected_components(joined, directed=False)
    for k in np.unique(part[damped]):
        here = np.flatnonzero(part == k)
        m, w, place = len(here), omega[here], np.append(here, n + here)
        A = np.block([[np.zeros((m, m)), np.diag(s[here])], [-np.diag(w**2 / s[here]), -damping[np.ix_(here, here)]]])
        if rng is not None and m > 1:  # of one mode the vectors are its eigenvalues, see ``known_until``
            A += size * np.linalg.norm(A, 2) * rng.uniform(-1.0, 1.0, A.shape)
        for group in _of(A, span):
            V, L = np.zeros((2 * n, len(group.T)), complex), np.zeros((len(group.T), 2 * n), complex)
            V[place], L[:, place] = group.V, group.L
            found.append(Group(group.T, V, L, group.paired))
    return s, found


def _of(A: Array, span: float) -> list[Group]:
    """The groups of the real matrix A of which no conjugate is kept twice. Those slower than the span are together, in
    a real basis: their answer to a constant is the small difference of large ones."""
    values, left, right = (x.astype(complex) for x in scipy.linalg.eig(A, left=True))  # type: ignore[misc]
    cosine = np.abs(np.sum(left.conj() * right, axis=0))
    cosine /= np.linalg.norm(left, axis=0) * np.linalg.norm(right, axis=0)
    sensitive = cosine * SENSITIVE < 1.0
    sensitive |= (np.abs(values) * span < 1.0) & (np.imag(values) != 0.0)
    sets = [[int(j)] for j in np.flatnonzero(~sensitive)] + _together(values, np.flatnonzero(sensitive), span)
    spaces = [right[:, own] if len(own) == 1 else _space(A, values, own) for own in sets]
    basis = np.hstack(spaces)
    condition = float(np.linalg.cond(basis))
    if not condition < CONDITION_LIMIT:
        raise InputError(
            "damping", f"eigenvectors of condition {condition:.1g}", f"keep it below {CONDITION_LIMIT:g}",
            "its modes are further apart than float64 holds together: use the adaptive solver cvode",
        )  # fmt: skip
    inverse, found, begin = np.linalg.inv(basis), [], 0
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


def known_until(omega: Array, damping: Array, tolerance: float) -> float:
    """The time to which every eigenvalue lambda is known: to ``tolerance`` over that time, or over its own 1/|lambda|.

    The algorithm errs by eps |A| in each of them, in those of slow motions too; see ``eigenvalues_off``.
    """
    if not np.any(damping):
        return np.inf
    n, s = len(omega), np.where(omega > 0.0, omega, np.max(omega, initial=0.0) or 1.0)
    A = np.block([[np.zeros((n, n)), np.diag(s)], [-np.diag(omega**2 / s), -damping]])
    values, right = (np.asarray(x) for x in scipy.linalg.eig(A)[:2])
    off = eigenvalues_off(values, right[:n] / s[:, None], damping, omega)
    lost = np.abs(off) > tolerance * np.abs(values + off)
    return float(tolerance / np.max(np.abs(off[lost]))) if np.any(lost) else np.inf


def _together(values: Complex, sensitive: NDArray[np.int64], span: float) -> list[list[int]]:
    """The sensitive eigenvalues in sets of neighbours, conjugates in sets that are conjugate."""
    sets: list[list[int]] = []
    for j in sensitive.tolist():
        size = max(TOGETHER * abs(values[j]), 1.0 / span)
        near = [own for own in sets if np.min(np.abs(values[own] - values[j])) <= size]
        sets = [own for own in sets if own not in near] + [[j, *(i for own in near for i in own)]]
    return sets


def _space(A: Array, values: Complex, own: list[int]) -> Complex:
    """An orthonormal basis (n, k) of the invariant subspace of the eigenvalues ``own``, real where these are
    their own conjugates."""
    inside = values[own]
    others = np.delete(values, own)

    def chosen(value: complex) -> bool:
        return bool(np.min(np.abs(inside - value)) < np.min(np.abs(others - value), initial=np.inf))

    made: Any = scipy.linalg.schur(A.astype(complex), output="complex", sort=chosen)
    _, Q, count = made
    if count != len(own):
        raise InputError(
            "damping", f"{len(own)} eigenvalues that meet", "keep them apart from the others",
            "change the damping a little or use the solver cvode",
        )  # fmt: skip
    Q = Q[:, :count]
    if np.all(inside.imag > 0.0) or np.all(inside.imag < 0.0):
        return Q
    return np.linalg.svd(np.hstack([Q.real, Q.imag]))[0][:, :count]
