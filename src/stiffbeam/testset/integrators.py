"""Integrators: schemes, reference solvers, users' functions and recorded runs, with one interface.

The score and the studies accept each of them, under a unique label.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..basics.resources import clock
from ..basics.validation import InputError, near, number, one_of, positive
from ..march.integrate import integrate
from ..model.system import System
from ..references import solve
from ..references.registry import ADAPTIVE, REFERENCES, RTOL
from ..schemes import RIGID, SCHEMES, Scheme
from ..schemes.labels import KNOWN_FORMS, parse_run, scheme_of, user_object
from ..trajectory.trajectory import Diverged, SolverFailure, Trajectory, Work
from .measure import Motion, motion_of
from .problem import Problem

TOLERANCES = (1e-4, 1e-6, 1e-8)
SOLVERS = ("exact", "cvode-adams", "dop853")  # one of each kind; others by name
DEFAULT = (*SCHEMES, *RIGID, *SOLVERS)
SCHEME, SOLVER, FUNCTION, RECORDED, PROBLEMS = "scheme", "solver", "function", "recorded", "problems"
REPEATS = 3  # the fastest counts: other work of the machine is no cost of the method
ENOUGH = 0.2  # seconds, after which a run is not repeated
SAME_STEP = 1e-9  # relative difference of steps that are one


@dataclass(frozen=True)
class Integrator:
    """Source of runs.

    label: its name in tables and pictures. kind: SCHEME, SOLVER, FUNCTION or RECORDED. source: the Scheme, the name of
    the reference solver, the function(system, dt, t_end), or the tuple of recorded runs. order: on smooth motion, NaN
    where it is not known.
    """

    label: str
    kind: str
    source: Any
    order: float = float("nan")

    @property
    def adaptive(self) -> bool:
        """True where its levels are tolerances, not steps."""
        return self.kind == SOLVER

    def levels(self, problem: Problem) -> Sequence[float]:
        """Steps or tolerances on a problem, the coarsest first."""
        if self.kind == RECORDED:
            return sorted(len(run.t) - 1 for run in self.source if run.fingerprint == problem.system.fingerprint)
        if self.kind != SOLVER:
            return problem.steps
        return TOLERANCES if REFERENCES[self.source].kind == ADAPTIVE else TOLERANCES[-1:]

    def run(self, system: System, dt: float, t_end: float, contact: str = "implicit", every: int = 1) -> Trajectory:
        """Return its run of a system with steps dt to t_end.

        A solver chooses its own steps, to its default tolerance, and has outputs at multiples of dt. contact, every:
        for a scheme, see ``integrate``.

        Raises Diverged and SolverFailure if there is no run, InputError if it does not support the system.
        """
        if self.kind == SCHEME:
            return integrate(system, self.source, dt, t_end, contact, every=every)
        if self.kind == SOLVER:
            return solve(system, t_end, self.source, np.arange(round(t_end / dt) + 1) * dt, RTOL, None)
        if self.kind == FUNCTION:
            return _called(self, system, dt, t_end)
        for run in self.source:
            if abs(run.provenance["dt"] - dt) <= SAME_STEP * dt:
                return run
        rule, steps = f"have been recorded by {self.label}", ", ".join(f"{r.provenance['dt']:g}" for r in self.source)
        raise InputError("dt", dt, rule, f"it was with {steps}")

    def solve(self, problem: Problem, level: float, t_end: float) -> Made:
        """Return its run of a problem at one of its levels."""
        by_kind = {SCHEME: _by_scheme, SOLVER: _by_solver, FUNCTION: _by_function, RECORDED: _by_record}
        return by_kind[self.kind](self.source, problem, level, t_end)


@dataclass(frozen=True)
class ProblemSolver(Integrator):
    """Integrator for the score alone, which needs the whole problem: source(problem, level, t_end) makes a run.

    tolerances: True where its levels are tolerances.
    """

    kind: str = PROBLEMS
    source: Any = None
    tolerances: bool = True

    @property
    def adaptive(self) -> bool:
        """True where its levels are tolerances, not steps."""
        return self.tolerances

    def levels(self, problem: Problem) -> Sequence[float]:
        """Steps or tolerances on a problem, the coarsest first."""
        return TOLERANCES if self.tolerances else problem.steps

    def run(self, system: System, dt: float, t_end: float, contact: str = "implicit", every: int = 1) -> Trajectory:
        """Raise InputError: it runs problems of the test set only."""
        raise InputError("integrator", self.label, "run any system, not problems alone", "stiffbeam score takes it")

    def solve(self, problem: Problem, level: float, t_end: float) -> Made:
        """Return its run of a problem at one of its levels."""
        return self.source(problem, level, t_end)


def integrator(given: Any, order: float | None = None) -> Integrator:
    """Return the integrator that ``given`` names or is.

    Parameters
    ----------
    given : Scheme, str, callable, Trajectory or list of Trajectory
        A Scheme; a label such as "HHT(alpha=-0.1)" or "dop853"; a function solve(system, dt, t_end) that returns times
        and positions (t, u), with velocities (t, u, v), or a Trajectory; recorded runs of one name
        (``Trajectory.from_arrays``); "module:name" of any of these.
    order : float, optional
        Order of a scheme or function on smooth motion.

    Raises
    ------
    InputError
        For anything else.

    Examples
    --------
    >>> integrator("HHT(alpha=-0.1)").kind, integrator("dop853").kind
    ('scheme', 'solver')
    """
    if isinstance(given, Integrator):
        return given
    if isinstance(given, str):
        # A reference solver by its name, else "module:name", else the label of a scheme.
        if given in REFERENCES:
            return Integrator(given, SOLVER, given)
        named = user_object(given) if re.fullmatch(r"[\w.]+:\w+", given) else None
        if named is not None and not isinstance(named, type):
            return replace(integrator(named, order), label=given)
        return integrator(parse_run(given)[0], order)
    if isinstance(given, Scheme):
        return Integrator(str(given), SCHEME, given, given.order if order is None else positive("order", order))
    if isinstance(given, Trajectory):
        return integrator([given])
    if isinstance(given, (list, tuple)) and given and all(isinstance(run, Trajectory) for run in given):
        names = list(dict.fromkeys(str(run.provenance["method"]) for run in given))
        if len(names) > 1:
            raise InputError("recorded runs", names, "have one name", "give each integrator's in a list of its own")
        # Recorded runs may have the name of a method of the package: their label must differ from it.
        taken = names[0] in REFERENCES or scheme_of(names[0]) is not None
        return Integrator(f"{names[0]} (recorded)" if taken else names[0], RECORDED, tuple(given))
    if callable(given) and not isinstance(given, type):
        return Integrator(_function_label(given), FUNCTION, given, float("nan") if order is None else float(order))
    remedy = "give a Scheme, the name of one or of a reference solver, a function solve(system, dt, t_end), or runs"
    raise InputError("integrator", given, "be something that can be run", remedy)


def parse_integrator(text: str, form: str) -> tuple[Integrator, str]:
    """Return the integrator and the form of ``integrator[@form]``, the form ``form`` where none is written."""
    name, at, named = (part.strip() for part in text.partition("@"))
    if name in REFERENCES or re.fullmatch(r"[\w.]+:\w+", name):
        if at:
            one_of("form", named, KNOWN_FORMS, "be one that there is")
        return integrator(name), named or form
    scheme, form = parse_run(text, form)
    return integrator(scheme), form


def integrators(given: Iterable[Any], order: float | None = None) -> list[Integrator]:
    """Return the integrators of a list, each label once: a second of one label gets a number.

    Recorded runs of one name that stand in the list one by one are one integrator.
    """
    runs: dict[str, list[Trajectory]] = {}
    first: list[Any] = []
    for x in given:
        if isinstance(x, Trajectory):
            name = str(x.provenance["method"])
            if name not in runs:
                first.append(runs.setdefault(name, []))
            runs[name].append(x)
        else:
            first.append(x)
    chosen = [integrator(x, order) for x in first]
    labels = [x.label for x in chosen]
    earlier = [labels[:i].count(label) for i, label in enumerate(labels)]
    return [replace(x, label=f"{x.label} ({k + 1})") if k else x for x, k in zip(chosen, earlier, strict=True)]


def _function_label(function: Any) -> str:
    """``module:function`` where another process can find it, else its bare name."""
    name = getattr(function, "__name__", type(function).__name__)
    label = f"{getattr(function, '__module__', None)}:{name}"
    try:
        return label if re.fullmatch(r"[\w.]+:\w+", label) and user_object(label) is function else name
    except InputError:
        return name


def _called(maker: Integrator, system: System, dt: float, t_end: float) -> Trajectory:
    """Return the result of a function on a system, as a run."""
    begun = clock()
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            returned = maker.source(system, dt, t_end)
    except (InputError, Diverged, SolverFailure):
        raise
    except Exception as error:  # of a function of anyone's
        reason = f"{type(error).__name__}: {error}"
        raise SolverFailure(maker.label, 0.0, reason, "the function raised this") from error
    seconds = clock() - begun
    if isinstance(returned, Trajectory):
        work = returned.work if np.isfinite(returned.work.seconds) else replace(
            returned.work, seconds=seconds, march_seconds=seconds
        )  # fmt: skip
        run = replace(returned, work=work, provenance=returned.provenance | {"method": maker.label})
    else:
        t, u, v = _finite_arrays(returned, maker.label)
        if u.ndim == 2 and v is None:
            u = system.positions(t, u)[:, system.tip_channel]
        states = (u, v) if u.ndim == 2 and v is not None else None
        tips = (u, v) if states is None else (None, None)
        run = Trajectory.from_arrays(t, *tips, system=system, states=states, name=maker.label)
        run = replace(run, work=Work(round(t_end / dt), seconds, seconds))
    if not run.t[-1] >= t_end * (1.0 - SAME_STEP):
        raise SolverFailure(maker.label, float(run.t[-1]), "it returned no later times", f"return all to {t_end:g}")
    return run


def _finite_arrays(returned: Any, label: str) -> tuple[Any, Any, Any]:
    """Return t, u and v of a function, v None where it has none. Raises Diverged where they are not finite from some
    time on, InputError for no tuple of two, three or, with gradients, four."""
    if not isinstance(returned, (tuple, list)) or len(returned) not in (2, 3, 4):
        rule, remedy = "return (t, u), (t, u, v) or (t, u, v, gradients)", "return a tuple of arrays"
        raise InputError("the integrator", type(returned).__name__, rule, remedy)
    arrays = [np.asarray(x, float) for x in returned[:3] if x is not None]
    bad = [~np.all(np.isfinite(x.reshape(len(x), -1)), axis=1) for x in arrays[1:] if x.ndim]
    if any(len(x) == len(arrays[0]) and np.any(x) for x in bad):
        first = min(int(np.argmax(x)) for x in bad if np.any(x))
        raise Diverged(label, float(arrays[0][first]), "more steps may help")
    return arrays[0], arrays[1], arrays[2] if len(arrays) > 2 else None


def _gradients(problem: Problem, returned: Any) -> Mapping[str, float] | None:
    """Return the gradients of a function that has some. Raises InputError for anything but numbers by path, and for
    paths of which none is known."""
    if len(returned) < 4:
        return None
    gradients = returned[3]
    rule = 'map paths of parameters such as "q0[0]" to derivatives of the tip at t_end'
    if not isinstance(gradients, Mapping):
        raise InputError("gradients", type(gradients).__name__, rule, "return a dictionary")
    known = problem.derivatives.get("tip", {})
    if gradients and known and not known.keys() & gradients:
        path = str(next(iter(gradients)))
        raise InputError("gradients", path, f"name a derivative that {problem.name} has", near(path, sorted(known)))
    return {str(path): number("gradients", value) for path, value in gradients.items()}


# ---------------------------------------------------------------- runs of a problem with a known answer


@dataclass(frozen=True)
class Made:
    """One run of a problem. level: its number of steps, or its relative tolerance. cost: stages, or right-hand sides;
    for a function its steps. motion: up to the problem's t_end, or to that of its statistics."""

    level: float
    cost: float
    seconds: float
    motion: Motion


def _by_scheme(scheme: Scheme, problem: Problem, steps: float, t_end: float) -> Made:
    run = integrate(problem.system, scheme, t_end / steps, t_end)
    states = None
    if problem.system.size == 1:
        states = run.tip[-1:], run.tip_velocity[-1:]
    elif t_end == problem.t_end:
        q, v = run.states
        states = q[-1], v[-1]
    record = run.contacts[0]
    motion = Motion(run.t, run.tip, run.tip_velocity, states, record.position, record.velocity)
    return Made(steps, steps * len(scheme.nodes), run.work.seconds, motion)


def _by_solver(method: str, problem: Problem, rtol: float, t_end: float) -> Made:
    times = np.append(0.0, problem.times)
    run = solve(problem.system, t_end, method, times, rtol, None)
    impacts = run.impacts if run.impacts.kind == "event" else None
    q, v = run.states
    record = run.contacts[0]
    peak = record.peak_force if impacts is not None else None
    paths = list(problem.derivatives.get("tip", ())) if method == "exact" and t_end == problem.t_end else []
    gradients = dict(zip(paths, run.derivative(paths, run.t[-1:]).tip[-1].tolist(), strict=True)) if paths else None
    motion = Motion(
        run.t, run.tip, run.tip_velocity, (q[-1], v[-1]), impacts=impacts, peak_force=peak, gradients=gradients
    )
    cost = max([0, *run.work.counters.values()])
    return Made(rtol, cost, run.work.seconds, motion)


def _by_function(function: Any, problem: Problem, steps: float, t_end: float) -> Made:
    system = problem.system  # before the clock: refused where there is none
    begun = clock()
    with np.errstate(over="ignore", invalid="ignore"):
        returned = function(system, t_end / steps, t_end)
    seconds = clock() - begun
    if isinstance(returned, Trajectory):
        returned = (returned.t, returned.tip, returned.tip_velocity)
    try:
        motion = motion_of(problem, *_finite_arrays(returned, "it"), t_end=t_end)
        return Made(steps, steps, seconds, replace(motion, gradients=_gradients(problem, returned)))
    except InputError as error:  # it has taken the problem, and failed
        raise ValueError(str(error)) from None


def _by_record(runs: Sequence[Trajectory], problem: Problem, steps: float, t_end: float) -> Made:
    same = (run for run in runs if run.fingerprint == problem.system.fingerprint and len(run.t) - 1 == steps)
    run = next(same)
    states = None
    if problem.system.size > 1 and run.pieces is not None:
        last = int(np.argmin(np.abs(run.t - t_end)))
        q, v = run.states
        states = q[last], v[last]
    motion = replace(motion_of(problem, run.t, run.tip, run.tip_velocity, t_end), states=states)
    record = run.contacts[0]
    if np.all(np.isfinite(record.position)):
        motion = replace(motion, position=record.position, velocity=record.velocity)
    return Made(steps, max(run.work.counters.values(), default=int(steps)), run.work.seconds, motion)


def fastest(run: Callable[[], Trajectory]) -> Trajectory:
    """The fastest of up to REPEATS runs; fewer repeats if a run takes long."""
    runs = [run()]
    while len(runs) < REPEATS and sum(one.work.seconds for one in runs) < ENOUGH:
        runs.append(run())
    return min(runs, key=lambda one: one.work.march_seconds)
