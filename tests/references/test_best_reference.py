"""The best reference of a system and the schemes that fit its stops, as every study and command takes them; damping
that couples the modes in what needs a frequency."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from every_system import BENCHES
from scipy.special import gamma
from systems import one_mass

import stiffbeam as sb
from stiffbeam.files.cases import case_of, default_schemes
from stiffbeam.measures.amplification import free_mode_errors
from stiffbeam.measures.frequencies import smooth_motion, steady_state
from stiffbeam.references import best_reference, substitute
from stiffbeam.references.adaptive import sundials
from stiffbeam.studies.base import chosen


def hertz(v: float = 1.0) -> sb.System:
    """A mass on a soft spring that meets a stop of Hertz's law."""
    return one_mass(1e-6, sb.Stops(upper=0.1, stiffness=1e4, exponent=1.5), v=v)


def test_a_power_law_has_an_adaptive_reference_and_hertz_closed_form():
    """A free mass at speed v goes to depth (5 m v^2/(4 kappa))^(2/5) and is back after 2.94 depth/v; exactly
    sqrt(pi) Gamma(2/5)/Gamma(9/10) 4/5."""
    found = best_reference(hertz(), 0.3)
    assert found.provenance["method"] == "cvode-adams"
    assert found.horizon == 0.3
    depth = (1.25 / 1e4) ** 0.4
    duration = 0.8 * np.sqrt(np.pi) * gamma(0.4) / gamma(0.9) * depth
    (impact,) = zip(found.impacts.times, found.impacts.durations, found.impacts.peaks, strict=True)
    assert impact == pytest.approx((0.1, duration, 1e4 * depth**1.5), rel=1e-7)
    assert "cvode-adams" in substitute(hertz(), 0.3)


def test_a_linear_system_has_the_exact_one():
    system, _, t_end = BENCHES["two bodies with a dashpot between"]
    assert best_reference(system, t_end).provenance["method"] == "exact"
    assert substitute(system, t_end) == ""


def test_what_no_method_takes_is_refused_with_the_reason_of_the_exact_solution():
    with pytest.raises(sb.InputError, match=r"stops\.restitution"):
        best_reference(one_mass(1e-6, sb.Stops(upper=0.1, stiffness=np.inf), v=1.0), 0.3)


def test_without_sundials_the_next_method_answers(monkeypatch):
    monkeypatch.setattr(sundials, "VERSION", 0)
    sundials.library_of.cache_clear()
    assert best_reference(hertz(), 0.3).provenance["method"] == "dop853"


def test_members_without_an_exact_solution_are_their_solo_runs():
    members = [hertz(), hertz(1.1)]
    many = sb.reference_ensemble(members[0], 0.3, members, np.linspace(0.0, 0.3, 7))
    for i, member in enumerate(members):
        solo = best_reference(member, 0.3, np.linspace(0.0, 0.3, 7))
        np.testing.assert_allclose(many.tip[i], solo.tip, atol=1e-12)
        assert many.contacts[0].impact_count[i] == solo.impacts.count == 1


def test_schemes_by_default_have_a_law_for_the_stops():
    system, dt, t_end = BENCHES["coupled oscillator, rigid"]
    labels = chosen(case_of(system, dt, t_end))
    assert {label.partition("(")[0] for label in labels} == {
        "MoreauJean",
        "PaoliSchatzman",
        "NonsmoothGeneralisedAlpha",
    }
    assert str(default_schemes([sb.Stops(upper=0.0, stiffness=1.0)])[0]) == "BDF2"
    plain = case_of(*BENCHES["chain"])
    assert not {label.partition("(")[0] for label in chosen(plain)} & set(sb.schemes.RIGID)


def test_the_steady_motion_solves_the_equation_under_coupled_damping():
    """K q + C q' + M q'' is the load at any time, for a drive at two frequencies and a constant one."""
    system, _, _ = BENCHES["two bodies with a dashpot between"]
    loads = [*system.loads, ([0.0, 1.0], sb.Harmonic(3.0, 8.1, 0.4)), ([0.5, 1.0], sb.Constant(2.0))]
    system = sb.System.from_matrices(system.mass, system.stiffness, system.damping, loads, observe=[1.0, 0.0])
    y, w = steady_state(system), np.array(system.drive.frequencies)
    for t in (0.0, 0.37, 2.9):
        s, c = np.sin(w * t), np.cos(w * t)
        force = sum(np.asarray(p) * float(f.value(t)) for p, f in system.loads)
        q, v = y[0] + s @ y[1::2] + c @ y[2::2], (w * c) @ y[1::2] - (w * s) @ y[2::2]
        a = -(w * w * s) @ y[1::2] - (w * w * c) @ y[2::2]
        np.testing.assert_allclose(system.mass @ a + system.damping @ v + system.stiffness @ q, force, atol=1e-12)


def test_the_slow_motion_under_coupled_damping_is_the_lowest_complex_mode():
    """Its lowest mode alone: by the matrix exponential the state stays in a plane, here the first pair's."""
    system, _, _ = BENCHES["free oscillator with a dashpot, no stops"]
    slow = smooth_motion(system)
    n, inverse = system.size, np.linalg.inv(system.mass)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ system.stiffness, -inverse @ system.damping]])
    states = [scipy.linalg.expm(A * t) @ np.concatenate([slow.q0, slow.v0]) for t in np.linspace(0.0, 3.0, 9)]
    sizes = np.linalg.svd(np.array(states), compute_uv=False)
    assert sizes[2] < 1e-12 * sizes[0]
    slowest = np.min(np.abs(np.linalg.eigvals(A)))
    plane = np.linalg.lstsq(np.array(states[:-1]), np.array(states[1:]))[0]
    values = np.linalg.eigvals(plane)
    rate = np.max(np.abs(np.log(values[np.abs(values) > 1e-3]))) / (3.0 / 8.0)
    assert rate == pytest.approx(slowest, rel=1e-6)


@pytest.mark.parametrize("phase", [0.0, 0.5 * np.pi, 1.0])
@pytest.mark.parametrize("length", [1.0, 1e-3, 1e3])
def test_the_lowest_mode_of_the_slow_motion_has_the_size_of_the_steady_one(length, phase):
    """In any units, and whatever the phase of the drive: without damping the response to a sine begins at 0."""
    load = ([0.0, 1.0], sb.Harmonic(amplitude=length, frequency=0.7, phase=phase))
    stiffness = np.array([[2.0, -1.0], [-1.0, 2.0]])
    slow = smooth_motion(sb.System.from_matrices(np.eye(2), stiffness, loads=[load], observe=[1.0, 0.0]))
    steady = np.linalg.solve(stiffness - 0.49 * np.eye(2), [0.0, length])
    lowest = slow.q0 - steady * np.sin(phase)
    np.testing.assert_allclose(np.abs(lowest), np.max(np.abs(steady)), rtol=1e-12)


def test_modes_that_damping_couples_are_late_as_the_trapezoidal_rule_makes_them():
    """Each complex eigenvalue is multiplied by (1 + lambda dt/2)/(1 - lambda dt/2) a step, to rounding."""
    system, _, _ = BENCHES["free oscillator with a dashpot, no stops"]
    dt = 0.02
    found = free_mode_errors(sb.integrate(system, sb.Trapezoidal(), dt, 40.0))
    n, inverse = system.size, np.linalg.inv(system.mass)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ system.stiffness, -inverse @ system.damping]])
    exact = sorted((x for x in np.linalg.eigvals(A) if x.imag > 0.0), key=abs)
    stepped = [np.log((1.0 + x * dt / 2.0) / (1.0 - x * dt / 2.0)) / dt for x in exact]
    wanted = [x.imag / y.imag - 1.0 for x, y in zip(exact, stepped, strict=True)]
    np.testing.assert_allclose(found.period_elongation, wanted, atol=1e-9)
    np.testing.assert_allclose(found.damping_ratio, [-y.real / abs(y) for y in stepped], atol=1e-9)
