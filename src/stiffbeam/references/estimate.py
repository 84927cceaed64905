"""How long a reference will take, before it is begun: pilot runs over small parts of the span."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

from ..basics.validation import InputError
from ..model.modes import undamped_modes
from ..model.system import System
from ..trajectory.trajectory import Reference, SolverFailure
from .registry import EXACT, MULTIPRECISION, REFERENCES
from .request import Steps

MINUTES = 60.0  # seconds from which on it is worth a warning
PARTS = 64  # a pilot runs over one or two of so many parts of the span
RUNS = {EXACT: 5.0}  # solutions behind one with its horizon; of an adaptive solver two
CELLS, FASTEST_TIME = 25, 4.3e4 * 0.06  # of the registry's seconds: Table 10, its fastest angular frequency times t


def warn_of_minutes(
    system: System, t_end: float, method: str, rtol: float, atol: float | None, steps: Steps,
    solve: Callable[..., Reference],
) -> None:  # fmt: skip
    """Warn where ``reference`` will take more than a minute, with the estimate and what to do.

    Only where the registry's seconds, scaled to the size and the fastest period, come near it are there pilot runs.
    The first over each span compile what it needs and are not counted; what setting up costs is in both of the others,
    and is not taken times the span.
    """
    own = REFERENCES[method]
    if own.kind == MULTIPRECISION:
        return  # its digits grow with the span: no part of it tells
    runs = RUNS.get(own.kind, 2.0)
    scale = float(undamped_modes(system).omega[-1]) * t_end / FASTEST_TIME * max(1.0, system.size / CELLS) ** 2
    if runs * own.seconds * scale < 0.2 * MINUTES:
        return

    def pilot(parts: int) -> float:
        return solve(system, parts * t_end / PARTS, method, None, rtol, atol, "auto", steps).work.march_seconds

    begun = time.perf_counter()
    try:
        if runs * PARTS * pilot(1) < MINUTES:
            return
        pilot(2)
        once, twice = pilot(1), pilot(2)
    except (InputError, SolverFailure):
        return  # what it refuses, the run itself will say
    seconds = runs * (once + (PARTS - 1) * max(0.0, twice - once))
    if seconds >= MINUTES:
        made = time.perf_counter() - begun
        advice = "progress=True shows how far it is; a shorter t_end, fewer cells or a looser rtol cost less"
        warnings.warn(
            f"{method} will take about {seconds:.0f} s or more (by pilots of {made:.1f} s): {advice}", stacklevel=3
        )
