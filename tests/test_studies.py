"""The studies: every one runs, answers, draws and saves; a killed one goes on where it stopped."""

from __future__ import annotations

import json
import os
import pkgutil
import random
import signal
import subprocess
import sys
from dataclasses import replace
from functools import cache
from importlib import import_module

import matplotlib.image
import numpy as np
import pandas
import pytest
from matplotlib.figure import Figure

import stiffbeam as sb
import stiffbeam.studies
from stiffbeam.cases import paper_case, parse_case
from stiffbeam.figures import TRUTH, look, short
from stiffbeam.schemes import registered
from stiffbeam.studies import STUDIES, Records, converge, find_study, impacts, journal, precision, study
from stiffbeam.studies.runner import run_study
from stiffbeam.validation import InputError

SMALL = replace(paper_case(10), cells=8, t_end=0.8)
FREE = """
[[case]]
name = "free"
cells = 6
dt = 1e-3
t_end = 0.5
[case.problem]
stiffness = 300.0
base = { amplitude = 0.1, frequency = 10.0 }
"""
THREE = ["bdf2", "hht(alpha=-0.1)", "trapezoidal"]


@cache
def smoke(name: str) -> Records:
    """The smoke configuration on a small grid, once for all tests."""
    return study(name, SMALL, **find_study(name).smoke)


# ---------------------------------------------------------------- every study


def test_the_registry_names_every_study_there_is():
    """A study is a module with a STUDY; each stands in the registry under its own name, with its picture."""
    found = set()
    for module in pkgutil.iter_modules(stiffbeam.studies.__path__):
        one = getattr(import_module(f"stiffbeam.studies.{module.name}"), "STUDY", None)
        if one is not None:
            assert one.name == module.name
            found.add(one.name)
    assert found == set(STUDIES)
    for name in STUDIES:
        assert callable(import_module(f"stiffbeam.figures.{name}").draw)


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_answers_in_numbers_from_flat_rows(name):
    records = smoke(name)
    assert records.rows
    assert not records.failures
    assert any(c.isdigit() for c in records.answer)
    assert find_study(name).question.endswith("?")
    assert json.loads(json.dumps(records.rows)) is not None
    assert all(isinstance(v, (int, float, str, bool, type(None))) for row in records.rows for v in row.values())
    # Rows of one kind have one set of keys, whatever their scheme found; pairs are rates and distances.
    kinds: dict[str, set[frozenset[str]]] = {}
    parameters = {p for scheme in registered() for p in scheme.parameters} if name == "amplification" else set()
    for row in records.rows:
        kind = row.get("scheme") if row.get("scheme") in (*TRUTH, None) else "a scheme"
        kinds.setdefault(str(row.get("kind", kind)), set()).add(frozenset(row) - parameters)
    assert all(len(keys) <= (2 if kind == "pairs" else 1) for kind, keys in kinds.items())
    assert len(records.to_dataframe()) == len(records.rows)


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_draws_named_axes(name):
    figure = smoke(name).figure()
    assert figure.axes
    for axis in figure.axes:
        if axis.get_lines() or axis.patches or axis.collections:
            # A category axis has names for ticks instead.
            assert axis.get_ylabel() or any(c.isalpha() for tick in axis.get_yticklabels() for c in tick.get_text())
            assert axis.get_xlabel() or axis.get_shared_x_axes().get_siblings(axis)[1:] or axis.get_xticklabels()
            assert axis.get_title(loc="left") or axis.get_shared_x_axes().get_siblings(axis)[1:]
    assert figure.get_suptitle()


@pytest.mark.parametrize("name", STUDIES)
def test_a_study_saves_what_it_found(name, tmp_path, monkeypatch):
    write = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda figure, file, dpi: write(figure, file, dpi=dpi / 4))  # for speed
    text, table, picture = smoke(name).save(tmp_path / "folder")
    document = json.loads(text.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert document["study"] == name
    assert document["answer"] == smoke(name).answer
    assert len(document["rows"]) == len(pandas.read_csv(table)) == len(smoke(name).rows)
    pixels = matplotlib.image.imread(picture)[..., :3]
    assert pixels.shape[1] == 11 * 200 // 4
    assert np.mean(np.any(pixels < 0.9, axis=-1)) > 0.005


def variants(rows, keys):
    """Rows as they may come: none, all failed, half of them, one scheme only, with holes, without a number."""
    rng = random.Random(1)
    numbers = {k for row in rows for k, v in row.items() if isinstance(v, float) and k not in keys}
    failed = [{k: v for k, v in row.items() if k in keys} | {"failed": "it overflowed"} for row in rows]
    lost = {str(row): rng.random() < 0.5 for row in failed}  # the rows of a point fail together
    who = "method" if "method" in rows[0] else "scheme"
    yield []
    yield failed
    yield [other if lost[str(other)] else one for one, other in zip(rows, failed, strict=True)]
    yield [row for row in rows if row.get(who) == rows[-1].get(who)]
    yield [{k: None if k in numbers and rng.random() < 0.3 else v for k, v in row.items()} for row in rows]
    yield [{k: float("nan") if k in numbers else v for k, v in row.items()} for row in rows]


@pytest.mark.parametrize("name", STUDIES)
def test_a_picture_survives_failed_missing_and_single_rows(name):
    records = smoke(name)
    keys = set().union(*find_study(name).points(SMALL, **find_study(name).smoke))
    keys |= {"dt", "kappa", "t", "dt_over_period", "omega"}
    for rows in variants(records.rows, keys):
        replace(records, rows=rows).figure().canvas.draw()


@pytest.mark.parametrize("name", STUDIES)
def test_an_answer_does_not_need_every_point(name):
    """Some points may fail: whatever remains, one row or those of the truth alone, there is a sentence."""
    records = smoke(name)
    for rows in (records.rows[:1], records.rows[-1:], []):
        assert replace(records, rows=rows).answer.endswith((".", "evaluated: "))


@pytest.mark.parametrize("name", [n for n in STUDIES if n not in ("impacts", "rigid", "ensemble")])
def test_a_beam_without_stops_is_studied_too(name):
    case = parse_case(FREE, "free.toml")
    options = {k: v for k, v in find_study(name).smoke.items() if k != "t_end"}
    records = study(name, case, **options)
    assert [row for row in records.rows if "failed" not in row]
    records.figure().canvas.draw()
    assert records.answer


@pytest.mark.parametrize("name", ["impacts", "rigid", "ensemble"])
def test_a_study_of_contact_wants_stops(name):
    with pytest.raises(InputError, match="have stops"):
        study(name, parse_case(FREE, "free.toml"))


def test_a_scheme_looks_the_same_everywhere_and_unlike_the_others():
    labels = [str(scheme) for scheme in registered()]
    assert short("sdirk(gamma=0.4359, nystrom=true)") == short("sdirk") == "SDIRK(0.4359)"
    assert short("hht(alpha=-0.1)") == "HHT(-0.1)"
    looks = {short(label): str(look(label)) for label in labels}
    assert all(str(look(label)) == looks[short(label)] for label in labels)
    assert len(set(looks.values())) == len(looks)
    # In grey print dashes and marker must do.
    defaults = [look(name) for name in sb.schemes.SCHEMES]
    assert len({(str(one["linestyle"]), one["marker"]) for one in defaults}) == len(defaults)
    assert look("exact")["color"] == look("true")["color"] == "black"
    assert look("cvode") != look("ida")


# ---------------------------------------------------------------- the journal


def counting(study, calls, stop_after=None):
    """The study with its evaluations counted, killed after so many."""
    evaluate = study.evaluate

    def counted(case, point):
        if stop_after is not None and len(calls) == stop_after:
            raise KeyboardInterrupt
        calls.append(point)
        return evaluate(case, point)

    return replace(study, evaluate=counted)


AMPLIFICATION = {"schemes": [*THREE, "bathe"], "per_decade": 10}


def test_an_interrupted_study_evaluates_only_what_is_missing(tmp_path):
    one = find_study("amplification")
    whole = run_study(one, SMALL, **AMPLIFICATION)
    first, second, third = [], [], []
    with pytest.raises(KeyboardInterrupt):
        run_study(counting(one, first, stop_after=3), SMALL, tmp_path, **AMPLIFICATION)
    resumed = run_study(counting(one, second), SMALL, tmp_path, **AMPLIFICATION)
    assert len(first) == 3
    assert [point["scheme"] for point in second] == ["bathe(split=0.5)"]
    assert json.dumps(resumed.rows) == json.dumps(whole.rows)
    run_study(counting(one, third), SMALL, tmp_path, **AMPLIFICATION)
    assert not third


KILLED = """
import sys, time
from dataclasses import replace
from stiffbeam.cases import paper_case
from stiffbeam.studies import study

def progress(what, done, total):
    print(done, flush=True)
    if done == 2:
        time.sleep(600)

case = replace(paper_case(10), cells=8, t_end=0.8)
study("amplification", case, folder=sys.argv[1], progress=progress, schemes={schemes!r}, per_decade=10)
"""


def test_a_killed_process_loses_nothing_finished(tmp_path):
    script = KILLED.format(schemes=AMPLIFICATION["schemes"])
    child = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        while child.stdout.readline().strip() != "2":
            assert child.poll() is None
        os.kill(child.pid, signal.SIGKILL)
        assert child.wait(30) == -signal.SIGKILL
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
    calls = []
    resumed = run_study(counting(find_study("amplification"), calls), SMALL, tmp_path, **AMPLIFICATION)
    assert len(calls) == 2
    assert json.dumps(resumed.rows) == json.dumps(study("amplification", SMALL, **AMPLIFICATION).rows)


def test_a_line_cut_short_is_evaluated_again(tmp_path):
    one = find_study("amplification")
    whole = run_study(one, SMALL, tmp_path, **AMPLIFICATION)
    (file,) = tmp_path.glob("*.jsonl")
    full = file.read_bytes()
    file.write_bytes(full[:-40])
    calls = []
    again = run_study(counting(one, calls), SMALL, tmp_path, **AMPLIFICATION)
    assert [point["scheme"] for point in calls] == ["bathe(split=0.5)"]
    assert json.dumps(again.rows) == json.dumps(whole.rows)
    assert file.read_bytes() == full


@pytest.mark.parametrize(
    "other",
    [
        {"dt": 2e-4},
        {"t_end": 0.4},
        {"cells": 9},
        {"problem": replace(SMALL.problem, stiffness=301.0)},
        {"runs": SMALL.runs[:1]},
    ],
    ids=["dt", "t_end", "cells", "problem", "runs"],
)
def test_the_journal_of_another_case_is_never_read(other, tmp_path):
    one = find_study("amplification")
    run_study(one, SMALL, tmp_path, **AMPLIFICATION)
    (file,) = tmp_path.glob("*.jsonl")
    before, calls = file.read_bytes(), []
    run_study(counting(one, calls), replace(SMALL, **other), tmp_path, **AMPLIFICATION)
    assert len(calls) == 4
    assert file.read_bytes() == before


def test_the_journal_of_another_version_study_or_option_is_never_read(tmp_path, monkeypatch):
    one = find_study("amplification")
    run_study(one, SMALL, tmp_path, **AMPLIFICATION)

    def evaluated(study=one, **options):
        calls = []
        run_study(counting(study, calls), SMALL, tmp_path, **(AMPLIFICATION | options))
        return len(calls)

    assert evaluated() == 0
    assert evaluated(per_decade=11) == 4
    assert evaluated(replace(one, name="another")) == 4
    with monkeypatch.context() as patch:
        patch.setattr(journal, "version", lambda package: "0.0.0")
        assert evaluated() == 4
    with monkeypatch.context() as patch:
        patch.setattr(journal, "source_hash", lambda: "edited")
        assert evaluated() == 4
    assert evaluated() == 0


@pytest.mark.slow
def test_two_processes_find_what_one_finds(tmp_path):
    options = {"schemes": THREE, "halvings": 2, "t_end": 0.2, "sensitivity": False}
    alone = study("impacts", SMALL, **options)
    together = study("impacts", SMALL, folder=tmp_path, jobs=2, **options)
    assert json.dumps(together.rows) == json.dumps(alone.rows)
    calls = []
    run_study(counting(find_study("impacts"), calls), SMALL, tmp_path, **options)
    assert not calls  # what other processes found was kept


# ---------------------------------------------------------------- failures and bad input


def test_a_point_that_fails_is_a_row_and_the_others_are_there():
    """Extrapolated contact is unstable: kappa dt^2 over the mass at the tip is far above its limit here."""
    options = {"schemes": ["trapezoidal"], "forms": ["displacement"], "contact": "extrapolated", "dt": 1e-3}
    records = study("energy", SMALL, **options)
    (failed,) = records.failures
    assert failed["scheme"] == "trapezoidal"
    assert "overflowed at t = 0." in failed["failed"]
    assert {row["scheme"] for row in records.rows} == {"exact", "trapezoidal"}
    records.figure().canvas.draw()
    # A misprint refused at this step is bad input of that point, not of the study.
    refused = study("errata", SMALL, schemes=["sdirk(nystrom=true)"], halvings=1, impacts=1)
    assert any("keep the printed (4.14)" in row["failed"] for row in refused.failures)
    assert len(refused.rows) > len(refused.failures)


def test_a_study_none_of_whose_points_succeed_says_why():
    records = study("errata", SMALL, schemes=["sdirk(nystrom=true)"], halvings=1, impacts=1)
    assert "keep the printed" in replace(records, rows=records.failures).answer


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: study("impact"), "did you mean impacts"),
        (lambda: study("impacts", SMALL, scheme=["bdf2"]), "did you mean schemes"),
        (lambda: study("amplification", "table99"), "be a table of the paper"),
        (lambda: study("amplification", SMALL, schemes=["bdf3"]), "bdf2"),
        (lambda: study("converge", SMALL, kinds=["bumpy"]), "smooth"),
        (lambda: study("amplification", SMALL, jobs=0), "jobs"),
        (lambda: study("converge", SMALL, kinds=["contact"], impacts=0), "impacts"),
        (lambda: study("rigid", SMALL, impacts=0), "impacts"),
    ],
)
def test_bad_input_is_named_with_its_remedy(call, words):
    with pytest.raises(InputError, match=words):
        call()


# ---------------------------------------------------------------- what answers are made of


def point(octave, error, dt, left_out=""):
    return {"octave": octave, "error_rms": error, "dt": dt, "left_out": left_out, "kind": "contact", "scheme": "bdf2"}


def test_the_envelope_takes_the_worst_of_every_whole_octave():
    rows = [
        point(0, 1e-2, 1.0, "impacts part"), point(0, 1e-3, 0.7),
        point(1, 3e-3, 0.5), point(1, 4e-3, 0.4),
        point(2, 1e-3, 0.25), point(2, 5e-4, 0.2),
        point(3, 1e-5, 0.125), point(3, 1e-9, 0.1, "rounding"),
    ]  # fmt: skip
    assert converge.envelope(rows) == ([0.5, 0.25], [4e-3, 1e-3])
    assert converge.orders(rows)["contact", "bdf2"].slope == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("kind", "scheme", "t_end", "steps", "reason"),
    [
        ("contact", "bdf2", 0.15, 1000, "impacts part"),
        ("smooth", "bdf2", 0.6, 12, "error above 10 %"),
        ("smooth", "sdirk", 0.1, 10, "motion not resolved"),
        ("smooth", "sdirk", 0.6, 200_000, "rounding"),
        ("smooth", "bdf2", 0.6, 2_000, ""),
    ],
)
def test_a_point_that_means_nothing_says_why_it_is_left_out(kind, scheme, t_end, steps, reason):
    where = {"kind": kind, "scheme": scheme, "form": "displacement", "contact": "implicit", "t_end": t_end}
    (row,) = converge.evaluate(replace(SMALL, t_end=0.6), where | {"steps": steps, "octave": 0})
    assert row["left_out"] == reason
    other = point(1, 1e-4, 0.5), point(2, 1e-5, 0.25)
    slope = converge.orders([point(0, 1.0, 1.0, row["left_out"]), *other])["contact", "bdf2"]
    assert slope.points == (2 if reason else 3)


def test_every_scheme_converges_with_its_order_on_the_smooth_problem():
    case = replace(paper_case(10), cells=4, dt=1e-3, t_end=0.7)
    labels = [str(scheme) for scheme in registered()]
    records = study("converge", case, schemes=labels, kinds=["smooth"], halvings=3)
    found = converge.orders(records.rows)
    assert len(found) == len(labels)
    for scheme in registered():
        order = found["smooth", str(scheme)]
        assert abs(order.slope - scheme.order) < 0.1, scheme
        assert order.points == 3


def test_the_cheapest_method_is_found_between_its_points():
    def row(method, cost, error):
        return {"method": method, "seconds": cost, "error": error}

    rows = [row("fast", 1.0, 1e-2), row("fast", 100.0, 1e-6), row("slow", 50.0, 1e-2), row("slow", 500.0, 1e-5)]
    rows += [row("never", 1e-3, 1e-2), row("never", 1e3, 2e-4), row("at once", 0.5, 1e-9)]
    (first, second) = precision.cheapest(rows, 1e-4, "seconds")
    assert first == (pytest.approx(10.0), "fast")  # half-way in both logarithms
    assert second == (pytest.approx(50.0 * 10 ** (2 / 3)), "slow")
    assert [name for _, name in precision.cheapest(rows, 1e-2, "seconds")] == []


@pytest.mark.parametrize(("spread", "allowed"), [(0.0, 0.0), (10.0, 1.96 * 10.0 * np.sqrt(1 / 16 + 1 / 128))])
def test_a_count_is_right_only_if_every_finer_one_is(spread, allowed):
    """To the tolerance and the 95 % interval of a difference of means over 16 and 128 members."""

    def row(dt, count, scheme="bdf2", purpose="step"):
        return {"scheme": scheme, "purpose": purpose, "dt": dt, "count": count, "count_spread": spread, "members": 16}

    edge = 100.0 + 5.0 + allowed
    rows = [row(0.0, 100.0, "exact"), row(1e-4, 100.0), row(5e-5, 200.0), row(1e-6, 0.0, purpose="contact")]
    rows += [row(2.5e-5, edge - 0.01), row(1.25e-5, 200.0 - edge + 0.01)]
    assert impacts.right_from(rows, "bdf2") == 2.5e-5  # right by accident at 1e-4 does not count
    assert np.isnan(impacts.right_from([*rows, row(6e-6, edge + 0.01)], "bdf2"))
    assert impacts.right_from([*rows, row(2e-5, edge + 0.01)], "bdf2") == 1.25e-5
    assert np.isnan(impacts.right_from(rows, "hht"))
    assert np.isnan(impacts.right_from(rows[1:], "bdf2"))
