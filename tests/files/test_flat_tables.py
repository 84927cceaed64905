"""Tables that pandas, spreadsheets and MATLAB read, and reprs of one line."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import loadmat
from systems import two_contacts

import stiffbeam as sb


@pytest.fixture(scope="module")
def ran():
    system = two_contacts()
    return system, sb.integrate(system, sb.HHT(-0.1), 1e-3, 2.0), sb.reference(system, 2.0)


def test_a_trajectory_is_a_table_with_all_its_contacts_and_its_ledger(ran):
    _, run, _ = ran
    assert np.array_equal(run.energy.to_dataframe()["energy_loss"], run.energy.loss)
    frame = run.to_dataframe()
    assert np.array_equal(frame.index, run.time)
    assert np.array_equal(frame["tip"], run.tip)
    assert np.array_equal(frame["contact_force_1"], run.contacts[1].force)
    assert np.array_equal(frame["energy_loss"], run.energy.loss)
    assert frame.attrs["provenance"]["dt"] == 1e-3
    impacts = run.contacts[1].impacts
    assert np.array_equal(impacts.to_dataframe()["impact_time"], impacts.times)


def test_an_ensemble_has_a_line_per_member_and_a_comparison_is_one(ran):
    system, run, ref = ran
    ensemble = sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-3, 1.0, members=sb.perturbed_members(system, 3))
    frame = ensemble.to_dataframe()
    assert len(frame) == 3
    assert frame["impact_count_1"].tolist() == ensemble.contacts[1].impact_count.tolist()
    compared = sb.compare(run, ref)
    line = compared.to_dataframe()
    assert line.shape[0] == 1
    assert line["contact1_run_impacts"][0] == compared.contacts[1].run.impacts
    assert line["contact0_matching_matched_until"][0] == compared.contacts[0].matching.matched_until
    assert not any(isinstance(x, (dict, list, tuple)) for x in line.iloc[0])


def test_csv_and_mat_hold_every_digit_and_load_takes_netcdf_only(ran, tmp_path):
    _, run, _ = ran
    saved, frame = run.save(tmp_path / "run.csv"), run.to_dataframe()
    assert np.array_equal(np.loadtxt(saved, delimiter=",", skiprows=1), frame.reset_index().to_numpy())
    assert saved.read_text(encoding="utf-8").splitlines()[0] == ",".join(["time", *frame.columns])
    mat = loadmat(run.save(tmp_path / "sub" / "RUN.MAT"))
    assert np.array_equal(mat["tip"][:, 0], run.tip)
    assert np.array_equal(mat["contact_position"][1], run.contacts[1].position)
    counts = [c.impacts.count for c in run.contacts]
    assert mat["impact_time"].size == sum(counts) > 0
    assert json.loads(mat["provenance"][0])["method"] == "HHT(alpha=-0.1)"
    assert [p.name for p in tmp_path.iterdir() if p.is_file()] == ["run.csv"]  # nothing half-written
    with pytest.raises(sb.InputError, match="netCDF"):
        sb.load(tmp_path / "run.csv")


def test_what_an_unknown_contact_is_survives_a_file(tmp_path):
    system = replace(two_contacts(), observe=None)  # the tip is the first contact
    run = sb.integrate(system, sb.HHT(), 1e-3, 0.5)
    own = sb.Trajectory.from_arrays(run.t, run.tip, run.tip_velocity, system)
    kinds = [c.impacts.kind for c in own.contacts]
    assert kinds == ["sampled", "unknown"]
    assert [c.impacts.kind for c in sb.load(own.save(tmp_path / "own.nc")).contacts] == kinds


def test_every_repr_fits_on_two_lines(ran):
    system, run, ref = ran
    shown = [run, ref, run.impacts, run.contacts[0], run.energy, sb.compare(run, ref), system,
             sb.integrate_ensemble(system, sb.HHT(), 1e-2, 0.1, members=sb.perturbed_members(system, 3)),
             sb.Sampled(np.linspace(0, 1, 10001), np.zeros(10001))]  # fmt: skip
    for x in shown:
        assert len(repr(x)) < 240, repr(x)
        assert "\n" not in repr(x)
    assert "tip error" in str(sb.compare(run, ref)).lower()
