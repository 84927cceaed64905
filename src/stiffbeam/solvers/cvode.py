"""CVODE, SUNDIALS' variable-order multistep solver, through scikit-sundae."""

from __future__ import annotations

import time

from ..arrays import Array
from ..system import System
from ..trajectory import Reference
from .adaptive import Solve, reference_from
from .rhs import RightHandSide
from .sundials import MAX_STEPS, event_options, finished


def solve_cvode(
    system: System, t_end: float, t_eval: Array | None, rtol: float, atol: float | None, adams: bool = False
) -> Reference:
    """BDF orders 1-5 (default) or Adams-Moulton orders 1-12, Newton with the analytic Jacobian.

    The Jacobian is banded where the system's is. The contact law is continuous, so no restart is made
    at a switch: error control finds the kink. Impacts are the roots of the gap functions; a double
    crossing inside one step is missed. Undamped, these systems lie on the imaginary axis, where BDF of
    order 3 and above is unstable and Adams needs a fifth of the work.
    """
    import sksundae
    from sksundae.cvode import CVODE

    method = "cvode-adams" if adams else "cvode"

    def solve(rhs: RightHandSide, t: Array, rtol: float, atol: float) -> Solve:
        options: dict = {"linsolver": "dense"}
        if rhs.banded:
            lower, upper = rhs.first_order.bandwidths
            options = {"linsolver": "band", "lband": lower, "uband": upper}

        def jacobian(t: float, y: Array, yp: Array, J: Array) -> None:
            J[:] = rhs.jacobian(t, y)

        def gaps(t: float, y: Array, out: Array) -> None:
            rhs.gaps(t, y, out)

        solver = CVODE(
            rhs,
            method="Adams" if adams else "BDF",
            rtol=rtol,
            atol=atol,
            jacfn=jacobian,
            max_num_steps=MAX_STEPS,
            **options,
            **event_options(gaps, len(rhs.sides)),
        )
        begun = time.perf_counter()
        result = solver.solve(t, rhs.first_order.y0)
        return finished(method, result, t, time.perf_counter() - begun)

    return reference_from(system, t_end, t_eval, rtol, atol, method, {"scikit-sundae": sksundae.__version__}, solve)
