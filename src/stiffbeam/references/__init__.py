"""Reference solutions: one call and one Trajectory type for every solver, and an estimate of its time."""

from __future__ import annotations

import math
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.resources import Show, displayed
from ..basics.validation import InputError, numbers, positive
from .registry import (
    ADAPTIVE,
    BEST,
    EXACT,
    METHODS,
    MULTIPRECISION,
    OUTPUTS,
    REFERENCES,
    RTOL,
    Request,
    Steps,
    method_of,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ..model.system import System
    from ..trajectory.trajectory import Reference


__all__ = ["METHODS", "REFERENCES", "best_reference", "reference", "solve", "substitute", "takes"]

BEST_RTOL = 1e-12  # of an adaptive solver where a system has no exact solution


def reference(
    system: System,
    t_end: float,
    method: str = "exact",
    t_eval: ArrayLike | None = None,
    rtol: float = RTOL,
    atol: float | None = None,
    digits: int | str = "auto",
    breakpoints: ArrayLike = (),
    max_step: float | None = None,
    progress: bool | Show = False,
) -> Reference:
    """Return a reference solution on [0, t_end], with the horizon to which it can be trusted.

    Motions with impacts are often chaotic: past ``horizon`` every float64 solution is one of many possible motions.

    Parameters
    ----------
    system : System
        Times and tolerances are in its units.
    t_end : float
        End of the solution.
    method : str
        "exact" (piecewise linear, closed form between events; rigid stops from impact to impact); "multiprecision" (the
        exact solution of compliant stops in as many ``digits`` as error growth requires, confirmed with more digits);
        "cvode" (BDF), "cvode-adams" and "ida" (BDF on the residual, no mass inverted) of SUNDIALS;
        "kvaerno3" and "kvaerno5" (ESDIRK) of diffrax; "dop853", "radau" and "lsoda" of SciPy.
    t_eval : (k,) array, optional
        Output times, increasing in [0, t_end]; 2001 equidistant ones by default. Every reference answers ``at`` any
        time: an exact one from its closed form, an adaptive one by solving once more where other times are asked.
    rtol, atol : float
        Tolerances of adaptive solvers; atol by default rtol/100 of the scale of every unknown.
    digits : int or "auto"
        Number of digits of "multiprecision".
    breakpoints : (k,) array
        Times where a load or an offset is not smooth; an adaptive solver starts anew there, as at those that a function
        of time states itself (its attribute ``breakpoints``). Limitation: a function in Python is seen only at the
        steps, of which there are at least 200. Give breakpoints where a shorter feature begins and ends.
    max_step : float, optional
        The longest step of an adaptive solver, by default what the functions of time allow.
    progress : bool or callable
        True shows a bar in a terminal or a notebook, by solutions done: the reference itself and those its horizon is
        measured with. A function is called as show(what, done, total), total 0 where it is not known.

    Returns
    -------
    Reference
        Limitation: a graze that goes less deep than 1e-12 of the motion, 1e-18 in multiprecision, may count as no
        impact.

    Raises
    ------
    InputError
        For an argument that is wrong or that the method cannot take, and where its library is missing.
    SolverFailure
        If the method gives up.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> reference = sb.reference(sb.paper_case(10).system(), t_end=0.2)
    >>> reference.horizon, reference.impacts.count
    (0.2, 42)
    """
    from ..model.system import require_system
    from ..model.time_functions import times_of
    from .horizon import with_horizon

    times = None if t_eval is None else numbers("t_eval", t_eval, "be increasing times", "give a list of them")
    steps = Steps(tuple(times_of("breakpoints", breakpoints).tolist()), max_step)
    require_system(system)
    method_of(method)
    t_end = positive("t_end", t_end)
    with displayed(progress) as show:
        show(f"{method}: solving", 0, 0)
        solution = solve(system, t_end, method, times, rtol, atol, digits, steps)
        if REFERENCES[method].kind == MULTIPRECISION or not math.isnan(solution.horizon):
            return solution  # confirmed by more digits, or by its own copies
        return with_horizon(solution, system, t_end, steps, solve, show)


def best_reference(
    system: System, t_end: float, t_eval: ArrayLike | None = None, progress: bool | Show = False
) -> Reference:
    """The exact solution of a system, or else an adaptive one to 1e-12 that restarts at every event; with its horizon.

    An adaptive solution replaces the exact one only for a law or a function of time that has no exact solution, see
    ``substitute``: numbers that are too large for the exact solution are no easier for SUNDIALS. Raises InputError with
    the reason of the last method that was asked, and SolverFailure if the supporting one fails.
    """
    *others, last = BEST[1:] if substitute(system, t_end) else BEST[:1]
    for method in others:
        with suppress(InputError):
            return reference(system, t_end, method, t_eval, rtol=BEST_RTOL, progress=progress)
    return reference(system, t_end, last, t_eval, rtol=BEST_RTOL, progress=progress)


def substitute(system: System, t_end: float) -> str:
    """Sentence with the best reference of a system that has no exact solution, and the reason; else empty."""
    from .exact.solution import refuse

    if system.rigid:
        return ""
    try:
        refuse(system, t_end)
    except InputError as error:
        rule = f"{error.field} must {error.rule}"
        return f"No exact solution ({rule}): {BEST[1]} at rtol {BEST_RTOL:g} replaces it."
    return ""


def takes(method: str, system: System, t_end: float) -> bool:
    """Return True if ``method`` supports the stops of a system and, for an exact method, its functions of time."""
    if REFERENCES[method].kind != EXACT and system.rigid:
        return False
    if REFERENCES[method].kind == ADAPTIVE:
        return True
    return not substitute(system, t_end)


def solve(
    system: System,
    t_end: float,
    method: str,
    t_eval: NDArray[Any] | None,
    rtol: float,
    atol: float | None,
    digits: int | str = "auto",
    steps: Steps = Steps(),  # noqa: B008
) -> Reference:
    """``reference`` without the horizon, except for multiprecision, which computes its own; t_eval: (k,) or None.

    Raises InputError for what the method cannot take or a library that is missing, SolverFailure where it
    gives up.
    """
    from ..model.system import require_system

    require_system(system)
    entry = method_of(method)
    t_end = positive("t_end", t_end)
    if entry.kind == ADAPTIVE and not 1e-150 <= t_end <= 1e150:
        raise InputError("t_end", t_end, "have a square in float64", "count time in another unit")
    given = "breakpoints" if len(steps.breakpoints) else "max_step" if steps.max_step is not None else None
    if entry.kind != ADAPTIVE and given:
        raise InputError(given, getattr(steps, given), f"be left out for {method}", "it has no steps to bound")
    if entry.kind == ADAPTIVE:
        for contact in system.contacts:
            contact.stops.require_compliant(f"the adaptive solver {method}")
    try:
        solver = import_module(f".{entry.module}", __name__)
        return solver.solve(Request(system, t_end, method, t_eval, rtol, atol, digits, steps))
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in entry.libraries:
            raise
        rule, remedy = f"have its library {missing} installed", f"pip install {entry.libraries[missing]}"
        raise InputError("method", method, rule, remedy) from None


PARTS = 64  # a pilot runs over one or two of so many parts of the span
RISES = 1.5  # from one pilot to one of twice the span, at least: else the start of the motion decides both
COPIES = 5.0  # exact solutions behind one with its horizon
CELLS, FASTEST_TIME = 25, 4.3e4 * 0.06  # of the registry's seconds: Table 10, its fastest angular frequency times t
RADIANS_PER_SAMPLE = 250.0  # of that angle: at least what a restart at a sample of a record costs any method
NEAR = 0.2  # of the seconds asked for: where the registry's come so near, pilots tell more


def expected_seconds(
    system: System, t_end: float, method: str, rtol: float, atol: float | None, steps: Steps,
    worth: float, solutions: float | None = None, outputs: int = OUTPUTS,
) -> float:  # fmt: skip
    """Return the estimated seconds of a reference, 0.0 if they are far below ``worth``.

    solutions: how often the method solves; by default as often as a reference with its horizon asks for. outputs: at
    how many times; a pilot has its share of them.

    The registry's seconds, scaled to the size, the fastest period and the samples of the loads, decide first. Only if
    they come near ``worth`` are there pilot runs. The first pilot over each span compiles its code and is not counted.
    Set-up time is part of both others and is not multiplied by the span. Pilots that the first steps dominate, as
    IDA's from rest, take twice the span. A multiprecision solution has no estimate
    (0.0), because its digits grow with the span. Neither has one that is refused or fails.
    """
    from ..model.modes import undamped_modes
    from ..model.sampled import Sampled
    from ..model.time_functions import parts_of
    from ..trajectory.trajectory import SolverFailure

    entry = REFERENCES[method]
    if entry.kind == MULTIPRECISION:
        return 0.0
    if solutions is None:
        solutions = COPIES if entry.kind == EXACT else _judged(system, t_end)
    # Work grows with the angle that the fastest motion turns through, and with a restart at every sample.
    samples = sum(len(part.t) for f in system.time_functions for part in parts_of(f) if isinstance(part, Sampled))
    angle = float(undamped_modes(system).omega[-1]) * t_end + RADIANS_PER_SAMPLE * samples
    scale = angle / FASTEST_TIME * max(1.0, system.size / CELLS) ** 2
    if solutions * entry.seconds * scale < NEAR * worth:
        return 0.0

    def pilot(parts: int) -> float:
        times = np.linspace(0.0, parts * t_end / PARTS, 2 + parts * outputs // PARTS)
        return solve(system, float(times[-1]), method, times, rtol, atol, "auto", steps).work.march_seconds

    try:
        # Too high where this first pilot compiles: if even so it is short, no other is needed.
        first = solutions * PARTS * pilot(1)
        if first < worth:
            return first
        parts, once, twice = 0, 1.0, 1.0
        while twice < RISES * once and 4 * parts < PARTS:
            parts = max(1, 2 * parts)
            pilot(2 * parts)  # this run compiles for the longer span
            once, twice = pilot(parts), pilot(2 * parts)
    except (InputError, SolverFailure):
        return 0.0  # the run itself will say
    # As many parts more cost twice - once; the set-up is part of both and is counted once.
    return solutions * (once + (PARTS / parts - 1.0) * max(0.0, twice - once))


def _judged(system: System, t_end: float) -> float:
    """Return how often an adaptive solver runs for its horizon: once beside an exact solution, else twice."""
    from .exact.solution import refuse

    try:
        refuse(system, t_end)
    except InputError:
        return 2.0
    return 1.0
