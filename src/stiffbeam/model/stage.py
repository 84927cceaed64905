"""The contacts of one node under any law: u = r + S F, u' = w + S' F, every F_c after its own law.

w is the velocity at the node, for averaged contact the way of half a step at this velocity.
"""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array
from ..basics.compiled import compiled, inlined
from .contact_law import law_of, stage_law
from .discrete_gradient import averaged_force, mean_force

# How a node finds its force: the linear law in closed form, any law, its mean over the step by the discrete gradient,
# or its average around the node.
LINEAR, BY_LAW, MEAN, AVERAGED = range(4)
RATED = (BY_LAW, AVERAGED)  # these need the velocity at the node
ITERATIONS = 200
ROUNDINGS = 16.0


@inlined
def one(
    r: float, w: float, s: float, s_rate: float, u0: float, rule: int, law: Array, c: int
) -> tuple[float, float, float]:
    """(F, dF/dr, dF/dw) of contact c by itself; u0 is where its step began."""
    if rule == MEAN:
        F, slope = mean_force(r, u0, s, law_of(law, c))
        return F, slope, 0.0
    if rule == AVERAGED:
        return averaged_force(r, w, s, s_rate, law_of(law, c))
    return stage_law(r, w, s, s_rate, law_of(law, c))


@compiled
def solve_stage(r: Array, w: Array, S: Array, S_rate: Array, u0: Array, rule: int, law: Array) -> Array:
    """The forces (m,); NaN where the search fails. r, w, u0 (m,); S, S_rate (m, m); law (m, 6).

    Contact c by itself, the others' forces given, has one force f_c. H(F) = F - f(F) vanishes at the solution:
    a semismooth Newton method with a line search on |H|; where that does not lower |H|, every contact takes its
    own f_c in turn (Gauss-Seidel), which for forces that have an energy cannot fail.
    """
    m = law.shape[0]
    F, f = np.zeros(m), np.zeros(m)
    if m == 1:
        F[0] = one(r[0], w[0], S[0, 0], S_rate[0, 0], u0[0], rule, law, 0)[0]
        return F
    tolerance, trial, trial_f, step = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    J, J_trial = np.zeros((m, m)), np.zeros((m, m))
    merit = _alone(r, w, S, S_rate, u0, rule, law, F, f, tolerance, J)
    for _ in range(ITERATIONS):
        if not np.isfinite(merit):
            break
        done = True
        for c in range(m):
            done = done and abs(F[c] - f[c]) <= tolerance[c]
        if done:
            return f
        lowered, new = False, merit
        for c in range(m):
            step[c] = F[c] - f[c]
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
        F, trial, f, trial_f, J, J_trial, merit = trial, F, trial_f, f, J_trial, J, new
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
