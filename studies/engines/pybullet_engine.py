"""PyBullet on the test set: one or two balls, each over a plane of its own, springs and loads as forces at every step.

The mass of an unknown is a ball, whose height over the plane is the distance to its stop. Rigid: the restitution of
Bullet, with its threshold velocity set to zero, and without the contactERP that pushes out of a plane with a speed that
stays. Compliant: contactStiffness and contactDamping. Bullet in double
precision, its solver with 200 iterations, damping off; forces are those of the begin of a step, semi-implicit Euler.
"""

from __future__ import annotations

from importlib.metadata import version

import numpy as np
import pybullet as pb
from problem_file import Problem, Refused, main, sides

RADIUS, APART = 1.0, 10.0


def build(problem: Problem, dt: float) -> tuple[list[int], list[float], list[float]]:
    """Balls, and sign and stop of each: height over the plane = RADIUS - sign (q - stop)."""
    if np.count_nonzero(problem.M - np.diag(np.diag(problem.M))) or problem.n > 2:
        raise Refused("set up for one or two separate bodies")
    pb.resetSimulation()
    pb.setPhysicsEngineParameter(
        fixedTimeStep=dt, numSubSteps=1, numSolverIterations=200, solverResidualThreshold=0.0,
        restitutionVelocityThreshold=0.0, contactERP=0.0,
    )  # fmt: skip
    pb.setGravity(0, 0, 0)
    balls, signs, stops = [], [], []
    for i, m in enumerate(np.diag(problem.M)):
        contact = next((c for c in problem.contacts if c["row"][i]), None)
        (sign, stop), *more = sides(contact) if contact else [(1.0, 0.0)]
        laws = {"exponent", "dissipation", "offset"} & contact.keys() if contact else set()
        if more or laws:
            raise Refused("a contact is a spring and a damper of one plane that stays, or a restitution")
        shape = pb.createCollisionShape(pb.GEOM_SPHERE, radius=RADIUS)
        place = [APART * i, 0.0, RADIUS - sign * (problem.q[i] - stop)]
        ball = pb.createMultiBody(baseMass=m, baseCollisionShapeIndex=shape, basePosition=place)
        pb.changeDynamics(ball, -1, linearDamping=0.0, angularDamping=0.0, maxJointVelocity=1e9,
                          lateralFriction=0.0, contactProcessingThreshold=0.0)  # fmt: skip
        pb.resetBaseVelocity(ball, [0.0, 0.0, -sign * problem.v[i]])
        if contact:
            plane = pb.createMultiBody(0, pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[3.0, 3.0, 1.0]),
                                       basePosition=[APART * i, 0.0, -1.0])  # fmt: skip
            pb.changeDynamics(plane, -1, lateralFriction=0.0, restitution=1.0)
            if problem.rigid:
                pb.changeDynamics(ball, -1, restitution=contact["restitution"])
            else:
                law = {"contactStiffness": contact["stiffness"], "contactDamping": contact.get("damping", 0.0)}
                pb.changeDynamics(ball, -1, **law)
                pb.changeDynamics(plane, -1, contactStiffness=1e30, contactDamping=0.0)
        balls.append(ball)
        signs.append(sign)
        stops.append(stop)
    return balls, signs, stops


def solve(problem: Problem, steps: float):
    steps = int(steps)
    dt = problem.t_end / steps
    balls, signs, stops = build(problem, dt)
    q, v = np.empty((steps + 1, problem.n)), np.empty((steps + 1, problem.n))
    q[0], v[0] = problem.q, problem.v
    for k in range(steps):
        force = problem.loads(k * dt) - problem.K @ q[k] - problem.C @ v[k]
        for ball, sign, f in zip(balls, signs, force, strict=True):
            place, _turn = pb.getBasePositionAndOrientation(ball)
            pb.applyExternalForce(ball, -1, [0.0, 0.0, -sign * f], place, pb.WORLD_FRAME)
        pb.stepSimulation()
        for i, (ball, sign, stop) in enumerate(zip(balls, signs, stops, strict=True)):
            place, _turn = pb.getBasePositionAndOrientation(ball)
            q[k + 1, i] = stop - sign * (place[2] - RADIUS)
            v[k + 1, i] = -sign * pb.getBaseVelocity(ball)[0][2]
    return np.linspace(0.0, problem.t_end, steps + 1), q, v


if __name__ == "__main__":
    pb.connect(pb.DIRECT)
    main("PyBullet", version("pybullet"), "200 iterations, no damping, no restitution threshold", solve)
