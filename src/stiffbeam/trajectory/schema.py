"""Table of all variables of results: name, unit and meaning; and the files that hold them.

Attributes, DataFrames, Datasets and files of every format have the names of ``VARIABLES``.
"""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.storage import content_hash, write_netcdf, write_whole
from ..basics.text import Units, plain, unit_of
from ..basics.validation import InputError, file_path, numbers

if TYPE_CHECKING:
    import pandas
    import xarray

FORMAT = 4  # of files
CONVENTIONS = "CF-1.11"

VARIABLES = {  # name: quantity, from which the unit follows, see ``Units``, "" for none; meaning
    "time": ("time", "time"),
    "tip": ("length", "displacement of the tip, or of the observed point"),
    "tip_velocity": ("velocity", "velocity of the tip, or of the observed point"),
    "displacement": ("length", "displacement u(x, t)"),
    "velocity": ("velocity", "velocity u_t(x, t)"),
    "contact_position": ("length", "position of the contact point against its stops"),
    "contact_velocity": ("velocity", "velocity of the contact point"),
    "contact_force": ("force", "contact force sigma on the beam, negative on the upper stop"),
    "contact_fraction": ("", "share of time in contact"),
    "contact_peak_force": ("force", "largest |sigma|"),
    "contact_impulse": ("impulse", "integral of |sigma|"),
    "contact_open_at_start": ("", "1: in contact at t = 0, which is no impact"),
    "impact_count": ("", "number of impacts"),
    "impact_time": ("time", "time of impact"),
    "impact_end": ("time", "time at which the contact ends"),
    "impact_stop": ("", "+1 upper stop, -1 lower stop"),
    "impact_peak_force": ("force", "largest |sigma| of the impact"),
    "impact_impulse": ("impulse", "integral of |sigma| over the impact"),
    "impact_open_at_start": ("", "1: contact that is there at t = 0, which is no impact"),
    "energy_kinetic": ("energy", "kinetic energy"),
    "energy_elastic": ("energy", "bending energy"),
    "energy_stops": ("energy", "energy in the stops"),
    "energy_input": ("energy", "work of loads and moving stops since t = 0"),
    "energy_viscous": ("energy", "viscous loss since t = 0"),
    "energy_loss": ("energy", "numerical loss since t = 0"),
    "energy_loss_in_contact": ("energy", "numerical loss in steps with contact"),
    "energy_loss_without_contact": ("energy", "numerical loss in steps without contact"),
    "energy_stop_dissipation": ("energy", "energy that damped stops took since t = 0"),
    "energy_spread": ("energy", "difference of two rules for what dampers and stops took since t = 0"),
    "diverged": ("time", "time at which the run overflowed, NaN for none"),
}
COORDINATES = {
    "contact": ("", "number of the contact"),
    "impact": ("", "number of the row among the impacts of all contacts"),
    "member": ("", "number of the ensemble member"),
    "x": ("length", "position along the beam"),
    "impact_contact": ("", "contact of the impact"),
    "impact_member": ("", "ensemble member of the impact"),
}
BY_NAME = VARIABLES | COORDINATES
CONTACT_FIELDS = {name.removeprefix("contact_"): name for name in VARIABLES if name.startswith("contact_")}
CONTACT_FIELDS["impact_count"] = "impact_count"
LEDGER_FIELDS = {name.removeprefix("energy_"): name for name in VARIABLES if name.startswith("energy_")}
IMPACT_FIELDS = {
    "times": "impact_time", "ends": "impact_end", "stops": "impact_stop", "peaks": "impact_peak_force",
    "impulses": "impact_impulse",
}  # fmt: skip
Values = dict[str, tuple[tuple[str, ...], Any]]


def values_of(result: Any, x: Any = None) -> Values:
    """Dimensions and values of all variables of a run or an ensemble.

    x: positions along the beam at which the field is wanted. The rows of impacts are those of all contacts, one contact
    after the other, and begin with the contact at t = 0 where there is one.
    """
    many, contacts = hasattr(result, "members"), result.contacts
    member, values = ("member",) if many else (), Values()
    if not many or len(result.t):
        values["time"] = (("time",), result.t)
        values |= {name: ((*member, "time"), getattr(result, name)) for name in ("tip", "tip_velocity")}
    if x is not None:
        values |= {name: (("time", "x"), getattr(result, name)(x)) for name in ("displacement", "velocity")}
        values["x"] = (("x",), np.asarray(x, float))
    if contacts:
        for field, name in CONTACT_FIELDS.items():
            if hasattr(contacts[0], field):
                rows = 1 * np.stack([getattr(contact, field) for contact in contacts])  # netCDF has no Boolean type
                values[name] = (("contact", *(member or ("time",)))[: rows.ndim], rows)
        values |= _impacts(contacts)
        values["contact"] = (("contact",), np.arange(len(contacts)))
    if getattr(result, "has_energy", False):
        values |= {name: (("time",), getattr(result.energy, field)) for field, name in LEDGER_FIELDS.items()}
    if many:
        values["diverged"], values["member"] = (member, result.diverged), (member, np.arange(len(result)))
        if contacts:
            each = [np.repeat(np.arange(len(result)), contact.impact_count) for contact in contacts]
            values["impact_member"] = (("impact",), np.concatenate(each))
        # A varied number is a coordinate by its path.
        values |= {parameter_name(path): (member, np.asarray(x)) for path, x in result.members.parameters.items()}
    return values


def _impacts(contacts: Any) -> Values:
    """The impacts of all contacts, with the contact and the number of each."""
    tables, flags = zip(*(contact.impacts.listed() for contact in contacts), strict=True)
    counts = [rows.count for rows in tables]
    columns = {name: np.concatenate([getattr(rows, x) for rows in tables]) for x, name in IMPACT_FIELDS.items()}
    columns["impact_open_at_start"] = 1 * np.concatenate(flags)
    columns |= {"impact": np.arange(sum(counts)), "impact_contact": np.repeat(np.arange(len(counts)), counts)}
    return {name: (("impact",), column) for name, column in columns.items()}


def parameter_name(parameter: str) -> str:
    """The name of the coordinate that holds the varied parameter: its path, ``stops[0].stiffness``."""
    name = re.sub(r"[^\w.\[\]]+", "_", parameter).strip("_") or "value"
    return f"{name}_value" if name in BY_NAME else name


def notes_of(name: str, units: Units) -> dict[str, str]:
    """Attributes long_name and units of a variable. The unit is "1" without dimension; that of matrices is unknown and
    left out, as is that of a parameter."""
    if name not in BY_NAME:
        return {"long_name": f"value of {name} in the member"}
    quantity, long_name = BY_NAME[name]
    unit = unit_of(units, quantity) if quantity else "1"
    return {"long_name": long_name} | ({"units": unit} if unit else {})


class Saved:
    """Label, units and files of a run or an ensemble."""

    kind = "run"  # in files
    provenance: dict[str, Any]

    @property
    def label(self) -> str:
        """Method and form, e.g. ``HHT(alpha=-0.1)@displacement``."""
        return f"{self.provenance['method']}@{self.provenance['form']}"

    @property
    def units(self) -> Units:
        """Names of the units of length, time and force."""
        return tuple(self.provenance.get("units", ()))

    def to_dataframe(self: Any) -> pandas.DataFrame:
        """Return a row for each output time of a run, or each member of an ensemble, the index.

        Of a run: tip, tip_velocity, ``contact_force_0`` and so on of every contact, and the energies if the run has an
        energy balance. Of an ensemble: each varied parameter by its path, ``diverged``, and ``impact_count_0``,
        ``contact_fraction_0``, ... of every contact.
        """
        import pandas

        index, columns = "member" if self.kind == "ensemble" else "time", dict[str, Any]()
        for name, (dims, array) in values_of(self).items():
            if dims == (index,):
                columns[name] = array
            elif len(dims) == 2 and set(dims) == {"contact", index}:
                columns |= {f"{name}_{i}": row for i, row in enumerate(array)}
        return pandas.DataFrame(columns).set_index(index)

    def to_xarray(self: Any, x: ArrayLike | None = None) -> xarray.Dataset:
        """All variables as an xarray.Dataset with units, provenance as attributes; of a run, with positions x along the
        beam, also displacement(time, x) and velocity(time, x)."""
        import xarray

        values = values_of(self, None if x is None else numbers("x", np.atleast_1d(x)))
        data = {name: (dims, array, notes_of(name, self.units)) for name, (dims, array) in values.items()}
        attributes: dict[str, Any] = {
            "Conventions": CONVENTIONS,
            "title": f"stiffbeam {self.kind}: {self.label}",
            "source": f"stiffbeam {self.provenance.get('stiffbeam', '')}".strip(),
            "stiffbeam_format": FORMAT,
            "kind": self.kind,
            "fingerprint": self.fingerprint,
            "provenance": json.dumps(plain(self.provenance)),
            "work": json.dumps(asdict(self.work)),
            "stops": json.dumps([asdict(stops) for stops in self.stops]),
            "impact_kind": ",".join(c.impacts.kind for c in self.contacts) or "none",
        }
        attributes |= {"horizon": self.horizon} if self.kind == "reference" else {}
        coordinates = [name for name in data if name not in VARIABLES]
        dataset = xarray.Dataset(data, attrs=attributes).set_coords(coordinates)
        dataset.attrs["hash"] = content_hash(dataset)
        return dataset

    def save(self: Any, file: str | Path) -> Path:
        """Write it in the format that the suffix names; an interrupted write leaves no file.

        .nc: netCDF-4 with everything, which alone ``stiffbeam.load`` reads. .json: the same, in the layout of
        ``xarray.Dataset.to_dict``. .csv: ``to_dataframe()``, a line for each output time or member; impacts have a
        table of their own, ``run.impacts.to_dataframe()``. Raises InputError for any other suffix.
        """
        suffix = file_path("file", file).suffix.lower()
        if suffix == ".csv":
            return write_whole(file, self.to_dataframe().to_csv())
        if suffix == ".json":
            return write_whole(file, json.dumps(plain(self.to_xarray().to_dict()), allow_nan=False) + "\n")
        if suffix != ".nc":
            raise InputError("file", str(file), "end in .nc, .json or .csv", f"name it {Path(file).stem}.nc")
        return write_netcdf(self.to_xarray(), file, compression=4 if self.kind == "ensemble" else 0)
