"""SciPy's solvers, independent of the other solver families; and the phases of any solver with SciPy's interface."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...model.right_hand_side import RightHandSide
from ...trajectory.trajectory import Reference, SolverFailure
from ..registry import REFERENCES, Request
from .adaptive import Solver, reference_from
from .restarts import Outcome, Phase, Root, refuse_endless

IMPLICIT = ("LSODA", "Radau")  # take the Jacobian
SAME = 1e-13  # of the time: no solver makes a step as short as that
BETWEEN = 256  # steps between two looks at the clock
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
    name = REFERENCES[method].solver
    library: Any = getattr(scipy.integrate, name)

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        options = {"rtol": rtol, "atol": atol} | ({"jac": rhs.jacobian} if name in IMPLICIT else {})

        def start(t: float, z: Array, end: float, outputs: Array = NO_TIMES, **more: Any) -> Any:
            # Radau's dense output is of order 3: steps no longer than the spacing of the outputs keep these accurate.
            if name == "Radau" and len(outputs) > 1:
                more["max_step"] = min(more["max_step"], float(np.max(np.diff(outputs))))
            return library(rhs.value, t, z, end, **options, **more)

        return Stepping(method, start, rhs).run

    return reference_from(request, solver)


class Stepping:
    """Phases by steppers with the interface of SciPy's ``OdeSolver``.

    start: the stepper from (t, z) to an end, with ``max_step`` and ``outputs``, or with the length ``first_step``.
    """

    def __init__(self, method: str, start: Callable[..., Any], rhs: RightHandSide) -> None:
        self.method, self.start, self.rhs = method, start, rhs
        self.counters: dict[str, int] = {}

    def run(self, phase: Phase) -> Outcome:
        """Integrate a phase step by step: a step, its roots, and the outputs up to its end or to the event."""
        stepper = self.start(phase.start, phase.z, phase.end, max_step=phase.max_step, outputs=phase.times)
        self.counters = {}
        states: list[Array] = []
        before = phase.values(phase.start, phase.z)
        directions, steps = np.array(phase.directions), 0
        root: Root | None = None
        while stepper.status == "running" and root is None:
            left, message = stepper.y, stepper.step()
            steps += 1
            if steps % BETWEEN == 0:
                refuse_endless(self.method, float(stepper.t), int(stepper.nfev))
            if stepper.status == "failed":
                remedy = "loosen rtol and atol or take the exact solution"
                raise SolverFailure(self.method, float(stepper.t), str(message), remedy)
            after = phase.values(stepper.t, stepper.y)
            # Zero counts as negative: a root at the joint of two steps is found once.
            crossed = ((before <= 0.0) != (after <= 0.0)) & (directions * (after - before) >= 0.0)
            before = after
            if crossed.any():
                dense = stepper.dense_output()
                found = _located(stepper, dense, phase, np.flatnonzero(crossed))
                root = next((x for x in found if phase.ends([x])), None)
                # A zero of a rate is only the end of a repeated phase: dense output is accurate enough for its state.
                if root is not None and root.which < phase.count:
                    root = root._replace(z=self._stepped(stepper, left, root.time))
            stop = stepper.t if root is None else root.time
            due = phase.times[len(states) : int(phase.times.searchsorted(stop, "right"))]
            if len(due) and due[0] < stepper.t:
                states += list(stepper.dense_output()(due).T)
            elif len(due):
                states.append(stepper.y)
        self._count(stepper)
        ended_by = [] if root is None else [root]
        t, z = (phase.end, stepper.y) if root is None else (root.time, root.z)
        return Outcome(t, z, states, ended_by, self.counters)

    def _stepped(self, stepper: Any, left: Array, t: float) -> Array:
        """The state at t by steps of the full order from ``left``, where the last step starts."""
        if t - stepper.t_old <= SAME * abs(t):
            return left
        # The whole way is proposed as one step; error control may still divide it.
        short = self.start(stepper.t_old, left, t, max_step=np.inf, first_step=t - stepper.t_old)
        while short.status == "running":
            short.step()
        self._count(short)
        return stepper.dense_output()(t) if short.status == "failed" else short.y

    def _count(self, stepper: Any) -> None:
        """Add what a stepper has counted."""
        counted = getattr(stepper, "counters", None) or {
            "rhs": int(stepper.nfev), "jacobians": int(stepper.njev), "factorisations": int(stepper.nlu),
        }  # fmt: skip
        for name, count in counted.items():
            self.counters[name] = self.counters.get(name, 0) + count


def _located(stepper: Any, dense: Any, phase: Phase, changed: Array) -> list[Root]:
    """The roots in the last step by its dense output, in order of time."""
    from scipy.optimize import brentq

    roots = []
    for k in changed:

        def value(t: float, k: int = int(k)) -> float:
            return float(phase.values(t, dense(t))[k])

        low, high = value(stepper.t_old), value(stepper.t)
        if low == 0.0 or low * high > 0.0:  # on it at the start of the step, or only by rounding of dense output
            t = stepper.t_old if abs(low) <= abs(high) else stepper.t
        else:
            xtol: Any = 1e-15 * abs(stepper.t)
            t: Any = brentq(value, stepper.t_old, stepper.t, xtol=xtol, rtol=np.float64(1e-14))
        roots.append(Root(int(k), 1 if high > low else -1, float(t), dense(t)))
    return sorted(roots, key=lambda root: root.time)
