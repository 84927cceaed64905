"""Trajectories and ensembles as xarray datasets, and as files: netCDF, CSV, MATLAB."""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.storage import write_whole
from ..basics.text import plain
from ..basics.units import NON_DIMENSIONAL, ONE, Units
from ..basics.validation import InputError, file_path
from .impacts import COLUMNS, OPEN_AT_START, SINGULAR, Impacts

if TYPE_CHECKING:
    import pandas
    import xarray as xr

    from ..basics.netcdf import Arrays
    from .ensemble import Ensemble
    from .trajectory import Trajectory


FORMAT = 2
SUFFIXES = (".nc", ".nc4", ".h5")
HASHED = ("stiffbeam_format", "kind", "fingerprint", "provenance", "work", "stops", "impact_kind", "horizon")
PATHS = {
    "position": ("position of the contact point against its stops", "length"),
    "velocity": ("velocity of the contact point", "velocity"),
    "force": ("contact force sigma on the beam, negative on the upper stop", "force"),
}
TOTALS = {
    "fraction": ("share of time in contact", ""),
    "peak_force": ("largest |sigma|", "force"),
    "impulse": ("integral of |sigma|", "impulse"),
}
LEDGER = {
    "kinetic": "kinetic energy",
    "elastic": "bending energy",
    "stops": "energy in the stops",
    "input": "work of loads and moving stops since t = 0",
    "viscous": "viscous loss since t = 0",
    "loss": "numerical loss since t = 0",
    "contact": "numerical loss in steps with contact",
    "free": "numerical loss in steps without contact",
    "stop_dissipation": "energy that damped stops took since t = 0",
    "spread": "difference of two rules for what dampers and stops took since t = 0",
}


def named_in(units: Units, text: str, quantity: str = "") -> dict[str, str]:
    """The attributes of a variable: "1" for what has no dimension; what matrices are counted in is not known."""
    if not quantity or units == NON_DIMENSIONAL:
        return {"long_name": text, "units": ONE}
    return {"long_name": text} | ({"units": units.of(quantity)} if units.known else {})


def to_xarray(run: Trajectory) -> xr.Dataset:
    """Dimensions time, contact, impact; every variable with its unit; provenance in the attributes."""
    return arrays_of(run).to_xarray()


def arrays_of(run: Trajectory) -> Arrays:
    """The same without xarray, which takes a second to import and a tenth of one to write."""
    from ..basics.netcdf import Arrays

    named = partial(named_in, run.units)
    data: dict[str, Any] = {
        "time": (("time",), run.t, named("time", "time")),
        "tip": (("time",), run.tip, named("tip displacement", "length")),
        "tip_velocity": (("time",), run.tip_velocity, named("tip velocity", "velocity")),
    }
    if run.contacts:
        for name, (text, quantity) in PATHS.items():
            values = np.stack([getattr(c, name) for c in run.contacts])
            data[f"contact_{name}"] = (("contact", "time"), values, named(text, quantity))
        for name, (text, quantity) in TOTALS.items():
            values = np.array([getattr(c, name) for c in run.contacts])
            data[f"contact_{name}"] = (("contact",), values, named(text, quantity))
        impacts, flags = zip(*(c.impacts.listed() for c in run.contacts), strict=True)
        data["impact_contact"] = (("impact",), np.repeat(np.arange(len(impacts)), [i.count for i in impacts]), {})
        text = "1: contact that is there at t = 0, which is no impact"
        data[f"impact_{OPEN_AT_START}"] = (("impact",), np.concatenate(flags).astype(np.int64), named(text))
        every = Impacts.concatenate(impacts)
        for name, (text, quantity) in COLUMNS.items():
            data[f"impact_{name}"] = (("impact",), getattr(every, name), named(text, quantity))
    if run.has_energy:
        for name, text in LEDGER.items():
            data[f"ledger_{name}"] = (("time",), getattr(run.energy, name), named(text, "energy"))
    horizon = getattr(run, "horizon", None)  # of a reference
    attributes = {
        "title": f"stiffbeam trajectory: {run.label}",
        "source": f"stiffbeam {run.provenance.get('stiffbeam', '')}".strip(),
        "stiffbeam_format": FORMAT,
        "kind": "run" if horizon is None else "reference",
        "fingerprint": run.fingerprint,
        "provenance": json.dumps(run.provenance),
        "work": json.dumps(asdict(run.work)),
        "stops": json.dumps([c.stops.data for c in run.contacts]),
        "impact_kind": ",".join(c.impacts.kind for c in run.contacts) or run.impacts.kind,
    }
    if horizon is not None:
        attributes["horizon"] = horizon
    attributes["hash"] = Arrays(data, attributes).hash(HASHED)
    return Arrays(data, attributes)


def save(run: Trajectory, file: str | Path) -> Path:
    """Write ``run`` in the format that the suffix names; an interrupted write leaves no file.

    .nc, .nc4, .h5: netCDF-4 with everything, which alone ``stiffbeam.load`` reads. .csv: a line per output time,
    ``run.to_dataframe()``; impacts have a table of their own, ``run.impacts.to_dataframe()``. .mat: the same
    columns and the impacts of all contacts for MATLAB. Raises InputError for any other suffix.
    """
    suffix = _suffix(file, (*SUFFIXES, ".csv", ".mat"))
    if suffix == ".csv":
        return write_csv(run.to_dataframe(), file)
    if suffix == ".mat":
        return _write_mat(run, file)
    from ..basics import netcdf

    return netcdf.write(arrays_of(run), file)


def _suffix(file: str | Path, known: tuple[str, ...]) -> str:
    """The suffix of the file in small letters. Raises InputError where it is none of the known ones."""
    suffix = file_path("file", file, 'for example "run.nc"').suffix.lower()
    if suffix not in known:
        raise InputError("file", str(file), f"end in {' or '.join(known)}", f"name it {Path(file).stem}.nc")
    return suffix


def write_csv(frame: pandas.DataFrame, file: str | Path) -> Path:
    """One line per row below a line of names; numbers to all their digits."""
    return write_whole(file, frame.to_csv(index=False))


def _write_mat(run: Trajectory, file: str | Path) -> Path:
    """A MATLAB 5 file: the columns of the run by name, a struct ``impacts`` with the contact of each, and
    ``provenance`` as JSON."""
    from scipy.io import savemat

    frames = [contact.impacts.to_dataframe() for contact in run.contacts]
    impacts = {"contact": np.repeat(np.arange(len(frames)), [len(frame) for frame in frames])}
    for name in (*SINGULAR.values(), OPEN_AT_START):
        impacts[name] = np.concatenate([np.zeros(0), *(frame[name] for frame in frames)])
    content: dict[str, Any] = {str(name): column.to_numpy()[:, None] for name, column in run.to_dataframe().items()}
    content["impacts"] = {name: np.asarray(values, float)[:, None] for name, values in impacts.items()}
    content["provenance"] = json.dumps(run.provenance)
    buffer = BytesIO()
    savemat(buffer, content, appendmat=False)
    return write_whole(file, buffer.getvalue())


def ensemble_dataset(many: Ensemble) -> xr.Dataset:
    """Impacts are in one list, with the contact and the member of each; tip and velocity where they were kept."""
    import xarray as xr

    named = partial(named_in, many.members.system.units)
    data: dict[str, Any] = {"diverged": ("member", many.diverged, named("when it overflowed, NaN: not", "time"))}
    if (values := many.values) is not None:
        data["value"] = ("member", values, {"long_name": many.members.parameter})
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
    if _suffix(file, (".nc", ".csv")) == ".csv":
        return write_csv(many.to_dataframe(), file)
    from ..basics import netcdf

    return netcdf.write(netcdf.Arrays.of(ensemble_dataset(many)), file, compression=4)
