"""Siconos on the test set: linear complementarity for linear stops, Newton's impact law for rigid ones.

Rigid: LagrangianLinearTIDS with NewtonImpactNSL, Moreau-Jean with theta = 1/2. Compliant: the first-order system in
(q, q') with lambda = (kappa d)_+ as the complementarity 0 <= lambda - kappa d _|_ lambda >= 0, by EulerMoreauOSI with
theta = gamma = 1/2. A load that changes is put in as the mean of both ends of the step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import siconos.kernel as sk
import siconos.numerics as sn
from problem_file import Problem, Refused, debian_version, main, sides


def solve(problem: Problem, steps: float):
    n, dt = problem.n, problem.t_end / int(steps)
    if any({"exponent", "dissipation"} & c.keys() for c in problem.contacts):
        raise Refused("a power law is no linear complementarity")
    if any("damping" in c for c in problem.contacts):
        raise Refused("a damped stop that pushes from its surface on is not one linear complementarity")
    if any("offset" in c for c in problem.contacts):
        raise Refused("the relations of LagrangianLinearTIR and FirstOrderLinearTIR do not depend on time")
    system, laws = _rigid(problem) if problem.rigid else _compliant(problem)
    model = sk.NonSmoothDynamicalSystem(0.0, problem.t_end)
    model.insertDynamicalSystem(system)
    for law in laws:
        model.link(law, system)
    if problem.rigid:
        osi = sk.MoreauJeanOSI(0.5)
    else:
        osi = sk.EulerMoreauOSI(0.5)
        osi.setGamma(0.5)
    solver = sk.LCP(sn.SICONOS_LCP_LEMKE)
    simulation = sk.TimeStepping(model, sk.TimeDiscretisation(0.0, dt), osi, solver)
    q, v = np.empty((int(steps) + 1, n)), np.empty((int(steps) + 1, n))
    q[0], v[0] = problem.q, problem.v
    for k in range(int(steps)):
        load = system.fExt() if problem.rigid else system.b()[n:]
        load[:] = 0.5 * _force(problem, k * dt) + 0.5 * _force(problem, (k + 1) * dt)
        simulation.computeOneStep()
        if problem.rigid:
            q[k + 1], v[k + 1] = system.q(), system.velocity()
        else:
            q[k + 1], v[k + 1] = np.split(np.array(system.x()), 2)
        simulation.nextStep()
    return np.linspace(0.0, problem.t_end, int(steps) + 1), q, v


def _rigid(problem: Problem) -> tuple[Any, list[Any]]:
    system = sk.LagrangianLinearTIDS(problem.q, problem.v, problem.M, problem.K, problem.C)
    system.setFExtPtr(np.zeros(problem.n))
    laws = [
        sk.Interaction(
            sk.NewtonImpactNSL(contact["restitution"]),
            sk.LagrangianLinearTIR(-sign * contact["row"][None, :], np.array([sign * stop])),
        )
        for contact in problem.contacts
        for sign, stop in sides(contact)
    ]
    return system, laws


def _compliant(problem: Problem) -> tuple[Any, list[Any]]:
    n, inverse = problem.n, np.linalg.inv(problem.M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ problem.K, -inverse @ problem.C]])
    system = sk.FirstOrderLinearDS(np.concatenate([problem.q, problem.v]), A)
    system.setbPtr(np.zeros(2 * n))
    laws = []
    for contact in problem.contacts:
        for sign, stop in sides(contact):
            kappa, row = contact["stiffness"], contact["row"]
            relation = sk.FirstOrderLinearTIR(
                -sign * np.concatenate([kappa * row, np.zeros(n)])[None, :],
                np.concatenate([np.zeros(n), -sign * inverse @ row])[:, None],
            )
            relation.setDPtr(np.array([[1.0]]))
            relation.setePtr(np.array([kappa * sign * stop]))
            laws.append(sk.Interaction(sk.ComplementarityConditionNSL(1), relation))
    return system, laws


def _force(problem: Problem, t: float) -> np.ndarray:
    """Forces for the Lagrangian system, accelerations for the first-order one."""
    return problem.loads(t) if problem.rigid else np.linalg.solve(problem.M, problem.loads(t))


if __name__ == "__main__":
    version = debian_version("python3-siconos")
    main("Siconos theta = 1/2", version, "MoreauJeanOSI or EulerMoreauOSI, LCP by Lemke", solve, limit=1.5e5)
