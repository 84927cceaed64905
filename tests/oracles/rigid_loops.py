"""Schemes for rigid stops as plain loops with matrices; the reactions by trying every set of closed contacts.

``chain`` is a system that they take, as the package has it and as plain numbers.
"""

from __future__ import annotations

from itertools import product

import numpy as np

import stiffbeam as sb

INF = float("inf")


def reactions(r, S, lower, upper):
    """lam with y = r + S lam in [lower, upper], lam <= 0 only where y = upper, >= 0 only where y = lower."""
    m = len(r)
    for sides in product((0, 1, -1), repeat=m):
        chosen = [c for c in range(m) if sides[c]]
        ends = np.array([upper[c] if sides[c] > 0 else lower[c] for c in chosen])
        if not np.all(np.isfinite(ends)):
            continue
        lam = np.zeros(m)
        if chosen:
            lam[chosen] = np.linalg.solve(S[np.ix_(chosen, chosen)], ends - r[chosen])
        y = r + S @ lam
        scale = 1e-11 * (1.0 + np.abs(r).max())
        signs = all(lam[c] * sides[c] <= 0.0 for c in chosen)
        if signs and np.all(y >= lower - scale) and np.all(y <= upper + scale):
            return lam
    raise AssertionError("no set of contacts fits")


class Loop:
    """M q'' + C q' + K q = f(t) + B^T lam, stops [lower, upper] of B q + o(t), restitution e; all as arrays."""

    def __init__(self, M, C, K, B, lower, upper, e, f, o, do):
        self.M, self.C, self.K, self.B = M, C, K, B
        self.lower, self.upper, self.e, self.f, self.o, self.do = lower, upper, e, f, o, do

    def sides(self, u, tolerance=0.0):
        """Bounds of a velocity where u is at a stop."""
        below, above = u <= self.lower + tolerance, u >= self.upper - tolerance
        return np.where(below, 0.0, -np.inf), np.where(above, 0.0, np.inf)

    def moreau_jean(self, q, v, h, n, theta=0.5):
        M, C, K, B, t = self.M, self.C, self.K, self.B, 0.0
        W = M + h * theta * C + (h * theta) ** 2 * K
        path = [(q, v, np.zeros(len(B)))]
        for k in range(n):
            t = k * h
            force = (1 - theta) * self.f(t) + theta * self.f(t + h)
            free = v + np.linalg.solve(W, h * (force - C @ v - K @ (q + h * theta * v)))
            r = B @ free + self.do(t + h) + self.e * (B @ v + self.do(t))
            bounds = self.sides(B @ (q + h / 2 * v) + self.o(t + h / 2))
            P = reactions(r, B @ np.linalg.solve(W, B.T), *bounds)
            new = free + np.linalg.solve(W, B.T @ P)
            q, v = q + h * ((1 - theta) * v + theta * new), new
            path.append((q, v, P / h))
        return path

    def paoli_schatzman(self, q, v, h, n, beta=0.25):
        M, C, K, B = self.M, self.C, self.K, self.B
        W = M + h / 2 * C + h * h * beta * K
        a = np.linalg.solve(M + h * h * beta * K, self.f(0.0) - C @ v - K @ q)
        before = q - h * (v - h / 2 * a)
        path = [(q, (q - before) / h, np.zeros(len(B)))]
        for k in range(n):
            t = k * h
            right = M @ (2 * q - before) + h / 2 * C @ before
            right = right + h * h * (self.f(t) - K @ ((1 - 2 * beta) * q + beta * before))
            free = np.linalg.solve(W, right)
            old = B @ before + self.o(max(0.0, t - h))
            r = B @ free + self.o(t + h) + self.e * old
            lam = reactions(r, B @ np.linalg.solve(W, B.T), (1 + self.e) * self.lower, (1 + self.e) * self.upper)
            before, q = q, free + np.linalg.solve(W, B.T @ lam)
            path.append((q, (q - before) / h, lam / h**2))
        return path

    def contact_stabilised(self, q, v, h, n):
        M, C, K, B = self.M, self.C, self.K, self.B
        W = M + h / 2 * C + h * h / 4 * K
        path = [(q, v, np.zeros(len(B)))]
        for k in range(n):
            t = k * h
            ahead = q + h * v
            nu = reactions(B @ ahead + self.o(t + h), B @ np.linalg.solve(M, B.T), self.lower, self.upper)
            ahead = ahead + np.linalg.solve(M, B.T @ nu)
            force = (self.f(t) + self.f(t + h)) / 2 - K @ (q + ahead) / 2 - C @ v
            a = np.linalg.solve(W, force)
            r = B @ (ahead + h * h / 2 * a) + self.o(t + h)
            lam = reactions(r, h * h / 2 * B @ np.linalg.solve(W, B.T), self.lower, self.upper)
            a = a + np.linalg.solve(W, B.T @ lam)
            q, v = ahead + h * h / 2 * a, v + h * a
            path.append((q, v, lam))
        return path

    def nonsmooth_alpha(self, q, v, h, n, rho=0.8):
        M, C, K, B = self.M, self.C, self.K, self.B
        am, af = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
        gamma, beta = 0.5 - am + af, (1 - am + af) ** 2 / 4
        a = s = np.linalg.solve(M, self.f(0.0) - C @ v - K @ q)
        path = [(q, v, np.zeros(len(B)))]
        N = len(q)
        for k in range(n):
            t = k * h

            def smooth(U, q=q, v=v, a=a, s=s, t=t):
                """q+, v~, a+, s+ from the four equations at once, U the correction of positions."""
                big, right, eye = np.zeros((4 * N, 4 * N)), np.zeros(4 * N), np.eye(N)
                blocks = [slice(i * N, (i + 1) * N) for i in range(4)]
                Q, V, A, X = blocks
                big[Q, Q], big[Q, A], right[Q] = eye, -h * h * beta * eye, q + h * v + h * h * (0.5 - beta) * a + U
                big[V, V], big[V, A], right[V] = eye, -h * gamma * eye, v + h * (1 - gamma) * a
                big[A, A], big[A, X], right[A] = (1 - am) * eye, -(1 - af) * eye, af * s - am * a
                big[X, X], big[X, V], big[X, Q], right[X] = M, C, K, self.f(t + h)
                found = np.linalg.solve(big, right)
                return [found[x] for x in blocks]

            free = B @ smooth(np.zeros(N))[0]
            unit = np.array([B @ smooth(np.linalg.solve(M, b))[0] - free for b in B]).T
            nu = reactions(free + self.o(t + h), unit, self.lower, self.upper)
            q_new, v_new, a, s = smooth(np.linalg.solve(M, B.T @ nu))
            low, high = np.where(nu > 0.0, 0.0, -np.inf), np.where(nu < 0.0, 0.0, np.inf)
            r = B @ v_new + self.do(t + h) + self.e * (B @ v + self.do(t))
            P = reactions(r, B @ np.linalg.solve(M, B.T), low, high)
            q, v = q_new, v_new + np.linalg.solve(M, B.T @ P)
            path.append((q, v, P / h))
        return path


def chain(contacts=1, damping="none", moving=False, e=None):
    """Four masses in a row, driven, with stops at one or two of them: the System and the same as a Loop."""
    M, n = np.diag([1.0, 0.7, 1.3, 0.8]), 4
    K = 40.0 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    turning = 20.0 * (np.outer(np.eye(n)[3], np.eye(n)[1]) - np.outer(np.eye(n)[1], np.eye(n)[3]))  # gyroscopic
    C = {"none": np.zeros((n, n)), "stiffness": 0.004 * K, "coupling": np.diag([0.0, 0.0, 0.0, 1.5]),
         "turning": turning}[damping]  # fmt: skip
    B = np.eye(n)[[3, 1][:contacts]]
    lower, upper = np.array([-0.3, -0.25][:contacts]), np.array([0.2, INF][:contacts])
    motion = sb.Harmonic(0.03, 5.0, 0.3)
    load, drive = np.array([0.0, 6.0, 0.0, -3.0]), sb.Harmonic(3.0, 4.0, 1.0)
    stops = [
        sb.Stops(lower=lo, upper=None if hi == INF else hi, stiffness=INF, restitution=e)
        for lo, hi in zip(lower, upper, strict=True)
    ]
    offsets = [motion if moving else None, None][:contacts]
    system = sb.System.from_matrices(
        M, K, C, loads=[(load, drive)], initial_velocity=[0.0, 0.5, 1.0, -0.5],
        contacts=[sb.Contact(*x) for x in zip(B, stops, offsets, strict=True)],
    )  # fmt: skip
    on = np.array([1.0, 0.0][:contacts]) * moving
    loop = Loop(
        M, C, K, B, lower, upper, np.full(contacts, e or 0.0), lambda t: load * float(drive.value(t)),
        lambda t: on * float(motion.value(t)), lambda t: on * float(motion.rate(t)),
    )  # fmt: skip
    return system, loop
