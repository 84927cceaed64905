"""IDA, SUNDIALS' solver for implicit systems, through scikit-sundae."""

from __future__ import annotations

import time

import numpy as np

from ..arrays import Array
from ..system import System
from ..trajectory import Reference
from .adaptive import Solve, reference_from
from .rhs import RightHandSide
from .sundials import MAX_STEPS, event_options, finished


def solve_ida(system: System, t_end: float, t_eval: Array | None, rtol: float, atol: float | None) -> Reference:
    """BDF orders 1-5 on the residual of M q'' + C q' + K q = f, the mass matrix not inverted.

        F(t, y, y') = E y' - g(t, y),  y = (q_1, q_1', ..., q_n, q_n')

    with the analytic iteration matrix c_j E - dg/dy, banded where M, C and K are. Switches and impacts
    as with CVODE: error control finds the kink, impacts are the roots of the gap functions, a double
    crossing inside one step is missed.
    """
    import sksundae
    from sksundae.ida import IDA

    E, right = system.descriptor()

    def solve(rhs: RightHandSide, t: Array, rtol: float, atol: float) -> Solve:
        i, j = np.nonzero((E != 0.0) | (right.matrix != 0.0))
        lower, upper = int(max(0, np.max(i - j))), int(max(0, np.max(j - i)))
        options: dict = {"linsolver": "dense"}
        if lower + upper + 1 < rhs.size // 3 and not system_couples(right):
            options = {"linsolver": "band", "lband": lower, "uband": upper}
        value = np.empty(rhs.size)

        def residual(t: float, y: Array, yp: Array, res: Array) -> None:
            rhs(t, y, value)
            np.matmul(E, yp, out=res)
            res -= value

        def jacobian(t: float, y: Array, yp: Array, res: Array, cj: float, J: Array) -> None:
            J[:] = cj * E - rhs.jacobian(t, y)

        def gaps(t: float, y: Array, yp: Array, out: Array) -> None:
            rhs.gaps(t, y, out)

        y0 = rhs.first_order.y0
        yp0 = np.linalg.solve(E, rhs.value(0.0, y0))
        solver = IDA(
            residual,
            rtol=rtol,
            atol=atol,
            jacfn=jacobian,
            max_num_steps=MAX_STEPS,
            **options,
            **event_options(gaps, len(rhs.sides)),
        )
        begun = time.perf_counter()
        result = solver.solve(t, y0, yp0)
        return finished("ida", result, t, time.perf_counter() - begun)

    versions = {"scikit-sundae": sksundae.__version__}
    return reference_from(system, t_end, t_eval, rtol, atol, "ida", versions, solve, first_order=right)


def system_couples(right) -> bool:
    """Whether a contact row reaches beyond neighbouring unknowns, outside the band."""
    return any(np.count_nonzero(c.row) > 1 for c in right.contacts)
