"""References from Python say how far they are."""

from __future__ import annotations

import time

import pytest
import threadpoolctl

import stiffbeam as sb
from stiffbeam.basics import resources


@pytest.mark.parametrize("colour", ["", "1"])  # to rich, standard error is then a terminal
def test_work_of_seconds_shows_itself_now_and_then(colour, monkeypatch, capsys):
    monkeypatch.setattr(resources, "WAIT", 0.05)
    monkeypatch.setattr(resources, "LOOK", 0.01)
    monkeypatch.setenv("FORCE_COLOR", colour) if colour else monkeypatch.delenv("FORCE_COLOR", raising=False)
    for asked in (None, True, False):
        with resources.working("counting", asked), resources.working("inside") as show:
            time.sleep(0.5)
            show("never", 0, 0)
        said = capsys.readouterr().err
        assert ("counting" in said) == (asked is not False)
        assert "inside" not in said
        assert "never" not in said
        if asked is not False and not colour:
            assert said.splitlines()[:2] == [f"stiffbeam: {t} s so far, now counting" for t in (0.05, 0.15)]


def test_blas_has_one_thread_inside_and_its_own_outside():
    def threads():
        info = threadpoolctl.threadpool_info()
        return [x["num_threads"] for x in info if "numpy" in x["filepath"] or "scipy.libs" in x["filepath"]]

    with threadpoolctl.threadpool_limits(2, "blas"):
        with resources.working("one"), resources.working("two"):
            assert set(threads()) == {1}
        assert set(threads()) == {2}


def test_a_reference_tells_the_solutions_it_makes_and_is_silent_unless_asked(table10, capsys):
    system = sb.semidiscretise(table10, 8)
    told: list[tuple[str, int, int]] = []
    asked = sb.reference(system, 0.05, progress=lambda what, done, total: told.append((what, done, total)))
    assert told[0] == ("exact: solving", 0, 0)
    assert [x[1:] for x in told if "copy" in x[0]] == [(k, 9) for k in range(1, 9)]
    for method, t_end in (("exact", 20.0), ("cvode", 0.02), ("dop853", 0.02)):
        told.clear()
        sb.reference(system, t_end, method, rtol=1e-6, progress=lambda *x: told.append(x))
        shares = [done / total for what, done, total in told if total]  # of all solutions
        assert shares == sorted(shares)
        assert len([x for x in told if x[0] == f"{method}: solving"]) > 2
        assert ("cvode: a second solution for its horizon", 1, 2) in told or method != "cvode"
    quiet = sb.reference(system, 0.05, progress=True)  # neither a terminal nor a notebook
    assert quiet.horizon == asked.horizon
    assert capsys.readouterr() == ("", "")


def test_a_study_shows_its_points(capsys):
    shown: list[tuple[str, int, int]] = []
    case, options = sb.paper_case(10), {"schemes": ["BDF2", "bathe"], "steps": 200}
    study = sb.study("modes", case, progress=lambda *x: shown.append(x), **options)
    assert shown[0] == ("modes: planning", 0, 0)
    assert shown[-1][1:] == (shown[-1][2],) * 2 > (0, 0)
    again = sb.study("modes", case, progress=True, **options)  # neither a terminal nor a notebook
    assert again.table.equals(study.table)
    assert capsys.readouterr() == ("", "")
