"""Read saved trajectories and stored references, and store a multiprecision solution.

A stored ("frozen") reference is a small file from which float64 computes the solution at any time. It has every event
time, and the full state at some of the events. From one of these states to the next float64 loses only a few digits.
Integrating again between them gives the solution at any time within the stated bound, past the float64 horizon too.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..basics.arrays import Array
from ..basics.storage import content_hash, read_netcdf, write_netcdf
from ..basics.validation import InputError, file_path, numbers
from ..march.integrate import Plan
from ..model.contact import Stops
from ..model.system import System, require_system
from ..references import solve
from ..references.exact.motion import Motion, Solver, fresh_after, joined
from ..references.exact.solution import reference_of
from ..schemes.labels import run_label, scheme_at_hand
from ..trajectory.records import ContactRecord, Impacts, Ledger
from ..trajectory.schema import FORMAT, HASHED, IMPACT_FIELDS, LEDGER_FIELDS, output_index
from ..trajectory.trajectory import Pieces, Reference, Trajectory, Work
from .cases import parse_case

if TYPE_CHECKING:
    import xarray as xr

FROZEN_FORMAT = 1
BOUND = 1e-9  # of max |u| and of the times: the accuracy that re-marching may lose


def can_freeze(reference: Reference) -> bool:
    """Return True if the solution is multiprecision and confirmed to its end."""
    t_end = float(reference.provenance["t_end"])
    return reference.provenance["method"] == "multiprecision" and reference.horizon >= t_end


def freeze(reference: Reference, case: str, file: str | Path) -> dict[str, Any]:
    """Write a multiprecision ``reference`` of the TOML text ``case`` to a file. Returns its entry for a manifest:
    impacts of all its contacts, the largest share of contact and force among them.

    With an empty ``case`` the file can be read together with its system only; another must make that system.

    The stored states are chosen so that the file, read back, gives the reference within ``BOUND``;
    that is tried before anything is written. Raises InputError where the reference is not confirmed
    to its end.
    """
    t_end = float(reference.provenance["t_end"])
    if not can_freeze(reference):
        raise InputError("reference", reference.label, "be multiprecision and confirmed to t_end", "give more digits")
    assert reference.system is not None
    # The case has to make the system of the reference: a file is read back by its case alone.
    if case and _system_of(case, "case", reference.system.form).fingerprint != reference.fingerprint:
        remedy = "numbers in a case are decimals: solve the system of the case itself"
        raise InputError("case", case.partition("[case.problem]")[2].strip(), "make the reference's system", remedy)
    solution: Motion = reference.solution
    for share in (0.1, 0.01, 0.001):  # a run of near grazes can magnify the last bits more than three tries show
        # Tried as it will be read. A tighter bound stores more states, where a run magnifies too much.
        stored = _states_to_store(reference, solution, t_end, share * BOUND)
        data = _arrays(reference, solution, case, t_end, stored)
        deviation = _deviation(data, solution, reference)
        if deviation <= BOUND:
            break
    else:
        raise InputError("reference", f"{deviation:.1e} off", f"be re-marched to {BOUND:g}", "report this case")
    # Attributes of the trial, then the hash of the whole.
    data.attrs["bound"] = BOUND
    data.attrs["deviation"] = deviation
    data.attrs["hash"] = _hash(data)
    path = write_netcdf(data, file, compression=9)
    return {
        "file": path.name,
        "form": reference.provenance["form"],
        "t_end": t_end,
        "digits": reference.provenance["digits"],
        "confirmed_with": reference.provenance["digits_confirmed_with"],
        **contact_facts(reference),
        "bound": BOUND,
        "seconds": round(reference.work.seconds, 1),
        "hash": data.attrs["hash"],
    }


def contact_facts(run: Trajectory) -> dict[str, float]:
    """Impacts of all contacts, the largest share of contact and force among them, for a manifest."""
    contacts = run.contacts
    return {
        "impacts": sum(contact.impacts.count for contact in contacts),
        "contact_fraction": max((contact.fraction for contact in contacts), default=0.0),
        "peak_force": max((contact.peak_force for contact in contacts), default=0.0),
    }


def load_frozen(data: xr.Dataset, path: Path, system: System | None = None, t_eval: Array | None = None) -> Reference:
    """The Reference in an opened file. Its content is checked against the hash, and its events are computed again.

    system: what the file is of, by default what its case makes. t_eval: output times, by default 2001.
    """
    begun = time.perf_counter()
    # What the file is, whether it is whole, and whether it is of this system.
    if data.attrs["stiffbeam_frozen"] != FROZEN_FORMAT:
        raise InputError(
            "file",
            str(path),
            f"be of format {FROZEN_FORMAT}",
            f"it has {data.attrs['stiffbeam_frozen']}: remake it",
        )
    if data.attrs.get("hash") != _hash(data):
        raise InputError("file", str(path), "hold what its hash says", "it is damaged: remake it")
    if system is None:
        if not data.attrs["case"]:
            raise InputError("file", str(path), "hold its case", "read it together with its system")
        system = _system_of(data.attrs["case"], str(path), data.attrs["form"])
    if system.fingerprint != data.attrs["fingerprint"]:
        raise InputError(
            "file", str(path), "describe the system that its case makes", "this version differs: remake it"
        )
    t_end = float(data.attrs["t_end"])
    notes = json.loads(data.attrs["provenance"])
    # The integration that was tried when the file was made.
    solution = _march(system, data, str(path))
    reference = reference_of(system, solution, t_end, t_eval, begun, "multiprecision", notes)
    return replace(reference, horizon=t_end)


def _system_of(case: str, source: str, form: str) -> System:
    """The system that the TOML text ``case`` makes."""
    return parse_case(case, source).system(form)


def _states_to_store(reference: Reference, solution: Motion, t_end: float, bound: float) -> Array:
    """The segments whose initial states a file needs.

    From each of them float64 is followed until it is off by ``bound`` of max |u| or of t_end, and the next is the
    last piece before that. Followed three times, twice with frequencies changed in their last bits: on
    another machine the modes come out differently, and a grazing impact can magnify that.
    """
    assert reference.system is not None
    system = reference.system
    eps = float(np.finfo(float).eps)
    # Two more solvers with other roundings stand for other machines.
    solver = Solver(system)
    solvers = [solver, *(solver.perturbed(eps, seed) for seed in (1, 2))]
    scale = float(np.max(np.abs(reference.tip)))
    # In the middle of segments, farthest from the events.
    times = solution.times
    middles = 0.5 * (times + np.append(times[1:], t_end))
    expected = _positions(system, solution, middles)
    # Spans start at 16 segments and grow or shrink by what holds.
    stored, span = [0], 16
    while True:
        piece = stored[-1]
        last = good = min(piece + span, len(times))
        q, v = (x[0] for x in solution.state_at_start(piece))
        for each in solvers:
            # To the middle of the last segment: its start alone would not compare it.
            until = float(middles[last - 1])
            part = _trace(each, float(times[piece]), solution.sides, piece, (q, v), until)
            here = slice(piece, min(piece + len(part.times), last))
            part = part.first(here.stop - piece)
            # Off by time, by position, or by sides; other sides count as 1, above any bound.
            late = np.abs(part.times - times[here])
            other = np.any(part.sides != solution.sides[here], axis=1)
            u = _positions(system, part, middles[here])
            off = np.maximum(late / t_end, np.max(np.abs(u - expected[here]), axis=1) / scale) + other
            bad = np.flatnonzero(off > bound)
            good = min(good, piece + int(bad[0]) if len(bad) else here.stop)
        if good >= len(times):
            return np.array(stored)
        # The bound breaks inside the span: store a state at the last good segment and begin there.
        if good < last:
            stored.append(max(piece + 1, good))
            span = max(16, 2 * (good - piece))
        else:
            # Good as far as it goes: look further from the same state.
            span *= 2


def _arrays(reference: Reference, solution: Motion, case: str, t_end: float, stored: Array) -> xr.Dataset:
    """Event times, and states at the start of the segments ``stored``."""
    assert reference.system is not None
    sides = solution.sides.astype(np.int8)
    # A single contact needs no second dimension.
    sides = sides[:, 0] if sides.shape[1] == 1 else sides
    q, v = (np.empty((len(stored), reference.system.size)) for _ in range(2))
    for row, piece in enumerate(stored):
        q[row], v[row] = (x[0] for x in solution.state_at_start(piece))
    keep = (
        "digits",
        "digits_confirmed_with",
        "horizon",
        "horizon_against",
        "horizon_tolerance",
        "parameters",
        "python-flint",
        "numpy",
    )
    attributes = {
        "title": f"stiffbeam frozen reference, {reference.provenance['form']} form",
        "stiffbeam_frozen": FROZEN_FORMAT,
        "source": f"stiffbeam {version('stiffbeam')}",
        "case": case,
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
    for row, piece in enumerate(stored):
        last = stored[row + 1] if row + 1 < len(stored) else len(times)
        # To the middle of the segment after the span, so that rounding cannot hide its last event.
        until = (
            0.5 * (times[last] + (times[last + 1] if last + 1 < len(times) else t_end)) if last < len(times) else t_end
        )
        q, v = data["q"].values[row], data["q_rate"].values[row]
        part = _trace(solver, float(times[piece]), sides, piece, (q, v), float(until))
        # The events must be those of the file, in sides and in times.
        count = last - piece
        same = len(part.times) >= count and np.array_equal(part.sides[:count], sides[piece:last])
        if not same or np.max(np.abs(part.times[:count] - times[piece:last])) > BOUND * t_end:
            raise InputError("file", source, "give the switches it lists", "it is damaged: remake it")
        parts.append(part.first(count))
    return joined(parts)  # with the times re-marched, to which the coefficients belong


def _trace(
    solver: Solver, t: float, sides: NDArray[np.int64], piece: int, start: tuple[Array, Array], until: float
) -> Motion:
    """The motion from the start of a piece on, whose contacts are on sides[piece]."""
    fresh = fresh_after(solver.system, sides[piece - 1] if piece else sides[0], sides[piece])
    return solver.trace(t, np.ascontiguousarray(sides[piece]), fresh, start, until)


def _deviation(data: xr.Dataset, a: Motion, reference: Reference) -> float:
    """Largest difference in position of a contact or the tip over max |u|, in the middle of every segment, between
    ``a`` and the motion from the file; infinite if the events differ."""
    assert reference.system is not None
    # Infinite, so that ``freeze`` tries a tighter bound.
    try:
        b = _march(reference.system, data, "the file to be")
    except InputError:
        return float("inf")
    if len(a.times) != len(b.times):
        return float("inf")
    # In the middle of segments, as in ``_states_to_store``.
    t = 0.5 * (a.times + np.append(a.times[1:], float(reference.provenance["t_end"])))
    difference = np.abs(_positions(reference.system, a, t) - _positions(reference.system, b, t))
    return float(np.max(difference) / np.max(np.abs(reference.tip)))


def _positions(system: System, solution: Motion, t: Array) -> Array:
    """Positions of every channel, (times, channels)."""
    return np.stack([solution.observed(t, row)[0] for row, _ in system.channels], axis=-1)


def _hash(data: xr.Dataset) -> str:
    """Hash of the content of the file, without the hash itself and machine-dependent entries."""
    return content_hash(data, map(str, data.attrs.keys() - {"hash", "deviation"}))


def load(file: str | Path, system: System | None = None, t_eval: ArrayLike | None = None) -> Trajectory:
    """Return the run of a file that ``save`` has written, or of a frozen reference.

    Parameters
    ----------
    file : path
    system : System, optional
        The system that the run is of. With it a scheme's run and an exact solution have states and the field over x
        again: they are computed anew on first use. So an exact solution answers ``at`` any time. Without it a
        trajectory has what the file holds, and a frozen reference uses its own case.
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
    if path.suffix in (".csv", ".json", ".txt", ".npz", ".npy", ".mat"):
        remedy = "of columns of your own make stiffbeam.Trajectory.from_arrays(t, tip, system=system)"
        raise InputError("file", str(path), "be netCDF, as run.save('run.nc') writes it", remedy)
    if system is not None:
        require_system(system)
    t_eval = None if t_eval is None else numbers("t_eval", t_eval)
    try:
        data = read_netcdf(path)
        if "stiffbeam_frozen" in data.attrs:
            return load_frozen(data, path, system, t_eval)
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
    if data.attrs.get("hash") != content_hash(data, HASHED):
        raise InputError("file", str(path), "hold what its hash says", "it is damaged: save the run again")
    if system is not None and system.fingerprint != data.attrs["fingerprint"]:
        remedy = "it is of another one: read it with that, or alone"
        raise InputError("file", str(path), "be of the system it is read with", remedy)
    contacts, kinds = [], data.attrs["impact_kind"].split(",")
    for i, stops_data in enumerate(json.loads(data.attrs["stops"])):
        mine = data["impact_contact"].values == i
        columns: Any = {field: data[name].values[mine] for field, name in IMPACT_FIELDS.items()}
        impacts = Impacts(**columns, kind=kinds[i]).started(data["impact_open_at_start"].values[mine] > 0)
        contacts.append(
            ContactRecord(
                stops=Stops.of(stops_data),
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
    common: dict[str, Any] = {
        "t": data["time"].values,
        "tip": data["tip"].values,
        "tip_velocity": data["tip_velocity"].values,
        "contacts": tuple(contacts),
        "work": Work(**work),
        "provenance": notes | {"method": run_label(notes["method"])},
        "stored_fingerprint": data.attrs["fingerprint"],
        "system": system,
    }
    # A system allows more than the file holds: its states and fields are computed on first use.
    if data.attrs["kind"] == "reference":
        again = None if system is None else _solved_again(system, common["provenance"])
        state_at = None if again is None else partial(_states_at, again)
        evaluate = partial(_values_at, common, again)
        run = Reference(
            **common,
            horizon=float(data.attrs["horizon"]),
            evaluate=evaluate,
            state_at=state_at,
            contact_by_events=None if again is None else partial(_contact_between, again),
            solution=None if again is None else _SolvedAgain(again),
        )
    else:
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
        plan = Plan.of(system, scheme, notes["dt"], notes["t_end"], notes["contact"], 1)
        return plan.states(system)

    return pieces


class _SolvedAgain:
    """The solver's own representation of a loaded exact solution, solved when one of its attributes is read."""

    def __init__(self, again: Callable[[], Reference]) -> None:
        self._again = again

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # what copies and pickles ask for
            raise AttributeError(name)
        return getattr(self._again().solution, name)


def _solved_again(system: System, notes: dict[str, Any]) -> Callable[[], Reference] | None:
    """The exact solution, solved on the first call; None for a solver that answers at its own times only."""
    if notes["method"] != "exact":
        return None
    return cache(partial(solve, system, notes["t_end"], "exact", None, 0.0, None))


def _states_at(again: Callable[[], Reference], t: Array) -> tuple[Array, Array]:
    state_at = again().state_at
    assert state_at is not None
    return state_at(t)


def _contact_between(again: Callable[[], Reference], start: float, end: float, contact: int) -> ContactRecord | None:
    return again().contact_between(start, end, contact)


def _values_at(
    saved: dict[str, Any], again: Callable[[], Reference] | None, times: Array, channel: int
) -> tuple[Array, Array]:
    """A contact's position and velocity; the channel after the last contact is the tip. They are those of the file at
    its output times, and of the solution at others, where ``again`` can solve it."""
    try:
        index = output_index(saved["t"], times, f"a saved {saved['provenance']['method']}")
    except InputError:
        evaluate = None if again is None else again().evaluate
        if evaluate is None:
            raise
        return evaluate(times, channel)
    if channel < len(saved["contacts"]):
        contact = saved["contacts"][channel]
        return contact.position[index], contact.velocity[index]
    return saved["tip"][index], saved["tip_velocity"][index]
