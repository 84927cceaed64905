"""An exact motion and its derivatives, in the modes of the free system, as one linear system in every regime:

    y = (q, q', 1, functions of time),   y' = A y,   dy' = A dy + dA y

    M q'' = f - C q' - K q + rows^T F,   F = -(kappa (u - g) + c u') of a pressed compliant contact

F of a contact held by a rigid stop keeps u'' = 0. Derivatives of all that is made of a system's numbers are complex
steps: the imaginary part, over h, of the same formula with numbers off by i h times their own derivatives.
Source: Squire and Trapp, SIAM Review 40 (1998) 110-112.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import expm

from ...basics.arrays import Array
from ...basics.validation import InputError
from ...model.system import System
from ...model.system_data import SystemData, data_of, load_terms, offset_terms
from ...model.time_functions import Constant, Harmonic, Sampled, moved
from .free import free_system, pressed_modes

TERMS = 33  # of a series over RADIANS: 4^33/33! is below rounding
RADIANS = 4.0  # of the fastest motion of a regime in a step
STEP = 1e-100  # of complex steps, whose square is nothing
FACTORIALS = np.array([1.0, 1.0, 2.0, 6.0])


class Numbers:
    """The linear systems of a system with these ``data`` in modes, real or off by i STEP.

    position, rate, curve: (m, N) forms of u, u' and o'' of contacts. seen: (N,) form of the tip.
    """

    def __init__(self, system: System, data: SystemData) -> None:
        self.data, self.n, m = data, len(data.mass), len(data.rows)
        loads, offsets = load_terms(system), offset_terms(system)
        self.leaves = [leaf for _, leaf in loads] + [leaf for _, _, leaf in offsets]
        # Functions of time as states: 1; a sin and a cos of a harmonic; a piece of a record and its derivatives.
        widths = [2 * isinstance(leaf, Harmonic) + 4 * isinstance(leaf, Sampled) for leaf in self.leaves]
        self.places = 1 + np.cumsum([0, *widths])[:-1]
        kind = complex if np.iscomplexobj(data.mass) else float
        values, self.drives = np.zeros((len(widths), 1 + sum(widths)), kind), np.zeros(2 * [1 + sum(widths)], kind)
        harmonics, constants = iter(data.harmonics), iter(data.constants)
        for value, leaf, at in zip(values, self.leaves, self.places.tolist(), strict=True):
            value[0 if isinstance(leaf, Constant) else at] = 1.0
            if isinstance(leaf, Harmonic):
                w = next(harmonics)[1]
                self.drives[at, at + 1], self.drives[at + 1, at] = w, -w
            elif isinstance(leaf, Constant):
                value[0] = next(constants)
            else:
                self.drives[[at, at + 1, at + 2], [at + 1, at + 2, at + 3]] = 1.0
        place = np.eye(m)[[i for i, _, _ in offsets]]
        shift = (data.factors[:, None] * place).T @ values[len(loads) :]
        none = np.zeros((m, self.n))
        self.loads = data.loads.T @ values[: len(loads)]
        self.position, self.rate = (
            np.hstack([data.rows, none, shift]),
            np.hstack([none, data.rows, shift @ self.drives]),
        )
        self.curve = np.hstack([none, none, shift @ self.drives @ self.drives])
        self.seen, self.seen_rate = (
            (self.position[0], self.rate[0])
            if system.observe is None
            else (np.pad(data.observe, (k * self.n, (1 - k) * self.n + len(self.drives))) for k in (0, 1))
        )

    def driven(self, t: Array, since: Array) -> Array:
        """The functions of time as states (S, d) at t (S,), behind the samples at ``since`` (S,)."""
        found = np.zeros((len(t), len(self.drives)), self.drives.dtype)
        found[:, 0] = 1.0
        harmonics, piece = iter(self.data.harmonics), 0
        for leaf, at in zip(self.leaves, self.places.tolist(), strict=True):
            if isinstance(leaf, Harmonic):
                amplitude, w, phase = next(harmonics)
                found[:, at], found[:, at + 1] = amplitude * np.sin(w * t + phase), amplitude * np.cos(w * t + phase)
            elif isinstance(leaf, Sampled):
                i = np.clip(np.searchsorted(leaf.t, since, side="right") - 1, 0, len(leaf.t) - 2)
                found[:, at : at + 4] = moved(self.data.records[piece + i], t - leaf.t[i]) * FACTORIALS
                piece += len(leaf.t) - 1
        return found

    def gap(self, contact: int, side: int) -> Array:
        """The form (N,) of u - g."""
        form = self.position[contact].copy()
        form[2 * self.n] -= (self.data.upper if side > 0 else self.data.lower)[contact]
        return form

    def matrix(self, sides: Sequence[int], held: Sequence[int]) -> Array:
        """A (N, N) with contacts on the sides (m,) pressed, or those of them that are ``held``, rigid."""
        data, n = self.data, self.n
        right = np.hstack([-data.stiffness, -data.damping, self.loads])
        for i in np.flatnonzero(sides).tolist():
            if i not in held:
                force = data.kappa[i] * self.gap(i, sides[i]) + data.c[i] * self.rate[i]
                right = right - np.outer(data.rows[i], force)
        right, H = np.linalg.solve(data.mass, right), data.rows[held]
        back = np.linalg.solve(data.mass, H.T)
        # The second time takes what rounding left: a body at rest stays at rest.
        for _ in range(2 if held else 0):
            right = right - back @ np.linalg.solve(H @ back, H @ right + self.curve[held])
        A = np.zeros(2 * [2 * n + len(self.drives)], right.dtype)
        A[:n, n : 2 * n], A[n : 2 * n], A[2 * n :, 2 * n :] = np.eye(n), right, self.drives
        return A

    def kick(self, y: Array, taking: Sequence[int], e: Array) -> Array:
        """Change (B, n) of q' in states y (B, N) by a blow on the contacts ``taking`` part, (1 + e) times u'."""
        H = self.data.rows[taking]
        back = np.linalg.solve(self.data.mass, H.T)
        return -(back @ np.linalg.solve(H @ back, ((1.0 + e) * (y @ self.rate[taking].T)).T)).T


class Variation:
    """A system in its free modes, and neighbours off by i STEP times the derivatives of its data, ``columns``."""

    def __init__(self, system: System, columns: Sequence[SystemData] = ()) -> None:
        self.system, self.free = system, free_system(system)
        self.X, self.into = self.free.X, self.free.into
        self.n, self.P = system.size, len(columns)
        data, exact = self._in_modes(data_of(system)), {"mass": np.eye(self.n), "rows": self.free.rows}
        exact |= {"stiffness": np.diag(self.free.w2), "damping": self.free.damping}
        self.data = SystemData(**(vars(data) | exact))
        self.base, self.columns = Numbers(system, self.data), [self._in_modes(x) for x in columns]
        for x, y in ((x, y) for x, y in vars(self.data).items() if np.any(y)):
            if any(STEP * np.max(np.abs(vars(column)[x])) > 1e-20 * np.max(np.abs(y)) for column in self.columns):
                raise InputError("wrt", f"a change of {x}", "be of a size with it for a derivative", "use other units")
        off = [{x: y + 1j * STEP * vars(column)[x] for x, y in vars(self.data).items()} for column in self.columns]
        self.beside = [Numbers(system, SystemData(**x)) for x in off]
        leaves = self.base.leaves
        self.edges = np.unique(np.concatenate([np.zeros(0), *(x.t for x in leaves if isinstance(x, Sampled))]))
        self._regimes: dict[tuple[int, ...], Regime] = {}

    def _in_modes(self, data: SystemData) -> SystemData:
        X = self.X
        squares = {x: X.T @ getattr(data, x) @ X for x in ("mass", "damping", "stiffness")}
        rows = {x: getattr(data, x) @ X for x in ("rows", "loads", "observe")}
        starts = {"q0": data.q0 @ self.into, "v0": data.v0 @ self.into}
        return SystemData(**(vars(data) | squares | rows | starts))

    def regime(self, sides: Sequence[int]) -> Regime:
        """The regime with contacts on these sides (m,)."""
        key = tuple(sides)
        if key not in self._regimes:
            self._regimes[key] = Regime(self, key)
        return self._regimes[key]

    def whole(self, t: Array, since: Array, z: Array) -> Array:
        """States and derivatives y (S, 1 + D, N) at t (S,) from z (S, 1 + D, 2n), D of parameters first."""
        drives = np.zeros((*z.shape[:2], len(self.base.drives)))
        drives[:, 0] = self.base.driven(t, since)
        for p, numbers in enumerate(self.beside[: z.shape[1] - 1], 1):
            drives[:, p] = np.imag(numbers.driven(t, since)) / STEP
        return np.concatenate([z, drives], axis=2)


class Regime:
    """Motion and derivatives with contacts on ``sides``, the compliant of them pressed and the rigid ones held."""

    def __init__(self, variation: Variation, sides: tuple[int, ...]) -> None:
        self.variation, free, n = variation, variation.free, variation.n
        sides = tuple(x if x in (-1, 1) else 0 for x in sides)
        closed, rigid = np.flatnonzero(sides).tolist(), variation.system.rigid
        on, self.held = ([], closed) if rigid else (closed, [])
        self.A = variation.base.matrix(sides, self.held)
        slopes = [np.imag(x.matrix(sides, self.held)) / STEP for x in variation.beside]
        self.dA = np.array(slopes).reshape(-1, *self.A.shape)
        self.damping = -self.A[n : 2 * n, n : 2 * n]
        # Frequencies (n,) and modes (n, n) of the regime without damping, of pressed springs.
        self.vibrations = pressed_modes(free.w2, free.rows[on], variation.data.kappa[on])

    @cached_property
    def fastest(self) -> float:
        """A bound of the rates of all motions in this regime."""
        drives = [float(x.frequency) for x in self.variation.base.leaves if isinstance(x, Harmonic)]
        return max(float(np.max(self.vibrations[0])) + float(np.linalg.norm(self.damping, 2)), *drives, 1e-300)

    def flow(self, tau: float, dz: Array) -> Array:
        """Derivatives (D, 2n) at tau after dz without parameters."""
        n = self.variation.n
        if not self.held and not np.any(self.damping):
            w, modes = self.vibrations
            q, v = dz[:, :n] @ modes.T, dz[:, n:] @ modes.T
            cosine, sine = np.cos(w * tau), np.sin(w * tau)
            moved = q * cosine + v * np.where(w > 0.0, sine / np.where(w > 0.0, w, 1.0), tau)
            return np.hstack([moved @ modes, (v * cosine - q * (w * sine)) @ modes])
        A: Any = self.A[: 2 * n, : 2 * n]
        # Rates in units that make positions and rates of one size, or digits are lost.
        unit = np.repeat([1.0, np.sqrt(np.linalg.norm(A[n:, :n])) or 1.0], n)
        return dz @ (expm(A * (tau * unit / unit[:, None])) * (unit[:, None] / unit)).T

    def later(self, y: Array, late: Array) -> Array:
        """States and derivatives (S, 1 + D, N) at times ``late`` (S,) behind y, by their Taylor series."""
        term, found, by = y, y.copy(), min(len(self.dA), y.shape[1] - 1)
        for k in range(1, TERMS + 1):
            rate = term @ self.A.T
            if by:
                rate[:, 1:] += np.tensordot(term[:, 0], self.dA, (1, 2))
            term = rate * (late / k)[:, None, None]
            found += term
        return found
