"""Writing a dataset so that the file appears whole or not at all, and knowing it again."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import xarray as xr

from .validation import InputError


def write(dataset: xr.Dataset, file: str | Path, compression: int = 4) -> Path:
    """Write a compressed netCDF-4 file in one step. Raises InputError for a place that cannot be written to."""
    path = Path(file)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(suffix=".nc", dir=path.parent)
    except OSError as error:
        raise InputError("file", str(path), "lie in a folder that can be written to", str(error)) from None
    os.close(handle)
    encoding = {
        name: {"zlib": True, "complevel": compression, "shuffle": True} if variable.size and variable.dims else {}
        for name, variable in dataset.data_vars.items()
    }
    try:
        dataset.to_netcdf(partial, engine="h5netcdf", encoding=encoding)
        os.chmod(partial, 0o644)
        os.replace(partial, path)
    except BaseException:
        Path(partial).unlink(missing_ok=True)
        raise
    return path


def content_hash(data: xr.Dataset, attributes: Iterable[str]) -> str:
    """sha256 of every variable and of the named attributes."""
    digest = hashlib.sha256()
    for name in sorted(map(str, data.variables)):
        digest.update(name.encode() + np.ascontiguousarray(data[name].values).tobytes())
    for name in sorted(attributes):
        digest.update(f"{name}={data.attrs.get(name)}".encode())
    return digest.hexdigest()
