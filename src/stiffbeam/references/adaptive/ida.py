"""IDA, SUNDIALS' solver for implicit systems, through scikit-sundae."""

from __future__ import annotations

from ...basics.arrays import Array
from ...model.right_hand_side import RightHandSide
from ...trajectory.trajectory import Reference
from ..request import KEEP, Request
from .adaptive import Solver, in_phases, reference_from
from .restarts import Outcome, Phase
from .sundials import advance, compiled, linear_solver, phase_options
from .sundials_library import CompiledSolver, available


def solve(request: Request) -> Reference:
    """BDF orders 1-5 on the residual of M q'' + C q' + K q = f, the mass matrix not inverted.

        F(t, y, y') = E y' - g(t, y),  y = (q_1, q_1', ..., q_n, q_n')

    with the analytic iteration matrix c_j E - dg/dy, banded where M, C and K are. Goes through the switches
    as CVODE's BDF does.
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
