"""Computer-assisted proof that a periodic orbit exists, by ball arithmetic on its event times.

    F_i(t_1 .. t_k) = h_i(Z(t_i)),   (I - P) z = c: the start of the periodic motion with these event times
    K(X) = m - Y F(m) + (I - Y F'(X)) (X - m)  inside X:   one zero of F in the box X, and no other (Krawczyk)

A zero of F is an orbit of the system where the signs of all gaps between the events are those of its segments: they are
proved too (ball_flow.py). The multipliers are those of the monodromy matrix D in balls, by the discs of Gershgorin
of X^-1 D X with approximate eigenvectors X. A connected union of m discs contains exactly m multipliers. Where I - D is
invertible in balls no multiplier is 1, and the orbit is locally unique among all motions of its period.
Source: Rump, Acta Numerica 19 (2010) 287-449, section 13; Tucker, Validated Numerics (2011).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from flint import acb, acb_mat, arb, arb_mat, ctx

from ..basics.arrays import Array
from ..basics.text import several
from ..basics.validation import InputError
from ..model.time_functions import Drive
from ..piecewise.follow import switched_by_force
from .ball_flow import BallSystem, ExactPeriod, SignProver, Watched, frame_of, identity, trimmed
from .multiprecision.rational import carried

if TYPE_CHECKING:
    from .exact.orbit import Orbit

LEAST_BITS, MOST_BITS = 192, 4096
TRIAL_BITS = 128  # of the evaluation that measures what rounding costs
SIGN_BITS = 128  # of the balls in which signs are proved
WIDER = 8  # times the Newton step: the box
NEWTON = 8  # iterations at one precision
NEAR = 1e-6  # of the motion, by which the orbit that is proved may differ from the float64 one


@dataclass(frozen=True, eq=False)
class OrbitProof:
    """Result of ``Orbit.prove``: enclosures of a periodic orbit, or the condition that could not be proved.

    Proved are: existence of the orbit; that no other motion of this period is near it; the order of its events and the
    signs of all gaps between them, so that these events are all; and that every multiplier lies in its ball. The
    numbers that it is proved of are those of ``method="multiprecision"``: the float64 entries of given matrices, the
    decimals of a beam's problem; and 2 pi ``turns``/w of the drive as period, not the float64 number next to it.

    Parameters
    ----------
    proved : bool
    reason, remedy : str
        The condition that failed, and what to do about it; empty where the proof holds.
    bits : int
        Precision of the last attempt.
    seconds : float
    period_text : str
        The exact period, for example "2 pi/33.0".
    period : flint.arb
        A ball; ``float(x)`` is its centre and ``x.rad()`` its radius.
    event_times : tuple of flint.arb, (k,)
        In (0, period), in order.
    itinerary : tuple of (contact, from side, to side), (k,)
        The events; an impact on a rigid stop leaves the side 0.
    q, v : tuple of flint.arb, (n,)
        State at t = 0.
    multipliers : tuple of flint.acb, (2n,)
        The largest first. Multipliers that are not separated share a ball, which is repeated.
    stable : bool or None
        True: all multipliers lie inside the unit circle. False: at least one lies outside. None: neither is proved.
    distance : float
        Largest difference of the float64 orbit from the ball of the state at t = 0, over the largest q or q'.
    motion : ProvedMotion or None
        The segments, for ``states``.

    Examples
    --------
    >>> import numpy as np, stiffbeam as sb
    >>> load = ([1.0], sb.Harmonic(1.0, 2.0))
    >>> free = sb.System.from_matrices([[1.0]], [[1.0]], [[0.1]], loads=[load], observe=[1.0])
    >>> proof = sb.periodic_orbit(free, np.pi).prove()
    >>> print(proof.q[0].str(15), proof.stable)
    [-0.0221238938053097 +/- 3.58e-17] True
    """

    proved: bool
    reason: str
    remedy: str
    bits: int
    seconds: float
    period_text: str
    period: Any = field(default=None, repr=False)
    event_times: tuple[Any, ...] = field(default=(), repr=False)
    itinerary: tuple[tuple[int, int, int], ...] = field(default=(), repr=False)
    q: tuple[Any, ...] = field(default=(), repr=False)
    v: tuple[Any, ...] = field(default=(), repr=False)
    multipliers: tuple[Any, ...] = field(default=(), repr=False)
    stable: bool | None = None
    distance: float = np.nan
    motion: ProvedMotion | None = field(default=None, repr=False)

    def states(self, count: int) -> tuple[list[tuple[Any, ...]], list[tuple[Any, ...]]]:
        """Balls of q and of q' at the times k period/count, k < count: (count, n) each.

        Raises InputError where nothing is proved, and for a time that is an event.
        """
        if self.motion is None:
            raise InputError("proof", self.reason, "be a proof that holds for enclosures of states", self.remedy)
        with carried(self.bits):
            return self.motion.states(self.period, count)

    @property
    def radius(self) -> float:
        """Largest radius of the event times, NaN without events."""
        return max((float(t.rad()) for t in self.event_times), default=np.nan)

    def __repr__(self) -> str:
        if not self.proved:
            return f"<OrbitProof, not proved with {self.bits} bits: {self.reason}; {self.remedy}>"
        kind = {True: "stable", False: "unstable", None: "stability not proved"}[self.stable]
        events = several(len(self.event_times), "event")
        return (
            f"<OrbitProof: an orbit of period {self.period_text} with {events} exists and is locally unique, {kind},"
            f" largest multiplier {_shown(self.multipliers[0])}; proved with {self.bits} bits,"
            f" {self.distance:.1e} from the float64 orbit>"
        )


@dataclass(frozen=True, eq=False)
class ProvedMotion:
    """States (N, 1) at the starts of all segments, the balls of these times, and the regimes from there on."""

    balls: BallSystem
    starts: list[Any]
    initial_states: list[Any]
    sides: tuple[tuple[int, ...], ...]

    def states(self, period: Any, count: int) -> tuple[list[tuple[Any, ...]], list[tuple[Any, ...]]]:
        """See ``OrbitProof.states``."""
        n, positions, velocities = self.balls.n, [], []
        for k in range(count):
            t = period * k / count
            if any(not (t > start or t < start) for start in self.starts[1:]):
                raise InputError("count", count, "leave the events out", f"the time {k}/{count} of the period is one")
            i = sum(bool(t > start) for start in self.starts[1:])
            Z = (self.balls.closed(self.sides[i]) * (t - self.starts[i])).exp() * self.initial_states[i]
            values = (self.balls.frame * Z).entries()
            positions.append(tuple(values[:n]))
            velocities.append(tuple(values[n : 2 * n]))
        return positions, velocities


class NotProved(Exception):
    """A condition that fails; ``hopeless`` where more bits do not help."""

    def __init__(self, reason: str, remedy: str = "", hopeless: bool = False) -> None:
        super().__init__(reason)
        self.reason, self.remedy, self.hopeless = reason, remedy, hopeless


class Event(NamedTuple):
    """The quantity that is zero, the sides before and after, and whether a rigid contact is hit."""

    quantity: Watched
    old: int
    new: int
    hit: bool


@dataclass(frozen=True, eq=False)
class Itinerary:
    """Events and their float64 times (k,), sides (k + 1, m) of all contacts in the segments.

    resets: whether forces or states may jump.
    """

    events: tuple[Event, ...]
    times: tuple[float, ...]
    sides: tuple[tuple[int, ...], ...]
    resets: bool


@dataclass(frozen=True, eq=False)
class Chain:
    """States (N, 1) before and after events, flows of the segments and maps from the start to behind them (N, N), F and
    its rates (k,); solve: x -> (I - P)^-1 x, (2n, .)."""

    before: list[Any]
    after: list[Any]
    flows: list[Any]
    maps: list[Any]
    F: list[Any]
    rates: list[Any]
    solve: Callable[[Any], Any]


def prove(orbit: Orbit, bits: int | None = None) -> OrbitProof:
    """See ``Orbit.prove``."""
    begun = time.perf_counter()
    if bits is not None and not (isinstance(bits, (int, np.integer)) and 64 <= bits <= 16 * MOST_BITS):
        raise InputError("bits", bits, f"be a whole number from 64 to {16 * MOST_BITS}", "leave it out")
    exact = ExactPeriod(orbit.system, orbit.period)
    used, frame = int(bits or LEAST_BITS), frame_of(orbit.system, orbit.period)
    try:
        plan = itinerary_of(orbit)
        if bits is None:
            used = _enough_bits(orbit, plan, exact, frame)
        # Twice the bits after each failure, until the proof holds or more bits cannot help.
        while True:
            try:
                with carried(used):
                    enclosures = _attempt(orbit, plan, exact, frame)
                return OrbitProof(True, "", "", used, time.perf_counter() - begun, exact.text, **enclosures)
            except (NotProved, ArithmeticError, ValueError) as error:  # balls too wide to divide by, or to convert
                if not isinstance(error, NotProved):
                    error = NotProved(f"the balls grow too wide: {error}")
                if error.hopeless or bits is not None or 2 * used > MOST_BITS:
                    raise error from None
                used *= 2
    except NotProved as condition:
        failure = condition
    remedy = failure.remedy or (f"give more bits than {used}" if bits is not None else "change a parameter or a phase")
    return OrbitProof(False, failure.reason, remedy, used, time.perf_counter() - begun, exact.text)


def itinerary_of(orbit: Orbit) -> Itinerary:
    """The events of a float64 orbit."""
    path, contacts = orbit.path, orbit.system.contacts
    sides = [tuple(int(side) for side in line) for line in path.sides]
    if path.rigid and any(any(line) for line in sides):
        raise NotProved("a rigid contact is held over part of the period", "take restitution > 0", hopeless=True)
    events, starts = [], []
    for i in range(1, len(path.times)):
        if path.rigid and i not in path.hits:  # the search began anew there
            continue
        at = f"at t = {path.times[i]:.6g}"
        changed = list(path.hits.get(i, ())) if path.rigid else np.flatnonzero(path.sides[i] != path.sides[i - 1])
        if len(changed) != 1:
            raise NotProved(f"{len(changed)} contacts change {at}", "move a stop a little", hopeless=True)
        c = int(changed[0])
        old, new = sides[i - 1][c], sides[i][c]
        if path.rigid:
            # An impact leaves no side in the path: the nearer stop is the one that is hit.
            stops, u = contacts[c].stops, float(contacts[c].row @ path.q[i])
            u += float(Drive.of(orbit.system).offset(orbit.system, c)(path.times[i : i + 1])[0][0])
            stop = 1 if abs(u - stops.upper_bound) < abs(u - stops.lower_bound) else -1
            if not (stops.restitution or 0.0) > 0.0:
                raise NotProved(f"contact {c} has restitution 0", "take restitution > 0", hopeless=True)
            events.append(Event(Watched(c, stop, False, 1), 0, 0, True))
        else:
            stop = int(np.sign(new or old))
            events.append(Event(Watched(c, stop, switched_by_force(old, new), 1), old, new, False))
        starts.append(i)
    if sides[0] != sides[-1]:
        raise NotProved("the contacts are on other sides after the period", hopeless=True)
    times = tuple(float(path.times[i]) for i in starts)
    resets = any(contact.stops.rigid or contact.stops.damping for contact in contacts)
    return Itinerary(tuple(events), times, tuple(sides[i] for i in [0, *starts]), resets)


def _enough_bits(orbit: Orbit, plan: Itinerary, exact: ExactPeriod, frame: Array) -> int:
    """Bits that a proof needs: what products of balls lose, for F, and as much again for F' over the box."""
    lost = np.inf
    with carried(TRIAL_BITS), suppress(NotProved, ArithmeticError, ValueError):
        balls, times = BallSystem(orbit.system, frame), [arb(t) for t in plan.times]
        chain = linked(balls, plan, _flows(balls, plan, times, exact.ball))
        radii = [float((f.rad() / abs(rate)).upper()) for f, rate in zip(chain.F, chain.rates, strict=True)]
        lost = TRIAL_BITS + np.log2(max([*radii, 1e-300]) / orbit.period)
    enough = 2.4 * max(lost, 0.0) + 96.0 if np.isfinite(lost) else 4.0 * LEAST_BITS
    return int(min(max(LEAST_BITS, 64 * np.ceil(enough / 64.0)), MOST_BITS))


def _attempt(orbit: Orbit, plan: Itinerary, exact: ExactPeriod, frame: Array) -> dict[str, Any]:
    """Enclosures of a proved orbit at the current precision. Raises NotProved."""
    full, k = ctx.prec, len(plan.events)
    balls, period = BallSystem(orbit.system, frame), exact.ball
    # Approximate event times, then F there in balls.
    middle = _refined(plan, balls, period)
    chain = linked(balls, plan, _flows(balls, plan, middle, period))
    times = list(middle)
    if k:
        # F'(X) over a box of the size that Newton's step needs
        inverse = _float_inverse(chain, plan, balls)
        step = (inverse * arb_mat([[f] for f in chain.F])).entries()
        # The box has room for Newton's step, and is never thinner than the precision.
        radius = (WIDER * max(abs(x).upper() for x in step) + period.upper() * arb(2) ** -full).mid()
        if not radius < period / 1000:
            raise NotProved("Newton's step on the event times is not small")
        chain = linked(balls, plan, _widened(balls, plan, chain.flows, radius))
        rest = identity(k) - inverse * slopes_of(balls, plan, chain)
        for i, line in enumerate(rest.tolist()):
            # Krawczyk's test in each component: the image of the box lies inside it.
            reach = sum((abs(x).upper() for x in line), arb(0)) * radius
            if not abs(step[i]).upper() + reach < radius:
                raise NotProved("Krawczyk's operator does not map the box of event times into itself")
            # The image contains the zero as well, and is smaller than the box.
            times[i] = (middle[i] - step[i]) + arb(0, reach.upper())
    # All events are in order, and none is at an end of the period.
    edges = [arb(0), *times, period]
    for i in range(k + 1):
        if not edges[i + 1] > edges[i]:
            remedy = "shift the phase of the loads" if i in (0, k) else ""
            raise NotProved(f"events {i} and {i + 1} of {k} are not apart", remedy)
    # The proved orbit must be the float64 one, not another with the same events.
    distance = _distance(orbit, balls, chain)
    if not distance < NEAR:
        reason = f"the orbit with this itinerary is another one, {distance:.1e} away"
        raise NotProved(reason, "polish the orbit with periodic_orbit", hopeless=True)
    _prove_signs(orbit, plan, exact, frame, chain, times)
    D = monodromy_of(balls, plan, chain)
    # I - D invertible in balls: no multiplier is 1, and the orbit is locally unique.
    try:
        (identity(2 * balls.n) - D).inv()
    except ZeroDivisionError:
        raise NotProved("a multiplier may be 1, so the orbit may not be alone") from None
    multipliers = spectrum(D)
    # Stable or not only if the balls decide it.
    inside = [bool(abs(x).upper() < 1) for x in multipliers]
    outside = any(abs(x).lower() > 1 for x in multipliers)
    start = (balls.frame * chain.after[0]).entries()
    return {
        "period": period,
        "event_times": tuple(times),
        "itinerary": tuple((event.quantity.contact, event.old, event.new) for event in plan.events),
        "q": tuple(start[: balls.n]),
        "v": tuple(start[balls.n : 2 * balls.n]),
        "multipliers": tuple(multipliers),
        "stable": True if all(inside) else False if outside else None,
        "distance": distance,
        "motion": ProvedMotion(balls, [arb(0), *times], chain.after, plan.sides),
    }


def _refined(plan: Itinerary, balls: BallSystem, period: Any) -> list[Any]:
    """Event times by Newton's method, as far as this precision goes; exact numbers, without proof."""
    times = [arb(t) for t in plan.times]
    if not times:
        return times
    before, size = period, period
    for _ in range(NEWTON):
        chain = linked(balls, plan, _flows(balls, plan, times, period), approximate=True)
        try:
            # Forces or states that jump couple the events; else F' is diagonal where F vanishes.
            if plan.resets:
                slopes, F = slopes_of(balls, plan, chain).mid(), arb_mat([[f.mid()] for f in chain.F])
                step = slopes.solve(F, algorithm="approx").mid().entries()
            else:  # the others vanish with F
                step = [(f / rate.mid()).mid() for f, rate in zip(chain.F, chain.rates, strict=True)]
        except ZeroDivisionError:
            raise NotProved("an event time has no derivative: a contact grazes its stop") from None
        times = [(t - x).mid() for t, x in zip(times, step, strict=True)]
        edges = [arb(0), *times, period]
        if not all(edges[i + 1] > edges[i] for i in range(len(edges) - 1)):
            raise NotProved("Newton's method brings events out of order", hopeless=True)
        before, size = size, max(abs(x).mid() for x in step)
        # Newton's method squares its error: after a step of half the digits all are right. Slower steps are rounding.
        if not size < before / 2 or size < period * arb(2) ** (-ctx.prec // 2):
            break
    return times


def _flows(balls: BallSystem, plan: Itinerary, times: Sequence[Any], period: Any) -> list[Any]:
    """Flows (N, N) of the segments."""
    edges = [arb(0), *times, period]
    return [(balls.closed(sides) * (edges[i + 1] - edges[i])).exp() for i, sides in enumerate(plan.sides)]


def _widened(balls: BallSystem, plan: Itinerary, flows: Sequence[Any], radius: Any) -> list[Any]:
    """The flows where both ends of each segment may move by ``radius``."""
    spread = arb(0, 2 * radius)
    return [flow * (balls.closed(sides) * spread).exp() for flow, sides in zip(flows, plan.sides, strict=True)]


def linked(balls: BallSystem, plan: Itinerary, flows: list[Any], approximate: bool = False) -> Chain:
    """The periodic motion with given flows of its segments. ``approximate``: centres of balls, without proof."""
    n2, k = 2 * balls.n, len(plan.events)
    impacts = [balls.impact(event.quantity.contact) if event.hit else None for event in plan.events]
    steps = [flow if J is None else J * flow for flow, J in zip(flows, [*impacts, None], strict=True)]
    maps = prefixes(steps)
    # Only (q, q') is unknown: the functions of time at t = 0 are known.
    rest, clock = maps[-1].tolist()[:n2], arb_mat([[x] for x in balls.clock])
    system = identity(n2) - arb_mat([line[:n2] for line in rest])

    def solve(right: Any) -> Any:
        try:
            if approximate:
                return system.mid().solve(right.mid(), algorithm="approx").mid()
            return system.solve(right)
        except ZeroDivisionError:
            raise NotProved("a multiplier of the chain of segments may be 1") from None

    # The periodic motion: (I - P) z = c.
    start = arb_mat(solve(arb_mat([line[n2:] for line in rest]) * clock).tolist() + clock.tolist())
    after = [start, *(Q * start for Q in maps[:-1])]
    before = [flow * Z for flow, Z in zip(flows[:-1], after, strict=False)]
    forms = [balls.form(*event.quantity.form) for event in plan.events]
    F = [(form * Z)[0, 0] for form, Z in zip(forms, before, strict=True)]
    rates = [(forms[j] * (balls.closed(plan.sides[j]) * before[j]))[0, 0] for j in range(k)]
    return Chain(before, after, flows, maps, F, rates, solve)


def prefixes(steps: list[Any]) -> list[Any]:
    """Products steps[i] ... steps[1] steps[0], by halves.

    Each is a product of few long ones, so that radii do not grow by the size of every single step.
    """
    if len(steps) == 1:
        return list(steps)
    half = len(steps) // 2
    first, second = prefixes(steps[:half]), prefixes(steps[half:])
    return [*first, *(Q * first[-1] for Q in second)]


def slopes_of(balls: BallSystem, plan: Itinerary, chain: Chain) -> Any:
    """F' (k, k): an event that is later adds what the rate of the state jumps by there."""
    n2, k = 2 * balls.n, len(plan.events)
    tops = [_top(flow, n2) for flow in chain.flows]
    # Forward: each event moves the states after it by the jump of the rate there.
    moved, ahead = arb_mat(n2, k), []
    for i, event in enumerate(plan.events):
        moved = tops[i] * moved
        ahead.append(moved)
        rate = balls.closed(plan.sides[i]) * chain.before[i]
        if event.hit:
            J = balls.impact(event.quantity.contact)
            moved, rate = _top(J, n2) * moved, J * rate
        jump = (rate - balls.closed(plan.sides[i + 1]) * chain.after[i + 1]).entries()
        columns = moved.tolist()
        for a in range(n2):
            columns[a][i] += jump[a]
        moved = arb_mat(columns)
    # Then the start follows, since the motion stays periodic, and moves every event once more.
    start, lines = chain.solve(tops[k] * moved), []
    for i, event in enumerate(plan.events):
        head = arb_mat([balls.form(*event.quantity.form).entries()[:n2]])
        back = tops[i] * (_top(chain.maps[i - 1], n2) * start if i else start)
        lines.append((head * (back + ahead[i])).entries())
        lines[i][i] += chain.rates[i]
    return arb_mat(lines)


def monodromy_of(balls: BallSystem, plan: Itinerary, chain: Chain) -> Any:
    """D (2n, 2n): flows, and where rates jump the saltation J + (f_after - J f_before) h/(h f_before)."""
    n2 = 2 * balls.n
    steps = [_top(chain.flows[0], n2)]
    for j, event in enumerate(plan.events):
        # The rate jumps at impacts and at the entry into a damped stop; elsewhere the saltation is the identity.
        damped = not event.hit and event.old == 0 and balls.system.contacts[event.quantity.contact].stops.damping > 0
        if event.hit or damped:
            form = balls.form(*event.quantity.form)
            J = balls.impact(event.quantity.contact) if event.hit else balls.identity
            rate = balls.closed(plan.sides[j]) * chain.before[j]
            jump = balls.closed(plan.sides[j + 1]) * chain.after[j + 1] - J * rate
            steps.append(_top(J + jump * form * (1 / (form * rate)[0, 0]), n2))
        steps.append(_top(chain.flows[j + 1], n2))
    return prefixes(steps)[-1]


def _prove_signs(
    orbit: Orbit, plan: Itinerary, exact: ExactPeriod, frame: Array, chain: Chain, times: Sequence[Any]
) -> None:
    """Raise NotProved where a gap between two events may have another sign than its segment."""
    # Signs need fewer bits: balls rounded to them still contain the states.
    with carried(SIGN_BITS):
        balls, period = BallSystem(orbit.system, frame), exact.ball
        prover, edges = SignProver(balls), [arb(0), *times, period]
        last = trimmed(chain.flows[-1] * chain.after[-1])
        for i, sides in enumerate(plan.sides):
            start, end = trimmed(chain.after[i]), last if i == len(plan.events) else trimmed(chain.before[i])
            zeros = (
                plan.events[i - 1].quantity.form if i else None,
                plan.events[i].quantity.form if i < len(plan.events) else None,
            )
            for quantity, place, sign in prover.segment(
                sides, start, end, edges[i + 1] - edges[i], zeros, balls.watched(sides)
            ):
                at = f"contact {quantity.contact} at t = {float(edges[i] + place):.8g}"
                # A negative sign disproves the itinerary; an open one may be decided with more bits.
                if sign is False:
                    raise NotProved(f"{at} is on another side than its segment", "polish the orbit", hopeless=True)
                raise NotProved(f"{at} grazes its stop, or comes too close to tell")


def _distance(orbit: Orbit, balls: BallSystem, chain: Chain) -> float:
    """Largest difference of the float64 start, relative to the largest q or q' of the orbit."""
    n, states = balls.n, [(balls.frame * Z).entries() for Z in chain.after]
    worst = 0.0
    for part, start in ((slice(0, n), orbit.q), (slice(n, 2 * n), orbit.v)):
        size = max(max((abs(float(x)) for x in Z[part]), default=0.0) for Z in states)
        away = max(float(abs(x - arb(float(y))).upper()) for x, y in zip(states[0][part], start, strict=True))
        worst = max(worst, away / max(size, 1e-300))
    return worst


def spectrum(D: Any) -> list[Any]:
    """Balls of all eigenvalues of a real matrix of balls, (size,), the largest first. Raises NotProved."""
    size = D.nrows()
    try:
        # Approximate eigenvectors suffice: X^-1 D X has the eigenvalues of D for every invertible X.
        _, vectors = acb_mat(D.mid()).eig(right=True, algorithm="approx")
        B = (vectors.inv() * acb_mat(D) * vectors).tolist()
    except (ValueError, ZeroDivisionError):
        raise NotProved("the multipliers cannot be separated") from None
    centres, radii = [], []
    # Gershgorin's disc of every row.
    for i, line in enumerate(B):
        centre = line[i].mid()
        radius = sum((abs(x - centre if i == j else x).upper() for j, x in enumerate(line)), arb(0)).upper()
        if abs(centre.imag) <= radius:  # a disc that is its own mirror image
            radius, centre = (radius + abs(centre.imag)).upper(), acb(centre.real)
        centres.append(centre)
        radii.append(radius)
    # Discs that may overlap form a group: a connected union of m discs contains m multipliers.
    groups = [{i} for i in range(size)]
    for i in range(size):
        for j in range(i):
            if not abs(centres[i] - centres[j]) > radii[i] + radii[j] and groups[i] is not groups[j]:
                groups[i] |= groups[j]
                for member in groups[i]:
                    groups[member] = groups[i]
    enclosures = []
    for i in range(size):
        # A member of a group has the hull of its discs.
        real, imag = arb(centres[i].real, radii[i]), arb(centres[i].imag, radii[i])
        if len(groups[i]) == 1:  # its mirror image is a multiplier too: one alone in a disc of its own is real
            imag = arb(0) if centres[i].imag == 0 else imag
        for member in groups[i]:
            real = real.union(arb(centres[member].real, radii[member]))
            imag = imag.union(arb(centres[member].imag, radii[member])) if len(groups[i]) > 1 else imag
        enclosures.append(acb(real, imag))
    # of a conjugate pair, equal but for rounding, the one with positive imaginary part first
    return sorted(enclosures, key=lambda x: (-float(f"{float(abs(x.mid())):.12e}"), -float(x.imag)))


def _top(matrix: Any, size: int) -> Any:
    """The first rows and columns."""
    return arb_mat([line[:size] for line in matrix.tolist()[:size]])


def _float_inverse(chain: Chain, plan: Itinerary, balls: BallSystem) -> Any:
    """Y (k, k), an approximate inverse of F', of exact numbers."""
    if plan.resets:
        matrix = np.array([[float(x) for x in line] for line in slopes_of(balls, plan, chain).tolist()])
    else:
        matrix = np.diag([float(rate) for rate in chain.rates])
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        inverse = np.full_like(matrix, np.nan)
    if not np.all(np.isfinite(inverse)):
        raise NotProved("the event times have no regular equations: a contact grazes its stop")
    return arb_mat([[arb(x) for x in line] for line in inverse.tolist()])


def _shown(value: Any) -> str:
    """A ball of a multiplier as text."""
    real, imag = float(value.real), float(value.imag)
    return f"{real:.8g}" if imag == 0.0 else f"{real:.8g}{imag:+.8g}j"
