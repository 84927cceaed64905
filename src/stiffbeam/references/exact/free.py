"""A system in its free modes, as the kernel of exact motion takes it: q = X eta, X^T M X = I, with closed forms where
the modes have them.

    real pairs      eta_j'' + d_j eta_j' + w_j^2 eta_j = f_j              where damping does not couple the modes
    complex modes   (w eta, eta') = Re V z,  z_k' = lambda_k z_k + b_k    where it does, or where a mode is overdamped
    pressed         w^2 + kappa row^T row = V^T w_p^2 V                   one spring: other modes
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...basics.validation import InputError
from ...kernels.exact import Free
from ...model.modes import decoupled_modes, undamped_modes
from ...model.system import System

RESONANCE = 0.03  # relative distance of w^2 and a drive below which the closed form of a mode cancels
CRITICAL = 1e-4  # relative distance of d^2 from 4 w^2 below which a real pair cancels
SLOW = 1e-9  # of the largest w^2: the answer of a mode so slow is far larger than its motion, and cancels
DASHPOT = 1e6  # of the fastest frequency: decay rates above which the slow poles of coupled modes have no digits
CONDITION = 1e4  # of the complex modes, above which they cancel
FEW = 50  # modes up to which a pressed spring is a series: as fast there, and more accurate by a factor of two
EPS = float(np.finfo(float).eps)


def free_system(system: System) -> Free:
    """The free system of a System with linear contacts and time functions in closed form.

    Beside what the kernel takes it has the modes X (n, n), ``into`` (n, n) with eta = q @ into, and what the terms of
    the loads cancel of each other, ``cancelled`` (B, n), in nodes.
    """
    basis, drive, m = undamped_modes(system), system.drive, len(system.contacts)
    w2, X = basis.omega**2, basis.shapes
    n = len(w2)
    decoupled = decoupled_modes(system)
    D = X.T @ system.damping @ X if decoupled is None else np.diag(decoupled.damping)
    coupling = 2 if decoupled is None else int(bool(np.any(D)))
    # Loads and offsets as rows of sin and cos of every frequency, constants as the frequency 0, and of the records.
    nodal, moving = system.load_amplitudes, drive.amplitudes([c.offset for c in system.contacts])
    loads, offsets = np.vstack([np.zeros((1, n)), nodal]) @ X, np.vstack([np.zeros((1, m)), moving])
    waves = np.array([0.0, *drive.frequencies])
    rows = np.array([c.row for c in system.contacts]).reshape(m, n) @ X
    stops = np.array([[c.stops.lower_bound, c.stops.upper_bound] for c in system.contacts], float).reshape(m, 2)
    law = [
        [float(c.stops.stiffness), float(c.stops.damping), -1.0 if c.stops.restitution is None else c.stops.restitution]
        for c in system.contacts
    ]
    shared: dict[str, Any] = {
        "w2": w2, "damping": D, "coupling": coupling, "rows": rows, "stops": stops,
        "laws": np.array(law, float).reshape(m, 3), "meet": rows @ rows.T, "loads": loads, "offsets": offsets,
        "waves": waves, "edges": np.ascontiguousarray(drive.edges), "pieces": drive.table,
    }  # fmt: skip
    stiffness = shared["laws"][:, 0] * np.diag(shared["meet"])
    if np.any(np.isfinite(shared["laws"][:, 0]) & ~(stiffness < 1e290)):
        rule, largest = "give modes that float64 can hold", float(np.max(shared["laws"][:, 0]))
        raise InputError("stops.stiffness", largest, rule, "use other units, or rigid stops with a restitution")
    cancelled, terms = np.zeros_like(loads), system.load_terms
    if terms:
        sizes = np.abs(drive.amplitudes([f for _, f in terms])) @ np.abs([p for p, _ in terms])
        cancelled[1 : 1 + drive.size] = np.maximum(sizes - np.abs(nodal), 0.0)[: drive.size]
    shared = {x: np.ascontiguousarray(y) if isinstance(y, np.ndarray) else y for x, y in shared.items()}
    shared |= {"X": X, "into": np.ascontiguousarray(system.mass @ X), "cancelled": cancelled}
    return with_pressed(closed_form(shared))


def closed_form(shared: dict[str, Any]) -> Free:
    """The free system with the closed forms of its modes."""
    w2, waves, d, coupled = shared["w2"], shared["waves"], np.diag(shared["damping"]), shared["coupling"] == 2
    n, F = len(w2), len(waves)
    kind, answer, apart, s = 0, np.zeros((2 * F, n)), np.zeros(n, np.int64), 1j * np.sqrt(w2)
    if not coupled and not np.any((d * d > (4.0 + CRITICAL) * w2) & (w2 > 0.0)):
        kind, s = 1, -0.5 * d + 1j * np.sqrt(np.maximum(w2 - 0.25 * d * d, 0.0))
        shared = shared | {"seen": np.stack([shared["rows"], np.zeros_like(shared["rows"])])}
        answer, apart = particular(w2, d, waves, shared["loads"])
    elif found := complex_modes(shared) if coupled else overdamped_modes(shared):
        s, out, back, answer = found
        seen = np.ascontiguousarray(np.stack([shared["rows"] @ out[0], shared["rows"] @ out[1]]))
        kind, shared = 2, shared | {"out": out, "back": back, "seen": seen}
    poles = np.array([np.append(s.real, np.zeros(F)), np.append(s.imag, waves)])
    # The length of flights that the modes ``apart`` allow.
    rates, some = 0.5 * np.abs(d) + np.sqrt(0.25 * d * d + w2), apart > 0
    fastest = max(np.max(rates[some]), np.max(waves, initial=0.0)) if np.any(some) else 0.0
    order = np.argsort(np.hypot(*poles), kind="stable")
    return Free(
        **shared, kind=kind, poles=poles, order=order, answer=answer, apart=apart,
        longest=1.0 / fastest if fastest else math.inf,
    )  # fmt: skip


def particular(w2: Array, d: Array, waves: Array, loads: Array) -> tuple[Array, Array]:
    """Answer (2 F, n) of decoupled modes to the harmonic loads, and the modes (n,) that have none: drives near
    resonance, critical damping, and free bodies that are damped."""
    n = len(w2)
    answer = np.zeros((2 * len(waves), n))
    critical = (np.abs(d * d - 4.0 * w2) <= CRITICAL * w2) & (d > 0.0) | (w2 == 0.0) & (d > 0.0)
    apart = critical.copy()
    for f, w in enumerate(waves):
        p = loads[2 * f + 1] - 1j * loads[2 * f]  # Re(p e^{iwt})
        H = w2 - w * w + 1j * w * d
        apart |= (np.abs(H) < RESONANCE * np.maximum(w2, w * w)) & (p != 0) & (w > 0.0)
        apart |= (np.abs(H) < SLOW * np.max(w2)) & (p != 0) & (w2 > 0.0)
        y: Any = np.divide(p, H, out=np.zeros(n, complex), where=(H != 0) & ~critical)
        answer[2 * f], answer[2 * f + 1] = -y.imag, y.real
    answer[:, apart] = 0.0
    return answer, apart.astype(np.int64)


def overdamped_modes(shared: dict[str, Any]) -> tuple[Any, Array, Array, Array] | None:
    """As ``complex_modes``, of decoupled modes: two real poles of one that is overdamped, to rounding."""
    w2, d, waves, loads = shared["w2"], np.diag(shared["damping"]), shared["waves"], shared["loads"]
    n, sigma, square = len(w2), -0.5 * d, w2 - 0.25 * d * d
    answer, apart = particular(w2, d, waves, loads)
    if np.any(apart) or np.any(w2 == 0.0):
        return None
    fast = sigma - np.sqrt(np.maximum(-square, 0.0))
    first: Any = np.where(square > 0.0, sigma + 1j * np.sqrt(np.maximum(square, 0.0)), w2 / fast)
    over = np.flatnonzero(square < 0.0)
    s: Any = np.append(first, fast[over])
    mode = np.append(np.arange(n), over)
    N, at = len(s), np.arange(len(s))
    out, back = np.zeros((4, n, N)), np.zeros((2, N, 2 * n))
    out[0, mode, at], out[2, mode, at], out[3, mode, at] = 1.0, s.real, s.imag
    # z = h + i (sigma h - v)/omega of a pair, z_1 + z_2 = h, s_1 z_1 + s_2 z_2 = v of two real poles.
    pair = np.flatnonzero(square > 0.0)
    back[0, pair, pair] = 1.0
    back[1, pair, pair], back[1, pair, n + pair] = sigma[pair] / s[pair].imag, -1.0 / s[pair].imag
    second, apart_by = n + np.arange(len(over)), first[over].real - fast[over]
    back[0, over, over], back[0, over, n + over] = -fast[over] / apart_by, 1.0 / apart_by
    back[0, second, over], back[0, second, n + over] = first[over].real / apart_by, -1.0 / apart_by
    return s, out, back, answer


def complex_modes(shared: dict[str, Any]) -> tuple[Any, Array, Array, Array] | None:
    """Poles (N,), ``out``, ``back`` and the answer to harmonic loads; None where these cancel."""
    w2, D, waves, loads = (shared[x] for x in ("w2", "damping", "waves", "loads"))
    n = len(w2)
    w = np.where(w2 > 0.0, np.sqrt(w2), np.sqrt(np.max(w2)) or 1.0)  # state (w eta, eta'): V is unitary without damping
    A = np.block([[np.zeros((n, n)), np.diag(w)], [-np.diag(w2 / w), -D]])
    s: Any
    s, V = np.linalg.eig(A)
    still = np.abs(s.imag) <= 1e-6 * np.abs(s)
    keep = np.where(still, True, s.imag > 0.0)
    real = still & (s.imag == 0.0)
    # A body that nothing holds has no answer to a constant load, and without a damper of its own no eigenvectors. Poles
    # lose rounding of the fastest: beside a strong dashpot the slow ones are lost.
    if (
        np.any(still & ~real)
        or np.max(np.abs(s)) > DASHPOT * np.max(w)
        or (np.any(w2 == 0.0) and np.any(loads[: 2 * len(waves)][:, w2 == 0.0]))
    ):
        return None
    if np.count_nonzero(real) + 2 * np.count_nonzero(keep & ~real) != 2 * n or np.linalg.cond(V) > CONDITION:
        return None
    back: Any = np.linalg.inv(V)[keep] * np.where(real[keep], 1.0, 2.0)[:, None] * np.append(w, np.ones(n))
    s, x, y = s[keep], V[:n, keep] / w[:, None], V[n:, keep]
    answer = np.zeros((2 * len(waves), n))
    for f, wave in enumerate(waves):
        p = loads[2 * f + 1] - 1j * loads[2 * f]
        if wave > 0.0 and np.any(p) and np.min(np.abs(s - 1j * wave)) < 1e-3 * wave:
            return None
        held = (w2 > 0.0) | (wave > 0.0)
        z: Any = np.zeros(n, complex)
        z[held] = np.linalg.solve((np.diag(w2 - wave * wave + 0j) + 1j * wave * D)[np.ix_(held, held)], p[held])
        answer[2 * f], answer[2 * f + 1] = -z.imag, z.real
    out = np.ascontiguousarray(np.stack([np.real(x), np.imag(x), np.real(y), np.imag(y)]))
    return s, out, np.ascontiguousarray(np.stack([np.real(back), np.imag(back)])), answer


def pressed_modes(w2: Array, rows: Array, kappa: Array) -> tuple[Array, Array]:
    """Angular frequencies (n,) with springs kappa (m,) on rows (m, n), increasing, and as rows the modes (n, n)."""
    # Singular values of a factor are as exact as the largest frequency, not as its square.
    factor = np.vstack([np.diag(np.sqrt(w2)), np.sqrt(kappa)[:, None] * rows])
    _, w, V = np.linalg.svd(factor, full_matrices=False)
    return w[::-1], np.ascontiguousarray(V[::-1])


def with_pressed(free: Free) -> Free:
    """The free system and, where its only contact is a spring without a dashpot, that with this contact pressed.

    Few undamped modes are a series as fast, unless damping makes the series short.
    """
    n, m, damped = len(free.w2), len(free.rows), free.coupling > 0
    if m != 1 or n == 0 or (free.kind != 1 and not damped):
        return free
    (kappa, c, _), row, w2 = free.laws[0], free.rows[0], free.w2
    if not np.isfinite(kappa) or c != 0.0 or (n <= FEW and np.max(np.abs(free.drag)) <= 2.0 * np.sqrt(np.max(w2))):
        return free
    w, V = pressed_modes(w2, free.rows, free.laws[:, 0])
    D = V @ free.damping @ V.T if damped else np.zeros((n, n))
    stated: dict[str, Any] = {
        x: getattr(free, x) for x in ("stops", "laws", "meet", "offsets", "waves", "edges", "pieces")
    }
    stated |= {"w2": w**2, "damping": D, "coupling": 2 * int(damped), "rows": np.ascontiguousarray(free.rows @ V.T)}
    sides = dict[str, Free]()
    for name, g in zip(("low", "up"), free.stops[0], strict=True):
        if np.isfinite(g):
            loads = free.loads - kappa * np.outer(free.offsets[:, 0], row)
            loads[1] += kappa * g * row
            sides[name] = closed_form(stated | {"loads": np.ascontiguousarray(loads @ V.T)})
    return free.changed(V=V, **sides) if all(x.kind for x in sides.values()) else free
