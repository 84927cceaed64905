"""SUNDIALS' variable-order multistep solvers CVODE and IDA (for implicit systems), through scikit-sundae."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...model.right_hand_side import RightHandSide
from ...trajectory.trajectory import Reference, SolverFailure
from ..request import KEEP, RESTART, Request
from . import sundials_library
from .adaptive import Solver, in_phases, reference_from
from .restarts import Outcome, Phase, Root, refuse_endless
from .sundials_library import CompiledSolver, available


def solve(request: Request) -> Reference:
    """Return the solution by IDA or CVODE, according to the name of the method."""
    return _ida(request) if request.method == "ida" else _cvode(request)


def _cvode(request: Request) -> Reference:
    """BDF orders 1-5 or Adams-Moulton orders 1-12, Newton with the analytic Jacobian.

    The Jacobian is banded if the system's is. Adams restarts at every event, because a method of high order gains by a
    smooth right-hand side. BDF steps through, and error control finds the kink: BDF has order 5 at most and needs many
    steps to raise its order again. Undamped, these systems lie on the
    imaginary axis, where BDF of order 3 and above is unstable and Adams needs a fifth of the work.
    """
    method, adams = request.method, request.method == "cvode-adams"

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        from sksundae.cvode import CVODE

        if not rhs.in_python and available():
            return compiled(method, CompiledSolver("CVode", rhs, rtol, atol, adams))

        def right(t: float, z: Array, rate: Array) -> None:
            rhs(t, z, rate)

        def jacobian(t: float, z: Array, rate: Array, J: Array) -> None:
            J[:] = rhs.jacobian(t, z)

        def run(phase: Phase) -> Outcome:
            def roots(t: float, z: Array, out: Array) -> None:
                phase.watch(t, z, out)

            family = "Adams" if adams else "BDF"
            options = linear_solver(rhs) | phase_options(phase, roots)
            cvode = CVODE(right, method=family, rtol=rtol, atol=atol, jacfn=jacobian, **options)
            cvode.init_step(phase.start, phase.z)
            return advance(method, cvode, phase)

        return run

    return reference_from(request, in_phases(method, solver), RESTART if adams else KEEP)


def _ida(request: Request) -> Reference:
    """BDF orders 1-5 on the residual of M q'' + C q' + K q = f, the mass matrix not inverted.

        F(t, y, y') = E y' - g(t, y),  y = (q_1, q_1', ..., q_n, q_n')

    with the analytic iteration matrix c_j E - dg/dy, banded where M, C and K are. IDA steps through
    the events like CVODE's BDF.
    """
    mass, right = request.system.descriptor()

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        from sksundae.ida import IDA

        if not rhs.in_python and available():
            return compiled("ida", CompiledSolver("IDA", rhs, rtol, atol))

        def residual(t: float, z: Array, rate: Array, res: Array) -> None:
            rhs.residual(t, z, rate, res)

        def jacobian(t: float, z: Array, rate: Array, res: Array, cj: float, J: Array) -> None:
            J[:] = rhs.jacobian(t, z, cj, -1.0)

        def run(phase: Phase) -> Outcome:
            def roots(t: float, z: Array, rate: Array, out: Array) -> None:
                phase.watch(t, z, out)

            options = linear_solver(rhs) | phase_options(phase, roots)
            ida = IDA(residual, rtol=rtol, atol=atol, jacfn=jacobian, **options)
            ida.init_step(phase.start, phase.z, rhs.rate(phase.start, phase.z))
            return advance("ida", ida, phase)

        return run

    return reference_from(request, in_phases("ida", solver), KEEP, mass, right)


def linear_solver(rhs: RightHandSide) -> dict[str, Any]:
    """The options of scikit-sundae's direct solver: banded where that pays."""
    if rhs.bandwidths is None:
        return {"linsolver": "dense"}
    lower, upper = rhs.bandwidths
    return {"linsolver": "band", "lband": lower, "uband": upper}


def compiled(method: str, solver: CompiledSolver) -> Callable[[Phase], Outcome]:
    """Return a function that integrates a phase by a solver with compiled equations."""

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
    counters: dict[str, int] = {}
    if result is not None:
        counters = {"rhs": int(result.nfev), "jacobians": int(result.njev), **getattr(result, "statistics", {})}
    return Outcome(
        t if ended_by else phase.end, z, states[: len(phase.times)], ended_by, phase.watch.missed(ended_by), counters
    )
