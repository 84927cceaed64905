"""The Taylor reference: against the exact solution, closed forms, and SciPy on random systems with every law."""

from __future__ import annotations

import sys

import mpmath
import numpy as np
import pytest
from law_systems import Witness, random_system
from systems import one_mass, two_contacts

import stiffbeam as sb
from stiffbeam.references import solve

heyoka = pytest.importorskip("heyoka")
from stiffbeam.references.adaptive import heyoka as taylor  # noqa: E402

SAMPLES = np.linspace(0.0, 0.1, 401)


def oscillator(depth=0.5, **law):
    """u = sin t under a stop at 1 - depth."""
    stops = sb.Stops(upper=1.0 - depth, **{"stiffness": 50.0} | law)
    return sb.System.from_matrices([[1.0]], [[1.0]], contacts=[sb.Contact([1.0], stops)], initial_velocity=[1.0])


def test_table_10_to_twelve_digits(table10_system):
    """Rounding grows a thousandfold over ten impacts; the exact solution is held to many digits elsewhere."""
    exact = solve(table10_system, 0.1, "exact", SAMPLES, 0.0, None)
    run = solve(table10_system, 0.1, "heyoka", SAMPLES, 1e-12, None)
    scale = np.max(np.abs(exact.tip))
    assert np.max(np.abs(run.tip - exact.tip)) < 5e-12 * scale
    assert np.max(np.abs(run.tip_velocity - exact.tip_velocity)) < 5e-11 * np.max(np.abs(exact.tip_velocity))
    assert list(run.impacts.stops) == list(exact.impacts.stops)
    assert run.impacts.times == pytest.approx(exact.impacts.times, abs=1e-12)
    assert run.impacts.ends == pytest.approx(exact.impacts.ends, abs=1e-12)
    assert run.impacts.peaks == pytest.approx(exact.impacts.peaks, rel=1e-9)
    assert run.impacts.impulses == pytest.approx(exact.impacts.impulses, rel=1e-9)
    assert np.max(np.abs(run.energy.loss)) < 1e-11 * np.max(run.energy.energy)
    assert run.provenance["heyoka"] == heyoka.__version__


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("depth", [1e-8, 1e-12, 1e-14])
def test_both_crossings_of_a_graze(depth, exponent):
    """A time is known to rounding of the gap over the speed; a contact is kappa/12 length^3 shorter than the arc."""
    run = solve(oscillator(depth, exponent=exponent), 4.0, "heyoka", None, 1e-12, None)
    with mpmath.workdps(40):
        entry = mpmath.asin(mpmath.mpf(1.0 - depth))
        entry, leaving = float(entry), float(mpmath.pi - entry)
    known_to = 4.0 * np.finfo(float).eps / np.sqrt(2.0 * depth) + 5.0 * (leaving - entry) ** 3
    assert run.impacts.count == 1
    assert run.impacts.times[0] == pytest.approx(entry, abs=known_to)
    assert run.impacts.ends[0] == pytest.approx(leaving, abs=known_to)


@pytest.mark.parametrize("name", ["hertz", "hunt-crossley", "kelvin-voigt"])
def test_laws_with_closed_forms_to_thirteen_digits(name):
    known = sb.problem(name)
    run = solve(known.system, known.t_end, "heyoka", np.append(0.0, known.times), 1e-13, None)
    answers = {what: answer.value for what, answer in known.answers.items()}
    assert run.tip[1:] == pytest.approx(answers["tip"], abs=2e-15 * np.max(np.abs(answers["tip"])) + 2e-16)
    assert run.tip_velocity[1:] == pytest.approx(answers["tip_velocity"], abs=1e-13)
    assert run.impacts.times == pytest.approx(answers["impacts"], rel=1e-14)
    assert run.impacts.ends == pytest.approx(answers["releases"], rel=1e-13)
    assert run.contacts[0].peak_force == pytest.approx(answers["peak_force"], rel=1e-13)


@pytest.mark.parametrize("seed", range(24))
@pytest.mark.fast(3, slow=5)
def test_random_systems_with_every_law_against_scipy(seed):
    """SciPy's solver and events in the oracle: no line in common. Its tolerance is 1e-12, times what errors grow by."""
    system, times = random_system(seed), np.linspace(0.0, 3.0, 31)
    fractional = [c.stops for c in system.contacts if c.stops.exponent not in (1.0, 1.5, 2.0)]
    if fractional or any(c.stops.jumps and c.stops.exponent == 1.5 for c in system.contacts):
        with pytest.raises(sb.InputError, match=r"stops.(exponent|damping) must .*cvode"):
            solve(system, 3.0, "heyoka", times, 1e-11, None)
        return
    tip, switches = Witness(system).solve(times)
    run = solve(system, 3.0, "heyoka", times, 1e-11, None)
    point = run.states[0] @ system.contacts[0].row
    assert np.max(np.abs(point - tip)) < 1e-8 * np.max(np.abs(tip))
    assert run.work.counters["restarts"] == switches


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_recorded_loads_and_a_recorded_motion_of_the_stop(kind):
    t = np.linspace(0.0, 3.0, 19)
    load, motion = sb.Sampled(t, 15.0 * np.sin(4.0 * t), kind), sb.Sampled(t, 0.05 * np.sin(3.0 * t), kind)
    system = two_contacts(load=sb.Superposition(load, sb.Harmonic(1.0, 9.0), sb.Constant(0.3)), offset=motion)
    times = np.linspace(0.0, 3.0, 101)
    exact, run = (solve(system, 3.0, method, times, 1e-12, None) for method in ("exact", "heyoka"))
    assert exact.impacts.count > 2
    for contact, other in zip(run.contacts, exact.contacts, strict=True):
        assert np.max(np.abs(contact.position - other.position)) < 1e-10
        assert contact.impacts.times == pytest.approx(other.impacts.times, abs=1e-10)
    assert np.max(np.abs(run.energy.input - exact.energy.input)) < 1e-10 * np.max(exact.energy.energy)


def test_an_entry_right_after_a_release_is_found():
    """Two zeros of a gap in one step, the first at its start: heyoka itself would lose the second."""
    system = sb.problem("table14").system
    exact, run = (solve(system, 0.008, method, None, 1e-12, None) for method in ("exact", "heyoka"))
    assert run.impacts.count == exact.impacts.count == 3
    assert run.impacts.times == pytest.approx(exact.impacts.times, rel=1e-11)


def test_stops_that_close_at_the_same_time():
    """Both masses of this problem meet their stops at the same moment."""
    known = sb.problem("two-stops-at-once")
    run = solve(known.system, known.t_end, "heyoka", np.append(0.0, known.times), 1e-12, None)
    for contact in run.contacts:
        assert contact.impacts.times == pytest.approx(known.answers["impacts"].value, abs=1e-12)


def test_systems_of_one_shape_share_a_program():
    for upper, exponent, compiling in ((0.5, 1.5, True), (0.4, 1.5, False), (0.4, 1.25, True)):
        before = set(taylor._PROGRAMS)
        run = solve(oscillator(1.0 - upper, exponent=exponent), 2.0, "heyoka", None, 3e-9, None)
        assert run.impacts.count == 1
        assert (set(taylor._PROGRAMS) > before) == compiling
        assert ("compile_seconds" in run.provenance) == compiling


def test_a_system_without_contacts():
    load = [([0.0, 1.0], sb.Harmonic(2.0, 3.0))]
    stiffness = [[20.0, -10.0], [-10.0, 10.0]]
    system = sb.System.from_matrices(np.eye(2), stiffness, 0.01 * np.eye(2), loads=load, observe=[0.0, 1.0])
    exact, run = (solve(system, 5.0, method, None, 1e-12, None) for method in ("exact", "heyoka"))
    assert np.max(np.abs(run.tip - exact.tip)) < 1e-12
    assert np.max(np.abs(run.energy.viscous - exact.energy.viscous)) < 1e-12


def test_the_horizon_and_other_units():
    """A motion a million times smaller and a thousand times faster takes the same steps."""
    runs = []
    for L, T in ((1.0, 1.0), (1e-6, 1e-3)):
        stops = sb.Stops(upper=0.5 * L, stiffness=50.0 / T**2 / np.sqrt(L), exponent=1.5, dissipation=0.2 * T / L)
        system = one_mass(1.0 / T**2, stops, v=L / T)
        runs.append(sb.reference(system, 10.0 * T, "heyoka"))
    large, small = runs
    assert large.horizon == 10.0
    assert small.horizon == pytest.approx(1e-2)
    assert large.impacts.count == small.impacts.count == 2
    assert 1e6 * small.tip == pytest.approx(large.tip, abs=1e-9)
    assert small.work.counters["steps"] == pytest.approx(large.work.counters["steps"], rel=0.05)


def refused(match, system, **options):
    with pytest.raises(sb.InputError, match=match):
        sb.reference(system, 1.0, "heyoka", **options)


def test_refusals_name_rule_value_and_remedy():
    refused("stops.exponent must be a ratio of whole numbers.*1.2345.*cvode-adams", oscillator(exponent=1.2345))
    refused(
        "stops.damping must be 0 beside the exponent 1.5.*got 0.1.*dissipation", oscillator(exponent=1.5, damping=0.1)
    )
    refused("switches must be 'restart'.*'through'.*cvode", oscillator(), switches="through")
    rigid = oscillator(stiffness=np.inf, restitution=0.8)
    refused("stops.stiffness must be finite.*exact solution", rigid)
    refused(
        "time function must be made of Harmonic.*cvode",
        one_mass(1.0, load=lambda t: 0.0 * t),
    )


def test_a_law_with_a_term_that_the_series_lacks_is_refused(monkeypatch):
    monkeypatch.setattr(taylor, "pressure", lambda d, rate, law: law.kappa * (d + 0.1 * d**2))
    refused("stops must have a law that heyoka spells out.*cvode", oscillator())


def test_what_a_series_cannot_begin_with_fails_with_a_remedy():
    resting = one_mass(1.0, sb.Stops(upper=0.5, stiffness=50.0, exponent=1.5), load=sb.Constant(2.0), q=0.5)
    with pytest.raises(sb.SolverFailure, match=r"at rest on a stop with exponent 1.5.*cvode-adams"):
        solve(resting, 1.0, "heyoka", None, 1e-10, None)
    contacts = [sb.Contact(row, sb.Stops(upper=0.5, stiffness=50.0, exponent=1.5)) for row in np.eye(2)]
    twins = sb.System.from_matrices(np.eye(2), np.eye(2), contacts=contacts, initial_velocity=[1.0, 1.0])
    with pytest.raises(sb.SolverFailure, match=r"two stops with fractional exponents close.*cvode-adams"):
        solve(twins, 1.0, "heyoka", None, 1e-10, None)


def test_without_heyoka_one_line_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "heyoka", None)
    refused(r"method must have its library heyoka installed.*pip install 'stiffbeam\[heyoka\]'", oscillator())
