"""Frozen references, their agreement, and the pytest plugin."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from processes import passed

import stiffbeam as sb
from dumont2002 import references
from dumont2002.references import entries, facts, wanted
from stiffbeam.basics import storage
from stiffbeam.files.cases import paper_cases
from stiffbeam.files.store import BOUND, freeze

STORE = Path(__file__).parents[2] / "reference"


@pytest.fixture(scope="module")
def many():
    case = paper_cases()["table10"]
    return sb.reference(sb.semidiscretise(case.problem, case.cells), 0.8, "multiprecision")


@pytest.fixture(scope="module")
def frozen(many, tmp_path_factory):
    file = tmp_path_factory.mktemp("frozen") / "table10.nc"
    freeze(many, file)
    return file


@pytest.mark.slow
def test_a_frozen_reference_comes_back_within_its_bound_past_the_float64_horizon(many, frozen):
    again = sb.load(frozen, many.system)
    assert isinstance(again, sb.Reference)
    assert again.horizon == 0.8
    assert np.max(np.abs(again.tip - many.tip)) < BOUND * np.max(np.abs(many.tip))
    t = np.random.default_rng(0).uniform(0, 0.8, 500)
    assert np.max(np.abs(again.at(t)[0] - many.at(t)[0])) < BOUND * np.max(np.abs(many.tip))
    assert np.allclose(again.impacts.times, many.impacts.times, rtol=0, atol=BOUND)
    assert np.allclose(again.impacts.peaks, many.impacts.peaks, rtol=1e-5, equal_nan=True)
    # float64 alone has lost it by then
    double = sb.reference(many.system, 0.8, t_eval=many.t)
    assert np.max(np.abs(double.tip - many.tip)) > 0.01 * np.max(np.abs(many.tip))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["switch_time", "side", "q", "q_rate"])
def test_a_changed_number_in_a_frozen_file_is_found(name, frozen, tmp_path):
    (damaged := tmp_path / "damaged.nc").write_bytes(frozen.read_bytes())
    with h5py.File(damaged, "r+") as file:
        data = file[name]
        index = (len(data) // 2,) if data.ndim == 1 else (len(data) // 2, 3)
        data[index] = data[index] * (1 + 1e-12) if data.dtype.kind == "f" else -data[index] + 1
    with pytest.raises(sb.InputError, match="damaged"):
        sb.load(damaged)


@pytest.mark.slow
def test_only_a_confirmed_reference_is_frozen(many, tmp_path):
    few = sb.reference(many.system, 2.0, "multiprecision", digits=25)
    with pytest.raises(sb.InputError, match="confirmed"):
        freeze(few, tmp_path / "few.nc")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_small_store_is_made_once(tmp_path, monkeypatch):
    short = dataclasses.replace(sb.paper_case(14), t_end=0.1)
    monkeypatch.setattr(references, "wanted", lambda: [("table14", "displacement", ["table14"])])
    monkeypatch.setattr(references, "paper_cases", lambda: {"table14": short})
    assert references.remake(tmp_path) == ["table14-displacement.nc"]
    assert references.remake(tmp_path) == []
    solution = references.frozen(tmp_path, short, "displacement")
    assert solution is not None
    assert solution.horizon == 0.1
    assert references.frozen(tmp_path, sb.paper_case(14), "displacement") is None  # it ends later


def test_every_table_of_the_paper_has_a_job_and_tables_with_one_physics_share_it():
    jobs = wanted()
    assert {table for _, _, tables in jobs for table in tables} == {f"table{i}" for i in range(1, 18)}
    assert ("table2", "displacement", ["table2", "table6", "table10"]) in jobs
    assert len(jobs) == 19


@pytest.mark.parametrize("file", sorted(STORE.glob("table*.nc")), ids=lambda file: file.stem)
def test_a_frozen_reference_is_of_the_system_that_its_case_makes(file):
    table, form = file.stem.split("-", 1)
    case = sb.paper_case(int(table.removeprefix("table")))
    with h5py.File(file) as data:
        assert data.attrs["fingerprint"] == sb.semidiscretise(case.problem, case.cells, form).fingerprint


def test_the_store_of_the_repository_is_complete_and_small():
    manifest = entries(STORE)
    assert {(e["tables"][0], e["form"]) for e in manifest} == {(name, form) for name, form, _ in wanted()}
    assert sum(file.stat().st_size for file in STORE.glob("*.nc")) < 10_000_000
    for entry in manifest:
        assert entry["t_end"] == paper_cases()[entry["tables"][0]].t_end
        assert entry["confirmed_with"] < entry["digits"]


def test_the_impacts_in_the_readme_are_those_of_the_manifest():
    text = (STORE / "README.md").read_text(encoding="utf-8")
    for e in entries(STORE):
        tables = ", ".join(table.removeprefix("table") for table in e["tables"])
        row = [tables, e["form"], f"{e['t_end']:g}", str(e["digits"]), str(e["impacts"])]
        assert f"| {' | '.join(row)} | {100 * e['contact_fraction']:.1f} % |" in text


@pytest.mark.slow
def test_every_frozen_reference_of_the_repository_is_as_the_manifest_states():
    manifest = entries(STORE)
    assert len(manifest) == 19
    assert {entry["file"] for entry in manifest} == {file.name for file in STORE.glob("*.nc")}
    for entry in manifest:
        for table in entry["tables"]:
            system = paper_cases()[table].system(entry["form"])
            known = facts(sb.load(STORE / entry["file"], system))
            assert known.pop("form") == entry["form"]
            assert {name: entry[name] for name in known} == pytest.approx(known, rel=1e-6)
        with h5py.File(STORE / entry["file"]) as data:
            assert data.attrs["hash"] == entry["hash"]


def test_a_stored_table_agrees_with_a_fresh_float64_run_inside_the_horizon():
    system = sb.paper_case(13).system("displacement")
    frozen = sb.load(STORE / "table13-displacement.nc", system)
    fresh = sb.reference(system, 0.1, t_eval=np.linspace(0, 0.1, 201))
    inside = fresh.t <= fresh.horizon
    assert np.max(np.abs(frozen.at(fresh.t[inside])[0] - fresh.tip[inside])) < 1e-3 * np.max(np.abs(fresh.tip))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["viscous", "two contacts"])
def test_frozen_references_take_damping_and_several_contacts(kind, table10, tmp_path):
    from systems import two_contacts

    viscous = sb.semidiscretise(dataclasses.replace(table10, viscosity=0.05), 8)
    system, t_end = (viscous, 0.5) if kind == "viscous" else (two_contacts(), 40.0)
    many = sb.reference(system, t_end, "multiprecision")
    freeze(many, tmp_path / "frozen.nc")
    again = sb.load(tmp_path / "frozen.nc", system)
    t = np.random.default_rng(0).uniform(0.0, t_end, 300)
    assert np.max(np.abs(again.at(t)[0] - many.at(t)[0])) < BOUND * np.max(np.abs(many.tip))
    for ours, theirs in zip(again.contacts, many.contacts, strict=True):
        assert ours.impacts.count == theirs.impacts.count > 5
        assert np.allclose(ours.impacts.times, theirs.impacts.times, rtol=0, atol=BOUND)


DOWNSTREAM = r"""
import numpy as np
import pytest
import stiffbeam as sb

PROBLEM = sb.BeamProblem(
    stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e6), base=sb.Harmonic(amplitude=0.2, frequency=10.0)
)
SYSTEM = sb.semidiscretise(PROBLEM, cells=8)

def test_my_integrator(reference_solution, assert_within_reference):
    reference = reference_solution(SYSTEM, t_end=0.5)
    run = sb.integrate(reference.system, sb.SDIRK(), dt=1e-6, t_end=0.06)
    assert_within_reference(run, reference, tolerance=1e-3)
    assert_within_reference((run.t, *run.states), reference, tolerance=1e-3)  # as a solver of one's own returns them
    assert_within_reference((run.t, run.tip, run.tip_velocity), reference, tolerance=1e-3)
    for wrong in ((run.t, 1.01 * run.tip), (run.t, 1.01 * run.states[0], run.states[1])):
        with pytest.raises(AssertionError, match="off by"):
            assert_within_reference(wrong, reference, tolerance=1e-3)
    with pytest.raises(sb.InputError, match=r"\(t, q, v\)"):
        assert_within_reference((run.t, run.tip, run.tip, run.tip), reference, tolerance=1e-3)

def test_it_refuses_what_nobody_knows(reference_solution, assert_within_reference):
    reference = reference_solution(SYSTEM, t_end=0.05)
    run = sb.integrate(reference.system, sb.SDIRK(), dt=1e-4, t_end=0.1)
    with pytest.raises(sb.InputError, match="horizon"):
        assert_within_reference(run, reference, tolerance=1.0)
"""


@pytest.mark.slow
def test_the_plugin_works_in_a_project_of_someone_else(tmp_path):
    assert "2 passed" in passed(tmp_path, DOWNSTREAM, STIFFBEAM_CACHE_DIR=str(storage.directory()))


@pytest.mark.slow
def test_the_command_makes_checks_and_compares(tmp_path):
    def run(*arguments):
        command = [sys.executable, "-m", "stiffbeam", "reference", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)

    made = run("table10", "--method", "multiprecision", "--t-end", "0.5", "--out", "ref.nc")
    assert made.returncode == 0, made.stderr  # which says what takes more than three seconds
    assert "horizon: 0.5" in made.stdout
    sb.load(tmp_path / "ref.nc", sb.paper_case(10).system())
    (tmp_path / "ref.nc").write_bytes((tmp_path / "ref.nc").read_bytes()[:5000])
    with pytest.raises(sb.InputError):
        sb.load(tmp_path / "ref.nc")
    assert run("table10", "--method", "multiprecision", "--digits", "many").returncode == 2
