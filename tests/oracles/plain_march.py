"""The witness for marches: a scheme's own step in long double, step by step, with its own search for forces.

Of the package it reads the scheme, and the system's numbers. The linear algebra, the law of the stops, its mean over a
step and the search for the forces are its own: u = r + S F, u' = w + S' F and F_c after the law, contact by contact
until nothing changes any more.
"""

from __future__ import annotations

import numpy as np

import stiffbeam as sb
from stiffbeam.model.equations import Equation

Real = np.longdouble


class Dense(Equation):
    """M q'' + C q' + K q = f in long double."""

    def __init__(self, M, C, K) -> None:
        self.M, self.C, self.K = (np.asarray(x, Real) for x in (M, C, K))
        self.kept = {}

    def mass(self, x):
        return x @ self.M.T

    def damping(self, x):
        return x @ self.C.T

    def stiffness(self, x):
        return x @ self.K.T

    def solve(self, a, b, x):
        if (a, b) not in self.kept:
            self.kept[a, b] = inverse(self.M + a * self.C + b * self.K)
        return x @ self.kept[a, b].T

    def flow(self, t, y, force0, force1):
        n = len(self.M)
        if t not in self.kept:  # y' = A y + B f, f' = slope, slope' = 0
            whole, minus = np.zeros((4 * n, 4 * n), Real), -inverse(self.M)
            whole[:n, n : 2 * n] = whole[2 * n : 3 * n, 3 * n :] = np.eye(n)
            whole[n : 2 * n, :n], whole[n : 2 * n, n : 2 * n] = minus @ self.K, minus @ self.C
            whole[n : 2 * n, 2 * n : 3 * n] = -minus
            unit = np.ones(4 * n, Real)  # positions and velocities of one size, or squarings lose what is small
            unit[n : 2 * n] = np.sqrt(np.max(np.abs(minus @ self.K))) or 1.0
            self.kept[t] = unit[:, None] * exponential(whole * t / unit[:, None] * unit) / unit
        z = np.concatenate([y[0], y[1], force0 + 0 * y[0], (force1 - force0) / t + 0 * y[0]], axis=-1) @ self.kept[t].T
        return np.array([z[..., :n], z[..., n : 2 * n]])


def inverse(A: np.ndarray) -> np.ndarray:
    X = np.linalg.inv(A.astype(float)).astype(Real)
    for _ in range(3):  # Newton's iteration
        X = X + X @ (np.eye(len(A)) - A @ X)
    return X


def exponential(A: np.ndarray) -> np.ndarray:
    """Taylor's series, squared."""
    halvings = max(0, int(np.ceil(np.log2(float(np.max(np.sum(np.abs(A), axis=1))) + 1e-30))) + 3)
    term = total = np.eye(len(A), dtype=Real)
    for k in range(1, 20):
        term = term @ (A / Real(2) ** halvings) / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


class Law:
    """F(u, u') of a contact, and its mean over a step."""

    def __init__(self, stops: sb.Stops) -> None:
        self.kappa, self.low, self.high, self.p, self.c, self.lam = map(Real, stops.law)

    def depth(self, u):
        return (u - self.high, 1) if u > self.high else (self.low - u, -1) if u < self.low else (Real(0), 0)

    def force(self, u, v):
        d, side = self.depth(u)
        return -side * max(Real(0), self.kappa * d**self.p * (1 + self.lam * side * v) + self.c * side * v)

    def stored(self, u):
        return self.kappa * self.depth(u)[0] ** (self.p + 1) / (self.p + 1)

    def mean(self, u, u0):
        """-(U(u) - U(u0))/(u - u0), by Gauss' rule where the difference cancels."""
        (d, side), (d0, side0) = self.depth(u), self.depth(u0)
        if side == side0 and abs(d - d0) <= 1e-3 * d0:
            x, weights = np.polynomial.legendre.leggauss(8)
            return -side * self.kappa * np.sum(0.5 * weights * ((d + d0) / 2 + (d - d0) / 2 * x) ** self.p)
        return Real(0) if u == u0 else -(self.stored(u) - self.stored(u0)) / (u - u0)


def alone(F, r, w, s, s_rate):
    """f = F(r + s f, w + s' f), to rounding: f - F grows with f. False position, and bisection where that is slow."""
    at_zero = F(r, w)
    if not at_zero or not (s or s_rate):
        return at_zero
    low, high = sorted((Real(0), at_zero))
    for i in range(150):
        ends = [x - F(r + s * x, w + s_rate * x) for x in (low, high)]
        if ends[0] == 0 or ends[1] == 0:
            return low if ends[0] == 0 else high
        f = low + (high - low) * (ends[0] / (ends[0] - ends[1])) if i % 3 else (low + high) / 2
        if f in (low, high) or high - low <= 2e-19 * max(abs(low), abs(high)):
            break
        low, high = (low, f) if f - F(r + s * f, w + s_rate * f) > 0 else (f, high)
    return f


def together(laws, r, w, S, S_rate):
    """The forces of all contacts at a node."""
    F = np.zeros(len(laws), Real)
    for _ in range(20_000 if len(laws) > 1 else 1):
        before = F.copy()
        for c, law in enumerate(laws):
            F[c] = 0
            F[c] = alone(law, r[c] + S[c] @ F, w[c] + S_rate[c] @ F, S[c, c], S_rate[c, c])
        if np.all(np.abs(F - before) <= 1e-18 * np.max(np.abs(F))):
            break
    return F


def value(function, t):
    """A function of time at t, and its rate."""
    if function is None:
        return Real(0), Real(0)
    if isinstance(function, sb.Harmonic):
        a, w, phase = (Real(float(getattr(function, x))) for x in ("amplitude", "frequency", "phase"))
        return a * np.sin(w * t + phase), a * w * np.cos(w * t + phase)
    at = lambda t: Real(float(function.value(float(t)) if hasattr(function, "value") else function(float(t))))  # noqa: E731
    if hasattr(function, "rate"):
        return at(t), Real(float(function.rate(float(t))))
    return at(t), (at(t + 1e-6) - at(t - 1e-6)) / Real(2e-6)


class March:
    """The steps of one scheme from time t on."""

    def __init__(self, system, scheme, dt, contact, history, t) -> None:
        self.system, self.scheme, self.dt, self.contact = system, scheme, Real(dt), contact
        self.equation = Dense(system.mass, system.damping, system.stiffness)
        self.rows = np.array([c.row for c in system.contacts], Real).reshape(-1, system.size)
        self.laws, m, S = [Law(c.stops) for c in system.contacts], len(self.rows), len(scheme.nodes)
        u, rate = self.motion(*history[0], t)
        force = self.load(t)
        if contact != "conserving":
            force = force + np.array([x.force(a, b) for x, a, b in zip(self.laws, u, rate, strict=True)]) @ self.rows
        self.z, self.before = scheme.initial(self.equation, history, force), u
        self.none, self.forces = [np.zeros(system.size, Real)] * S, np.zeros(m, Real)
        zero, self.pushes = np.zeros_like(self.z), []  # of a unit force at node s: on the state, and at every node
        for s in range(S):
            unit = [[self.rows[c] if i == s else x for i, x in enumerate(self.none)] for c in range(m)]
            moved = [scheme.step(self.equation, self.dt, zero, self.none, one) for one in unit]
            states, at_nodes = np.array([z for z, _ in moved]), np.array([x for _, x in moved], Real)
            if contact == "extrapolated":
                at_nodes = 0 * at_nodes
            self.pushes.append((states, at_nodes[:, :, :2] @ self.rows.T if m else at_nodes))

    def load(self, t):
        return sum((value(f, t)[0] * vector for vector, f in self.system.loads), np.zeros(self.system.size, Real))

    def motion(self, q, v, t):
        moved = np.array([value(c.offset, t) for c in self.system.contacts], Real).reshape(-1, 2)
        return self.rows @ q + moved[:, 0], self.rows @ v + moved[:, 1]

    def step(self, n):
        scheme, dt = self.scheme, self.dt
        times = [(n + Real(c)) * dt for c in scheme.nodes]
        places = scheme.predict(self.equation, dt, self.z) if self.contact == "extrapolated" else None
        z, stages = scheme.step(self.equation, dt, self.z, [self.load(t) for t in times], self.none)
        where = [y[0] for y in stages] if places is None else places
        x = np.array([self.motion(q, y[1], t) for q, y, t in zip(where, stages, times, strict=True)], Real)
        for s, (of_state, of_nodes) in enumerate(self.pushes):
            if not len(self.rows):
                break
            F = [law.force for law in self.laws]
            if self.contact == "conserving":
                F = [
                    lambda u, _, law=law, u0=u0: law.mean(u, u0) for law, u0 in zip(self.laws, self.before, strict=True)
                ]
            F = together(F, *x[s], of_nodes[:, s, 0].T, of_nodes[:, s, 1].T)
            x, z = x + np.tensordot(F, of_nodes, 1), z + np.tensordot(F, of_state, 1)
            self.before, self.forces = x[s, 0], F
        self.z = z


def states(system: sb.System, scheme: sb.Scheme, dt: float, steps: int, contact: str = "implicit"):
    """q, q' (steps + 1, n) in long double, and the forces (steps, contacts) at the last node of every step."""
    scheme = scheme.conserving if contact == "conserving" else scheme
    path, forces, n = [np.array([system.q0, system.v0], Real)], [], 0
    for part, end in ((scheme.starter, min(scheme.history - 1, steps)), (scheme, steps)):
        if n < end:
            march = March(system, part, dt, contact, path[::-1][: part.history], n * Real(dt))
            for n in range(n, end):  # noqa: B020
                march.step(n)
                path.append(march.z[:2])
                forces.append(march.forces)
            n = end
    q, v = np.array(path).transpose(1, 0, 2)
    return q, v, np.array(forces)
