"""Rigid stops from impact to impact: known answers, chatter, sticking, and solvers that share no code."""

from __future__ import annotations

import numpy as np
import pytest
from law_systems import rigid_system
from rigid_loops import chain as rigid_chain
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references.exact.motion import Solver
from stiffbeam.references.horizon import PERTURBATION

INF = float("inf")


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1.0])
def test_impacts_are_on_their_stop_but_for_the_rounding_of_time(gap):
    """On a stop at zero every impact is at zero: nothing but time says how large the rounding is."""
    stops = sb.Stops(lower=-gap, stiffness=INF, restitution=0.5)
    run = sb.reference(one_mass(10.0, stops, load=sb.Harmonic(5.0, 3.0)), 100.0)
    assert run.horizon == 100.0
    assert run.impacts.count > 40


@pytest.mark.parametrize("seed", [35, 47, 97, 126])
def test_an_output_at_an_impact_has_the_state_behind_it(seed):
    """Its time was rounded otherwise than that of the impact: the state was before the blow, whose loss was counted."""
    one = rigid_system(seed)
    times = sb.reference(one, 3.0).impacts.times
    found = sb.reference(one, 3.0, t_eval=[0.0, *times, 3.0])
    assert np.array_equal(found.impacts.times, times)
    after = found.at(np.nextafter(times, np.inf), 0)[1]
    np.testing.assert_allclose(found.contacts[0].velocity[1:-1], after, atol=1e-9)


@pytest.mark.parametrize(("speed", "horizon"), [(4.0, 0.5), (4.0 - 1e-11, 0.9), (4.0 + 1e-11, 0.9)])
def test_where_rounding_decides_whether_a_stop_is_hit_the_horizon_ends(speed, horizon):
    """u = v t - 4 t^2 rises to v^2/16, the stop is at 1."""
    stops = sb.Stops(upper=1.0, stiffness=np.inf, restitution=0.5)
    ball = one_mass(0.0, stops, load=sb.Constant(-8.0), v=speed)
    found = sb.reference(ball, 0.9, t_eval=np.linspace(0.0, 0.9, 10))
    assert found.horizon == pytest.approx(horizon, abs=1e-6)
    assert found.impacts.count == (speed > 4.0)


@pytest.mark.parametrize("form", ["a sum", "two loads"])
def test_a_perturbed_copy_loses_the_rounding_of_loads_that_cancel(form):
    """What a sum of 1e6 and -1e6 loses is relative to 1e6."""
    f, against = sb.Harmonic(1e6, 5.0, 0.3), sb.Harmonic(-1e6, 5.0, 0.3)
    loads = [([1.0], sb.Superposition(f, against))] if form == "a sum" else [([1.0], f), ([1.0], against)]
    stops = sb.Stops(upper=1.0, stiffness=np.inf, restitution=0.5)
    system = sb.System.from_matrices([[1.0]], [[1.0]], None, loads, [sb.Contact([1.0], stops)])
    copies = [Solver(system).perturbed(PERTURBATION, seed).solve(1.0) for seed in range(8)]
    assert 1e6 * np.finfo(float).eps < max(abs(float(x.states(np.ones(1))[0][0, 0])) for x in copies) < 1e-8


def test_a_beam_that_is_held_everywhere_on_its_stops_has_the_whole_horizon():
    """Its positions are rounding, which is nothing beside what its stops withhold."""
    stops = [sb.Stops(lower=0.0, stiffness=INF, restitution=0.5, position=x) for x in np.linspace(0.1, 1.0, 10)]
    load = sb.DistributedLoad(lambda x: -1.0 + 0.0 * x, sb.Harmonic(5.0, 3.0))
    found = sb.reference(sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=stops, loads=(load,)), 10), 0.01)
    assert found.horizon == 0.01


RIGID = {"upper": 0.1, "stiffness": INF}
SOFT, LAWLESS = (one_mass(1.0, sb.Stops(**x)) for x in ({"upper": 0.1, "stiffness": 5.0}, RIGID))
GIVEN, BEYOND = (one_mass(1.0, sb.Stops(**RIGID, restitution=0.5), q=q) for q in (0.0, 0.2))
REFUSED = r"be finite for .*, which has no impact law, got inf: use MoreauJean\(\), PaoliSchatzman\(\), .* large"


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: sb.reference(BEYOND, 1.0), "between"),
        (lambda: sb.integrate(BEYOND, sb.MoreauJean(), 0.01, 1.0), "between"),
        (lambda: sb.integrate(GIVEN, sb.ContactStabilisedNewmark(), 0.01, 1.0), "restitution must be left out"),
        (lambda: sb.integrate(rigid_chain(1)[0], sb.ExponentialFlow(), 0.01, 1.0, "conserving"), REFUSED),
        (lambda: sb.integrate(LAWLESS, sb.HHT(), 0.01, 1.0, "extrapolated"), REFUSED),
        (lambda: sb.integrate(LAWLESS, sb.MoreauJean(), 0.01, 1.0, "extrapolated"), "contact must be 'implicit'"),
        (lambda: sb.integrate_ensemble(GIVEN, sb.MoreauJean(), 0.01, 1.0, [SOFT]), "be inf for MoreauJean"),
        (lambda: sb.integrate_ensemble(SOFT, sb.BDF2(), 0.01, 1.0, [LAWLESS]), REFUSED),
    ],
)
def test_what_is_refused(call, named):
    with pytest.raises(sb.InputError, match=named):
        call()
