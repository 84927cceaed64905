"""integrate_ensemble: a scheme over many members of one system, side by side on all cores."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from time import perf_counter

import numpy as np

from ..basics.progress import silent, working
from ..basics.resources import over_slices
from ..basics.validation import InputError, function, integer
from ..model.members import EnsembleMembers, as_members, march_apart
from ..model.system import System
from ..schemes import Scheme
from ..trajectory.ensemble import MEMBERS_PER_SLICE, Ensemble, Progress, record_from, slim
from ..trajectory.records import Ledger
from ..trajectory.trajectory import Trajectory, Work
from .integrate import Plan

SLICE_STEPS = 30_000  # below which a thread takes longer to start


@working("integrating an ensemble")
def integrate_ensemble(
    system: System,
    scheme: Scheme,
    dt: float,
    t_end: float,
    members: EnsembleMembers | Sequence[System],
    contact: str = "implicit",
    every: int | None = None,
    progress: Progress | None = None,
    since: float = 0.0,
) -> Ensemble:
    """Return the runs of all members of an ensemble, on all cores; each equals its single run to rounding.

    ``joblib.parallel_config`` has processes compute the members, on this machine or on others.

    Parameters
    ----------
    system : System
    scheme : Scheme
    dt, t_end : float
    members : EnsembleMembers or sequence of System
        From ``perturbed_members`` or ``varied_members``, or systems that differ from
        ``system`` in initial data, stops, loads and motions only. Members with records (Sampled) or matrices of their
        own are set up one by one.
    contact : {"implicit", "extrapolated", "conserving"}
        As in ``integrate``.
    every : int, optional
        Keep tip and tip velocity every so many steps. None keeps none; memory then grows with the impacts only.
    progress : callable, optional
        Called with the number of member-steps done.
    since : float
        Contacts are recorded after this time, a whole number of steps. A contact that is there then is no impact.
        Impulses are the sum of dt F over the steps after it, without half weights at the ends.

    Returns
    -------
    Ensemble
        A member that overflows is marked in ``diverged``; the others go on.

    Raises
    ------
    InputError
        For bad arguments.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> many = sb.integrate_ensemble(system, sb.HHT(alpha=-0.1), 1e-4, 0.5, sb.perturbed_members(system, 16))
    >>> many.impact_count.shape
    (16,)
    """
    begun = perf_counter()
    function("progress", silent if progress is None else progress)
    members = as_members(system, members)
    plan = Plan.of(system, scheme, dt, t_end, contact)
    plan.afford(len(members), every if every is None else integer("every", every, 1))
    passed = round(record_from(since, t_end) / dt)
    if abs(passed * dt - since) > 1e-9 * t_end:
        remedy = f"for example {dt * int(since / dt):.12g}"
        raise InputError("since", since, f"be a whole number of steps dt = {dt:g}", remedy)
    report = None if progress is None else lambda done: progress(done * plan.steps)
    return _integrated(plan, members, every, passed, report, begun)


def _integrated(
    plan: Plan, members: EnsembleMembers, every: int | None, since: int, report: Progress | None, begun: float
) -> Ensemble:
    """The ensemble of a plan."""
    # Members with records, or with other matrices, share no propagator and are set up one by one.
    apart = march_apart(members)
    march = partial(_march, plan, every, since, apart)
    # A slice holds at least as much work as a thread takes to start.
    least = min(SLICE_STEPS // plan.steps, MEMBERS_PER_SLICE)
    runs = [run for part in over_slices(march, members, MEMBERS_PER_SLICE, report, least) for run in part]
    seconds = perf_counter() - begun
    return Ensemble.of(
        runs,
        members=members,
        t=np.arange(0, plan.steps + 1, every) * plan.dt if every is not None else np.zeros(0),
        work=Work(len(members) * plan.steps, seconds, seconds),
        provenance=plan.provenance(every) | {"members": len(members), "parameter": members.parameter},
        ledger=partial(_ledger, plan, members, every or plan.steps, apart),
    )


def _march(plan: Plan, every: int | None, since: int, apart: bool, part: EnsembleMembers) -> list[Trajectory]:
    """Runs of some of the members."""
    if apart:
        return [slim(_alone(plan, member).run(member, every, None, since)) for member in part]
    return plan.runs(part, every, since)


def _alone(plan: Plan, member: System) -> Plan:
    """Plan of a member with its own records, whose loads no other member shares."""
    return Plan.of(member, plan.scheme, plan.dt, plan.t_end, plan.treatment.name)


def _ledger(plan: Plan, members: EnsembleMembers, every: int, apart: bool, i: int) -> Ledger:
    return (_alone(plan, members[i]) if apart else plan).ledger(members[i], every)
