"""Trajectories as files: what is saved comes back, and what is no such file is said to be none."""

from __future__ import annotations

import dataclasses
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas
import pytest
import xarray as xr

import stiffbeam as sb
from stiffbeam.basics import storage


@pytest.fixture(scope="module")
def system():
    problem = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.001, 0.001, stiffness=2e7), base=sb.Harmonic(0.2, 10.0))
    return sb.semidiscretise(problem, 10)


@pytest.fixture(scope="module")
def run(system):
    return sb.integrate(system, sb.HHT(-0.1), 5e-5, 0.05)


@pytest.fixture(scope="module")
def exact(system):
    return sb.reference(system, 0.05, t_eval=np.linspace(0.0, 0.05, 101))


class HHT(sb.HHT):
    """Half a step for a step."""

    def step(self, equation, dt, z, loads, reactions):
        return super().step(equation, 0.5 * dt, z, loads, reactions)


def assert_same(a, b):
    """Every number and string that a file keeps, bit by bit."""
    assert type(a) is type(b)
    assert (a.label, a.fingerprint, a.provenance, a.work) == (b.label, b.fingerprint, b.provenance, b.work)
    for name in ("t", "tip", "tip_velocity", "contact_force"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert len(a.contacts) == len(b.contacts)
    for c, d in zip(a.contacts, b.contacts, strict=True):
        assert (c.stops, c.impacts.kind) == (d.stops, d.impacts.kind)
        for name in ("position", "velocity", "force", "fraction", "peak_force", "impulse"):
            np.testing.assert_array_equal(getattr(c, name), getattr(d, name))
        for name in ("times", "stops", "peaks", "impulses"):  # equal NaN count as equal
            np.testing.assert_array_equal(getattr(c.impacts, name), getattr(d.impacts, name))
        assert np.issubdtype(c.impacts.stops.dtype, np.integer)
    for ledger in dataclasses.fields(a.energy):
        np.testing.assert_array_equal(getattr(a.energy, ledger.name), getattr(b.energy, ledger.name))


def test_a_scheme_run_comes_back_bit_by_bit(run, tmp_path):
    assert run.impacts.count > 0
    file = run.save(tmp_path / "folder" / "run.nc")  # the folder is made
    assert file == tmp_path / "folder" / "run.nc"
    assert_same(sb.load(file), run)


def test_an_exact_reference_comes_back_with_its_horizon(exact, tmp_path):
    assert exact.impacts.kind == "event"
    assert exact.impacts.count > 0
    loaded = sb.load(exact.save(tmp_path / "exact.nc"))
    assert_same(loaded, exact)
    assert loaded.horizon == exact.horizon > 0.0


def test_a_saved_exact_reference_answers_at_any_time_with_its_system(system, exact, tmp_path):
    file = exact.save(tmp_path / "exact.nc")
    loaded, between = sb.load(file, system=system), np.linspace(0.00031, 0.0397, 36)
    assert not np.isin(between, exact.t).any()
    other = sb.reference(system, 0.05, "cvode", t_eval=between, rtol=1e-11)  # by steps, not in closed form
    for u, v in (loaded.at(between), loaded.at(between, contact=0)):
        np.testing.assert_allclose(u, other.tip, rtol=0.0, atol=1e-7)
        np.testing.assert_allclose(v, other.tip_velocity, rtol=0.0, atol=1e-4)
    np.testing.assert_array_equal(loaded.at(exact.t)[0], exact.tip)  # at its own times the numbers of the file
    with pytest.raises(sb.InputError, match="among t_eval"):
        sb.load(file).at(between)


def test_a_reference_without_a_horizon_comes_back_without_one(exact, tmp_path):
    unknown = dataclasses.replace(exact, horizon=float("nan"))
    assert np.isnan(sb.load(unknown.save(tmp_path / "unknown.nc")).horizon)


def test_a_loaded_run_can_be_saved_and_compared_again(run, exact, tmp_path):
    once = sb.load(run.save(tmp_path / "once.nc"))
    assert_same(sb.load(once.save(tmp_path / "twice.nc")), run)
    fresh, stored = sb.compare(run, exact), sb.compare(once, exact)
    assert stored.to_dict() == fresh.to_dict()


def test_a_loaded_exact_reference_knows_its_contacts_between_the_steps(system, exact, tmp_path):
    """With steps of a twentieth of a contact, a sampled peak is far below that of the exact solution."""
    coarse, loaded = sb.integrate(system, sb.HHT(-0.1), 1e-3, 0.05), sb.load(exact.save(tmp_path / "exact.nc"), system)
    fresh, stored = sb.compare(coarse, exact), sb.compare(coarse, loaded)
    # On some processors the last bits of a position depend on how many times are evaluated at once.
    both = (pandas.json_normalize(x.to_dict()["contacts"]) for x in (stored, fresh))
    pandas.testing.assert_frame_equal(*both, rtol=1e-12, atol=0.0)
    assert stored.contacts[0].reference.events
    assert stored.contacts[0].reference.peak_force == pytest.approx(exact.contacts[0].peak_force, rel=1e-12)


def test_two_loaded_files_alone_cannot_be_compared(run, exact, tmp_path):
    stored, reference = sb.load(run.save(tmp_path / "run.nc")), sb.load(exact.save(tmp_path / "exact.nc"))
    with pytest.raises(sb.InputError, match="leave one trajectory with its system"):
        sb.compare(stored, reference)


def test_a_lower_stop_alone_comes_back(tmp_path):
    problem = sb.paper_case(14).problem
    run = sb.integrate(sb.semidiscretise(problem, 10), sb.HHT(-0.01), 5e-5, 0.05)
    assert run.impacts.count > 0
    loaded = sb.load(run.save(tmp_path / "one.nc"))
    assert_same(loaded, run)
    assert loaded.contacts[0].stops == sb.Stops(lower=-0.001, stiffness=7e6)
    assert loaded.contacts[0].stops.upper is None


def test_runs_without_impacts_and_without_contacts_come_back(system, tmp_path):
    calm = sb.integrate(system, sb.BDF2(), 1e-5, 1e-4)
    assert calm.impacts.count == 0
    assert_same(sb.load(calm.save(tmp_path / "calm.nc")), calm)
    free = sb.BeamProblem(stiffness=300.0, base=sb.Harmonic(0.2, 10.0))
    contactless = sb.integrate(sb.semidiscretise(free, 8), sb.BDF2(), 1e-3, 0.05)
    assert_same(sb.load(contactless.save(tmp_path / "free.nc")), contactless)


def test_a_thinned_run_comes_back_at_its_output_times(system, tmp_path):
    thin = sb.integrate(system, sb.HHT(), 5e-5, 0.02, every=8)
    assert len(thin.t) == 51
    assert_same(sb.load(thin.save(tmp_path / "thin.nc")), thin)


def test_a_thinned_run_has_its_states_again_with_its_system(tmp_path):
    stops = sb.Contact([1.0], sb.Stops(-0.1, 0.2, stiffness=400.0))
    small = sb.System.from_matrices([[1.0]], [[4.0]], contacts=[stops], initial_velocity=[1.0])
    run = sb.integrate(small, sb.HHT(-0.1), 0.05, 12.0, every=3)
    again = sb.load(run.save(tmp_path / "run.nc"), small)
    for one, other in zip(again.states, run.states, strict=True):
        assert np.array_equal(one, other)
    assert str(sb.contact_rates(again)) == str(sb.contact_rates(run))


def test_a_scheme_with_the_name_of_a_registered_one_has_its_own_states_again(tmp_path):
    """States of a loaded run were those of the registered scheme."""
    small = sb.System.from_matrices([[1.0]], [[4.0]], observe=[1.0], initial_velocity=[1.0])
    run = sb.integrate(small, HHT(-0.1), 0.05, 12.0)
    again = sb.load(run.save(tmp_path / "run.nc"), small)
    assert again.label == run.label == "test_store:HHT(alpha=-0.1)@matrices"
    np.testing.assert_allclose(again.states[0][:, 0], run.tip, rtol=0.0, atol=1e-12)

    local = type("HHT", (sb.HHT,), {"__qualname__": "within.HHT", "__module__": __name__})
    again = sb.load(sb.integrate(small, local(-0.1), 0.05, 12.0).save(tmp_path / "local.nc"), small)
    assert again.label == "test_store:within.HHT(alpha=-0.1)@matrices"
    with pytest.raises(sb.InputError, match="load it then, or integrate again"):
        print(again.states)


def test_a_file_cannot_import_a_module(run, tmp_path):
    method = {"method": "this:Zen(theta=0.5)"}
    loaded = sb.load(dataclasses.replace(run, provenance=run.provenance | method).save(tmp_path / "run.nc"), run.system)
    assert loaded.provenance["method"] == method["method"]
    print(loaded, loaded.plot())
    with pytest.raises(sb.InputError, match="states"):
        print(loaded.states)
    assert "this" not in sys.modules


def test_the_file_is_one_that_xarray_opens(run, tmp_path):
    file = run.save(tmp_path / "run.nc")
    with xr.open_dataset(file, engine="h5netcdf") as data:
        assert dict(data.sizes) == {"time": 1001, "contact": 1, "impact": run.impacts.count}
        np.testing.assert_array_equal(data["tip"], run.tip)
        np.testing.assert_array_equal(data["time"], run.t)
        np.testing.assert_array_equal(data["energy_loss"], run.energy.loss)
        assert all("long_name" in data[name].attrs for name in data.variables)
        assert run.label in data.attrs["title"]


def test_saving_again_replaces_the_file(run, exact, tmp_path):
    file = run.save(tmp_path / "one.nc")
    exact.save(file)
    assert isinstance(sb.load(file), sb.Reference)
    assert [path.name for path in tmp_path.iterdir()] == ["one.nc"]


@pytest.mark.fast(2)
@pytest.mark.parametrize("keep", [0, 4, 100, 0.25, 0.5, -1], ids=str)
def test_a_truncated_file_is_named(run, tmp_path, keep):
    file = run.save(tmp_path / "cut.nc")
    whole = file.read_bytes()
    file.write_bytes(whole[: int(keep * len(whole)) if isinstance(keep, float) else keep])
    with pytest.raises(sb.InputError, match=r"^file must be a whole netCDF-4 file, got '.*cut\.nc'"):
        sb.load(file)


@pytest.mark.slow
def test_what_is_no_trajectory_is_named(tmp_path):
    text = tmp_path / "notes.nc"
    text.write_text("not a netCDF file\n" * 100, encoding="utf-8")
    with pytest.raises(sb.InputError, match=r"be a whole netCDF-4 file, got '.*notes\.nc'"):
        sb.load(text)
    other = tmp_path / "other.nc"
    xr.Dataset({"temperature": ("x", np.arange(3.0))}).to_netcdf(other, engine="h5netcdf")
    with pytest.raises(sb.InputError, match=r"be a stiffbeam trajectory of format 3, got '.*other\.nc'"):
        sb.load(other)
    for missing in (tmp_path / "none.nc", tmp_path):
        with pytest.raises(sb.InputError, match="file must exist"):
            sb.load(missing)
    # A whole file of a format that save() writes and load() does not read.
    for suffix in (".csv", ".json", ".mat"):
        written = sb.integrate(sb.paper_case(10).system(), sb.HHT(), 1e-3, 0.01).save(tmp_path / f"run{suffix}")
        with pytest.raises(sb.InputError, match=r"be netCDF, as run\.save\('run\.nc'\) writes it"):
            sb.load(written)


def half_written(stream):
    raise OSError(28, "No space left on device")


def no_rename(*args):
    raise PermissionError(13, "Permission denied")


@pytest.mark.parametrize(
    ("target", "failure"), [("os.fsync", half_written), ("os.replace", no_rename)], ids=["write", "rename"]
)
def test_a_failing_write_leaves_no_partial_file(run, exact, tmp_path, monkeypatch, target, failure):
    old = exact.save(tmp_path / "old.nc")
    before = old.read_bytes()
    monkeypatch.setattr(target, failure)
    for file in (old, tmp_path / "new.nc"):
        with pytest.raises(sb.InputError, match=r"No space|denied"):
            run.save(file)
    assert [path.name for path in tmp_path.iterdir()] == ["old.nc"]
    assert old.read_bytes() == before


@pytest.mark.parametrize(
    ("ask", "field"),
    [(lambda t: t.states, "states"), (lambda t: t.displacement(0.5), "displacement(x)")],
    ids=["states", "displacement"],
)
def test_a_loaded_run_asked_for_states_says_what_to_do(run, exact, tmp_path, ask, field):
    for trajectory, remedy in ((run, "with its system"), (exact, "with its system")):
        loaded = sb.load(trajectory.save(tmp_path / "stored.nc"))
        with pytest.raises(sb.InputError, match=f"a loaded file.*{remedy}") as caught:
            ask(loaded)
        assert caught.value.field == field
        assert caught.value.remedy


def test_a_loaded_reference_asked_for_new_times_is_refused(exact, tmp_path):
    loaded = sb.load(exact.save(tmp_path / "exact.nc"))
    with pytest.raises(sb.InputError, match="new times"):
        loaded.at(0.0123)


def test_threads_save_files_of_one_name(run, tmp_path):
    files = [tmp_path / str(i) / "run.nc" for i in range(8)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(run.save, files))
    for file in files:
        np.testing.assert_array_equal(sb.load(file).tip, run.tip)


def test_a_file_of_more_bytes_than_allowed_is_refused(run, tmp_path, monkeypatch):
    file = run.save(tmp_path / "run.nc")
    monkeypatch.setattr(storage, "LARGEST", 1000)
    with pytest.raises(sb.InputError, match="have at most 1000 bytes"):
        sb.load(file)
