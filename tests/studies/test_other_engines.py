"""The way to the engines of others: problems are read alike without the package, and runs come back as a score."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.testset.problem import folder
from stiffbeam.testset.score import CONVERGES, FAILED, NOT_TAKEN


@pytest.fixture
def engines(monkeypatch):
    """(problem_file, run_all), as an adapter and the runner import them."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "studies" / "engines"))
    return importlib.import_module("problem_file"), importlib.import_module("run_all")


@pytest.mark.parametrize("name", sorted(sb.problems()))
def test_a_problem_is_read_without_the_package_as_with_it(name, engines):
    known = sb.problem(name).system
    mine = engines[0].Problem((folder() / f"{name}.toml").read_text(encoding="utf-8"))
    for a, b in ((mine.M, known.mass), (mine.C, known.damping), (mine.K, known.stiffness), (mine.q, known.q0)):
        assert np.array_equal(a, b)
    times = np.linspace(0.0, mine.t_end, 7)
    assert np.allclose([mine.loads(t) for t in times], [known.load(t) for t in times], rtol=1e-14, atol=0.0)
    assert [c["row"].tolist() for c in mine.contacts] == [c.row.tolist() for c in known.contacts]
    assert mine.rigid == known.rigid


def test_modes_are_those_of_the_matrices(engines):
    mine = engines[0].Problem((folder() / "aster-beam.toml").read_text(encoding="utf-8"))
    shapes, squares = engines[0].modes(mine)
    assert np.allclose(shapes.T @ mine.M @ shapes, np.eye(mine.n), atol=1e-12)
    stiff = shapes.T @ mine.K @ shapes
    assert np.max(np.abs(stiff - np.diag(squares))) < 1e-9 * squares[-1]


def test_what_an_adapter_writes_is_scored(engines, tmp_path, monkeypatch):
    problem_file, runner = engines

    def central(problem, steps):
        if problem.rigid:
            raise problem_file.Refused("no rigid stops")
        if problem.name == "hertz":
            raise ZeroDivisionError("at every step")
        t, h = np.linspace(0.0, problem.t_end, steps + 1), problem.t_end / steps
        (q, v), path = (problem.q, problem.v), []
        for each in t:
            path.append((q, v))
            ahead = q + h * v + 0.5 * h**2 * push(problem, each, q)
            v, q = v + 0.5 * h * (push(problem, each, q) + push(problem, each + h, ahead)), ahead
        q, v = np.swapaxes(path, 0, 1)
        return t, q, v

    def push(problem, t, q):
        contacts = sb.problem(problem.name).system.contacts
        pushed = sum(c.row * c.stops.force(c.row @ q, 0.0) for c in contacts)
        return np.linalg.solve(problem.M, problem.loads(t) - problem.K @ q + pushed)

    chosen = ["bilinear-gap", "bouncing-ball", "hertz", "table12"]
    monkeypatch.setattr(sys, "argv", ["adapter", str(folder()), str(tmp_path), *chosen])
    problem_file.main("plain", "1.0", "none", central, limit=5e4)
    card = sb.score(runner.recorded(tmp_path), chosen)
    assert {e.problem.name: e.outcome for e in card.entries} == {
        "bilinear-gap": CONVERGES, "hertz": FAILED, "table12": NOT_TAKEN, "bouncing-ball": NOT_TAKEN,
    }  # fmt: skip
    assert len(card.entries[0].runs) == len(sb.problem("bilinear-gap").steps)
    for words in ("no rigid stops", "ZeroDivisionError: at every step", "left out here: it takes"):
        assert words in str(card)


@pytest.mark.slow
def test_an_engine_that_is_installed_is_scored(engines, tmp_path):
    pytest.importorskip("mujoco")
    engines[1].run("mujoco_engine.py", tmp_path, ["bilinear-gap"])
    (entry,) = sb.score(engines[1].recorded(tmp_path), "bilinear-gap").entries
    assert entry.outcome == CONVERGES
    assert entry.best["tip_error"] < 0.05
