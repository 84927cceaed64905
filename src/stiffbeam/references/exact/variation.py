"""The equations of variation of an exact motion, in the modes of the free system, by their Taylor series:

    q''  = f - D q' - W q + rows^T F
    dq'' = df - D dq' - W dq + rows^T dF - dD q' - dW q + drows^T F - dM q''

F is -(kappa (u - g) + c u') of a pressed compliant contact; that of a contact held by a rigid stop keeps u'' = 0. The
same recursion gives the coefficients of the motion and of all its derivatives, in every regime and under every load.
Without parameters the flow of the derivatives is linear, and its matrix exponential spans any time.
Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (1993), section I.14.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from ...basics.arrays import Array, IntArray
from ...model.system import System
from ...model.system_data import SystemData, data_of, load_terms, offset_terms
from ...model.time_functions import Constant, Drive, Harmonic, Sampled, moved
from .free import free_system, pressed_modes

TERMS = 33  # of a series over RADIANS: 4^33/33! is below rounding
RADIANS = 4.0  # of the fastest motion of a regime in a step


class Series(NamedTuple):
    """Taylor coefficients at S times, along the first axis; on the third the motion, then its D derivatives.

    eta: (K + 1, S, 1 + D, n) modes. u: (K + 1, S, 1 + D, m) positions of contacts. force: (K - 1, S, 1 + D, m) of
    stops.
    """

    eta: Array
    u: Array
    force: Array


class Variation:
    """A system in its free modes, and the derivatives of its data in the ``columns``, P parameters."""

    def __init__(self, system: System, columns: Sequence[SystemData] = ()) -> None:
        made = free_system(system, Drive.of(system))
        self.system, self.X, self.into, self.free = system, made.X, made.into, made.free
        self.n, self.m, self.P = system.size, len(system.contacts), len(columns)
        self.data, self.columns = self._in_modes(data_of(system)), [self._in_modes(x) for x in columns]
        loads, offsets = load_terms(system), offset_terms(system)
        self.leaves = [leaf for _, leaf in loads] + [leaf for _, _, leaf in offsets]
        self.loads, self._of_contact = len(loads), [i for i, _, _ in offsets]
        self.edges = np.unique(np.concatenate([np.zeros(0), *(x.t for x in self.leaves if isinstance(x, Sampled))]))
        self._regimes: dict[tuple[int, ...], Regime] = {}

    def _in_modes(self, data: SystemData) -> SystemData:
        X = self.X
        squares = {x: X.T @ getattr(data, x) @ X for x in ("mass", "damping", "stiffness")}
        rows = {x: getattr(data, x) @ X for x in ("rows", "loads", "observe")}
        starts = {"q0": data.q0 @ self.into, "v0": data.v0 @ self.into}
        return SystemData(**(vars(data) | squares | rows | starts))

    @cached_property
    def slopes(self) -> dict[str, Array]:
        """The derivatives of every array of the data, (P, ...)."""
        return {
            name: np.array([getattr(x, name) for x in self.columns]).reshape(self.P, *base.shape)
            for name, base in vars(self.data).items()
        }

    def regime(self, sides: Sequence[int]) -> Regime:
        """The regime with contacts on these sides (m,)."""
        key = tuple(sides)
        if key not in self._regimes:
            self._regimes[key] = Regime(self, key)
        return self._regimes[key]

    def gap(self, u: Array, contacts: Sequence[int], sides: Sequence[int]) -> Array:
        """u - g of positions (..., 1 + D, contacts) and of their derivatives, from the stops on these sides."""
        gap, P = np.array(u), min(self.P, u.shape[-2] - 1)
        for k, (i, side) in enumerate(zip(contacts, sides, strict=True)):
            name = "upper" if side > 0 else "lower"
            gap[..., 0, k] -= getattr(self.data, name)[i]
            gap[..., 1 : 1 + P, k] -= self.slopes[name][:P, i]
        return gap

    def pressure(self, gap: Array, rate: Array, contacts: Sequence[int]) -> Array:
        """kappa (u - g) + c u' and its derivatives, (..., 1 + D, contacts)."""
        kappa, c = ((getattr(self.data, x)[contacts], self.slopes[x][:, contacts]) for x in ("kappa", "c"))
        force, P = kappa[0] * gap + c[0] * rate, min(self.P, gap.shape[-2] - 1)
        force[..., 1 : 1 + P, :] += kappa[1][:P] * gap[..., :1, :] + c[1][:P] * rate[..., :1, :]
        return force

    def damped(self, x: Array) -> Array:
        """D x of the last axis."""
        return x @ self.free.damping.T if self.free.coupling == 2 else x * self.free.drag

    def drive(self, t: Array, since: Array, K: int) -> Array:
        """Taylor coefficients (S, K + 1, 1 + P, leaves) of the functions of time at t (S,), and of their derivatives.

        since: (S,), times behind which, and before the next sample of a record, the times lie.
        """
        f = np.zeros((len(t), K + 1, 1 + self.P, len(self.leaves)))
        h = c = piece = 0
        for j, leaf in enumerate(self.leaves):
            if isinstance(leaf, Harmonic):
                amplitude, w, phase = self.data.harmonics[h]
                sine, cosine = _waves(w, w * t + phase, K)
                f[..., 0, j] = amplitude * sine
                # The derivative of sin(w t + phase) by w is t cos(w t + phase).
                turned = t[:, None] * cosine
                turned[:, 1:] += cosine[:, :-1]
                for p, (da, dw, turn) in enumerate(self.slopes["harmonics"][:, h]):
                    f[..., 1 + p, j] = da * sine + amplitude * (turn * cosine + dw * turned)
                h += 1
            elif isinstance(leaf, Constant):
                f[:, 0, 0, j], f[:, 0, 1:, j] = self.data.constants[c], self.slopes["constants"][:, c]
                c += 1
            elif isinstance(leaf, Sampled):
                i = np.clip(np.searchsorted(leaf.t, since, side="right") - 1, 0, len(leaf.t) - 2)
                for p, records in enumerate((self.data.records, *self.slopes["records"])):
                    f[:, :4, p, j] = moved(records[piece + i], t - leaf.t[i])[:, : K + 1]
                piece += len(leaf.t) - 1
        return f

    def offsets(self, f: Array, D: int) -> Array:
        """Taylor coefficients (S, K + 1, 1 + D, m) of the offsets of contacts, from those of ``drive``."""
        place = np.eye(self.m)[self._of_contact]
        shift = np.zeros((*f.shape[:2], 1 + D, self.m))
        P = min(self.P, D)
        shift[:, :, : 1 + P] = f[:, :, : 1 + P] @ (self.data.factors[:, None] * place)
        for p in range(P):
            shift[:, :, 1 + p] += f[:, :, 0] @ (self.slopes["factors"][p][:, None] * place)
        return shift


class Regime:
    """Motion and derivatives with the contacts ``on`` pressed, compliant, or ``held``, rigid."""

    def __init__(self, variation: Variation, sides: tuple[int, ...]) -> None:
        self.variation, self.sides = variation, sides
        closed, rigid = [i for i, side in enumerate(sides) if side in (-1, 1)], variation.system.rigid
        self.on, self.held = ([], closed) if rigid else (closed, [])
        data, free = variation.data, variation.free
        self.kappa, self.c = data.kappa[self.on], data.c[self.on]
        self.rows, self.H = free.rows[self.on], free.rows[self.held]
        self.inverse = np.linalg.inv(self.H @ self.H.T)

    @cached_property
    def _changing(self) -> dict[str, Array]:
        """The derivatives of the matrices that have any."""
        names = "mass", "stiffness", "damping", "rows", "loads"
        return {x: self.variation.slopes[x] for x in names if np.any(self.variation.slopes[x])}

    def _by(self, name: str, x: Array) -> Array | float:
        """The derivatives (P, j, i) of a matrix times x (S, i), (S, P, j); 0 for none."""
        return np.einsum("pji,si->spj", self._changing[name], x) if name in self._changing else 0.0

    @cached_property
    def damping(self) -> Array:
        """Damping of the modes and of the pressed contacts, (n, n)."""
        free = self.variation.free
        D = free.damping if free.coupling == 2 else np.diag(free.drag)
        return D + (self.rows.T * self.c) @ self.rows

    @cached_property
    def vibrations(self) -> tuple[Array, Array]:
        """Frequencies (n,) and modes (n, n) of the regime without damping, of pressed springs."""
        return pressed_modes(self.variation.free.w2, self.rows, self.kappa)

    @cached_property
    def fastest(self) -> float:
        """A bound of the rates of all motions in this regime."""
        drives = [float(x.frequency) for x in self.variation.leaves if isinstance(x, Harmonic)]
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
        return dz @ self._exponential(tau).T

    def _exponential(self, tau: float) -> Array:
        n, free = self.variation.n, self.variation.free
        kept = np.eye(n) - self.H.T @ self.inverse @ self.H
        A = np.zeros((2 * n, 2 * n))
        A[:n, n:] = np.eye(n)
        A[n:, :n] = -kept @ (np.diag(free.w2) + (self.rows.T * self.kappa) @ self.rows)
        A[n:, n:] = -kept @ self.damping
        # Rates in units that make positions and rates of one size, or digits are lost.
        unit = np.repeat([1.0, np.sqrt(np.linalg.norm(A[n:, :n])) or 1.0], n)
        return expm(A * (tau * unit / unit[:, None])) * (unit[:, None] / unit)

    def series(self, t: Array, since: Array, z: Array, K: int = TERMS) -> Series:
        """Taylor coefficients at t (S,) from z (S, 1 + D, 2n), the motion and D derivatives, P by parameters first.

        since: see ``Variation.drive``. Without derivatives D is 0.
        """
        variation, (S, wide, _) = self.variation, z.shape
        n, m, by = variation.n, variation.m, min(variation.P, wide - 1)
        f = variation.drive(t, since, K)
        shift = np.moveaxis(variation.offsets(f[..., variation.loads :], wide - 1), 1, 0)
        loads = np.moveaxis(f[..., : variation.loads], 1, 0)
        eta, u, force = np.empty((K + 1, S, wide, n)), np.empty((K + 1, S, wide, m)), np.zeros((K - 1, S, wide, m))
        eta[0], eta[1] = z[..., :n], z[..., n:]
        for k in range(K + 1):
            if k > 1:
                eta[k] = self._term(k - 2, eta, u, force, loads[k - 2], shift[k])
            u[k] = shift[k] + eta[k] @ variation.free.rows.T
            if by:
                u[k][:, 1 : 1 + by] += self._by("rows", eta[k][:, 0])
        return Series(eta, u, force)

    def _term(self, k: int, eta: Array, u: Array, force: Array, loads: Array, shift: Array) -> Array:
        """Coefficient k + 2 (S, 1 + D, n), from those before it; that of the force is filled in.

        loads (S, 1 + P, L): coefficient k of the functions of time. shift (S, 1 + D, m): k + 2 of the offsets.
        """
        variation, on, own, rates = self.variation, self.on, eta[k], eta[k + 1]
        by, two = min(variation.P, own.shape[1] - 1), (k + 1.0) * (k + 2.0)
        right = -variation.free.w2 * own
        if variation.free.coupling:
            right -= (k + 1.0) * variation.damped(rates)
        right[:, : 1 + by] += loads[:, : 1 + by] @ variation.data.loads
        if on:
            gap = u[k][..., on] if k else variation.gap(u[0][..., on], on, [self.sides[i] for i in on])
            force[k][..., on] = -variation.pressure(gap, (k + 1.0) * u[k + 1][..., on], on)
            right += force[k] @ variation.free.rows
        self._react(right[:, :1], two * shift[:, :1], force[k][:, :1])
        if by:
            mine, motion = right[:, 1 : 1 + by], right[:, 0]
            mine -= self._by("stiffness", own[:, 0]) + (k + 1.0) * self._by("damping", rates[:, 0])
            if "loads" in self._changing:
                mine += np.einsum("sl,pln->spn", loads[:, 0], self._changing["loads"])
            if "rows" in self._changing:
                mine += np.einsum("sm,pmn->spn", force[k][:, 0], self._changing["rows"])
            mine -= self._by("mass", motion)
        if self.held:
            curve = two * shift[:, 1:]
            if by:
                curve[:, :by] += self._by("rows", right[:, 0])
            self._react(right[:, 1:], curve, force[k][:, 1:])
        return right / two

    def _react(self, right: Array, curve: Array, force: Array) -> None:
        """Add the reactions by which held contacts keep their places to ``right`` and to their forces; curve: second
        derivatives of the offsets."""
        # The second time takes what rounding left: a body at rest stays at rest.
        for _ in range(2 if self.held else 0):
            more = -(right @ self.H.T + curve[..., self.held]) @ self.inverse.T
            right += more @ self.H
            force[..., self.held] += more

    def later(self, t: Array, since: Array, z: Array, of: IntArray, late: Array) -> Array:
        """Motion and derivatives (E, 1 + D, 2n) at times ``late`` (E,) behind t[of]; of: (E,)."""
        eta, s = self.series(t, since, z).eta, late[:, None, None]
        q, v = np.zeros((2, len(late), *eta.shape[2:]))
        for a in eta[::-1]:
            v, q = v * s + q, q * s + a[of]
        return np.concatenate([q, v], axis=-1)


def _waves(w: float, x: Array, K: int) -> tuple[Array, Array]:
    """Taylor coefficients (S, K + 1) in s of sin(x + w s) and of cos(x + w s)."""
    k, sine, cosine = np.arange(K + 1), np.sin(x), np.cos(x)
    turns = np.array([sine, cosine, -sine, -cosine]).T
    size = np.cumprod(np.append(1.0, w / k[1:]))
    return size * turns[:, k % 4], size * turns[:, (k + 1) % 4]
