"""Schemes, solvers, anyone's functions and recorded runs through one door, each under a label of its own."""

from __future__ import annotations

import numpy as np
import pytest
from systems import pair

import stiffbeam as sb
from stiffbeam.files.cases import case_of
from stiffbeam.integrators import integrator, integrators
from stiffbeam.schemes.labels import user_source
from stiffbeam.studies.comparison import CaseComparison


def runge_kutta(system, dt, t_end):
    """The classical method of order 4."""
    ode, times = system.ode(), np.arange(round(t_end / dt) + 1) * dt
    states = [ode.y0]
    for t in times[:-1]:
        y = states[-1]
        k1 = ode.rhs(t, y)
        k2 = ode.rhs(t + dt / 2, y + dt / 2 * k1)
        k3 = ode.rhs(t + dt / 2, y + dt / 2 * k2)
        states.append(y + dt / 6 * (k1 + 2.0 * k2 + 2.0 * k3 + ode.rhs(t + dt, y + dt * k3)))
    states = np.array(states)
    return times, states[:, ::2], states[:, 1::2]


def recorded(system, dt, t_end, name="radau"):
    t, q, v = runge_kutta(system, dt, t_end)
    return sb.Trajectory.from_arrays(t, q, v, system, name)


def test_each_kind_has_a_label_of_its_own(tmp_path, monkeypatch):
    (tmp_path / "ext_kinds.py").write_text("def f(system, dt, t_end):\n    return None\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    runs = [recorded(pair(), dt, 0.1) for dt in (0.05, 0.025)]
    chosen = integrators(
        ["HHT(alpha=-0.1)", "radau", "ext_kinds:f", runge_kutta, *runs, lambda *_: None, lambda *_: None]
    )
    assert [x.kind for x in chosen] == ["scheme", "solver", "function", "function", "recorded", "function", "function"]
    labels = [x.label for x in chosen]
    named = ["HHT(alpha=-0.1)", "radau", "ext_kinds:f", "runge_kutta", "radau (recorded)", "<lambda>", "<lambda> (2)"]
    assert labels == named
    for other in (3, None, [], [3]):
        with pytest.raises(sb.InputError, match="integrator must be something that can be run"):
            integrator(other)
    with pytest.raises(sb.InputError, match="recorded runs must have one name"):
        integrator([runs[0], recorded(pair(), 0.05, 0.1, "other")])


def test_a_journal_sees_that_a_function_has_changed(tmp_path, monkeypatch):
    for name, factor in (("ext_one", 1.0), ("ext_two", 2.0)):
        (tmp_path / f"{name}.py").write_text(f"def f(system, dt, t_end):\n    return {factor}\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    one, two = user_source("ext_one:f"), user_source("ext_two:f")
    assert len(one) == len(two) == 64
    assert one != two
    assert one == user_source("ext_one:f")
    assert user_source("hht(alpha=-0.1)") == user_source("no_such_module:f") == ""


def test_compare_takes_functions_recorded_runs_and_solvers():
    """Runge and Kutta's method as a function and as arrays is one motion; the solver is a further reference."""

    def eighths(system, dt, t_end):  # at an impact the order of both methods is 2
        return tuple(x[::8] for x in runge_kutta(system, dt / 8, t_end))

    system, dt, t_end = pair(), 0.01, 0.6
    t, *states = eighths(system, dt, t_end)
    runs = ["trapezoidal", eighths, sb.Trajectory.from_arrays(t, *states, system=system, name="radau"),
            "cvode-adams"]  # fmt: skip
    result = CaseComparison(case_of(system, dt, t_end))
    list(result.run(runs, ["exact"]))
    assert not result.failures
    assert [x.provenance["method"] for x in result.references] == ["exact", "cvode-adams"]
    errors = {x.label: x.tip_error_rms for x in result.comparisons}
    names = integrator(eighths).label, "radau", "Trapezoidal"
    function, arrays, rule = (errors[f"{name}@matrices"] for name in names)
    assert function == arrays < 0.1 * rule
    assert {x.contacts[0].run.impacts for x in result.comparisons} == {result.references[0].impacts.count}


@pytest.mark.slow
def test_a_comparison_with_rigid_stops_asks_the_exact_solution_only():
    stops = sb.Stops(-0.1, 0.1, stiffness=float("inf"), restitution=0.5)
    beam = sb.BeamProblem(stiffness=300.0, stops=stops, base=sb.Harmonic(0.2, 10.0))
    case = case_of(sb.semidiscretise(beam, 6), 1e-4, 0.1)
    result = CaseComparison(case)
    list(result.run())
    assert [r.provenance["method"] for r in result.references] == ["exact"]
    assert not result.failures
    asked = CaseComparison(case)
    list(asked.run(references=("exact", "cvode")))
    assert [failure[:2] for failure in asked.failures] == [("refused", "cvode@displacement")]
    assert asked.report().text().count("refused  cvode@displacement") == 1


def test_what_breaks_in_a_function_is_a_failure_with_its_reason():
    def short(system, dt, t_end):
        t = np.linspace(0.0, 0.5 * t_end, 11)
        return t, 0.0 * t

    def raising(system, dt, t_end):
        raise ZeroDivisionError("no pivot")

    def overflowing(system, dt, t_end):
        t = np.linspace(0.0, t_end, 11)
        return t, np.where(t > 0.5 * t_end, np.inf, t)

    result = CaseComparison(case_of(pair(), 0.01, 0.5))
    list(result.run([short, raising, overflowing, "trapezoidal"], ["exact"]))
    messages = {label: message for _, label, message in result.failures}
    assert "returned no later times" in messages["short@matrices"]
    assert "ZeroDivisionError: no pivot" in messages["raising@matrices"]
    assert "overflowed at t = 0.3" in messages["overflowing@matrices"]
    assert [run.label for run in result.runs] == ["Trapezoidal@matrices"]


def test_a_function_that_fails_at_every_step_is_named_with_its_reason():
    def broken(system, dt, t_end):
        raise ZeroDivisionError("no pivot")

    system = sb.System.from_matrices([[2.0]], [[50.0]], observe=[1.0], initial_velocity=[1.0])
    options = {"halvings": 4, "kinds": ["smooth"], "dt": 0.05, "t_end": 2.0}
    records = sb.study("converge", system, integrators=["trapezoidal", broken], **options)
    assert "lost (4): broken stopped at t = 0: ZeroDivisionError: no pivot" in str(records)


@pytest.mark.slow
def test_a_strangers_method_stands_in_one_picture_with_ida_cvode_and_kvaerno():
    """Order 4 without contact. Recorded runs cannot run at other steps."""
    system, t_end = pair(), 1.0
    with pytest.raises(sb.InputError, match="pass recorded runs to compare or score"):
        sb.study("converge", system, dt=0.02, t_end=t_end, integrators=[recorded(system, 0.02, t_end)])
    records = sb.study(
        "converge", system, dt=0.02, t_end=t_end, halvings=2, tolerances=[1e-6], impacts=2, kinds=["contact"],
        views=["work"], integrators=["trapezoidal", runge_kutta, "ida", "cvode", "kvaerno5"],
    )  # fmt: skip
    rows = dict(list(records.found.groupby("integrator")))
    label = integrator(runge_kutta).label
    assert set(rows) == {"Trapezoidal", label, "ida", "cvode", "kvaerno5"}
    assert max(rows[name]["tip_error"].max() for name in ("ida", "cvode", "kvaerno5")) < 1e-4
    assert rows["kvaerno5"]["solves"].iloc[0] < 6000  # of its steps, not of steps of six stages to a thousand outputs
    assert (records.found["solves"].dropna() > 0).all()
    assert (records.found["tip_error"] < 0.1).all()
    assert {"IDA", "CVODE BDF", "Kvaerno5"} <= {text.get_text() for text in records.figure().legends[0].get_texts()}
    smooth = sb.study(
        "converge",
        system,
        dt=0.1,
        t_end=t_end,
        halvings=4,
        kinds=["smooth"],
        views=["order"],
        integrators=[runge_kutta],
    )
    order = smooth.answer.table["order without contact"].iloc[0]
    assert float(order.split()[0]) == pytest.approx(4.0, abs=0.1)
