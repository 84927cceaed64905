"""What goes wrong in references: a clear error each, and nothing half-written."""

from __future__ import annotations

import itertools

import h5py
import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam import references
from stiffbeam.basics import resources
from stiffbeam.files.store import freeze
from stiffbeam.references import REFERENCES, multiprecision, solve
from stiffbeam.references.adaptive import restarts

ADAPTIVE = [method.name for method in REFERENCES.values() if method.kind == "adaptive"]


@pytest.fixture(scope="module")
def system(table10):
    return sb.semidiscretise(table10, 8)


@pytest.mark.parametrize("method", ADAPTIVE)
def test_a_tolerance_below_float64_is_refused(method, system):
    with pytest.raises(sb.InputError, match=r"rtol must be at least 2.2e-14 in float64, got 1e-30.*multiprecision"):
        solve(system, 0.01, method, None, 1e-30, None)


@pytest.mark.parametrize("method", ["cvode", "cvode-adams", "ida"])
def test_sundials_that_gives_up_says_where_and_what_to_do(method, system, monkeypatch):
    from stiffbeam.references.adaptive import sundials

    monkeypatch.setattr(sundials, "STEPS_A_CALL", 20)
    monkeypatch.setattr(sundials, "TOO_MUCH_WORK", None)
    with pytest.raises(sb.SolverFailure, match=rf"{method} stopped at t = .*steps.*; loosen rtol"):
        solve(system, 0.1, method, None, 1e-10, None)


def test_digits_that_cannot_be_reached_leave_no_file(table10, monkeypatch, command, tmp_path):
    monkeypatch.setattr(multiprecision, "MAX_DIGITS", 60)
    with pytest.raises(sb.SolverFailure, match="digits are not enough; shorten t_end"):
        sb.reference(sb.semidiscretise(table10, 25), 2.0, "multiprecision")
    code, _, error = command("reference", "table10", "--method", "multiprecision", "--t-end", "2", "--out", "r.nc")
    assert (code, "digits are not enough" in error) == (1, True)
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def files(system, tmp_path_factory):
    """A saved reference and a frozen one."""
    folder = tmp_path_factory.mktemp("files")
    sb.reference(system, 0.05, "cvode-adams", np.linspace(0.0, 0.05, 101), rtol=1e-6).save(folder / "saved.nc")
    freeze(sb.reference(system, 0.05, "multiprecision"), folder / "frozen.nc")
    return folder


@pytest.mark.fast(2)
@pytest.mark.parametrize(
    ("kind", "attribute", "value", "message"),
    [
        ("saved", "stiffbeam_format", 5, "be a stiffbeam trajectory of format 4.*it has format 5"),
        ("frozen", "stiffbeam_frozen", 2, "of format 1.*it has format 2"),
        ("saved", "horizon", 0.06, "hold what its hash says"),
        ("frozen", "t_end", 0.2, "hold what its hash says"),
    ],
)
def test_another_version_and_a_changed_attribute_are_found(kind, attribute, value, message, files, tmp_path):
    (copy := tmp_path / "copy.nc").write_bytes((files / f"{kind}.nc").read_bytes())
    with h5py.File(copy, "r+") as file:
        file.attrs[attribute] = value
    with pytest.raises(sb.InputError, match=message):
        sb.load(copy)


def test_a_file_of_another_system_is_found(files, system, table10):
    other = sb.semidiscretise(table10, 9)
    with pytest.raises(sb.InputError, match="be of the system it is read with"):
        sb.load(files / "saved.nc", other)
    with pytest.raises(sb.InputError, match="be of the system it is read with"):
        sb.load(files / "frozen.nc", other)
    with pytest.raises(sb.InputError, match="be read together with its system"):
        sb.load(files / "frozen.nc")
    assert sb.load(files / "saved.nc", system).system is system


# ------------------------------------------------------------------ work without end


@pytest.mark.fast(2)
@pytest.mark.parametrize("method", ["cvode", "cvode-adams", "ida", "dop853", "radau", "kvaerno3"])
def test_work_without_end_is_given_up(method, monkeypatch):
    monkeypatch.setattr(restarts, "MOST_EVALUATIONS", 300)
    with pytest.raises(sb.SolverFailure, match="more than 300; loosen rtol") as failure:
        sb.reference(one_mass(1.0, q=1.0), 500.0, method)
    assert 0.0 < failure.value.t < 500.0


def test_what_no_pass_repeats_takes_its_time_from_all(monkeypatch):
    """Of 20 s for 10 passes 10 s of compiling leave 1 s for each."""
    now, reached = [0.0], list[float]()
    monkeypatch.setattr(resources, "clock", lambda: now[0])
    with resources.deadline(20.0, 10.0, reached.append):
        with resources.once():
            now[0] = 10.0
        now[0] = 10.9
        resources.in_time(0.5)
        now[0] = 11.1
        with pytest.raises(resources.OutOfTime):
            resources.in_time(0.6)
    assert reached == [0.5, 0.6]


def tick(monkeypatch) -> None:
    """From now on every look at the clock is a second."""
    seconds = itertools.count(1.0)
    for module in (resources, references):
        monkeypatch.setattr(module, "clock", lambda: next(seconds))


@pytest.mark.parametrize("method", ["cvode-adams", "ida", "dop853", "radau", "kvaerno5"])
def test_an_adaptive_reference_ends_where_its_budget_does(method, system, monkeypatch):
    """It is one path, not solved again, and the exact solution is the judge of it; further times lie on it, too."""
    t = np.linspace(0.0, 0.2, 2001)
    exact = sb.reference(system, 0.2, t_eval=t)
    tick(monkeypatch)
    run = sb.reference(system, 0.2, method, t, rtol=1e-8, seconds=500.0)
    end = run.provenance["t_end"]
    assert 0.0 < run.t[-1] <= end < 0.2
    assert f"to t = {end:.3g} of 0.2: its budget of 500 s" in run.provenance["budget"]
    assert run.horizon == run.t[-1]
    np.testing.assert_allclose(run.tip, exact.tip[: len(run.t)], atol=1e-5 * np.max(np.abs(exact.tip)))
    wanted = exact.impacts.times[exact.impacts.times <= end]
    np.testing.assert_allclose(run.impacts.times, wanted, atol=1e-6)
    between = np.array([0.3, 0.7]) * run.t[-1]
    np.testing.assert_allclose(run.at(between)[0], exact.at(between)[0], atol=1e-5 * np.max(np.abs(exact.tip)))


def test_a_horizon_ends_where_the_second_solution_has_no_more_time(monkeypatch):
    """Of two solutions only what both have followed is certified."""
    hertz = one_mass(1.0, sb.Stops(upper=0.1, stiffness=1e4, exponent=1.5), v=1.0)
    t = np.linspace(0.0, 100.0, 4001)
    tick(monkeypatch)
    run = sb.reference(hertz, 100.0, "cvode-adams", t, rtol=1e-8, seconds=6000.0)
    assert "ends there" in run.provenance["budget"]
    assert "that one ends at t = " in run.provenance["horizon_against"]
    assert 1.0 < run.horizon < run.t[-1] < 100.0
    with pytest.raises(sb.SolverFailure, match="5 s of CPU end before its first outputs; give more seconds"):
        sb.reference(hertz, 100.0, "cvode-adams", t, seconds=5.0)
