"""Runs and ensembles as xarray datasets and as files in netCDF, CSV, MATLAB and JSON, by the table of variables."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.storage import write_whole
from ..basics.text import plain
from ..basics.validation import InputError, file_path
from .schema import CONVENTIONS, FORMAT, notes_of, values_of

if TYPE_CHECKING:
    from ..basics.netcdf import Arrays
    from .ensemble import Ensemble
    from .trajectory import Trajectory


SUFFIXES = (".nc", ".nc4", ".h5", ".csv", ".mat", ".json")
HASHED = ("stiffbeam_format", "kind", "fingerprint", "provenance", "work", "stops", "impact_kind", "horizon")


def arrays_of(result: Trajectory | Ensemble, x: Any = None) -> Arrays:
    """All variables of a run or an ensemble with their attributes; the provenance is an attribute of the whole.

    Without xarray, which takes a second to import and a tenth of one to write.
    """
    from ..basics.netcdf import Arrays

    values = values_of(result, x)
    notes = notes_of(values, result.units)
    data = {name: (dims, array, notes[name]) for name, (dims, array) in values.items()}
    attributes: dict[str, Any] = {
        "Conventions": CONVENTIONS,
        "title": f"stiffbeam {result.kind}: {result.label}",
        "source": f"stiffbeam {result.provenance.get('stiffbeam', '')}".strip(),
        "stiffbeam_format": FORMAT,
        "kind": result.kind,
        "fingerprint": result.fingerprint,
        "provenance": json.dumps(plain(result.provenance)),
        "work": json.dumps(asdict(result.work)),
        "stops": json.dumps([stops.data for stops in result.stops]),
        "impact_kind": ",".join(c.impacts.kind for c in result.contacts) or "none",
    } | result.further_attributes()
    attributes["hash"] = Arrays(data, attributes).hash(HASHED)
    return Arrays(data, attributes)


def save(result: Trajectory | Ensemble, file: str | Path) -> Path:
    """Write a run or an ensemble in the format that the suffix names; an interrupted write leaves no file.

    .nc, .nc4, .h5: netCDF-4 with everything, which alone ``stiffbeam.load`` reads. .json: the same, in the layout of
    ``xarray.Dataset.to_dict``. .mat: the same for MATLAB, with structs ``units`` and ``long_name``. .csv:
    ``to_dataframe()``, a line for each output time or member; impacts have a table of their own,
    ``run.impacts.to_dataframe()``. Raises InputError for any other suffix.
    """
    suffix = file_path("file", file, 'for example "run.nc"').suffix.lower()
    if suffix not in SUFFIXES:
        remedy = f"name it {Path(file).stem}.nc"
        raise InputError("file", str(file), f"end in {' or '.join(SUFFIXES)}", remedy)
    if suffix == ".csv":
        return write_whole(file, result.to_dataframe().to_csv())
    arrays = arrays_of(result)
    if suffix == ".json":
        return write_whole(file, json.dumps(plain(arrays.to_dict()), allow_nan=False) + "\n")
    if suffix == ".mat":
        return _write_mat(arrays, file)
    from ..basics import netcdf

    return netcdf.write(arrays, file, compression=4 if result.kind == "ensemble" else 0)


def _write_mat(arrays: Arrays, file: str | Path) -> Path:
    """A MATLAB 5 file: every variable by name, one along time, impacts or members as a column; structs ``units`` and
    ``long_name``; ``provenance`` as JSON. A parameter's path becomes a name: ``stops_0_stiffness``."""
    from scipy.io import savemat

    content: dict[str, Any] = {}
    notes: dict[str, dict[str, str]] = {"units": {}, "long_name": {}}
    for written, (_, values, attributes) in arrays.variables.items():
        name = re.sub(r"\W+", "_", written).strip("_")
        column = np.asarray(values)
        content[name] = column[:, None] if column.ndim == 1 else column
        for key, texts in notes.items():
            if key in attributes:
                texts[name] = attributes[key]
    buffer = BytesIO()
    content |= notes | {"provenance": arrays.attributes["provenance"]}
    savemat(buffer, content, appendmat=False, long_field_names=True)
    return write_whole(file, buffer.getvalue())
