"""Horizons: the time to which a reference agrees with another solution or with perturbed copies of itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..basics.progress import Show, silent
from ..basics.validation import InputError
from ..model.graded import rounding_of_zero
from ..model.modes import undamped_modes
from ..model.scales import scales
from ..model.system import System
from ..piecewise.spectrum import known_until
from ..trajectory.trajectory import Reference, SolverFailure
from .agreement import DISPLACEMENT_TOLERANCE, agree_until, agreement, apart, scales_of, watched
from .exact.piecewise import copies, solve_exact
from .request import KEEP, Steps

COPIES = 4  # of the exact solution, each perturbed in its own way
SOON = 40  # powers of two below t_end
PART = 0.5  # of the tolerances, to which two solutions must agree: each may be off by as much
FINEST = 1e-11  # rtol of an adaptive solution up to which a tenth of it is compared with
MARGIN = 4.0  # times the rounding, for the perturbed copies


def time_tolerance(system: System, t_end: float = np.inf) -> float:
    """Largest difference of impact times inside the horizon: a thousandth of the longest time scale of a run to t_end.

    That is 1.0e-4 time units for the paper's k^2 = 300.
    """
    return 1e-3 * scales(system, t_end).period


def exact_horizon(
    reference: Reference, system: System, t_end: float, show: Show = silent
) -> tuple[float, dict[str, Any]]:
    """Horizon of the exact float64 solution, and the evidence for it.

    COPIES of the solution are perturbed by MARGIN times what its own construction loses to rounding, in
    frequencies, forces and at every event. The horizon is the time to which all of them agree with the
    solution to half the tolerance. Rounding and perturbations grow at the same rate, but start in different
    directions. For its error to be twice that of every copy, rounding has to start 2 MARGIN times closer to
    the direction of growth than each of them: a chance of the order of (2 MARGIN)^-COPIES, 2e-4. The margin
    shortens a chaotic horizon by ln(2 MARGIN)/ln(1e-3/eps), a fourteenth. Phases w t are known to eps w t, which
    no copy shows: the horizon ends where MARGIN times that reaches the tolerance, and likewise where a mode that counts
    as free would be held back by a stiffness within the rounding of K, or one that damping makes slow decays at a rate
    that is lost beside the fast ones. ``horizon_predicted``: the horizon that the tangent flow predicts.
    """
    from .exact.lyapunov import predicted_horizon

    eps = MARGIN * float(np.finfo(float).eps)
    tolerance, solution = time_tolerance(system, t_end), reference.solution
    fastest = 2.0 * np.pi / solution.shortest_period
    unseen = min(t_end, DISPLACEMENT_TOLERANCE / (eps * fastest), _of_free_modes(system))
    unseen = min(unseen, *(_of_slow_modes(system, sides) for sides in np.unique(solution.sides, axis=0)))
    horizon, own, scales = unseen, watched(reference), scales_of(reference)
    others = copies(system, t_end, reference.t, eps)
    for seed in range(COPIES):
        show(f"exact: copy {seed + 1} of {COPIES} for its horizon", 1 + seed, 1 + COPIES)
        horizon = min(horizon, agree_until(own, next(others), tolerance, scales, PART))
    if horizon == 0.0:
        horizon = min(unseen, _soon(reference, system, t_end, eps))
    return horizon, {
        "horizon_predicted": predicted_horizon(system, solution, t_end, DISPLACEMENT_TOLERANCE),
        "against": f"{COPIES} copies perturbed by {MARGIN:g} times its rounding, to half the tolerance",
    }


def _of_free_modes(system: System) -> float:
    """omega^2 t^2/12 of a free motion under a constant force is lost where omega^2 is the rounding of a zero."""
    basis = undamped_modes(system)
    shapes = basis.shapes[:, basis.omega == 0.0]
    terms = np.sum(np.abs(shapes) * (np.abs(system.stiffness) @ np.abs(shapes)), axis=0)
    largest = float(np.max(rounding_of_zero(terms, system.size), initial=0.0))
    return float(np.sqrt(12.0 * DISPLACEMENT_TOLERANCE / largest)) if largest else np.inf


def _of_slow_modes(system: System, sides: NDArray[np.int64]) -> float:
    """Horizon from slow modes while the contacts press on these sides, see ``known_until``."""
    closed = [
        (x.row, *x.stops.spring(1), x.stops.damping) for x, side in zip(system.contacts, sides, strict=False) if side
    ]
    C = system.damping + sum(c * np.outer(row, row) for row, _, _, c in closed)
    if not np.any(C):
        return np.inf
    basis = undamped_modes(system, tuple((row, kappa) for row, kappa, _, _ in closed))
    return known_until(basis.omega, basis.shapes.T @ C @ basis.shapes, 0.5 * DISPLACEMENT_TOLERANCE)


def _soon(reference: Reference, system: System, t_end: float, eps: float) -> float:
    """The horizon by outputs at t_end 2^-k, if it ends before the first output of the reference.

    Its tolerance stays that of the reference's outputs: where all of these are zeros of the motion, as good as
    none of their digits is right, however large the motion is between them. Raises SolverFailure where it ends
    before all of these too: there rounding is as large as the outputs.
    """
    times = np.append(0.0, t_end * 2.0 ** np.arange(-SOON, 1.0))
    own, tolerance, scales = (
        watched(solve_exact(system, t_end, times)),
        time_tolerance(system, t_end),
        scales_of(reference),
    )
    others = islice(copies(system, t_end, times, eps), COPIES)
    horizon = min(agree_until(own, copy, tolerance, scales, PART) for copy in others)
    if horizon <= times[1]:
        reason = "rounding is as large as the outputs from the start"
        raise SolverFailure("exact", 0.0, reason, "use multiprecision")
    return horizon


def with_horizon(
    reference: Reference,
    system: System,
    t_end: float,
    steps: Steps,
    solve: Callable[..., Reference],
    show: Show = silent,
) -> Reference:
    """``reference`` with its horizon; the provenance names the solution that it was compared with.

    The exact solution is compared with perturbed copies of itself, see ``exact_horizon``. Any other solution is
    compared with the exact one. If that does not exist, it is compared with itself at ten times its rtol, or at a tenth
    if it steps across kinks, with steps of less than half the length and the functions of time sampled at other points.
    A load that one of the two missed makes them differ; a load that both missed is not found. The provenance names the
    other solution. Both must agree to half the tolerance, so that each may be off by the other half. solve: the
    function that solves again, with the arguments of ``references.solve``. Raises SolverFailure for an exact solution
    without any valid time span.
    """
    tolerance = time_tolerance(system, t_end)
    notes: dict[str, Any] = {}
    if reference.provenance["method"] == "exact":
        horizon, notes = exact_horizon(reference, system, t_end, show)
        against = notes.pop("against")
    else:
        show(f"{reference.provenance['method']}: a second solution for its horizon", 1, 2)
        try:
            other = solve_exact(system, t_end, reference.t)
            against = "exact"
        except (InputError, SolverFailure):
            rtol, method = float(reference.provenance["rtol"]), reference.provenance["method"]
            # Across a kink the error does not follow rtol: two solutions can share it, unless one is more precise.
            rtol *= 0.1 if reference.provenance.get("switches") == KEEP and rtol >= FINEST else 10.0
            against = f"itself at rtol {rtol:g} with shorter steps"
            other = solve(system, t_end, method, reference.t, rtol, None, steps=steps._replace(other=True))
            spacing = reference.provenance.get("loads_scanned_every", 0.0)
            against += f"; loads sampled every {spacing:.2g}" if spacing else ""
        horizon = agreement(reference, other, tolerance, PART)
    tolerance = min([tolerance, *(apart(c.impacts.count, t_end) for c in reference.contacts)])
    notes |= {
        "horizon": horizon,
        "horizon_against": against,
        "horizon_tolerance": f"|du| <= {DISPLACEMENT_TOLERANCE:g} max|u|, impact times to {tolerance:.3g}",
    }
    return replace(reference, horizon=horizon, provenance=reference.provenance | notes)
