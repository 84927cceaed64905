"""reference_ensemble: the best references of many members of one system; exact ones in parallel on all cores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.compiled import wall_clock
from ..basics.progress import silent
from ..basics.resources import cores, over_slices
from ..basics.validation import InputError, numbers, positive
from ..model.members import EnsembleMembers, as_members
from ..model.system import System
from ..piecewise.measures import audit, within_float64
from ..piecewise.regimes import Known
from ..piecewise.tracer import tracer_of
from ..trajectory.ensemble import MEMBERS_PER_SLICE, Ensemble, Progress, Runs, gathered, record_from
from ..trajectory.ledger import Ledger
from ..trajectory.trajectory import Reference, Work
from . import BEST_RTOL, best_reference
from . import solve as solve_by
from .exact.piecewise import reference_of, solve_exact
from .exact.rigid_reference import solve_rigid


def reference_ensemble(
    system: System,
    t_end: float,
    members: EnsembleMembers | Sequence[System],
    t_eval: ArrayLike | None = None,
    progress: Progress | None = None,
    since: float = 0.0,
) -> Ensemble:
    """Return the exact solutions of all members, on all cores; each is equal to the bit to its single solution.

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
    progress : callable, optional
        Called with the number of members done.
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
    >>> sb.reference_ensemble(system, 0.2, sb.perturbed_members(system, 4)).impact_count.shape
    (4,)
    """
    begun = wall_clock()
    members = as_members(system, members)
    times = np.zeros(0) if t_eval is None else numbers("t_eval", t_eval)
    t_end = positive("t_end", t_end)
    at = np.array([0.0, float(t_end)]) if t_eval is None else times
    record_from(since, t_end)
    known: Known | None = None if members.separate else {}  # modes, shared between members; the first one finds them
    best = best_reference(members[0], t_end, progress=silent)
    method, horizon = str(best.provenance["method"]), best.horizon
    if method != "exact" and since:
        raise InputError("since", since, f"be 0 for members solved by {method}", "record contacts from the start")
    one = _solve if method == "exact" else partial(_adaptive, method)
    first = one(members[0], t_end, at, known, since)

    def solve(part: EnsembleMembers) -> Runs:
        return Runs.joined([Runs.of([one(member, t_end, at, known, since)], len(times)) for member in part])

    own = members.system
    exact = method == "exact" and not any(c.stops.rigid for c in own.contacts)
    if exact and set(members.fields) <= {"q0", "v0"}:
        tracer = tracer_of(own, known=known, span=t_end)  # one for all

        def solve(part: EnsembleMembers) -> Runs:
            runs = []
            for i in range(len(part)):
                start = part.start(i)
                with within_float64("exact", t_end):
                    solution = tracer.solve(t_end, start)
                    audit(own, solution, t_end, start=start)
                    run = reference_of(own, solution, t_end, at, begun, method, {}, since)
                runs.append(Runs.of([run], len(times)))
            return Runs.joined(runs)

    rest = None if progress is None else lambda done: progress(1 + done)
    parts = [
        Runs.of([first], len(times)),
        # SUNDIALS' solvers do not run side by side in one process.
        *over_slices(solve, members[1:], MEMBERS_PER_SLICE, cores() if method == "exact" else 1, rest),
    ]
    seconds = wall_clock() - begun
    notes = {"members": len(members), "parameter": members.parameter, "horizon": horizon}
    ledger = partial(_ledger, one, members, t_end, at)
    return gathered(members, parts, times, Work(0, seconds, seconds), first.provenance | notes, ledger)


def _solve(system: System, t_end: float, at: Array, known: Known | None, since: float) -> Reference:
    if any(contact.stops.rigid for contact in system.contacts):
        return solve_rigid(system, t_end, at, since, trusted=False)
    return solve_exact(system, t_end, at, known=known, since=since)


def _adaptive(method: str, system: System, t_end: float, at: Array, known: Known | None, since: float) -> Reference:
    return solve_by(system, t_end, method, at, BEST_RTOL, None)


def _ledger(one: Callable[..., Reference], members: EnsembleMembers, t_end: float, at: Array, i: int) -> Ledger:
    return one(members[i], t_end, at, {}, 0.0).energy
