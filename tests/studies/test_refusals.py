"""An expected refusal is an answer with its reason and no failure; a promise that is not kept is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.studies import runner, study
from stiffbeam.studies.runner import evaluate_point

SMALL = replace(sb.paper_case(10), cells=8, t_end=0.8)


def test_overdamped_modes_are_listed_with_the_reason_and_the_others_measured():
    case = replace(SMALL, problem=replace(SMALL.problem, viscosity=0.5))
    records = study("modes", case, schemes=["bdf2"], steps=1000)
    assert not records.failures
    assert records.refusals
    assert all("does not oscillate" in row["refused"] for row in records.refusals)
    assert len(records.found) + len(records.refusals) == 8
    assert "Mode 1 is late" in records.answer
    records.figure().canvas.draw()


def test_the_contact_of_a_beam_whose_finest_grid_meets_the_stop_late_is_compared():
    """The README's steel beam: the span that holds two impacts of its own grid held one of the finest."""
    steel = sb.BeamProblem.from_physical(
        length=0.4, bending_stiffness=4.2, mass_per_length=0.16, stops=sb.Stops(-2e-3, 2e-3, stiffness=1e5),
        base=sb.Harmonic(1e-3, 150.0),
    )  # fmt: skip
    case = replace(SMALL, name="steel", problem=steel, cells=30, dt=1e-5, t_end=0.2)
    records = study("space", case, cells=[8, 12], forms=["displacement"], finest=20)
    assert not records.failures
    assert not records.refusals
    assert {row["kind"] for row in records.rows} == {"frequency", "response", "contact"}


def test_a_refused_point_is_data_and_one_that_breaks_off_is_a_failure():
    def refusing(case, point):
        raise sb.InputError("dt", 1.0, "be small", "halve it")

    def breaking(case, point):
        raise sb.Diverged("hht", 0.5, "use a smaller dt")

    assert "be small" in evaluate_point(refusing, SMALL, {"k": 1})[0]["refused"]
    assert "overflowed" in evaluate_point(breaking, SMALL, {"k": 1})[0]["failed"]


def test_rigid_stops_are_asked_of_undamped_beams_only():
    with pytest.raises(sb.InputError, match="viscosity must be 0"):
        study("rigid", replace(SMALL, problem=replace(SMALL.problem, viscosity=0.1)))


STOP = sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=9.0, damping=1.0))
STRUCK = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[STOP], initial_velocity=[1.0])
CROUCHING = replace(STRUCK, contacts=(replace(STOP, stops=sb.Stops(upper=0.1, stiffness=9.0, dissipation=1.0)),))


@pytest.mark.parametrize(
    ("call", "remedy"),
    [
        (lambda: sb.System.from_matrices(np.eye(2), np.eye(2), [[0.0, 1.0], [-1.0, 0.0]]), r"0\.5\*\(A \+ A\.T\)"),
        (lambda: sb.reference(STRUCK, 1.0, "cvode", switches="through"), "leave switches out"),
        (lambda: sb.Stops.from_restitution(0.0, speed=1.0, stiffness=9.0, upper=0.1), "for 0 use a rigid stop"),
        (lambda: study("energy", STRUCK, dt=1e-3, t_end=1.0, schemes=["Trapezoidal(rho=1)"]), "leave it out"),
    ],
)
def test_a_refusal_states_what_its_caller_can_do(call, remedy):
    with pytest.raises(sb.InputError, match=remedy):
        call()


@pytest.mark.slow
def test_the_environment_belongs_to_others_while_points_are_evaluated(monkeypatch):
    """Threads of workers are told to them; what runs here meanwhile reads its own settings."""
    import os

    monkeypatch.delenv("STIFFBEAM_THREADS", raising=False)
    before = dict(os.environ)
    seen = []
    for _ in runner._on_processes(ECHO, SMALL, [{"k": 0}, {"k": 1}], 2):
        seen.append(dict(os.environ) == before)
    assert seen == [True, True]


def _points(case):
    return [{"k": 0}]


def _threads(case, point):
    import os

    return [{"threads": os.environ["STIFFBEAM_THREADS"], "blas": os.environ["OPENBLAS_NUM_THREADS"]}]


ECHO = runner.Study("echo", "?", _points, _threads, lambda rows: "", lambda records: None, marches=False)


def test_an_unknown_suffix_is_refused_with_the_remedy(table10, tmp_path):
    run = sb.integrate(sb.semidiscretise(table10, 8), sb.HHT(), 1e-3, 0.01)
    with pytest.raises(sb.InputError, match=r"end in \.nc.*or \.csv or \.mat.*name it run\.nc"):
        run.save(tmp_path / "run.txt")
    assert not list(tmp_path.iterdir())
    assert np.array_equal(sb.load(run.save(str(tmp_path / "run.nc"))).tip, run.tip)


def test_a_comparison_is_text_in_a_notebook_too(table10, monkeypatch, capsys):
    """rich shows in a notebook what it is told to write: the text was empty and the table stood there twice."""
    system = sb.semidiscretise(table10, 8)
    found = sb.compare(sb.integrate(system, sb.HHT(), 1e-3, 0.1), sb.reference(system, 0.1))
    plain = str(found)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert str(found) == plain
    assert "HHT" in found._repr_html_()
    assert not capsys.readouterr().out


def test_numbers_of_numpy_are_shown_as_numbers():
    assert (
        str(sb.InputError("x", (np.float64(1.5), np.int64(2)), "be one", "add")) == "x must be one, got (1.5, 2): add"
    )
