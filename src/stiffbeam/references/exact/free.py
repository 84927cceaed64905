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

from ...basics.arrays import Array, BoolArray
from ...basics.validation import InputError
from ...kernels.library import Free
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
    each = [c.stops for c in system.contacts]
    stops = np.array([(x.law.g1, x.law.g2) for x in each], float).reshape(m, 2)
    laws = np.array([(x.stiffness, x.damping, -1.0 if x.restitution is None else x.restitution) for x in each], float)
    shared: dict[str, Any] = {
        "w2": w2, "damping": D, "coupling": coupling, "rows": rows, "stops": stops,
        "laws": laws.reshape(m, 3), "meet": rows @ rows.T, "loads": loads, "offsets": offsets,
        "waves": waves, "edges": np.ascontiguousarray(drive.edges), "pieces": drive.table,
    }  # fmt: skip
    stiffness = shared["laws"][:, 0] * np.diag(shared["meet"])
    if np.any(np.isfinite(shared["laws"][:, 0]) & ~(stiffness < 1e290)):
        rule, largest = "give modes that float64 can hold", float(np.max(shared["laws"][:, 0]))
        raise InputError("stops.stiffness", largest, rule, "use other units, or rigid stops with a restitution")
    # Beside the sum of the loads, the sizes of its terms.
    terms = system.load_terms
    sizes = np.abs(drive.amplitudes([f for _, f in terms])) @ np.abs([p for p, _ in terms] or np.zeros((0, n)))
    cancelled = np.vstack([np.zeros((1, n)), np.maximum(sizes - np.abs(nodal), 0.0)])
    shared = {x: np.ascontiguousarray(y) if isinstance(y, np.ndarray) else y for x, y in shared.items()}
    shared |= {"X": X, "into": np.ascontiguousarray(system.mass @ X), "cancelled": cancelled}
    return with_pressed(closed_form(shared))


def closed_form(shared: dict[str, Any]) -> Free:
    """The free system with the closed forms of its modes."""
    w2, waves, d = shared["w2"], shared["waves"], np.diag(shared["damping"])
    n, F, rows, coupled = len(w2), len(waves), shared["rows"], shared["coupling"] == 2
    forces = shared["loads"][1 : 2 * F : 2] - 1j * shared["loads"][: 2 * F : 2]  # Re(p e^{iwt})
    kind, apart, s = 0, np.zeros(n, bool), 1j * np.sqrt(w2)
    answers: Any = np.zeros((F, n), complex)
    out = back = seen = None
    if not coupled and not np.any((d * d > (4.0 + CRITICAL) * w2) & (w2 > 0.0)):
        kind, s, seen = 1, -0.5 * d + 1j * np.sqrt(np.maximum(w2 - 0.25 * d * d, 0.0)), [rows, np.zeros_like(rows)]
        answers, apart = decoupled_answers(w2, d, waves, forces)
    elif found := complex_modes(shared, forces):
        kind, (s, x, y, inverse, answers) = 2, found
        out, back = np.array([x.real, x.imag, y.real, y.imag]), np.array([inverse.real, inverse.imag])
        seen = [rows @ out[0], rows @ out[1]]
    poles = np.array([np.append(s.real, np.zeros(F)), np.append(s.imag, waves)])
    # The length of flights that the modes ``apart`` allow.
    rates = 0.5 * np.abs(d) + np.sqrt(0.25 * d * d + w2)
    fastest = max(np.max(rates[apart]), np.max(waves, initial=0.0)) if np.any(apart) else 0.0
    own: dict[str, Any] = {
        "kind": kind, "poles": poles, "order": np.argsort(np.hypot(*poles), kind="stable"),
        "answer": np.stack([-answers.imag, answers.real], axis=1).reshape(2 * F, n), "apart": apart.astype(np.int64),
        "longest": 1.0 / fastest if fastest else math.inf, "out": out, "back": back,
        "seen": None if seen is None else np.array(seen),
    }  # fmt: skip
    return Free(**shared | own)


def decoupled_answers(w2: Array, d: Array, waves: Array, forces: Any) -> tuple[Any, BoolArray]:
    """Answers (F, n) of decoupled modes to the ``forces`` (F, n), amplitudes of e^{iwt}, and True for the modes (n,)
    that have none: drives near resonance, critical damping, and free bodies that are damped."""
    w = waves[:, None]
    H: Any = w2 - w * w + 1j * w * d
    near = (np.abs(H) < RESONANCE * np.maximum(w2, w * w)) & (w > 0.0)
    near |= (np.abs(H) < SLOW * np.max(w2)) & (w2 > 0.0)
    critical = ((np.abs(d * d - 4.0 * w2) <= CRITICAL * w2) | (w2 == 0.0)) & (d > 0.0)
    apart = critical | np.any(near & (forces != 0.0), axis=0)
    return np.divide(forces, H, out=np.zeros_like(H), where=(H != 0.0) & ~apart), apart


def complex_modes(shared: dict[str, Any], forces: Any) -> tuple[Any, Any, Any, Any, Any] | None:
    """Poles s (N,), modes x and rates y (n, N) with (eta, eta') = Re (x, y) z, the inverse (N, 2 n) of these, and the
    answers (F, n) to the forces; None where these cancel."""
    w2, n = shared["w2"], len(shared["w2"])
    w = np.where(w2 > 0.0, np.sqrt(w2), np.sqrt(np.max(w2)) or 1.0)
    # The state is (w eta, eta'): V is unitary without damping.
    vectors = coupled_modes if shared["coupling"] == 2 else overdamped_modes
    if (found := vectors(w2, w, shared["damping"], shared["waves"], forces)) is None:
        return None
    s, V, inverse, answers = found
    # Of a pair of poles one is enough, twice.
    keep, twice = s.imag >= 0.0, np.where(s.imag > 0.0, 2.0, 1.0)[:, None]
    return s[keep], V[:n, keep] / w[:, None], V[n:, keep], (inverse * twice)[keep] * np.append(w, np.ones(n)), answers


def overdamped_modes(w2: Array, w: Array, D: Array, waves: Array, forces: Any) -> tuple[Any, Any, Any, Any] | None:
    """As ``coupled_modes``, of decoupled modes: two real poles of one that is overdamped, to rounding."""
    d = np.diag(D)
    answers, apart = decoupled_answers(w2, d, waves, forces)
    if np.any(apart) or np.any(w2 == 0.0):
        return None
    # The product of the two poles is w^2: their sum would cancel.
    fast: Any = -0.5 * d + 1j * np.sqrt(w2 - 0.25 * d * d + 0j)
    slow, one = w2 / fast, np.eye(len(w))
    V = np.block([[np.diag(w), np.diag(w)], [np.diag(fast), np.diag(slow)]])
    inverse = np.block([[np.diag(slow / w), -one], [-np.diag(fast / w), one]]) / np.tile(slow - fast, 2)[:, None]
    return np.append(fast, slow), V, inverse, answers


def coupled_modes(w2: Array, w: Array, D: Array, waves: Array, forces: Any) -> tuple[Any, Any, Any, Any] | None:
    """Poles s (2 n,), vectors V (2 n, 2 n) of (w eta, eta'), their inverse, and the answers to harmonic forces."""
    n = len(w2)
    s: Any
    s, V = np.linalg.eig(np.block([[np.zeros((n, n)), np.diag(w)], [-np.diag(w2 / w), -D]]))
    # A body that nothing holds has no answer to a constant load, and without a damper of its own no eigenvectors. Poles
    # lose rounding of the fastest: beside a strong dashpot the slow ones are lost.
    if (
        np.any((np.abs(s.imag) <= 1e-6 * np.abs(s)) & (s.imag != 0.0))
        or np.max(np.abs(s)) > DASHPOT * np.max(w)
        or np.any(forces[:, w2 == 0.0])
        or np.linalg.cond(V) > CONDITION
    ):
        return None
    answers = np.zeros_like(forces)
    for answer, p, wave in zip(answers, forces, waves, strict=True):
        if wave > 0.0 and np.any(p) and np.min(np.abs(s - 1j * wave)) < 1e-3 * wave:
            return None
        held = (w2 > 0.0) | (wave > 0.0)
        answer[held] = np.linalg.solve((np.diag(w2 - wave * wave + 0j) + 1j * wave * D)[np.ix_(held, held)], p[held])
    return s, V, np.linalg.inv(V), answers


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
    other = {x: free.stated[x] for x in ("stops", "laws", "meet", "offsets", "waves", "edges", "pieces")}
    other |= {"w2": w**2, "damping": D, "coupling": 2 * int(damped), "rows": np.ascontiguousarray(free.rows @ V.T)}
    sides = dict[str, Free]()
    for name, g in zip(("low", "up"), free.stops[0], strict=True):
        if np.isfinite(g):
            loads = free.loads - kappa * np.outer(free.offsets[:, 0], row)
            loads[1] += kappa * g * row
            sides[name] = closed_form(other | {"loads": np.ascontiguousarray(loads @ V.T)})
    return free.changed(V=V, **sides) if all(x.kind for x in sides.values()) else free
