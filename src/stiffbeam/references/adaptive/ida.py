"""IDA, SUNDIALS' solver for implicit systems, through scikit-sundae."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg

from ...basics.arrays import Array
from ...model.first_order import FirstOrderSystem
from ...trajectory.trajectory import Reference
from ..request import KEEP, Request
from .adaptive import Solver, in_phases, reference_from
from .restarts import Outcome, Phase
from .rhs import RightHandSide
from .sundials import advance, phase_options


def solve(request: Request) -> Reference:
    """BDF orders 1-5 on the residual of M q'' + C q' + K q = f, the mass matrix not inverted.

        F(t, y, y') = E y' - g(t, y),  y = (q_1, q_1', ..., q_n, q_n')

    with the analytic iteration matrix c_j E - dg/dy, banded where M, C and K are. Goes through the switches
    as CVODE's BDF does.
    """
    from sksundae.ida import IDA

    mass, right = request.system.descriptor()

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        i, j = np.nonzero((mass != 0.0) | (right.matrix != 0.0))
        lower, upper = int(max(0, np.max(i - j))), int(max(0, np.max(j - i)))
        options: dict[str, Any] = {"linsolver": "dense"}
        if lower + upper + 1 < rhs.states // 3 and not system_couples(right):
            options = {"linsolver": "band", "lband": lower, "uband": upper}
        E = np.asarray(scipy.linalg.block_diag(mass, np.eye(rhs.size - rhs.states)))  # the integrals beside the motion
        value = np.empty(rhs.size)

        def residual(t: float, z: Array, rate: Array, res: Array) -> None:
            rhs(t, z, value)
            np.matmul(E, rate, out=res)
            res -= value

        def jacobian(t: float, z: Array, rate: Array, res: Array, cj: float, J: Array) -> None:
            J[:] = cj * E - rhs.jacobian(t, z)

        def run(phase: Phase) -> Outcome:
            def roots(t: float, z: Array, rate: Array, out: Array) -> None:
                phase.watch(t, z, out)

            ida = IDA(residual, rtol=rtol, atol=atol, jacfn=jacobian, **options, **phase_options(phase, roots))
            ida.init_step(phase.start, phase.z, rhs.rate(phase.start, phase.z))
            return advance("ida", ida, phase)

        return run

    return reference_from(request, in_phases("ida", solver), KEEP, mass, right)


def system_couples(right: FirstOrderSystem) -> bool:
    """Whether a contact row reaches beyond neighbouring unknowns, outside the band."""
    return any(np.count_nonzero(c.row) > 1 for c in right.contacts)
