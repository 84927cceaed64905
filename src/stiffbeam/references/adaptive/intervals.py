"""Smooth intervals of the functions of time, and the longest step in each.

An adaptive solver chooses its steps by the errors that it estimates, and it evaluates a load only at its steps. At rest
it doubles its step and can pass over a short pulse. The time span is therefore cut where a function of time is known
not to be smooth, and the step is bounded by the period of a Harmonic and by a share of the span for Python functions.

Limitation: a Python function is seen only at the steps. A feature shorter than a step can be missed, unless the caller
gives ``breakpoints`` around it or a ``max_step``. The reference states the bound, and its horizon is measured against
a solution with shorter steps at other times.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...basics.validation import positive
from ...model.system import System
from ...model.time_functions import Harmonic, Sampled, breakpoints_of, covered, in_closed_form, leaves, times_of
from ..registry import Steps

PERIODS_PER_STEP = 0.25  # of a Harmonic
PER_STEP = 0.25  # of an interval with a cubic: it turns twice, and a stop that does is in and out again in one step
STEPS_OF_FUNCTIONS = 200  # in the span, at least, where a load or an offset is a Python function
SECOND_LOOK = 0.381966  # of the step bounds, for the steps of a second solution to lie at other times


class Interval(NamedTuple):
    """Interval [start, end] with smooth functions of time. They may be evaluated in [first, end] only: a jump at an
    end belongs to the neighbour. max_step: inf without a bound."""

    start: float
    end: float
    first: float
    max_step: float


def smooth_intervals(system: System, t_end: float, steps: Steps) -> list[Interval]:
    """Cut [0, t_end] for the loads and contact offsets of ``system``."""
    covered(system.time_functions, t_end)
    # Parts of all functions of time, each once: harmonics, records, and Python functions.
    functions = {id(leaf): leaf for leaf in leaves(*system.time_functions)}.values()
    records = [f for f in functions if isinstance(f, Sampled)]  # polynomials between their samples
    cubic = any(f.kind == "cubic" for f in records)
    longest = math.inf if steps.max_step is None else positive("max_step", steps.max_step)
    # A harmonic load bounds the step too: error control sees a load at the steps only.
    frequencies = [f.frequency for f in functions if isinstance(f, Harmonic) and f.amplitude]
    longest = min([longest, *(PERIODS_PER_STEP * 2.0 * math.pi / w for w in frequencies)])
    if not in_closed_form(*functions):
        longest = min(longest, t_end / STEPS_OF_FUNCTIONS)
    if steps.other:
        longest = SECOND_LOOK * min(longest, t_end / STEPS_OF_FUNCTIONS)
    # The cuts: breakpoints of the caller, samples of the records, breakpoints that a function states.
    times = [times_of("breakpoints", steps.breakpoints), breakpoints_of(*functions)]
    # Cuts that are a few roundings apart would leave an interval of rounding length between them.
    cuts, least = [0.0], 64.0 * float(np.finfo(float).eps) * t_end
    for t in np.unique(np.concatenate(times)).tolist():
        if cuts[-1] + least < t < t_end - least:
            cuts.append(t)
    # The functions may jump at a cut: an interval ends one double before it, and the next one evaluates them after it.
    ends = [*(math.nextafter(t, -math.inf) for t in cuts[1:]), t_end]
    firsts = [0.0, *(math.nextafter(t, math.inf) for t in cuts[1:])]
    return [
        Interval(start, end, first, min(longest, PER_STEP * (end - start) if cubic else math.inf))
        for start, end, first in zip([0.0, *ends[:-1]], ends, firsts, strict=True)
    ]
