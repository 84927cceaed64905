"""MuJoCo on the test set: unit masses on slide joints, one for each mode, and a tendon for each contact.

Modal coordinates z, q = Phi z: mass 1, joint stiffness omega^2. The contact row.q = (row Phi).z is a fixed tendon;
its ``springlength`` is a dead band, so that its stiffness is exactly that of compliant stops. A rigid stop is the
tendon's limit with solref = (-k, -b): MuJoCo has no restitution, and a limit that is a damped spring returns e of the
speed, with its half period of ``CONTACT_STEPS`` steps.
"""

from __future__ import annotations

import mujoco
import numpy as np
from problem_file import Problem, Refused, main, modes

CONTACT_STEPS = 8.0
FAR = 1e9  # where there is no stop


def model(problem: Problem, shapes: np.ndarray, squares: np.ndarray, dt: float) -> mujoco.MjModel:
    bodies = "".join(
        f'<body><joint name="z{i}" type="slide" axis="1 0 0" stiffness="{w!r}"/>'
        f'<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
        for i, w in enumerate(squares.tolist())
    )
    tendons = ""
    for contact in problem.contacts:
        if "offset" in contact:
            raise Refused("a tendon's range and dead band stay where they are: no stop that moves")
        if {"exponent", "damping", "dissipation"} & contact.keys():
            raise Refused("a tendon's spring is polynomial and its damper acts outside the dead band too")
        low, high = contact.get("lower", -FAR), contact.get("upper", FAR)
        coefficients = (contact["row"] @ shapes).tolist()
        joints = "".join(f'<joint joint="z{i}" coef="{x!r}"/>' for i, x in enumerate(coefficients))
        law = f'stiffness="{contact["stiffness"]!r}" springlength="{low!r} {high!r}"'
        if problem.rigid:
            k, b = _limit(contact["restitution"], dt)
            law = f'limited="true" range="{low!r} {high!r}" solreflimit="{-k!r} {-b!r}"'
            law += ' solimplimit="0.9999 0.9999 0.001 0.5 2"'
        tendons += f"<fixed {law}>{joints}</fixed>"
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler autolimits="false"/><option timestep="{dt!r}" gravity="0 0 0" integrator="RK4" '
        f'tolerance="1e-14" iterations="200"/><worldbody>{bodies}</worldbody><tendon>{tendons}</tendon></mujoco>'
    )


def _limit(e: float, dt: float) -> tuple[float, float]:
    """Stiffness and damping over the mass for a restitution e.

    Of a damped spring that is left when its force is zero, e = exp(-2 s atan(1/s)), s = zeta/sqrt(1 - zeta^2).
    """
    if e == 0.0:
        return 0.01 / dt**2, 1.0 / dt
    low, high = 0.0, 100.0
    for _ in range(80):
        s = 0.5 * (low + high)
        low, high = (s, high) if -2.0 * s * np.arctan2(1.0, s) > np.log(e) else (low, s)
    decay = np.pi / (CONTACT_STEPS * dt)
    return decay**2 * (1.0 + s * s), 2.0 * decay * s


def solve(problem: Problem, steps: int):
    if np.any(problem.C):
        raise Refused("dampers between coordinates would couple the modes")
    shapes, squares = modes(problem)
    m = model(problem, shapes, squares, problem.t_end / steps)
    d = mujoco.MjData(m)
    back = shapes.T @ problem.M
    d.qpos[:], d.qvel[:] = back @ problem.q, back @ problem.v

    def passive(m, d) -> None:
        d.qfrc_passive[:] += shapes.T @ problem.loads(d.time)

    z, v = np.empty((steps + 1, problem.n)), np.empty((steps + 1, problem.n))
    z[0], v[0] = d.qpos, d.qvel
    mujoco.set_mjcb_passive(passive if problem.load_tables else None)
    try:
        for k in range(1, steps + 1):
            mujoco.mj_step(m, d)
            z[k], v[k] = d.qpos, d.qvel
    finally:
        mujoco.set_mjcb_passive(None)
    if any(w.number for w in d.warning):
        raise RuntimeError("it warns of instability")  # and has begun anew
    return np.linspace(0.0, problem.t_end, steps + 1), z @ shapes.T, v @ shapes.T


if __name__ == "__main__":
    main("MuJoCo RK4", mujoco.__version__, "integrator RK4", solve, limit=4e5)
