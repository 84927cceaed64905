"""The arguments of ``reference`` as one object for every solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError

if TYPE_CHECKING:
    from ..model.system import System

RESTART, KEEP = "restart", "through"  # treatment of events by a solver
OUTPUTS = 2001  # times of a solution, where none are asked for


class Steps(NamedTuple):
    """Bounds of the steps of an adaptive solver besides its tolerances, and its treatment of events.

    breakpoints: times of a restart. max_step: longest step, None for what the functions of time require. switches:
    "restart", "through" or None for the method's default. other: scan at other points and shorter steps, for a second
    opinion. events: False leaves the roots out if a solver steps through the events; impacts are then the sampled ones.
    """

    breakpoints: Array | Sequence[float] = ()
    max_step: float | None = None
    switches: str | None = None
    other: bool = False
    events: bool = True


class Request(NamedTuple):
    """The solution of ``system`` on [0, t_end] by ``method``, output at t_eval (k,), None for 2001 times.

    rtol, atol and steps are for the adaptive solvers, atol None for rtol/100 of the scale of every
    unknown; digits, a number or "auto", is for multiprecision.
    """

    system: System
    t_end: float
    method: str
    t_eval: Array | None
    rtol: float
    atol: float | None
    digits: int | str
    steps: Steps


def output_times(t_eval: Array | None, t_end: float) -> Array:
    """t_eval, (k,), or 2001 equidistant times in [0, t_end].

    Raises InputError where they are fewer than two, do not increase, or leave [0, t_end].
    """
    if t_eval is None:
        t = np.linspace(0.0, t_end, OUTPUTS)
        if not np.all(np.diff(t) > 0.0):
            raise InputError("t_end", t_end, "be long enough for 2001 output times in float64", "pass t_eval")
        return t
    t = np.asarray(t_eval, float)
    # Every comparison with NaN is false: all of them have to hold.
    if t.ndim != 1 or len(t) < 2 or not (np.all(np.diff(t) > 0.0) and t[0] >= 0.0 and t[-1] <= t_end * (1 + 1e-12)):
        rule = f"be two or more increasing times in [0, {t_end:g}]"
        raise InputError("t_eval", t, rule, "for a comparison pass t_eval=run.t")
    return np.minimum(t, t_end)
