"""Results as files and tables, and the cache of references: what is saved comes back under the same names and units."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from systems import one_mass, two_contacts

import stiffbeam as sb
from stiffbeam.basics import storage
from stiffbeam.files import store
from stiffbeam.files.store import BOUND
from stiffbeam.trajectory.schema import BY_NAME

BEAM = sb.BeamProblem(
    length=0.4, stiffness=4.2, mass_per_length=0.16, base=sb.Harmonic(2e-3, 150.0),
    stops=[sb.Stops(-2e-3, 2e-3, stiffness=1e5), sb.Stops(None, 1e-3, stiffness=1e5, position=0.25)],
    units=("m", "s", "N"),
)  # fmt: skip
# Units of a beam in metres, seconds and newtons; what is not here has none.
UNITS = {
    "time": "s", "tip": "m", "tip_velocity": "m/s", "x": "m", "displacement": "m", "velocity": "m/s", "diverged": "s",
    "contact_position": "m", "contact_velocity": "m/s", "contact_force": "N", "contact_peak_force": "N",
    "contact_impulse": "N s", "impact_time": "s", "impact_end": "s", "impact_peak_force": "N", "impact_impulse": "N s",
}  # fmt: skip
FROZEN = Path(__file__).parents[2] / "reference" / "tables" / "table13-displacement.nc"


@cache
def system() -> sb.System:
    return sb.semidiscretise(BEAM, 8)


@cache
def results() -> dict:
    """Every kind of result that has files."""
    run = sb.integrate(system(), sb.HHT(-0.1), 1e-4, 0.05)
    members = sb.varied_members(system(), {"stops[0].stiffness": [5e4, 1e5, 2e5], "viscosity": [0.0, 0.1, 0.2]})
    unknown = dataclasses.replace(two_contacts(), observe=None)  # the tip is the first contact
    other = sb.integrate(unknown, sb.HHT(), 1e-3, 0.5)
    free = sb.BeamProblem(stiffness=300.0, base=sb.Harmonic(0.2, 10.0))
    exact = sb.reference(system(), 0.05, t_eval=np.linspace(0.0, 0.05, 101))
    wall = sb.Stops(upper=0.5, stiffness=np.inf, restitution=0.5)
    return {
        "run": run,
        "thinned": sb.integrate(system(), sb.HHT(), 1e-4, 0.02, every=8),
        "calm": sb.integrate(sb.paper_case(10).system(), sb.BDF2(), 1e-5, 1e-4),
        "without contact": sb.integrate(sb.semidiscretise(free, 8), sb.BDF2(), 1e-3, 0.05),
        "lower stop": sb.integrate(sb.semidiscretise(sb.paper_case(14).problem, 10), sb.HHT(-0.01), 5e-5, 0.05),
        "arrays": sb.Trajectory.from_arrays(run.t, *run.states, system()),
        "unknown contact": sb.Trajectory.from_arrays(other.t, other.tip, other.tip_velocity, unknown),
        "rigid stop": sb.integrate(one_mass(1.0, wall, v=1.0), sb.MoreauJean(), 1e-2, 5.0),
        "reference": exact,
        "no horizon": dataclasses.replace(exact, horizon=float("nan")),
        "ensemble": sb.integrate_ensemble(system(), sb.HHT(-0.1), 1e-4, 0.05, members=members, every=10),
        "exact ensemble": sb.reference_ensemble(system(), 0.05, members=sb.perturbed_members(system(), 2)),
    }


SINGLE = ["run", "thinned", "calm", "without contact", "lower stop", "arrays", "unknown contact", "rigid stop",
          "reference", "no horizon"]  # fmt: skip


def same(a, b):
    np.testing.assert_array_equal(np.asarray(a, float), np.asarray(b, float))


def assert_same(a, b):
    """Every number and string that a file keeps, bit by bit."""
    assert type(a) is type(b)
    assert (a.label, a.fingerprint, a.provenance) == (b.label, b.fingerprint, b.provenance)
    np.testing.assert_equal(dataclasses.asdict(a.work), dataclasses.asdict(b.work))
    assert [(c.stops, c.impacts.kind) for c in a.contacts] == [(c.stops, c.impacts.kind) for c in b.contacts]
    assert a.has_energy == b.has_energy
    one, other = a.to_xarray(), b.to_xarray()
    assert one.identical(other)
    assert all(np.issubdtype(contact.impacts.stops.dtype, np.integer) for contact in a.contacts)


@pytest.mark.fast(4)
@pytest.mark.parametrize("kind", SINGLE)
def test_what_is_saved_comes_back_bit_by_bit_and_can_be_saved_again(kind, tmp_path):
    result = results()[kind]
    file = result.save(tmp_path / "folder" / "run.nc")  # the folder is made
    assert file == tmp_path / "folder" / "run.nc"
    again = sb.load(sb.load(file).save(tmp_path / "twice.nc"))
    assert_same(again, result)
    np.testing.assert_equal(getattr(again, "horizon", 0.0), getattr(result, "horizon", 0.0))


def attribute(result, name):
    """The values of a variable through the attributes that the schema names, written out by hand."""
    contacts = result.contacts
    if name.startswith("energy_"):
        return getattr(result.energy, name.removeprefix("energy_"))
    if name == "impact_count":
        return np.array([contact.impact_count for contact in contacts])
    if name.startswith("contact_"):
        return np.array([getattr(contact, name.removeprefix("contact_")) for contact in contacts])
    if name.startswith("impact_"):
        fields = {"time": "times", "end": "ends", "stop": "stops", "peak_force": "peaks", "impulse": "impulses"}
        return np.concatenate([getattr(c.impacts, fields[name.removeprefix("impact_")]) for c in contacts])
    return getattr(result, name)


@pytest.mark.parametrize("kind", ["run", "reference", "arrays", "ensemble", "exact ensemble"])
def test_every_result_is_the_same_in_every_container(kind, tmp_path):
    result = results()[kind]
    data, many = result.to_xarray(), hasattr(result, "members")
    parameter = {"stops[0].stiffness", "viscosity"} & set(data.variables)
    assert set(data.variables) - parameter <= set(BY_NAME)
    assert len(parameter) == 2 * (many and len(result.members.parameters) > 0)
    assert {"member" if many else "time", "contact_fraction", "impact_time", "impact_count"} <= set(data.variables)
    assert many or {"tip", "contact_force", "energy_loss"} <= set(data.variables)
    assert data.attrs["Conventions"].startswith("CF-")
    assert json.loads(data.attrs["provenance"])["method"] == result.provenance["method"]
    for name in set(data.data_vars) - {"impact_open_at_start"}:  # the rows that it flags are not among the attributes
        same(data[name], attribute(result, str(name)))
    for name in set(data.variables) - parameter:
        unit = "J" if str(name).startswith("energy_") else UNITS.get(str(name), "1")
        assert data[name].attrs["long_name"]
        assert data[name].attrs["units"] == unit, name
    with xr.open_dataset(result.save(tmp_path / "a.nc"), engine="h5netcdf", decode_times=False) as opened:
        assert opened.load().identical(data)
    frame, index = result.to_dataframe(), "member" if many else "time"
    # As text first: pandas before 3.1 rounds the last digits.
    read = pd.read_csv(result.save(tmp_path / "a.csv"), index_col=index, dtype=str).astype(float)
    assert list(read.columns) == list(frame.columns)
    along = {str(n) for n in data.variables if data[n].dims == (index,) and n != index}
    numbered = {f"{n}_{i}" for n in data.variables if set(data[n].dims) == {"contact", index} for i in range(2)}
    assert set(frame.columns) == along | numbered
    for column in frame:
        name, _, i = column.rpartition("_")
        values = data[column] if column in along else data[name].sel(contact=int(i))
        same(frame[column], values)
        same(read[column], values)


@pytest.mark.parametrize("kind", ["run", "reference", "frozen"])
@pytest.mark.parametrize("seed", range(3))
def test_any_damaged_file_is_one_sentence_with_its_name(kind, seed, tmp_path):
    """Cut anywhere, or bytes changed anywhere: the file is refused, or has every number that was saved."""
    rng, file = np.random.default_rng([57, seed]), tmp_path / "run.nc"
    if kind == "frozen":
        file.write_bytes(FROZEN.read_bytes())
    else:
        results()[kind].save(file)
    of = sb.paper_case(13).system() if kind == "frozen" else None
    result, content = sb.load(file, of), bytearray(file.read_bytes())
    if seed % 2:
        content = content[: rng.integers(len(content))]
    for place in rng.integers(0, max(len(content), 1), 0 if seed % 2 else 3):
        content[place] ^= int(rng.integers(1, 256))
    file.write_bytes(content)
    try:
        assert_same(sb.load(file, of), result)
    except sb.InputError as error:
        said = str(error)
        assert "run.nc" in said
        assert "\n" not in said


def test_an_exact_reference_with_its_system_answers_at_any_time(tmp_path):
    exact = results()["reference"]
    file = exact.save(tmp_path / "exact.nc")
    loaded, alone = sb.load(file, system=system()), sb.load(file)
    between = np.linspace(0.00031, 0.0397, 36)
    for contact in (None, 0, 1):
        np.testing.assert_allclose(loaded.at(between, contact), exact.at(between, contact), rtol=0.0, atol=1e-12)
    same(loaded.at(exact.t)[0], exact.tip)  # at its own times the numbers of the file
    with pytest.raises(sb.InputError, match="among t_eval"):
        alone.at(between)
    coarse = sb.integrate(system(), sb.HHT(-0.1), 1e-3, 0.05)
    fresh, stored = sb.compare(coarse, exact), sb.compare(coarse, loaded)
    # On some processors the last bits of a position depend on how many times are evaluated at once.
    both = (pd.json_normalize(x.to_dict()["contacts"]) for x in (stored, fresh))
    pd.testing.assert_frame_equal(*both, rtol=1e-12, atol=0.0)
    with pytest.raises(sb.InputError, match="leave one trajectory with its system"):
        sb.compare(sb.load(coarse.save(tmp_path / "run.nc")), alone)


def test_a_loaded_run_has_no_states(tmp_path):
    for result, remedy in ((results()["run"], "integrate again"), (results()["reference"], "with its system")):
        with pytest.raises(sb.InputError, match=f"states .*a loaded file.*{remedy}"):
            _ = sb.load(result.save(tmp_path / "alone.nc")).states


def test_a_file_cannot_import_a_module(tmp_path):
    run = results()["run"]
    method = {"method": "this:Zen(theta=0.5)"}
    loaded = sb.load(dataclasses.replace(run, provenance=run.provenance | method).save(tmp_path / "run.nc"), run.system)
    assert loaded.provenance["method"] == method["method"]
    steered = dataclasses.replace(run, provenance=run.provenance | {"method": "\x1b[2J"})
    assert "\x1b" not in str(sb.load(steered.save(tmp_path / "run.nc")))
    with pytest.raises(sb.InputError, match="states"):
        print(loaded.states)
    assert "this" not in sys.modules


def test_what_is_no_run_is_named(tmp_path):
    other = tmp_path / "other.nc"
    xr.Dataset({"temperature": ("x", np.arange(3.0))}).to_netcdf(other, engine="h5netcdf")
    many, run = results()["ensemble"], results()["run"]
    for file, words in (
        (other, r"be a stiffbeam trajectory of format 4, got '.*other\.nc'"),
        (many.save(tmp_path / "many.nc"), "it is an ensemble"),
        (run.save(tmp_path / "run.csv"), r"be a whole netCDF-4 file, .*save\('run\.nc'\)"),
    ):  # fmt: skip
        with pytest.raises(sb.InputError, match=words):
            sb.load(file)
    with pytest.raises(sb.InputError, match=r"end in \.nc, \.json or \.csv"):
        run.save(tmp_path / "run.mat")


@pytest.mark.slow
def test_a_link_is_replaced_and_threads_save_files_of_one_name(tmp_path):
    run, stranger = results()["run"], tmp_path / "stranger"
    stranger.write_text("mine")
    files = [tmp_path / str(i) / "run.nc" for i in range(4)]
    files[0].parent.mkdir()
    files[0].symlink_to(stranger)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(run.save, files))
    for file in files:
        same(sb.load(file).tip, run.tip)
    assert stranger.read_text() == "mine"


# ---------------------------------------------------------------- the cache of references

TIMES = np.linspace(0.0, 0.06, 121)
FINITE = ("cvode-adams", "ida", pytest.param("kvaerno5", marks=pytest.mark.slow))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of the cached files, empty."""
    monkeypatch.setattr(storage, "directory", lambda: tmp_path)
    return tmp_path / "references"


@pytest.fixture(scope="module")
def eight_cells(table10):
    return sb.semidiscretise(table10, 8)


@pytest.mark.parametrize("method", FINITE)
def test_what_comes_from_the_cache_is_what_was_computed_and_compares_alike(method, folder, eight_cells):
    fresh = sb.cached_reference(eight_cells, 0.06, method, TIMES, rtol=1e-7)
    [file] = folder.iterdir()
    before = file.stat().st_ino  # a file that is written is a new one
    cached = sb.cached_reference(eight_cells, 0.06, method, TIMES, rtol=1e-7)
    assert file.stat().st_ino == before
    assert (fresh.provenance.get("kept"), cached.provenance["kept"], cached.system) == (None, True, eight_cells)
    for one in (cached, fresh):
        one.provenance.pop("kept", None)
    assert_same(cached, fresh)
    assert cached.horizon == fresh.horizon > 0.0
    np.testing.assert_array_equal(cached.at(TIMES[3:9]), fresh.at(TIMES[3:9]))
    # As the reference of a scheme, and as the run held against another reference.
    run, exact = sb.integrate(eight_cells, sb.HHT(-0.1), TIMES[1], 0.06), sb.reference(eight_cells, 0.06)
    assert sb.compare(run, cached).to_dict() == sb.compare(run, fresh).to_dict()
    assert sb.compare(cached, exact).to_dict() == sb.compare(fresh, exact).to_dict()


@pytest.mark.slow
def test_every_parameter_has_a_file_of_its_own(folder, eight_cells, monkeypatch):
    common = {"method": "cvode-adams", "t_eval": TIMES, "rtol": 1e-6}
    stops = sb.Stops(-0.1, 0.1, stiffness=5e6 * (1 + 1e-15))
    others = [
        sb.semidiscretise(eight_cells.problem, 9), sb.semidiscretise(eight_cells.problem, 8, "velocity-curvature"),
        sb.semidiscretise(dataclasses.replace(eight_cells.problem, stops=stops), 8),
    ]  # fmt: skip
    changes = [{}, {"rtol": 1.01e-6}, {"atol": 1e-7}, {"t_eval": TIMES[:-1]}, {"method": "dop853"}]
    calls = [(eight_cells, 0.06, common | change) for change in changes] + [(x, 0.06, common) for x in others]
    for count, (each, t_end, options) in enumerate([*calls, (eight_cells, 0.061, common)], 1):
        for _ in range(2):
            sb.cached_reference(each, t_end, **options)
        assert len(list(folder.iterdir())) == count
    monkeypatch.setattr(store, "version", lambda package: "another")
    sb.cached_reference(eight_cells, 0.06, **common)
    assert len(list(folder.iterdir())) == count + 1


def test_what_has_no_key_leaves_no_file(folder, eight_cells, monkeypatch):
    from stiffbeam.references.adaptive import restarts

    assert sb.cached_reference(eight_cells, 0.05).provenance["method"] == "exact"  # solved again, as fast as it is read
    pushed = sb.BeamProblem(stiffness=300.0, loads=(sb.PointLoad(0.5, lambda t: 0 * t),))
    for arguments, options, words in (
        ((sb.semidiscretise(pushed, 8), 0.1, "cvode"), {}, "Harmonic, Constant and Sampled"),
        ((eight_cells, -1.0, "cvode"), {}, "t_end"), ((eight_cells, 0.1, "cvod"), {}, "method"),
        ((eight_cells, 0.1, "cvode"), {"rtol": -1.0}, "rtol"),
    ):  # fmt: skip
        with pytest.raises(sb.InputError, match=words):
            sb.cached_reference(*arguments, **options)
    with pytest.raises(TypeError, match="tolerance"):
        sb.cached_reference(eight_cells, 0.1, "cvode", tolerance=1e-6)
    monkeypatch.setattr(restarts, "MOST_EVALUATIONS", 20)
    with pytest.raises(sb.SolverFailure):
        sb.cached_reference(eight_cells, 0.06, "cvode", TIMES)
    assert not folder.exists()


@pytest.mark.parametrize("method", ["multiprecision", "cvode-adams"])
@pytest.mark.parametrize("damage", ["cut", "flipped bytes", "another problem's file", "empty"])
@pytest.mark.fast(1)
def test_a_damaged_file_is_named_and_remade(method, damage, folder, eight_cells):
    fresh = sb.cached_reference(eight_cells, 0.06, method, TIMES, rtol=1e-6)
    [file] = folder.iterdir()
    content = bytearray(file.read_bytes())
    if damage == "flipped bytes":
        for position in range(300, len(content), 97):
            content[position] ^= 0x10
    elif damage == "another problem's file":
        sb.cached_reference(sb.semidiscretise(eight_cells.problem, 9), 0.06, method, TIMES, rtol=1e-6)
        [other] = set(folder.iterdir()) - {file}
        content = bytearray(other.read_bytes())
        other.unlink()
    else:
        content = content[: len(content) // 2 if damage == "cut" else 0]
    file.write_bytes(content)
    with pytest.warns(UserWarning, match=f"remaking a cached reference: .*{file.name}"):
        remade = sb.cached_reference(eight_cells, 0.06, method, TIMES, rtol=1e-6)
    assert [path.name for path in folder.iterdir()] == [file.name]
    again = sb.cached_reference(eight_cells, 0.06, method, TIMES, rtol=1e-6)  # no warning: it is good
    for one in (remade, again):
        assert np.max(np.abs(one.tip - fresh.tip)) < BOUND


@pytest.mark.slow
def test_threads_that_ask_for_one_reference_leave_one_good_file(folder, eight_cells):
    with ThreadPoolExecutor(4) as pool:
        tips = list(pool.map(lambda _: sb.cached_reference(eight_cells, 0.02, "cvode-adams", TIMES[:41]).tip, range(4)))
    for tip in tips:
        np.testing.assert_array_equal(tip, tips[0])
    [file] = folder.iterdir()
    assert sb.load(file, eight_cells).horizon == 0.02


@pytest.mark.slow
def test_what_was_not_used_for_longest_goes(folder, eight_cells, monkeypatch):
    first, second, third = (np.linspace(0.0, 0.06, n) for n in (101, 102, 103))
    for times in (first, second):
        sb.cached_reference(eight_cells, 0.06, "cvode", times, rtol=1e-5)
    old = time.time() - 1000.0
    for file in folder.iterdir():
        os.utime(file, (old, old))
    assert sb.cached_reference(eight_cells, 0.06, "cvode", first, rtol=1e-5).provenance["kept"]  # used now
    monkeypatch.setattr(store, "MOST", int(2.5 * max(f.stat().st_size for f in folder.iterdir())))
    sb.cached_reference(eight_cells, 0.06, "cvode", third, rtol=1e-5)
    found = [
        sb.cached_reference(eight_cells, 0.06, "cvode", t, rtol=1e-5).provenance.get("kept") for t in (first, third)
    ]
    assert found == [True, True]
    assert len(list(folder.iterdir())) == 2
