"""SciPy with events and diffrax on the test set, with the options that suit them best.

    python studies/other_engines.py            writes studies/other_engines.md, two minutes

SciPy: solve_ivp with DOP853, a terminal event at every switch and a new start with a smooth right-hand side;
a rigid stop turns the velocity round at the event. diffrax: Dopri8 with its PID controller, through the switches,
since its events end a solve; no rigid stops. Both get rtol, and rtol/1000 of the largest known displacement as atol.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import stiffbeam as sb
from stiffbeam.testset.integrators import Made, ProblemSolver
from stiffbeam.testset.measure import motion_of
from stiffbeam.testset.problem import Problem, matrix

MOST_EVENTS = 5_000


class Model:
    """A problem's equations from its file: y = (q, q'), contacts on sides chi (0 free, +-1 on a stop)."""

    def __init__(self, problem: Problem) -> None:
        data = problem.data
        self.n = len(data["initial_displacement"])
        mass, stiffness = matrix(data["mass"]), matrix(data["stiffness"])
        damping = matrix(data["damping"]) if "damping" in data else 0.0 * mass
        self.inverse = np.linalg.inv(mass)
        self.A = np.block([[np.zeros_like(mass), np.eye(self.n)], [-self.inverse @ stiffness, -self.inverse @ damping]])
        self.loads = [(self.inverse @ vector, function) for vector, function in problem.system.loads]
        self.contacts = data["contacts"]
        self.rows = [np.array(c["row"]) for c in self.contacts]
        self.offsets = [contact.offset or sb.Constant(0.0) for contact in problem.system.contacts]
        self.start = np.array([*data["initial_displacement"], *data["initial_velocity"]], float)

    def free(self, t: float, y: np.ndarray) -> np.ndarray:
        """y' without contact."""
        found = self.A @ y
        for vector, f in self.loads:
            found[self.n :] += vector * f.value(t)
        return found

    def depth(self, i: int, side: int, t: float, y: np.ndarray) -> tuple[float, float]:
        """Penetration into a stop and its rate."""
        offset, n = self.offsets[i], self.n
        u, v = self.rows[i] @ y[:n] + offset.value(t), self.rows[i] @ y[n:] + offset.rate(t)
        stop = self.contacts[i]["upper" if side > 0 else "lower"]
        return side * (u - stop), side * v

    def force(self, i: int, side: int, t: float, y: np.ndarray) -> float:
        """What the stop pushes with, before it is cut at zero."""
        (d, rate), c = self.depth(i, side, t, y), self.contacts[i]
        power = np.sign(d) * abs(d) ** c.get("exponent", 1.0)
        return c["stiffness"] * power * (1.0 + c.get("dissipation", 0.0) * rate) + c.get("damping", 0.0) * rate

    def regime(self, chi: list[int]) -> Callable[[float, np.ndarray], np.ndarray]:
        """y' with the stops of ``chi`` pressed."""

        def rhs(t: float, y: np.ndarray) -> np.ndarray:
            found = self.free(t, y)
            for i, side in enumerate(chi):
                if side:
                    found[self.n :] -= side * self.force(i, side, t, y) * (self.inverse @ self.rows[i])
            return found

        return rhs


def scipy_with_events(method: str) -> ProblemSolver:
    def solve(problem: Problem, rtol: float, t_end: float) -> Made:
        model, begun = Model(problem), time.perf_counter()
        times, atol = np.append(0.0, problem.times), rtol * 1e-3 * np.max(np.abs(problem.answers["tip"].value))
        breaks = [x for load in problem.data.get("loads", ()) for x in load.get("times", ()) if 0.0 < x < t_end]
        t, y, work = 0.0, model.start, 0
        chi = [_side(model, i, t, y) for i in range(len(model.contacts))]
        found = [y]
        for _ in range(MOST_EVENTS):
            watched = [_event(model, i, side, chi[i]) for i in range(len(chi)) for side in _watched(model, i, chi[i])]
            until = min([x for x in breaks if x > t], default=t_end)
            run: Any = solve_ivp(model.regime(chi), (t, until), y, method, rtol=rtol, atol=atol, dense_output=True,
                                 events=watched)  # fmt: skip
            work += run.nfev
            inside = times[(times > t) & (times <= run.t[-1])]
            found += [run.sol(x) for x in inside]
            t, y = float(run.t[-1]), run.y[:, -1]
            if t >= t_end:
                states = np.array(found)
                motion = motion_of(problem, times, states[:, : model.n], states[:, model.n :])
                return Made(rtol, work, time.perf_counter() - begun, motion)
            for event, hits in zip(watched, run.t_events, strict=True):
                if len(hits):
                    chi, y = event.after(chi, t, y)  # type: ignore[attr-defined]
        raise RuntimeError(f"{MOST_EVENTS} events by t = {t:.6g}")

    return ProblemSolver(f"SciPy {method}, events", source=solve)


def _side(model: Model, i: int, t: float, y: np.ndarray) -> int:
    """The stop that contact i is on at the start, or moves into from its surface."""
    if model.contacts[i]["stiffness"] == np.inf:
        return 0
    for side in (1, -1):
        if ("upper" if side > 0 else "lower") in model.contacts[i]:
            d, rate = model.depth(i, side, t, y)
            if d > 0.0 or (d == 0.0 and rate > 0.0):
                return side
    return 0


def _watched(model: Model, i: int, side: int) -> list[int]:
    return [side] if side else [s for s, name in ((1, "upper"), (-1, "lower")) if name in model.contacts[i]]


def _event(model: Model, i: int, side: int, now: int) -> Callable[[float, np.ndarray], float]:
    """Where contact i meets the stop on ``side``, or leaves it where it is there ``now``."""
    rigid, damped = model.contacts[i]["stiffness"] == np.inf, model.contacts[i].get("damping", 0.0) > 0.0

    def event(t: float, y: np.ndarray) -> float:
        return model.force(i, side, t, y) if now and damped else model.depth(i, side, t, y)[0]

    def after(chi: list[int], t: float, y: np.ndarray) -> tuple[list[int], np.ndarray]:
        if not rigid:
            return [(0 if now else side) if j == i else c for j, c in enumerate(chi)], y
        row, n = model.rows[i], model.n
        kick = model.inverse @ row / (row @ model.inverse @ row)
        turned = y.copy()
        turned[n:] -= (1.0 + model.contacts[i]["restitution"]) * (row @ y[n:]) * kick
        return chi, turned

    event.terminal, event.direction = True, -1.0 if now else 1.0  # type: ignore[attr-defined]
    event.after = after  # type: ignore[attr-defined]
    return event


def diffrax_through() -> ProblemSolver:
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)

    def solve(problem: Problem, rtol: float, t_end: float) -> Made:
        if problem.rigid:
            raise sb.InputError(
                "stops.stiffness", np.inf, "be finite: events of diffrax end a solve", "use sb.reference"
            )
        model = Model(problem)
        if any("times" in load for load in problem.data.get("loads", ())):
            table = problem.data["loads"][0]
            load = lambda t: jnp.interp(t, jnp.array(table["times"]), jnp.array(table["values"]))  # noqa: E731
        else:
            load = None
        waves = [(jnp.array(p), x) for (p, _), x in zip(model.loads, problem.data.get("loads", ()), strict=True)]
        A, n = jnp.array(model.A), model.n

        def sine(x: dict, t: Any) -> Any:
            return x["constant"] if "constant" in x else x["amplitude"] * jnp.sin(x["frequency"] * t + x["phase"])

        def field(t: Any, y: Any, args: Any) -> Any:
            a = (A @ y)[n:]
            for vector, x in waves:
                a = a + vector * (load(t) if load is not None else sine(x, t))
            for i, c in enumerate(problem.system.contacts):
                o, o_rate = 0.0, 0.0
                if "offset" in model.contacts[i]:
                    x = model.contacts[i]["offset"]
                    o, o_rate = sine(x, t), x["amplitude"] * x["frequency"] * jnp.cos(x["frequency"] * t + x["phase"])
                row = jnp.array(c.row)
                push = c.stops.force_in(jnp, row @ y[:n] + o, row @ y[n:] + o_rate)
                a = a + push * jnp.array(model.inverse @ c.row)
            return jnp.concatenate([y[n:], a])

        times = np.append(0.0, problem.times)
        atol = rtol * 1e-3 * float(np.max(np.abs(problem.answers["tip"].value)))
        jumps = jnp.array(
            sorted({x for w in problem.data.get("loads", ()) for x in w.get("times", ()) if 0 < x < t_end})
        )
        control: Any = diffrax.PIDController(rtol=rtol, atol=atol)
        if len(jumps):
            control = diffrax.ClipStepSizeController(control, jump_ts=jumps)
        begun = time.perf_counter()
        run = diffrax.diffeqsolve(
            diffrax.ODETerm(field), diffrax.Dopri8(), 0.0, t_end, None, jnp.array(model.start),
            saveat=diffrax.SaveAt(ts=jnp.array(times)), stepsize_controller=control, max_steps=2_000_000,
        )  # fmt: skip
        y = np.array(run.ys)
        cost = 13 * int(run.stats["num_steps"])
        return Made(rtol, cost, time.perf_counter() - begun, motion_of(problem, times, y[:, :n], y[:, n:]))

    return ProblemSolver("diffrax Dopri8", source=solve)


PAGE = """# SciPy and diffrax on the test set

`python studies/other_engines.py` writes this page, here with {packages}.
The first lines of the script give the options. Each adaptive solver runs at relative tolerances of 1e-4, 1e-6 and
1e-8. It is flagged if its error exceeds 10⁴ times the last of these. The table also has stiffbeam's own
`dop853`, which is SciPy's solver restarted at every event, and the exact solution.

```text
{card}
```

Both solvers are right on every compliant problem. SciPy's DOP853, with an event and a restart at every change of
contact, needs no setting but its tolerance. The error control of diffrax finds the kinks by itself.

Rigid stops are harder:

* bouncing-ball, preloaded-chatter: once the bounces are short, the gap after a rebound is zero to rounding. The solver
  misses the next event, and the ball falls through the floor. An integrator has to complete such a series itself.
* nonsmooth-mode: the mass passes its stop and returns within one step. Events are searched for between the ends of
  steps, where no sign changes. The remedy is a smaller max_step.
* sticking-phase: the impacts have no end.

Other programs run through adapters: see [MuJoCo, EXUDYN, Siconos, GetFEM and PyBullet](engines/README.md).
"""


def main() -> None:
    engines = [scipy_with_events("DOP853"), diffrax_through()]
    card = sb.score(
        [*engines, "dop853", "exact"], progress=lambda what, done, total: print(f"{done}/{total} {what}", flush=True)
    )
    packages = ", ".join(f"{name} {version(name)}" for name in ("scipy", "diffrax", "jax"))
    text = PAGE.format(packages=packages, card=card)
    (Path(__file__).parent / "other_engines.md").write_text("\n".join(x.rstrip() for x in text.split("\n")), "utf-8")
    print(card)


if __name__ == "__main__":
    main()
