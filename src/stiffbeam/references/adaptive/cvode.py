"""CVODE, SUNDIALS' variable-order multistep solver, through scikit-sundae."""

from __future__ import annotations

from ...basics.arrays import Array
from ...model.right_hand_side import RightHandSide
from ...trajectory.trajectory import Reference
from ..request import KEEP, RESTART, Request
from .adaptive import Solver, in_phases, reference_from
from .restarts import Outcome, Phase
from .sundials import advance, compiled, linear_solver, phase_options
from .sundials_library import CompiledSolver, available


def solve(request: Request) -> Reference:
    """BDF orders 1-5 ("cvode") or Adams-Moulton orders 1-12 ("cvode-adams"), Newton with the analytic Jacobian.

    The Jacobian is banded where the system's is. Adams starts anew at every switch, where a method of
    high order gains by a smooth right-hand side; BDF goes through, and error control finds the kink: it
    is of order 5 at most and takes long to raise its order again. Undamped, these systems lie on the
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
