"""Table of all variables of results: name, dimensions, unit and meaning; and the files that hold them.

Attributes, DataFrames, Datasets and files of every format are walks over ``SCHEMA``; the documentation prints it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Container, Iterable
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.storage import content_hash, write_netcdf, write_whole
from ..basics.text import plain, table
from ..basics.units import Units, unit_of
from ..basics.validation import InputError, file_path, near
from ..model.members import STARTS, SYSTEMS

if TYPE_CHECKING:
    import pandas
    import xarray

    from .ensemble import Ensemble
    from .trajectory import Trajectory

FORMAT = 3  # of files
CONVENTIONS = "CF-1.11"
IMPACTS, ENERGY = "contacts[i].impacts", "energy"  # owners of attributes


@dataclass(frozen=True)
class Variable:
    """Definition of one quantity of a result.

    name: in every table and file, and as ``run[name]``. dims: of a run; an ensemble has the dimension member too.
    quantity: what its unit follows from, see ``unit_of``; "" for a number without dimension. attribute: of the
    Trajectory that holds the values.
    """

    name: str
    dims: tuple[str, ...]
    quantity: str
    long_name: str
    attribute: str

    @property
    def owner(self) -> str:
        """The object that holds the values: "contacts[i]", "contacts[i].impacts", "energy", or "" for the run."""
        return self.attribute.rpartition(".")[0]

    @property
    def field(self) -> str:
        """The name of the values on their owner."""
        return self.attribute.rpartition(".")[2].removesuffix("(x)")

    def notes(self, units: Units) -> dict[str, str]:
        """Return long_name and units: "1" without dimension, left out where the case names none."""
        unit = unit_of(units, self.quantity) if self.quantity else "1"
        return {"long_name": self.long_name} | ({"units": unit} if unit else {})


T, C, IM, CT, TX = ("time",), ("contact",), ("impact",), ("contact", "time"), ("time", "x")
SCHEMA = tuple(
    Variable(*row)
    for row in (
        ("time", T, "time", "time", "t"),
        ("tip", T, "length", "displacement of the tip, or of the observed point", "tip"),
        ("tip_velocity", T, "velocity", "velocity of the tip, or of the observed point", "tip_velocity"),
        ("displacement", TX, "length", "displacement u(x, t)", "displacement(x)"),
        ("velocity", TX, "velocity", "velocity u_t(x, t)", "velocity(x)"),
        ("contact_position", CT, "length", "position of the contact point against its stops", "contacts[i].position"),
        ("contact_velocity", CT, "velocity", "velocity of the contact point", "contacts[i].velocity"),
        ("contact_force", CT, "force", "contact force sigma on the beam, negative on the upper stop",
         "contacts[i].force"),
        ("contact_fraction", C, "", "share of time in contact", "contacts[i].fraction"),
        ("contact_peak_force", C, "force", "largest |sigma|", "contacts[i].peak_force"),
        ("contact_impulse", C, "impulse", "integral of |sigma|", "contacts[i].impulse"),
        ("contact_open_at_start", C, "", "1: in contact at t = 0, which is no impact", "contacts[i].open_at_start"),
        ("impact_count", C, "", "number of impacts", "contacts[i].impact_count"),
        ("impact_time", IM, "time", "time of impact", "contacts[i].impacts.times"),
        ("impact_end", IM, "time", "time at which the contact ends", "contacts[i].impacts.ends"),
        ("impact_stop", IM, "", "+1 upper stop, -1 lower stop", "contacts[i].impacts.stops"),
        ("impact_peak_force", IM, "force", "largest |sigma| of the impact", "contacts[i].impacts.peaks"),
        ("impact_impulse", IM, "impulse", "integral of |sigma| over the impact", "contacts[i].impacts.impulses"),
        ("impact_open_at_start", IM, "", "1: contact that is there at t = 0, which is no impact",
         "contacts[i].impacts.at_start"),
        ("energy_kinetic", T, "energy", "kinetic energy", "energy.kinetic"),
        ("energy_elastic", T, "energy", "bending energy", "energy.elastic"),
        ("energy_stops", T, "energy", "energy in the stops", "energy.stops"),
        ("energy_input", T, "energy", "work of loads and moving stops since t = 0", "energy.input"),
        ("energy_viscous", T, "energy", "viscous loss since t = 0", "energy.viscous"),
        ("energy_loss", T, "energy", "numerical loss since t = 0", "energy.loss"),
        ("energy_loss_in_contact", T, "energy", "numerical loss in steps with contact", "energy.loss_in_contact"),
        ("energy_loss_without_contact", T, "energy", "numerical loss in steps without contact",
         "energy.loss_without_contact"),
        ("energy_stop_dissipation", T, "energy", "energy that damped stops took since t = 0",
         "energy.stop_dissipation"),
        ("energy_spread", T, "energy", "difference of two rules for what dampers and stops took since t = 0",
         "energy.spread"),
        ("diverged", (), "time", "time at which the run overflowed, NaN for none", "diverged"),
    )
)  # fmt: skip
COORDINATES = tuple(
    Variable(*row)
    for row in (
        ("contact", C, "", "number of the contact", ""),
        ("impact", IM, "", "number of the row among the impacts of all contacts", ""),
        ("member", ("member",), "", "number of the ensemble member", ""),
        ("x", ("x",), "length", "position along the beam", ""),
        ("impact_contact", IM, "", "contact of the impact", ""),
        ("impact_member", IM, "", "ensemble member of the impact", ""),
    )
)
BY_NAME = {variable.name: variable for variable in (*SCHEMA, *COORDINATES)}
IMPACT_FIELDS = {v.field: v.name for v in SCHEMA if v.owner == IMPACTS and v.field != "at_start"}
LEDGER_FIELDS = {v.field: v.name for v in SCHEMA if v.owner == ENERGY}
Values = dict[str, tuple[tuple[str, ...], Any]]


def named(result: Any, name: str) -> Any:
    """The values of one variable of a run or an ensemble. Raises InputError for a variable that it lacks."""
    if name in BY_NAME:  # an energy is worked out only where it is asked for
        values = values_of(result, None, {name})
    else:
        values = _coordinates(result, (), None, hasattr(result, "members"))
    if name not in values:
        known = [*BY_NAME] if name not in BY_NAME else [each for each in values_of(result) if each != name]
        raise InputError("variable", name, "be one that the result holds", near(name, known))
    return values[name][1]


def values_of(result: Any, x: Any = None, wanted: Container[str] = BY_NAME) -> Values:
    """Dimensions and values of all variables of a run or an ensemble, by the names of the schema.

    x: positions along the beam at which the field is wanted. wanted: the names to look for, all by default. The rows of
    impacts are those of all contacts, one contact after the other, and begin with the contact at t = 0 where there is
    one.
    """
    many = hasattr(result, "members")
    contacts, values = result.contacts, dict[str, tuple[tuple[str, ...], Any]]()
    impacts, flags = zip(*(contact.impacts.listed() for contact in contacts), strict=True) if contacts else ((), ())
    for variable in SCHEMA:
        if variable.name not in wanted:
            continue
        # By owner: the run itself (none), its energy, the impacts of its contacts, its contacts.
        owner, field, dims = variable.owner, variable.field, variable.dims
        if dims == TX:
            if x is not None:
                values[variable.name] = (dims, getattr(result, field)(x))
        elif owner == ENERGY:
            if getattr(result, "has_energy", False):
                values[variable.name] = (dims, getattr(result.energy, field))
        elif not owner:
            numbers = getattr(result, field)
            if many and variable.name != "time":
                dims = ("member", *dims)
            if dims and (np.size(numbers) or not many):  # of a run that has not overflowed there is nothing to say
                values[variable.name] = (dims, numbers)
        elif contacts and owner == IMPACTS:
            each = flags if field == "at_start" else [getattr(table, field) for table in impacts]
            column = np.concatenate(each)
            # netCDF has no Boolean type.
            values[variable.name] = (dims, column.astype(np.int64) if column.dtype == bool else column)
        elif contacts and hasattr(contacts[0], field):
            rows = np.stack([getattr(contact, field) for contact in contacts])
            values[variable.name] = ((*dims, "member") if many else dims, rows.astype(np.int64)
                                     if rows.dtype == bool else rows)  # fmt: skip
    return values | _coordinates(result, impacts, x, many)


def _coordinates(result: Any, impacts: Iterable[Any], x: Any, many: bool) -> Values:
    """The coordinates of all dimensions but time, which is a quantity; the varied parameter by its name."""
    values: Values = {}
    contacts = result.contacts
    if contacts:
        counts = [table.count for table in impacts]
        values["contact"] = (C, np.arange(len(contacts)))
        values["impact"] = (IM, np.arange(sum(counts)))
        values["impact_contact"] = (IM, np.repeat(np.arange(len(counts)), counts))
    if x is not None:
        values["x"] = (("x",), np.asarray(x, float))
    if many:
        members = np.arange(len(result))
        values["member"] = (("member",), members)
        if contacts:
            each = [np.repeat(members, contact.impact_count) for contact in contacts]
            values["impact_member"] = (IM, np.concatenate(each))
        # A varied number is a coordinate by its path.
        if result.values is not None and result.members.parameter not in (STARTS, SYSTEMS):
            values[parameter_name(result.members.parameter)] = (("member",), result.values)
    return values


def parameter_name(parameter: str) -> str:
    """The name of the coordinate that holds the varied parameter: its path, ``stops[0].stiffness``."""
    name = re.sub(r"[^\w.\[\]]+", "_", parameter).strip("_") or "value"
    return f"{name}_value" if name in BY_NAME else name


def notes_of(values: Values, units: Units) -> dict[str, dict[str, str]]:
    """Attributes of every variable: long_name and units."""
    return {
        name: BY_NAME[name].notes(units) if name in BY_NAME else {"long_name": f"value of {name} in the member"}
        for name in values
    }


def frame_of(values: Values, index: str, units: Units | None = None, **attributes: Any) -> pandas.DataFrame:
    """The table with one row for each entry of the dimension ``index``: a column for each variable along it, and
    ``contact_force_0``, ``contact_force_1`` for one that every contact has. attrs: units by column, and more."""
    columns: dict[str, Any] = {}
    unit: dict[str, str] = {}
    for name, (dims, array) in values.items():
        each = {name: array} if dims == (index,) else {}
        # A column for every contact.
        if len(dims) == 2 and set(dims) == {"contact", index}:
            each = {f"{name}_{i}": row for i, row in enumerate(array)}
        columns |= each
        if units is not None and name in BY_NAME:
            unit |= dict.fromkeys(each, BY_NAME[name].notes(units).get("units", ""))
    frame = table(columns, attributes | ({"units": unit} if units is not None else {}))
    return frame.set_index(index) if index in columns else frame.rename_axis(index)


HASHED = ("stiffbeam_format", "kind", "fingerprint", "provenance", "work", "stops", "impact_kind", "horizon")
SUFFIXES = (".nc", ".nc4", ".h5", ".csv", ".mat", ".json")


def dataset_of(result: Trajectory | Ensemble, x: Any = None) -> xarray.Dataset:
    """All variables of a run or an ensemble with their attributes; the provenance is an attribute of the whole."""
    import xarray

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
    coordinates = [name for name in data if name not in BY_NAME or name in {v.name for v in COORDINATES}]
    dataset = xarray.Dataset(data, attrs=attributes).set_coords(coordinates)
    dataset.attrs["hash"] = content_hash(dataset, HASHED)
    return dataset


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
    data = dataset_of(result)
    if suffix == ".json":
        return write_whole(file, json.dumps(plain(data.to_dict()), allow_nan=False) + "\n")
    if suffix == ".mat":
        return _write_mat(data, file)
    return write_netcdf(data, file, compression=4 if result.kind == "ensemble" else 0)


def _write_mat(data: xarray.Dataset, file: str | Path) -> Path:
    """A MATLAB 5 file: every variable by name, one along time, impacts or members as a column; structs ``units`` and
    ``long_name``; ``provenance`` as JSON. A parameter's path becomes a name: ``stops_0_stiffness``."""
    from scipy.io import savemat

    content: dict[str, Any] = {}
    notes: dict[str, dict[str, str]] = {"units": {}, "long_name": {}}
    for written, variable in data.variables.items():
        name, column, attributes = re.sub(r"\W+", "_", str(written)).strip("_"), variable.values, variable.attrs
        content[name] = column[:, None] if column.ndim == 1 else column
        for key, texts in notes.items():
            if key in attributes:
                texts[name] = attributes[key]
    buffer = BytesIO()
    content |= notes | {"provenance": data.attrs["provenance"]}
    savemat(buffer, content, appendmat=False, long_field_names=True)
    return write_whole(file, buffer.getvalue())


GIVEN_TIMES = "for a comparison pass t_eval=run.t, or numpy.unique(t) for arrays (t, tip)"


def output_index(t: Array, times: Array, method: str) -> NDArray[np.int64]:
    """Indices of ``times`` among the output times t. Raises InputError for any other time."""
    index = np.clip(np.searchsorted(t, times - 1e-12 * t[-1]), 0, len(t) - 1)
    if np.any(np.abs(t[index] - times) > 1e-11 * t[-1]):
        raise InputError("t", "new times", f"be among t_eval for {method}", GIVEN_TIMES)
    return index
