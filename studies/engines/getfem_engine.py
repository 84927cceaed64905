"""GetFEM on the test set: the equations as one expression of its weak form language, by its Newmark scheme (1/4, 1/2).

    (M q'' + C q' + K q - f).w + sum over contacts of (kappa (row.q - stop)_+^p (1 + lambda row.q')) row.w

over a mesh of one element of length 1, q a variable of n numbers. GetFEM differentiates it for Newton's method.
"""

from __future__ import annotations

import getfem as gf
import numpy as np
from problem_file import Problem, Refused, debian_version, main, sides, value


def build(problem: Problem, element: gf.MeshIm) -> gf.Model:
    if problem.rigid:
        raise Refused("its contact has no law of impact: a restitution cannot be told to it")
    model = gf.Model("real")
    model.add_variable("q", problem.n)
    model.add_Newmark_scheme("q", 0.25, 0.5)
    for name, matrix in (("M", problem.M), ("C", problem.C), ("K", problem.K)):
        model.add_initialized_data(name, matrix.ravel(), [problem.n, problem.n])
    model.add_initialized_data("f", problem.loads(0.0))
    terms = ["(M*Dot2_q + C*Dot_q + K*q - f).Test_q"]
    for i, contact in enumerate(problem.contacts):
        if "damping" in contact:
            raise Refused("the force of a damped stop jumps at its surface, which Newton's method does not take")
        model.add_initialized_data(f"row{i}", contact["row"])
        model.add_initialized_data(f"offset{i}", [0.0])
        for sign, stop in sides(contact):
            depth = f"pos_part({sign!r}*(row{i}.q + offset{i}) - {sign * stop!r})"
            power = f"pow({depth}, {contact['exponent']!r})" if "exponent" in contact else depth
            force = f"{contact['stiffness']!r}*{power}"
            if "dissipation" in contact:
                force = f"pos_part({force}*(1 + {contact['dissipation'] * sign!r}*(row{i}.Dot_q)))"
            terms.append(f"{sign!r}*{force}*(row{i}.Test_q)")
    model.add_nonlinear_term(element, " + ".join(terms))
    return model


def solve(problem: Problem, steps: float):
    steps = int(steps)
    mesh = gf.Mesh("cartesian", np.array([0.0, 1.0]))
    element = gf.MeshIm(mesh, gf.Integ("IM_GAUSS1D(1)"))  # both live as long as the model
    dt, model = problem.t_end / steps, build(problem, element)
    acceleration = np.linalg.solve(problem.M, problem.loads(0.0) - problem.K @ problem.q - problem.C @ problem.v)
    model.set_time_step(dt)
    for name, start in (("q", problem.q), ("Previous_q", problem.q), ("Previous_Dot_q", problem.v),
                        ("Previous_Dot2_q", acceleration)):  # fmt: skip
        model.set_variable(name, start)
    q, v = np.empty((steps + 1, problem.n)), np.empty((steps + 1, problem.n))
    q[0], v[0] = problem.q, problem.v
    for k in range(1, steps + 1):
        model.set_variable("f", problem.loads(k * dt))
        for i, contact in enumerate(problem.contacts):
            if "offset" in contact:
                model.set_variable(f"offset{i}", [value(contact["offset"], k * dt)])
        iterations, converged = model.solve("max_res", _residual(problem, dt), "max_iter", 60)
        if iterations >= 60 and not converged:
            raise RuntimeError(f"Newton's method has not converged at t = {k * dt:.6g}")
        q[k], v[k] = model.variable("q"), model.variable("Dot_q")
        model.shift_variables_for_time_integration()
    return np.linspace(0.0, problem.t_end, steps + 1), q, v


def _residual(problem: Problem, dt: float) -> float:
    """Of an error of 1e-12 in a displacement."""
    stops = [abs(c[side]) for c in problem.contacts for side in ("lower", "upper") if side in c]
    size = max([*stops, *np.abs(problem.q), *np.abs(problem.v) * dt])
    return 1e-12 * size * float(np.max(np.abs(problem.M)) / dt**2 + np.max(np.abs(problem.K)))


if __name__ == "__main__":
    gf.util_trace_level(0)
    version = debian_version("python3-getfem")
    main("GetFEM Newmark", version, "beta 1/4, gamma 1/2, Newton to 1e-12 of the displacement", solve, limit=1.5e3)
