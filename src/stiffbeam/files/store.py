"""Read saved trajectories and stored references, and store a multiprecision solution.

A stored ("frozen") reference is a small file from which float64 computes the solution at any time. It has every event
time, and the full state at some of the events. From one of these states to the next float64 loses only a few digits.
Integrating again between them gives the solution at any time within the stated bound, past the float64 horizon too.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.storage import content_hash, read_netcdf, write_netcdf
from ..basics.text import printable
from ..basics.validation import InputError, file_path, numbers
from ..march.integrate import Plan
from ..model.contact import Stops
from ..model.system import System, require_system
from ..references import solve
from ..references.exact.motion import Motion, Solver, fresh_after, joined
from ..references.exact.solution import reference_of
from ..schemes.labels import scheme_at_hand
from ..trajectory.records import ContactRecord, Impacts, Ledger
from ..trajectory.schema import FORMAT, IMPACT_FIELDS, LEDGER_FIELDS
from ..trajectory.trajectory import Pieces, Reference, Trajectory, Work

if TYPE_CHECKING:
    import xarray as xr

FROZEN_FORMAT = 1
BOUND = 1e-9  # of max |u| and of the times: the accuracy that re-marching may lose


def can_freeze(reference: Reference) -> bool:
    """Return True if the solution is multiprecision and confirmed to its end."""
    t_end = float(reference.provenance["t_end"])
    return reference.provenance["method"] == "multiprecision" and reference.horizon >= t_end


def freeze(reference: Reference, file: str | Path) -> Path:
    """Write a multiprecision ``reference`` to a file, which is read together with its system.

    So many states are stored that the file, read back, gives the reference within a tenth of ``BOUND``; that is tried
    before anything is written. Raises InputError where the reference is not confirmed to its end.
    """
    t_end = float(reference.provenance["t_end"])
    if not can_freeze(reference):
        raise InputError("reference", reference.label, "be multiprecision and confirmed to t_end", "give more digits")
    assert reference.system is not None
    solution: Motion = reference.solution
    # Fewer segments from one state to the next, until what float64 loses between them is small.
    for every in (32, 16, 8, 4, 2, 1):
        data = _arrays(reference, solution, t_end, np.arange(0, len(solution.times), every))
        deviation = _deviation(data, solution, reference)
        if deviation <= 0.1 * BOUND:
            break
    if deviation > BOUND:
        raise InputError("reference", f"{deviation:.1e} off", f"be re-marched to {BOUND:g}", "report this case")
    # Attributes of the trial, then the hash of the whole.
    data.attrs["bound"] = BOUND
    data.attrs["deviation"] = deviation
    data.attrs["hash"] = content_hash(data)
    return write_netcdf(data, file, compression=9)


def _load_frozen(data: xr.Dataset, path: Path, system: System | None, t_eval: Array | None) -> Reference:
    """The Reference in an opened file; its events are computed again. t_eval: output times, by default 2001."""
    begun = time.perf_counter()
    if data.attrs["stiffbeam_frozen"] != FROZEN_FORMAT:
        remedy = f"it has {data.attrs['stiffbeam_frozen']}: remake it"
        raise InputError("file", str(path), f"be of format {FROZEN_FORMAT}", remedy)
    if system is None:
        rule = "be read together with its system"
        raise InputError("file", str(path), rule, "it holds events and states: stiffbeam.load(file, system)")
    t_end, notes = float(data.attrs["t_end"]), json.loads(data.attrs["provenance"])
    # The integration that was tried when the file was made.
    solution = _march(system, data, str(path))
    return replace(reference_of(solution, t_end, t_eval, begun, "multiprecision", notes), horizon=t_end)


def _arrays(reference: Reference, solution: Motion, t_end: float, stored: Array) -> xr.Dataset:
    """Event times, and states at the start of the segments ``stored``."""
    assert reference.system is not None
    sides = solution.sides.astype(np.int8)
    # A single contact needs no second dimension.
    sides = sides[:, 0] if sides.shape[1] == 1 else sides
    q, v = solution.states(solution.times[stored], stored)
    keep = ("digits", "digits_confirmed_with", "horizon", "horizon_against", "horizon_tolerance", "parameters",
            "python-flint", "numpy")  # fmt: skip
    attributes = {
        "title": f"stiffbeam frozen reference, {reference.provenance['form']} form",
        "stiffbeam_frozen": FROZEN_FORMAT,
        "source": f"stiffbeam {version('stiffbeam')}",
        "form": reference.provenance["form"],
        "t_end": t_end,
        "fingerprint": reference.fingerprint,
        "provenance": json.dumps({key: reference.provenance[key] for key in keep}),
    }
    variables = {
        "switch_time": (("switch",), solution.times, "start of every piece"),
        "side": (("switch", "contact")[: sides.ndim], sides, "+1 upper stop, -1 lower, 0 free"),
        "stored_switch": (("stored",), stored.astype(np.int32), "the switch a state belongs to"),
        "q": (("stored", "node"), q, "displacement v = u - phi (1 - (x/L)^2) at the nodes"),
        "q_rate": (("stored", "node"), v, "its rate"),
    }
    import xarray as xr

    return xr.Dataset(
        {name: (*entry[:2], {"long_name": entry[2]}) for name, entry in variables.items()}, attrs=attributes
    )


def _march(system: System, data: xr.Dataset, source: str) -> Motion:
    """Integrate again from stored state to stored state, and compare every event with the file."""
    solver = Solver(system)
    times, sides = data["switch_time"].values, data["side"].values.astype(np.int64)
    sides = sides[:, None] if sides.ndim == 1 else sides
    stored, t_end = data["stored_switch"].values, float(data.attrs["t_end"])
    parts: list[Motion] = []
    ends = np.append(times, t_end)
    for row, piece in enumerate(stored):
        last = stored[row + 1] if row + 1 < len(stored) else len(times)
        # To the middle of the segment after the span, so that rounding cannot hide its last event.
        until = 0.5 * (ends[last] + ends[last + 1]) if last < len(times) else t_end
        start = data["q"].values[row], data["q_rate"].values[row]
        fresh = fresh_after(system, sides[max(piece - 1, 0)].tolist(), sides[piece].tolist())
        part = solver.trace(float(times[piece]), np.ascontiguousarray(sides[piece]), fresh, start, float(until))
        # The events must be those of the file, in sides and in times.
        count = last - piece
        same = len(part.times) >= count and np.array_equal(part.sides[:count], sides[piece:last])
        if not same or np.max(np.abs(part.times[:count] - times[piece:last])) > BOUND * t_end:
            raise InputError("file", source, "give the switches it lists", "it is damaged: remake it")
        parts.append(part.first(count))
    return joined(parts)  # with the times re-marched, to which the coefficients belong


def _deviation(data: xr.Dataset, a: Motion, reference: Reference) -> float:
    """Largest difference in position of a contact or the tip over max |u|, in the middle of every segment, between
    ``a`` and the motion from the file; infinite if the events differ."""
    assert reference.system is not None
    try:
        b = _march(reference.system, data, "the file to be")
    except InputError:
        return float("inf")
    # In the middle of segments, farthest from the events.
    t = 0.5 * (a.times + np.append(a.times[1:], float(reference.provenance["t_end"])))
    difference = np.abs(_positions(reference.system, a, t) - _positions(reference.system, b, t))
    return float(np.max(difference) / np.max(np.abs(reference.tip)))


def _positions(system: System, solution: Motion, t: Array) -> Array:
    """Positions of every channel, (times, channels)."""
    return np.stack([solution.observed(t, row)[0] for row, _ in system.channels], axis=-1)


def load(file: str | Path, system: System | None = None, t_eval: ArrayLike | None = None) -> Trajectory:
    """Return the run of a file that ``save`` has written, or of a frozen reference.

    Parameters
    ----------
    file : path
    system : System, optional
        The system that the run is of. With it a scheme's run and an exact solution have states and the field over x
        again: they are computed anew. So an exact solution answers ``at`` any time. Without it a trajectory has what
        the file holds; a frozen reference needs it.
    t_eval : array (k,), optional
        Output times of a frozen reference, which answers at any time.

    Returns
    -------
    Trajectory
        A Reference where the file holds one.

    Raises
    ------
    InputError
        For a file of another kind, a damaged file, and a file of another ``system``.

    Examples
    --------
    >>> import tempfile
    >>> import stiffbeam as sb
    >>> run = sb.integrate(sb.paper_case(10).system(), sb.HHT(alpha=-0.1), dt=1e-4, t_end=0.1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     again = sb.load(run.save(f"{folder}/run.nc"))
    >>> bool((again.tip == run.tip).all())
    True
    """
    path = file_path("file", file, "give one that save() has written")
    if not path.is_file():
        raise InputError("file", str(path), "exist", "give one that save() has written")
    if path.suffix in (".csv", ".json", ".txt", ".npz", ".npy"):
        remedy = "of columns of your own make stiffbeam.Trajectory.from_arrays(t, tip, system=system)"
        raise InputError("file", str(path), "be netCDF, as run.save('run.nc') writes it", remedy)
    if system is not None:
        require_system(system)
    t_eval = None if t_eval is None else numbers("t_eval", t_eval)
    try:
        data = read_netcdf(path)
        known = (data.attrs.get("stiffbeam_frozen"), data.attrs.get("stiffbeam_format")) in (
            (FROZEN_FORMAT, None),
            (None, FORMAT),
        )
        if known and data.attrs.get("hash") != content_hash(data):
            raise InputError("file", str(path), "hold what its hash says", "it is damaged: make it again")
        if known and system is not None and system.fingerprint != data.attrs["fingerprint"]:
            remedy = "it is of another one: read it with that"
            raise InputError("file", str(path), "be of the system it is read with", remedy)
        if "stiffbeam_frozen" in data.attrs:
            return _load_frozen(data, path, system, t_eval)
        return _from_arrays(data, path, system)
    except InputError:
        raise
    except Exception as error:  # a file that another tool has written may lack anything
        remedy = f"make it again: {error}"
        raise InputError("file", str(path), "be a whole netCDF-4 file", remedy) from None


def _from_arrays(data: xr.Dataset, path: Path, system: System | None) -> Trajectory:
    # Kind of file, content and system, in this order.
    if data.attrs.get("stiffbeam_format") != FORMAT:
        rule = f"be a stiffbeam trajectory of format {FORMAT}"
        remedy = f"it has format {data.attrs.get('stiffbeam_format')}: save the run again"
        raise InputError("file", str(path), rule, remedy)
    if data.attrs["kind"] == "ensemble":
        raise InputError("file", str(path), "hold one run", "it is an ensemble: xarray.open_dataset reads it")
    contacts, kinds = [], data.attrs["impact_kind"].split(",")
    for i, stops_data in enumerate(json.loads(data.attrs["stops"])):
        mine = data["impact_contact"].values == i
        columns: Any = {field: data[name].values[mine] for field, name in IMPACT_FIELDS.items()}
        impacts = Impacts(**columns, kind=kinds[i]).started(data["impact_open_at_start"].values[mine] > 0)
        contacts.append(
            ContactRecord(
                stops=Stops(**stops_data),
                impacts=impacts,
                position=data["contact_position"].values[i],
                velocity=data["contact_velocity"].values[i],
                force=data["contact_force"].values[i],
                fraction=float(data["contact_fraction"].values[i]),
                peak_force=float(data["contact_peak_force"].values[i]),
                impulse=float(data["contact_impulse"].values[i]),
            )
        )
    work, notes = json.loads(data.attrs["work"]), json.loads(data.attrs["provenance"])
    notes = {name: printable(x) if isinstance(x, str) else x for name, x in notes.items()}
    common: dict[str, Any] = {
        "t": data["time"].values,
        "tip": data["tip"].values,
        "tip_velocity": data["tip_velocity"].values,
        "contacts": tuple(contacts),
        "work": Work(**work),
        "provenance": notes,
        "stored_fingerprint": data.attrs["fingerprint"],
        "system": system,
    }
    if data.attrs["kind"] == "reference":
        horizon, provenance = float(data.attrs["horizon"]), common["provenance"]
        if system is not None and provenance["method"] == "exact":  # solved again, it answers at any time
            solved = solve(system, provenance["t_end"], "exact", common["t"], 0.0, None)
            return replace(solved, horizon=horizon, work=common["work"], provenance=provenance)
        run = Reference(**common, horizon=horizon)
    else:  # its states are computed on first use
        run = Trajectory(**common, pieces=None if system is None else _pieces_of(system, common["provenance"]))
    energies = {field: data[name].values for field, name in LEDGER_FIELDS.items() if name in data}
    # The cached property is filled in: without states nothing could compute it.
    if energies:
        run.__dict__["energy"] = Ledger(run.t, **energies)
    return run


def _pieces_of(system: System, notes: dict[str, Any]) -> Pieces | None:
    """The states of a scheme's run, integrated again; None for arrays of another program and for a scheme that its
    label does not define."""
    if notes.get("source") == "arrays":
        return None
    scheme = scheme_at_hand(notes["method"])
    if scheme is None:
        return None

    def pieces() -> Iterator[tuple[Array, Array, Array, Array]]:
        plan = Plan(system, scheme, notes["dt"], notes["t_end"], notes["contact"])
        return plan.states(system)

    return pieces
