"""The equations of a node under any law: bisection, and nodes that a jump of the force holds on the stop."""

from __future__ import annotations

import numpy as np
import plain_march
import pytest
from law_systems import LAWS, stops_of
from systems import one_mass

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.kernels.march import BY_LAW, solve_stage

# ------------------------------------------------------------------ the equations of a node


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


# ------------------------------------------------------------------ nodes that a jump of the force holds on the stop


def mass(v: float = 3.0) -> sb.System:
    return one_mass(1.0, sb.Stops(None, 0.5, stiffness=1000.0, damping=200.0), load=sb.Constant(2.0), v=v)


class Lagging(sb.Scheme):
    """The exact flow that takes the force at t_n from the state there, after its node has let go of it."""

    name = "lagging"
    order = 2
    nodes = (0.0, 1.0)

    def step(self, equation, dt, z, loads, reactions):
        y = equation.flow(dt, z, *(load + reaction for load, reaction in zip(loads, reactions, strict=True)))
        return y, [z, y]


def test_a_scheme_whose_node_no_force_moves_is_refused():
    with pytest.raises(InputError, match="whose force jumps"):
        sb.integrate(mass(), Lagging(), 1e-3, 0.1)


def coupled(seed: int, on_the_stop: bool, n: int = 5) -> sb.System:
    """A chain with a Kelvin-Voigt stop, which starts on it to an ulp or comes to be held there."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(n, n)))
    stiffness = turn @ np.diag(rng.uniform(3.0, 60.0, n) ** 2) @ turn.T
    row = rng.normal(size=n)
    start = row / (row @ row) * 0.3 if on_the_stop else np.zeros(n)
    stop = float(row @ start) if on_the_stop else rng.uniform(0.05, 0.2)
    return sb.System.from_matrices(
        np.eye(n), 0.5 * (stiffness + stiffness.T), initial_displacement=start,
        contacts=[sb.Contact(row, sb.Stops(None, stop, stiffness=1e3, damping=200.0))],
        initial_velocity=row / (row @ row) if on_the_stop else rng.normal(size=n) * 3.0,
    )  # fmt: skip


@pytest.mark.parametrize("on_the_stop", [True, False])
def test_the_march_is_the_plain_loop_where_rounding_would_tell_the_side(on_the_stop):
    """Forces of the nodes, as long as the motions are the same."""
    compared = 0
    for seed in range(20):
        system = coupled(seed, on_the_stop)
        run = sb.integrate(system, sb.Trapezoidal(), 0.02, 0.6)
        q, _, F = plain_march.states(system, sb.Trapezoidal(), 0.02, 30)
        if np.max(np.abs(run.states[0] - q)) > 1e-9:  # a graze
            continue
        assert np.allclose(run.contacts[0].force[1:], F[:, 0], rtol=1e-6, atol=1e-6)
        pressed = F[:, 0] != 0.0
        assert run.contacts[0].fraction == np.mean(pressed)
        compared += 1
    assert compared > 8
