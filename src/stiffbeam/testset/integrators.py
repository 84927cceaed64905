"""What can be scored: a scheme of ours, a solver of ours, or anyone's function, all asked the same way."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..basics.compiled import clock
from ..basics.validation import InputError
from ..march.integrate import integrate
from ..references import solve
from ..references.registry import ADAPTIVE, REFERENCES
from ..schemes import RIGID, SCHEMES, Scheme
from ..schemes.labels import parse_run, user_function
from ..trajectory.trajectory import Diverged, Trajectory
from .measure import Motion, motion_of
from .problem import Problem

TOLERANCES = (1e-4, 1e-6, 1e-8)
SOLVERS = ("exact", "cvode-adams", "dop853")  # one of each kind; others by name
DEFAULT = (*SCHEMES, *RIGID, *SOLVERS)


@dataclass(frozen=True)
class Made:
    """One run. level: its number of steps, or its relative tolerance. cost: stages, or right-hand sides; for a
    function its steps. motion: up to the problem's t_end, or to that of its statistics."""

    level: float
    cost: float
    seconds: float
    motion: Motion


@dataclass(frozen=True)
class Integrator:
    """order: on smooth motion, NaN where it is not known. adaptive: whether its levels are tolerances.

    solve(problem, level, t_end) makes one run of the problem's system; levels(problem) are its levels.
    """

    name: str
    order: float
    adaptive: bool
    solve: Callable[[Problem, float, float], Made]

    def levels(self, problem: Problem) -> Sequence[float]:
        """Steps or tolerances, the coarsest first."""
        if not self.adaptive:
            return problem.steps
        return TOLERANCES if self.name not in REFERENCES or REFERENCES[self.name].kind == ADAPTIVE else TOLERANCES[-1:]


def integrator(given: Any, order: float | None = None) -> Integrator:
    """A Scheme, a label such as "HHT(alpha=-0.1)" or "dop853", or a function solve(system, dt, t_end) -> (t, u) or
    (t, u, v), itself or as "module:function". Raises InputError for anything else."""
    if isinstance(given, Integrator):
        return given
    if isinstance(given, str):
        if given in REFERENCES:
            return Integrator(given, float("nan"), True, lambda *args: _by_solver(given, *args))
        function = user_function(given) if re.fullmatch(r"[\w.]+:\w+", given) else None
        if function is not None and not isinstance(function, Scheme):
            return Integrator(given, float("nan") if order is None else float(order), False, _by_function(function))
        given = parse_run(given)[0] if function is None else function
    if isinstance(given, Scheme):
        own = float(given.order if order is None else order)
        return Integrator(str(given), own, False, lambda *args: _by_scheme(given, *args))
    if callable(given):
        name = getattr(given, "__name__", type(given).__name__)
        return Integrator(name, float("nan") if order is None else float(order), False, _by_function(given))
    remedy = "give a Scheme, the name of one or of a reference solver, or a function solve(system, dt, t_end)"
    raise InputError("integrator", given, "be something that can be run", remedy)


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
    motion = Motion(run.t, run.tip, run.tip_velocity, (q[-1], v[-1]), impacts=impacts, peak_force=peak)
    cost = max([0, *run.work.counters.values()])
    return Made(rtol, cost, run.work.seconds, motion)


def _by_function(function: Callable[..., Any]) -> Callable[[Problem, float, float], Made]:
    def run(problem: Problem, steps: float, t_end: float) -> Made:
        system = problem.system  # before the clock: refused where there is none
        begun = clock()
        with np.errstate(over="ignore", invalid="ignore"):
            found = function(system, t_end / steps, t_end)
        seconds = clock() - begun
        if isinstance(found, Trajectory):
            found = (found.t, found.tip, found.tip_velocity)
        try:
            return Made(steps, steps, seconds, _returned(problem, found, t_end))
        except InputError as error:  # it has taken the problem, and failed
            raise ValueError(str(error)) from None

    return run


def _returned(problem: Problem, found: Any, t_end: float) -> Motion:
    """What a function returned. Raises Diverged where it is not finite from some time on, InputError for what fits
    nothing."""
    if not isinstance(found, (tuple, list)) or len(found) not in (2, 3):
        remedy = "return a tuple of arrays"
        raise InputError("the integrator", type(found).__name__, "return (t, u) or (t, u, v)", remedy)
    arrays = [np.asarray(x, float) for x in found]
    bad = [~np.all(np.isfinite(x.reshape(len(x), -1)), axis=1) for x in arrays[1:] if x.ndim]
    if any(len(x) == len(arrays[0]) and np.any(x) for x in bad):
        first = min(int(np.argmax(x)) for x in bad if np.any(x))
        raise Diverged("it", float(arrays[0][first]), "more steps may help")
    return motion_of(problem, *arrays, t_end=t_end)
