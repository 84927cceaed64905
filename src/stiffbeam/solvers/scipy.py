"""SciPy's DOP853 and Radau, outside witnesses of the other solver families."""

from __future__ import annotations

import time

import numpy as np
import scipy

from ..arrays import Array
from ..system import System
from ..trajectory import Reference, SolverFailure
from .adaptive import Solve, reference_from
from .rhs import RightHandSide


def solve_scipy(
    system: System, t_end: float, t_eval: Array | None, rtol: float, atol: float | None, method: str
) -> Reference:
    """method "dop853" (explicit Runge-Kutta, order 8) or "radau" (Radau IIA, order 5).

    Outputs between steps are dense output, of order 7 and 3, so Radau is stepped from output to output.
    Impacts are the roots of the gap functions at the ends of steps; a double crossing inside one step
    is missed.
    """
    from scipy.integrate import solve_ivp

    def solve(rhs: RightHandSide, t: Array, rtol: float, atol: float) -> Solve:
        events = []
        gaps = np.empty(len(rhs.sides))
        for k in range(len(rhs.sides)):

            def gap(t: float, y: Array, k: int = k) -> float:
                rhs.gaps(t, y, gaps)
                return float(gaps[k])

            gap.direction = 1.0  # type: ignore[attr-defined]
            events.append(gap)
        options: dict = {"method": "DOP853"}
        if method == "radau":
            options = {"method": "Radau", "jac": rhs.jacobian, "max_step": float(np.max(np.diff(t)))}
        begun = time.perf_counter()
        result = solve_ivp(
            rhs.value,
            (t[0], t[-1]),
            rhs.first_order.y0,
            t_eval=t,
            rtol=rtol,
            atol=atol,
            events=events or None,
            **options,
        )
        seconds = time.perf_counter() - begun
        if not result.success:
            reached = float(result.t[-1]) if len(result.t) else 0.0
            raise SolverFailure(method, reached, result.message, "loosen rtol and atol or use method='exact'")
        found = [(float(s), k) for k, times in enumerate(result.t_events or []) for s in times if s > 0.0]
        counters = {"rhs": int(result.nfev), "jacobians": int(result.njev)}
        return Solve(result.y.T, sorted(found), counters, seconds)

    return reference_from(system, t_end, t_eval, rtol, atol, method, {"scipy": scipy.__version__}, solve)
