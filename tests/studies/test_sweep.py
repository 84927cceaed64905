"""Sweeps: the section against closed forms, every parameter against a system built by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.studies import study
from stiffbeam.studies.sweep import repeats_after, sections

SHORT = {"periods": 3, "transient": 2}
TABLE10 = sb.paper_case(10)
# Without stops, smooth and damped, so that the start is forgotten to rounding within the transient.
VISCOUS = sb.BeamProblem(stiffness=300.0, viscosity=3.0, base=sb.Harmonic(0.2, 10.0, phase=0.3))
LINEAR = replace(TABLE10, problem=VISCOUS, cells=8, dt=1e-3, t_end=1.0, runs=((sb.Trapezoidal(), "displacement"),))


def steady_tip(problem: sb.BeamProblem, rate) -> float:
    """u(1, 0) of the steady motion: (s^2 M + s C + K) q = p, s the factor that stands for d/dt."""
    system = sb.semidiscretise(problem, LINEAR.cells)
    force = sum(p * f.amplitude * np.exp(1j * f.phase) for p, f in system.loads)  # Im of it at t = 0
    s = rate(problem.base.frequency)
    return float(np.linalg.solve(s**2 * system.mass + s * system.damping + system.stiffness, force)[-1].imag)


def frequency_steps(frequency: float, dt: float) -> float:
    """The step nearest to dt that divides the period."""
    period = 2.0 * np.pi / frequency
    return period / round(period / dt)


def test_the_section_of_a_linear_motion_is_the_closed_form():
    """Exact: s = i a. Trapezoidal rule: its steady motion is exactly that of s = (2 i/dt) tan(a dt/2)."""
    values = [7.0, 10.0, 13.7]
    exact = sections(study("sweep", LINEAR, method="exact", values=values, periods=4, transient=12).found, "frequency")
    rule = sections(study("sweep", LINEAR, values=values, dt=5e-3, periods=4, transient=12).found, "frequency")
    assert list(exact) == list(rule) == values
    for a in values:
        problem = replace(LINEAR.problem, base=sb.Harmonic(0.2, a, phase=0.3))
        dt = frequency_steps(a, 5e-3)
        assert np.allclose(exact[a], steady_tip(problem, lambda a: 1j * a), rtol=1e-8, atol=0.0)
        assert np.allclose(rule[a], steady_tip(problem, lambda a, dt=dt: 2j / dt * np.tan(a * dt / 2)), rtol=1e-8)
        assert repeats_after(rule[a], 0.2) == 1
        assert abs(rule[a][0] / exact[a][0] - 1.0) > 1e-6, "the two closed forms must not be one"


def by_hand(parameter: str, value: float) -> tuple[sb.System, float]:
    """Table 10 with one parameter changed, built from the constructors."""
    stiffness, gap, kappa, base, viscosity = 300.0, 0.1, 5e6, {"amplitude": 0.2, "frequency": 10.0}, 0.0
    if parameter in base:
        base[parameter] = value
    stiffness = value if parameter == "stiffness" else stiffness
    viscosity = value if parameter == "viscosity" else viscosity
    gap = value if parameter == "clearance" else gap
    kappa = value if parameter == "stops.stiffness" else kappa
    problem = sb.BeamProblem(
        stiffness=stiffness, viscosity=viscosity, stops=sb.Stops(-gap, gap, stiffness=kappa), base=sb.Harmonic(**base)
    )
    return sb.semidiscretise(problem, 25), frequency_steps(base["frequency"], 2e-4)


RANGES = {
    "frequency": [8.5, 11.0], "amplitude": [0.15, 0.3], "clearance": [0.05, 0.12], "stops.stiffness": [1e6, 2e7],
    "stiffness": [200.0, 400.0], "viscosity": [0.0, 0.02],
}  # fmt: skip


@pytest.mark.parametrize("parameter", RANGES)
def test_a_parameter_does_what_it_does_to_a_system_built_by_hand(parameter):
    """To the bit, through the chaos."""
    scheme = sb.HHT(-0.1)
    records = study("sweep", TABLE10, parameter=parameter, values=RANGES[parameter], method=scheme, dt=2e-4, **SHORT)
    for value in RANGES[parameter]:
        system, dt = by_hand(parameter, value)
        period = 2.0 * np.pi / system.problem.base.frequency
        run = sb.integrate(system, scheme, dt, 5 * period)
        per_period = round(period / dt)
        own = [r for r in records.table.to_dict("records") if r[parameter] == value]
        assert [r["tip"] for r in own if r["kind"] == "section"] == run.tip[3 * per_period :: per_period].tolist()
        seen = next(r for r in own if r["kind"] == "contact")
        late = run.contact_force[2 * per_period + 1 :]
        assert seen["count"] == np.sum(run.impacts.times > 2 * period) > 0
        assert seen["fraction"] == np.mean(late != 0.0)
        assert seen["peak_force"] == np.max(np.abs(late))


def test_what_repeats_itself():
    chaos = np.random.default_rng(1).uniform(-1.0, 1.0, 40)
    assert repeats_after(np.full(40, 0.3), 1.0) == 1
    assert repeats_after(np.tile([0.3, -0.2, 0.1], 14), 1.0) == 3
    assert repeats_after(np.tile([0.3, 0.3004], 14), 1.0) == 1
    assert repeats_after(chaos, 1.0) == 0
    assert repeats_after(chaos[:5], 1.0) is None  # too short to tell


def test_a_value_that_overflows_is_a_row_and_the_others_stand():
    """The extrapolated contact overflows on stiff stops (Table 11 with a coarse step)."""
    case = sb.paper_case(11)
    records = study(
        "sweep", case, parameter="stops.stiffness", values=[1e4, 2e7], contact="extrapolated", dt=2.5e-4, **SHORT
    )
    assert records.table["stops.stiffness"][records.table.lost.notna()].tolist() == [2e7]
    assert "overflowed" in next(iter(records.lost))
    assert "stops.stiffness 10000 to 10000" in str(records)


BAD = {
    "amplitdue": ({"parameter": "amplitdue", "values": [0.0]}, "did you mean amplitude"),
    "of a scheme": ({"parameter": "alpha", "values": [0.3]}, "be a path to a number of the system"),
    "no values": ({"parameter": "amplitude"}, "be given for amplitude"),
    "none": ({"values": []}, "be given for frequency"),
    "negative": ({"values": [9.0, -1.0]}, "frequency must lie in"),
    "not a number": ({"values": [float("nan"), 9.0]}, "finite"),
    "clearance": ({"parameter": "clearance", "values": [0.0, 0.1]}, "clearance must be > 0"),
    "coarse": ({"values": [9.0], "dt": 0.5}, "half a period"),
    "periods": ({"values": [9.0], "periods": 0}, "periods must be an integer >= 1"),
    "jobs": ({"values": [9.0], "jobs": 0}, "jobs must be an integer >= 1"),
    "scheme": ({"values": [9.0], "method": "htt"}, "did you mean HHT"),
}


@pytest.mark.parametrize("bad", BAD)
def test_bad_input_is_refused_before_anything_runs(bad):
    options, message = BAD[bad]
    with pytest.raises(sb.InputError, match=message):
        study("sweep", TABLE10, **options)


def test_a_case_without_a_drive_has_no_frequency_to_vary():
    still = replace(TABLE10, problem=replace(TABLE10.problem, base=None))
    with pytest.raises(sb.InputError, match=r"be given for frequency.*a case without a period"):
        study("sweep", still)
    with pytest.raises(sb.InputError, match="case with stops"):
        study("sweep", LINEAR, parameter="clearance", values=[0.1])


def dropped(height: float) -> sb.System:
    """A mass that falls onto a damped stop."""
    return one_mass(0.0, sb.Stops(lower=0.0, stiffness=2e3, damping=20.0), mass=1.5, load=sb.Constant(-14.7), q=height)


@pytest.mark.parametrize("method", ["exact", "BDF2"])
def test_a_drop_without_a_drive_is_swept_from_its_start_to_its_end(method):
    """The largest force over heights of fall, against single exact solutions."""
    heights = [0.1, 0.2, 0.3]
    records = sb.study("sweep", dropped(0.1), dt=1e-4, t_end=1.0, parameter="q0[0]", values=heights, method=method)
    assert [row["q0[0]"] for row in records.table.to_dict("records")] == heights
    for row in records.table.to_dict("records"):
        exact = sb.reference(dropped(row["q0[0]"]), 1.0)
        assert row["count"] == exact.impacts.count
        assert row["peak_force"] == pytest.approx(exact.contacts[0].peak_force, rel=1e-7 if method == "exact" else 1e-2)
    assert "Single runs, t = 0 to 1" in str(records)


def test_the_period_of_a_motion_is_that_of_its_size():
    """With its stop at 0 a mass moves in proportion to the load, so that its period is the same at all amplitudes."""
    stops = sb.Stops(upper=0.0, stiffness=25.0)
    system = one_mass(1.0, stops, damping=0.1, load=sb.Harmonic(amplitude=1.0, frequency=2.8))
    options = {"method": "exact", "periods": 12, "transient": 80, "dt": 1e-2, "t_end": 1.0}
    answer = study("sweep", system, parameter="amplitude", values=[0.0, 1e-4, 1.0], **options).answer
    assert "every period of the drive at 1 of 3 values, every 2 to 8 periods at 2" in answer.verdict


def test_a_sweep_of_a_hertz_stop_asks_for_a_scheme():
    """Not for a field of the ensemble beneath it, at every value anew."""
    options = {"values": [2.5, 3.5], "method": "exact", "periods": 3, "dt": 1e-2, "t_end": 1.0}
    stops = sb.Stops(upper=0.5, stiffness=9.0, exponent=1.5)
    hertz = one_mass(1.0, stops, damping=0.5, load=sb.Harmonic(1.0, 2.6))
    with pytest.raises(sb.InputError, match="name a scheme as method, or transient=0"):
        study("sweep", hertz, transient=2, **options)
    assert study("sweep", hertz, transient=0, **options).answer.verdict.startswith("exact over frequency")
