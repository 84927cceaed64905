"""Numbers that the literature on impacts knows, each to 1e-12 by a reference, printed here with all their digits.

Those that other tests ask:
    Kelvin-Voigt restitution                             test_damped_stops
    Hunt-Crossley restitution, Hertz                     test_known_answers
    a ball's and a preloaded oscillator's last bounce    test_known_answers
    speed and phase of the rational orbit                test_known_answers
    nonsmooth modes of a chain and of the beam           test_known_answers
    the chain that sticks once a period                  test_known_answers
    bars on a wall, in rational numbers                  test_known_answers, test_rigid
    periods and contact times of a mass with a stop      test_known_answers
    cos l cosh l = -1                                    test_semidiscretisation
    tan l = tanh l                                       test_beams
    in 28 digits, against the files of problems          test_known_answers
"""

from __future__ import annotations

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb

INF = float("inf")


POWERS = [(1.0, np.pi), (1.5, 2.9432751843247047), (2.0, 2.8043642106509085), (3.0, 2.6220575542921198)]


@pytest.mark.parametrize(("p", "time"), POWERS)
def test_the_time_on_power_law_stops(p, time):
    """T v/d, d = ((p + 1) m v^2/(2 kappa))^(1/(p + 1)) the depth; the largest force is kappa d^p."""
    depth = ((p + 1.0) / 2.0) ** (1.0 / (p + 1.0))
    run = sb.reference(
        one_mass(0.0, sb.Stops(upper=0.0, stiffness=1.0, exponent=p), q=-0.01, v=1.0), 4.0, "dop853",
        t_eval=[0.0, 4.0], rtol=1e-13,
    )  # fmt: skip
    assert run.contacts[0].fraction * 4.0 == pytest.approx(time * depth, rel=1e-12)
    assert run.impacts.peaks[0] == pytest.approx(depth**p, rel=1e-12)


@pytest.mark.slow
def test_the_dissipation_that_delivers_a_restitution():
    known = {
        0.95: 0.078926605287415231, 0.9: 0.16648195068530811, 0.7: 0.63482828126641674, 0.5: 1.4327505332713750,
        0.3: 3.0870819811296242, 0.1: 9.9981593974956678,
    }  # fmt: skip
    for e, lam in known.items():
        stops = sb.Stops(upper=0.0, stiffness=1.0, exponent=1.5, dissipation=lam)
        run = sb.reference(one_mass(0.0, stops, q=-0.01, v=1.0), 60.0, "dop853", t_eval=[0.0, 60.0], rtol=1e-13)
        assert run.tip_velocity[-1] == pytest.approx(-e, abs=1e-12)


@pytest.mark.parametrize(
    ("w", "V", "t0", "multipliers"),
    [
        (2.8, 0.3361772699756701192, 1.0926345564090809343, (-2.9580950669935995, -0.21635545359617233)),
        (2.0, 20.0 / 3.0, np.pi / 4.0, (0.8, 0.8)),
    ],
)
def test_the_multipliers_of_the_impact_oscillator(w, V, t0, multipliers):
    """x'' + x = cos(w t), x <= 0, e = 0.8, from half a period after the impact at t0."""
    e, T, wall = 0.8, 2.0 * np.pi / w, sb.Stops(upper=0.0, stiffness=INF, restitution=0.8)
    one, later = (
        one_mass(1.0, wall, load=sb.Harmonic(1.0, w, w * t + 0.5 * np.pi), v=-e * V) for t in (t0, t0 + T / 2)
    )
    start = [x[-1] for x in sb.reference(one, T / 2).states]
    orbit = sb.periodic_orbit(later, T, (start[0] + 1e-3, start[1]))
    assert np.allclose([orbit.q, orbit.v], start, rtol=1e-11)
    assert np.allclose(orbit.events, [0.5 * T], rtol=1e-12)
    assert orbit.stable == (np.max(np.abs(multipliers)) < 1.0)
    assert orbit.closure < 1e-13
    assert np.sum(orbit.multipliers) == pytest.approx(sum(multipliers), rel=1e-12)
    assert np.prod(orbit.multipliers) == pytest.approx(e * e, rel=1e-12)


@pytest.mark.parametrize(
    ("w", "zeta", "largest"),
    [(2.8, 0.0, 0.14619883040935673), (0.8, 0.05, 2.71163072273320215), (2.5, 0.01, 0.19046755268780537)],
)
def test_where_a_driven_mass_just_touches_a_stop(w, zeta, largest):
    """The steady answer to cos(w t): a stop at 1 - 1e-12 of its amplitude is hit, one at 1 + 1e-12 is not."""
    answer = 1.0 / complex(1.0 - w * w, 2.0 * zeta * w)  # x = Re answer exp(i w t)
    T, start = 2.0 * np.pi / w, {"q": answer.real, "v": -w * answer.imag}
    for off in (-1e-12, 1e-12):
        stops = sb.Stops(upper=largest * (1.0 + off), stiffness=1e-3)
        driven = one_mass(1.0, stops, load=sb.Harmonic(1.0, w, 0.5 * np.pi), damping=2.0 * zeta, **start)
        assert bool(sb.reference(driven, 2.1 * T).impacts.count) == (off < 0.0)
