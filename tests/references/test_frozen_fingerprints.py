"""The frozen references are of the systems that this version makes of their cases."""

from __future__ import annotations

from pathlib import Path

import pytest
import xarray as xr

import stiffbeam as sb

FILES = sorted((Path(__file__).parents[2] / "reference").glob("table*.nc"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_frozen_reference_is_of_the_system_that_its_case_makes(file):
    table, form = file.stem.split("-", 1)
    case = sb.paper_case(int(table.removeprefix("table")))
    with xr.open_dataset(file, engine="h5netcdf", decode_times=False) as data:
        assert data.attrs["fingerprint"] == sb.semidiscretise(case.problem, case.cells, form).fingerprint


def test_there_are_frozen_references():
    assert len(FILES) == 19
