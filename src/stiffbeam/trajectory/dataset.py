"""Trajectories and ensembles as xarray datasets, and as files: netCDF, CSV, MATLAB."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.text import plain
from ..basics.units import NON_DIMENSIONAL, ONE, Units
from ..basics.validation import InputError, file_path
from .impacts import COLUMNS, OPEN_AT_START, Impacts
from .tables import impact_columns, write_csv, write_mat

if TYPE_CHECKING:
    import xarray as xr

    from ..basics.netcdf import Arrays
    from .ensemble import Ensemble
    from .trajectory import Trajectory


FORMAT = 2
SUFFIXES = (".nc", ".nc4", ".h5")
HASHED = ("stiffbeam_format", "kind", "fingerprint", "provenance", "work", "stops", "impact_kind", "horizon")
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
        names = {
            "position": named("position of the contact point against its stops", "length"),
            "velocity": named("velocity of the contact point", "velocity"),
            "force": named("contact force sigma on the beam, negative on the upper stop", "force"),
        }
        for name, attributes in names.items():
            values = np.stack([getattr(c, name) for c in run.contacts])
            data[f"contact_{name}"] = (("contact", "time"), values, attributes)
        totals = {
            "fraction": named("share of time in contact"),
            "peak_force": named("largest |sigma|", "force"),
            "impulse": named("integral of |sigma|", "impulse"),
        }
        for name, attributes in totals.items():
            data[f"contact_{name}"] = (("contact",), np.array([getattr(c, name) for c in run.contacts]), attributes)
        impacts, flags = zip(*(c.impacts.listed() for c in run.contacts), strict=True)
        data["impact_contact"] = (("impact",), np.repeat(np.arange(len(impacts)), [i.count for i in impacts]), {})
        text = "1: contact that is there at t = 0, which is no impact"
        data[f"impact_{OPEN_AT_START}"] = (("impact",), np.concatenate(flags).astype(np.int64), named(text))
        every = Impacts.concatenate(impacts)
        for name, (text, quantity) in COLUMNS.items():
            data[f"impact_{name}"] = (("impact",), getattr(every, name), named(text, quantity))
    ledger = run.energy if run.ledger is not None or "energy" in run.__dict__ else None
    if ledger is not None:
        for name, text in LEDGER.items():
            data[f"ledger_{name}"] = (("time",), getattr(ledger, name), named(text, "energy"))
    horizon = getattr(run, "horizon", None)  # of a reference
    attributes = {
        "title": f"stiffbeam trajectory: {run.label}",
        "source": f"stiffbeam {run.provenance.get('stiffbeam', '')}".strip(),
        "stiffbeam_format": FORMAT,
        "kind": "run" if horizon is None else "reference",
        "fingerprint": run.fingerprint,
        "provenance": json.dumps(run.provenance),
        "work": json.dumps(
            {
                "steps": run.work.steps,
                "seconds": run.work.seconds,
                "march_seconds": run.work.march_seconds,
                "counters": run.work.counters,
            }
        ),
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
    suffix = file_path("file", file, 'for example "run.nc"').suffix.lower()
    if suffix == ".csv":
        return write_csv(run.to_dataframe(), Path(file))
    if suffix == ".mat":
        frame = run.to_dataframe()
        columns = {str(name): frame[name].to_numpy() for name in frame.columns}
        return write_mat(columns, impact_columns(run.contacts), run.provenance, Path(file))
    if suffix not in SUFFIXES:
        known = (*SUFFIXES, ".csv", ".mat")
        raise InputError("file", str(file), f"end in {' or '.join(known)}", f"name it {Path(file).stem}.nc")
    from ..basics import netcdf

    return netcdf.write(arrays_of(run), file)


ENSEMBLE_SUFFIXES = (".nc", ".csv")
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
    if suffix not in ENSEMBLE_SUFFIXES:
        raise InputError("file", str(file), f"end in {' or '.join(ENSEMBLE_SUFFIXES)}", f"name it {Path(file).stem}.nc")
    if suffix == ".csv":
        return write_csv(many.to_dataframe(), Path(file))
    from ..basics import netcdf

    return netcdf.write(netcdf.Arrays.of(ensemble_dataset(many)), file, compression=4)
