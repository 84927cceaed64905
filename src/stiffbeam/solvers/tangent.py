"""The tangent flow of the exact solution: how fast neighbouring motions part, and so what rounding costs.

    z(t) = Phi(t) z(0),  Phi(t) = flow of the last piece ... flow of the first,  |Phi(t) z| ~ exp(lambda t)

The contact law is continuous, so a switch leaves tangent vectors alone (its saltation matrix is the
identity) and Phi is the product of the homogeneous flows of the pieces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..modal import undamped_modes
from ..system import System
from ..validation import InputError, positive
from .exact_measures import Solution
from .piecewise import refuse, tracer_of

RANDOM = 3  # tangent vectors beside the direction of the motion itself
SAMPLES = 200  # times beside the switches


@dataclass(frozen=True, eq=False)
class Growth:
    """log_growth: ln(|Phi(t) z|/|z|), (k, vectors), at times t (k,), in the energy norm without contact,
    |z|^2 = dq'^T M dq' + dq^T K dq. The first RANDOM vectors are random, the last, where it is not at
    rest, is the direction of the motion at t = 0."""

    t: Array
    log_growth: Array

    @property
    def largest(self) -> Array:
        """The largest growth of the vectors so far, ln, (k,)."""
        return np.maximum.accumulate(np.max(self.log_growth, axis=1))

    @property
    def exponent(self) -> float:
        """The finite-time Lyapunov exponent, mean over the vectors of ln(|Phi z|/|z|)/t at the last time."""
        return float(np.mean(self.log_growth[-1]) / self.t[-1])

    @property
    def digits(self) -> float:
        """Decimal digits that the motion loses on the way to the last time."""
        return float(self.largest[-1] / np.log(10.0))


def lyapunov(system: System, t_end: float, seed: int = 0) -> Growth:
    """The growth of tangent vectors along the exact float64 motion on [0, t_end].

    Past the horizon that motion is another one of the same system, along which the growth is as good an
    estimate as along the true one. Takes what the exact solution takes and raises InputError as it does.
    """
    positive("t_end", t_end)
    if not isinstance(system, System):
        raise InputError("system", type(system).__name__, "be a System")
    refuse(system)
    return growth(system, tracer_of(system).solve(t_end), t_end, seed)


def growth(system: System, solution: Solution, t_end: float, seed: int = 0, enough: float = np.inf) -> Growth:
    """``lyapunov`` along a solution that is there already, ended where a growth, ln, is ``enough``."""
    dq, dv = _vectors(system, seed)
    edges = np.union1d(solution.times[solution.times < t_end], np.linspace(0.0, t_end, SAMPLES + 1))
    piece = np.maximum(np.searchsorted(solution.times, edges[:-1], side="right") - 1, 0)
    logs = np.zeros((len(edges), dq.shape[1]))
    for i, (k, tau) in enumerate(zip(piece.tolist(), np.diff(edges).tolist(), strict=True)):
        dq, dv = solution.flow(k, tau, dq, dv)
        size = _norm(system, dq, dv)
        logs[i + 1] = logs[i] + np.log(size)
        dq, dv = dq / size, dv / size
        if np.max(logs[i + 1]) > enough:
            return Growth(edges[: i + 2], logs[: i + 2])
    return Growth(edges, logs)


def predicted_horizon(system: System, solution: Solution, t_end: float, tolerance: float) -> float:
    """The first time at which rounding, eps (1 + w_max t) |Phi(t)| of the motion, reaches ``tolerance`` of it.

    An error eps w_max of the frequencies turns a mode by eps w_max t: that much more than a rounding of
    the initial data is there to be magnified, all of it counted as if it had been there from the start.
    """
    eps, fastest = float(np.finfo(float).eps), 2.0 * np.pi / solution.shortest_period
    grown = growth(system, solution, t_end, enough=float(np.log(tolerance / eps)))
    over = np.flatnonzero(np.log(eps * (1.0 + fastest * grown.t)) + grown.largest > np.log(tolerance))
    return float(grown.t[over[0]]) if len(over) else t_end


def _vectors(system: System, seed: int) -> tuple[Array, Array]:
    """Unit tangent vectors (n, vectors): random with the energy spread over all modes, and (q', q'')."""
    basis = undamped_modes(system)
    noise = np.random.default_rng(seed).standard_normal((2, system.size, RANDOM))
    scale = np.maximum(basis.omega, basis.omega[-1] * 1e-8 or 1.0)[:, None]
    force = system.load(0.0) - system.stiffness @ system.q0 - system.damping @ system.v0
    for contact, u in zip(system.contacts, system.positions(0.0, system.q0), strict=False):
        force = force + contact.row * contact.stops.force(u)
    dq = np.column_stack([basis.shapes @ (noise[0] / scale), system.v0])
    dv = np.column_stack([basis.shapes @ noise[1], np.linalg.solve(system.mass, force)])
    size = _norm(system, dq, dv)
    moving = size > 0.0
    return dq[:, moving] / size[moving], dv[:, moving] / size[moving]


def _norm(system: System, dq: Array, dv: Array) -> Array:
    """sqrt(dq'^T M dq' + dq^T K dq) of every column."""
    return np.sqrt(np.sum(dv * (system.mass @ dv), axis=0) + np.sum(dq * (system.stiffness @ dq), axis=0))
