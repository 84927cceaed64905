"""Horizons: the time to which a reference agrees with another solution or with perturbed copies of itself, at the tip
and at every contact."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import count, islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..basics.resources import Show, silent
from ..basics.validation import InputError
from ..model.modes import rounding_of_zero, undamped_modes
from ..model.scales import scales
from ..model.system import System
from ..piecewise.linear import Perturbation
from ..piecewise.measures import entries, path_of, within_float64
from ..piecewise.regimes import Source
from ..piecewise.spectrum import known_until
from ..piecewise.tracer import Tracer
from ..trajectory.records import Impacts
from ..trajectory.trajectory import Reference, SolverFailure, Trajectory
from .exact.piecewise import solve_exact
from .registry import KEEP, Steps

COPIES = 4  # of the exact solution, each perturbed in its own way
SOON = 40  # powers of two below t_end
PART = 0.5  # of the tolerances, to which two solutions must agree: each may be off by as much
FINEST = 1e-11  # rtol of an adaptive solution up to which a tenth of it is compared with
MARGIN = 4.0  # times the rounding, for the perturbed copies
DISPLACEMENT_TOLERANCE = 1e-3  # of max |u|
STILL = 1e-9  # of the motion: that of a point which stands still is rounding
LOOKS = 64  # output times at which the size of the whole motion is looked at


class Watched(NamedTuple):
    """Data that define the horizon: positions at the times t (k,), of the tip and then of every contact, and the
    impacts of each contact."""

    t: Array
    paths: tuple[Array, ...]
    impacts: tuple[Impacts, ...]


def agreement(a: Trajectory, b: Trajectory, tolerance: float, part: float = 1.0) -> float:
    """The time to which a and b agree: |du| <= 1e-3 max|u| at output times, impact times to ``tolerance``.

    u is the position of the tip and, each by itself, of every contact, see ``scales_of``. Impacts are paired in order,
    see ``impacts_match_until``, and must differ by less than a twentieth of the mean time between those of their
    contact too. Both must have the same output times. max|u| is the smaller of the two: past the horizon, one that has
    diverged may move further than the system does. part: of the tolerances.
    """
    return agree_until(watched(a), watched(b), tolerance, list(np.fmin(scales_of(a), scales_of(b))), part)


def watched(run: Trajectory) -> Watched:
    """The data of a run that define the horizon, at its output times."""
    return Watched(run.t, (run.tip, *(c.position for c in run.contacts)), tuple(c.impacts for c in run.contacts))


def scales_of(run: Trajectory) -> list[float]:
    """Scale of 1e-3 for every path of ``watched``: max|u|, of a contact at least the gap to its nearer stop and STILL
    of the tip's; of all of them at least STILL of what the whole motion could move the point by."""
    largest = float(np.max(np.abs(run.tip)))
    scales = [largest, *(max(c.scale, STILL * largest) for c in run.contacts)]
    return np.maximum(scales, STILL * _reach(run)).tolist()


def _reach(run: Trajectory) -> Array:
    """sqrt(row M^-1 row) max |q|_M >= max|row q| of the tip's row and every contact's; 0 of a run without states."""
    system, state_at = run.system, getattr(run, "state_at", None)
    if system is None or state_at is None:
        return np.zeros(1 + len(run.contacts))
    # Every so many outputs, rounded up: at most LOOKS states.
    q, _ = state_at(run.t[:: -(-len(run.t) // LOOKS)])
    # The inequality of Cauchy and Schwarz in the norm of M.
    length = np.sqrt(np.max(np.sum(q * (q @ system.mass), axis=1)))
    seen = [np.atleast_2d(system.channels[i][0]) for i in (system.tip_channel, *range(len(run.contacts)))]
    rows, heads = np.concatenate(seen), np.cumsum([0, *map(len, seen[:-1])])
    # Of a hole both rows count: no direction reaches farther.
    return length * np.sqrt(np.add.reduceat(np.sum(rows * np.linalg.solve(system.mass, rows.T).T, axis=1), heads))


def agree_until(
    a: Watched, b: Watched, tolerance: float, scales: Sequence[float], part: float = 1.0, chatters: bool = False
) -> float:
    """See ``agreement``; part: of the tolerances; chatters: see ``impacts_match_until``."""
    end = float(min(a.t[-1], b.t[-1]))
    horizon = end
    for u, other, scale in zip(a.paths, b.paths, scales, strict=True):
        close = np.abs(u - other) <= part * DISPLACEMENT_TOLERANCE * scale  # NaN is not
        if not np.all(close):
            # The last output before the first difference.
            horizon = min(horizon, float(a.t[max(0, int(np.argmin(close)) - 1)]))
    for c, d in zip(a.impacts, b.impacts, strict=True):
        least = min(tolerance, apart(max(c.count, d.count), end))
        horizon = min(horizon, impacts_match_until(c, d, part * least, end, chatters))
    return horizon


def impacts_match_until(a: Impacts, b: Impacts, tolerance: float, end: float, chatters: bool = False) -> float:
    """The time of the first impact that does not match, else ``end``.

    The i-th impacts of a and b match where they are on the same stop with times that differ by ``tolerance``
    at most. Impacts within the tolerance of the start do not count: a motion that starts on a stop may enter
    it or be in it already. Nor do those within the tolerance of ``end``, whose partner may come just after.
    chatters: nor those without a partner that come at once after the last one with a partner.
    """
    a, b = (_after(tolerance, x) for x in (a, b))
    n = min(a.count, b.count)
    bad = (a.stops[:n] != b.stops[:n]) | (np.abs(a.times[:n] - b.times[:n]) > tolerance)
    # Both sequences agree up to the earlier of the first two impacts that do not match.
    if np.any(bad):
        k = int(np.argmax(bad))
        return float(min(a.times[k], b.times[k]))
    # Where one sequence is longer, its next impact is missing in the other.
    unpaired = np.concatenate([a.times[n:], b.times[n:]])
    unpaired = unpaired[unpaired < end - tolerance]
    if chatters and n:
        unpaired = unpaired[unpaired > a.times[n - 1] + tolerance]
    return float(np.min(unpaired)) if len(unpaired) else end


def _after(t: float, impacts: Impacts) -> Impacts:
    return impacts.take(impacts.times > t)


def apart(count: int, end: float) -> float:
    """A twentieth of the mean time between ``count`` impacts in [0, end]: corresponding impacts of two solutions must
    differ by less, however slow the motion is."""
    return 0.05 * end / max(1, count)


def time_tolerance(system: System, t_end: float = np.inf) -> float:
    """Largest difference of impact times inside the horizon: a thousandth of the longest time scale of a run to t_end.

    That is 1.0e-4 time units for the paper's k^2 = 300.
    """
    return 1e-3 * scales(system, t_end).period


def copies(system: System, t_end: float, t: Array, size: float) -> Iterator[Watched]:
    """Perturbed copies of the exact solution, an endless sequence, each by ``size`` in its own way; t: as in
    ``Watched``."""
    # All copies share the unperturbed modes.
    source = Source(system, span=t_end)
    for seed in count():
        with within_float64("exact", t_end):
            solution = Tracer(source, Perturbation(size, size, seed)).solve(t_end)
            seen = [path_of(system, solution, t, channel)[0] for channel in range(len(system.channels))]
            paths = (seen[system.tip_channel], *seen[: len(system.contacts)])
            impacts = tuple(entries(solution, i, t_end) for i in range(len(system.contacts)))
        yield Watched(t, paths, impacts)  # outside: what float64 raises inside is not for who goes on with it


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
    # Errors that no copy shows end the horizon by estimates: of phases, free modes and slow modes.
    tolerance, solution = time_tolerance(system, t_end), reference.solution
    fastest = 2.0 * np.pi / solution.shortest_period
    unseen = min(t_end, DISPLACEMENT_TOLERANCE / (eps * fastest), _of_free_modes(system))
    unseen = min(unseen, *(_of_slow_modes(system, sides) for sides in np.unique(solution.sides, axis=0)))
    horizon, own, scales = unseen, watched(reference), scales_of(reference)
    # The first copy to diverge ends it.
    others = copies(system, t_end, reference.t, eps)
    for seed in range(COPIES):
        show(f"exact: copy {seed + 1} of {COPIES} for its horizon", 1 + seed, 1 + COPIES)
        horizon = min(horizon, agree_until(own, next(others), tolerance, scales, PART))
    # Some copy differs at the first output after the start already: look at earlier times.
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
    # Under a constant force q = f t^2/2 (1 - omega^2 t^2/12 + ...); a zero of K is known to its rounding.
    terms = np.sum(np.abs(shapes) * (np.abs(system.stiffness) @ np.abs(shapes)), axis=0)
    largest = float(np.max(rounding_of_zero(terms, system.size), initial=0.0))
    return float(np.sqrt(12.0 * DISPLACEMENT_TOLERANCE / largest)) if largest else np.inf


def _of_slow_modes(system: System, sides: NDArray[np.int64]) -> float:
    """Horizon from slow modes while the contacts press on these sides, see ``known_until``."""
    closed = [
        (x.row, *x.stops.spring(1), x.stops.damping) for x, side in zip(system.contacts, sides, strict=False) if side
    ]
    # Dashpots of closed contacts damp the system in this regime.
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
        # The exact solution is the better judge where it exists.
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
    # The tolerance to state is the strictest: contacts that are hit often have a smaller one.
    tolerance = min([tolerance, *(apart(c.impacts.count, t_end) for c in reference.contacts)])
    notes |= {
        "horizon": horizon,
        "horizon_against": against,
        "horizon_tolerance": f"|du| <= {DISPLACEMENT_TOLERANCE:g} max|u|, impact times to {tolerance:.3g}",
    }
    return replace(reference, horizon=horizon, provenance=reference.provenance | notes)
