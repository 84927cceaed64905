"""Eigenpairs of K x = lambda M x of which the smallest lambda has as many digits as the largest.

A solver for symmetric matrices errs by eps lambda_max in every eigenvalue. Its vectors X are good enough to
start from: S = X^T K X and R = X^T M X, summed with twice the digits, are graded, S_ij of the size
sqrt(S_ii S_jj) or below, and the Jacobi method errs by eps lambda_j in each eigenvalue of such a matrix
(Demmel and Veselic, SIAM J. Matrix Anal. Appl. 13, 1992).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg

from ..basics.arrays import Array

EPS = float(np.finfo(float).eps)
PASSES = 5
GRADED = 0.1  # of sqrt(S_ii S_jj): from there on the Jacobi method has its digits
SWEEPS = 30  # a graded matrix takes three or four
SPLIT = 2.0**27 + 1.0  # cuts 53 bits into 26 and 26
SMALL = 100  # unknowns up to which all pairs are refined, which takes a second at 200 and a minute at 800
SUMMED = 8.0  # times sqrt(n) eps of its terms: more than twice what sums of n^2 of them have been seen to lose
ENOUGH = 1e-10  # of lambda: beyond SMALL those that the solver knows to that much are left as they are


def graded_eigenpairs(
    mass: Array, stiffness: Array, springs: tuple[Any, ...], squares: Array, X: Array
) -> tuple[Array, Array]:
    """(lambda ascending (n,), vectors (n, n), vectors^T M vectors = I) from approximate ones, ``squares`` and ``X``.

    Of K + sum of kappa row^T row over the ``springs`` (row, kappa), not summed before. An eigenvalue below
    the rounding of the entries of K, seen along its vector, is that of a rigid-body motion, and zero. Where
    S_ij comes near sqrt(S_ii S_jj) the vectors were too far off, and the better ones are the next start.
    Of more than SMALL unknowns only the slow pairs are refined, within the space that they span.
    """
    slow = len(X)
    # The solver errs by n eps of the largest square: squares below this one have more than ENOUGH of error.
    if slow > SMALL:
        slow = int(np.count_nonzero(squares < EPS * len(X) / ENOUGH * squares[-1]))
        if not slow:
            return squares, X
    few, Y = _refined(mass, stiffness, springs, X[:, :slow])
    return np.append(few, squares[slow:]), np.hstack([Y, X[:, slow:]])


def _refined(mass: Array, stiffness: Array, springs: tuple[Any, ...], X: Array) -> tuple[Array, Array]:
    """The pairs in the space of the columns of X (n, k)."""
    squares = rounding = np.zeros(X.shape[1])
    for _ in range(PASSES):
        # S = X^T K X, and the size of the terms that it sums, from which its rounding follows.
        S, terms = congruence(stiffness, X), np.sum(np.abs(X) * (np.abs(stiffness) @ np.abs(X)), axis=0)
        # Springs one by one: a stiff spring summed into K would round its soft entries away.
        for row, kappa in springs:
            along = product(row[None], X)[0][0]
            S += kappa * np.outer(along, along)
            terms += kappa * along**2
        # R = U^T U makes one symmetric matrix of the pair: U^-T S U^-1.
        R = congruence(mass, X)
        upper = scipy.linalg.cholesky(0.5 * (R + R.T))
        S = scipy.linalg.solve_triangular(upper, S, trans=1)
        S = scipy.linalg.solve_triangular(upper, S.T, trans=1)
        # The Jacobi method, and its vectors back in the space of X.
        rounding = rounding_of_zero(terms, len(S))
        squares, turned = jacobi(0.5 * (S + S.T), rounding)
        X = X @ scipy.linalg.solve_triangular(upper, turned)
        # Graded already: the Jacobi method had its digits, and no better start is needed.
        size = np.sqrt(np.maximum(np.abs(np.diag(S)), rounding))
        if not np.any(np.abs(S - np.diag(np.diag(S))) > GRADED * np.outer(size, size)):
            break
    # A rigid motion has the square zero, not its rounding.
    squares[np.abs(squares) < rounding] = 0.0
    order = np.argsort(squares, kind="stable")
    return squares[order], X[:, order]


def rounding_of_zero(terms: Array, n: int) -> Array:
    """Below which squares count as zero: sums of n terms that are ``terms`` large in all."""
    return 2.0 * EPS * max(n, 8) * terms


def uncoupled(A: Any, X: Array, projected: Array, rigid: Array) -> Array:
    """``projected`` = X^T A X (k, k) without the rounding of zero: entries beside the diagonal, and those of rigid
    motions (k,). Those on the diagonal stay: of slow motions they can be that small. A: (n, n), dense or sparse."""
    terms, n = np.abs(X.T) @ (abs(A) @ np.abs(X)), len(X)
    # Between modes by the statistics of rounding, sqrt(n). Rigid motions by the full bound, diagonal included.
    least = np.where(np.eye(len(projected), dtype=bool), 0.0, SUMMED * EPS * np.sqrt(n) * terms)
    least = np.where(rigid[:, None] | rigid, rounding_of_zero(terms, n), least)
    return np.where(np.abs(projected) <= least, 0.0, projected)


def congruence(A: Array, X: Array) -> Array:
    """X^T A X, each entry as if summed with twice the digits and rounded once."""
    shift = np.floor(np.log2(float(np.max(np.abs(A))) or 1.0))  # 2^27 times it has to stay finite
    high, low = product(np.ldexp(A, -int(shift)), X)
    total, rest = product(X.T, high)
    return np.ldexp(total + (rest + X.T @ low), int(shift))


def product(A: Array, B: Array) -> tuple[Array, Array]:
    """A B as the unrounded sum of two matrices: the dot products of Ogita, Rump and Oishi (SIAM J. Sci. Comput.
    26, 2005), with an error of eps^2 |A| |B|."""
    high, low = np.zeros((2, len(A), B.shape[1]))
    # Column by row: the sum of n rank-one products, whose roundings are summed beside it.
    for a, b in zip(A.T[:, :, None], B[:, None, :], strict=True):
        term = a * b
        # The rounding of every product, exactly (Dekker).
        (a1, a2), (b1, b2) = _halves(a), _halves(b)
        lost = a2 * b2 - (((term - a1 * b1) - a2 * b1) - a1 * b2)
        # The rounding of every sum, exactly (Knuth).
        total = high + term
        back = total - high
        low += ((high - (total - back)) + (term - back)) + lost
        high = total
    return high, low


def _halves(x: Array) -> tuple[Array, Array]:
    """x = x1 + x2 with half the bits each, so that products of halves are exact."""
    big = SPLIT * x
    upper = big - (big - x)
    return upper, x - upper


def jacobi(S: Array, least: Array) -> tuple[Array, Array]:
    """Eigenvalues (n,) and orthonormal vectors (n, n) of a symmetric graded matrix, in the order of its diagonal.

    Entries below eps sqrt(S_ii S_jj) are zero; ``least`` (n,) are diagonals below which no digit is known.
    Rotations of disjoint pairs are made at once: n - 1 rounds of n/2 are a sweep.
    """
    n = len(S)
    S, V = S.copy(), np.eye(n)
    for _ in range(SWEEPS):
        rotated = False
        for i, j in _rounds(n):
            a, b, c = S[i, i], S[j, j], S[i, j]
            # Relative to both diagonals, not to the largest one: this is what keeps the digits of the small ones.
            size = np.sqrt(np.maximum(np.abs(a), least[i])) * np.sqrt(np.maximum(np.abs(b), least[j]))
            on = np.abs(c) > EPS * size
            if not np.any(on):
                continue
            rotated = True
            i, j, a, b, c = i[on], j[on], a[on], b[on], c[on]
            # The smaller of the two angles, by the formula that does not cancel.
            half = (b - a) / (2.0 * c)
            tangent = np.where(half < 0.0, -1.0, 1.0) / (np.abs(half) + np.hypot(1.0, half))
            cosine = 1.0 / np.hypot(1.0, tangent)
            sine = tangent * cosine
            # Columns of the matrix and of the vectors, then the rows.
            for x in (S, V):
                x[:, i], x[:, j] = cosine * x[:, i] - sine * x[:, j], sine * x[:, i] + cosine * x[:, j]
            S[i], S[j] = cosine[:, None] * S[i] - sine[:, None] * S[j], sine[:, None] * S[i] + cosine[:, None] * S[j]
            # The diagonals from their old values: the products above would round the small one off.
            S[i, i], S[j, j] = a - tangent * c, b + tangent * c
            S[i, j] = S[j, i] = 0.0
        if not rotated:
            break
    return np.diag(S).copy(), V


def _rounds(n: int) -> list[tuple[Array, Array]]:
    """Every pair i < j once, in rounds of disjoint pairs, as in a round-robin tournament."""
    players, rounds = list(range(n + n % 2)), []
    for _ in range(len(players) - 1):
        half = len(players) // 2
        pairs = [sorted(p) for p in zip(players[:half], reversed(players[half:]), strict=True) if max(p) < n]
        rounds.append(tuple(np.array(pairs, int).reshape(-1, 2).T))
        players.insert(1, players.pop())
    return rounds
