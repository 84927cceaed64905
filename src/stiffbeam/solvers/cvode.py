"""CVODE, SUNDIALS' variable-order multistep solver, through scikit-sundae."""

from __future__ import annotations

import time

import numpy as np

from ..arrays import Array
from ..system import System
from ..trajectory import Reference, SolverFailure
from .adaptive import Solve, reference_from
from .rhs import RightHandSide

MAX_STEPS = 10_000_000  # per output point; the default of 500 ends most contact runs


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
        sides = rhs.sides

        def jacobian(t: float, y: Array, yp: Array, J: Array) -> None:
            J[:] = rhs.jacobian(t, y)

        def events(t: float, y: Array, gaps: Array) -> None:
            rhs.gaps(t, y, gaps)

        if sides:
            events.terminal = [False] * len(sides)  # type: ignore[attr-defined]
            events.direction = [1] * len(sides)  # type: ignore[attr-defined]
            options |= {"eventsfn": events, "num_events": len(sides)}
        solver = CVODE(
            rhs,
            method="Adams" if adams else "BDF",
            rtol=rtol,
            atol=atol,
            jacfn=jacobian,
            max_num_steps=MAX_STEPS,
            **options,
        )
        begun = time.perf_counter()
        result = solver.solve(t, rhs.first_order.y0)
        seconds = time.perf_counter() - begun
        if not result.success or len(result.t) < len(t):
            remedy = "loosen rtol and atol or use method='exact'"
            raise SolverFailure(method, float(result.t[-1]), str(result.message), remedy)
        found: list[tuple[float, int]] = []
        if sides and result.t_events is not None:
            which = np.asarray(result.i_events)
            found = [
                (float(s), int(k)) for s, row in zip(result.t_events, which, strict=True) for k in np.flatnonzero(row)
            ]
        counters = {"rhs": int(result.nfev), "jacobians": int(result.njev)}
        return Solve(np.asarray(result.y), found, counters, seconds)

    return reference_from(system, t_end, t_eval, rtol, atol, method, {"scikit-sundae": sksundae.__version__}, solve)
