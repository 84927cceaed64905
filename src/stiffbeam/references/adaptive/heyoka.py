"""Taylor series of some twenty terms, compiled by heyoka, whose events miss no crossing of a gap."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import stopped_clock
from ...basics.validation import InputError
from ...model.contact_law import Law, damps, depth_holding, jumps, law_of, pressure
from ...model.right_hand_side import RightHandSide
from ...model.time_functions import require_closed_form
from ...trajectory.trajectory import Reference, SolverFailure
from ..registry import KEEP, RESTART, Request
from .adaptive import Solver, reference_from
from .restarts import Outcome, Phase, Root, refuse_endless

LARGEST = 16  # numerator and denominator of an exponent: the equations contain powers as high as that
SHARE = 0.01  # of rtol: the absolute tolerance of an unknown in units of its scale
FINEST = float(np.finfo(float).eps)  # tolerance of a series, which sets its order: 20 terms
# heyoka 7.13 loses the second root of a gap that is exactly 0 at the start of a step, so that no gap is: each lies this
# much, in units of the motion, before its event.
NOT_ZERO = 1e-20
LOST = 1e-8  # of the motion: two events that far apart do not come together by rounding
MOST_EVENTS = 2**16  # beyond it the code of a step is no event's
MOST_PROGRAMS = 64  # kept in a process
_PROGRAMS: dict[tuple[int, Shape], Program] = {}


def solve(request: Request) -> Reference:
    """Solve by Taylor series of order 10 to 20, with events found on the series themselves.

    heyoka compiles the series of the motion and of every gap by LLVM. In every step it isolates the roots of a gap's
    polynomial, so that no pair of crossings is missed, however close. A phase between two events has one smooth
    right-hand side; outputs come from the series, as accurate as the steps. It shares no code with SUNDIALS, SciPy,
    diffrax or the exact solution. Every number of the system is a parameter of the compiled program, so that systems of
    one shape share it (its time is ``provenance["compile_seconds"]``).

    A force kappa d^(a/b) is no power series in time at the entry, where d = 0. With w = (d/L)^(1/b) and the
    independent variable s, dt/ds = w^(b-1), it is a polynomial:

        dw/ds = d'/(b L),   dy/ds = w^(b-1) y',   f = kappa L^(a/b) w^a

    Limitations: exponents are ratios of whole numbers up to LARGEST; two stops with fractional exponents must not close
    at the same time; ``max_step`` bounds s instead of t in such a contact, where t grows no faster than s.
    """
    import heyoka  # pyright: ignore[reportMissingImports]

    assert heyoka.taylor_adaptive  # a missing library is named before anything is computed
    system, switches = request.system, request.steps.switches
    if switches == KEEP:
        raise InputError("switches", switches, f"be {RESTART!r} for heyoka", "use the adaptive solver cvode")
    require_closed_form(system.time_functions, "heyoka")
    for contact in system.contacts:
        stops = contact.stops
        if exponent_of(stops.coefficients.p) is None:
            rule = f"be a ratio of whole numbers up to {LARGEST} for heyoka, such as 3/2"
            raise InputError("stops.exponent", stops.exponent, rule, "use the adaptive solver cvode-adams")
        if stops.jumps and fractional(stops.coefficients):
            rule = f"be 0 beside the exponent {float(stops.exponent):g} for heyoka"
            raise InputError("stops.damping", stops.damping, rule, "use dissipation, or the adaptive solver cvode")
        # The series spells the law out: another term of ``contact_law`` would be missing in it.
        law = stops.coefficients
        spelled = law.kappa * (1.0 + 0.5 * law.lam) + 0.5 * law.c
        if not math.isclose(pressure(1.0, 0.5, law), spelled, rel_tol=1e-12):
            raise InputError("stops", stops, "have a law that heyoka spells out", "use the adaptive solver cvode")
    return reference_from(request, _solver, RESTART)


def exponent_of(p: float) -> Fraction | None:
    """The exponent as a ratio of whole numbers up to LARGEST, None where it is no such ratio."""
    ratio = Fraction(p).limit_denominator(LARGEST)
    return ratio if float(ratio) == p and ratio.numerator <= LARGEST else None


def fractional(law: Law) -> bool:
    """Return True where the force is no power series in time at d = 0."""
    return law.p != int(law.p)


class Numbers(NamedTuple):
    """Arrays of numbers of the equations for the scaled unknowns x = z/scales; a program has a symbol for each."""

    matrix: Array  # (size, n)
    loads: Array  # (d + R, size)
    damping: Array  # (n, n), of the viscous power
    power: Array  # (d + R, n), of the input
    pushes: Array  # (m, size), with the impulses
    position_rows: Array  # (m, n)
    velocity_rows: Array  # (m, n)
    acceleration_rows: Array  # (m, n), of the unknowns' rates, where a stop damps
    offsets: Array  # (d + R, m)
    frequencies: Array
    law: Array  # (m, 6)
    lengths: Array  # (m,), L
    energies: Array  # (2,), 1/scale of input and of what the stops absorb
    pressing: Array  # (sides,), 1 in contact, else 0
    clock: Array  # (2,), start of the phase, and unit of the time in it
    edge: Array  # (1,), origin of the records
    records: Array  # (R, P), their polynomials


OF_PHASE = ("pressing", "clock", "edge", "records")  # differ from phase to phase
DENSE = ("frequencies", "law", "lengths", "energies", *OF_PHASE)  # have a symbol for a zero too


class Shape(NamedTuple):
    """Constants of a compiled program.

    places: shape of every array of ``Numbers``, and where it has symbols. sides: (contact, +1 upper or -1 lower) of
    every gap. exponents, damps, jumps: of the contacts' laws. pressed: sides in contact with a fractional exponent.
    tolerance: of a series.
    """

    places: tuple[tuple[tuple[int, ...], bytes], ...]
    sides: tuple[tuple[int, int], ...]
    exponents: tuple[Fraction, ...]
    damps: tuple[bool, ...]
    jumps: tuple[bool, ...]
    pressed: tuple[int, ...]
    tolerance: float


class Peaks:
    """Callback of a side's rate: the value of the independent variable and the state at every zero of it."""

    def __init__(self) -> None:
        self.zeros: list[tuple[float, Array]] = []

    def __deepcopy__(self, memo: Any) -> Peaks:
        return self  # heyoka copies its callbacks

    def __call__(self, integrator: Any, s: float, direction: int) -> None:
        """Record a zero."""
        self.zeros.append((s, np.array(integrator.update_d_output(s))))


class Program(NamedTuple):
    """A compiled integrator, the peaks of its sides, the sides of its events after those of the gaps, and the sides
    of its w."""

    integrator: Any
    peaks: list[Peaks]
    releasing: list[int]
    pressed: tuple[int, ...]


def _solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
    scales = 2.0 ** np.round(np.log2(atol / (SHARE * rtol)))  # powers of two: no number is rounded
    laws = [law_of(rhs.equations.law, c) for c in range(len(rhs.equations.law))]
    numbers = _numbers(rhs, scales)
    # A number that is zero gets no symbol, except in DENSE: the compiled program stays short.
    kept = [np.ones(x.shape, bool) if f in DENSE else x != 0.0 for f, x in zip(Numbers._fields, numbers, strict=True)]
    shape = Shape(
        tuple((x.shape, mask.tobytes()) for x, mask in zip(numbers, kept, strict=True)), tuple(rhs.sides),
        tuple(exponent_of(law.p) or Fraction(1) for law in laws), tuple(bool(damps(law)) for law in laws),
        tuple(bool(jumps(law)) for law in laws), (), max(SHARE * rtol, FINEST),
    )  # fmt: skip

    def run(phase: Phase) -> Outcome:
        # A side beyond its event at the start switches before any step.
        ended_by = _overdue(rhs, laws, phase)
        if ended_by:
            return Outcome(phase.start, phase.z, [], ended_by, False, {})
        closed = phase.watch.closed
        # Only a fractional force in contact needs w: without contact it is zero.
        pressed = tuple(k for k in np.flatnonzero(closed).tolist() if fractional(laws[rhs.sides[k][0]]))
        program = _program(shape._replace(pressed=pressed), rhs)
        now = _of_phase(rhs, numbers, phase)
        values = np.concatenate([x[mask] for x, mask in zip(now, kept, strict=True)])
        program.integrator.pars[:] = values[: len(program.integrator.pars)]  # heyoka leaves out the last if unused
        roots = [_depth_root(rhs, phase, k, shape.exponents) for k in pressed]
        outcome = _march(program, rhs, scales, phase, roots, float(now.clock[1]))
        _require_no_lost_event(rhs, laws, phase, outcome)
        return outcome

    return run


def _numbers(rhs: RightHandSide, scales: Array) -> Numbers:
    """The numbers of the equations; those of a phase are still to be set."""
    e, n, y = rhs.equations, rhs.states, rhs.first_order
    m, x = len(e.law), scales[:n]
    damping = y.to_v.T @ y.system.damping @ y.to_v if y.system.damped else np.zeros((n, n))
    # In the scaled unknowns a column has the factor of its unknown, a row is divided by that of its rate.
    matrix, loads, pushes = np.zeros((rhs.size, n)), np.zeros((len(e.loads), rhs.size)), np.zeros((m, rhs.size))
    matrix[:n] = y.matrix * x / x[:, None]
    loads[:, :n], pushes[:, :n] = e.loads / x, e.pushes / x
    pushes[:, n + 2 : n + 2 + m] = -np.diag(1.0 / scales[n + 2 : n + 2 + m])
    acceleration_rows = e.acceleration_rows * x if rhs.damped else np.zeros((m, n))
    count = len(e.loads) - 1 - 2 * len(e.frequencies)
    return Numbers(
        matrix, loads, damping * np.outer(x, x) / scales[n + 1], e.power * x / scales[n], pushes, e.position_rows * x,
        e.velocity_rows * x, acceleration_rows, e.offsets, e.frequencies, e.law, np.ones(m),
        1.0 / scales[[n, -1]], np.zeros(len(rhs.sides)), np.zeros(2), np.zeros(1),
        np.zeros((count, e.records.shape[1] // count if count else 0)),
    )  # fmt: skip


def _of_phase(rhs: RightHandSide, numbers: Numbers, phase: Phase) -> Numbers:
    """The numbers with those of a phase."""
    edges, records, edge = rhs.equations.edges, numbers.records, 0.0
    # By the middle of the phase: its ends may be samples, where two polynomials meet.
    if records.size:
        k = int(np.searchsorted(edges, 0.5 * (phase.start + phase.end), side="right")) - 1
        k = min(max(k, 0), len(edges) - 2)
        edge, records = edges[k], rhs.equations.records[k].reshape(records.shape)
    # The unit of time is a power of two, as the scales are: no number is rounded by it.
    clock = np.array([phase.start, 2.0 ** np.ceil(np.log2(phase.end))])
    return numbers._replace(
        lengths=rhs.lengths, pressing=np.array(phase.watch.closed, float), clock=clock, edge=np.array([edge]),
        records=records,
    )  # fmt: skip


def _depth(rhs: RightHandSide, k: int, t: float, z: Array) -> tuple[float, float]:
    """Depth of side k and its rate."""
    c, side = rhs.sides[k]
    contact = rhs.first_order.contacts[c]
    u, v = rhs.first_order.contact_motion(contact, float(np.clip(t, *rhs.window)), z[: rhs.states])
    return side * (u - contact.contact.stops.bound(side)), side * v


def _depth_root(rhs: RightHandSide, phase: Phase, k: int, exponents: Sequence[Fraction]) -> float:
    """w of a side at the start of a phase. Raises SolverFailure where the motion cannot go on from w = 0."""
    c, _ = rhs.sides[k]
    depth, speed = _depth(rhs, k, phase.start, phase.z)
    if depth <= 0.0 and speed <= 0.0:
        reason = f"the motion starts at rest on a stop with exponent {float(exponents[c]):g}"
        raise SolverFailure("heyoka", phase.start, reason, "use the adaptive solver cvode-adams")
    return float((max(depth, 0.0) / rhs.lengths[c]) ** (1.0 / exponents[c].denominator))


def _first_step(rhs: RightHandSide, phase: Phase, pressed: Sequence[int], roots: Sequence[float]) -> float:
    """Bound of the first step from w = 0, where the last coefficients of a series may be zero by symmetry and set none.

    A sixteenth of the s in which the stop would halt its contact point, if nothing else pushed that.
    """
    for k, w in zip(pressed, roots, strict=True):
        if w == 0.0:
            c, _ = rhs.sides[k]
            law, L, speed = law_of(rhs.equations.law, c), rhs.lengths[c], _depth(rhs, k, phase.start, phase.z)[1]
            # Depth at which the elastic force has taken the kinetic energy of the mass 1/mobility.
            mobility = float(rhs.equations.velocity_rows[c] @ rhs.equations.pushes[c])
            depth = depth_holding(0.5 * speed**2 / mobility / (1.0 + law.lam * speed), law)
            b = Fraction(law.p).limit_denominator(LARGEST).denominator
            # At constant speed dw/ds = speed/(b L).
            return float((depth / L) ** (1.0 / b) * b * L / speed / 16.0)
    return math.inf


def _overdue(rhs: RightHandSide, laws: Sequence[Law], phase: Phase) -> list[Root]:
    """Sides beyond their event at the start of a phase: they switch together with the one that ended the last phase."""
    watch, roots = phase.watch, []
    for k, closed in enumerate(watch.closed):
        law = laws[rhs.sides[k][0]]
        depth, speed = _depth(rhs, k, phase.start, phase.z)
        force = float(pressure(max(depth, 0.0), speed, law))
        if closed:
            open_again = depth <= 0.0 and speed <= 0.0 and (depth < 0.0 or speed < 0.0)
            # A damped stop lets go while still inside. Its force is negative here, and falls at a release.
            if damps(law) and depth > 0.0 and force < 0.0:  # going on, not coming back
                row = watch.size - watch.count + k
                open_again = watch.values(phase.start, phase.z)[row] + rhs.levels[row] <= 0.0
            if open_again:
                roots.append(Root(k, -1, phase.start, phase.z))
        elif (depth > 0.0 and speed >= 0.0 and force > 0.0) or (depth == 0.0 and speed > 0.0):
            roots.append(Root(k, 1, phase.start, phase.z))
    return roots


def _require_no_lost_event(rhs: RightHandSide, laws: Sequence[Law], phase: Phase, outcome: Outcome) -> None:
    """Raise SolverFailure where a side is beyond its event at the end of a phase: heyoka gives up roots of a polynomial
    that it cannot separate, with no more than a line of its log."""
    for k, closed in enumerate(phase.watch.closed):
        depth, speed = _depth(rhs, k, outcome.t, outcome.z)
        law, beyond = laws[rhs.sides[k][0]], LOST * rhs.lengths[rhs.sides[k][0]]
        if (closed and depth < -beyond) or (not closed and depth > beyond and pressure(depth - beyond, speed, law) > 0):
            reason = "heyoka lost the zero of a gap"
            raise SolverFailure("heyoka", outcome.t, reason, "use another rtol or the adaptive solver cvode-adams")


def _march(
    program: Program, rhs: RightHandSide, scales: Array, phase: Phase, roots: Sequence[float], unit: float
) -> Outcome:
    """Make steps to the end of a phase or to an event. roots: w of the sides whose force is a fractional power."""
    integrator, size, watch, in_contact = program.integrator, len(scales), phase.watch, bool(roots)
    if sum(w == 0.0 for w in roots) > 1:
        reason = "two stops with fractional exponents close at the same time"
        raise SolverFailure("heyoka", phase.start, reason, "use the adaptive solver cvode-adams")
    bound = _first_step(rhs, phase, program.pressed, roots)
    # Start values. In a contact with a fractional power the time since the start and w are unknowns too.
    integrator.time = 0.0 if in_contact else phase.start
    integrator.state[:] = [*(phase.z / scales), *([0.0, *roots] if in_contact else [])]
    # heyoka ignores an event for a while after it. In a new phase the same event may have another meaning.
    if integrator.with_events:
        integrator.reset_cooldowns()
    for peaks in program.peaks:
        peaks.zeros.clear()

    def time_at(s: float, x: Array) -> float:
        return phase.start + unit * float(x[size]) if in_contact else s

    def at(t: float, first: float) -> Array:
        """The unknowns at t in the last step, which starts at ``first``."""
        s = t
        if in_contact:
            from scipy.optimize import brentq

            def late(s: float) -> float:
                return phase.start + unit * float(integrator.update_d_output(s)[size]) - t

            last = float(integrator.time)
            s = first if late(first) >= 0.0 else last if late(last) <= 0.0 else brentq(late, first, last, xtol=1e-300)
        return scales * integrator.update_d_output(s)[:size]

    # Step by step, to an event or to the end of the phase.
    now, z, states, steps, ended_by = phase.start, phase.z, [], 0, []
    while now < phase.end and not ended_by:
        left = phase.end - now
        longest = min(phase.max_step, math.inf if in_contact else left, bound if steps == 0 else math.inf)
        first = float(integrator.time)
        # An event i that stops the integrator has the outcome -i - 1.
        outcome, length = integrator.step(max_delta_t=longest, write_tc=True)
        steps += 1
        new, event = time_at(float(integrator.time), integrator.state), -int(outcome) - 1
        if not np.all(np.isfinite(integrator.state)) or (length == 0.0 and not 0 <= event < MOST_EVENTS):
            reason = "the series has no radius of convergence"
            raise SolverFailure("heyoka", now, reason, "use the adaptive solver cvode-adams")
        # The s at the end is not known before: a step goes beyond it, and its series is evaluated at the end.
        if in_contact and new >= phase.end:
            new, event, z = phase.end, -1, at(phase.end, first)
        else:
            z = scales * integrator.state[:size]
            if length == left and not in_contact and not 0 <= event < MOST_EVENTS:
                new = phase.end  # not its neighbour in float64
        refuse_endless("heyoka", new, steps * int(integrator.order), phase.forecast)
        due = phase.times[len(states) :]
        states += [at(t, first) for t in due[due <= new].tolist()]
        if 0 <= event < MOST_EVENTS:
            k = event if event < watch.count else program.releasing[event - watch.count]
            # A force that would press outside the stop closes nothing.
            if watch.closed[k] or event < watch.count or _depth(rhs, k, new, z)[0] > 0.0:
                ended_by = [Root(k, -1 if watch.closed[k] else 1, new, z)]
        now = new
    for k, peaks in enumerate(program.peaks):
        # A peak after the end of the phase lies in the part of the step that is dropped.
        times = [(time_at(s, x), scales * x[:size]) for s, x in peaks.zeros] if watch.closed[k] else []
        watch.peaks += [Root(watch.size - watch.count + k, -1, t, x) for t, x in times if t <= now]
    # A term of the series takes about an evaluation of the right-hand side.
    return Outcome(now, z, states, ended_by, False, {"steps": steps, "terms": steps * int(integrator.order)})


def _program(shape: Shape, rhs: RightHandSide) -> Program:
    """The program of a shape in this thread, compiled if it is the first such."""
    # A solve writes to its integrator: two threads must not share one.
    key = (threading.get_ident(), shape)
    if key not in _PROGRAMS:
        while len(_PROGRAMS) >= MOST_PROGRAMS:
            del _PROGRAMS[next(iter(_PROGRAMS))]
        begun = time.process_time()
        with stopped_clock():
            _PROGRAMS[key] = _compiled(shape)
        rhs.compile_seconds += time.process_time() - begun
    return _PROGRAMS[key]


def _compiled(shape: Shape) -> Program:
    """Compile the equations and events of a shape."""
    import heyoka as hy  # pyright: ignore[reportMissingImports]

    a = Numbers(*_symbols(shape))
    size, n = a.matrix.shape
    x = [hy.expression(f"x{i}") for i in range(size)]
    w = {k: hy.expression(f"w{k}") for k in shape.pressed}
    t, since = hy.expression("t"), hy.expression("T")

    def dot(row: Any, values: Any) -> Any:
        return hy.sum([hy.expression(0.0), *(p * v for p, v in zip(row, values, strict=True) if p is not None)])

    def power(base: Any, exponent: int) -> Any:
        return hy.prod([hy.expression(1.0), *[base] * exponent])

    # Functions of time with two derivatives.
    g = [hy.expression(1.0)]
    for frequency in a.frequencies:
        g += [hy.sin(frequency * t), hy.cos(frequency * t)]
    for record in a.records:
        value = hy.expression(0.0)
        for p in record[::-1]:
            value = value * (t - a.edge[0]) + p
        g.append(value)
    rates = [hy.diff(f, t) for f in g]
    accelerations = [hy.diff(f, t) for f in rates]

    # Depth, rate and force of every side; elastic part and its slope by w where the exponent is fractional.
    offset_rates = [dot(column, rates) for column in a.offsets.T]
    depths, speeds, elastic, slopes = [], [], [], []
    forces: list[Any] = [hy.expression(0.0) for _ in a.law]
    for k, (c, side) in enumerate(shape.sides):
        law, p = Law(*a.law[c]), shape.exponents[c]
        u = dot(a.position_rows[c], x[:n]) + dot(a.offsets[:, c], g)
        v = dot(a.velocity_rows[c], x[:n]) + offset_rates[c]
        depths.append(float(side) * (u - (law.g2 if side > 0 else law.g1)))
        speeds.append(float(side) * v)
        if k in w:
            times = law.kappa * a.lengths[c] ** float(p)
            elastic.append(times * power(w[k], p.numerator))
            slopes.append(float(p) * times / a.lengths[c] * power(w[k], p.numerator - p.denominator))
        elif p.denominator == 1:
            elastic.append(law.kappa * power(depths[k], int(p)))
            slopes.append(float(p) * law.kappa * power(depths[k], int(p) - 1))
        else:  # not in contact
            elastic.append(hy.expression(0.0))
            slopes.append(hy.expression(0.0))
        pressure = elastic[k] * (1.0 + law.lam * speeds[k]) + law.c * speeds[k]
        forces[c] = forces[c] - float(side) * a.pressing[k] * pressure

    # Rates of the unknowns and of the integrals.
    z_rate = [dot(a.matrix[i], x[:n]) + dot(a.loads[:, i], g) + dot(a.pushes[:, i], forces) for i in range(size)]
    z_rate[n] += hy.sum([f * dot(row, x[:n]) for f, row in zip(g, a.power, strict=True)])
    z_rate[n] -= a.energies[0] * hy.sum(
        [hy.expression(0.0), *(f * o for f, o in zip(forces, offset_rates, strict=True))]
    )
    z_rate[n + 1] += hy.sum([x[i] * dot(a.damping[i], x[:n]) for i in range(n)])
    if any(shape.damps):
        for k, (c, side) in enumerate(shape.sides):
            if shape.damps[c]:
                z_rate[-1] -= a.energies[1] * a.pressing[k] * float(side) * forces[c] * speeds[k]

    # Events: gaps, forces of stops that damp, and the peaks.
    # With these signs every event is a rise: of the depth of an open side, of minus the depth of a closed one.
    signs = [1.0 - 2.0 * pressing for pressing in a.pressing]
    units = [a.lengths[c] for c, _ in shape.sides]
    gaps = [-w[k] - NOT_ZERO if k in w else signs[k] * depths[k] - NOT_ZERO * units[k] for k in range(len(signs))]
    releasing = [k for k, (c, _) in enumerate(shape.sides) if shape.damps[c]]
    turning = list(speeds)
    for k in releasing:
        c, side = shape.sides[k]
        law = Law(*a.law[c])
        damper = 1.0 + law.lam * speeds[k]
        presses = elastic[k] * damper + law.c * speeds[k] if shape.jumps[c] else damper
        gaps.append(signs[k] * presses - NOT_ZERO * (law.kappa * units[k] if shape.jumps[c] else 1.0))
        acceleration = dot(a.acceleration_rows[c], z_rate[:n]) + dot(a.offsets[:, c], accelerations)
        turning[k] = slopes[k] * damper * speeds[k] + (law.lam * elastic[k] + law.c) * float(side) * acceleration

    # Independent variable: t, or s with dt/ds = product of w^(b-1) in a contact with a fractional power.
    powers = {k: power(w[k], shape.exponents[shape.sides[k][0]].denominator - 1) for k in w}
    pace = hy.prod([hy.expression(1.0), *powers.values()])
    equations = [(x[i], pace * rate) for i, rate in enumerate(z_rate)]
    if w:
        equations.append((since, pace / a.clock[1]))
    for k in w:
        c, _ = shape.sides[k]
        # s is common to all pressed sides: dw/ds has the factors w^(b-1) of the other sides.
        others = hy.prod([hy.expression(1.0), *(f for j, f in powers.items() if j != k)])
        equations.append((w[k], others * speeds[k] / (float(shape.exponents[c].denominator) * a.lengths[c])))
    now = {"t": a.clock[0] + a.clock[1] * since if w else hy.time}
    rising, falling = hy.event_direction.positive, hy.event_direction.negative
    peaks = [Peaks() for _ in turning]
    # compact_mode keeps the compilation of large systems short; high_accuracy sums the series with compensation.
    integrator = hy.taylor_adaptive(
        [(variable, hy.subs(rate, now)) for variable, rate in equations],
        state=[0.0] * len(equations),
        tol=shape.tolerance,
        compact_mode=True,
        high_accuracy=True,
        t_events=[hy.t_event(hy.subs(gap, now), direction=rising) for gap in gaps],
        nt_events=[
            hy.nt_event(hy.subs(rate, now), peak, direction=falling) for rate, peak in zip(turning, peaks, strict=True)
        ],
    )
    return Program(integrator, peaks, releasing, shape.pressed)


def _symbols(shape: Shape) -> list[Any]:
    """Arrays of parameters, None for a zero."""
    import heyoka as hy  # pyright: ignore[reportMissingImports]

    arrays, count = [], 0
    for form, places in shape.places:
        symbols = np.full(form, None, object)
        for place in zip(*np.nonzero(np.frombuffer(places, bool).reshape(form)), strict=True):
            symbols[place] = hy.par[count]
            count += 1
        arrays.append(symbols)
    return arrays
