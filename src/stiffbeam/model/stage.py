"""The contacts of one node under any law: u = r + S F, u' = w + S' F, every F_c after its own law.

w is the velocity at the node. F_c may also be the mean force of the stop over the step, from its energies at both ends,
which neither gains nor loses energy:

    F = -(U(u+) - U(u0))/(u+ - u0),   u+ = r + s F

u0 at the start of the step, r where it would end without the force. F does the work F (u+ - u0) = U(u0) - U(u+)
whatever the step is, so that a scheme which conserves the energy of the linear system under a force that is
constant over the step conserves the sum of both. U is convex, so its secant slope grows with u+ and there is
one F. Source: Gonzalez, J. Nonlinear Sci. 6 (1996) 449-467; Simo and Tarnow, ZAMP 43 (1992) 757-792.

Several stops that are springs, F_c = F_c(v_c) with v = r + S F, are a complementarity problem, which ``solve_node``
ends in finitely many steps.
"""

from __future__ import annotations

import math

import numpy as np

from ..basics.arrays import Array
from ..basics.compiled import compiled, inlined
from .contact_law import (
    G1,
    G2,
    KAPPA,
    NEWTON,
    Law,
    damps,
    depth,
    elastic,
    elastic_slope,
    is_spring,
    law_of,
    mean_elastic,
    stage_law,
    stored,
)  # fmt: skip

# How a node finds its force: the linear law in closed form, any law, or the mean over the step (the discrete gradient).
LINEAR, BY_LAW, MEAN = range(3)
ITERATIONS = 200
# Roundings of f(F), as ``_alone`` adds them up, within which a force counts as solved.
ROUNDINGS = 16.0


@compiled
def secant(u: float, u0: float, law: Law) -> float:
    """(U(u) - U(u0))/(u - u0), U'(u0) where they are equal."""
    a, b = depth(u0, law.g1, law.g2), depth(u, law.g1, law.g2)
    # Both ends in one stop: the mean of the law, without the difference of two energies.
    if a > 0.0 and b > 0.0:
        return mean_elastic(a, b, law)
    if a < 0.0 and b < 0.0:
        return -mean_elastic(-a, -b, law)
    if u == u0:
        return elastic(a, law)
    return (stored(b, law) - stored(a, law)) / (u - u0)


@compiled
def _linear(rho: float, d0: float, s: float, kappa: float) -> float:
    """P = -F on one stop that is a spring, from the depths rho = r - g2 and d0 = u0 - g2 < 0 outside; P >= 0."""
    # Inside at the start: inside at the end too, or off the stop there.
    if d0 > 0.0:
        P = kappa * (rho + d0) / (2.0 + kappa * s)  # inside at both ends
        if rho - s * P >= 0.0:
            return P
        # Off the stop at the end: all its energy goes into the motion.
        out, held = d0 - rho, 0.5 * kappa * d0 * d0  # s P^2 + (d0 - rho) P = U(u0)
        root = math.sqrt(out * out + 4.0 * s * held)
        # Of the two forms of the root the one that does not cancel.
        return 2.0 * held / (out + root) if out > 0.0 else (root - out) / (2.0 * s)
    if rho <= 0.0:
        return 0.0
    # (kappa s^2/2 + s) P^2 - (kappa s rho + rho - d0) P + kappa rho^2/2 = 0, the smaller root
    way = rho - d0
    return kappa * rho * rho / (kappa * s * rho + way + math.sqrt(way * way - 2.0 * kappa * s * rho * d0))


@compiled
def mean_force(r: float, u0: float, s: float, law: Law) -> tuple[float, float]:
    """(F, dF/dr): in closed form on one stop that is a spring, else by Newton's method inside its bracket."""
    slope = secant(r, u0, law)
    # Without a force the energy does not change: zero is the one solution.
    if slope == 0.0:
        return 0.0, 0.0
    F, in_range = 0.0, False
    # The closed form has one stop: it holds while the end stays short of the other.
    if is_spring(law):
        if slope > 0.0 and u0 >= law.g1:
            F = -_linear(r - law.g2, u0 - law.g2, s, law.kappa)
            in_range = r + s * F >= law.g1
        elif slope < 0.0 and u0 <= law.g2:
            F = _linear(law.g1 - r, law.g1 - u0, s, law.kappa)
            in_range = r + s * F <= law.g2
    if not in_range:
        # P = |F| in [0, |slope|]; the node moves back by s P.
        sign = math.copysign(1.0, slope)
        left, right, P = 0.0, abs(slope), 0.0
        for _ in range(NEWTON):
            u = r - sign * s * P
            value = sign * secant(u, u0, law)
            # |F| at the trial falls as P grows, which gives the side of the root.
            if value > P:
                left = P
            else:
                right = P
            new = P + (value - P) / (1.0 + s * _secant_slope(u, u0, sign * value, law))
            # Newton's step, or bisection where it leaves the bracket.
            if not left <= new <= right:
                new = 0.5 * (left + right)
            change, P = abs(new - P), new
            if change <= 2e-16 * P or left >= right:
                break
        F = -sign * P
    # The slope of F in r: the secant's slope over a node that gives way by s.
    stiff = _secant_slope(r + s * F, u0, -F, law)
    return F, -stiff / (1.0 + s * stiff)


@compiled
def _secant_slope(u: float, u0: float, slope: float, law: Law) -> float:
    """d secant/du, to what Newton's method needs."""
    # The quotient loses its digits as the ends meet: its limit is U''/2.
    if abs(u - u0) <= 1e-7 * (abs(u) + abs(u0)):
        d = abs(depth(0.5 * (u + u0), law.g1, law.g2))
        return 0.5 * elastic_slope(d, law) if d > 0.0 else 0.0
    # U is convex: a negative slope is rounding.
    return max(0.0, (elastic(depth(u, law.g1, law.g2), law) - slope) / (u - u0))


@inlined
def one(
    r: float, w: float, s: float, s_rate: float, u0: float, rule: int, law: Array, c: int
) -> tuple[float, float, float]:
    """(F, dF/dr, dF/dw) of contact c by itself; u0 is where its step began."""
    if rule == MEAN:
        F, slope = mean_force(r, u0, s, law_of(law, c))
        return F, slope, 0.0
    return stage_law(r, w, s, s_rate, law_of(law, c))


@compiled
def solve_stage(r: Array, w: Array, S: Array, S_rate: Array, u0: Array, rule: int, law: Array) -> Array:
    """The forces (m,); NaN where the search fails. r, w, u0 (m,); S, S_rate (m, m); law (m, 6).

    Contact c by itself, the others' forces given, has one force f_c. H(F) = F - f(F) vanishes at the solution:
    a semismooth Newton method with a line search on |H|; where that does not lower |H|, every contact takes its
    own f_c in turn (Gauss-Seidel), which for forces that have an energy cannot fail.
    """
    m = law.shape[0]
    # One contact is solved by its law alone.
    F, f = np.zeros(m), np.zeros(m)
    if m == 1:
        F[0] = one(r[0], w[0], S[0, 0], S_rate[0, 0], u0[0], rule, law, 0)[0]
        return F
    tolerance, trial, trial_f, step = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    J, J_trial = np.zeros((m, m)), np.zeros((m, m))
    # F starts at zero, where no contact presses.
    merit = _alone(r, w, S, S_rate, u0, rule, law, F, f, tolerance, J)
    # Where no force changes another, as with the extrapolated contact, f is the solution, even if |H|^2 overflows.
    coupled = np.any(S)
    for c in range(m):
        coupled = coupled or damps(law_of(law, c))
    if not coupled:
        return f
    for _ in range(ITERATIONS):
        if not np.isfinite(merit):
            break
        # Solved where every force is its own f_c to rounding.
        done = True
        for c in range(m):
            done = done and abs(F[c] - f[c]) <= tolerance[c]
        if done:
            return f
        lowered, new = False, merit
        for c in range(m):
            step[c] = F[c] - f[c]
        # Newton's step, halved until |H|^2 falls by Armijo's rule with the usual 1e-4.
        if solve_in_place(J, step):
            share = 1.0
            for _ in range(6):
                for c in range(m):
                    trial[c] = F[c] - share * step[c]
                new = _alone(r, w, S, S_rate, u0, rule, law, trial, trial_f, tolerance, J_trial)
                if new < (1.0 - 1e-4 * share) * merit:
                    lowered = True
                    break
                share *= 0.5
        if not lowered:
            # No share of the step lowers |H|: each contact takes its f_c, with the newest forces of the others.
            for c in range(m):
                trial[c] = F[c]
            for c in range(m):
                here, rate = r[c], w[c]
                for e in range(m):
                    if e != c:
                        here += S[c, e] * trial[e]
                        rate += S_rate[c, e] * trial[e]
                trial[c] = one(here, rate, S[c, c], S_rate[c, c], u0[c], rule, law, c)[0]
            new = _alone(r, w, S, S_rate, u0, rule, law, trial, trial_f, tolerance, J_trial)
        # Buffers change places: the loop makes no arrays.
        F, trial, f, trial_f, J, J_trial, merit = trial, F, trial_f, f, J_trial, J, new
    # The search failed: NaN shows it, which a force from the last iteration would not.
    for c in range(m):
        F[c] = np.nan
    return F


@inlined
def solve_in_place(A: Array, b: Array) -> bool:
    """x with A x = b in place of b, by Gaussian elimination with row exchanges in A; False where a pivot is zero.

    Not np.linalg.solve: with its checks and their messages it takes longer to compile than all the rest of this file.
    """
    n = b.size
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[p, k]):
                p = i
        if not abs(A[p, k]) > 0.0:
            return False
        for j in range(k, n):
            A[k, j], A[p, j] = A[p, j], A[k, j]
        b[k], b[p] = b[p], b[k]
        for i in range(k + 1, n):
            share = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= share * A[k, j]
            b[i] -= share * b[k]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    return True


@compiled
def _alone(
    r: Array, w: Array, S: Array, S_rate: Array, u0: Array, rule: int, law: Array, F: Array, f: Array,
    tolerance: Array, J: Array,
) -> float:  # fmt: skip
    """f(F), what rounding makes of it, dH/dF, and |H|^2."""
    m = law.shape[0]
    total = 0.0
    for c in range(m):
        here, rate, size, size_rate = r[c], w[c], abs(r[c]), abs(w[c])
        for e in range(m):
            if e != c:
                here += S[c, e] * F[e]
                rate += S_rate[c, e] * F[e]
                size += abs(S[c, e] * F[e])
                size_rate += abs(S_rate[c, e] * F[e])
        force, slope, slope_rate = one(here, rate, S[c, c], S_rate[c, c], u0[c], rule, law, c)
        f[c] = force
        tolerance[c] = ROUNDINGS * 2.3e-16 * (abs(force) + abs(slope) * size + abs(slope_rate) * size_rate)
        for e in range(m):
            J[c, e] = 1.0 if e == c else -slope * S[c, e] - slope_rate * S_rate[c, e]
        total += (F[c] - force) ** 2
    return total


# ---------------------------------------------------------------- springs: v = r + S F(v), by active set


@inlined
def solve_definite(A: Array, b: Array, n: int) -> None:
    """x with A x = b in place of b, A = L D L^T the first n rows; its lower part becomes L and D."""
    # No exchange of rows: a definite A has positive pivots.
    for i in range(n):
        for j in range(i):
            for k in range(j):
                A[i, j] -= A[i, k] * A[k, k] * A[j, k]
            A[i, j] /= A[j, j]
        for k in range(i):
            A[i, i] -= A[i, k] * A[i, k] * A[k, k]
            b[i] -= A[i, k] * b[k]
    for i in range(n - 1, -1, -1):
        b[i] /= A[i, i]
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]


@compiled
def solve_node(r: Array, compliance: Array, law: Array) -> Array:
    """The forces F (m,) with v = r + S F and F_c = F_c(v_c), S symmetric positive semidefinite, laws (m, 3).

    They minimise 1/2 F^T S F + r^T F + sum_c (F_c^2/(2 kappa_c) - g_c F_c), g_c the stop that F_c comes
    from. Lawson and Hanson's active set: close the contact that penetrates most, solve for the closed
    ones, and go only as far as no force changes sign, opening those that reach zero. It ends, because every iteration
    lowers the minimum over the closed contacts.
    """
    m = r.size
    kappa, g1, g2 = law[:, KAPPA], law[:, G1], law[:, G2]
    force, target, right = np.zeros(m), np.zeros(m), np.zeros(m)
    side = np.zeros(m)  # +1 on the upper stop, -1 on the lower, 0 open
    factor, which = np.zeros((m, m)), np.zeros(m, np.int64)
    # The limit is for rounding, which keeps a search from ending where S has a condition of 1e14 or more. Rigid stops
    # are refused from 1e12 on; compliant ones add 1/kappa to the diagonal.
    for _ in range(20 * m):
        # Penetration times stiffness is the force that it would cause alone: the largest one enters.
        worst = 0.0
        entering = -1
        stop = 0.0
        for c in range(m):
            if side[c] == 0.0:
                v = r[c]
                for e in range(m):
                    v += compliance[e, c] * force[e]
                depth = max(v - g2[c], g1[c] - v)
                # A depth that rounding of v explains must not enter, or the same contact would enter and leave forever.
                if depth > 1e-15 * abs(v) and kappa[c] * depth > worst:
                    worst = kappa[c] * depth
                    entering = c
                    stop = 1.0 if v > g2[c] else -1.0
        if entering < 0:
            break
        side[entering] = stop
        # Solve for the closed contacts, some of which may open again.
        while True:
            # (1/kappa + S) F = g - r on the closed contacts, the others left at zero.
            closed = 0
            for c in range(m):
                target[c] = 0.0
                if side[c] != 0.0:
                    which[closed] = c
                    right[closed] = (g2[c] if side[c] > 0.0 else g1[c]) - r[c]
                    for e in range(closed):
                        factor[closed, e] = compliance[which[e], c]
                    factor[closed, closed] = 1.0 / kappa[c] + compliance[c, c]
                    closed += 1
            solve_definite(factor, right, closed)
            for i in range(closed):
                target[which[i]] = right[i]
            # As far as the first force that would pull: beyond it the minimum over pressing forces is left.
            way = 1.0
            opening = -1
            for c in range(m):
                if side[c] != 0.0 and target[c] * side[c] >= 0.0:  # the force opposes its side
                    # Equal forces are both zero: the contact opens without a move.
                    part = force[c] / (force[c] - target[c]) if force[c] != target[c] else 0.0
                    if opening < 0 or part < way:
                        way = part
                        opening = c
            if opening < 0:
                for c in range(m):
                    force[c] = target[c]
                break
            # Move to the first zero; set it exactly, so that rounding leaves no force on an open contact.
            for c in range(m):
                force[c] += way * (target[c] - force[c])
            force[opening] = 0.0
            side[opening] = 0.0
    return force


@compiled
def solve_pivoting(r: Array, compliance: Array, law: Array) -> Array:
    """The forces of rigid stops with v = r + S^T F, S = ``compliance`` (m, m) positive definite but not symmetric.

    No energy has its minimum at F, so that ``solve_node`` may end at another point. Murty's least-index rule: the first
    contact that penetrates closes, or the first that would pull opens, and all closed ones are solved again.
    """
    m = r.size
    side, force = np.zeros(m), np.zeros(m)
    # The rule ends for every such S; the limit is for rounding.
    for _ in range(20 * m * m):
        closed = np.flatnonzero(side)
        A, b = np.empty((closed.size, closed.size)), np.empty(closed.size)
        for i, c in enumerate(closed):
            b[i] = (law[c, G2] if side[c] > 0.0 else law[c, G1]) - r[c]
            for j, e in enumerate(closed):
                A[i, j] = compliance[e, c]
        solve_in_place(A, b)
        force[:] = 0.0
        for i, c in enumerate(closed):
            force[c] = b[i]
        solved = True
        for c in range(m):
            if side[c] != 0.0:
                if force[c] * side[c] >= 0.0:
                    side[c], force[c], solved = 0.0, 0.0, False
                    break
                continue
            v = r[c]
            for e in range(m):
                v += compliance[e, c] * force[e]
            # As in ``solve_node``, a depth that rounding explains does not close a contact.
            if max(v - law[c, G2], law[c, G1] - v) > 1e-15 * abs(v):
                side[c], solved = (1.0 if v > law[c, G2] else -1.0), False
                break
        if solved:
            break
    return force
