"""Reference solutions: one call and one Trajectory type for every solver, and a deadline for it."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import OutOfTime, Show, clock, deadline, working
from ..basics.validation import InputError, numbers, positive
from .registry import ADAPTIVE, BEST, EXACT, MULTIPRECISION, REFERENCES, RTOL, Request, filled, method_of, output_times

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..model.system import System
    from ..trajectory.trajectory import Reference


__all__ = ["REFERENCES", "best_reference", "reference", "solve", "substitute", "takes"]

# The first solution takes one part of so many of a budget. An adaptive one, which ends where its part does, leaves the
# other to a second opinion; one to be solved again to its end leaves more, and an exact one eight copies.
PASSES = {ADAPTIVE: 2.0, MULTIPRECISION: 4.0, EXACT: 10.0}
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
    progress: bool | Show | None = None,
    seconds: float | None = None,
) -> Reference:
    """Return a reference solution on [0, t_end], with the horizon to which it can be trusted.

    Motions with impacts are often chaotic: past ``horizon`` every float64 solution is one of many possible motions.

    Parameters
    ----------
    system : System
    t_end : float
    method : str
        "exact": piecewise linear, closed form between events. "multiprecision": the same for compliant stops without
        records, in as many ``digits`` as error growth requires. Adaptive: "cvode" (BDF), "cvode-adams" and "ida" (BDF
        on the residual) of SUNDIALS; "kvaerno3" and "kvaerno5" of diffrax; "dop853", "radau" and "lsoda" of SciPy.
    t_eval : (k,) array, optional
        Output times, increasing in [0, t_end]; 2001 equidistant ones by default. ``at`` answers any other time, of an
        adaptive reference by solving once more.
    rtol, atol : float
        Tolerances of adaptive solvers; atol by default rtol/100 of the scale of every unknown.
    digits : int or "auto"
        Number of digits of "multiprecision".
    breakpoints : (k,) array
        Times where a load or an offset is not smooth, for adaptive solvers, besides the samples of records.
        Limitation: a function in Python is seen only at the steps, of which there are at least 200. Give breakpoints
        where a shorter feature begins and ends.
    progress : bool or callable
        None shows a bar after 3 s, True at once, False nothing. A function is called as show(what, done, total) with
        the share that is done of the reference itself and of the solutions its horizon is measured with.
    seconds : float, optional
        CPU seconds, horizon included, after which the reference ends where it has come to, an adaptive one with the
        outputs up to there; see provenance["budget"].

    Returns
    -------
    Reference
        Limitation: a graze that goes less deep than 1e-12 of the motion may count as no impact.

    Raises
    ------
    InputError
        For an argument that is wrong or that the method cannot take.
    SolverFailure
        If the method gives up.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> reference = sb.reference(sb.paper_case(10).system(), t_end=0.2)
    >>> reference.horizon, reference.impacts.count
    (0.2, 42)
    """
    from .horizon import with_horizon

    times = None if t_eval is None else numbers("t_eval", t_eval, "be increasing times", "give a list of them")
    request = _checked(Request(system, t_end, method, times, rtol, atol, digits, breakpoints))
    if times is not None:
        times = output_times(times, request.t_end)
        # The horizon holds between outputs, too: it is measured at no fewer times than by default.
        if method_of(method).kind != MULTIPRECISION:
            request = request._replace(t_eval=filled(times, request.t_end))
    seconds = math.inf if seconds is None else positive("seconds", seconds)
    end, passes, percent = clock() + seconds, PASSES[method_of(method).kind], 0

    def progressed(t: float) -> None:
        """Show how far the first solution is."""
        nonlocal percent
        if (now := int(100.0 * t / request.t_end)) > percent:
            percent = now
            show(f"{method}: solving", now, int(100.0 * passes))

    def within(parts: float, request: Request) -> Reference:
        """The solution to where one of so many parts of the CPU seconds that are left brings it."""
        try:
            with deadline(end - clock(), parts, progressed):
                solution = _solution(request)
        except OutOfTime as late:  # adaptive solutions end there, others are solved again
            solution = _solution(_until(late.t, request, seconds))
        reached = float(solution.provenance["t_end"])
        if reached < request.t_end:
            digits = next(n for n in range(3, 18) if f"{reached:.{n}g}" != f"{request.t_end:.{n}g}")
            solution.provenance["budget"] = (
                f"to t = {reached:.{digits}g} of {request.t_end:.{digits}g}: its budget of {seconds:g} s of CPU, "
                "horizon included, ends there"
            )
        return solution

    with working(f"{method}: solving", progress) as show:
        show(f"{method}: solving", 0, 0)
        solution = within(passes, request)
        if math.isnan(solution.horizon):  # not confirmed by more digits
            solution = with_horizon(solution, request, partial(within, 1.0), show)
        return solution if times is None or len(times) == len(solution.t) else _thinned(solution, times, seconds)


def _until(t: float, request: Request, seconds: float) -> Request:
    """The same of a solution that the deadline has ended at t."""
    times = request.t_eval
    if times is not None:
        times = times[times <= t]
        t = float(times[-1]) if len(times) > 2 else 0.0
    if t <= 0.0:
        raise _too_short(request.method, seconds)
    return request._replace(t_end=t, t_eval=times)


def _thinned(solution: Reference, times: Array, seconds: float) -> Reference:
    """The solution with outputs at those of the times (k,) that it has reached."""
    from ..trajectory.records import Ledger

    rows = np.searchsorted(solution.t, times[times <= solution.t[-1]])
    if len(rows) < 2:
        raise _too_short(str(solution.provenance["method"]), seconds)
    t, tip, tip_velocity = (x[rows] for x in (solution.t, solution.tip, solution.tip_velocity))
    contacts = tuple(
        replace(c, position=c.position[rows], velocity=c.velocity[rows], force=c.force[rows]) for c in solution.contacts
    )
    ledger = lambda: Ledger(*(x[rows] for x in vars(solution.energy).values()))  # noqa: E731
    return replace(solution, t=t, tip=tip, tip_velocity=tip_velocity, contacts=contacts, ledger=ledger)


def _too_short(method: str, seconds: float) -> Exception:
    from ..trajectory.trajectory import SolverFailure

    return SolverFailure(method, 0.0, f"{seconds:g} s of CPU end before its first outputs", "give more seconds")


def best_reference(
    system: System,
    t_end: float,
    t_eval: ArrayLike | None = None,
    progress: bool | Show | None = None,
    seconds: float | None = None,
) -> Reference:
    """The exact solution of a system, or else an adaptive one to 1e-12 that restarts at every event; with its horizon.

    An adaptive solution replaces the exact one only for a law or a function of time that has no exact solution, see
    ``substitute``: numbers that are too large for the exact solution are no easier for SUNDIALS. Raises InputError with
    the reason of the last method that was asked, and SolverFailure if the supporting one fails.
    """
    *others, last = BEST[1:] if substitute(system, t_end) else BEST[:1]
    for method in others:
        with suppress(InputError):
            return reference(system, t_end, method, t_eval, rtol=BEST_RTOL, progress=progress, seconds=seconds)
    return reference(system, t_end, last, t_eval, rtol=BEST_RTOL, progress=progress, seconds=seconds)


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


def solve(*request: Any, **options: Any) -> Reference:
    """``reference`` without the horizon, except for multiprecision, which computes its own; arguments of ``Request``.

    Raises InputError for what the method cannot take, SolverFailure where it gives up.
    """
    return _solution(_checked(Request(*request, **options)))


def _checked(request: Request) -> Request:
    """The request, t_end a float. Raises InputError for what its method cannot take."""
    from ..model.system import require_system

    method = request.method
    breaks = np.unique(numbers("breakpoints", request.breakpoints, "be finite times", "give a list of them"))
    require_system(request.system)
    adaptive, t_end = method_of(method).kind == ADAPTIVE, positive("t_end", request.t_end)
    if adaptive:
        if not 1e-150 <= t_end <= 1e150:
            raise InputError("t_end", t_end, "have a square in float64", "count time in another unit")
        for contact in request.system.contacts:
            contact.stops.require_compliant(f"the adaptive solver {method}", "use the method exact, or a large one")
    elif len(breaks):
        raise InputError("breakpoints", breaks, f"be left out for {method}", "its functions of time have their own")
    return request._replace(t_end=t_end, breakpoints=breaks)


def _solution(request: Request) -> Reference:
    """The solution of a request, by the module of its method."""
    return import_module(f".{method_of(request.method).module}", __name__).solve(request)
