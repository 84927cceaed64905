"""Trajectories as netCDF files that xarray and ncdump read."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from . import netcdf
from .arrays import Array
from .contact import Stops
from .frozen import thaw
from .ledger import Ledger
from .system import System
from .trajectory import ContactRecord, Impacts, Reference, Trajectory, Work, output_index
from .validation import InputError

FORMAT = 1
_HASHED = ("stiffbeam_format", "kind", "fingerprint", "provenance", "work", "stops", "impact_kind", "horizon")
_LEDGER = {
    "kinetic": "kinetic energy",
    "elastic": "bending energy",
    "stops": "energy in the stops",
    "input": "work of loads and moving stops since t = 0",
    "viscous": "viscous loss since t = 0",
    "loss": "numerical loss since t = 0",
    "contact": "numerical loss in steps with contact",
    "free": "numerical loss in steps without contact",
}


def to_xarray(run: Trajectory) -> xr.Dataset:
    """Dimensions time, contact, impact; non-dimensional units; provenance in the attributes."""
    time = ("time", run.t, {"long_name": "time", "units": "1"})
    data: dict[str, Any] = {
        "tip": ("time", run.tip, {"long_name": "tip displacement u(1, t)", "units": "1"}),
        "tip_velocity": ("time", run.tip_velocity, {"long_name": "tip velocity u_t(1, t)", "units": "1"}),
    }
    if run.contacts:
        names = {
            "position": "position of the contact point",
            "velocity": "velocity of the contact point",
            "force": "contact force sigma on the beam, negative on the upper stop",
        }
        for name, text in names.items():
            values = np.stack([getattr(c, name) for c in run.contacts])
            data[f"contact_{name}"] = (("contact", "time"), values, {"long_name": text, "units": "1"})
        totals = {
            "fraction": "share of time in contact",
            "peak_force": "largest |sigma|",
            "impulse": "integral of |sigma|",
        }
        for name, text in totals.items():
            values = [getattr(c, name) for c in run.contacts]
            data[f"contact_{name}"] = ("contact", values, {"long_name": text, "units": "1"})
        impacts = [c.impacts for c in run.contacts]
        data["impact_contact"] = ("impact", np.repeat(np.arange(len(impacts)), [i.count for i in impacts]))
        fields = {
            "times": "time of impact",
            "stops": "+1 upper stop, -1 lower stop",
            "peaks": "largest |sigma| of the impact",
            "impulses": "integral of |sigma| over the impact",
        }
        for name, text in fields.items():
            values = np.concatenate([getattr(i, name) for i in impacts])
            data[f"impact_{name}"] = ("impact", values, {"long_name": text, "units": "1"})
    ledger = run.energy if run.ledger is not None or "energy" in run.__dict__ else None
    if ledger is not None:
        for name, text in _LEDGER.items():
            data[f"ledger_{name}"] = ("time", getattr(ledger, name), {"long_name": text, "units": "1"})
    attributes = {
        "title": f"stiffbeam trajectory: {run.label}",
        "source": f"stiffbeam {run.provenance.get('stiffbeam', '')}".strip(),
        "stiffbeam_format": FORMAT,
        "kind": "reference" if isinstance(run, Reference) else "run",
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
        "stops": json.dumps([[c.stops.lower, c.stops.upper, c.stops.stiffness] for c in run.contacts]),
        "impact_kind": run.impacts.kind,
    }
    if isinstance(run, Reference):
        attributes["horizon"] = run.horizon
    dataset = xr.Dataset(data, coords={"time": time}, attrs=attributes)
    dataset.attrs["hash"] = netcdf.content_hash(dataset, _HASHED)
    return dataset


def save(run: Trajectory, file: str | Path) -> Path:
    """Write ``run`` to a netCDF-4 file; the file appears whole or not at all."""
    return netcdf.write(to_xarray(run), file)


def load(file: str | Path, system: System | None = None, t_eval: ArrayLike | None = None) -> Trajectory:
    """Read a file written by ``save`` or a frozen reference. Raises InputError for a file that is neither,
    or is damaged, or is of another ``system``.

    A frozen reference answers at any time, and comes at ``t_eval``; what was saved answers at the times
    it was saved at. Without ``system`` a trajectory does without, a frozen reference has its own case.
    """
    path = Path(file)
    if not path.is_file():
        raise InputError("file", str(path), "exist")
    try:
        _read_all(path)
        with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as opened:
            data = opened.load()
            if "stiffbeam_frozen" in data.attrs:
                return thaw(data, path, system, None if t_eval is None else np.asarray(t_eval, float))
            return _from_dataset(data, path, system)
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError, IndexError) as error:
        raise InputError("file", str(path), "be a whole netCDF-4 file", str(error)) from None


def _read_all(path: Path) -> None:
    """Read every attribute and value once: a damaged file fails here, before xarray has it half open."""

    def read(name: str, item: h5py.Group | h5py.Dataset) -> None:
        dict(item.attrs)
        if isinstance(item, h5py.Dataset):
            item[()]

    with h5py.File(path) as file:
        dict(file.attrs)
        file.visititems(read)


def _from_dataset(data: xr.Dataset, path: Path, system: System | None) -> Trajectory:
    if data.attrs.get("stiffbeam_format") != FORMAT:
        found = data.attrs.get("stiffbeam_format")
        raise InputError("file", str(path), f"be a stiffbeam trajectory of format {FORMAT}", f"it has format {found}")
    if data.attrs.get("hash") != netcdf.content_hash(data, _HASHED):
        raise InputError("file", str(path), "hold what its hash says", "it is damaged: save the run again")
    if system is not None and system.fingerprint != data.attrs["fingerprint"]:
        raise InputError("file", str(path), "be of the system it is read with", "it is of another one")
    contacts = []
    for i, (lower, upper, stiffness) in enumerate(json.loads(data.attrs["stops"])):
        mine = data["impact_contact"].values == i
        impacts = Impacts(
            *(data[f"impact_{name}"].values[mine] for name in ("times", "stops", "peaks", "impulses")),
            kind=data.attrs["impact_kind"],
        )
        contacts.append(
            ContactRecord(
                stops=Stops(lower, upper, stiffness=stiffness),
                impacts=impacts,
                position=data["contact_position"].values[i],
                velocity=data["contact_velocity"].values[i],
                force=data["contact_force"].values[i],
                fraction=float(data["contact_fraction"].values[i]),
                peak_force=float(data["contact_peak_force"].values[i]),
                impulse=float(data["contact_impulse"].values[i]),
            )
        )
    work = json.loads(data.attrs["work"])
    common: dict[str, Any] = {
        "t": data["time"].values,
        "tip": data["tip"].values,
        "tip_velocity": data["tip_velocity"].values,
        "contacts": tuple(contacts),
        "work": Work(**work),
        "provenance": json.loads(data.attrs["provenance"]),
        "fingerprint": data.attrs["fingerprint"],
        "system": system,
    }
    if data.attrs["kind"] == "reference":
        run = Reference(**common, horizon=float(data.attrs["horizon"]), evaluate=_at_outputs(common))
    else:
        run = Trajectory(**common)
    if "ledger_kinetic" in data:
        run.__dict__["energy"] = Ledger(run.t, *(data[f"ledger_{name}"].values for name in _LEDGER))
    return run


def _at_outputs(saved: dict[str, Any]) -> Callable[[Array, int], tuple[Array, Array]]:
    """A contact's position and velocity at output times; the channel after the last contact is the tip."""

    def evaluate(times: Array, channel: int) -> tuple[Array, Array]:
        index = output_index(saved["t"], times, f"a saved {saved['provenance']['method']}")
        if channel < len(saved["contacts"]):
            contact = saved["contacts"][channel]
            return contact.position[index], contact.velocity[index]
        return saved["tip"][index], saved["tip_velocity"][index]

    return evaluate
