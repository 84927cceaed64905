"""The generator of a regime, its derivatives in parameters, and the flow of both.

    Z = (q, q', g),  Z' = A Z,  g = (1, sin w t, cos w t, ..., s, s^2, s^3)
    [dZ]'   [A  dA] [dZ]
    [ Z]  = [0   A] [ Z],   exp of it holds  L_jl = G_jl (exp(l_j tau) - exp(l_l tau))/(l_j - l_l),  G = W dA V

in eigenvectors A = V diag(l) W. Loads and moving stops are in A, so that a parameter of theirs, the frequency too, is
one more dA. Where eigenvectors are no basis (rigid motions under load, resonance, critical damping, records) the block
exponential is taken as it stands.

Accelerations come of M a - H^T R = F g - C q' - K q,  H a = -o'', with the rows H of the contacts that are held (rigid
stops); of pressed compliant ones K and C have kappa row row^T and c row row^T.
Source: Van Loan, IEEE Trans. Automat. Control 23 (1978) 395-404; Najfeld and Havel, Adv. Appl. Math. 16 (1995) 321-375.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, cast

import numpy as np
from scipy.linalg import eigh, expm, lapack, solve_triangular

from ...basics.arrays import Array, IntArray
from ...model.sampled import Sampled, moved
from ...model.system import System
from ...model.system_data import SystemData, data_of, load_terms, offset_terms
from ...model.time_functions import Constant, Harmonic

WORST = 1e5  # condition of the eigenvectors, in units of energy, up to which they are used
NEAR = 0.05  # of the lowest frequency: eigenvalues that lie closer have their difference by sinh(x)/x
KEPT = 100  # unknowns up to which eigenvectors are kept for the next system
RECORD_TERMS = 3  # s, s^2, s^3
Complex = Any  # arrays of complex128


class TimeBasis:
    """Functions g(t) (d,) of which loads and offsets are made, and how they depend on the parameters.

    Two harmonics share a pair where frequency and its derivatives are equal. edges: the times of all samples; between
    two of them s is the time since the last.
    """

    def __init__(self, system: System, data: SystemData, columns: Sequence[SystemData]) -> None:
        self.leaves = [leaf for _, leaf in load_terms(system)] + [leaf for _, _, leaf in offset_terms(system)]
        self.records = [leaf for leaf in self.leaves if isinstance(leaf, Sampled)]
        # Harmonics of one frequency with the same derivatives of it share a pair of functions.
        rates = np.array([x.harmonics[:, 1] for x in columns]).reshape(len(columns), len(data.harmonics))
        keys = [(w, *rates[:, k].tolist()) for k, w in enumerate(data.harmonics[:, 1].tolist())]
        pairs = list(dict.fromkeys(keys))
        self.pair = [pairs.index(key) for key in keys]
        self.frequencies = np.array([key[0] for key in pairs], float)
        self.edges = np.unique(np.concatenate([np.zeros(0), *(record.t for record in self.records)]))
        self.F, self._edges = len(pairs), self.edges.tolist()
        self.size = 1 + 2 * self.F + (RECORD_TERMS if self.records else 0)
        self.R = self._generator(self.frequencies)
        if self.records:
            # s' = 1, (s^2)' = 2 s, (s^3)' = 3 s^2
            k = 1 + 2 * self.F
            self.R[k, 0], self.R[k + 1, k], self.R[k + 2, k + 1] = 1.0, 2.0, 3.0
        self.dR = [self._generator(np.array([key[1 + p] for key in pairs], float)) for p in range(len(columns))]

    @cached_property
    def waves(self) -> tuple[Complex, Complex]:
        """Eigenvalues and orthonormal eigenvectors of R without records: 0, and +- i w with (-+ i, 1)/sqrt 2."""
        G = np.eye(1 + 2 * self.F, dtype=complex)
        for k in range(1, 1 + 2 * self.F, 2):
            G[k : k + 2, k : k + 2] = np.sqrt(0.5) * np.array([[-1j, 1j], [1.0, 1.0]])
        return np.concatenate([[0.0], *np.multiply.outer(self.frequencies, [1j, -1j])]), G

    def _generator(self, frequencies: Array) -> Array:
        R = np.zeros((self.size, self.size))
        for i, w in enumerate(frequencies.tolist()):
            R[1 + 2 * i, 2 + 2 * i], R[2 + 2 * i, 1 + 2 * i] = w, -w
        return R

    def interval(self, t: float) -> int:
        """The edge that a time follows, 0 where there are no records."""
        return min(max(bisect_right(self._edges, t) - 1, 0), max(len(self._edges) - 2, 0))

    def values(self, t: float, interval: int) -> Array:
        """g(t), (d,)."""
        return self.all_values(np.array([t]), [interval])[0]

    def all_values(self, t: Array, intervals: Sequence[int]) -> Array:
        """g at times (k,), (k, d)."""
        g, phase = np.ones((len(t), self.size)), np.multiply.outer(t, self.frequencies)
        g[:, 1 : 1 + 2 * self.F : 2], g[:, 2 : 2 + 2 * self.F : 2] = np.sin(phase), np.cos(phase)
        if self.records:
            g[:, 1 + 2 * self.F :] = (t - self.edges[intervals])[:, None] ** np.arange(1, 1 + RECORD_TERMS)
        return g

    def terms(self, data: SystemData, interval: int, by: SystemData | None = None) -> Array:
        """(leaves, d), every leaf in g; of its derivative where ``by`` has those of the data."""
        rows = np.zeros((len(self.leaves), self.size))
        h = k = piece = 0
        for row, leaf in zip(rows, self.leaves, strict=True):
            if isinstance(leaf, Harmonic):
                a, _, phase = data.harmonics[h]
                at = 1 + 2 * self.pair[h]
                # a sin(w t + phase)
                if by is None:
                    row[at], row[at + 1] = a * np.cos(phase), a * np.sin(phase)
                else:  # that of the frequency is in dR
                    da, _, turn = by.harmonics[h]
                    row[at] = da * np.cos(phase) - a * turn * np.sin(phase)
                    row[at + 1] = da * np.sin(phase) + a * turn * np.cos(phase)
                h += 1
            elif isinstance(leaf, Constant):
                row[0] = (data if by is None else by).constants[k]
                k += 1
            elif isinstance(leaf, Sampled):
                # The record's polynomial of this interval, about the last edge instead of its last sample.
                start = self.edges[interval]
                i = int(np.clip(np.searchsorted(leaf.t, start, side="right") - 1, 0, len(leaf.t) - 2))
                c = moved((data if by is None else by).records[piece + i], float(start - leaf.t[i]))
                row[0], row[1 + 2 * self.F :] = c[0], c[1:]
                piece += len(leaf.t) - 1
        return rows


@dataclass(frozen=True, eq=False)
class Forms:
    """Linear forms of Z in one interval between samples: loads (d, n), positions of contacts and tip (m + 1, N)."""

    force: Array
    positions: Array


class Generators:
    """Generators of all regimes of a system, with their derivatives in the ``columns`` of parameters."""

    def __init__(self, system: System, columns: Sequence[SystemData] = ()) -> None:
        self.system, self.data, self.columns = system, data_of(system), list(columns)
        self.basis = TimeBasis(system, self.data, self.columns)
        self.n, self.m, self.N = system.size, len(system.contacts), 2 * system.size + self.basis.size
        self.count = len(self.columns)
        self._regimes: dict[tuple[Any, ...], RegimeFlow] = {}
        self._forms: dict[int, tuple[Forms, list[Forms]]] = {}
        self._loads = len(load_terms(system))
        self._offsets = [(i, factor) for i, factor, _ in offset_terms(system)]

    def forms(self, interval: int) -> tuple[Forms, list[Forms]]:
        """Forms in an interval between samples, and their derivatives in every column."""
        if interval not in self._forms:
            basis, data = self.basis, self.data
            terms = basis.terms(data, interval)
            own = self._form(data, terms, data.loads, data.factors, data.rows, data.observe)
            derived = []
            for column in self.columns:
                turned = basis.terms(data, interval, column)
                # The product rule: once the functions vary, once the loads and rows.
                parts = [
                    self._form(data, turned, data.loads, data.factors, 0.0 * data.rows, 0.0 * data.observe),
                    self._form(data, terms, column.loads, column.factors, column.rows, column.observe),
                ]
                first, second = parts
                derived.append(Forms(first.force + second.force, first.positions + second.positions))
            self._forms[interval] = own, derived
        return self._forms[interval]

    def _form(self, data: SystemData, terms: Array, loads: Array, factors: Array, rows: Array, tip: Array) -> Forms:
        positions = np.zeros((self.m + 1, self.N))
        positions[: self.m, : self.n] = rows
        for (i, _), factor, term in zip(self._offsets, factors.tolist(), terms[self._loads :], strict=True):
            positions[i, 2 * self.n :] += factor * term
        positions[self.m] = positions[0] if self.system.observe is None else 0.0
        if self.system.observe is not None:
            positions[self.m, : self.n] = tip
        return Forms(terms[: self._loads].T @ loads, positions)

    def regime(self, sides: tuple[int, ...], held: bool, interval: int) -> RegimeFlow:
        """The regime with contacts pressed on these sides, compliant, or ``held`` there, rigid."""
        key = (*sides, held, interval if self.basis.records else 0)
        if key not in self._regimes:
            self._regimes[key] = RegimeFlow(self, sides, held, interval)
        return self._regimes[key]

    def gap(self, contact: int, side: int, interval: int) -> tuple[Array, list[Array]]:
        """The form u - g of a contact, zero on its stop on that side, and its derivatives in every column."""
        own, derived = self.forms(interval)
        form, one = own.positions[contact].copy(), 2 * self.n
        stop = "upper" if side > 0 else "lower"
        form[one] -= getattr(self.data, stop)[contact]
        moved_by = [x.positions[contact].copy() for x in derived]
        for each, column in zip(moved_by, self.columns, strict=True):
            each[one] -= getattr(column, stop)[contact]
        return form, moved_by

    def rate(self, form: Array, derived: Sequence[Array]) -> tuple[Array, list[Array]]:
        """The rate of a form of positions, without accelerations: of (r, 0, o) it is (0, r, R^T o)."""
        n, R = self.n, self.basis.R

        def turned(x: Array, R: Array) -> Array:
            return np.concatenate([np.zeros(n), x[:n], x[2 * n :] @ R])

        moved_by = [turned(x, R) for x in derived]
        for each, dR in zip(moved_by, self.basis.dR, strict=True):
            each[2 * n :] += form[2 * n :] @ dR
        return turned(form, R), moved_by

    def pressure(self, contact: int, side: int, interval: int) -> tuple[Array, list[Array]]:
        """The form kappa (u - g) + c u', the force of a pressed contact but for its sign, and its derivatives."""
        gap, gaps = self.gap(contact, side, interval)
        rate, rates = self.rate(gap, gaps)
        kappa, c = self.data.kappa[contact], self.data.c[contact]
        derived = [
            kappa * a + c * b + x.kappa[contact] * gap + x.c[contact] * rate
            for a, b, x in zip(gaps, rates, self.columns, strict=True)
        ]
        return kappa * gap + c * rate, derived


class RegimeFlow:
    """Flow of Z and of its derivatives in one regime.

    A: (N, N). dA: one for each column. acceleration: (n, N) of it. reactions: (h, N) of the held contacts.
    """

    def __init__(self, generators: Generators, sides: tuple[int, ...], held: bool, interval: int) -> None:
        self.generators, n, N = generators, generators.n, generators.N
        data, basis = generators.data, generators.basis
        own, derived = generators.forms(interval)
        # [M, -H^T; H, 0] (a, R) = right Z, and the slopes of the right side in every column.
        closed = [i for i, side in enumerate(sides) if side]
        self.held = closed if held else []
        M, H = data.mass, data.rows[self.held]
        right = np.zeros((n + len(self.held), N))
        right[:n, :n], right[:n, n : 2 * n], right[:n, 2 * n :] = -data.stiffness, -data.damping, own.force.T
        self.stiffness = data.stiffness.copy()
        slopes = []
        for x, form in zip(generators.columns, derived, strict=True):
            slope = np.zeros_like(right)
            slope[:n, :n], slope[:n, n : 2 * n], slope[:n, 2 * n :] = -x.stiffness, -x.damping, form.force.T
            slopes.append(slope)
        # Held contacts add rows H a = -o''; pressed ones add their force to the right side.
        if held:
            for k, i in enumerate(self.held):
                right[n + k, 2 * n :], moved_by = self._curve(basis, own, derived, i)
                for slope, row in zip(slopes, moved_by, strict=True):
                    slope[n + k, 2 * n :] = row
        else:
            for i in closed:
                force, forces = generators.pressure(i, sides[i], interval)
                right[:n] -= np.outer(data.rows[i], force)
                self.stiffness += data.kappa[i] * np.outer(data.rows[i], data.rows[i])
                for slope, x, moved_by in zip(slopes, generators.columns, forces, strict=True):
                    slope[:n] -= np.outer(x.rows[i], force) + np.outer(data.rows[i], moved_by)
        # The derivative of the solution X: the same equation with the change of its matrix on the right.
        solve = saddle(M, H)
        X = solve(right)
        self.acceleration, self.reactions = X[:n], X[n:]
        self.A = self._generator(X[:n], basis.R, 1.0)
        for slope, x in zip(slopes, generators.columns, strict=True):
            if self.held or x.mass.any():
                slope -= saddle_times(x.mass, x.rows[self.held], X)
        dX = np.split(solve(np.hstack(slopes)), len(slopes), axis=1) if slopes else []
        self.dA = [self._generator(x[:n], dR, 0.0) for x, dR in zip(dX, basis.dR, strict=True)]
        self.reaction_slopes = [x[n:] for x in dX]

    @staticmethod
    def _curve(basis: TimeBasis, own: Forms, derived: list[Forms], i: int) -> tuple[Array, list[Array]]:
        """-o'' of a held contact in g, and its derivatives."""
        R = basis.R
        o = own.positions[i, -basis.size :]
        rows = []
        for form, dR in zip(derived, basis.dR, strict=True):
            rows.append(-(form.positions[i, -basis.size :] @ R @ R + o @ dR @ R + o @ R @ dR))
        return -(o @ R @ R), rows

    def _generator(self, acceleration: Array, R: Array, unit: float) -> Array:
        n, N = self.generators.n, self.generators.N
        A = np.zeros((N, N))
        A[range(n), range(n, 2 * n)] = unit
        A[n : 2 * n], A[2 * n :, 2 * n :] = acceleration, R
        return A

    @cached_property
    def eigen(self) -> tuple[Complex, Complex, Complex] | None:
        """(l, V, W) with A = V diag(l) W, None where eigenvectors are no basis.

        A = [A_h, F; 0, R]: the eigenvectors of A_h, and beside each one of R the answer to it.
        """
        h, N, basis = 2 * self.generators.n, self.generators.N, self.generators.basis
        # The powers of time are a Jordan chain.
        if basis.records:
            return None
        matrices = self.A[:h, :h], self.stiffness, self.generators.data.mass
        of_matrices = vibrations if h <= 2 * KEPT else vibrations.__wrapped__
        made = of_matrices(*(np.ascontiguousarray(x).tobytes() for x in matrices))
        free, right, left, energy, lowest, condition = made
        if not condition < WORST:
            return None
        rates, G = basis.waves
        # (rate - A_h) x = F g; nothing answers a force of zero.
        pushed = left @ (self.A[:h, h:] @ G)
        with np.errstate(divide="ignore", invalid="ignore"):
            answer = np.where(pushed == 0.0, 0.0, pushed / (rates - free[:, None]))
        # Units of the time functions that bring forces to the size of the lowest frequency.
        force = float(np.max(np.abs(energy @ self.A[:h, h:]), initial=0.0)) / lowest or 1.0
        # A bound of |V| |W|, the vectors in energy and of length one.
        if not condition * (1 + N - h) * (1.0 + 1.5 * answer.size**0.5 * np.max(np.abs(answer)) / force) < WORST:
            return None
        V, W = np.zeros((2, N, N), complex)
        V[:h, :h], V[:h, h:], V[h:, h:] = right, right @ answer, G
        W[:h, :h], W[:h, h:], W[h:, h:] = left, -answer @ G.conj().T, G.conj().T
        return np.concatenate([free, rates]), V, W

    @cached_property
    def upper(self) -> tuple[Complex, Complex, Complex]:
        """(l, V, W) of one of two conjugate eigenvalues, (H,), (N, H) and (H, N): real motions are Re V exp(l t) W."""
        assert self.eigen is not None
        rates, V, W = self.eigen
        half = rates.imag >= 0.0
        return rates[half], V[:, half] * np.where(rates[half].imag > 0.0, 2.0, 1.0), W[half]

    @cached_property
    def balance(self) -> Array:
        """Units (N,) in which rates, and loads beside forces of springs, are of one size: else digits are lost."""
        n, N = self.generators.n, self.generators.N
        scale = np.ones(N)
        scale[n : 2 * n] = np.sqrt(np.linalg.norm(self.A[n : 2 * n, :n])) or 1.0
        scale[2 * n :] = scale[n] ** 2 / (np.linalg.norm(self.A[n : 2 * n, 2 * n :]) or scale[n] ** 2)
        return scale

    @property
    def fastest(self) -> float:
        """The largest angular frequency of the regime."""
        rates = np.linalg.eigvals(self.A) if self.eigen is None else self.eigen[0]
        return float(np.max(np.abs(np.imag(rates)), initial=0.0))

    @cached_property
    def coupling(self) -> tuple[IntArray, Complex, Complex, tuple[IntArray, IntArray], Complex]:
        """The columns (p,) that change A, and of their G = W dA V, rows j (H,) of ``upper``: B (p, H, N) = G_jl/(l_j -
        l_l) of eigenvalues apart, G_jj (p, H), and which other pairs (j, l) are near, with their G (p, k)."""
        assert self.eigen is not None
        rates, V, _ = self.eigen
        values, _, W = self.upper
        active = [p for p, dA in enumerate(self.dA) if np.any(dA)]
        G = np.zeros((len(active), len(values), len(rates)), complex)
        for each, p in zip(G, active, strict=True):  # most columns change few entries
            rows, columns = np.flatnonzero(self.dA[p].any(axis=1)), np.flatnonzero(self.dA[p].any(axis=0))
            each[:] = (W[:, rows] @ self.dA[p][np.ix_(rows, columns)]) @ V[columns]
        # Differences of near eigenvalues cancel: their pairs are left to sinh(x)/x. Zeros do not count as lowest.
        apart = values[:, None] - rates
        sizes = np.abs(values)
        lowest = float(np.min(sizes[sizes > 1e-6 * np.max(sizes)], initial=np.max(sizes)))
        near = np.abs(apart) < max(NEAR * lowest, 1e-300)
        B = G * np.divide(1.0, apart, out=np.zeros_like(apart), where=~near)
        at = np.flatnonzero(self.eigen[0].imag >= 0.0)
        near[range(len(at)), at] = False
        j, k = np.nonzero(near)
        return np.array(active, np.int64), B, G[:, range(len(at)), at], (j, k), G[:, j, k]

    def flow(self, tau: float) -> Array:
        """exp(A tau), (N, N)."""
        return self.ahead(np.eye(self.generators.N), tau)

    def flows(self, tau: Array) -> Array:
        """``flow`` of each of tau (k,), (k, N, N)."""
        if self.eigen is None:
            return np.array([self.flow(x) for x in tau.tolist()])
        # One real product: the real part of the complex one.
        rates, V, W = self.upper
        left = V * np.exp(np.multiply.outer(tau, rates))[:, None]
        return np.concatenate([left.real, left.imag], axis=2) @ np.concatenate([W.real, -W.imag])

    def ahead(self, dZ: Array, tau: float) -> Array:
        """exp(A tau) dZ, (N, columns)."""
        if self.eigen is None:
            scale = self.balance
            return scale[:, None] * (expm(self.A * (tau * scale / scale[:, None])) @ (dZ / scale[:, None]))
        values, V, W = self.upper
        return (V @ (np.exp(values * tau)[:, None] * (W @ dZ))).real

    def seen(
        self, forms: Array | None, Z: Array, dZ: Array | None, tau: Array, start: IntArray | None = None
    ) -> tuple[Array, Array]:
        """Values (k, f) of forms (f, N) at tau (k,) later than the starts Z (s, N), and derivatives (k, f, D).

        forms: None for all of Z.
        dZ: (s, N, D) at the starts, of which the first columns are those of dA; None for zeros. start: (k,), numbers of
        the starts.
        """
        start = np.arange(len(tau)) if start is None else start
        D = len(self.dA) if dZ is None else dZ.shape[2]
        if self.eigen is None:
            forms = np.eye(len(self.A)) if forms is None else forms
            values, slopes = np.empty((len(tau), len(forms))), np.empty((len(tau), len(forms), D))
            for i, (s, x) in enumerate(zip(start.tolist(), tau.tolist(), strict=True)):
                E, moved = self._blocks(x)
                values[i], slopes[i] = forms @ (E @ Z[s]), 0.0 if dZ is None else forms @ (E @ dZ[s])
                for p, dE in moved.items():
                    slopes[i, :, p] += forms @ (dE @ Z[s])
            return values, slopes
        all_rates, _, all_W = self.eigen
        rates, V, W = self.upper
        active, B, same, (j, m), near = self.coupling
        U = (V if forms is None else forms @ V).T
        real = np.concatenate([U.real, -U.imag])  # the real part of a complex product in one real one
        c, E = (Z @ all_W.T)[start], np.exp(np.multiply.outer(tau, all_rates))
        at = np.flatnonzero(all_rates.imag >= 0.0)
        here, carried = E[:, at], E * c
        # Derivatives of the coefficients (D, k, H): those of the starts carried on, then what dA adds.
        moved = np.zeros((D, len(tau), len(rates)), complex)
        if dZ is not None:
            moved += here * np.moveaxis(W @ dZ, 2, 0)[:, start]
        if len(active):
            # Pairs apart are a difference of two products, an eigenvalue with itself tau exp(l tau).
            turned = np.concatenate([c, carried]) @ B.transpose(0, 2, 1)
            added = here * turned[:, : len(tau)] - turned[:, len(tau) :] + tau[:, None] * carried[:, at] * same[:, None]
            # L of near pairs: (exp(l_j tau) - exp(l_m tau))/(l_j - l_m) = tau exp of the mean times sinh(half)/half.
            if len(j):
                half = np.multiply.outer(tau, 0.5 * (rates[j] - all_rates[m]))
                with np.errstate(invalid="ignore", divide="ignore"):
                    # Below 1e-4 the series errs by half^4/120 < 1e-18.
                    ratio = np.where(np.abs(half) < 1e-4, 1.0 + half**2 / 6.0, np.sinh(half) / half)
                beside = (
                    tau[:, None] * np.exp(np.multiply.outer(tau, 0.5 * (rates[j] + all_rates[m]))) * ratio * c[:, m]
                )
                added += (beside * near[:, None]) @ np.eye(len(rates))[j]
            moved[active] += added
        y: Complex = np.concatenate([carried[None, :, at], moved])
        seen = np.concatenate([y.real, y.imag], axis=2) @ real
        return seen[0], np.moveaxis(seen[1:], 0, 2)

    def _blocks(self, tau: float) -> tuple[Array, dict[int, Array]]:
        """exp(A tau) and its derivatives in the columns that change it, by Van Loan's block exponential, balanced."""
        N, scale = len(self.A), self.balance
        block, turn, E, moved = np.zeros((2 * N, 2 * N)), scale / scale[:, None], None, {}
        block[:N, :N] = block[N:, N:] = self.A * turn
        for p, dA in enumerate(self.dA):
            if np.any(dA):
                block[:N, N:] = dA * turn
                # The result is linear in dA: at the size of A it does not determine how often expm squares.
                size = float(np.max(np.abs(block[:N, N:]))) / max(float(np.max(np.abs(block[:N, :N]))), 1e-300)
                block[:N, N:] /= size
                E, moved[p] = (x / turn for x in np.split(expm(block * tau)[:N], 2, axis=1))
                moved[p] *= size
        return self.flow(tau) if E is None else E, moved


@lru_cache(maxsize=16)
def vibrations(motion: bytes, stiffness: bytes, mass: bytes) -> tuple[Complex, Complex, Complex, Array, float, float]:
    """(l, V, W) of A_h (2n, 2n), the coordinates of energy, its lowest frequency and the condition of V in energy.

    In coordinates of energy, |L_K^T q|^2 + |L_M^T q'|^2, eigenvectors of a conservative regime are orthogonal. Systems
    that differ by their loads share these.
    """
    M, K = np.frombuffer(mass), np.frombuffer(stiffness)
    n = math.isqrt(len(M))
    M, K, A = M.reshape(n, n), K.reshape(n, n), np.frombuffer(motion).reshape(2 * n, 2 * n)
    # Coordinates of energy need a positive definite stiffness. Where a motion strains nothing, a small shift is added
    # for the coordinates alone: A is unchanged.
    squares = eigh(K, M, eigvals_only=True)
    rigid = squares[0] < 1e-9 * squares[-1] or not squares[-1] > 0.0  # a motion that strains nothing
    shift = (1e-6 * max(float(squares[-1]), 0.0) or 1.0) if rigid else 0.0
    a, b = np.linalg.cholesky(K + shift * M).T, np.linalg.cholesky(M).T
    T, back = np.zeros((2, 2 * n, 2 * n))
    T[:n, :n], T[n:, n:] = a, b
    back[:n, :n], back[n:, n:] = (solve_triangular(x, np.eye(n)) for x in (a, b))
    values, V = (np.asarray(x, complex) for x in np.linalg.eig(T @ A @ back))
    try:
        W = np.linalg.inv(V)
        condition = float(np.linalg.norm(V, 2) * np.linalg.norm(W, 2))
    except np.linalg.LinAlgError:
        W, condition = V, np.inf
    # A positive real part is rounding, and would grow.
    values = np.minimum(np.real(values), 0.0) + 1j * np.imag(values)
    return values, back @ V, W @ T, T, float(np.sqrt(max(squares[0], 0.0) + shift)), condition


def saddle(M: Array, H: Array) -> Callable[[Array], Array]:
    """Solver of [M, -H^T; H, 0] X = right, by the Schur complement."""
    n, solver = len(M), cast("Any", lapack)  # of a matrix that was checked: without the checks of cho_factor
    factor = solver.dpotrf(M)[0]

    def unheld(right: Array) -> Array:
        return solver.dpotrs(factor, right)[0]

    if not len(H):
        return unheld
    back = unheld(H.T)
    inner = H @ back

    def solve(right: Array) -> Array:
        x, R = unheld(right[:n]), np.zeros_like(right[n:])
        for _ in range(2):  # what rounding leaves of forces that cancel would move a body at rest
            step = np.linalg.solve(inner, right[n:] - H @ x)
            x, R = x + back @ step, R + step
        return np.concatenate([x, R])

    return solve


def saddle_times(M: Array, H: Array, X: Array) -> Array:
    """[M, -H^T; H, 0] X."""
    n = len(M)
    return np.concatenate([M @ X[:n] - H.T @ X[n:], H @ X[:n]])
