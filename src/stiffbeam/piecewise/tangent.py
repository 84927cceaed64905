"""Derivatives of an exact motion in initial data and parameters: the variational equations, segment by segment.

    Z = (q, q', g),  Z' = G Z                  G: generator of a segment's regime, g: 1 and (sin, cos) of every Harmonic
    dZ(t + tau) = e^(G tau) dZ(t) + L(G tau, dG tau) Z(t)                    L: Frechet derivative of the exponential
    dt = -(h dZ + dh Z)/(h G- Z),  dZ+ = dZ- + (G- - G+) Z dt                at an event, where h Z = 0

The force of an undamped linear stop is continuous, so that dZ does not jump. Source: Mueller, Chaos, Solitons &
Fractals 5 (1995) 1671-1681; Al-Mohy and Higham, SIAM J. Matrix Anal. Appl. 30 (2009) 1639-1657, for L.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from scipy.linalg import expm_frechet

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..model.members import value_at, with_values
from ..model.system import System
from ..model.time_functions import Constant, Harmonic, LoadFunction, parts
from .events import switched_by_force
from .measures import Solution

STEP = 1.0 / 64.0  # of a parameter, or of 1 where that is 0, between the samples of the matrices
CENTRED = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}  # weights of an eighth-order difference
SAME = 4 * float(np.finfo(float).eps)  # of the time: two steps that differ by no more are of one length
GRAZING = 1e-9  # of the terms of the gap's rate: a slower crossing has no derivative of its time
FORWARD = {k: (-1) ** (k + 1) * comb(8, k) / k for k in range(1, 9)}  # and -sum at 0


@dataclass(frozen=True, eq=False)
class Derivative:
    """Derivatives of an exact motion in p parameters.

    Attributes
    ----------
    wrt : tuple of str
        The p paths.
    t : (k,) array
    tip : (k, p) array
        Of the observed position at the times t.
    state : (k, 2n, p) array
        Of (q, q') at the times t.
    event_times : (events, p) array
        Of the times at which a contact opens or closes; NaN at a graze.
    impact_times : tuple of (impacts, p) arrays
        Of the times in ``contacts[i].impacts.times``, one array for every contact.
    """

    wrt: tuple[str, ...]
    t: Array
    tip: Array
    state: Array
    event_times: Array
    impact_times: tuple[Array, ...] = ()


def derivative(system: System, solution: Solution, t: Array, parameters: Sequence[str]) -> Derivative:
    """Derivatives of an exact motion with compliant linear stops at times t (k,), increasing.

    Parameters
    ----------
    system, solution
        System, and its motion to t[-1] at least.
    t : array of (k,)
    parameters
        Paths as of ``varied``, for example "stops.stiffness" or "q0[2]".

    Returns
    -------
    Derivative
        An event time is NaN where the gap opens or closes at less than GRAZING of the speed (a graze).

    Raises
    ------
    InputError
        For rigid stops, for records, and for a path that the system does not have.

    Notes
    -----
    The matrices are differentiated by eight samples: without error where they are polynomials of degree 8 in the
    parameter, as in stiffness, gap, damping, amplitude and frequency; rounding adds a relative error of some 1e-13.
    """
    motions = [_Sampled(system, path) for path in parameters]
    n, size = system.size, 2 * system.size + len(_waves(system))
    begins = np.append(solution.times, np.inf)
    dZ = np.column_stack([m.slope(_start) for m in motions]).reshape(size, len(motions))
    state, tip = np.empty((len(t), 2 * n, len(motions))), np.empty((len(t), len(motions)))
    observed = _observed(system)
    turned = np.column_stack([m.slope(_observed) for m in motions])  # of the functions of time in it
    dt = np.full((len(begins) - 2, len(motions)), np.nan)
    begun, k, flow = 0.0, 0, None
    Z = _start(system)
    for i, sides in enumerate(map(tuple, solution.sides.tolist())):
        if i:
            dZ, dt[i - 1] = _across(system, motions, Z, dZ, tuple(solution.sides[i - 1].tolist()), sides)
        ends: list[float] = t[k : int(np.searchsorted(t, begins[i + 1]))].tolist()
        wanted = len(ends)
        if begins[i + 1] <= t[-1]:
            ends.append(float(begins[i + 1]))
        for j, end in enumerate(ends):
            flow = _flow(system, motions, sides, end - begun, SAME * end, flow)
            Z, dZ = flow.moved(Z, dZ)
            begun = end
            if j < wanted:
                state[k], tip[k] = dZ[: 2 * n], observed @ dZ + Z @ turned
                k += 1
        if k == len(t):
            break
    return Derivative(tuple(parameters), np.array(t, float), tip, state, dt)


class _Sampled:
    """A system at samples of a parameter, from which the derivative of a matrix is taken."""

    def __init__(self, system: System, path: str) -> None:
        at = _value(system, path)
        step = STEP * abs(at) or STEP
        try:
            samples = {k: with_values(system, {path: at + k * step}) for k in range(-4, 5) if k}
            self.weights = {k: np.sign(k) * CENTRED[abs(k)] / step for k in samples}
        except InputError:  # at the end of what the parameter may be, as damping 0
            samples = {k: with_values(system, {path: at + k * step}) for k in range(9)}
            self.weights = {k: w / step for k, w in FORWARD.items()}
            self.weights[0] = -sum(self.weights.values())
        if any(len(_waves(sample)) != len(_waves(system)) for sample in samples.values()):
            rule, remedy = "keep the number of harmonic loads", "take a value a little above 0"
            raise InputError(path, at, rule, remedy)
        self.samples = samples
        self.known: dict[Any, Array] = {}

    def slope(self, of: Callable[..., Array], *data: Any) -> Array:
        """d/dtheta of ``of(system, *data)``."""
        key = (of, *data)
        if key not in self.known:
            self.known[key] = np.asarray(sum(w * of(self.samples[k], *data) for k, w in self.weights.items()))
        return self.known[key]


def _value(system: System, path: str) -> float:
    """The parameter at a path; "stops" without an index are those of the only contact."""
    if path.startswith("stops.") and len(system.contacts) == 1:
        path = f"stops[0].{path.removeprefix('stops.')}"
    try:
        return value_at(system, path)
    except LookupError as error:
        remedy = "name one number in full, for example stops[0].stiffness or loads[0].time.frequency"
        raise InputError("parameter", path, "be a path to one number of the system", remedy) from error


@dataclass(frozen=True)
class _Flow:
    """exp(G tau) and its Frechet derivatives, balanced by ``scale``: unbalanced it loses the digits of its norm."""

    sides: tuple[int, ...]
    tau: float
    scale: Array
    flows: list[tuple[Array, Array]]

    def moved(self, Z: Array, dZ: Array) -> tuple[Array, Array]:
        """Z and dZ at tau later."""
        Z, dZ = Z / self.scale, dZ / self.scale[:, None]
        later = np.column_stack([E @ dZ[:, j] + L @ Z for j, (E, L) in enumerate(self.flows)])
        return self.scale * (self.flows[0][0] @ Z), self.scale[:, None] * later


def _flow(
    system: System, motions: list[_Sampled], sides: tuple[int, ...], tau: float, rounding: float, last: _Flow | None
) -> _Flow:
    """The flow over tau in a segment: the last one where it is over the same time, as between equidistant outputs."""
    if last is not None and last.sides == sides and abs(last.tau - tau) <= rounding:
        return last
    G, n = _generator(system, sides), system.size
    scale = np.ones(len(G))
    scale[n : 2 * n] = np.sqrt(np.linalg.norm(G[n : 2 * n, :n])) or 1.0
    scale[2 * n :] = scale[n] ** 2 / (np.linalg.norm(G[n : 2 * n, 2 * n :]) or scale[n] ** 2)
    turned = tau * scale / scale[:, None]
    flows: list[Any] = [expm_frechet(G * turned, m.slope(_generator, sides) * turned) for m in motions]
    return _Flow(sides, tau, scale, flows)


def _across(
    system: System, motions: list[_Sampled], Z: Array, dZ: Array, old: tuple[int, ...], new: tuple[int, ...]
) -> tuple[Array, Array]:
    """dZ behind an event, and the derivatives of its time (p,)."""
    changed = [i for i in range(len(old)) if old[i] != new[i]]
    dt = np.full(dZ.shape[1], np.nan)
    if not changed:  # the records' samples end segments too; these are refused
        return dZ, dt
    before, after = _generator(system, old), _generator(system, new)
    i = changed[0]
    side = int(np.sign(old[i] or new[i]))
    force = switched_by_force(old[i], new[i])
    h = _zero(system, i, side, force)
    speed = float(h @ before @ Z)
    if abs(speed) <= GRAZING * float(np.max(np.abs(h * (before @ Z)))) or len(changed) > 1:
        return (dZ, dt) if len(changed) == 1 else (dZ * np.nan, dt)
    dt = np.array([-(h @ dZ[:, j] + m.slope(_zero, i, side, force) @ Z) / speed for j, m in enumerate(motions)])
    return dZ + np.outer((before - after) @ Z, dt), dt


def _start(system: System) -> Array:
    """Z at t = 0."""
    waves = np.zeros(len(_waves(system)))
    waves[0], waves[2::2] = 1.0, 1.0
    return np.concatenate([system.q0, system.v0, waves])


def _waves(system: System) -> list[float]:
    """The rate of each entry of g: the constant, and two for every Harmonic of loads, then of stop motions."""
    functions = [f for _, f in system.loads] + [c.offset for c in system.contacts]
    leaves = [leaf for f in functions for _, leaf in parts(f) if isinstance(leaf, Harmonic)]
    return [0.0, *np.repeat([leaf.frequency for leaf in leaves], 2).tolist()]


def _amplitudes(system: System) -> tuple[list[Array], list[Array]]:
    """Each load and each contact's offset as coefficients of g."""
    size, found, k = len(_waves(system)), [], 1
    functions: list[LoadFunction | None] = [f for _, f in system.loads] + [c.offset for c in system.contacts]
    for function in functions:
        row = np.zeros(size)
        for factor, leaf in parts(function):
            if isinstance(leaf, Harmonic):
                row[k : k + 2] += factor * np.array([leaf.sine, leaf.cosine])
                k += 2
            elif isinstance(leaf, Constant):
                row[0] += factor * leaf.level
            else:
                rule = "be made of Harmonic and Constant for derivatives"
                raise InputError("time function", leaf, rule, "take differences of exact references")
        found.append(row)
    return found[: len(system.loads)], found[len(system.loads) :]


def _generator(system: System, sides: tuple[int, ...]) -> Array:
    """G with every contact on its side, see events."""
    n, rates = system.size, _waves(system)
    loads, _ = _amplitudes(system)
    K, C = system.stiffness, system.damping
    force = np.zeros((n, len(rates)))
    for (vector, _), row in zip(system.loads, loads, strict=True):
        force += np.outer(vector, row)
    G = np.zeros((2 * n + len(rates), 2 * n + len(rates)))
    for k in range(1, len(rates), 2):
        G[2 * n + k, 2 * n + k + 1], G[2 * n + k + 1, 2 * n + k] = rates[k], -rates[k]
    back = np.hstack([-K, -C, force])
    for i, side in enumerate(sides):
        if abs(side) == 1:
            back -= np.outer(system.contacts[i].row, _zero(system, i, side, True))
    G[:n, n : 2 * n] = np.eye(n)
    G[n : 2 * n] = np.linalg.solve(system.mass, back)
    return G


def _observed(system: System) -> Array:
    """The tip as a function of Z."""
    row, offset = system.channels[system.tip_channel]
    moving = np.zeros(len(_waves(system))) if offset is None else _amplitudes(system)[1][system.tip_channel]
    return np.concatenate([row, np.zeros(system.size), moving])


def _zero(system: System, contact: int, side: int, force: bool) -> Array:
    """h: the function of Z that is 0 at an event, the gap's depth or, of a stop with damping, its force."""
    n, rates = system.size, np.array(_waves(system))
    acting, (_, offsets) = system.contacts[contact], _amplitudes(system)
    stops = acting.stops
    if stops.rigid:
        raise InputError("stops", stops, "be compliant for derivatives", "take differences of exact references")
    offset = offsets[contact].copy()
    rate = np.zeros(len(rates))  # of the offset: sin' = w cos, cos' = -w sin
    rate[2::2], rate[1::2] = rates[1::2] * offset[1::2], -rates[1::2] * offset[2::2]
    offset[0] -= stops.g2 if side > 0 else stops.g1
    depth = np.concatenate([acting.row, np.zeros(n), offset])
    if not force:
        return depth
    return float(stops.stiffness) * depth + float(stops.damping) * np.concatenate([np.zeros(n), acting.row, rate])
