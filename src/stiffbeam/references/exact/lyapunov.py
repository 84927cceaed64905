"""The tangent flow of the exact solution: the rate at which neighbouring motions diverge, and the loss of digits.

    z(t) = Phi(t) z(0),  Phi(t) = flow of the last segment ... flow of the first,  |Phi(t) z| ~ exp(lambda t)

If the force is continuous, tangent vectors do not jump at an event (the saltation matrix is the identity), and Phi is
the product of the homogeneous flows of the segments. At the entry into a damped stop the force jumps, see follow.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...basics.arrays import Array
from ...basics.validation import integer, positive
from ...model.modes import undamped_modes
from ...model.system import System, require_system
from ...model.time_functions import offset_rate
from ...piecewise.follow import entry
from ...piecewise.generator import Generators
from ...piecewise.measures import audit, within_float64
from ...piecewise.motion import Motion
from ...piecewise.tangent import Tangent
from ...piecewise.tracer import tracer_of
from ...trajectory.trajectory import SolverFailure
from ..rigid_stops import require_rigid
from .derivative import path_of_solution
from .impacting import Tracer as ImpactTracer
from .piecewise import afford_search, refuse
from .rigid_motion import RigidMotion

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
    def largest(self) -> Array:
        """The largest growth of the vectors so far, ln, (k,)."""
        return np.maximum.accumulate(np.max(self.log_growth, axis=1))

    @property
    def exponent(self) -> float:
        """The finite-time Lyapunov exponent, mean over the vectors of ln(|Phi z|/|z|)/t at the last time."""
        return float(np.mean(self.log_growth[-1]) / self.t[-1])

    @property
    def digits(self) -> float:
        """Decimal digits that the motion loses on the way to the last time."""
        return float(self.largest[-1] / np.log(10.0))


def lyapunov(system: System, t_end: float, seed: int = 0) -> PerturbationGrowth:
    """Return the growth of tangent vectors along the exact float64 motion on [0, t_end].

    Beyond the horizon that motion is another one of the same system, and the growth along it is as good an estimate.

    Parameters
    ----------
    system : System
        As for the exact solution; stops may be rigid.
    t_end : float
    seed : int
        Of the random directions.

    Returns
    -------
    PerturbationGrowth

    Raises
    ------
    InputError
        As the exact solution does.
    SolverFailure
        If a motion against rigid stops comes to rest: the end of chatter takes back what it had magnified, and
        nothing is left of a neighbouring motion.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> growth = sb.lyapunov(sb.paper_case(10).system(), 0.5)
    >>> bool(growth.log_growth[-1, 0] > 10.0)
    True
    """
    require_system(system)
    t_end = positive("t_end", t_end)
    integer("seed", seed, 0)
    rigid = system.rigid
    if rigid:
        require_rigid(system, t_end)
        with within_float64("lyapunov", t_end):
            return growth(system, ImpactTracer(system).solve(t_end), t_end, seed)
    refuse(system, t_end)
    with within_float64("lyapunov", t_end):
        afford_search(system, t_end)
        solution = tracer_of(system).solve(t_end)
        audit(system, solution, t_end)
        return growth(system, solution, t_end, seed)


def growth(system: System, solution: Motion, t_end: float, seed: int = 0, enough: float = np.inf) -> PerturbationGrowth:
    """``lyapunov`` along an existing solution; it ends where a growth, ln, reaches ``enough``."""
    dq, dv = _vectors(system, seed)
    along = Struck(system, solution, t_end) if isinstance(solution, RigidMotion) else Pressed(system, solution)
    # Vectors that held contacts leave nothing of drop out.
    dq, dv = _unit(system, *along.start(dq, dv))
    if not dq.shape[1]:
        raise SolverFailure("lyapunov", 0.0, MERGED, "shorten t_end")
    times = np.asarray(solution.times)
    # Every event is an edge, so that each flow is that of one segment.
    edges = np.union1d(times[times < t_end], np.linspace(0.0, t_end, SAMPLES + 1))
    # The compiled loop does it all, unless it cannot follow a regime or a vector under- or overflows.
    if isinstance(along, Pressed):
        passed, logs = solution.grow(system, edges, dq, dv, enough)
        if passed == len(edges) - 1 or np.max(logs[passed]) > enough:
            return PerturbationGrowth(edges[: passed + 1], logs[: passed + 1])
    segment = np.maximum(np.searchsorted(times, edges[:-1], side="right") - 1, 0)
    logs, last = np.zeros((len(edges), dq.shape[1])), 0
    for i, (k, tau) in enumerate(zip(segment.tolist(), np.diff(edges).tolist(), strict=True)):
        # Several events may come between two edges, at one time.
        for new in range(last + 1, k + 1):
            dq, dv = along.across(new, dq, dv)
        last = k
        try:
            dq, dv, logs[i + 1] = _carried(system, along, k, tau, dq, dv, logs[i], float(edges[i]))
        except SolverFailure:
            if not np.isfinite(enough):
                raise
            return PerturbationGrowth(edges[: i + 1], logs[: i + 1])  # nothing is left that could grow to ``enough``
        if np.max(logs[i + 1]) > enough:
            return PerturbationGrowth(edges[: i + 2], logs[: i + 2])
    return PerturbationGrowth(edges, logs)


@dataclass(frozen=True, eq=False)
class Pressed:
    """Tangent vectors (n, k) along a motion between compliant stops."""

    system: System
    solution: Motion

    def start(self, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Vectors at t = 0."""
        return dq, dv

    def flow(self, segment: int, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Vectors at tau after dq, dv in a segment."""
        return self.solution.flow(segment, tau, dq, dv)

    def across(self, segment: int, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Vectors after the event at which a segment begins."""
        return dq, entry(self.system, self.solution.sides[segment - 1], self.solution.sides[segment], dq, dv)


class Struck:
    """Tangent vectors (n, k) along a motion between rigid stops.

    A contact that is held leaves of them what is M-orthogonal to M^-1 row^T: impulses along the row do not touch it.
    """

    def __init__(self, system: System, solution: RigidMotion, t_end: float) -> None:
        self.n, self.held = system.size, solution.held
        self.tangent = Tangent(Generators(system), path_of_solution(system, solution, t_end))

    def start(self, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Vectors at t = 0."""
        return self._on_stops(0, dq, dv)

    def flow(self, segment: int, tau: float, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Vectors at tau after dq, dv in a segment."""
        return self._split(self.tangent.regimes[segment].ahead(self._joined(dq, dv), tau))

    def across(self, segment: int, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Vectors after the event at which a segment begins."""
        dq, dv = self._split(self.tangent.across(segment, self._joined(dq, dv)))
        # Contacts held before stay so under the flow: only new ones change the vectors.
        newly_held = set(self.held[segment]) - set(self.held[segment - 1])
        return self._on_stops(segment, dq, dv) if newly_held else (dq, dv)

    def _joined(self, dq: Array, dv: Array) -> Array:
        return np.vstack([dq, dv, np.zeros((self.tangent.generators.basis.size, dq.shape[1]))])

    def _split(self, dZ: Array) -> tuple[Array, Array]:
        return dZ[: self.n], dZ[self.n : 2 * self.n]

    def _on_stops(self, segment: int, dq: Array, dv: Array) -> tuple[Array, Array]:
        """Projection of vectors while the contacts of a segment are held; zero where all that is left is rounding."""
        data, held = self.tangent.generators.data, list(self.held[segment])
        if not held:
            return dq, dv
        rows = data.rows[held]
        back = np.linalg.solve(data.mass, rows.T)
        # M-orthogonal projection onto displacements and velocities that leave the held contacts in place.
        kept = [x - back @ np.linalg.solve(rows @ back, rows @ x) for x in (dq, dv)]
        size = [np.linalg.norm(x, axis=0) for x in (*kept, dq, dv)]
        return np.where(size[0] > ROUNDING * size[2], kept[0], 0.0), np.where(
            size[1] > ROUNDING * size[3], kept[1], 0.0
        )


def _carried(
    system: System, along: Pressed | Struck, segment: int, tau: float, dq: Array, dv: Array, log: Array, t: float
) -> tuple[Array, Array, Array]:
    """Unit vectors and the ln of their growth after tau more; in ever shorter parts where damping leaves
    nothing of them that float64 can hold."""
    # Unit vectors again after every part: the logarithms add up where the vectors would underflow.
    for parts in (1, 10, 100, 1000):
        q, v, total = dq, dv, log
        for _ in range(parts):
            q, v = along.flow(segment, tau / parts, q, v)
            size = _norm(system, q, v)
            if not np.all((size > LEAST) & np.isfinite(size)):
                break
            q, v, total = q / size, v / size, total + np.log(size)
        else:
            return q, v, total
    raise SolverFailure("lyapunov", t, MERGED, "shorten t_end")


def predicted_horizon(system: System, solution: Motion, t_end: float, tolerance: float) -> float:
    """The first time at which rounding, eps (1 + w_max t) |Phi(t)| of the motion, reaches ``tolerance`` of it.

    An error eps w_max of the frequencies turns a mode by eps w_max t: that much more than a rounding of
    the initial data is there to be magnified, all of it counted as if it had been there from the start.
    """
    eps, fastest = float(np.finfo(float).eps), 2.0 * np.pi / solution.shortest_period
    # Growth beyond tolerance/eps is not needed: there a rounding has reached the tolerance.
    grown = growth(system, solution, t_end, enough=float(np.log(tolerance / eps)))
    over = np.flatnonzero(np.log(eps * (1.0 + fastest * grown.t)) + grown.largest > np.log(tolerance))
    return float(grown.t[over[0]]) if len(over) else t_end


def _vectors(system: System, seed: int) -> tuple[Array, Array]:
    """Unit tangent vectors (n, vectors): random with the energy spread over all modes, and (q', q'')."""
    basis = undamped_modes(system)
    noise = np.random.default_rng(seed).standard_normal((2, system.size, RANDOM))
    slowest = np.min(
        basis.omega, where=basis.omega > 0.0, initial=np.max(basis.omega) or 1.0
    )  # also for a rigid motion
    # Displacements over frequencies: elastic and kinetic energy are of one size. The floor bounds nearly rigid modes.
    scale = np.where(basis.omega > 0.0, np.maximum(basis.omega, 1e-8 * basis.omega[-1]), slowest)[:, None]
    # The direction of the motion needs q'' at t = 0, with the forces of the stops.
    force = system.load(0.0) - system.stiffness @ system.q0 - system.damping @ system.v0
    compliant = [contact for contact in system.contacts if not contact.stops.rigid]
    for contact, u in zip(compliant, system.positions(0.0, system.q0), strict=False):
        speed = (
            float(contact.row @ system.v0) + offset_rate(contact.offset, np.zeros(1))[0]
            if contact.stops.dissipative
            else 0.0
        )
        force = force + contact.row * contact.stops.force(u, speed)
    dq = np.column_stack([basis.shapes @ (noise[0] / scale), system.v0])
    dv = np.column_stack([basis.shapes @ noise[1], np.linalg.solve(system.mass, force)])
    return _unit(system, dq, dv)


def _unit(system: System, dq: Array, dv: Array) -> tuple[Array, Array]:
    """Vectors of size 1, without those of none."""
    size = _norm(system, dq, dv)
    moving = size > 0.0
    return dq[:, moving] / size[moving], dv[:, moving] / size[moving]


def _norm(system: System, dq: Array, dv: Array) -> Array:
    """sqrt(dq'^T M dq' + dq^T K dq) of every column."""
    elastic = np.sum(dq * (system.stiffness @ dq), axis=0)  # of a rigid motion rounding, of either sign
    return np.sqrt(np.sum(dv * (system.mass @ dv), axis=0) + np.maximum(elastic, 0.0))
