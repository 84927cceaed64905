"""Integrators: whatever makes a Trajectory of a System at a resolution.

A scheme and a user's function have a time step, a reference solver a tolerance, and recorded arrays the steps of their
recording. ``compare`` and ``score`` accept all of them, the studies those that can run, each under a unique label.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .basics.resources import clock
from .basics.validation import InputError
from .march.integrate import integrate
from .model.system import System
from .references import solve
from .references.registry import ADAPTIVE, REFERENCES, RTOL
from .schemes import Scheme
from .schemes.labels import parse_run, scheme_of, user_object
from .trajectory.trajectory import Diverged, SolverFailure, Trajectory, Work

SCHEME, SOLVER, FUNCTION, RECORDED = "scheme", "solver", "function", "recorded"
USER = re.compile(r"[\w.]+:\w+")  # "module:name"
REPEATS = 3  # the fastest counts: other work of the machine is no cost of the method
ENOUGH = 0.2  # seconds, after which a run is not repeated
SAME_STEP = 1e-9  # relative difference of equal times


@dataclass(frozen=True)
class Integrator:
    """Source of runs.

    Parameters
    ----------
    label : str
        Name in tables and pictures.
    kind : {"scheme", "solver", "function", "recorded"}
    source : Scheme, str, callable or tuple of Trajectory
        The scheme, the name of the reference solver, the function(system, dt, t_end), or the recorded runs.
    order : float
        On smooth motion; NaN where it is not known.
    """

    label: str
    kind: str
    source: Any
    order: float = float("nan")

    @property
    def adaptive(self) -> bool:
        """True where its resolution is a tolerance, not a step."""
        return self.kind == SOLVER and REFERENCES[self.source].kind == ADAPTIVE

    def run(self, system: System, dt: float, t_end: float, contact: str = "implicit", every: int = 1) -> Trajectory:
        """Return its run of a system with steps dt to t_end.

        A solver chooses its own steps, to its default tolerance, and has outputs at multiples of dt. Of recorded runs
        the one with the nearest step counts. contact, every: for a scheme, see ``integrate``.

        Raises Diverged and SolverFailure if there is no run, InputError if it does not support the system.
        """
        if self.kind == SCHEME:
            return integrate(system, self.source, dt, t_end, contact, every)
        if self.kind == SOLVER:
            return self.solve(system, RTOL, np.arange(round(t_end / dt) + 1) * dt, t_end)
        if self.kind == FUNCTION:
            return _called(self, system, dt, t_end)
        return min(self.source, key=lambda run: abs(float(run.provenance["dt"]) - dt))

    def solve(self, system: System, rtol: float, times: Any, t_end: float) -> Trajectory:
        """Return the run of a solver to a relative tolerance, at ``times`` (k,); the exact solver has none."""
        return solve(system, t_end, self.source, np.asarray(times, float), rtol, None)

    def work(self, run: Trajectory) -> int:
        """Return the work of its run: steps times stages of a scheme, evaluations or solves of others, else steps."""
        if self.kind == SCHEME:
            return run.work.steps * len(self.source.nodes)
        return max(run.work.counters.values(), default=run.work.steps)


def integrator(given: Any) -> Integrator:
    """Return the integrator that ``given`` names or is.

    Parameters
    ----------
    given : Scheme, str, callable, Trajectory or list of Trajectory
        A Scheme; a label such as "HHT(alpha=-0.1)" or "dop853"; a function solve(system, dt, t_end) that returns times
        and positions (t, u), with velocities (t, u, v), or a Trajectory; recorded runs of one name
        (``Trajectory.from_arrays``); "module:name" of any of these.

    Raises
    ------
    InputError
        For anything else.

    Examples
    --------
    >>> from stiffbeam.integrators import integrator
    >>> integrator("HHT(alpha=-0.1)").kind, integrator("dop853").kind
    ('scheme', 'solver')
    """
    if isinstance(given, Integrator):
        return given
    if isinstance(given, str):
        if given in REFERENCES:
            return Integrator(given, SOLVER, given)
        named = user_object(given) if USER.fullmatch(given) else None
        if named is not None and not isinstance(named, type):
            return replace(integrator(named), label=given)
        if "@" in given:
            raise InputError("integrator", given, "be without a form", "leave @ out, and give the option form")
        return integrator(parse_run(given)[0])
    if isinstance(given, Scheme):
        return Integrator(str(given), SCHEME, given, given.order)
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
        return Integrator(getattr(given, "__name__", type(given).__name__), FUNCTION, given)
    remedy = "give a Scheme, the name of one or of a reference solver, a function solve(system, dt, t_end), or runs"
    raise InputError("integrator", given, "be something that can be run", remedy)


def integrators(given: Iterable[Any]) -> list[Integrator]:
    """Return the integrators of a list, each label once: a second of one label gets a number.

    Recorded runs of one name that stand in the list one by one are one integrator.
    """
    apart: dict[Any, Any] = {}
    for i, x in enumerate(given):
        if isinstance(x, Trajectory):
            apart.setdefault(str(x.provenance["method"]), []).append(x)
        else:
            apart[i] = x
    chosen, labels = [integrator(x) for x in apart.values()], list[str]()
    for k, x in enumerate(chosen):
        labels.append(x.label)
        count = labels.count(x.label)
        chosen[k] = replace(x, label=f"{x.label} ({count})") if count > 1 else x
    return chosen


def fastest(run: Callable[[], Trajectory]) -> Trajectory:
    """The fastest of up to REPEATS runs; fewer repeats if a run takes long."""
    runs = [run()]
    while len(runs) < REPEATS and sum(one.work.seconds for one in runs) < ENOUGH:
        runs.append(run())
    return min(runs, key=lambda one: one.work.march_seconds)


def _called(one: Integrator, system: System, dt: float, t_end: float) -> Trajectory:
    """Return the result of a function on a system, as a run."""
    begun = clock()
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            returned = one.source(system, dt, t_end)
    except (InputError, Diverged, SolverFailure):
        raise
    except Exception as error:  # of a function of anyone's
        reason = f"{type(error).__name__}: {error}"
        raise SolverFailure(one.label, 0.0, reason, "the function raised this") from error
    seconds = clock() - begun
    if isinstance(returned, Trajectory):
        timed = np.isfinite(returned.work.seconds)
        work = returned.work if timed else replace(returned.work, seconds=seconds, march_seconds=seconds)
        run = replace(returned, work=work, provenance=returned.provenance | {"method": one.label})
    else:
        run = replace(finite_run(returned, system, one.label), work=Work(round(t_end / dt), seconds, seconds))
    if not run.t[-1] >= t_end * (1.0 - SAME_STEP):
        raise SolverFailure(one.label, float(run.t[-1]), "it returned no later times", f"return all to {t_end:g}")
    return run


def finite_run(arrays: Any, system: System, label: str) -> Trajectory:
    """Return (t, u) or (t, u, v), u and v the tip (k,) or all unknowns (k, n), as a run.

    Raises Diverged where they are not finite from some time on, InputError for anything else.
    """
    if not isinstance(arrays, (tuple, list)) or len(arrays) not in (2, 3):
        raise InputError(label, type(arrays).__name__, "return (t, u) or (t, u, v)", "return a tuple of arrays")
    t, *others = (np.asarray(x, float) for x in (arrays if arrays[-1] is not None else arrays[:-1]))
    for x in others:
        if x.ndim and len(x) == len(t):
            bad = ~np.all(np.isfinite(x.reshape(len(x), -1)), axis=1)
            if np.any(bad):
                raise Diverged(label, float(t[np.argmax(bad)]), "more steps may help")
    return Trajectory.from_arrays(t, *others, system=system, name=label)
