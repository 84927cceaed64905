"""The journal of a study: what is finished is never lost, and never taken for something else."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace

import pytest
from measured import settled

from stiffbeam.files.cases import paper_case
from stiffbeam.studies import find_study, runner, study
from stiffbeam.studies.runner import run_study

SMALL = replace(paper_case(10), cells=8, t_end=0.8)


THREE = ["bdf2", "HHT(alpha=-0.1)", "trapezoidal"]


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
    assert [point["scheme"] for point in second] == ["Bathe(split=0.5)"]
    assert json.dumps(resumed.rows) == json.dumps(whole.rows)
    run_study(counting(one, third), SMALL, tmp_path, **AMPLIFICATION)
    assert not third


@pytest.mark.slow
def test_an_interrupted_measurement_ends_with_the_same_bits_but_for_what_it_calls_measured(tmp_path):
    one = find_study("precision")
    whole = run_study(one, SMALL, **one.smoke).to_dict()
    done = []
    with pytest.raises(KeyboardInterrupt):
        run_study(counting(one, done, stop_after=3), SMALL, tmp_path, **one.smoke)
    resumed = run_study(counting(one, done), SMALL, tmp_path, **one.smoke).to_dict()
    assert len(done) == len(whole["rows"])
    assert json.dumps(settled(resumed)) == json.dumps(settled(whole))
    assert set(one.measured) < set(whole["rows"][0])


KILLED = """
import sys, time
from dataclasses import replace
from stiffbeam.files.cases import paper_case
from stiffbeam.studies import study

def progress(what, done, total):
    print(done, flush=True)
    if done == 2:
        time.sleep(600)

case = replace(paper_case(10), cells=8, t_end=0.8)
study("amplification", case, folder=sys.argv[1], progress=progress, schemes={schemes!r}, per_decade=10)
"""


@pytest.mark.slow
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
    assert [point["scheme"] for point in calls] == ["Bathe(split=0.5)"]
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
        patch.setattr(runner, "version", lambda package: "0.0.0")
        assert evaluated() == 4
    with monkeypatch.context() as patch:
        patch.setattr(runner, "source_hash", lambda: "edited")
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


def point(octave, error, dt, left_out=""):
    return {"octave": octave, "error_rms": error, "dt": dt, "left_out": left_out, "kind": "contact", "scheme": "bdf2"}
