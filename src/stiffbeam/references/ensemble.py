"""reference_ensemble: the best references of many members of one system; exact ones in parallel on all cores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.resources import cores, current, over, working
from ..basics.validation import InputError, numbers, positive
from ..model.members import EnsembleMembers, as_members
from ..model.system import System
from ..trajectory.ensemble import Ensemble, record_from, slim
from ..trajectory.records import Ledger
from ..trajectory.trajectory import Trajectory, Work
from . import BEST_RTOL, best_reference, solve
from .exact.solution import solve_exact


@working("solving an ensemble")
def reference_ensemble(
    system: System,
    t_end: float,
    members: EnsembleMembers | Sequence[System],
    t_eval: ArrayLike | None = None,
    since: float = 0.0,
) -> Ensemble:
    """Return the exact solutions of all members, on all cores; each equals its single solution to rounding.

    Where the first member has no exact solution, the adaptive solver of ``best_reference`` solves all, one after the
    other, as ``provenance["method"]`` says.

    Parameters
    ----------
    system : System
        Its stops may be rigid.
    t_end : float
    members : EnsembleMembers or sequence of System
    t_eval : array (k,), optional
        Times at which tip and tip velocity are kept; by default none.
    since : float
        Contacts are recorded after this time, for exact solutions only.

    Returns
    -------
    Ensemble
        ``provenance["horizon"]`` is that of the first member. Beyond it only statistics over the members are
        meaningful.

    Raises
    ------
    InputError, SolverFailure
        As ``best_reference`` does.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> sb.reference_ensemble(system, 0.2, sb.perturbed_members(system, 4)).contacts[0].impact_count.shape
    (4,)
    """
    begun = perf_counter()
    members = as_members(system, members)
    times = np.zeros(0) if t_eval is None else numbers("t_eval", t_eval)
    t_end = positive("t_end", t_end)
    # A Reference has two output times at least, also where none are kept.
    at = np.array([0.0, float(t_end)]) if t_eval is None else times
    record_from(since, t_end)
    best = best_reference(members[0], t_end, progress=False)
    method = str(best.provenance["method"])
    if method != "exact" and since:
        raise InputError("since", since, f"be 0 for members solved by {method}", "record contacts from the start")
    one, show = partial(_solution, method, t_end, at), current()
    report = lambda done: show(f"{method}: members", done, len(members))  # noqa: E731
    # An adaptive solver uses the processes of ``joblib.parallel_config`` alone.
    runs = list(over(partial(one, since, len(times)), members, report, cores() if method == "exact" else 1))
    seconds = perf_counter() - begun
    notes = {"members": len(members), "varied": list(members.parameters), "horizon": best.horizon}
    # Runs keep no motion: a ledger solves its member again, on demand.
    ledger = partial(_ledger, partial(one, 0.0, None), members)
    return Ensemble.of(
        runs, members=members, t=times,
        work=Work(0, seconds, seconds), provenance=best.provenance | notes, ledger=ledger,
    )  # fmt: skip


def _solution(method: str, t_end: float, at: Array, since: float, kept: int | None, system: System) -> Trajectory:
    """The solution of a member, all of it or what an ensemble keeps of it, with so many outputs."""
    exact = method == "exact"
    run = solve_exact(system, t_end, at, since) if exact else solve(system, t_end, method, at, BEST_RTOL)
    return run if kept is None else slim(run, kept)


def _ledger(one: Callable[[System], Trajectory], members: EnsembleMembers, i: int) -> Ledger:
    return one(members[i]).energy


def energy_of(many: Ensemble, i: int) -> Array:
    """Energy (k,) of a member at the output times. Of an exact one without the work of loads and dashpots, which takes
    longer than the motion."""
    if many.provenance["method"] != "exact":
        return many.ledger(i).energy
    system = many.members[i]
    run = solve_exact(system, float(many.provenance["t_end"]), many.t, 0.0)
    return sum(system.energies(many.t, *run.states), np.zeros(len(many.t)))
