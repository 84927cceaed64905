"""Reading what was saved: trajectories and frozen references."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import xarray as xr
from numpy.typing import ArrayLike

from ..basics import netcdf
from ..basics.arrays import Array
from ..basics.validation import InputError, file_path, numbers
from ..march.integrate import Plan
from ..model.contact import Stops
from ..model.system import System, require_system
from ..references import solve
from ..schemes.labels import parse_run
from ..trajectory.dataset import FORMAT, HASHED, LEDGER
from ..trajectory.impacts import COLUMNS, OPEN_AT_START, ContactRecord, Impacts
from ..trajectory.ledger import Ledger
from ..trajectory.trajectory import Pieces, Reference, Trajectory, Work, output_index
from .frozen import load_frozen


def load(file: str | Path, system: System | None = None, t_eval: ArrayLike | None = None) -> Trajectory:
    """Read a file written by ``save`` or a frozen reference. Raises InputError for a file that is neither,
    or is damaged, or is of another ``system``.

    A frozen reference answers at any time, and comes at ``t_eval``; what was saved answers at the times
    it was saved at. Without ``system`` a trajectory does without, a frozen reference has its own case. With it
    a scheme's run and an exact solution have states and field too: made again on first use, since a run is a
    function of its arguments.
    """
    path = file_path("file", file, "give one that save() has written")
    if not path.is_file():
        raise InputError("file", str(path), "exist", "give one that save() has written")
    if path.suffix in (".csv", ".txt", ".npz", ".npy", ".mat"):
        remedy = "of columns of your own make stiffbeam.Trajectory.from_arrays(t, tip, system=system)"
        raise InputError("file", str(path), "be netCDF, as run.save('run.nc') writes it", remedy)
    if system is not None:
        require_system(system)
    t_eval = None if t_eval is None else numbers("t_eval", t_eval)
    try:
        netcdf.require_whole(path)
        with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as opened:
            data = opened.load()
            if "stiffbeam_frozen" in data.attrs:
                return load_frozen(data, path, system, t_eval)
            return _from_dataset(data, path, system)
    except InputError:
        raise
    except Exception as error:  # whatever xarray raises for what another tool has written
        remedy = f"it is damaged, make it again: {error}"
        raise InputError("file", str(path), "be a whole netCDF-4 file", remedy) from None


def _from_dataset(data: xr.Dataset, path: Path, system: System | None) -> Trajectory:
    if data.attrs.get("stiffbeam_format") != FORMAT:
        found = data.attrs.get("stiffbeam_format")
        raise InputError("file", str(path), f"be a stiffbeam trajectory of format {FORMAT}", f"it has format {found}")
    if data.attrs.get("hash") != netcdf.Arrays.of(data).hash(HASHED):
        raise InputError("file", str(path), "hold what its hash says", "it is damaged: save the run again")
    if system is not None and system.fingerprint != data.attrs["fingerprint"]:
        raise InputError("file", str(path), "be of the system it is read with", "it is of another one")
    contacts, kinds = [], data.attrs["impact_kind"].split(",")  # one for all contacts, or one for each
    for i, given in enumerate(json.loads(data.attrs["stops"])):
        mine = data["impact_contact"].values == i
        columns: Any = {name: data[f"impact_{name}"].values[mine] for name in COLUMNS}
        impacts = Impacts(**columns, kind=kinds[i % len(kinds)])
        if f"impact_{OPEN_AT_START}" in data:  # older files have no such rows
            impacts = impacts.started(data[f"impact_{OPEN_AT_START}"].values[mine] > 0)
        contacts.append(
            ContactRecord(
                stops=Stops.of(given),
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
        "read_for": data.attrs["fingerprint"],
        "system": system,
    }
    if data.attrs["kind"] == "reference":
        again = None if system is None else _states_of(system, common["provenance"])
        run = Reference(**common, horizon=float(data.attrs["horizon"]), evaluate=_at_outputs(common), state_at=again)
    else:
        run = Trajectory(**common, pieces=None if system is None else _pieces_of(system, common["provenance"]))
    if "ledger_kinetic" in data:
        run.__dict__["energy"] = Ledger(
            run.t, *(data[f"ledger_{name}"].values for name in LEDGER if f"ledger_{name}" in data)
        )
    return run


def _pieces_of(system: System, notes: dict[str, Any]) -> Pieces | None:
    """The states of a scheme's run, marched again; None for arrays of one's own and a scheme that no label makes."""
    if notes.get("source") == "arrays":
        return None
    try:
        scheme = parse_run(notes["method"])[0]
    except InputError:
        return None
    given = system.first_order() if notes["form"].endswith("first order") else system

    def pieces() -> Iterator[tuple[Array, Array, Array, Array]]:
        plan = Plan.of(given, scheme, notes["dt"], notes["t_end"], notes["contact"], 1, notes["engine"])
        return plan.states(given)

    return pieces


def _states_of(system: System, notes: dict[str, Any]) -> Callable[[Array], tuple[Array, Array]] | None:
    """The states of an exact solution, solved again; None for a solver that answers at its own times only."""
    if notes["method"] != "exact":
        return None

    def state_at(t: Array) -> tuple[Array, Array]:
        found = solve(system, notes["t_end"], "exact", None, 0.0, None)
        assert found.state_at is not None
        return found.state_at(t)

    return state_at


def _at_outputs(saved: dict[str, Any]) -> Callable[[Array, int], tuple[Array, Array]]:
    """A contact's position and velocity at output times; the channel after the last contact is the tip."""

    def evaluate(times: Array, channel: int) -> tuple[Array, Array]:
        index = output_index(saved["t"], times, f"a saved {saved['provenance']['method']}")
        if channel < len(saved["contacts"]):
            contact = saved["contacts"][channel]
            return contact.position[index], contact.velocity[index]
        return saved["tip"][index], saved["tip_velocity"][index]

    return evaluate
