"""Ensembles as xarray datasets and as files."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.plain import plain
from ..basics.validation import InputError
from .dataset import named_in
from .impacts import COLUMNS, OPEN_AT_START
from .tables import write_csv

if TYPE_CHECKING:
    import xarray as xr

    from .ensemble import Ensemble

SUFFIXES = (".nc", ".csv")
TOTALS = {
    "fraction": ("share of time in contact", ""),
    "peak_force": ("largest |sigma|", "force"),
    "impulse": ("integral of |sigma|", "impulse"),
}


def ensemble_dataset(many: Ensemble) -> xr.Dataset:
    """Impacts are in one list, with the contact and the member of each; tip and velocity where they were kept."""
    import xarray as xr

    named = partial(named_in, many.members.system.units)
    data: dict[str, Any] = {"diverged": ("member", many.diverged, named("when it overflowed, NaN: not", "time"))}
    values = np.asarray(many.members.values, object)
    if values.ndim == 1 and all(isinstance(x, (int, float, np.number)) for x in values.tolist()):
        data["value"] = ("member", values.astype(float), {"long_name": many.members.parameter})
    if len(many.t):
        for name, text, quantity in (("tip", "displacement", "length"), ("tip_velocity", "velocity", "velocity")):
            data[name] = (("member", "time"), getattr(many, name), named(f"tip {text}", quantity))
    if many.contacts:
        for name, (text, quantity) in TOTALS.items():
            over = np.stack([getattr(contact, name) for contact in many.contacts])
            data[f"contact_{name}"] = (("contact", "member"), over, named(text, quantity))
        counts = np.stack([contact.impact_count for contact in many.contacts])
        data["contact_impacts"] = (("contact", "member"), counts, named("impacts"))
        begun = np.stack([contact.open_at_start for contact in many.contacts]).astype(np.int8)
        data[f"contact_{OPEN_AT_START}"] = (("contact", "member"), begun, named("1: contact at t = 0, no impact"))
        data["impact_contact"] = ("impact", np.repeat(np.arange(len(counts)), counts.sum(axis=1)))
        data["impact_member"] = ("impact", np.concatenate([np.repeat(np.arange(len(many)), row) for row in counts]))
        for name, (text, quantity) in COLUMNS.items():
            column = np.concatenate([getattr(contact.impacts, name) for contact in many.contacts])
            data[f"impact_{name}"] = ("impact", column, named(text, quantity))
    attributes = {
        "title": f"stiffbeam ensemble: {many.label}",
        "parameter": many.members.parameter,
        "provenance": json.dumps(plain(many.provenance)),
        "fingerprint": many.members.system.fingerprint,
    }
    coordinates = {"member": np.arange(len(many)), "time": ("time", many.t, named("time", "time"))}
    return xr.Dataset(data, coords=coordinates, attrs=attributes)


def save_ensemble(many: Ensemble, file: str | Path) -> Path:
    """Write ``many`` to a .nc or .csv file and return its path; InputError for another suffix."""
    suffix = Path(file).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError("file", str(file), f"end in {' or '.join(SUFFIXES)}", f"name it {Path(file).stem}.nc")
    if suffix == ".csv":
        return write_csv(many.to_dataframe(), Path(file))
    from ..basics import netcdf

    return netcdf.write(netcdf.Arrays.of(ensemble_dataset(many)), file, compression=4)
