"""One contract of data: every result has the same names, units and values in every container."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import loadmat

import stiffbeam as sb
from stiffbeam.trajectory.schema import BY_NAME, COORDINATES, SCHEMA

BEAM = sb.BeamProblem.from_physical(
    length=0.4, bending_stiffness=4.2, mass_per_length=0.16, base=sb.Harmonic(2e-3, 150.0),
    stops=[sb.Stops(-2e-3, 2e-3, stiffness=1e5), sb.Stops(None, 1e-3, stiffness=1e5, position=0.25)],
)  # fmt: skip
# Units of a beam in metres, seconds and newtons, by the ends of names; what is not here has none.
UNITS = {
    "time": "s", "tip": "m", "tip_velocity": "m/s", "x": "m", "displacement": "m", "velocity": "m/s", "diverged": "s",
    "contact_position": "m", "contact_velocity": "m/s", "contact_force": "N", "contact_peak_force": "N",
    "contact_impulse": "N s", "impact_time": "s", "impact_end": "s", "impact_peak_force": "N", "impact_impulse": "N s",
}  # fmt: skip


@cache
def results() -> dict:
    """Every kind of result that has files: of a scheme, of a solver, of arrays, and two ensembles."""
    system = sb.semidiscretise(BEAM, 8)
    run = sb.integrate(system, sb.HHT(-0.1), 1e-4, 0.05)
    members = sb.varied_members(system, {"stops[0].stiffness": [5e4, 1e5, 2e5]})
    return {
        "run": run,
        "reference": sb.reference(system, 0.05),
        "arrays": sb.Trajectory.from_arrays(run.t, states=run.states, system=system),
        "ensemble": sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, 0.05, members=members, every=10),
        "exact ensemble": sb.reference_ensemble(system, 0.05, members=sb.perturbed_members(system, 2)),
    }


@pytest.fixture(scope="module", params=["run", "reference", "arrays", "ensemble", "exact ensemble"])
def result(request):
    return results()[request.param]


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


def same(a, b):
    np.testing.assert_array_equal(np.asarray(a, float), np.asarray(b, float))


@pytest.mark.slow
def test_every_result_is_the_same_in_every_container(result, tmp_path):
    data = result.to_xarray()
    many = hasattr(result, "members")
    parameter = {"stops[0].stiffness"} & set(data.variables)
    assert set(data.variables) - parameter <= set(BY_NAME)
    assert len(parameter) == (many and result.members.parameter != "initial data")  # numbers are no values
    assert {"member" if many else "time", "contact_fraction", "impact_time", "impact_count"} <= set(data.variables)
    assert many or {"tip", "contact_force", "energy_loss"} <= set(data.variables)
    assert data.attrs["Conventions"].startswith("CF-")
    assert json.loads(data.attrs["provenance"])["method"] == result.provenance["method"]

    for name in set(data.data_vars) - {"impact_open_at_start"}:  # the rows that it flags are not among the attributes
        same(data[name], attribute(result, str(name)))
        same(data[name], result[str(name)])
    for name in data.variables:
        unit = "J" if str(name).startswith("energy_") else UNITS.get(str(name), "1")
        assert data[name].attrs["long_name"]
        if name not in parameter:
            assert data[name].attrs["units"] == unit, name

    with xr.open_dataset(result.save(tmp_path / "a.nc"), engine="h5netcdf", decode_times=False) as opened:
        assert opened.load().identical(data)
    written = json.loads(result.save(tmp_path / "a.json").read_text(encoding="utf-8"))
    again = xr.Dataset.from_dict(written)
    assert set(again.coords) == set(data.coords)
    mat = loadmat(result.save(tmp_path / "a.mat"))
    for name in data.variables:
        same(again[name], data[name])
        assert again[name].attrs == data[name].attrs
        letters = "stops_0_stiffness" if name == "stops[0].stiffness" else str(name)
        same(mat[letters].reshape(data[name].shape), data[name])
        assert mat["long_name"][letters][0, 0][0] == data[name].attrs["long_name"]

    frame = result.to_dataframe()
    index = "member" if many else "time"
    assert frame.index.name == index
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
        if column not in parameter:
            assert frame.attrs["units"][column] == values.attrs["units"]


def test_impacts_and_energies_by_themselves_have_the_names_of_the_whole():
    run = results()["run"]
    data, impacts, energies = run.to_xarray(), run.contacts[1].impacts.to_dataframe(), run.energy.to_dataframe()
    assert impacts.index.name == "impact"
    assert energies.index.name == "time"
    for name in impacts:
        same(impacts[name], data[name].values[data["impact_contact"].values == 1])
    for name in energies:
        same(energies[name], data[name])


def test_an_ensemble_has_the_varied_parameter_as_a_coordinate_of_its_members():
    many = results()["ensemble"]
    data = many.to_xarray()
    assert data.coords["stops[0].stiffness"].dims == ("member",)
    assert data.coords["impact_member"].dims == data.coords["impact_contact"].dims == ("impact",)
    assert data["contact_force" if "contact_force" in data else "contact_fraction"].dims == ("contact", "member")
    third = data["impact_time"].values[(data["impact_member"] == 2) & (data["impact_contact"] == 1)]
    same(third, many.contacts[1].impacts_of(2).times)


def test_the_field_is_a_variable_of_time_and_place():
    run = results()["run"]
    data = run.to_xarray(x=[0.1, 0.4])
    assert data["displacement"].dims == ("time", "x")
    same(data["displacement"].sel(x=0.4), run.displacement(0.4))
    np.testing.assert_allclose(data["displacement"].sel(x=0.4), run.tip, atol=1e-15)
    same(data["velocity"].sel(x=0.1), run.velocity(0.1))


def test_the_schema_names_every_variable_once_and_a_wrong_name_is_refused():
    names = [variable.name for variable in (*SCHEMA, *COORDINATES)]
    assert len(names) == len(set(names))
    run = results()["run"]
    with pytest.raises(sb.InputError, match="energy_loss"):
        _ = run["ledger_loss"]
    plain = sb.Trajectory.from_arrays(run.t, run.tip)
    with pytest.raises(sb.InputError, match="be one that the result holds"):
        _ = plain["energy_loss"]


def test_a_file_of_an_ensemble_is_no_run(tmp_path):
    many = results()["ensemble"]
    with pytest.raises(sb.InputError, match="it is an ensemble"):
        sb.load(many.save(tmp_path / "many.nc"))
