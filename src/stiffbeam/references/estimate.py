"""Estimated time of a reference before it begins, from pilot runs over small parts of the span."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

import numpy as np

from ..basics.validation import InputError
from ..model.modes import undamped_modes
from ..model.sampled import Sampled
from ..model.system import System
from ..model.time_functions import parts_of
from ..trajectory.trajectory import Reference, SolverFailure
from .registry import EXACT, MULTIPRECISION, OUTPUTS, REFERENCES, Steps

MINUTES = 60.0  # seconds from which on it is worth a warning
PARTS = 64  # a pilot runs over one or two of so many parts of the span
COPIES = 5.0  # exact solutions behind one with its horizon
CELLS, FASTEST_TIME = 25, 4.3e4 * 0.06  # of the registry's seconds: Table 10, its fastest angular frequency times t
RADIANS_PER_SAMPLE = 250.0  # of that angle: at least what a restart at a sample of a record costs any method
NEAR = 0.2  # of the seconds asked for: where the registry's come so near, pilots tell more


def expected_seconds(
    system: System, t_end: float, method: str, rtol: float, atol: float | None, steps: Steps,
    solve: Callable[..., Reference], worth: float, solutions: float | None = None, outputs: int = OUTPUTS,
) -> float:  # fmt: skip
    """Return the estimated seconds of a reference, 0.0 if they are far below ``worth``.

    solutions: how often the method solves; by default as often as a reference with its horizon asks for. outputs: at
    how many times; a pilot has its share of them.

    The registry's seconds, scaled to the size, the fastest period and the samples of the loads, decide first. Only if
    they come near ``worth`` are there pilot runs. The first pilot over each span compiles its code and is not counted.
    Set-up time is part of both others and is not multiplied by the span. A multiprecision solution has no estimate
    (0.0), because its digits grow with the span. Neither has one that is refused or fails.
    """
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
        # This run compiles for the longer span.
        pilot(2)
        once, twice = pilot(1), pilot(2)
    except (InputError, SolverFailure):
        return 0.0  # the run itself will say
    # One part more costs twice - once; the set-up is part of both and is counted once.
    return solutions * (once + (PARTS - 1) * max(0.0, twice - once))


def _judged(system: System, t_end: float) -> float:
    """Return how often an adaptive solver runs for its horizon: once beside an exact solution, else twice."""
    from .exact.piecewise import refuse

    try:
        refuse(system, t_end)
    except InputError:
        return 2.0
    return 1.0


def warn_of_minutes(
    system: System, t_end: float, method: str, rtol: float, atol: float | None, steps: Steps,
    solve: Callable[..., Reference],
) -> None:  # fmt: skip
    """Warn where ``reference`` will take more than a minute, with the estimate and what to do."""
    begun = time.perf_counter()
    seconds = expected_seconds(system, t_end, method, rtol, atol, steps, solve, MINUTES)
    if seconds >= MINUTES:
        pilots = time.perf_counter() - begun
        advice = "progress=True shows how far it is; a shorter t_end, fewer cells or a looser rtol cost less"
        warnings.warn(
            f"{method} will take about {seconds:.0f} s or more (by pilots of {pilots:.1f} s): {advice}", stacklevel=3
        )
