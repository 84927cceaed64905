"""integrate_ensemble and reference_ensemble: many members of one system, side by side on all cores."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..ledger import Ledger
from ..schemes import Scheme
from ..system import System
from ..trajectory import Impacts, Reference, Work
from ..validation import InputError, near, non_negative
from .integrate import Plan, Seen
from .members import Members, as_members
from .modal_march import warm_up

ENGINES = ("numba", "numpy", "jax")
MEMBERS_PER_SLICE = 64  # marched by one thread in one go
DEVICE_MEMBERS = 1 << 14  # marched by a device in one go
Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False, kw_only=True)
class ContactStatistics:
    """What the members have seen of one contact, see ContactRecord.

    fraction, peak_force, impulse: (M,). impacts: those of all members, one member after the other;
    member i has the rows offsets[i] to offsets[i + 1].
    """

    fraction: Array
    peak_force: Array
    impulse: Array
    impacts: Impacts
    offsets: NDArray[np.int64]

    @property
    def impact_count(self) -> NDArray[np.int64]:
        """(M,)."""
        return np.diff(self.offsets)

    def impacts_of(self, member: int) -> Impacts:
        """The impacts of one member."""
        rows = slice(self.offsets[member], self.offsets[member + 1])
        x = self.impacts
        return Impacts(x.times[rows], x.stops[rows], x.peaks[rows], x.impulses[rows], x.kind)


@dataclass(frozen=True, eq=False, kw_only=True)
class Ensemble:
    """What M members have done.

    contacts: one record per contact; the arrays over members of the first stand on the ensemble itself.
    t: (k,) output times, tip and tip_velocity: (M, k); k = 0 unless they were asked for. diverged:
    (M,), the time at which a member overflowed, NaN for none; it has seen nothing after. work.steps
    counts member-steps. ledger(i): the energy ledger of member i at the output times, at the start and
    the end where there are none, made by going through the member once more.
    """

    members: Members
    contacts: tuple[ContactStatistics, ...]
    t: Array
    tip: Array
    tip_velocity: Array
    diverged: Array
    work: Work
    provenance: dict[str, Any]
    ledger: Callable[[int], Ledger] = field(repr=False)

    def __len__(self) -> int:
        return len(self.members)

    def __repr__(self) -> str:
        return f"<Ensemble {self.label}: {len(self)} members, {self.members.parameter}>"

    @property
    def label(self) -> str:
        """Method and form, e.g. ``hht(alpha=-0.1)@displacement``."""
        return f"{self.provenance['method']}@{self.provenance['form']}"

    @property
    def contact(self) -> ContactStatistics:
        """The first contact's record; InputError without contact."""
        if not self.contacts:
            raise InputError("contact", "a system without contacts", "be asked of one with stops")
        return self.contacts[0]

    @property
    def impact_count(self) -> NDArray[np.int64]:
        """(M,) at the first contact."""
        return self.contact.impact_count

    @property
    def contact_fraction(self) -> Array:
        """(M,) share of the steps in contact, of the time for an exact ensemble."""
        return self.contact.fraction

    @property
    def peak_force(self) -> Array:
        """(M,) max |sigma|."""
        return self.contact.peak_force

    @property
    def impulse(self) -> Array:
        """(M,) integral of |sigma|."""
        return self.contact.impulse

    @property
    def impacts(self) -> Impacts:
        """All impacts at the first contact, one member after the other, see ``contact.offsets``."""
        return self.contact.impacts


def integrate_ensemble(
    system: System,
    scheme: Scheme,
    dt: float,
    t_end: float,
    members: Members | Sequence[System],
    contact: str = "implicit",
    every: int | None = None,
    engine: str = "numba",
    progress: Progress | None = None,
    since: float = 0.0,
) -> Ensemble:
    """``integrate`` for every member, on all cores; each has the bits of its solo run on the same engine.

    members: from ``perturbed`` or ``varied``, or systems that differ from ``system`` in initial data,
    stops, and frequencies and amplitudes of their loads only. every: keep tip and tip velocity at every
    so many steps; None keeps none, and memory does not grow with the steps but for the impacts.
    engine: "numba"; "numpy"; "jax" (at most one contact; on a GPU where JAX has one), equal to rounding.
    progress: called with the number of member-steps done. since: the time, a whole number of steps,
    after which contacts are recorded; one that is there then is no impact. A member that overflows is
    marked in ``diverged`` and the others go on. Raises InputError for bad arguments.
    """
    begun = time.perf_counter()
    members = as_members(system, members)
    if engine not in ENGINES:
        raise InputError("engine", engine, "be a known engine", near(str(engine), ENGINES))
    plan = Plan.of(system, scheme, dt, t_end, contact, 1 if every is None else every, engine)
    passed = round(_before(since, t_end) / dt)
    if abs(passed * dt - since) > 1e-9 * t_end:
        raise InputError("since", since, f"be a whole number of steps dt = {dt:g}")
    compile_seconds = warm_up() if plan.engine == "numba" else 0.0
    size = DEVICE_MEMBERS if engine == "jax" else MEMBERS_PER_SLICE

    def march(part: Members) -> list[Seen]:
        return plan.seen(part, every, passed)

    seen = list(_over_slices(march, members, size, plan.steps, progress))
    seconds = time.perf_counter() - begun - compile_seconds
    return _ensemble(
        members,
        seen,
        np.arange(0, plan.steps + 1, every) * dt if every is not None else np.zeros(0),
        Work(len(members) * plan.steps, seconds, seconds),
        plan.provenance(every) | {"members": len(members), "parameter": members.parameter},
        lambda i: plan.ledger(members[i], every or plan.steps),
    )


def reference_ensemble(
    system: System,
    t_end: float,
    members: Members | Sequence[System],
    t_eval: ArrayLike | None = None,
    progress: Progress | None = None,
    since: float = 0.0,
) -> Ensemble:
    """The exact solution of every member, on all cores; each has the bits of its solo run.

    t_eval: (k,) times at which tip and tip velocity are kept, None for none. progress: called with the
    number of members done. since: the time after which contacts are recorded. No horizon is computed:
    past it statistics over the members are all that means anything. Raises InputError as
    ``reference(method="exact")`` does.
    """
    from ..solvers.piecewise import solve_exact

    begun = time.perf_counter()
    members = as_members(system, members)
    times = np.zeros(0) if t_eval is None else np.asarray(t_eval, float)
    at = np.array([0.0, float(t_end)]) if t_eval is None else times
    _before(since, t_end)
    known: dict = {}  # modes, shared between members; the first one finds them
    first = solve_exact(members[0], t_end, at, known=known, since=since)

    def see(run: Reference) -> Seen:
        return Seen(run.tip[: len(times)], run.tip_velocity[: len(times)], run.contacts)

    def solve(part: Members) -> list[Seen]:
        return [see(solve_exact(member, t_end, at, known=known, since=since)) for member in part]

    rest = None if progress is None else lambda done: progress(1 + done)
    seen = [see(first), *_over_slices(solve, members[1:], MEMBERS_PER_SLICE, 1, rest)]
    seconds = time.perf_counter() - begun
    notes = {"members": len(members), "parameter": members.parameter}

    def ledger(i: int) -> Ledger:
        return solve_exact(members[i], t_end, at, known=known).energy

    return _ensemble(members, seen, times, Work(0, seconds, seconds), first.provenance | notes, ledger)


def _over_slices(
    work: Callable[[Members], list[Seen]], members: Members, most: int, unit: int, progress: Progress | None
) -> Iterator[Seen]:
    """``work`` on slices of at most ``most`` members, one thread per core, the results in order."""
    threads = cores() if most <= MEMBERS_PER_SLICE else 1  # a device is shared by no threads
    size = min(most, max(1, len(members) // (4 * threads))) if threads > 1 else most
    with ThreadPoolExecutor(threads) as pool:
        parts: list[Future] = [pool.submit(work, members[i : i + size]) for i in range(0, len(members), size)]
        try:
            done = 0
            for part in parts:
                seen = part.result()
                done += len(seen)
                if progress is not None:
                    progress(done * unit)
                yield from seen
        finally:
            for part in parts:
                part.cancel()


def _before(since: float, t_end: float) -> float:
    """``since`` as a time in [0, t_end)."""
    if not non_negative("since", since) < t_end:
        raise InputError("since", since, f"be a time before t_end = {t_end:g}")
    return since


def cores() -> int:
    """The threads an ensemble marches on: STIFFBEAM_THREADS, else the cores this process may use."""
    wanted = os.environ.get("STIFFBEAM_THREADS", "").strip()
    if wanted:
        if not wanted.isdigit() or int(wanted) < 1:
            raise InputError("STIFFBEAM_THREADS", wanted, "be an integer >= 1")
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _ensemble(
    members: Members,
    seen: list[Seen],
    t: Array,
    work: Work,
    provenance: dict[str, Any],
    ledger: Callable[[int], Ledger],
) -> Ensemble:
    contacts = []
    for records in zip(*(one.contacts for one in seen), strict=True):
        each = [record.impacts for record in records]
        names = ("times", "stops", "peaks", "impulses")
        columns = {name: np.concatenate([getattr(x, name) for x in each]) for name in names}
        contacts.append(
            ContactStatistics(
                fraction=np.array([record.fraction for record in records]),
                peak_force=np.array([record.peak_force for record in records]),
                impulse=np.array([record.impulse for record in records]),
                impacts=Impacts(**columns, kind=each[0].kind),
                offsets=np.concatenate([[0], np.cumsum([x.count for x in each])]),
            )
        )
    return Ensemble(
        members=members,
        contacts=tuple(contacts),
        t=t,
        tip=np.array([one.tip for one in seen]),
        tip_velocity=np.array([one.tip_velocity for one in seen]),
        diverged=np.array([one.diverged for one in seen]),
        work=work,
        provenance=provenance,
        ledger=ledger,
    )
