"""Predictability: the time to which a reference agrees with another solution or with perturbed copies of itself, at the
tip and at every contact; and the rate at which neighbouring motions diverge, by the tangent flow,

    z(t) = Phi(t) z(0),  Phi(t) = flow of the last segment ... flow of the first,  |Phi(t) z| ~ exp(lambda t)

Between them stand the saltation matrices of the events, see exact/tangent.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import Show, working
from ..basics.validation import InputError, Rng, positive
from ..model.modes import rounding_of_zero, undamped_modes
from ..model.scales import scales
from ..model.system import System, require_system
from ..trajectory.records import STILL, Impacts, at_rest_until, last_before
from ..trajectory.trajectory import Reference, SolverFailure, Trajectory
from .exact.motion import Motion, Solver
from .exact.solution import DUST, audit, entries, largest_momentum, refuse, solve_exact, withheld, within_float64
from .exact.tangent import Tangent, Variation
from .registry import Request

COPIES = 8  # of the problem, each perturbed in its own way
FOURTH = 4  # output times of which a copy is compared at one; its impacts are all compared
PERTURBATION = 16.0 * float(np.finfo(float).eps)  # of all numbers of a copy
SOON = 40  # powers of two below t_end
PART = 0.5  # of the tolerances, to which two solutions must agree: each may be off by as much
DISPLACEMENT_TOLERANCE = 1e-3  # of max |u|
IMPULSES = 0.01  # of the largest impulse of a contact
AT_ONCE = 1e-14  # of t_end
LOOKS = 64  # output times at which the size of the whole motion is looked at


class Watched(NamedTuple):
    """Data that define the horizon: positions at the times t (k,), of the tip and then of every contact, and their
    scales; the impacts of each contact, and of an exact motion the impulses (m,) of rigid stops at t = 0, but for
    rounding."""

    t: Array
    paths: tuple[Array, ...]
    scales: Array
    impacts: tuple[Impacts, ...]
    struck: Array = np.zeros(0)


def agreement(a: Trajectory, b: Trajectory, tolerance: float) -> float:
    """The time to which a and b agree to PART of |du| <= 1e-3 max|u| at output times, and of impact times to
    ``tolerance``.

    u is the position of the tip and, each by itself, of every contact, see ``watched``. Impacts are paired in order,
    see ``impacts_match_until``, and must differ by less than a twentieth of the mean time between those of their
    contact too; their impulses by less than IMPULSES of the largest. Both must have the same output times, but one may
    end earlier. max|u| is the smaller of the two: past the horizon, one that has diverged may move further than the
    system does.
    """
    return agree_until(watched(a), watched(b), tolerance)


def watched(run: Trajectory) -> Watched:
    """The data of a run that define the horizon, at its output times.

    Scales: max|u|, of a contact at least the gap to its nearer stop and STILL of the tip's; of all of them at least
    STILL of what the whole motion could move the point by, sqrt(row M^-1 row) max |q|_M >= max|row q|.
    """
    largest, system, state_at = float(np.max(np.abs(run.tip))), run.system, getattr(run, "state_at", None)
    scales = np.array([largest, *(max(c.scale, STILL * largest) for c in run.contacts)])
    if system is not None and state_at is not None:
        # Every so many outputs, rounded up: at most LOOKS states.
        q, _ = state_at(run.t[:: -(-len(run.t) // LOOKS)])
        length = np.sqrt(np.max(np.sum(q * (q @ system.mass), axis=1)))
        rows = _rows(system)
        reach = length * np.sqrt(np.sum(rows * np.linalg.solve(system.mass, rows.T).T, axis=1))
        scales = np.maximum(scales, STILL * reach)
    paths = run.tip, *(c.position for c in run.contacts)
    return Watched(run.t, paths, scales, tuple(c.impacts for c in run.contacts))


def _rows(system: System) -> Array:
    """The rows (1 + m, n) of the tip and of every contact."""
    return np.array([system.channels[i][0] for i in (system.tip_channel, *range(len(system.contacts)))])


def _watched_motion(motion: Motion, t: Array, scales: Array) -> Watched:
    """The same of an exact motion, at any times t (k,)."""
    system, end, contacts = motion.system, float(t[-1]), range(len(motion.system.contacts))
    paths = tuple(motion.path(t, i)[0] for i in (system.tip_channel, *contacts))
    impacts = tuple(entries(motion, i, end) for i in contacts)
    if not system.rigid:
        return Watched(t, paths, scales, impacts)
    largest, blows = np.array([largest_momentum(motion, i) for i in contacts]), motion.blows
    strong = (blows.t <= AT_ONCE * end) & (blows.outward >= DUST * largest[blows.contact])
    return Watched(t, paths, scales, impacts, np.bincount(blows.contact, blows.outward * strong, len(contacts)))


def agree_until(a: Watched, b: Watched, tolerance: float, chatters: bool = False) -> float:
    """See ``agreement``; chatters: see ``impacts_match_until``."""
    n = min(len(a.t), len(b.t))
    t, end, scales = a.t[:n], float(min(a.t[-1], b.t[-1])), np.fmin(a.scales, b.scales)
    horizon = end
    if len(a.struck) and np.max(np.abs(a.struck - b.struck)) > IMPULSES * np.max(np.abs([a.struck, b.struck])):
        return 0.0
    for u, other, scale in zip(a.paths, b.paths, scales, strict=True):
        close = np.abs(u[:n] - other[:n]) <= PART * DISPLACEMENT_TOLERANCE * scale  # NaN is not
        horizon = min(horizon, last_before(t, ~close, end))
    for k, (c, d) in enumerate(zip(a.impacts, b.impacts, strict=True), 1):
        least = min(tolerance, apart(max(c.count, d.count), end))
        begun = max(at_rest_until(x.t, x.paths[k], scales[k]) for x in (a, b))
        horizon = min(horizon, impacts_match_until(c, d, PART * least, end, chatters, begun))
    return horizon


def impacts_match_until(
    a: Impacts, b: Impacts, tolerance: float, end: float, chatters: bool = False, begun: float = 0.0
) -> float:
    """The time of the first impact that does not match, else ``end``.

    The i-th impacts of a and b match where they are on the same stop with times that differ by ``tolerance``
    at most. Impacts within the tolerance of the start do not count: a motion that starts on a stop may enter
    it or be in it already. Nor do those before ``begun``, when the contact has not moved: a stop on which it rests it
    enters where rounding shows it. Nor do those within the tolerance of ``end``, whose partner may come just after.
    chatters: nor those without a partner that come at once after the last one with a partner.
    """
    late = a.times > max(tolerance, begun), b.times > max(tolerance, begun)
    (t1, stops1), (t2, stops2) = ((x.times[rows], x.stops[rows]) for x, rows in zip((a, b), late, strict=True))
    n = min(len(t1), len(t2))
    bad = (stops1[:n] != stops2[:n]) | (np.abs(t1[:n] - t2[:n]) > tolerance)
    # Impulses too, where both have them: where the order of two impacts at one time decides, they differ at once.
    x, y = (x.impulses[rows][:n] for x, rows in zip((a, b), late, strict=True))
    bad |= np.abs(x - y) > IMPULSES * min(np.nanmax(each, initial=0.0) for each in (x, y))
    # Both sequences agree up to the earlier of the first two impacts that do not match.
    if np.any(bad):
        k = int(np.argmax(bad))
        return float(np.nextafter(min(t1[k], t2[k]), 0.0))
    # Where one sequence is longer, its next impact is missing in the other.
    unpaired = np.concatenate([t1[n:], t2[n:]])
    unpaired = unpaired[unpaired < end - tolerance]
    if chatters and n:
        unpaired = unpaired[unpaired > t1[n - 1] + tolerance]
    return float(np.min(unpaired)) if len(unpaired) else end


def apart(count: int, end: float) -> float:
    """A twentieth of the mean time between ``count`` impacts in [0, end]: corresponding impacts of two solutions must
    differ by less, however slow the motion is."""
    return 0.05 * end / max(1, count)


def time_tolerance(system: System, t_end: float = np.inf) -> float:
    """Largest difference of impact times inside the horizon: a thousandth of the longest time scale of a run to t_end.

    That is 1.0e-4 time units for the paper's k^2 = 300.
    """
    return 1e-3 * scales(system, t_end).period


def exact_horizon(reference: Reference, t_end: float, tolerance: float, show: Show) -> tuple[float, dict[str, Any]]:
    """Horizon of the exact float64 solution, and the evidence for it, for the provenance.

    It is the time to which COPIES of the problem, whose numbers are all off by PERTURBATION at most, agree with the
    solution to half the tolerance. No copy shows that a mode counts as free which a stiffness within the rounding of K
    would hold back: the horizon ends where a bound of that reaches the tolerance. Raises SolverFailure where it ends at
    once between compliant stops.
    """
    motion, scales = reference.solution, watched(reference).scales
    t = np.append(reference.t[:-1:FOURTH], reference.t[-1])
    system: System = motion.system
    if system.rigid:
        # Differences as large as the rounding of held positions pass, or a body at rest would have no horizon.
        _, kept = withheld(motion, t_end)
        scales = np.maximum(scales, np.abs(_rows(system)) @ kept / (PART * DISPLACEMENT_TOLERANCE))
    most = min(t_end, _of_free_modes(system))
    horizon = copies_agree_until(motion, t, tolerance, scales, most, show)
    # Some copy differs at the first output after the start already: look at earlier times.
    if horizon == 0.0:
        soon = np.append(0.0, t_end * 2.0 ** np.arange(-SOON, 1.0))
        horizon = copies_agree_until(motion, soon, tolerance, scales, most, show)
        if horizon <= soon[1] and not system.rigid:
            reason = "rounding is as large as the outputs from the start"
            raise SolverFailure("exact", 0.0, reason, "use multiprecision")
    against = f"{COPIES} copies of the problem, its numbers off by {PERTURBATION:.2g}, to half the tolerance"
    ends = _order_decides(motion, horizon, t) if system.rigid and horizon < t_end else ""
    return horizon, {"horizon_against": against} | ({"horizon_ends": ends} if ends else {})


def copies_agree_until(motion: Motion, t: Array, tolerance: float, scales: Array, horizon: float, show: Show) -> float:
    """The time, ``horizon`` at most, to which COPIES of the problem agree with its motion at the times t (k,)."""
    solver = Solver(motion.system, motion.free)

    def agreed(copy: Solver, until: float) -> float:
        """The time to which a copy agrees, at the times up to the first behind ``until``."""
        part = t[: max(2, 1 + int(np.searchsorted(t, until)))]
        end = float(part[-1])
        with within_float64("exact", end):
            other = _watched_motion(copy.solve(end, stations=part), part, scales)
        # Of a chatter either may count more impacts.
        return agree_until(_watched_motion(motion, part, scales), other, tolerance, motion.system.rigid)

    for seed in range(COPIES):
        show(f"exact: copy {seed + 1} of {COPIES} for its horizon", 1 + seed, 1 + COPIES)
        copy = solver.perturbed(PERTURBATION, seed)
        # The first copy to diverge, or to stop, ends it: no other need go further.
        try:
            horizon = min(horizon, agreed(copy, horizon))
        except SolverFailure as stopped:
            horizon = float(t[max(0, int(np.searchsorted(t, stopped.t)) - 1)])
            if horizon > 0.0:  # else it stops before the first output behind the start
                horizon = min(horizon, agreed(copy, float(np.nextafter(horizon, 0.0))))
    return horizon


def _order_decides(solution: Motion, horizon: float, t: Array) -> str:
    """Sentence for a horizon that ends, by one output at most, before several rigid stops are hit at one time."""
    blows, after = solution.blows, t[np.searchsorted(t, horizon, "right") :]
    until = float(after[0]) if len(after) else np.inf
    for mark in np.unique(blows.mark[(blows.t >= horizon) & (blows.t <= until)]).tolist():
        here = blows.mark == mark
        if len(np.unique(blows.contact[here])) > 1:
            when = f"Contacts are hit at one time, t = {blows.t[here][0]:.6g}"
            return f"{when}: their order decides what follows. To compare further, move one of the stops a little."
    return ""


def _of_free_modes(system: System) -> float:
    """omega^2 t^2/12 of a free motion under a constant force is lost where omega^2 is the rounding of a zero."""
    basis = undamped_modes(system)
    shapes = basis.shapes[:, basis.omega == 0.0]
    # Under a constant force q = f t^2/2 (1 - omega^2 t^2/12 + ...); a zero of K is known to better than this bound.
    terms = np.sum(np.abs(shapes) * (np.abs(system.stiffness) @ np.abs(shapes)), axis=0)
    largest = float(np.max(rounding_of_zero(terms, system.size), initial=0.0))
    return float(np.sqrt(12.0 * DISPLACEMENT_TOLERANCE / largest)) if largest else np.inf


def with_horizon(
    reference: Reference, request: Request, solve: Callable[[Request], Reference], show: Show
) -> Reference:
    """``reference``, the solution of ``request``, with its horizon; the provenance names the solution that it was
    compared with.

    The exact solution is compared with perturbed copies of itself, see ``exact_horizon``. Any other solution is
    compared with the exact one. If that does not exist, it is compared with itself at ten times its rtol, with steps of
    less than half the length and the functions of time sampled at other points; the horizon ends where the time of
    that one does. A load that one of the two missed makes them differ; a load that both missed is not found. Both must
    agree to half the tolerance, so that each may be off by the other half. solve: the function that solves another
    request. Raises SolverFailure for an exact solution without any valid time span.
    """
    system, t_end = request.system, float(reference.provenance["t_end"])
    tolerance = time_tolerance(system, t_end)
    notes: dict[str, Any] = {}
    if request.method == "exact":
        horizon, notes = exact_horizon(reference, t_end, tolerance, show)
    else:
        show(f"{request.method}: a second solution for its horizon", 1, 2)
        # The exact solution is the better judge where it exists.
        try:
            other = solve_exact(system, t_end, reference.t)
            against = "exact"
        except (InputError, SolverFailure):
            rtol = 10.0 * request.rtol
            against = f"itself at rtol {rtol:g} with shorter steps"
            other = solve(request._replace(t_end=t_end, t_eval=reference.t, rtol=rtol, atol=None, second=True))
            if "budget" in other.provenance:
                against += f"; that one ends at t = {other.provenance['t_end']:.3g}"
                notes["budget"] = reference.provenance.get("budget", other.provenance["budget"])
            seen = reference.provenance.get("functions_seen_every", 0.0)
            against += f"; functions in Python seen at steps of at most {seen:.2g}" if seen else ""
        horizon, notes["horizon_against"] = agreement(reference, other, tolerance), against
    # The tolerance to state is the strictest: contacts that are hit often have a smaller one.
    tolerance = min([tolerance, *(apart(c.impacts.count, t_end) for c in reference.contacts)])
    notes |= {
        "horizon": horizon,
        "horizon_tolerance": f"|du| <= {DISPLACEMENT_TOLERANCE:g} max|u|, impact times to {tolerance:.3g}",
    }
    return replace(reference, horizon=horizon, provenance=reference.provenance | notes)


# ---------------------------------------------------------------- growth of tangent vectors

RANDOM = 3  # tangent vectors beside the direction of the motion itself
SAMPLES = 200  # times besides the events
ROUNDING = 1e-14  # of a vector, what a projection leaves of one along its own direction
LEAST = 1e-150  # size of a vector: its square is a number yet
MERGED = "neighbouring motions become equal and have no exponent: their tangent vectors vanish below float64"


@dataclass(frozen=True, eq=False)
class PerturbationGrowth:
    """Growth of tangent vectors along an exact motion, ln(|Phi(t) z|/|z|).

    The energy norm without contact, |z|^2 = dq'^T M dq' + dq^T K dq, is that of the growth.

    Parameters
    ----------
    t : array (k,)
    log_growth : array (k, vectors)
        The first vectors are random. The last one is the direction of the motion at t = 0, where it is not at rest.
    """

    t: Array
    log_growth: Array

    def __repr__(self) -> str:
        return (
            f"<PerturbationGrowth to t = {self.t[-1]:g}: exponent {self.exponent:.4g}, {self.digits:.1f} digits lost>"
        )

    @property
    def exponent(self) -> float:
        """The finite-time Lyapunov exponent, mean over the vectors of ln(|Phi z|/|z|)/t at the last time."""
        return float(np.mean(self.log_growth[-1]) / self.t[-1])

    @property
    def digits(self) -> float:
        """Decimal digits that the motion loses on the way to the last time."""
        return float(np.max(self.log_growth) / np.log(10.0))


@working("following neighbours")
def lyapunov(system: System, t_end: float, rng: Rng = 0) -> PerturbationGrowth:
    """Return the growth of tangent vectors along the exact float64 motion on [0, t_end].

    Beyond the horizon that motion is another one of the same system, and the growth along it is as good an estimate.

    Parameters
    ----------
    system : System
        As for the exact solution; stops may be rigid.
    t_end : float
    rng : None, int, Generator, BitGenerator or SeedSequence
        Of the random directions, for ``numpy.random.default_rng``.

    Returns
    -------
    PerturbationGrowth

    Raises
    ------
    InputError
        As the exact solution does.
    SolverFailure
        If a motion against rigid stops comes to rest: the end of chatter takes back what it had magnified, and
        nothing is left of a neighbouring motion. Also where it hits two of them at one time: neighbours hit one before
        the other.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> growth = sb.lyapunov(sb.paper_case(10).system(), 0.5)
    >>> bool(growth.log_growth[-1, 0] > 10.0)
    True
    """
    require_system(system)
    t_end = positive("t_end", t_end)
    refuse(system, t_end, 'take the study "chaos"')
    with within_float64("lyapunov", t_end):
        solution = Solver(system).solve(t_end)
        if not system.rigid:
            audit(solution, t_end)
        tangent = Tangent(Variation(system), solution, t_end)
        # Vectors that held contacts leave nothing of drop out.
        dz = _on_stops(tangent, 0, _vectors(tangent, rng))
        size = _norm(tangent, dz)
        dz = dz[size > 0.0] / size[size > 0.0, None]
        if not len(dz):
            raise SolverFailure("lyapunov", 0.0, MERGED, "shorten t_end")
        times = tangent.times
        # Every event is an edge, so that each flow is that of one segment.
        edges = np.union1d(times[times < t_end], np.linspace(0.0, t_end, SAMPLES + 1))
        segment = tangent.segment_at(edges[:-1])
        logs, last = np.zeros((len(edges), len(dz))), 0
        for i, (k, tau) in enumerate(zip(segment.tolist(), np.diff(edges).tolist(), strict=True)):
            # Several events may come between two edges, at one time.
            for new in range(last + 1, k + 1):
                dz = _on_stops(tangent, new, tangent.across(new, dz))
            if tangent.ties:
                remedy = "shorten t_end, or move one of the stops a little"
                raise SolverFailure("lyapunov", tangent.ties[0], "two contacts are hit at one time", remedy)
            last, dz = k, tangent.regimes[k].flow(tau, dz)
            # Unit vectors again: the logarithms add up where the vectors would overflow.
            size = _norm(tangent, dz)
            if not np.all((size > LEAST) & np.isfinite(size)):
                raise SolverFailure("lyapunov", float(edges[i]), MERGED, "shorten t_end")
            dz, logs[i + 1] = dz / size[:, None], logs[i] + np.log(size)
        return PerturbationGrowth(edges, logs)


def _on_stops(tangent: Tangent, segment: int, dz: Array) -> Array:
    """Vectors (D, 2n) with what newly held contacts of a segment leave of them, M-orthogonal to M^-1 row^T: impulses
    along the row do not touch it. Zero where all that is left is rounding."""
    regime, n = tangent.regimes[segment], tangent.variation.n
    if not regime.held or (segment and set(regime.held) <= set(tangent.regimes[segment - 1].held)):
        return dz
    H, halves = tangent.variation.free.rows[regime.held], dz.reshape(len(dz), 2, n)
    kept = halves - halves @ np.linalg.pinv(H) @ H
    left, whole = (np.linalg.norm(x, axis=2, keepdims=True) for x in (kept, halves))
    return np.where(left > ROUNDING * whole, kept, 0.0).reshape(dz.shape)


def _vectors(tangent: Tangent, rng: Rng) -> Array:
    """Tangent vectors (vectors, 2n) in modes: random with the energy spread over all of them, and (q', q'')."""
    omega = np.sqrt(tangent.variation.free.w2)
    noise = np.random.default_rng(rng).standard_normal((2, len(omega), RANDOM))
    slowest = np.min(omega, where=omega > 0.0, initial=np.max(omega) or 1.0)  # also for a rigid motion
    # Displacements over frequencies: elastic and kinetic energy are of one size. The floor bounds nearly rigid modes.
    scale = np.where(omega > 0.0, np.maximum(omega, 1e-8 * np.max(omega)), slowest)
    own = tangent.regimes[0].A @ tangent.whole(0, 0.0, tangent.z[0], np.zeros((0, tangent.z.shape[1])))[0]
    return np.vstack([np.hstack([noise[0].T / scale, noise[1].T]), own[: tangent.z.shape[1]]])


def _norm(tangent: Tangent, dz: Array) -> Array:
    """sqrt(dq'^T M dq' + dq^T K dq) of every vector."""
    n = tangent.variation.n
    return np.sqrt(np.sum(dz[:, n:] ** 2, axis=1) + dz[:, :n] ** 2 @ tangent.variation.free.w2)
