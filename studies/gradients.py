"""Errors of gradients through contact: other engines and schemes on the test set's known derivatives.

    python studies/gradients.py            the engines without a record in studies/gradients.json, ten minutes for all,
                                           and the tables of studies/guide/derivatives.md from the records

Value: error of the tip at the end over the largest displacement. Gradient: largest relative error of its derivatives in
the parameters that the problem knows. diffrax: jax.grad through the solve, the contact a penalty force. SciPy: central
differences of solve_ivp, through the contacts or restarted at events. heyoka: variational equations, restarted at
events. CasADi: forward sensitivities, through the contacts or with its events. MJX: jax.jacfwd through MuJoCo's steps.
nosnoc: variational equations, every contact the end of an element. Schemes: central differences of their runs. CasADi,
MJX and nosnoc (`pip install casadi mujoco-mjx nosnoc`) are needed only for their records.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg

import stiffbeam as sb
from stiffbeam.model.members import with_values
from stiffbeam.testset.problem import Problem

sys.path.insert(0, str(Path(__file__).parent / "test_set"))
PAGE = Path(__file__).parent / "guide" / "derivatives.md"
RECORDS = Path(__file__).with_suffix(".json")
BEGIN, END = "<!-- made by studies/gradients.py -->", "<!-- end -->"
COMPLIANT = ("bilinear-gap", "two-mass-chain", "hertz")
LIBRARIES = {
    "diffrax": "diffrax",
    "SciPy": "scipy",
    "heyoka": "heyoka",
    "CasADi": "casadi",
    "MJX": "mujoco-mjx",
    "nosnoc": "nosnoc",
}
RIGID = ("impact-oscillator", "impact-transient")
HALF_PERIOD = 8.0  # of the spring in the place of a rigid stop of MuJoCo, in steps
SOLIMP = "0.9999 0.9999 0.001 0.5 2"  # almost all of the force at a limit is that of this spring
WIDTH = 1e-6  # of a parameter, of central differences
Found = tuple[float, Mapping[str, float]]  # tip at the end, and its derivatives


def tip_by_theta(problem: Problem) -> tuple[list[str], np.ndarray]:
    """Paths of the known derivatives, and the values of the parameters."""
    paths = list(problem.derivatives["tip"])
    return paths, np.array([value_of(problem, path) for path in paths])


def value_of(problem: Problem, path: str) -> float:
    """The number of a parameter in the problem's data."""
    from derivatives import place

    table, key = place(problem.data, path)
    return float(table[key])


def differences(problem: Problem, tip: Callable[[Mapping[str, float]], float]) -> Found:
    """Central differences of a function of the parameters."""
    paths, theta = tip_by_theta(problem)
    found = {}
    for path, value in zip(paths, theta, strict=True):
        h = WIDTH * (abs(value) or 1.0)
        found[path] = (tip({path: value + h}) - tip({path: value - h})) / (2.0 * h)
    return tip({}), found


class Model:
    """Equations of a problem with one contact, in NumPy or JAX: y = (q, q'), theta by path."""

    def __init__(self, problem: Problem) -> None:
        data = problem.data
        self.problem, self.n, self.contact = problem, len(data["initial_displacement"]), data["contacts"][0]
        self.inverse = np.linalg.inv(np.array(data["mass"], float))
        self.K, self.row = np.array(data["stiffness"], float), np.array(self.contact["row"], float)

    def law(self, theta: Mapping[str, Any], name: str) -> Any:
        default = self.contact.get(name, 1.0 if name == "exponent" else 0.0)
        return theta.get(f"contacts[0].stops.{name}", default)

    def start(self, theta: Mapping[str, Any], xp: Any) -> Any:
        names = [f"{x}0[{i}]" for x in "qv" for i in range(self.n)]
        values = [*self.problem.data["initial_displacement"], *self.problem.data["initial_velocity"]]
        return xp.stack([xp.asarray(theta.get(a, b), float) for a, b in zip(names, values, strict=True)])

    def loads(self, t: Any, xp: Any) -> Any:
        """Forces of the loads at t."""
        force = xp.zeros(self.n)
        for load in self.problem.data.get("loads", ()):
            force = force + np.array(load["vector"]) * load["amplitude"] * xp.sin(load["frequency"] * t + load["phase"])
        return force

    def depth(self, y: Any, theta: Mapping[str, Any]) -> Any:
        return self.row @ y[: self.n] - self.law(theta, "upper")

    def rate(self, t: Any, y: Any, theta: Mapping[str, Any], xp: Any, closed: bool | None = None) -> Any:
        """y' with the contact closed, open, or as the depth says."""
        force = self.loads(t, xp) - self.K @ y[: self.n]
        if closed is not False and np.isfinite(self.contact["stiffness"]):
            d, p = self.depth(y, theta), self.law(theta, "exponent")
            inside = d > 0.0
            press = self.law(theta, "stiffness") * (
                d if p == 1.0 else xp.where(inside, xp.where(inside, d, 1.0) ** p, 0)
            )
            force = force - self.row * (press if closed and p == 1.0 else xp.where(inside, press, 0.0))
        return xp.concatenate([y[self.n :], self.inverse @ force])


# ---------------------------------------------------------------- engines


def by_diffrax(solver: str, rtol: float | None = None, steps: int | None = None) -> Callable[[Problem], Found]:
    """jax.grad through diffrax with a penalty force: adaptive, or with equal steps."""

    def engine(problem: Problem) -> Found:
        import diffrax
        import jax
        import jax.numpy as jnp

        model, (paths, theta) = Model(problem), tip_by_theta(problem)
        largest = np.max(np.abs(problem.answers["tip"].value))
        controller = diffrax.ConstantStepSize()
        if rtol is not None:
            controller = diffrax.PIDController(rtol=rtol, atol=rtol * 1e-2 * largest)

        def tip(values: Any) -> Any:
            named = dict(zip(paths, values, strict=True))
            term = diffrax.ODETerm(lambda t, y, args: model.rate(t, y, named, jnp))
            solution = diffrax.diffeqsolve(
                term, getattr(diffrax, solver)(), 0.0, problem.t_end, None if steps is None else problem.t_end / steps,
                model.start(named, jnp), stepsize_controller=controller, max_steps=500_000,
            )  # fmt: skip
            return model.row @ solution.ys[-1, : model.n]

        value, gradient = jax.value_and_grad(tip)(jnp.asarray(theta))
        return float(value), dict(zip(paths, np.asarray(gradient).tolist(), strict=True))

    return engine


def by_scipy(rtol: float, events: bool) -> Callable[[Problem], Found]:
    """Central differences of solve_ivp with DOP853."""

    def engine(problem: Problem) -> Found:
        from scipy.integrate import solve_ivp

        model = Model(problem)
        options = {"method": "DOP853", "rtol": rtol, "atol": rtol * 1e-2 * np.max(np.abs(problem.answers["tip"].value))}

        def tip(theta: Mapping[str, float]) -> float:
            t, y, closed = 0.0, model.start(theta, np), False
            while events:

                def gap(t: float, y: np.ndarray) -> float:
                    return model.depth(y, theta)

                gap.terminal, gap.direction = True, -1.0 if closed else 1.0
                path = solve_ivp(
                    lambda t, y, closed=closed: model.rate(t, y, theta, np, closed), (t, problem.t_end), y,
                    events=gap, **options,
                )  # fmt: skip
                t, y = path.t[-1], path.y[:, -1]
                if path.status != 1:
                    return float(model.row @ y[: model.n])
                if problem.rigid:
                    y = y.copy()
                    y[model.n] *= -model.law(theta, "restitution")
                else:
                    closed = not closed
            path = solve_ivp(lambda t, y: model.rate(t, y, theta, np), (0.0, problem.t_end), y, **options)
            return float(model.row @ path.y[: model.n, -1])

        return differences(problem, tip)

    return engine


def by_heyoka(problem: Problem) -> Found:
    """heyoka's variational equations in double precision, with the change of the derivative at events."""
    from derivatives import tangent

    paths, _ = tip_by_theta(problem)
    tip, found = tangent(dict(problem.data), problem.t_end, paths, bits=53)
    return float(tip), {path: float(pair[0]) for path, pair in found.items()}


def by_casadi(solver: str, rtol: float, events: bool = False) -> Callable[[Problem], Found]:
    """Forward sensitivities of CasADi's integrators, through the contacts or with its events.

    With events a third state, 0 or 1, tells whether the contact is closed; a rigid stop turns the velocity round.
    """

    def engine(problem: Problem) -> Found:
        import casadi as ca

        model, (paths, theta) = Model(problem), tip_by_theta(problem)
        n, data = model.n, problem.data
        x, p, t = ca.SX.sym("x", 2 * n + 1), ca.SX.sym("p", len(paths)), ca.SX.sym("t")
        named = dict(zip(paths, ca.vertsplit(p), strict=True))
        depth = ca.dot(ca.DM(model.row), x[:n]) - model.law(named, "upper")
        closed = x[2 * n] if events else ca.if_else(depth > 0.0, 1.0, 0.0)
        force = -(ca.DM(model.K) @ x[:n])
        for load in data.get("loads", ()):
            force += ca.DM(load["vector"]) * load["amplitude"] * ca.sin(load["frequency"] * t + load["phase"])
        if not problem.rigid:
            exponent = model.law(named, "exponent")
            press = depth
            if exponent != 1.0:  # no power of a negative number, not even where it is multiplied by zero
                press = ca.if_else(depth > 0.0, ca.if_else(depth > 0.0, depth, 1.0) ** exponent, 0.0)
            force -= ca.DM(model.row) * closed * model.law(named, "stiffness") * press
        ode = ca.vertcat(x[n : 2 * n], ca.DM(model.inverse) @ force, 0.0)
        equations = {"x": x, "p": p, "t": t, "ode": ode}
        options: dict[str, Any] = {"abstol": rtol * 1e-2 * float(np.max(np.abs(problem.answers["tip"].value)))}
        options |= {"reltol": rtol, "max_num_steps": 10**7, "enable_reverse": False, "enable_jacobian": False}
        if events:
            equations["zero"] = (2.0 * closed - 1.0) * depth
            after = ca.vertcat(x[: 2 * n], 1.0 - closed)
            if problem.rigid:
                after = ca.vertcat(x[:n], -model.law(named, "restitution") * x[n : 2 * n], 0.0)
            index, z, u = ca.SX.sym("index"), ca.SX(0, 1), ca.SX(0, 1)
            options["transition"] = ca.Function(
                "transition", [index, t, x, z, p, u], [after, z], ca.event_in(), ca.event_out()
            )
            options["max_events"] = 10_000
        flow = ca.integrator("flow", solver, equations, 0.0, problem.t_end, options)
        values = ca.MX.sym("values", len(paths))
        mixed = dict(zip(paths, ca.vertsplit(values), strict=True))
        names = [f"{name}0[{i}]" for name in "qv" for i in range(n)]
        numbers = [*data["initial_displacement"], *data["initial_velocity"]]
        start = ca.vertcat(*(mixed.get(a, b) for a, b in zip(names, numbers, strict=True)), 0.0)
        tip = ca.dot(ca.DM(model.row), flow(x0=start, p=values)["xf"][:n])
        value, gradient = ca.Function("tip", [values], [tip, ca.jacobian(tip, values)])(theta)
        return float(value), dict(zip(paths, np.asarray(gradient)[0].tolist(), strict=True))

    return engine


def by_nosnoc(windows: int) -> Callable[[Problem], Found]:
    """Variational equations as further states of nosnoc, whose elements (Radau IIA, three stages) end at the switch.

    windows: boundary problems that are solved one after the other, with two elements each.
    """

    def engine(problem: Problem) -> Found:
        import casadi as ca
        import nosnoc

        model, (paths, theta) = Model(problem), tip_by_theta(problem)
        n, columns = model.n, len(paths)
        y, S, p = ca.SX.sym("y", 2 * n), ca.SX.sym("S", 2 * n, columns), ca.SX.sym("p", columns)
        named = dict(zip(paths, ca.vertsplit(p), strict=True))
        depth = ca.dot(ca.DM(model.row), y[:n]) - model.law(named, "upper")
        press = model.law(named, "stiffness") * depth
        if (exponent := model.law(named, "exponent")) != 1.0:
            press *= ca.if_else(depth > 0.0, depth, 0.0) ** (exponent - 1.0)
        flows = []
        for force in (0.0, press):  # open, closed
            rate = ca.vertcat(y[n:], ca.DM(model.inverse) @ (-(ca.DM(model.K) @ y[:n]) - ca.DM(model.row) * force))
            moved = ca.jacobian(rate, y) @ S + ca.jacobian(rate, p)
            flows.append(ca.substitute(ca.vertcat(rate, ca.vec(moved)), p, ca.DM(theta)))
        names = [f"{x}0[{i}]" for x in "qv" for i in range(n)]
        start = np.concatenate([model.start({}, np), np.ravel([[a == b for a in names] for b in paths])])
        options = nosnoc.NosnocOpts()
        options.irk_scheme, options.n_s, options.N_finite_elements = nosnoc.IrkSchemes.RADAU_IIA, 3, 2
        options.terminal_time, options.comp_tol, options.sigma_N = problem.t_end / windows, 1e-6, 1e-6
        equations = nosnoc.NosnocModel(
            x=ca.vertcat(y, ca.vec(S)), F=[ca.horzcat(*flows)], S=[np.array([[-1], [1]])],
            c=[ca.substitute(depth, p, ca.DM(theta))], x0=start,
        )  # fmt: skip
        run = nosnoc.NosnocSimLooper(nosnoc.NosnocSolver(options, equations), start, windows)
        run.run()
        end = np.array(run.get_results()["X_sim"])[-1]
        gradient = model.row @ end[2 * n :].reshape(columns, 2 * n)[:, :n].T
        return float(model.row @ end[:n]), dict(zip(paths, gradient.tolist(), strict=True))

    return engine


def by_mjx(steps: int) -> Callable[[Problem], Found]:
    """Forward derivatives through MuJoCo's steps (RK4), with the model of `engines/mujoco_engine.py`.

    Unit masses on slide joints, one for each mode; the contact is a tendon with a dead band, or with a limit for a
    rigid stop. A limit has no restitution: a damped spring whose half period is HALF_PERIOD steps gives back the
    same share of the speed. The load is held over each step at its value in the middle.
    """

    def engine(problem: Problem) -> Found:
        import jax
        import jax.numpy as jnp
        import mujoco
        from mujoco import mjx

        model, (paths, theta) = Model(problem), tip_by_theta(problem)
        if model.law({}, "exponent") != 1.0:
            raise sb.InputError("stops.exponent", model.law({}, "exponent"), "be 1 for a tendon", "take another engine")
        data, dt = problem.data, problem.t_end / steps
        squares, shapes = scipy.linalg.eigh(np.array(data["stiffness"], float), np.array(data["mass"], float))
        joints = "".join(
            f'<body><joint name="z{i}" type="slide" axis="1 0 0" stiffness="{w!r}"/>'
            f'<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>' for i, w in enumerate(squares.tolist())
        )  # fmt: skip
        tendon = "".join(f'<joint joint="z{i}" coef="{x!r}"/>' for i, x in enumerate((model.row @ shapes).tolist()))
        law = 'stiffness="1" springlength="-1e9 0"'
        if problem.rigid:
            law = f'limited="true" range="-1e9 0" solreflimit="-1 -1" solimplimit="{SOLIMP}"'
        xml = mujoco.MjModel.from_xml_string(
            f'<mujoco><compiler autolimits="false"/><option timestep="{dt!r}" gravity="0 0 0" integrator="RK4" '
            f'tolerance="1e-14" iterations="200"/><worldbody>{joints}</worldbody>'
            f"<tendon><fixed {law}>{tendon}</fixed></tendon></mujoco>"
        )
        still, at_rest = mjx.put_model(xml), mjx.make_data(xml)
        back = shapes.T @ np.array(data["mass"], float)

        def tip(values: Any) -> Any:
            named = dict(zip(paths, values, strict=True))
            ends = jnp.array([[-1e9, 1.0]]).at[0, 1].set(model.law(named, "upper"))
            if problem.rigid:
                limit = jnp.stack(spring_of(model.law(named, "restitution"), dt))[None]
                changed = still.replace(tendon_range=ends, tendon_solref_lim=-limit)
            else:
                stiffness = jnp.full(1, model.law(named, "stiffness"))
                changed = still.replace(tendon_lengthspring=ends, tendon_stiffness=stiffness)
            y = model.start(named, jnp)

            def step(state: Any, k: Any) -> Any:
                force = shapes.T @ model.loads((k + 0.5) * dt, jnp)
                after = mjx.step(changed, at_rest.replace(qpos=state[0], qvel=state[1], qfrc_applied=force))
                return (after.qpos, after.qvel), None

            (z, _), _ = jax.lax.scan(step, (back @ y[: model.n], back @ y[model.n :]), jnp.arange(steps))
            return model.row @ (shapes @ z), model.row @ (shapes @ z)

        gradient, value = jax.jit(jax.jacfwd(tip, has_aux=True))(jnp.asarray(theta))
        return float(value), dict(zip(paths, np.asarray(gradient).tolist(), strict=True))

    return engine


def spring_of(restitution: Any, dt: float) -> tuple[Any, Any]:
    """Stiffness and damping, over the mass, of the spring that returns this share of the speed when its force is zero.

    e = exp(-2 s atan(1/s)), s = zeta/sqrt(1 - zeta^2).
    """
    import jax
    import jax.numpy as jnp

    def log_e(s: Any) -> Any:
        return -2.0 * s * jnp.arctan2(1.0, s)

    aim, s = jnp.log(restitution), 0.1
    for _ in range(30):  # Newton's steps, the last of which carries the derivative
        s = s - (log_e(s) - aim) / jax.grad(log_e)(s)
    decay = np.pi / (HALF_PERIOD * dt)
    return decay**2 * (1.0 + s * s), 2.0 * decay * s


def by_scheme(scheme: Any, steps: int, contact: str = "implicit") -> Callable[[Problem], Found]:
    """Central differences of runs of a scheme."""

    def engine(problem: Problem) -> Found:
        def tip(theta: Mapping[str, float]) -> float:
            system = with_values(problem.system, dict(theta)) if theta else problem.system
            return float(sb.integrate(system, scheme, problem.t_end / steps, problem.t_end, contact).tip[-1])

        return differences(problem, tip)

    return engine


def by_exact(problem: Problem) -> Found:
    """``reference.derivative``."""
    paths, _ = tip_by_theta(problem)
    run = sb.reference(problem.system, problem.t_end)
    return float(run.tip[-1]), dict(zip(paths, run.derivative(paths, run.t[-1:]).tip[-1].tolist(), strict=True))


ENGINES: dict[str, Callable[[Problem], Found]] = {
    "diffrax Tsit5, rtol 1e-6, jax.grad": by_diffrax("Tsit5", 1e-6),
    "diffrax Tsit5, rtol 1e-9": by_diffrax("Tsit5", 1e-9),
    "diffrax Kvaerno5, rtol 1e-6": by_diffrax("Kvaerno5", 1e-6),
    "diffrax Kvaerno5, rtol 1e-9": by_diffrax("Kvaerno5", 1e-9),
    "diffrax Tsit5, 1000 equal steps": by_diffrax("Tsit5", steps=1000),
    "diffrax Tsit5, 16 000 equal steps": by_diffrax("Tsit5", steps=16_000),
    "SciPy DOP853, rtol 1e-6, differences": by_scipy(1e-6, events=False),
    "SciPy DOP853, rtol 1e-12, differences": by_scipy(1e-12, events=False),
    "SciPy DOP853, rtol 1e-12, restarted at events": by_scipy(1e-12, events=True),
    "heyoka, variational equations": by_heyoka,
    "CasADi CVODES, rtol 1e-6, forward sensitivities": by_casadi("cvodes", 1e-6),
    "CasADi CVODES, rtol 1e-10": by_casadi("cvodes", 1e-10),
    "CasADi erk, rtol 1e-9": by_casadi("erk", 1e-9),
    "CasADi erk, rtol 1e-12, with events": by_casadi("erk", 1e-12, events=True),
    "nosnoc, Radau IIA, 100 elements, variational equations": by_nosnoc(50),
    "MJX RK4, 1000 steps, jax.jacfwd": by_mjx(1000),
    "MJX RK4, 16 000 steps": by_mjx(16_000),
    "trapezoidal, 16 000 steps, differences": by_scheme(sb.Trapezoidal(), 16_000),
    "trapezoidal, conserving contact": by_scheme(sb.Trapezoidal(), 16_000, "conserving"),
    "trapezoidal, averaged contact": by_scheme(sb.Trapezoidal(), 16_000, "averaged"),
    "exact solution, `reference.derivative`": by_exact,
}
OF_RIGID: dict[str, Callable[[Problem], Found]] = {
    "SciPy DOP853, rtol 1e-12, restarted at events, differences": by_scipy(1e-12, events=True),
    "heyoka, variational equations": by_heyoka,
    "CasADi erk, rtol 1e-12, with events, forward sensitivities": by_casadi("erk", 1e-12, events=True),
    "MJX RK4, 1000 steps, jax.jacfwd": by_mjx(1000),
    "MJX RK4, 16 000 steps": by_mjx(16_000),
    "Moreau-Jean, 16 000 steps, differences": by_scheme(sb.MoreauJean(), 16_000),
    "Paoli-Schatzman, 16 000 steps, differences": by_scheme(sb.PaoliSchatzman(), 16_000),
    "nonsmooth generalised-alpha, 16 000 steps, differences": by_scheme(sb.NonsmoothGeneralisedAlpha(), 16_000),
    "exact solution, `reference.derivative`": by_exact,
}


def errors(problem: Problem, found: Found) -> tuple[float, float]:
    """Errors of value and gradient."""
    known, (tip, gradient) = problem.answers["tip"].value, found
    off = [abs(x / problem.derivatives["tip"][path].value - 1.0) for path, x in gradient.items()]
    return abs(tip - known[-1]) / float(np.max(np.abs(known))), max(off)


def record(engines: Mapping[str, Callable[[Problem], Found]], names: Sequence[str]) -> None:
    """Add the errors of every engine on every problem to the records; those that are there stay."""
    records = json.loads(RECORDS.read_text(encoding="utf-8")) if RECORDS.exists() else {}
    for label, engine in engines.items():
        for name in names:
            of_engine = records.setdefault(label, {})
            library = LIBRARIES.get(label.partition(",")[0].split()[0])
            if name in of_engine:
                continue
            begun = time.perf_counter()
            try:
                value, gradient = errors(sb.problem(name), engine(sb.problem(name)))
                of_engine[name] = {"value": value, "gradient": gradient}
            except sb.InputError:  # no exact solution for a power law
                of_engine[name] = {"value": None, "gradient": None}
            if library:
                records.setdefault("made with", {})[library] = version(library)
            print(f"{label}, {name}: {of_engine[name]}, {time.perf_counter() - begun:.1f} s", flush=True)
            RECORDS.write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")


def table(engines: Mapping[str, Callable[[Problem], Found]], names: Sequence[str]) -> list[str]:
    """Rows of value and gradient of every engine on every problem, from the records."""
    records = json.loads(RECORDS.read_text(encoding="utf-8"))
    heads = " | ".join(f"{name}: value | gradient" for name in names)
    rows = [f"| engine | {heads} |", "|---" * (1 + 2 * len(names)) + "|"]
    for label in engines:
        cells = [shown(records[label][name][what]) for name in names for what in ("value", "gradient")]
        rows.append(f"| {label} | {' | '.join(cells)} |")
    return rows


def shown(x: float | None) -> str:
    """An error with one digit."""
    return "–" if x is None else f"{x:.0e}"


def main() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    record(OF_RIGID, RIGID)
    record(ENGINES, COMPLIANT)
    made_with = json.loads(RECORDS.read_text(encoding="utf-8"))["made with"]
    libraries = ", ".join(f"{library} {number}" for library, number in made_with.items())
    lines = [BEGIN, "", *table(ENGINES, COMPLIANT), "", "Rigid stops:", "", *table(OF_RIGID, RIGID), "",
             f"Made with {libraries}.", "", END]  # fmt: skip
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(before + "\n".join(lines) + rest.partition(END)[2], encoding="utf-8")


if __name__ == "__main__":
    main()
