"""Measured records: the commands that ask many runs of one, from case files and Python, on masses and on a beam."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import stiffbeam as sb
from stiffbeam.cli import app
from stiffbeam.files.cases import find_case
from stiffbeam.schemes.labels import parse_run
from stiffbeam.studies import study

MASSES = """
[[case]]
name = "masses"
dt = 1e-3
t_end = 0.5
[case.system]
mass = [[1.0, 0.0], [0.0, 0.5]]
stiffness = [[900.0, -400.0], [-400.0, 400.0]]
damping = [[0.9, -0.4], [-0.4, 0.4]]
loads = [{ row = [1.0, 0.0], sampled = "force.csv", kind = "linear" }]
contacts = [{ row = [0.0, 1.0], lower = -0.003, upper = 0.003, stiffness = 2e4 }]
"""
BEAM = """
[[case]]
name = "tube"
cells = 4
dt = 5e-4
t_end = 0.5
[case.problem]
length = 1.0
bending_stiffness = 300.0
mass_per_length = 1.0
bending_viscosity = 1.0
stops = { lower = -2e-4, upper = 2e-4, stiffness = 1e4 }
loads = [{ position = 0.7, sampled = "force.csv", kind = "cubic" }]
"""
FILES = {"masses": MASSES, "tube": BEAM}
HHT = "HHT(alpha=-0.1)"
SCALE = "loads[0].time.scale"
TIMES = np.linspace(0.0, 0.5, 101)
FORCE = 3.0 * np.sin(44.0 * TIMES) + 1.5 * np.sin(71.0 * TIMES + 1.0)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the record, which ends with the runs, and both cases."""
    lines = [f"{a:.4f},{b:.6f}" for a, b in zip(TIMES, FORCE, strict=True)]
    (tmp_path / "force.csv").write_text("t,F\n" + "\n".join(lines) + "\n")
    for name, text in FILES.items():
        (tmp_path / f"{name}.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def asked(folder: Path, command: str, name: str, *options: str) -> dict[str, Any]:
    """The JSON that a command gives of a case."""
    jobs = () if command == "advise" else ("--jobs", "1")
    arguments = [command, f"{folder / name}.toml", *options, *jobs, "--out", str(folder / "out"), "--json", "-"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.mark.fast(1)
@pytest.mark.parametrize("name", FILES)
def test_a_sweep_counts_over_the_record_what_single_runs_count(folder, name):
    said = asked(folder, "sweep", name, "--parameter", SCALE, "--values", "0.5,1,2", "--method", HHT)
    case = find_case(f"{name}.toml")
    assert [row["kind"] for row in said["rows"]] == ["contact"] * 3  # and no sections: nothing has a period
    for row in said["rows"]:
        run = sb.integrate(scaled(name, row[SCALE]), sb.HHT(-0.1), case.dt, case.t_end)
        assert row["count"] == run.impacts.count > 0
        assert row["peak_force"] == pytest.approx(run.contacts[0].peak_force, rel=1e-9)
        assert row["fraction"] == pytest.approx(run.contacts[0].fraction, rel=1e-9)
    most = max(row["count"] for row in said["rows"]) / case.t_end
    unit = "s" if name == "tube" else "unit of time"
    assert f"impacts per {unit}: {most:g} at" in said["answer"]


def scaled(name: str, factor: float) -> sb.System:
    """The system of a case by hand, with ``factor`` times its record."""
    values = factor * np.array([float(f"{x:.6f}") for x in FORCE])
    if name == "masses":
        mass, stiffness = [[1.0, 0.0], [0.0, 0.5]], [[900.0, -400.0], [-400.0, 400.0]]
        contact = sb.Contact(np.array([0.0, 1.0]), sb.Stops(-0.003, 0.003, stiffness=2e4))
        loads = [([1.0, 0.0], sb.Sampled(TIMES, values))]
        damping = [[0.9, -0.4], [-0.4, 0.4]]
        return sb.System.from_matrices(mass, stiffness, damping, loads=loads, contacts=[contact])
    beam = sb.BeamProblem.from_physical(
        length=1.0, bending_stiffness=300.0, mass_per_length=1.0, bending_viscosity=1.0,
        loads=(sb.PointLoad(0.7, sb.Sampled(TIMES, values, "cubic")),), stops=sb.Stops(-2e-4, 2e-4, stiffness=1e4),
    )  # fmt: skip
    return sb.semidiscretise(beam, 4)


@pytest.mark.fast(1)
@pytest.mark.parametrize("name", FILES)
def test_an_exact_sweep_over_a_stop_and_a_level_has_the_exact_impacts(folder, name):
    values = {"values": [1e4, 2e4], "second": SCALE, "second_values": [1.0, 2.0], "method": "exact"}
    case = find_case(f"{name}.toml")
    records = study("sweep", case, parameter="stops.stiffness", **values)
    assert len(records.rows) == 4
    for row in records.rows:
        system = scaled(name, row[SCALE])
        system = sb.varied_members(system, {"stops.stiffness": [row["stops.stiffness"]]})[0]
        exact = sb.reference(system, case.t_end)
        assert (row["count"], row["peak_force"]) == (
            exact.impacts.count,
            pytest.approx(exact.contacts[0].peak_force, rel=1e-7),
        )
    assert records.figure().axes


REFUSED = {
    "frequency": ({}, r"for a case without a period, got 'frequency': .*loads\[0\].time.scale"),
    "amplitude": ({"parameter": "amplitude", "values": [1.0, 2.0]}, r"exactly one Harmonic .*loads\[0\].time.scale"),
    "periods": (
        {"parameter": SCALE, "values": [1.0], "periods": 3},
        "periods must be left out for a case without a period",
    ),
    "path": (
        {"parameter": "loads[0].time.amplitude", "values": [1.0]},
        r"path to a number of the system.*loads\[0\].time.scale",
    ),
    "step": ({"parameter": SCALE, "values": [1.0], "dt": 0.3}, "half the run, 0.25"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_a_record_cannot_be_swept_over_is_refused_with_what_it_can(folder, what):
    options, words = REFUSED[what]
    with pytest.raises(sb.InputError, match=words):
        study("sweep", find_case("tube.toml"), **options)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_pairs_of_neighbours_end_before_the_record_does(folder, name):
    """The record ends with the runs: pairs that start late are followed to its end and no further."""
    said = asked(folder, "chaos", name, "--schemes", HHT, "--starts", "8")
    pairs = [row for row in said["rows"] if row.get("pair") is not None and row["kind"] == "pairs"]
    assert len(pairs) == 16
    assert all(row["start"] + row["span"] <= 0.5 * (1 + 1e-9) for row in pairs)
    assert not [row for row in said["rows"] if "failed" in row]
    assert "lambda = ." not in said["answer"]
    with pytest.raises(sb.InputError, match="span must end before the samples"):
        study("chaos", find_case(f"{name}.toml"), schemes=[HHT], span=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_orders_counts_and_advice_on_a_record(folder, name):
    case = find_case(f"{name}.toml")
    exact = sb.reference(case.system(), case.t_end)
    orders = asked(folder, "converge", name, "--schemes", HHT, "--halvings", "4")
    smooth = [row for row in orders["rows"] if row["kind"] == "smooth"]
    assert smooth
    assert "2.00 (HHT(alpha=-0.1)) without contact" in orders["answer"]
    counts = asked(folder, "impacts", name, "--schemes", HHT, "--halvings", "3", "--members", "2", "--no-sensitivity")
    assert {row["reference_count"] for row in counts["rows"] if row["scheme"] == HHT} == {exact.impacts.count}
    want = ("--want", "impacts=0.1,peak_force=0.05", "--schemes", HHT, "--members", "4")
    advised = asked(folder, "advise", name, *want)["recommendation"]
    scheme = parse_run(advised["scheme"])[0]
    run = sb.integrate(case.system(), scheme, advised["dt"], case.t_end, advised["contact"])
    other = sb.reference(case.system(), case.t_end, "cvode", rtol=1e-10)  # which shares no code with the exact one
    assert abs(run.impacts.count - other.impacts.count) <= 0.1 * other.impacts.count
    assert abs(run.contacts[0].peak_force / other.contacts[0].peak_force - 1.0) <= 0.05
