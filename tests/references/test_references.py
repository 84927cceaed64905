"""Frozen references, their agreement, and the pytest plugin."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import h5py
import numpy as np
import pytest
from systems import two_contacts

import stiffbeam as sb
from dumont2002 import references
from dumont2002.references import entries, facts, wanted
from stiffbeam.files.cases import paper_cases
from stiffbeam.files.store import BOUND, keep

STORE = Path(__file__).parents[2] / "reference" / "tables"


@pytest.fixture(scope="module")
def many():
    case = paper_cases()["table10"]
    return sb.reference(sb.semidiscretise(case.problem, case.cells), 0.6, "multiprecision")


@pytest.fixture(scope="module")
def frozen(many, tmp_path_factory):
    file = tmp_path_factory.mktemp("frozen") / "table10.nc"
    keep(many, file)
    return file


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
    few = sb.reference(many.system, 1.6, "multiprecision", digits=25)
    assert few.provenance["digits_confirmed_with"] == 25
    assert 0.3 < few.horizon < 1.6
    assert sb.load(keep(few, tmp_path / "few.nc")).horizon == few.horizon  # which takes no system


@pytest.mark.slow
def test_a_small_store_is_made_once(tmp_path, monkeypatch):
    short = dataclasses.replace(sb.paper_case(14), t_end=0.1)
    monkeypatch.setattr(references, "wanted", lambda: [("table14", "displacement", ["table14"])])
    monkeypatch.setattr(references, "paper_cases", lambda: {"table14": short})
    assert references.remake(tmp_path) == ["table14-displacement.nc"]
    assert references.remake(tmp_path) == []
    assert references.frozen(tmp_path, short, "displacement").horizon == 0.1
    with pytest.raises(sb.InputError, match="to t = 4"):
        references.frozen(tmp_path, sb.paper_case(14), "displacement")


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


@pytest.mark.slow
def test_every_frozen_reference_of_the_repository_is_as_the_manifest_states():
    manifest = entries(STORE)
    assert len(manifest) == 19
    assert {entry["file"] for entry in manifest} == {file.name for file in STORE.glob("*.nc")}
    for entry in manifest:
        system, *others = (paper_cases()[table].system(entry["form"]) for table in entry["tables"])
        known = facts(sb.load(STORE / entry["file"], system))
        assert known.pop("form") == entry["form"]
        assert {name: entry[name] for name in known} == pytest.approx(known, rel=1e-6)
        assert {other.fingerprint for other in others} <= {system.fingerprint}
        with h5py.File(STORE / entry["file"]) as data:
            assert data.attrs["hash"] == entry["hash"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["table 10", "viscous", "two contacts"])
def test_a_frozen_reference_comes_back_within_its_bound_past_the_float64_horizon(kind, many, table10, tmp_path):
    if kind != "table 10":
        viscous = sb.semidiscretise(dataclasses.replace(table10, viscosity=0.05), 8)
        many = sb.reference(*((viscous, 0.5) if kind == "viscous" else (two_contacts(), 45.0)), "multiprecision")
    keep(many, tmp_path / "frozen.nc")
    again, t_end = sb.load(tmp_path / "frozen.nc", many.system), many.provenance["t_end"]
    assert again.horizon == t_end
    t = np.random.default_rng(0).uniform(0.0, t_end, 300)
    assert np.max(np.abs(again.at(t)[0] - many.at(t)[0])) < BOUND * np.max(np.abs(many.tip))
    for ours, theirs in zip(again.contacts, many.contacts, strict=True):
        assert ours.impacts.count == theirs.impacts.count > 5
        assert np.allclose(ours.impacts.times, theirs.impacts.times, rtol=0, atol=BOUND)
        assert np.allclose(ours.impacts.peaks, theirs.impacts.peaks, rtol=1e-5, equal_nan=True)
    double = sb.reference(many.system, t_end, t_eval=many.t)
    assert kind == "viscous" or np.max(np.abs(double.tip - many.tip)) > 0.01 * np.max(np.abs(many.tip))
