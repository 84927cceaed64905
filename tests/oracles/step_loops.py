"""Every scheme as a plain loop over dense matrices, written from its formulas, sharing no code with the package.

One step asks for the accelerations at its nodes; a node's equation is M a + C v + K q = f + sum row^T F(row q + o)
with q and v affine in a. Contact is found by trying every combination of sides.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from vibro_impact import Case, wave_value

GAMMA = 0.435866521508459  # the middle root of 1/6 - 3/2 g + 3 g^2 - g^3


def contact_forces(case: Case, r: np.ndarray, S: np.ndarray) -> np.ndarray:
    """F with u = r + S F and F_c = F_c(u_c): of all combinations of sides the one that fits best."""
    best, found = np.inf, np.zeros(len(r))
    for sides in product(*[(0, 1, -1)] * len(r)):
        stops = np.array([c.upper if s > 0 else c.lower for c, s in zip(case.contacts, sides, strict=True)])
        on = [i for i, s in enumerate(sides) if s and np.isfinite(stops[i])]
        if len(on) < np.count_nonzero(sides):
            continue
        F = np.zeros(len(r))
        if on:
            flexible = np.diag([1.0 / case.contacts[i].kappa for i in on])
            F[on] = np.linalg.solve(flexible + S[np.ix_(on, on)], stops[on] - r[on])
        u, wrong = r + S @ F, 0.0
        for i, (c, s) in enumerate(zip(case.contacts, sides, strict=True)):
            wrong = max(wrong, (s * F[i] / c.kappa) if s else max(u[i] - c.upper, c.lower - u[i]))
        if wrong < best:
            best, found = wrong, F
        if wrong <= 0.0:
            break
    return found


class Nodes:
    """The equation of motion at one time, for states q = q_known + b a, v = v_known + c a."""

    def __init__(self, case: Case) -> None:
        self.case, self.rows = case, np.array([c.row for c in case.contacts]).reshape(-1, case.size)
        self.inverses: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}

    def offsets(self, t: float) -> np.ndarray:
        return np.array([0.0 if c.offset is None else float(wave_value(c.offset, t)) for c in self.case.contacts])

    def law(self, u: np.ndarray) -> np.ndarray:
        """The stops' forces at positions u."""
        c = self.case.contacts
        return np.array([-x.kappa * (max(y - x.upper, 0.0) - max(x.lower - y, 0.0)) for x, y in zip(c, u, strict=True)])

    def load(self, t: float) -> np.ndarray:
        zero = np.zeros(self.case.size)
        return sum((p * float(wave_value(w, t)) for p, w in self.case.loads), zero)

    def net(self, t: float, q: np.ndarray, v: np.ndarray, F: np.ndarray) -> np.ndarray:
        """f - C v - K q + sum row^T F."""
        return self.load(t) - self.case.damping @ v - self.case.stiffness @ q + F @ self.rows

    def solve(
        self,
        t: float,
        q: np.ndarray,
        v: np.ndarray,
        b: float,
        c: float,
        weight: float,
        rest: np.ndarray,
        guess: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """a with M a = weight N(q + b a, v + c a) + rest, and the contact forces: implicit, or of ``guess``."""
        if (b, c, weight) not in self.inverses:
            matrix = self.case.mass + weight * (c * self.case.damping + b * self.case.stiffness)
            inverse = np.linalg.inv(matrix)
            self.inverses[b, c, weight] = inverse, weight * b * self.rows @ inverse @ self.rows.T
        inverse, S = self.inverses[b, c, weight]
        free = inverse @ (weight * self.net(t, q, v, np.zeros(len(self.rows))) + rest)
        shift = self.offsets(t)
        if guess is None:
            F = contact_forces(self.case, self.rows @ (q + b * free) + shift, S)
        else:
            F = self.law(self.rows @ guess + shift)
        return free + weight * inverse @ (F @ self.rows), F


def march(
    case: Case, scheme: str, parameters: dict, dt: float, steps: int, contact: str
) -> tuple[np.ndarray, np.ndarray]:
    """q, q' (steps + 1, n)."""
    nodes, q, v = Nodes(case), case.q0.astype(float), case.v0.astype(float)
    F = nodes.law(nodes.rows @ q + nodes.offsets(0.0))
    a = np.linalg.solve(case.mass, nodes.net(0.0, q, v, F))
    path = [(q, v)]
    step = STEPS[scheme](nodes, dt, parameters, contact == "extrapolated")
    memory: dict = {"a": a, "net": case.mass @ a, "past": None}
    for n in range(steps):
        new = step(n * dt, q, v, memory)
        memory["past"] = (q, v)
        q, v = new
        path.append((q, v))
    q, v = (np.array(x) for x in zip(*path, strict=True))
    return q, v


Step = Callable[[float, np.ndarray, np.ndarray, dict], tuple[np.ndarray, np.ndarray]]


def _stage(nodes: Nodes, t: float, q: np.ndarray, v: np.ndarray, c: float, guess: np.ndarray | None):
    """(a, v) at y = (q, v) + c (v_new, a)."""
    a, _ = nodes.solve(t, q + c * v, v, c * c, c, 1.0, np.zeros(len(q)), guess)
    return a, v + c * a


def _theta(nodes: Nodes, dt: float, parameters: dict, explicit: bool) -> Step:
    theta = parameters.get("theta", 0.5)

    def step(t, q, v, memory):
        guess = q + dt * v if explicit else None
        rq, rv = q + (1 - theta) * dt * v, v + (1 - theta) * dt * memory["a"]
        a, rate = _stage(nodes, t + dt, rq, rv, theta * dt, guess)
        memory["a"] = a
        return rq + theta * dt * rate, rv + theta * dt * a

    return step


def _bdf2(nodes: Nodes, dt: float, parameters: dict, explicit: bool) -> Step:
    first = _theta(nodes, dt, {}, explicit)

    def step(t, q, v, memory):
        if memory["past"] is None:
            return first(t, q, v, memory)
        q0, v0 = memory["past"]
        guess = (4 * q - q0 + 2 * dt * (2 * v - v0)) / 3 if explicit else None
        rq, rv = (4 * q - q0) / 3, (4 * v - v0) / 3
        a, rate = _stage(nodes, t + dt, rq, rv, 2 * dt / 3, guess)
        return rq + 2 * dt / 3 * rate, rv + 2 * dt / 3 * a

    return step


def _sdirk(nodes: Nodes, dt: float, parameters: dict, explicit: bool) -> Step:
    g = parameters.get("gamma", GAMMA)
    g = GAMMA if g == 0.4359 else g
    s = -(g**3 - 3 * g**2 + 2 * g - 1 / 3) / (g**2 - 2 * g + 0.5)
    b2 = (g**2 - 2 * g + 0.5) / s
    A = [[g], [s, g], [1 - g - b2, b2, g]]

    def step(t, q, v, memory):
        rates = []
        for row in A:
            rq = q + dt * sum(w * k[0] for w, k in zip(row, rates, strict=False))
            rv = v + dt * sum(w * k[1] for w, k in zip(row, rates, strict=False))
            guess = q + sum(row) * dt * v if explicit else None
            a, rate = _stage(nodes, t + sum(row) * dt, rq, rv, g * dt, guess)
            rates.append((rate, a))
        return tuple(x + dt * sum(w * k[i] for w, k in zip(A[2], rates, strict=True)) for i, x in enumerate((q, v)))

    return step


def _bathe(nodes: Nodes, dt: float, parameters: dict, explicit: bool) -> Step:
    s = parameters.get("split", 0.5)

    def step(t, q, v, memory):
        half = s * dt / 2
        rq, rv = q + half * v, v + half * memory["a"]
        a, rate = _stage(nodes, t + s * dt, rq, rv, half, q + s * dt * v if explicit else None)
        middle = rq + half * rate, rv + half * a
        c = (1 - s) / (2 - s) * dt
        rq, rv = ((m - (1 - s) ** 2 * y) / (s * (2 - s)) for m, y in zip(middle, (q, v), strict=True))
        a, rate = _stage(nodes, t + dt, rq, rv, c, q + dt * v if explicit else None)
        memory["a"] = a
        return rq + c * rate, rv + c * a

    return step


def _newmark(alpha_m: float, alpha_f: float) -> Callable[[Nodes, float, dict, bool], Step]:
    beta, gamma = (1 - alpha_m + alpha_f) ** 2 / 4, 0.5 - alpha_m + alpha_f

    def make(nodes: Nodes, dt: float, parameters: dict, explicit: bool) -> Step:
        M = nodes.case.mass

        def step(t, q, v, memory):
            a = memory["a"]
            q_known, v_known = q + dt * v + dt**2 * (0.5 - beta) * a, v + dt * (1 - gamma) * a
            rest = (alpha_f * memory["net"] - alpha_m * M @ a) / (1 - alpha_m)
            weight, guess = (1 - alpha_f) / (1 - alpha_m), q + dt * v if explicit else None
            new, F = nodes.solve(t + dt, q_known, v_known, beta * dt**2, gamma * dt, weight, rest, guess)
            q, v = q_known + beta * dt**2 * new, v_known + gamma * dt * new
            memory["a"], memory["net"] = new, nodes.net(t + dt, q, v, F)
            return q, v

        return step

    return make


def _hht(nodes: Nodes, dt: float, parameters: dict, explicit: bool) -> Step:
    return _newmark(0.0, -parameters.get("alpha", -0.1))(nodes, dt, parameters, explicit)


def _generalised_alpha(nodes: Nodes, dt: float, parameters: dict, explicit: bool) -> Step:
    rho = parameters.get("rho", 0.8)
    return _newmark((2 * rho - 1) / (rho + 1), rho / (rho + 1))(nodes, dt, parameters, explicit)


STEPS: dict[str, Callable[[Nodes, float, dict, bool], Step]] = {
    "bdf2": _bdf2,
    "sdirk": _sdirk,
    "hht": _hht,
    "generalised-alpha": _generalised_alpha,
    "trapezoidal": _theta,
    "theta": _theta,
    "bathe": _bathe,
}
