"""The exact piecewise-linear solution in as many digits as the chaos eats, with python-flint.

The same regimes as in float64 (undamped.py, exponential.py), with modes, states and switching times
carried as midpoints of multiprecision numbers. Most evaluations need few digits: the float64 search
finds the next switch, Newton's method doubles its digits, and only one evaluation of the exponentials
per switch is made at full precision. Digits that the motion has already used up are not carried on.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import flint
import numpy as np
from flint import ctx

from ..arrays import Array
from ..system import System
from ..trajectory import Reference, SolverFailure
from ..validation import InputError, positive
from .exact_measures import Solution
from .piecewise import general, reference_of, refuse
from .precise_exponential import precise_exponential
from .precise_modes import GUARD_BITS
from .precise_undamped import precise_undamped
from .tangent import lyapunov

BITS = math.log2(10.0)
MAX_DIGITS = 20_000
AGREEMENT = 1e-12  # of max |u|: how closely two precisions have to agree, float64 evaluation included


def solve_multiprecision(system: System, t_end: float, t_eval: Array | None, digits: int | str = "auto") -> Reference:
    """The exact solution carried with ``digits`` decimal digits, and again with a quarter more.

    "auto" estimates the digits from the growth of tangent vectors along the float64 solution, and goes
    on until both runs agree to t_end. A fixed number gives the horizon to which both
    agree. The result holds the states at the switches rounded to float64, from which any time is
    evaluated to about 1e-12 of max |u|. Takes what the exact solution takes: any damping, any number of
    contacts, Harmonic and Constant time functions; raises InputError otherwise, SolverFailure where
    even ``MAX_DIGITS`` do not suffice.
    """
    positive("t_end", t_end)
    refuse(system)
    if digits != "auto" and (isinstance(digits, bool) or not isinstance(digits, int) or not 20 <= digits <= MAX_DIGITS):
        raise InputError("digits", digits, f"be 'auto' or an integer from 20 to {MAX_DIGITS}")
    begun = time.perf_counter()
    wanted = _estimate(system, t_end) if digits == "auto" else int(digits)
    previous: Reference | None = None
    while True:
        if wanted > MAX_DIGITS:
            raise SolverFailure("multiprecision", t_end, f"{wanted} digits are not enough", "shorten t_end")
        notes: dict[str, Any] = {"digits": wanted, "python-flint": flint.__version__}
        run = reference_of(system, march(system, t_end, wanted), t_end, t_eval, begun, "multiprecision", notes)
        if previous is not None:
            horizon = _agreement(previous, run)
            if horizon >= t_end or digits != "auto":
                notes = {
                    "digits_confirmed_with": previous.provenance["digits"],
                    "horizon": horizon,
                    "horizon_against": f"itself with {previous.provenance['digits']} digits",
                    "horizon_tolerance": f"|du| <= {AGREEMENT:g} max|u|, the same switches",
                }
                return replace(run, horizon=horizon, provenance=run.provenance | notes)
        previous = run
        wanted = math.ceil(1.25 * wanted) + 15


def march(system: System, t_end: float, digits: int) -> Solution:
    """Follow the solution with ``digits`` at the start and what the outputs need at the end."""
    before = ctx.prec
    full = math.ceil(digits * BITS) + GUARD_BITS
    try:
        ctx.prec = full + 80  # cancellation in the eigenproblem: (w_max/w_1)^2 and some
        return (precise_exponential if general(system) else precise_undamped)(system, t_end, full)
    finally:
        ctx.prec = before


def _estimate(system: System, t_end: float) -> int:
    """Digits for t_end: what tangent vectors lose on the way, a twentieth for another way, and 20 to be left."""
    return 20 + math.ceil(1.05 * max(0.0, lyapunov(system, t_end).digits))


def _agreement(a: Reference, b: Reference) -> float:
    """The time to which two precisions agree in every switch and in the displacement."""
    x, y = a.solution, b.solution
    n = min(len(x.times), len(y.times))
    apart = np.any(x.sides[:n] != y.sides[:n], axis=1)
    apart |= np.abs(x.times[:n] - y.times[:n]) > 1e-12 * (1.0 + y.times[:n])
    end = float(b.provenance["t_end"])
    if np.any(apart):
        end = float(min(x.times[np.argmax(apart)], y.times[np.argmax(apart)]))
    elif len(x.times) != len(y.times):
        end = float((x if len(x.times) > n else y).times[n])
    scale = float(np.max(np.abs(b.tip)))
    wrong = np.flatnonzero(~(np.abs(a.tip - b.tip) <= AGREEMENT * scale) & (b.t <= end))
    return min(end, float(b.t[max(0, wrong[0] - 1)])) if len(wrong) else end
