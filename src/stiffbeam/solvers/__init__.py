"""Reference solutions: one call, one Trajectory type, whoever solves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..system import System
from ..trajectory import Reference
from ..validation import InputError, near

METHODS = ("exact", "multiprecision", "cvode", "cvode-adams", "ida", "kvaerno3", "kvaerno5", "dop853", "radau")
_PACKAGES = {"sksundae": "scikit-sundae", "flint": "python-flint"}  # where import and package differ


def reference(
    system: System,
    t_end: float,
    method: str = "exact",
    t_eval: ArrayLike | None = None,
    rtol: float = 1e-10,
    atol: float | None = None,
    digits: int | str = "auto",
) -> Reference:
    """A reference solution on [0, t_end], with the horizon to which it can be trusted.

    method: "exact" (piecewise linear, closed form between switches); "multiprecision" (the same in as
    many ``digits`` as the chaos eats, confirmed with more: trusted to t_end); "cvode" (BDF), "cvode-adams" and
    "ida" (BDF on the residual, no mass inverted) of SUNDIALS; "kvaerno3" and "kvaerno5" (ESDIRK,
    diffrax); "dop853" and "radau" (SciPy). t_eval: output times, default 2001 equidistant; the exact
    solution answers ``at`` any time, the others at t_eval only. rtol, atol (default rtol/100) are for
    the adaptive solvers. Contact runs are chaotic: past ``horizon`` no float64 solution is *the* one.
    Raises InputError for what a method cannot take, SolverFailure where one gives up.
    """
    from .agreement import with_horizon

    times = None if t_eval is None else np.asarray(t_eval, float)
    if method == "multiprecision":
        return solve(system, t_end, method, times, rtol, atol, digits)
    return with_horizon(solve(system, t_end, method, times, rtol, atol), system, t_end)


def solve(
    system: System,
    t_end: float,
    method: str,
    t_eval: NDArray | None,
    rtol: float,
    atol: float | None,
    digits: int | str = "auto",
) -> Reference:
    """``reference`` without the horizon, but for multiprecision, which brings its own."""
    try:
        if not isinstance(system, System):
            raise InputError("system", type(system).__name__, "be a System")
        if method == "exact":
            from .piecewise import solve_exact

            return solve_exact(system, t_end, t_eval)
        if method == "multiprecision":
            from .multiprecision import solve_multiprecision

            return solve_multiprecision(system, t_end, t_eval, digits)
        if method in ("cvode", "cvode-adams"):
            from .cvode import solve_cvode

            return solve_cvode(system, t_end, t_eval, rtol, atol, adams=method == "cvode-adams")
        if method == "ida":
            from .ida import solve_ida

            return solve_ida(system, t_end, t_eval, rtol, atol)
        if method in ("kvaerno3", "kvaerno5"):
            from .kvaerno import solve_kvaerno

            return solve_kvaerno(system, t_end, t_eval, rtol, atol, method)
        if method in ("dop853", "radau"):
            from .scipy import solve_scipy

            return solve_scipy(system, t_end, t_eval, rtol, atol, method)
        raise InputError("method", method, "be a reference method", near(method, METHODS))
    except ModuleNotFoundError as error:
        remedy = f"pip install {_PACKAGES.get(error.name or '', error.name)}"
        raise InputError("method", method, f"have its library {error.name} installed", remedy) from None
