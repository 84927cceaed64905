"""SciPy's solvers, independent of the other solver families; and the phases of any solver with SciPy's interface."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import late
from ...model.right_hand_side import RightHandSide
from ...trajectory.trajectory import Reference, SolverFailure
from ..registry import REFERENCES, Request
from .adaptive import reference_from
from .restarts import Phase, Solver, refuse_endless

IMPLICIT = ("LSODA", "Radau")  # take the Jacobian
SAME = 1e-13  # of the time: no solver makes a step as short as that
NO_TIMES = np.empty(0)


def solve(request: Request) -> Reference:
    """Solve by DOP853 (explicit Runge-Kutta, order 8), Radau (Radau IIA, order 5) or LSODA.

    Outputs between steps are dense output, for Radau of order 3, so that it is stepped from output to output. A root is
    found by dense output; where it ends a phase, a step of the full order leads to it. Radau's error estimate is of
    order 3 only: its steps are as short as rtol^(1/4) asks, 50 000 of them at rtol 1e-10 for 90 periods, half a minute.
    DOP853's are no longer than stability allows, however smooth the motion.

    LSODA of ODEPACK takes Adams orders 1-12 with functional iteration, or BDF orders 1-5 with Newton's method and the
    analytic Jacobian, and changes between the two by itself, by which of them allows the longer step. It shares no
    code with SUNDIALS. Measured on Tables 5 and 10: the time of CVODE's BDF at rtol 1e-8 and half of it at 1e-10, with
    errors 25 to 115 times smaller; CVODE's Adams takes half to four fifths of LSODA's time at the same rtol.
    """
    import scipy.integrate

    method = request.method
    name = REFERENCES[method].label
    library: Any = getattr(scipy.integrate, name)

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        options = {"rtol": rtol, "atol": atol} | ({"jac": rhs.jacobian} if name in IMPLICIT else {})

        def start(t: float, z: Array, end: float, outputs: Array = NO_TIMES, **more: Any) -> Any:
            # Radau's dense output is of order 3: steps no longer than the spacing of the outputs keep these accurate.
            if name == "Radau" and len(outputs) > 1:
                more["max_step"] = min(more["max_step"], float(np.max(np.diff(outputs))))
            return library(rhs.value, t, z, end, **options, **more)

        return Stepping(method, start)

    return reference_from(request, solver)


class Stepping:
    """Solver of phases by steppers with the interface of SciPy's ``OdeSolver``.

    start: the stepper from (t, z) to an end, with ``max_step`` and ``outputs``, or with the length ``first_step``.
    """

    def __init__(self, method: str, start: Callable[..., Any]) -> None:
        self.method, self.start = method, start

    def __call__(self, phase: Phase) -> dict[str, int]:
        """Integrate a phase step by step: a step, its roots, and the outputs up to its end or to the event."""
        stepper = self.start(phase.t, phase.z, phase.end, max_step=phase.max_step, outputs=phase.times)
        before, directions = phase.values(phase.t, phase.z), np.array(phase.directions)
        steppers = [stepper]
        while stepper.status == "running" and not phase.ended_by and not late(stepper.t):
            left, message = stepper.y, stepper.step()
            if stepper.status == "failed":
                remedy = "loosen rtol and atol or take the exact solution"
                raise SolverFailure(self.method, float(stepper.t), str(message), remedy)
            refuse_endless(self.method, float(stepper.t), int(stepper.nfev))
            phase.t, phase.z = min(float(stepper.t), phase.end), stepper.y
            after = phase.values(phase.t, phase.z)
            # Zero counts as negative: a root at the joint of two steps is found once.
            crossed = ((before <= 0.0) != (after <= 0.0)) & (directions * (after - before) >= 0.0)
            before = after
            if crossed.any():
                dense = stepper.dense_output()
                located = sorted(_located(stepper, dense, phase, k) for k in np.flatnonzero(crossed).tolist())
                root = next((t for t, k, sign in located if phase.ends(t, dense(t), {k: sign})), None)
                if root is not None:
                    phase.t, phase.z = root, dense(root)
                    # A repeated phase needs the time alone, which dense output has.
                    if not phase.missed and root - stepper.t_old > SAME * root:
                        # The whole way is proposed as one step of the full order; error control may still divide it.
                        first = root - stepper.t_old
                        short = self.start(stepper.t_old, left, root, max_step=np.inf, first_step=first)
                        while short.status == "running":
                            short.step()
                        steppers.append(short)
                        phase.z = phase.z if short.status == "failed" else short.y
            due = phase.times[len(phase.states) : int(phase.times.searchsorted(phase.t, "right"))]
            if len(due):
                phase.states += list(stepper.dense_output()(due).T) if due[0] < stepper.t else [stepper.y]
        counted = {"nfev": getattr(stepper, "unit", "rhs"), "njev": "jacobians", "nlu": "factorisations"}
        return {name: sum(int(getattr(x, key)) for x in steppers) for key, name in counted.items()}


def _located(stepper: Any, dense: Callable[[float], Array], phase: Phase, k: int) -> tuple[float, int, int]:
    """Time of root ``k`` in the last step by its dense output, the root, and its sign."""
    from scipy.optimize import brentq

    def value(t: float) -> float:
        return float(phase.values(t, dense(t))[k])

    low, high = value(stepper.t_old), value(stepper.t)
    if low == 0.0 or low * high > 0.0:  # on it at the start of the step, or only by rounding of dense output
        t = stepper.t_old if abs(low) <= abs(high) else stepper.t
    else:
        xtol: Any = 1e-15 * abs(stepper.t)
        t: Any = brentq(value, stepper.t_old, stepper.t, xtol=xtol, rtol=np.float64(1e-14))
    return float(t), k, 1 if high > low else -1
