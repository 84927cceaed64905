"""Derivatives along a motion, through its segments and events: in the modes of the free system the motion and its
derivatives are one linear system in every regime.

    y = (q, q', 1, functions of time),   y' = A y,   dy' = A dy + dA y          within a segment, by Taylor steps
    dt = -dh/h',   dz+ = J (dz- + z'- dt) - z'+ dt                              at an event h = 0 (saltation)

    M q'' = f - C q' - K q + rows^T F,   F = -(kappa (u - g) + c u') of a pressed compliant contact

F of a contact held by a rigid stop keeps u'' = 0. A and all else that is made of the system's numbers x(p) has its
derivative in p by a complex step: f' = Im f(x + i h x')/h, h = 1e-100.

J is the derivative of what happens at an event. On a compliant stop nothing does, and z' is continuous: dz+ = dz-. At
the entry into a damped one the force jumps by c u'. On a rigid one with restitution the impulses P solve

    M (q'+ - q'-) = H^T P,   H q'+ + o' = -e (H q'- + o')

with the rows H of the contacts that take part, and so do their derivatives, its right side differentiated.
Source: di Bernardo et al., Piecewise-smooth Dynamical Systems (2008), section 2.5; Mueller, Chaos, Solitons & Fractals
5 (1995) 1671-1681; of complex steps Squire and Trapp, SIAM Review 40 (1998) 110-112.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import expm

from ...basics.arrays import Array, IntArray
from ...basics.resources import afford
from ...basics.validation import InputError
from ...model.system import System
from ...model.system_data import SystemData, data_of, offset_terms
from ...model.time_functions import Constant, Harmonic, Sampled
from .free import free_system, pressed_modes
from .motion import Motion, pressed

GRAZE = 64.0 * float(np.finfo(float).eps)  # of h, by which a graze is told from an event
CHUNK = 1_000_000  # numbers of a series at once
TERMS = 33  # of a series over RADIANS: 4^33/33! is below rounding
RADIANS = 4.0  # of the fastest motion of a regime in a step
STEP = 1e-100  # of complex steps, whose square is nothing
FACTORIALS = np.array([1.0, 1.0, 2.0, 6.0])


def moved(c: Array, s: Array) -> Array:
    """The coefficients (..., P) of p(s + .) from those of p: Horner's scheme, as often as there are any to move."""
    # On a copy: coefficient k collects s times the one above it, the last ones first.
    c, last = np.array(c), np.shape(c)[-1] - 1
    for first in range(last):
        for k in range(last - 1, first - 1, -1):
            c[..., k] += s * c[..., k + 1]
    return c


class Numbers:
    """The linear systems of a system with these ``data`` in modes, real or off by i STEP.

    position, rate, curve: (m, N) forms of u, u' and o'' of contacts. seen: (N,) form of the tip.
    """

    def __init__(self, system: System, data: SystemData) -> None:
        self.data, self.n, m = data, len(data.mass), len(data.rows)
        loads, offsets = system.load_terms, offset_terms(system)
        self.leaves = [leaf for _, leaf in loads] + [leaf for _, _, leaf in offsets]
        # Functions of time as states behind 1: f of a constant, f and f' of a harmonic, f to f''' of a record.
        widths = [1 if isinstance(x, Constant) else 2 if isinstance(x, Harmonic) else 4 for x in self.leaves]
        self.places = 1 + np.cumsum([0, *widths])[:-1]
        values, harmonics = np.eye(1 + sum(widths))[self.places], iter(data.harmonics)
        self.drives = np.zeros(2 * [1 + sum(widths)], data.mass.dtype)
        for leaf, at, width in zip(self.leaves, self.places.tolist(), widths, strict=True):
            rates = np.arange(at, at + width - 1)
            self.drives[rates, rates + 1] = 1.0
            if isinstance(leaf, Harmonic):
                self.drives[at + 1, at] = -(next(harmonics)[1] ** 2)
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
        harmonics, constants, piece = iter(self.data.harmonics), iter(self.data.constants), 0
        for leaf, at in zip(self.leaves, self.places.tolist(), strict=True):
            if isinstance(leaf, Constant):
                found[:, at] = next(constants)
            elif isinstance(leaf, Harmonic):
                amplitude, w, phase = next(harmonics)
                found[:, at] = amplitude * np.sin(w * t + phase)
                found[:, at + 1] = amplitude * w * np.cos(w * t + phase)
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
        key = tuple(pressed(sides).tolist())
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


class Tangent:
    """Derivatives along a motion in the parameters of ``variation``, or in ``directions`` (2n, D) of its start.

    Segments also begin at the samples of records: at times (k,), with the contacts on ``sides`` (k, m), in segment
    ``piece`` (k,) of the motion. hits: contacts that are hit where a segment begins. grazes: times of impacts without
    derivative, on rigid or damped stops. ties: times at which several free rigid contacts are hit.
    """

    def __init__(
        self, variation: Variation, motion: Motion, t_end: float, directions: Array | None = None, graze: float = GRAZE
    ) -> None:
        self.variation, self.motion, self.t_end, self.graze, n = variation, motion, t_end, graze, variation.n
        self.rigid, self.grazes, self.ties = variation.system.rigid, list[float](), list[float]()
        count = max(1, int(np.searchsorted(motion.times, t_end, side="left")))
        edges = np.setdiff1d(variation.edges, motion.times)
        edges = edges[(edges > 0.0) & (edges < t_end)]
        place = np.searchsorted(motion.times[:count], edges, "right")
        self.times = np.insert(motion.times[:count], place, edges)
        self.piece = np.insert(np.arange(count), place, place - 1)
        self.sides = np.abs(motion.sides[self.piece]) if self.rigid else motion.sides[self.piece]
        ends = np.append(self.times[1:], t_end)
        self.hits: dict[int, list[int]] = {}
        # A contact may take two blows at one time, for example where it is then held: it is hit once.
        first = {int(mark): k for k, mark in reversed(list(enumerate(motion.first_mark[self.piece].tolist())))}
        for mark, contact in dict.fromkeys(zip(motion.blows.mark.tolist(), motion.blows.contact.tolist(), strict=True)):
            if mark in first:
                self.hits.setdefault(first[mark], []).append(contact)
        # The regimes, and the samples between which the functions of time have one series.
        self.regimes = [variation.regime(sides) for sides in self.sides.tolist()]
        samples = np.append(self.times[0], variation.edges)
        self.since = samples[np.searchsorted(variation.edges, self.times, "right")]
        segments = np.arange(len(self.times))
        self.z, self.z_end = self.states(self.times, segments), self.states(ends, segments)
        start = np.array([np.append(x.q0, x.v0) for x in variation.columns]).reshape(-1, 2 * n)
        if directions is not None:
            start = np.hstack([directions[:n].T @ variation.into, directions[n:].T @ variation.into])
        # Steps of the Taylor series; without parameters a segment is one step.
        self.lengths = ends - self.times
        self.steps = self.cut() if variation.P else (segments, self.times, self.lengths, self.z)
        _, t, h, _ = self.steps
        afford("t_end", t_end, "shorten t_end", floats=4.0 * len(t) * (1 + len(start)) * n)
        driven = np.zeros((len(t), len(start), 2 * n))
        if variation.P:
            driven = self._later(driven, np.arange(len(t)), h)[:, 1:, : 2 * n]
        self.dz, self.end = self._follow(start, driven)  # at the starts of steps, and at the end

    def _follow(self, dz: Array, driven: Array) -> tuple[Array, Array]:
        """Derivatives at the starts of all steps and at the end of the path."""
        (owner, _, h, _), n = self.steps, self.variation.n
        starts = np.zeros((len(owner), *dz.shape))
        first = np.searchsorted(owner, np.arange(len(self.regimes) + 1))
        for i, regime in enumerate(self.regimes if len(dz) else ()):
            if i:
                dz = self.across(i, dz)
            tau, steps = float(h[first[i]]), range(first[i], first[i + 1])
            flow = regime.flow(tau, np.eye(2 * n)) if len(steps) > 1 else None
            for k in steps:
                starts[k] = dz
                dz = (regime.flow(tau, dz) if flow is None else dz @ flow) + driven[k]
        return starts, dz

    def states(self, t: Array, segment: IntArray) -> Array:
        """Motion (k, 2n) in modes at times t (k,), as the given segments have it."""
        return np.hstack(self.motion.modal(t, self.piece[segment])[:2])

    def cut(self) -> tuple[IntArray, Array, Array, Array]:
        """Steps of RADIANS at most: the segment, time, length and state of each."""
        count = np.maximum(1, np.ceil(self.lengths * np.array([x.fastest for x in self.regimes]) / RADIANS))
        floats = 4.0 * float(np.sum(count)) * self.variation.n
        afford("t_end", self.t_end, "shorten t_end", floats=floats)
        count = count.astype(int)
        h, owner = np.repeat(self.lengths / count, count), np.repeat(np.arange(len(count)), count)
        t = self.times[owner] + h * (np.arange(len(h)) - np.repeat(np.cumsum(count) - count, count))
        return owner, t, h, self.states(t, owner)

    def at(self, t: Array, segment: IntArray) -> Array:
        """Motion and derivatives y (k, 1 + D, N) at increasing times t (k,) in the given segments."""
        owner, at = self.steps[:2]
        # The last step that begins before each time, in its segment.
        first, last = np.searchsorted(owner, segment), np.searchsorted(owner, segment, "right") - 1
        step = np.clip(np.searchsorted(at, t, "right") - 1, first, last)
        return self._later(self.dz, step, t - at[step])

    def _later(self, dz: Array, step: IntArray, late: Array) -> Array:
        """y (k, 1 + D, N) at ``late`` (k,) behind the starts of steps (k,), from dz there."""
        owner, t, _, z = (x[step] for x in self.steps)
        regimes = np.array([id(x) for x in self.regimes])[owner]
        found = np.empty((len(late), 1 + dz.shape[1], len(self.variation.base.seen)))
        for one in dict.fromkeys(regimes.tolist()):
            here = np.flatnonzero(regimes == one)
            for part in np.array_split(here, 1 + len(here) * found[0].size // CHUNK):
                of = owner[part]
                y = self.variation.whole(t[part], self.since[of], np.concatenate([z[part, None], dz[step[part]]], 1))
                found[part] = self.regimes[of[0]].later(y, late[part])
        return found

    def segment_at(self, t: Array) -> IntArray:
        """The segment that each time lies in; an event belongs to the segment it begins."""
        return np.maximum(np.searchsorted(self.times, t, side="right") - 1, 0)

    def whole(self, i: int, t: float, z: Array, dz: Array) -> Array:
        """y (1 + D, N) at a time of segment i from z (2n,) and dz (D, 2n)."""
        return self.variation.whole(np.array([t]), self.since[i : i + 1], np.vstack([z, dz])[None])[0]

    def motion_at(self, t: Array, segment: IntArray) -> Array:
        """y (k, N) of the motion alone at times t (k,), as the given segments have it."""
        return self.variation.whole(t, self.since[segment], self.states(t, segment)[:, None])[:, 0]

    def gap(self, y: Array, contact: int, side: int) -> tuple[Array, Array, float]:
        """u - g and u' of a contact in y (1 + D, N), their derivatives (2, D), and the size of the terms of u - g."""
        numbers, data = self.variation.base, self.variation.data
        forms = [np.array([x.gap(contact, side), x.rate[contact]]) for x in (numbers, *self.variation.beside)]
        slopes = forms[0] @ y[1:].T
        for p, form in enumerate(forms[1 : len(y)]):
            slopes[:, p] += np.imag(form) @ y[0] / STEP
        stop = (data.upper if side > 0 else data.lower)[contact]
        return forms[0] @ y[0], slopes, float(np.abs(numbers.position[contact]) @ np.abs(y[0]) + abs(stop))

    def across(self, i: int, dz: Array) -> Array:
        """dz+ (D, 2n) after the event at which segment i begins, from dz- before it."""
        t, before, after = float(self.times[i]), self.sides[i - 1], self.sides[i]
        data, n = self.variation.data, self.variation.n
        if self.rigid:
            return self._struck(i, dz) if i in self.hits else dz
        for contact in np.flatnonzero((before == 0) & (after != 0) & (data.c > 0.0)).tolist():
            # A neighbour enters later by -dh/h', without the force c h' until then.
            y = self.whole(i - 1, t, self.z_end[i - 1], dz)
            late = self._reached(i, y, contact, int(np.sign(after[contact])))[1][0]
            dz = dz.copy()
            dz[:, n:] -= data.c[contact] * np.outer(late, data.rows[contact])
        return dz

    def _reached(self, i: int, y: Array, contact: int, side: int) -> tuple[Array, Array]:
        """Gap and rate of the contact that meets its stop in y (1 + D, N), with their derivatives; notes a graze."""
        h, slopes, size = self.gap(y, contact, side)
        curve = float(self.variation.base.rate[contact] @ (self.regimes[i - 1].A @ y[0]))
        # The parabola with h' and h'' turns within ``graze`` of the terms of h, of this size.
        if h[1] ** 2 <= 2.0 * abs(curve) * self.graze * size:
            self.grazes.append(float(self.times[i]))
        return h, slopes

    def _struck(self, i: int, dz: Array) -> Array:
        """dz+ (D, 2n) behind the impact on a rigid stop at which segment i begins, from dz- before it."""
        variation, n, t = self.variation, self.variation.n, float(self.times[i])
        before, after, hits = self.sides[i - 1], self.sides[i], list(self.hits[i])
        y = self.whole(i - 1, t, self.z_end[i - 1], dz)
        arriving = variation.base.rate @ y[0]
        # The fastest of the free contacts is hit; if all were held, the fastest of these.
        free = [c for c in hits if not before[c]]
        if len(free) > 1:
            self.ties.append(t)
        hit = max(free or hits, key=lambda c: abs(arriving[c]))
        # Held contacts take part in the blow: those in ``hits`` and those that stay held.
        taking = [hit, *(c for c in hits if c != hit)]
        taking += [c for c in np.flatnonzero(before & after).tolist() if c not in hits]
        (_, speed), (slope, _) = self._reached(i, y, hit, int(np.sign(arriving[hit])) or 1)
        # The time of the impact, and the derivatives of the motion there. Without speed it is the graze noted above.
        late = -slope / speed if speed else np.zeros(len(dz))
        y[1:] += np.outer(late, self.regimes[i - 1].A @ y[0])
        # The same blow for all directions, or by the numbers of the neighbour of each parameter.
        beside = [([p], x) for p, x in enumerate(variation.beside[: len(dz)])] or [(slice(None), variation.base)]
        out = y[1:, : 2 * n].copy()
        for these, numbers in beside:
            e = np.where(after[taking] != 0, 0.0, numbers.data.restitution[taking])
            out[these, n:] += np.imag(numbers.kick(y[0] + 1j * STEP * y[1:][these], taking, e)) / STEP
        # Derivatives behind the blow, brought back to a fixed time.
        then = self.whole(i - 1, t, self.z[i], dz[:0])[0]
        return out - np.outer(late, (self.regimes[i].A @ then)[: 2 * n])

    @property
    def monodromy(self) -> Array:
        """Derivative of q, q' at the end of the path in the directions of its start, (2n, D)."""
        X, n = self.variation.X, self.variation.n
        return np.vstack([X @ self.end[:, :n].T, X @ self.end[:, n:].T])
