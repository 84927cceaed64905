"""Damaged netCDF files: each is refused in a moment or harmless, whatever HDF5 would make of it."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from break_it import damaged

import stiffbeam as sb
from stiffbeam.basics import storage
from stiffbeam.files import store

SEALED = storage.SEAL_LENGTH  # bytes behind those that HDF5 reads


@pytest.fixture(scope="module")
def run():
    system = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=1e4)), 4)
    return sb.integrate(system, sb.HHT(), 1e-3, 0.05)


@pytest.fixture(scope="module")
def content(run, tmp_path_factory):
    return run.save(tmp_path_factory.mktemp("whole") / "run.nc").read_bytes()


def read(file: Path, run: sb.Trajectory) -> bool:
    """Whether a file was refused; what was not refused is the run."""
    try:
        found = sb.load(file)
    except sb.InputError:
        return True
    assert np.array_equal(found.tip, run.tip)
    return False


@pytest.mark.slow
def test_damage_to_a_file_of_ours_is_found_before_hdf5_sees_it(run, content, tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "_unreadable", lambda file, size: "its seal is damaged")
    monkeypatch.setattr(store, "read_netcdf", None)
    for seed in range(600):
        (file := tmp_path / "run.nc").write_bytes(damaged(content, seed))
        assert read(file, run), seed


@pytest.mark.slow
def test_a_file_that_hdf5_does_not_come_back_from_is_refused_in_time(run, content, tmp_path, monkeypatch):
    """An object of a global heap whose size is 16 less than nothing: HDF5 reads it for ever."""
    monkeypatch.setattr(storage, "READ_SECONDS", 3.0)
    at = content.index(b"GCOL") + 24
    endless = content[:at] + struct.pack("<Q", 2**64 - 16) + content[at + 8 : -SEALED]
    (file := tmp_path / "endless.nc").write_bytes(endless)
    begun = time.monotonic()
    with pytest.raises(sb.InputError, match="it is damaged, make it again: reading it takes more than 3 seconds"):
        sb.load(file)
    assert time.monotonic() - begun < 10.0


@pytest.mark.slow
def test_a_file_that_another_tool_has_written_again_is_read(run, content, tmp_path):
    (file := tmp_path / "again.nc").write_bytes(content[:-SEALED])
    assert not read(file, run)
    file.write_bytes(content)
    with h5py.File(file, "r+") as opened:  # HDF5 takes the seal away
        opened.attrs["history"] = "looked at"
    assert not read(file, run)


@pytest.mark.slow
def test_damage_to_a_file_without_a_seal_is_found_or_harmless(run, content, tmp_path, monkeypatch):
    """Each opened by a process that may take five seconds; without a limit some take for ever."""
    monkeypatch.setattr(storage, "READ_SECONDS", 5.0)
    refused = 0
    for seed in range(20):
        (file := tmp_path / "run.nc").write_bytes(damaged(content[:-SEALED], seed))
        refused += read(file, run)
    assert refused > 6
