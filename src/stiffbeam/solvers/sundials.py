"""What CVODE and IDA share through scikit-sundae: events, limits, outcome."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..arrays import Array
from ..trajectory import SolverFailure
from .adaptive import Solve

MAX_STEPS = 10_000_000  # per output point; the default of 500 ends most contact runs


def event_options(gaps: Callable[..., None], count: int) -> dict[str, Any]:
    """Record every gap that rises through zero and go on. Made anew for each run: events accumulate."""
    if not count:
        return {}
    gaps.terminal = [False] * count  # type: ignore[attr-defined]
    gaps.direction = [1] * count  # type: ignore[attr-defined]
    return {"eventsfn": gaps, "num_events": count}


def finished(method: str, result: Any, t: Array, seconds: float) -> Solve:
    """The solver's result, or SolverFailure where it did not reach the end."""
    if not result.success or len(result.t) < len(t):
        reached = float(result.t[-1]) if np.size(result.t) else 0.0
        raise SolverFailure(method, reached, str(result.message), "loosen rtol and atol or use method='exact'")
    events: list[tuple[float, int]] = []
    if result.t_events is not None:
        for when, which in zip(result.t_events, np.asarray(result.i_events), strict=True):
            events += [(float(when), int(k)) for k in np.flatnonzero(which)]
    counters = {"rhs": int(result.nfev), "jacobians": int(result.njev)}
    return Solve(np.asarray(result.y), events, counters, seconds)
