"""Read saved trajectories and frozen references, and keep references in the cache directory.

A frozen reference is a small file from which float64 computes a multiprecision solution at any time. It has every event
time, and the full state at some of the events. From one of these states to the next float64 loses only a few digits.
Integrating again between them gives the solution at any time within the stated bound, past the float64 horizon too.
"""

from __future__ import annotations

import hashlib
import json
import platform
import time
import warnings
from dataclasses import replace
from importlib.metadata import version
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics import storage
from ..basics.resources import Show
from ..basics.storage import content_hash, read_netcdf, write_netcdf
from ..basics.text import printable
from ..basics.validation import InputError, file_path, numbers
from ..model.contact import Stops
from ..model.system import System, require_system
from ..references import reference, solve
from ..references.exact.motion import Motion, Solver, fresh_after, joined
from ..references.exact.solution import reference_of
from ..references.registry import method_of
from ..trajectory.records import ContactRecord, Impacts, Ledger
from ..trajectory.schema import FORMAT, IMPACT_FIELDS, LEDGER_FIELDS
from ..trajectory.trajectory import Reference, Trajectory, Work

if TYPE_CHECKING:
    import xarray as xr

FROZEN_FORMAT = 1
EVERY = 2  # events from one stored state to the next
KEPT = ("digits", "digits_confirmed_with", "horizon", "horizon_against", "horizon_tolerance", "parameters",
        "python-flint", "numpy")  # fmt: skip
MOST = 1 << 30  # bytes of references that are kept
BOUND = 1e-9  # of max |u| and of the times: the accuracy that integrating again may lose


def keep(solution: Reference, file: str | Path) -> Path:
    """Write a solution to a file. One that is multiprecision and confirmed to its end is frozen: every event time, and
    the state at every second event, which ``load`` reads together with its system. Any other has its outputs."""
    import xarray as xr

    notes, motion = solution.provenance, solution.solution
    if notes["method"] != "multiprecision" or solution.horizon < float(notes["t_end"]):
        return solution.save(file)
    stored, sides = np.arange(0, len(motion.times), EVERY), motion.sides.astype(np.int8)
    sides = sides[:, 0] if sides.shape[1] == 1 else sides  # a single contact needs no second dimension
    q, v = motion.states(motion.times[stored], stored)
    variables = {
        "switch_time": (("switch",), motion.times, "start of every segment"),
        "side": (("switch", "contact")[: sides.ndim], sides, "+1 upper stop, -1 lower, 0 free"),
        "stored_switch": (("stored",), stored.astype(np.int32), "the segment a state belongs to"),
        "q": (("stored", "node"), q, "displacement v = u - phi (1 - (x/L)^2) at the nodes"),
        "q_rate": (("stored", "node"), v, "its rate"),
    }
    data = xr.Dataset({name: (*entry[:2], {"long_name": entry[2]}) for name, entry in variables.items()}, attrs={
        "title": f"stiffbeam frozen reference, {notes['form']} form", "stiffbeam_frozen": FROZEN_FORMAT,
        "source": f"stiffbeam {version('stiffbeam')}", "form": notes["form"], "t_end": float(notes["t_end"]),
        "fingerprint": solution.fingerprint, "provenance": json.dumps({key: notes[key] for key in KEPT}),
        "bound": BOUND,
    })  # fmt: skip
    assert solution.system is not None
    again = _march(solution.system, data, str(file))  # raises InputError where float64 loses an event
    off = np.max(np.abs(reference_of(again, float(notes["t_end"]), solution.t, 0.0, "exact", notes).tip - solution.tip))
    if not off <= BOUND * np.max(np.abs(solution.tip)):
        raise InputError(
            "reference", f"{off:.1e} off", f"come out of its file to {BOUND:g} of the motion", "end it earlier"
        )
    data.attrs["hash"] = content_hash(data)
    return write_netcdf(data, file, compression=9)


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
        part = solver.solve(float(until), start, t=float(times[piece]), sides=sides[piece], fresh=fresh)
        # The events must be those of the file, in sides and in times.
        count = last - piece
        same = len(part.times) >= count and np.array_equal(part.sides[:count], sides[piece:last])
        if not same or np.max(np.abs(part.times[:count] - times[piece:last])) > BOUND * t_end:
            raise InputError("file", source, "give the switches it lists", "it is damaged: remake it")
        parts.append(part.first(count))
    return joined(parts)  # with the times re-marched, to which the coefficients belong


def load(file: str | Path, system: System | None = None, t_eval: ArrayLike | None = None) -> Trajectory:
    """Return the run of a file that ``save`` has written, or of a frozen reference.

    Parameters
    ----------
    file : path
    system : System, optional
        The system that the run is of. With it an exact solution is computed anew: it has states and the field over x
        again, and answers ``at`` any time. Any other run has what the file holds; a frozen reference needs its system.
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
    path = file_path("file", file)
    if not path.is_file():
        raise InputError("file", str(path), "exist", "give one that save() has written")
    if system is not None:
        require_system(system)
    t_eval = None if t_eval is None else numbers("t_eval", t_eval)
    try:
        data = read_netcdf(path)
        frozen = "stiffbeam_frozen" in data.attrs
        kind, known = ("stiffbeam_frozen", FROZEN_FORMAT) if frozen else ("stiffbeam_format", FORMAT)
        if data.attrs.get(kind) != known:
            remedy = f"it has format {data.attrs.get(kind)}: make it again"
            raise InputError("file", str(path), f"be a stiffbeam trajectory of format {known}", remedy)
        if data.attrs.get("hash") != content_hash(data):
            raise InputError("file", str(path), "hold what its hash says", "it is damaged: make it again")
        if system is not None and system.fingerprint != data.attrs["fingerprint"]:
            remedy = "it is of another one: read it with that"
            raise InputError("file", str(path), "be of the system it is read with", remedy)
        if not frozen:
            return _from_arrays(data, path, system)
        if system is None:
            remedy = "it holds events and states: stiffbeam.load(file, system)"
            raise InputError("file", str(path), "be read together with its system", remedy)
        begun, t_end, notes = time.perf_counter(), float(data.attrs["t_end"]), json.loads(data.attrs["provenance"])
        solution = _march(system, data, str(path))  # its events are computed again
        return replace(reference_of(solution, t_end, t_eval, begun, "multiprecision", notes), horizon=t_end)
    except InputError:
        raise
    except Exception as error:  # a file that another tool has written may lack anything
        remedy = f"make it again: {error}"
        raise InputError("file", str(path), "be a whole netCDF-4 file", remedy) from None


def _from_arrays(data: xr.Dataset, path: Path, system: System | None) -> Trajectory:
    """The run or Reference in an opened file."""
    if data.attrs["kind"] == "ensemble":
        raise InputError("file", str(path), "hold one run", "it is an ensemble: xarray.open_dataset reads it")
    contacts, kinds = [], data.attrs["impact_kind"].split(",")
    for i, stops_data in enumerate(json.loads(data.attrs["stops"])):
        mine = data["impact_contact"].values == i
        columns: Any = {field: data[name].values[mine] for field, name in IMPACT_FIELDS.items()}
        impacts = Impacts(**columns, kind=kinds[i]).started(data["impact_open_at_start"].values[mine] > 0)
        arrays: Any = {name: data[f"contact_{name}"].values[i] for name in ("position", "velocity", "force")}
        arrays |= {name: float(data[f"contact_{name}"].values[i]) for name in ("fraction", "peak_force", "impulse")}
        contacts.append(ContactRecord(stops=Stops(**stops_data), impacts=impacts, **arrays))
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
    else:
        run = Trajectory(**common)
    energies = {field: data[name].values for field, name in LEDGER_FIELDS.items() if name in data}
    # The cached property is filled in: without states nothing could compute it.
    if energies:
        run.__dict__["energy"] = Ledger(run.t, **energies)
    return run


# ---------------------------------------------------------------- the cache of references


def cached_reference(
    system: System,
    t_end: float,
    method: str = "exact",
    t_eval: ArrayLike | None = None,
    progress: bool | Show | None = None,
    **options: Any,
) -> Reference:
    """Return ``reference`` with the same arguments and defaults, from the cache where it holds the answer.

    The key is the system's fingerprint, every argument and the versions of the libraries, so a changed parameter never
    finds an old file. A damaged file is named in a warning and computed again. Writing is atomic: two processes that
    compute the same reference leave one good file. Files that have not been used for longest are deleted when the cache
    exceeds a gigabyte.

    A multiprecision reference that is confirmed to t_end can be evaluated at any time. The others are loaded without
    states: with outputs, impacts, energy, horizon, work and provenance, as ``provenance["kept"]`` states. "exact" is
    solved again, which takes no longer than reading a file.

    Parameters
    ----------
    system, t_end, method, t_eval, progress, **options
        As in ``reference``.

    Returns
    -------
    Reference

    Raises
    ------
    InputError
        As ``reference`` does, and for a bare callable, which has no fingerprint.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.cached_reference(sb.paper_case(10).system(), 0.1).horizon
    0.1
    """
    times = None if t_eval is None else numbers("t_eval", t_eval)
    given = signature(reference).bind(system, t_end, method, times, progress=progress, **options)
    entry = method_of(method)
    if method == "exact":
        return reference(*given.args, **given.kwargs)
    require_system(system)
    # A bare callable has no content to make a key of.
    system.drive.require_closed_form("a cached reference")
    given.apply_defaults()
    settings = {name: x for name, x in given.arguments.items() if name not in ("system", "progress", "seconds")}
    # Another version may round differently, or compute something else.
    versions = [platform.python_version(), storage.source_hash(), *map(version, ("stiffbeam", "numpy", "scipy"))]
    key = json.dumps([system.fingerprint, settings, versions, entry.versions()],
                     default=lambda x: x.tolist() if isinstance(x, (np.ndarray, np.generic)) else repr(x))  # fmt: skip
    file = storage.directory() / "references" / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.nc"
    if file.is_file():
        try:
            result = load(file, system, times)
            assert isinstance(result, Reference)
            file.touch()  # used last
            result.provenance["kept"] = True
            return result
        except InputError as error:
            warnings.warn(f"remaking a cached reference: {error}", stacklevel=2)
    result = reference(*given.args, **given.kwargs)
    if "budget" in result.provenance:
        return result  # more seconds reach further
    try:
        keep(result, file)
        # The latest stay, as long as they fit.
        files = sorted(file.parent.glob("*.nc"), key=lambda path: path.stat().st_mtime, reverse=True)
        for path, size in zip(files, np.cumsum([path.stat().st_size for path in files]), strict=True):
            if size > MOST:
                path.unlink(missing_ok=True)
    except InputError as error:
        if error.field != "file":
            raise
        warnings.warn(f"a reference is not kept: {error}", stacklevel=2)  # the cache's disk may be full
    return result
