"""EXUDYN on the test set: an ObjectGenericODE2 with M, C, K, its loads, and a CoordinateSpringDamper for each contact.

The law of a contact is the spring's force function. (The limit stops of CoordinateSpringDamperExt converge as well,
with larger errors: their state is that of the step before, and DOPRI5 does not see them switch.)

    python exudyn_engine.py FOLDER OUT [NAME ...]           the implicit trapezoidal rule
    python exudyn_engine.py FOLDER OUT --dopri5 [NAME ...]  DOPRI5 with automatic steps, from sample to sample
"""

from __future__ import annotations

import sys
from itertools import pairwise

import exudyn as exu
import exudyn.itemInterface as item
import numpy as np
from problem_file import Problem, Refused, main, press


def build(problem: Problem):
    """The system, and the list of its (t, q, v) after every step."""
    if problem.rigid:
        raise Refused("stops are springs: a rigid stop with a restitution between coordinates is not among the objects")
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    node = mbs.AddNode(
        item.NodeGenericODE2(
            numberOfODE2Coordinates=problem.n, referenceCoordinates=[0.0] * problem.n,
            initialCoordinates=problem.q.tolist(), initialCoordinates_t=problem.v.tolist(),
        )
    )  # fmt: skip
    loads = {"forceUserFunction": lambda mbs, t, i, q, v: problem.loads(t)} if problem.load_tables else {}
    mbs.AddObject(
        item.ObjectGenericODE2(
            nodeNumbers=[node], massMatrix=problem.M, stiffnessMatrix=problem.K, dampingMatrix=problem.C, **loads
        )
    )
    ground = mbs.AddMarker(item.MarkerNodeCoordinate(nodeNumber=mbs.AddNode(item.NodePointGround()), coordinate=0))
    for contact in problem.contacts:
        touched = np.flatnonzero(contact["row"])
        if len(touched) != 1 or contact["row"][touched[0]] != 1.0:
            raise Refused("a coordinate spring acts on one coordinate")
        point = mbs.AddMarker(item.MarkerNodeCoordinate(nodeNumber=node, coordinate=int(touched[0])))
        law = _law(contact)
        mbs.AddObject(item.CoordinateSpringDamper(markerNumbers=[ground, point], springForceUserFunction=law))
    mbs.Assemble()
    rows: list[tuple] = []

    def after_step(mbs, t: float) -> bool:
        if rows and t <= rows[-1][0]:  # called at the start of a section too
            rows.pop()
        rows.append((t, np.array(mbs.systemData.GetODE2Coordinates()), np.array(mbs.systemData.GetODE2Coordinates_t())))
        return True

    mbs.SetPostStepUserFunction(after_step)
    return container, mbs, rows


def _law(contact: dict):
    return lambda mbs, t, i, u, v, k, d, offset: press(contact, t, u, v)


def settings(steps: int, begin: float, end: float):
    chosen = exu.SimulationSettings()
    chosen.timeIntegration.numberOfSteps = steps
    chosen.timeIntegration.startTime, chosen.timeIntegration.endTime = begin, end
    chosen.timeIntegration.verboseMode = 0
    chosen.solution.file.write = False
    chosen.show.computationTime = False
    chosen.timeIntegration.newton.relativeTolerance = 1e-10
    chosen.timeIntegration.newton.absoluteTolerance = 1e-12
    return chosen


def trapezoidal(problem: Problem, steps: float):
    _container, mbs, rows = build(problem)
    chosen = settings(int(steps), 0.0, problem.t_end)
    if not mbs.SolveDynamic(chosen, solverType=exu.DynamicSolverType.TrapezoidalIndex2):
        raise RuntimeError("SolveDynamic has failed")
    return tuple(zip(*rows, strict=True))


def dopri5(problem: Problem, rtol: float):
    _container, mbs, rows = build(problem)
    stations = np.unique([*problem.times, *problem.breaks])
    step = 1e-3 * (stations[1] - stations[0])
    for begin, end in pairwise(stations):
        chosen = settings(1, begin, end)
        chosen.timeIntegration.automaticStepSize = True
        chosen.timeIntegration.minimumStepSize = 1e-14
        chosen.timeIntegration.initialStepSize = min(step, end - begin)
        chosen.timeIntegration.relativeTolerance = rtol
        chosen.timeIntegration.absoluteTolerance = 1e-3 * rtol * _size(problem)
        if not mbs.SolveDynamic(chosen, solverType=exu.DynamicSolverType.DOPRI5, updateInitialValues=True):
            raise RuntimeError(f"SolveDynamic has failed at t = {begin:.6g}")
        step = max(b[0] - a[0] for a, b in pairwise(rows) if b[0] > begin)
    return tuple(zip(*rows, strict=True))


def _size(problem: Problem) -> float:
    """A displacement of the problem's: of its stops, its start, or its speed times a sample."""
    stops = [abs(c[side]) for c in problem.contacts for side in ("lower", "upper") if side in c]
    return max([*stops, *np.abs(problem.q), *np.abs(problem.v) * problem.times[1]])


if __name__ == "__main__":
    adaptive = "--dopri5" in sys.argv
    if adaptive:
        sys.argv.remove("--dopri5")
        main("EXUDYN DOPRI5", exu.__version__, "automatic steps, restarted at the samples", dopri5, adaptive=True)
    else:
        main("EXUDYN trapezoidal", exu.__version__, "TrapezoidalIndex2, Newton to 1e-10", trapezoidal, limit=1.5e5)
