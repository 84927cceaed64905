"""Writing a dataset so that the file appears whole or not at all, and knowing it again."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import xarray as xr

from .whole_file import write_whole


def write(dataset: xr.Dataset, file: str | Path, compression: int = 4) -> Path:
    """Write a compressed netCDF-4 file: into memory, since HDF5 does not survive a full disk, then in one step. Raises
    InputError for a place that cannot be written to."""
    encoding = {
        name: {"zlib": True, "complevel": compression, "shuffle": True} if variable.size and variable.dims else {}
        for name, variable in dataset.data_vars.items()
    }
    return write_whole(file, bytes(dataset.to_netcdf(None, engine="h5netcdf", encoding=encoding)))


def content_hash(data: xr.Dataset, attributes: Iterable[str]) -> str:
    """sha256 of every variable and of the named attributes."""
    digest = hashlib.sha256()
    for name in sorted(map(str, data.variables)):
        digest.update(name.encode() + np.ascontiguousarray(data[name].values).tobytes())
    for name in sorted(attributes):
        digest.update(f"{name}={data.attrs.get(name)}".encode())
    return digest.hexdigest()
