"""Horizons: how long two solutions agree, and so how long a reference can be trusted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..modal import undamped_modes
from ..system import System
from ..trajectory import Impacts, Reference, Trajectory

DISPLACEMENT_TOLERANCE = 1e-3  # of max |u|
TWINS = 4


def time_tolerance(system: System) -> float:
    """How far impact times may differ inside the horizon: a thousandth of the longest natural period.

    That is 1.0e-4 time units for the paper's k^2 = 300.
    """
    omega = undamped_modes(system).omega
    first = omega[omega > 0.0]
    return 1e-3 * 2.0 * np.pi / float(first[0]) if len(first) else 1e-4


def agreement(a: Trajectory, b: Trajectory, tolerance: float) -> float:
    """The time to which a and b agree: |du| <= 1e-3 max|u| at common times, impact times to ``tolerance``.

    Impacts are paired in order; the sequence parts where the stop differs, the times do, or one has no
    partner. Both must have the same output times.
    """
    # A tip that has not moved yet is no scale: a millionth of the way its speed would have taken it is.
    scale = max(float(np.max(np.abs(a.tip))), 1e-6 * float(np.max(np.abs(a.tip_velocity)) * a.t[-1]), 1e-300)
    end = float(min(a.t[-1], b.t[-1]))
    apart = np.flatnonzero(~(np.abs(a.tip - b.tip) <= DISPLACEMENT_TOLERANCE * scale))  # NaN is apart
    horizon = min(end, float(a.t[max(0, apart[0] - 1)])) if len(apart) else end
    for c, d in zip(a.contacts, b.contacts, strict=True):
        horizon = min(horizon, parting(c.impacts, d.impacts, tolerance, end))
    return horizon


def parting(a: Impacts, b: Impacts, tolerance: float, end: float) -> float:
    """The time of the first impact without a partner of the same stop within ``tolerance``, else ``end``.

    Not counting those within the tolerance of the start, where a motion that starts on a stop may enter it
    or be in it already, and of the end, whose partner may come just after.
    """
    a, b = (_after(tolerance, x) for x in (a, b))
    n = min(a.count, b.count)
    bad = (a.stops[:n] != b.stops[:n]) | (np.abs(a.times[:n] - b.times[:n]) > tolerance)
    if np.any(bad):
        k = int(np.argmax(bad))
        return float(min(a.times[k], b.times[k]))
    unpaired = np.concatenate([a.times[n:], b.times[n:]])
    unpaired = unpaired[unpaired < end - tolerance]
    return float(np.min(unpaired)) if len(unpaired) else end


def _after(t: float, impacts: Impacts) -> Impacts:
    late = impacts.times > t
    return Impacts(impacts.times[late], impacts.stops[late], impacts.peaks[late], impacts.impulses[late], impacts.kind)


def with_horizon(reference: Reference, system: System, t_end: float, rtol: float | None = None) -> Reference:
    """``reference`` with its horizon, and in the provenance what it was measured against.

    The exact solution is held against twins whose frequencies and initial data are perturbed by the
    rounding errors of its own construction (four seeds, the earliest parting counts), and beside that
    what its tangent flow predicts is noted as horizon_predicted; any other solution against the exact
    one, or where that does not exist against itself at ten times its rtol.
    """
    from . import solve
    from .piecewise import Perturbation, solve_exact
    from .tangent import predicted_horizon

    tolerance = time_tolerance(system)
    notes: dict[str, Any] = {}
    if reference.provenance["method"] == "exact":
        spread = np.finfo(float).eps
        horizon = t_end
        for seed in range(TWINS):
            perturbation = Perturbation(frequency=spread, state=10.0 * spread, seed=seed)
            twin = solve_exact(system, t_end, reference.t, perturbation)
            horizon = min(horizon, agreement(reference, twin, tolerance))
        against = f"{TWINS} twins perturbed by rounding"
        predicted = predicted_horizon(system, reference.solution, t_end, DISPLACEMENT_TOLERANCE)
        notes["horizon_predicted"] = predicted
    else:
        try:
            other = solve_exact(system, t_end, reference.t)
            against = "exact"
        except ValueError:
            loose = 10.0 * float(reference.provenance["rtol"])
            other = solve(system, t_end, reference.provenance["method"], reference.t, loose, None)
            against = f"itself at rtol {loose:g}"
        horizon = agreement(reference, other, tolerance)
    notes |= {
        "horizon": horizon,
        "horizon_against": against,
        "horizon_tolerance": f"|du| <= {DISPLACEMENT_TOLERANCE:g} max|u|, impact times to {tolerance:.3g}",
    }
    return replace(reference, horizon=horizon, provenance=reference.provenance | notes)
