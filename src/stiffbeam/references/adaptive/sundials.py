"""What CVODE and IDA share through scikit-sundae: one phase, from its start to a root or its end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...model.right_hand_side import RightHandSide
from ...trajectory.trajectory import SolverFailure
from . import sundials_library
from .restarts import Outcome, Phase, Root, refuse_endless
from .sundials_library import CompiledSolver


def linear_solver(rhs: RightHandSide) -> dict[str, Any]:
    """The options of scikit-sundae's direct solver: banded where that pays."""
    if rhs.bandwidths is None:
        return {"linsolver": "dense"}
    lower, upper = rhs.bandwidths
    return {"linsolver": "band", "lband": lower, "uband": upper}


def compiled(method: str, solver: CompiledSolver) -> Callable[[Phase], Outcome]:
    """Return what integrates a phase with a solver whose equations are compiled."""

    def run(phase: Phase) -> Outcome:
        solver.init_step(phase)
        return advance(method, solver, phase)

    return run


def phase_options(phase: Phase, roots: Callable[..., None]) -> dict[str, Any]:
    """Root functions and step bound. Made anew for each phase: events accumulate in a solver."""
    options: dict[str, Any] = {"max_num_steps": sundials_library.MAX_STEPS}
    if np.isfinite(phase.max_step):
        options["max_step"] = phase.max_step
    if phase.watch.count:
        roots.terminal = [True] * phase.watch.size  # type: ignore[attr-defined]
        roots.direction = phase.watch.directions  # type: ignore[attr-defined]
        options |= {"eventsfn": roots, "num_events": phase.watch.size}
    return options


def advance(method: str, solver: Any, phase: Phase) -> Outcome:
    """Step an initialised solver from output to output, until a root ends the phase."""
    states, ended_by = [], []
    t, z, result = phase.start, phase.z, None
    least = 8.0 * np.finfo(float).eps * phase.end  # SUNDIALS refuses a first output closer than that
    for target in [*phase.times, *([phase.end] if not len(phase.times) or phase.times[-1] < phase.end else [])]:
        if target - phase.start <= least:
            states.append(z)
            t = float(target)
            continue
        while not ended_by:
            result = solver.step(float(target), tstop=phase.end)
            if not result.success:
                message, remedy = str(result.message), "loosen rtol and atol or take the exact solution"
                raise SolverFailure(method, float(result.t), message, remedy)
            t, z = float(result.t), np.asarray(result.y)
            refuse_endless(method, t, int(result.nfev), phase.forecast)
            if result.status != 2:  # not a root: the output time, or the end
                break
            flags = np.asarray(result.i_events)[-1]
            roots = [Root(int(k), int(flags[k]), t, z) for k in np.flatnonzero(flags)]
            if phase.watch.ends(roots):
                ended_by = roots
        if ended_by:
            break
        states.append(z)
    counters = {} if result is None else {"rhs": int(result.nfev), "jacobians": int(result.njev)}
    return Outcome(
        t if ended_by else phase.end, z, states[: len(phase.times)], ended_by, phase.watch.missed(ended_by), counters
    )
