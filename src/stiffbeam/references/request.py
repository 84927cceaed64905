"""What a reference is asked for: the arguments of ``reference``, in one piece for every solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError

if TYPE_CHECKING:
    from ..model.system import System

RESTART, KEEP = "restart", "through"  # what a solver does at a switch


class Steps(NamedTuple):
    """What bounds the steps of an adaptive solver beside its tolerances, and what it does at a switch.

    breakpoints: times at which it starts anew. max_step: its longest step, None for what the functions
    of time ask for. switches: "restart", "through" or None for the method's default. other: scan at other
    points and step shorter, for a second opinion. events: False leaves the roots out where a solver goes
    through the switches, so that impacts are the sampled ones.
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
        t = np.linspace(0.0, t_end, 2001)
        if not np.all(np.diff(t) > 0.0):
            raise InputError("t_end", t_end, "be long enough for 2001 output times in float64", "pass t_eval")
        return t
    t = np.asarray(t_eval, float)
    # Every comparison with NaN is false: all of them have to hold.
    if t.ndim != 1 or len(t) < 2 or not (np.all(np.diff(t) > 0.0) and t[0] >= 0.0 and t[-1] <= t_end * (1 + 1e-12)):
        rule = f"be two or more increasing times in [0, {t_end:g}]"
        raise InputError("t_eval", t, rule, "for a comparison pass t_eval=run.t")
    return np.minimum(t, t_end)
