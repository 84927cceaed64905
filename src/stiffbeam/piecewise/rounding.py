"""Rounding of float64 in the modes of a system, and modes that are perturbed by as much, for copies of a solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..basics.arrays import Array
from ..model.modes import Modes
from ..model.system import System

WIDE = 100  # modes up to which extended precision, which no library is fast in, is used for perturbed copies


class Perturbation(NamedTuple):
    """A change of the size of float64's rounding, for a perturbed copy of the solution.

    frequency: of the modes, see ``Correction.perturbed``; state: of every initial modal amplitude
    relative to the largest in energy, of every modal force, of the change between modes and at every switch
    of every amplitude relative to the terms it is made of, of the time of the switch, and relative to its norm of
    every matrix that damped modes are taken of; seed: of the random signs and sizes.
    """

    frequency: float
    state: float
    seed: int


def rounded_sum(a: Array, b: Array) -> Array:
    """sqrt(sum_k (a_ik b_kj)^2): what rounding takes from the product a b, in units of eps."""
    return np.sqrt(np.abs(a) ** 2 @ np.abs(b) ** 2)


class Correction(NamedTuple):
    """Modes in extended precision, as far as float64 can hold them: ``base`` with the frequencies sqrt(squares) and the
    shapes X (I + E). lost_shapes (n, n) and lost_squares (n,): what rounding takes from E and from the squares, in
    units of eps."""

    base: Modes
    squares: Array
    E: Array
    lost_shapes: Array
    lost_squares: Array

    def perturbed(self, size: float, rng: np.random.Generator) -> Modes:
        """These modes, off by ``size`` and by size/eps times what the correction loses."""
        n = len(self.squares)
        noise = rng.uniform(-1.0, 1.0, (n + 1, n))
        # abs: the change of a square near zero may exceed it.
        omega = np.sqrt(np.abs(self.squares * (1.0 + size * noise[n]) + size * self.lost_squares * np.diag(noise)))
        shapes = self.base.shapes + self.base.shapes @ (self.E + size * self.lost_shapes * noise[:n])
        return replace(self.base, omega=omega, shapes=shapes)


def correction(system: System, springs: Sequence[tuple[Array, float]], base: Modes) -> Correction:
    """Errors of the modes ``base``.

    It shows in S = X^T K X and R = X^T M X in extended precision: with lambda_j = S_jj/R_jj the right
    shapes are X (I + E), E_ij = (S_ij - lambda_j R_ij)/(lambda_j - lambda_i), E_jj = (1 - R_jj)/2, and -R_ij/2
    between equal ones (Ogita and Aishima). A hard stop mixes the slow modes by eps w_max^2/w_1^2.
    """
    wide = np.longdouble if base.omega.size <= WIDE else np.float64
    X, mass, factor = base.shapes.astype(wide), system.mass, system.stiffness_factor
    sizes = np.abs(base.shapes)
    # The factor G, K = G^T G, loses the digits of w_max/w_1, and K those of its square.
    if factor is not None:
        bent = factor.astype(wide) @ X
        S, terms = bent.T @ bent, np.abs(bent.astype(float)).T @ (np.abs(factor) @ sizes)
    else:
        S, terms = X.T @ (system.stiffness.astype(wide) @ X), sizes.T @ (np.abs(system.stiffness) @ sizes)
    # Springs are added in extended precision: beside a hard one, K would lose its soft digits.
    for row, kappa in springs:
        seen = row.astype(wide) @ X
        S = S + wide(kappa) * np.outer(seen, seen)
        terms = terms + kappa * np.outer(np.abs(seen).astype(float), np.abs(row) @ sizes)
    lumped = np.diag(mass)  # n^2 operations for n^3, where the mass is
    R = X.T @ (lumped[:, None] * X if np.count_nonzero(mass) == np.count_nonzero(lumped) else mass.astype(wide) @ X)
    squares = np.diag(S) / np.diag(R)
    apart = (squares[None, :] - squares[:, None]).astype(float)
    # Squares that agree to half the digits of float64 count as equal: a quotient by their difference is rounding.
    near = np.abs(apart) <= 1e-8 * np.maximum(squares[None, :], squares[:, None]).astype(float)
    rigid = base.omega == 0.0  # any two rigid motions are as good as two others
    near |= rigid[:, None] & rigid[None, :]
    apart = np.where(near, 1.0, apart)
    E = np.where(near, -0.5 * R.astype(float), (S - squares * R).astype(float) / apart)
    np.fill_diagonal(E, (0.5 * (1 - np.diag(R))).astype(float))
    # Rounding of S in the precision used, in units of the eps of float64.
    lost = float(np.finfo(wide).eps) / float(np.finfo(float).eps) * (terms + terms.T)
    return Correction(base, squares.astype(float), E, np.where(near, 0.0, lost / apart), np.diag(lost).copy())
