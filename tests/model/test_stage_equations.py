"""The equations of a stage under any law, solved: against bisection and against their own residual."""

from __future__ import annotations

import math

import numpy as np
import pytest
from law_systems import LAWS, stops_of

import stiffbeam as sb
from stiffbeam.kernels.contact import solve_stage
from stiffbeam.kernels.march import BY_LAW


def _brute(stops: sb.Stops, r: float, w: float, s: float, s_rate: float) -> float:
    """|F| by bisection on what the law says, jump included."""
    sign = 1.0 if r > stops.upper_bound else -1.0
    d0, rate0 = (r - stops.upper_bound, w) if sign > 0 else (stops.lower_bound - r, -w)

    def excess(P: float) -> float:
        d, rate = d0 - s * P, rate0 - s_rate * P
        if d <= 0.0:
            return P
        size = stops.stiffness * d ** float(stops.exponent)
        return P - max(0.0, size * (1.0 + stops.dissipation * rate) + stops.damping * rate)

    if excess(0.0) >= 0.0:
        return 0.0
    low, high = 0.0, 1.0
    while excess(high) < 0.0:
        high *= 2.0
    for _ in range(400):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) < 0.0 else (low, middle)
    return high


@pytest.mark.parametrize("seed", range(40))
def test_stage_equation_of_one_contact(seed):
    rng = np.random.default_rng([seed, 5])
    stops = stops_of(rng, LAWS[seed % 4])
    one = np.zeros(1)
    for _ in range(50):
        r, w = float(rng.normal()), float(10.0 ** rng.uniform(-2, 2) * rng.normal())
        s, s_rate = 10.0 ** rng.uniform(-12, 2, size=2) * (rng.random(2) < 0.9)
        S, S_rate = np.array([[s]]), np.array([[s_rate]])
        F = solve_stage(np.array([r]), np.array([w]), S, S_rate, one, BY_LAW, stops.law[None])[0]
        want = _brute(stops, r, w, s, s_rate) if stops.lower_bound > r or r > stops.upper_bound else 0.0
        assert math.isclose(abs(F), want, rel_tol=1e-12, abs_tol=1e-14)
        assert F * r <= 0.0 or F == 0.0


@pytest.mark.fast(12)
@pytest.mark.parametrize("seed", range(30))
def test_stage_equations_of_several_contacts(seed):
    rng = np.random.default_rng([seed, 6])
    m = int(rng.integers(2, 5))
    laws = np.array([stops_of(rng, LAWS[(seed + c) % 4]).law for c in range(m)])
    for _ in range(30):
        A = rng.normal(size=(m, m))
        S = A @ A.T * 10.0 ** rng.uniform(-8, 0)
        S_rate = S * 10.0 ** rng.uniform(-2, 3)
        r, w = rng.normal(size=m), rng.normal(size=m) * 10.0 ** rng.uniform(-2, 1)
        F = solve_stage(r, w, S, S_rate, np.zeros(m), BY_LAW, laws)
        assert np.all(np.isfinite(F))
        # Every contact alone, the others' forces given, is solved by its own bisection.
        for c in range(m):
            others = F * (np.arange(m) != c)
            kappa, g1, g2, p, damping, lam = laws[c]
            numbers = {"stiffness": kappa, "exponent": p, "damping": damping, "dissipation": lam}
            stops = sb.Stops(g1 if np.isfinite(g1) else None, g2 if np.isfinite(g2) else None, **numbers)
            rc, wc = r[c] + S[c] @ others, w[c] + S_rate[c] @ others
            want = _brute(stops, rc, wc, S[c, c], S_rate[c, c]) if not g1 <= rc <= g2 else 0.0
            scale = abs(want) + np.abs(S[c]) @ np.abs(F) / S[c, c]
            assert abs(abs(F[c]) - want) <= 1e-9 * scale
