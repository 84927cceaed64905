"""The exact solution in as many digits as error growth requires, with python-flint.

    z = (q, q', 1, sin w_1 t, cos w_1 t, ...),   z' = G z       a system with some contacts closed and all its drives
    u = l z of a contact with its offset,   u' = l G z

Float64 finds the next event from the state, Newton's method doubles its digits, and one evaluation of the exponentials
uses all of them. Digits that the motion has lost are dropped. Two runs with different digits have to agree.

Numbers have their exact values: a beam's matrices are whole multiples of EI h^-3 or thirds and sixths of m h; the
float64 entries of the System carry roundings that past the horizon lead to another trajectory. Arrays are NumPy's, of
fmpq and arb.

The flow is split into blocks: those that float64 knows, refined to the digits carried.

    z = V y,   y' = T y,   T = L G V block by block,   L = V^-1
    V <- V (I + E),   E_ij T_jj - T_ii E_ij = T_ij

The last line is Newton's method, which squares its error at each turn. Eigenvalues that meet, and a drive in
resonance with them, share a block of any size. A block that is larger than need be costs time and nothing else: what
float64 cannot separate is joined.

Limitation: the event search runs in float64, so that a contact shallower than 1e-12 of the motion may be missed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx, fmpq
from scipy.sparse.csgraph import connected_components

from ..basics.arrays import Array
from ..basics.resources import afford, clock, in_time
from ..basics.validation import InputError, exact_value
from ..kernels.library import Marks
from ..model.beam import velocity_curvature_matrices
from ..model.contact import Stops
from ..model.modes import PRECISION
from ..model.problem import BeamProblem, PointLoad, PolynomialProfile, Profile
from ..model.semidiscretisation import bending_stencil, curvature_stencil
from ..model.system import System
from ..model.time_functions import Constant, Drive, Harmonic, parts
from ..trajectory.records import last_before
from ..trajectory.trajectory import Reference, SolverFailure
from .exact.motion import NO_TIMES, Motion, Solver, fresh_after, pressed, require_short, switched_by_force
from .exact.solution import reference_of, refuse
from .horizon import lyapunov
from .registry import Request, output_times

BITS = math.log2(10.0)
MAX_DIGITS = 20_000
GUARD_BITS = 100  # below the digits that are lost: two doubles' worth for the outputs
KNOWN_BITS = 28  # precision of a time between two events in float64
AGREEMENT = 1e-12  # of max |u| and of the time: how closely two precisions have to agree


def solve(request: Request) -> Reference:
    """The exact solution with ``digits`` decimal digits, and again with a quarter more.

    "auto" estimates the digits from the growth of tangent vectors along the float64 solution, and goes
    on until both runs agree to t_end. A fixed number gives the horizon to which both
    agree. The states at the output times are evaluated in that many digits and rounded once. From these states and
    those at the events float64 finds all others, and integrates peaks, impulses and work. Takes what the exact solution
    takes but records: any damping, any number of contacts, time functions made of Harmonic and Constant; raises
    InputError otherwise and for rigid stops, SolverFailure where even ``MAX_DIGITS`` do not suffice.

    Numbers: those of a case file, and in Python those given as texts, Fractions or Decimals, have their exact
    values. All others are doubles; provenance["parameters"] names the
    exact ones. Past the horizon of float64 the two readings have different solutions. t_end and output
    times are doubles: nothing magnifies their rounding. Float64 finds the next event, which is then refined.
    """
    system, t_end, t_eval, digits = request.system, request.t_end, request.t_eval, request.digits
    if digits != "auto" and (isinstance(digits, bool) or not isinstance(digits, int) or not 20 <= digits <= MAX_DIGITS):
        raise InputError("digits", digits, f"be 'auto' or an integer from 20 to {MAX_DIGITS}", "auto decides by itself")
    for contact in system.contacts:
        contact.stops.require_compliant("multiprecision", "use the method exact, or a large one")
    for function in system.drive.others:
        rule = "be made of Harmonic and Constant for multiprecision"
        raise InputError("time function", function, rule, "use the method exact, and sample Python functions for it")
    refuse(system, t_end)
    begun = clock()
    # Solve with more and more digits until two runs agree.
    wanted, guard = (_estimate(system, t_end) if digits == "auto" else int(digits)), GUARD_BITS
    previous: Reference | None = None
    while wanted <= MAX_DIGITS:
        exact = "; ".join(system.exact_parameters) or "none"
        notes: dict[str, Any] = {"digits": wanted, "parameters": f"doubles; exact: {exact}"}
        solution = carry(system, t_end, wanted, guard, output_times(t_eval, t_end))
        run = reference_of(solution, t_end, t_eval, begun, "multiprecision", notes)
        if previous is not None:
            horizon, before = _agreement(previous, run), previous.provenance["digits"]
            # A fixed number of digits is confirmed once: the horizon tells how far it is good.
            if horizon >= t_end or digits != "auto":
                notes = {
                    "digits_confirmed_with": before,
                    "horizon": horizon,
                    "horizon_against": f"itself with {before} digits",
                    "horizon_tolerance": f"|du| <= {AGREEMENT:g} max|u| at the output times, the same events",
                }
                return replace(run, horizon=horizon, provenance=run.provenance | notes)
        previous = run
        # The guard grows too: other outputs then reveal cancellation that it did not cover.
        wanted, guard = math.ceil(1.25 * wanted) + 15, math.ceil(1.25 * guard) + 50
    raise SolverFailure("multiprecision", t_end, f"{wanted} digits are not enough", "shorten t_end")


def carry(system: System, t_end: float, digits: int, guard: int = GUARD_BITS, outputs: Array = NO_TIMES) -> Motion:
    """The solution with ``digits`` at the start beside the ``guard`` bits that the ``outputs`` (k,) need.

    Those also pay for cancellation: between modes, between the motion and its response to the drive, and
    in the eigenproblem. How much of it there is shows when another guard gives other outputs.
    """
    full = math.ceil(digits * BITS) + guard
    with PRECISION, ctx.workprec(full + guard):
        solver = PreciseSolver(system, t_end, full, guard)
        return solver.motion(solver.follow(), outputs)


def _estimate(system: System, t_end: float) -> int:
    """Digits for t_end: what tangent vectors lose on the way, a twentieth for another way, and 20 to be left.

    Where float64 has no solution to take them along, 40: the runs go on until they agree.
    """
    try:
        lost = lyapunov(system, t_end).digits
    except SolverFailure:
        return 40
    return 20 + math.ceil(1.05 * max(0.0, lost))


def _agreement(a: Reference, b: Reference) -> float:
    """The time to which two precisions agree in every event and in the displacement."""
    x, y = a.solution, b.solution
    n = min(len(x.times), len(y.times))
    same = np.all(x.sides[:n] == y.sides[:n], axis=1) & (np.abs(x.times[:n] - y.times[:n]) <= AGREEMENT * y.times[:n])
    # First event that differs, or that only one run has.
    first = int(np.argmin(np.append(same, False)))
    end = float(min([b.provenance["t_end"], *x.times[first : first + 1], *y.times[first : first + 1]]))
    # First output up to there at which the displacements differ.
    scale = float(np.max(np.abs(b.tip)))
    return last_before(b.t, ~(np.abs(a.tip - b.tip) <= AGREEMENT * scale) & (b.t <= end), end)


# ---------------------------------------------------------------- from event to event


class Piece(NamedTuple):
    """A flow from time t on: the coordinates y there, the bits carried, q and q' (2n,) rounded, sides of contacts."""

    split: Split
    t: Any
    y: Any
    bits: int
    state: Array
    sides: list[int]

    def whole(self, t: Any) -> Any:
        """z (N, 1) at time t, a float or arb."""
        with ctx.workprec(self.bits):
            return (self.split.V * self.split.ahead(self.y, arb(t) - self.t)).mid()


class PreciseSolver:
    """Flows of regimes in many digits, and events that float64 finds, on [0, t_end].

    ``full`` bits are carried at the start and ``guard`` at the end; ctx.prec has room to spare.
    """

    def __init__(self, system: System, t_end: float, full: int, guard: int) -> None:
        self.system, self.t_end, self.full, self.guard = system, t_end, full, guard
        self.room, self.solver, self.flow = ctx.prec, Solver(system), LinearFlow(system)
        self.regimes: dict[tuple[int, ...], Split] = {}
        require_short(self.solver.free, t_end)

    def follow(self) -> list[Piece]:
        """The pieces of the solution from event to event."""
        system, t_end, pieces = self.system, self.t_end, list[Piece]()
        none = fresh = np.zeros(len(system.contacts), np.int64)
        t, z, sides, resting = arb(0), self.flow.start, list[int](), True
        while True:
            begun, state = float(t), self._rounded(z)
            in_time(begun)
            afford("t_end", t_end, "shorten t_end", floats=len(pieces) * (self.full / 32.0 + 20.0) * system.size)
            # The sides, where a gap may be zero, and the next event by float64.
            begin = partial(self.solver.follower, np.split(state, 2), begun)
            if resting:
                soon = begin()
                soon.follow(np.nextafter(begun, np.inf), NO_TIMES)
                sides = soon.arrays["side"].tolist()
            piece = self._piece(t, z, state, sides)
            pieces.append(piece)
            follower = begin() if resting else begin(np.array(sides, np.int64), fresh)
            found = follower.first_event(t_end) if system.contacts else None
            if found is None or found[0] >= t_end:
                return pieces
            start, contact, side = found
            # Refine the event to all digits, and go on from there in the new regime.
            when = self._event_time(piece, start, contact, side)
            if not resting and when == t and start > begun:  # back to where the sides are known: float64's rounding
                t, z, fresh, resting = arb(start), piece.whole(start), none, False
                continue
            after = [side if i == contact else x for i, x in enumerate(sides)]
            resting = when == t  # the state stays as it is: its rounding would bring the event back
            if not resting:
                z = piece.whole(when)
            t, fresh, sides = when, fresh_after(system, sides, after), after

    def _piece(self, t: Any, z: Any, state: Array, sides: list[int]) -> Piece:
        """The piece that begins with z, rounded ``state``, at t."""
        # The regime of these contacts, refined where it is first met.
        key = tuple(pressed(sides).tolist())
        if key not in self.regimes:
            with ctx.workprec(self.room):
                self.regimes[key] = Split(self.flow, key)
        split, share = self.regimes[key], min(1.0, float(t) / self.t_end)
        # Errors grow with time: precision falls evenly from ``full`` at the start to ``guard`` at the end.
        ctx.prec = max(self.guard, math.ceil(self.full - (self.full - self.guard) * share)) + 30
        return Piece(split, t, (split.L * z).mid(), ctx.prec, state, sides)

    def _rounded(self, z: Any) -> Array:
        """q and q' (2n,) of z, each rounded once."""
        return np.array([float(x) for x in z.entries()[: 2 * self.flow.n]])

    def _event_time(self, piece: Piece, start: float, contact: int, side: int) -> Any:
        """The time of an event at which a contact changes to a side, near the time ``start``, to all digits."""
        rates: Any = np.array([x for split in self.regimes.values() for block in split.blocks for x in block.values])
        fastest = max(1.0 / self.t_end, float(np.max(np.abs(rates))))
        turning = max(1.0 / self.t_end, *self.flow.drive.frequencies, float(np.max(np.abs(rates.imag))))
        before, begun, split = piece.sides[contact], float(piece.t), piece.split
        form = self.flow.gap(contact, int(np.sign(side or before)), switched_by_force(before, side))
        with ctx.workprec(self.room):
            gap = (arb_mat([x.entries() for x in (form, form * split.G)]) * split.V).mid()

        def gap_at(tau: Any) -> list[Any]:
            return (gap * split.ahead(piece.y, tau)).mid().entries()

        return (piece.t + _locate(gap_at, start - begun, fastest, 2.0 * np.pi / turning, begun)).mid()

    def motion(self, pieces: list[Piece], outputs: Array) -> Motion:
        """The motion of these pieces as float64 reads it, from states behind every event and at every output."""
        m, begun = len(self.system.contacts), np.array([float(x.t) for x in pieces])
        of = np.maximum(np.searchsorted(begun, outputs, "right") - 1, 0)
        seen = [self._rounded(pieces[k].whole(t)) for k, t in zip(of.tolist(), outputs.tolist(), strict=True)]
        # Marks in order of time; those of one time in order of the pieces.
        times, piece = np.concatenate([begun, outputs]), np.concatenate([np.arange(len(pieces)), of])
        order = np.argsort(times, kind="stable")
        whole = np.array([*(x.state for x in pieces), *seen])
        eta, rate = (x @ self.solver.free.into for x in np.split(whole, 2, axis=1))
        sides = np.array([x.sides for x in pieces], np.int64).reshape(len(pieces), m)[piece[order]]
        first = np.flatnonzero([True, *np.any(sides[1:] != sides[:-1], axis=1)])  # the marks of events
        marks = Marks(times[order], eta[order], rate[order], sides)
        at_outputs = outputs, eta[len(pieces) :], rate[len(pieces) :], np.zeros((len(outputs), m))
        return Motion(self.system, self.solver.free, marks, first, len(pieces), seen=at_outputs)


def _locate(gap_at: Callable[[Any], list[Any]], start: float, fastest: float, shortest: float, t: float) -> Any:
    """The time tau at which the gap closes.

    gap_at(tau) -> [gap, gap']. Newton's method from the float64 time ``start``, the precision doubled at each turn,
    so that only one evaluation is made at full precision. Where the gap is zero as the piece begins, at rest on its
    stop and pressed, that is the event. Raises SolverFailure where Newton's method leads further than a fiftieth of
    the ``shortest`` period away: two crossings so close to each other that float64 cannot tell them apart.
    """
    near = 0.02 * shortest
    # At rest on its stop and pressed: at the start gap and rate are zero to half the digits.
    if start < near:
        (gap, speed), soon = gap_at(arb(0)), arb(0.5 * near)
        if max(abs(gap), abs(speed) * soon) < arb(2) ** (-ctx.prec // 2) * abs(gap_at(soon)[0]):
            return arb(0)
    # Newton's method with few digits first: a step doubles the correct ones, so more would be computed in vain.
    full, tau, accurate = ctx.prec, arb(start), KNOWN_BITS
    for _ in range(64):
        accurate = min(full, 2 * accurate - 8)  # the ratio of gap'' to gap' costs a few bits at each turn
        with ctx.workprec(min(full, accurate + 70)):
            gap, speed = gap_at(tau)
            shift = (-gap / speed).mid()
            tau = (tau + shift).mid()
        if not abs(float(tau) - start) < near:
            break
        # What the last step leaves is its square. A damped stop's force jumps, so all digits of the time count.
        if accurate == full and abs(shift) * fastest < arb(2) ** (-full // 2):
            return tau
    remedy = f"end before t = {t + start:.6g}" if t + start > near else "start a little off the stop"
    raise SolverFailure("multiprecision", t + start, "the event is a graze that float64 cannot place", remedy)


# ---------------------------------------------------------------- the problem without rounding

Term = tuple[Any, Any, int]  # vector (n,), function of time, order of its derivative


class ExactContact(NamedTuple):
    """Row (n,), offset in the drive coefficients (d,), kappa, c, g1, g2 (0 for a side without a stop)."""

    row: Any
    offset: Any
    kappa: Any
    damping: Any
    g1: Any
    g2: Any


def number(x: float) -> Any:
    """The exact value of a given number: fmpq, or at the current precision arb for a multiple of pi."""
    ratio, pi = exact_value(x)
    rational = fmpq(ratio.numerator, ratio.denominator)
    return rational * arb.pi() if pi else rational


_numbers = np.vectorize(number, otypes=[object])


def exact_problem(system: System, drive: Drive) -> tuple[Any, Any, Any, Any, list[ExactContact], Any, Any]:
    """M, C, K (n, n), the loads' basis (d, n), the contacts, and q0, v0 (n,), at the current precision."""
    # Of elements the matrices are taken as they are: see System.exact_parameters.
    beam = system.problem if system.form != "hermite" else None
    start = _numbers(system.q0), _numbers(system.v0)
    if beam is not None:
        mass, damping, stiffness, loads, of_beam = _beam(system, beam, drive)
        places = [_place(beam, stops, system.size, drive) for stops in beam.all_stops]
        start = of_beam if system.keeps("q0", "v0") else start
    else:
        mass, damping, stiffness = (_numbers(x) for x in (system.mass, system.damping, system.stiffness))
        places = [(_numbers(each.row), in_drive(drive, [([1], each.offset, 0)])[:, 0]) for each in system.contacts]
        loads = [(_numbers(vector), function, 0) for vector, function in system.loads]
    contacts = []
    for stops, place in zip((contact.stops for contact in system.contacts), places, strict=True):
        sides = [number(0.0 if g is None else g) for g in (stops.lower, stops.upper)]
        contacts.append(ExactContact(*place, number(stops.stiffness), number(stops.damping), *sides))
    return mass, damping, stiffness, in_drive(drive, loads, system.size), contacts, *start


def in_drive(drive: Drive, terms: Iterable[Term], n: int = 1) -> Any:
    """A sum of vectors times time functions in closed form as a basis (d, n) of the drive coefficients."""
    frequencies, basis = [exact_value(x) for x in drive.frequencies], np.full((drive.size, n), arb(0), object)
    for vector, function, order in terms:
        for factor, part in parts(function):
            weighted = np.array(vector, object) * number(factor)
            if isinstance(part, Constant) and not order:
                basis[0] += weighted * number(part.level)
            elif isinstance(part, Harmonic):
                k = 1 + 2 * frequencies.index(exact_value(part.frequency))
                # a sin(w t + phase) = a cos(phase) sin w t + a sin(phase) cos w t.
                s, c = arb(number(part.phase)).sin_cos()
                size = number(part.amplitude)
                for _ in range(order):  # a sin(w t + phase) -> a w cos(w t + phase)
                    s, c, size = c, -s, size * number(part.frequency)
                basis[k] += weighted * (size * c)
                basis[k + 1] += weighted * (size * s)
    return basis


def _place(problem: BeamProblem, stops: Stops, M: int, drive: Drive) -> tuple[Any, Any]:
    """Row of stops on a beam by linear interpolation, and phi (1 - (x/L)^2) - m(t) in the drive coefficients."""
    share = number(problem.place(stops)) / number(problem.length)
    offset = [([1 - share * share], problem.base, 0), ([-1], stops.motion, 0)]
    return _hat(share, M), in_drive(drive, offset)[:, 0]


def _hat(share: Any, M: int) -> Any:
    """The weights of the nodes beside x = share L, node 0 left out."""
    place = share * M
    # The tip lies at the end of the last cell.
    cell = min(int(arb(place).floor().unique_fmpz() or 0), M - 1)
    hats = np.full(M + 1, fmpq(0), object)
    hats[cell], hats[cell + 1] = 1 - (place - cell), place - cell
    return hats[1:]


def _beam(system: System, problem: BeamProblem, drive: Drive) -> tuple[Any, Any, Any, list[Term], tuple[Any, Any]]:
    """Mass, damping and stiffness of both forms, the terms of the loads, and the initial data."""
    M = system.size
    bending, viscosity = number(problem.stiffness), number(problem.viscosity)
    length, m, drag = (number(x) for x in (problem.length, problem.mass_per_length, problem.mass_damping))
    paper, phi = system.form == "displacement", problem.base
    # Matrices: stencils of whole numbers times (M/length)^3, and the weights of the nodes.
    weights = length * _weights(M, paper)
    stencil, over = (bending_stencil(M), 1) if paper else (curvature_stencil(M), 24)
    strain = stencil.astype(int).astype(object) * ((M / length) ** 3 / over)
    mass = m * weights
    mass[-1, -1] += number(problem.tip_mass)
    # (2.5) at the tip: (1 - (x/L)^2) phi has a curvature there, which v must balance.
    lift = np.array([1 - fmpq(i, M) ** 2 for i in range(1, M + 1)], object)
    clamp = np.full(M, fmpq(0), object)
    clamp[-2:] = [-2 * M / length**3, 2 * M / length**3] if paper else [-2 * M**2 / length**4, 7 * M**2 / length**4]
    clamp = clamp if paper else weights @ clamp
    # Loads of the base: its inertia and mass damping, its bending with viscosity at the tip; then those of the problem.
    loads: list[Term] = [(-m * (weights @ lift), phi, 2), (bending * clamp, phi, 0)]
    loads.append((viscosity * clamp - drag * m * (weights @ lift), phi, 1))
    x = [length * fmpq(i, M) for i in range(1, M + 1)]
    for load in problem.loads:
        point = isinstance(load, PointLoad)
        vector = _hat(number(load.position) / length, M) if point else weights @ _values(load.shape, x)
        loads.append((vector, load.time, 0))
    # The initial data in v = u - phi (1 - (x/L)^2).
    base = in_drive(drive, [([1], phi, 0)])[:, 0]
    at, rate = (
        base[0] + sum(base[2::2]),
        sum(w * s for w, s in zip(map(number, drive.frequencies), base[1::2], strict=True)),
    )
    u0 = at if problem.initial_displacement is None else _values(problem.initial_displacement, x)
    w0 = 0 if problem.initial_velocity is None else _values(problem.initial_velocity, x)
    return mass, viscosity * strain + drag * mass, bending * strain, loads, (u0 - at * lift, w0 - rate * lift)


def _values(profile: Profile, x: list[Any]) -> Any:
    """A polynomial exactly; of any other function of x, the doubles that it gives."""
    if isinstance(profile, PolynomialProfile):
        powers = [sum((number(c) * y**k for k, c in enumerate(profile.coefficients)), fmpq(0)) for y in x]
        return np.array(powers, object)
    grid = np.array([float(arb(y)) for y in x])
    return _numbers(np.broadcast_to(profile(grid), grid.shape))


def _weights(M: int, lumped: bool) -> Any:
    """The weights of the nodes over L: 1/M and half of it at the tip; or P of (3.12)."""
    sixths = np.diag([6] * (M - 1) + [3]) if lumped else np.rint(6.0 * velocity_curvature_matrices(M, float(M))[0])
    return sixths.astype(int).astype(object) * fmpq(1, 6 * M)


# ---------------------------------------------------------------- regimes


class LinearFlow:
    """G of all regimes of ``system``, at the current precision. start: z (N, 1) at t = 0."""

    def __init__(self, system: System) -> None:
        self.drive = system.drive
        mass, damping, stiffness, basis, self.contacts, q0, v0 = exact_problem(system, self.drive)
        self.n, self.N, inverse = system.size, 2 * system.size + self.drive.size, arb_mat(mass.tolist()).inv()

        def solved(x: Any) -> Any:
            return np.array((inverse * arb_mat(x.tolist())).tolist(), object).reshape(x.shape)

        # G: the equation of motion with its loads, then the equations of the functions of time.
        n, G = self.n, np.full((self.N, self.N), arb(0), object)
        np.fill_diagonal(G[:n, n:], arb(1))
        G[n : 2 * n] = np.hstack([-solved(stiffness), -solved(damping), solved(basis.T)])
        for k, frequency in enumerate(self.drive.frequencies):
            at, w = 2 * n + 1 + 2 * k, number(frequency)
            # (sin w t)' = w cos w t, (cos w t)' = -w sin w t.
            G[at, at + 1], G[at + 1, at] = w, -w
        self.G = arb_mat(G.tolist()).mid()
        waves = len(self.drive.frequencies) * [0, 1]  # sin 0 and cos 0
        self.start = arb_mat([[x] for x in (*q0, *v0, 1, *waves)]).mid()
        # The position of every contact as a form, its rate, and M^-1 row^T, a unit of impulse as a change of z.
        self.forms = [arb_mat([[*contact.row, *n * [0], *contact.offset]]).mid() for contact in self.contacts]
        self.rates = [(form * self.G).mid() for form in self.forms]
        rows = [solved(contact.row[:, None]).ravel() for contact in self.contacts]
        self.back = [arb_mat([[x] for x in (*n * [0], *row, *self.drive.size * [0])]).mid() for row in rows]

    def closed(self, sides: Sequence[int]) -> Any:
        """G with compliant contacts on the given sides, 0 free: sigma = kappa (g - u) - c u'."""
        G = self.G
        for c, (contact, side) in enumerate(zip(self.contacts, sides, strict=True)):
            if side:
                force = self.gap(c, side) * -arb(contact.kappa) - self.rates[c] * arb(contact.damping)
                G = (G + self.back[c] * force).mid()
        return G

    def gap(self, contact: int, side: int, lagging: bool = False) -> Any:
        """u - g of a contact, or u - g + (c/kappa) u', a form."""
        entries, of = self.forms[contact].entries(), self.contacts[contact]
        entries[2 * self.n] -= of.g2 if side > 0 else of.g1
        form = arb_mat([entries]).mid()
        return form + self.rates[contact] * arb(of.damping / of.kappa) if lagging else form


# ---------------------------------------------------------------- their blocks

START_BITS = 120  # of the first turn, which begins with the 53 of float64
MAX_TURNS = 40
TOO_FAR = 0.1  # an entry of E: blocks with larger ones are joined
CLOSE = 1e-6  # of their size: eigenvalues of a mode and of a drive that are in resonance
NOTHING = 1e-9  # of the largest eigenvalue
TURNING = 1e-3  # imaginary by real part of a pair of eigenvalues, from which its exponential is a closed form


class Block(NamedTuple):
    """Places in y, and the eigenvalues by float64."""

    places: list[int]
    values: list[complex]

    def __add__(self, other: Block) -> Block:  # type: ignore[override]
        return Block(self.places + other.places, self.values + other.values)


class Split:
    """The flow with compliant contacts on the given sides (m,), in ``blocks``, at the current precision.

    Of the coordinates those from ``drives`` on depend on themselves alone.
    """

    def __init__(self, flow: LinearFlow, sides: Sequence[int]) -> None:
        self.G, self.N, self.drives = flow.closed(sides), flow.N, 2 * flow.n
        V, self.blocks = by_float64(flow, self.G)
        self.V = V
        # Refine. Blocks that cannot be separated are joined, and the refinement starts anew from the V it was given.
        with ctx.workprec(target := ctx.prec):
            while apart := self._refine(target):
                self.V, (i, j) = V, sorted(apart)
                self.blocks[i : i + 1] = [self.blocks[i] + self.blocks.pop(j)]
        identity = arb_mat([[int(i == j) for j in range(self.N)] for i in range(self.N)])
        self.L = self.V.solve(identity, algorithm="approx").mid()
        self._moves = [(block.places, T, _turning(T)) for block, T in zip(self.blocks, self._own, strict=True)]

    def ahead(self, y: Any, tau: Any) -> Any:
        """y (N, 1) at tau later."""
        y = y.entries()
        for places, T, turning in self._moves:
            part = [y[k] for k in places]
            if turning is None:
                part = ((T * tau).exp() * arb_mat([[x] for x in part])).entries()
            else:
                (a, b), (decay, frequency, (p, q, r)) = part, turning
                growth, (sine, cosine) = (decay * tau).exp(), (frequency * tau).sin_cos()
                sine, cosine = growth * sine, growth * cosine
                part = [cosine * a + sine * (p * a + q * b), cosine * b + sine * (r * a - p * b)]
            for k, x in zip(places, part, strict=True):
                y[k] = x
        return arb_mat(self.N, 1, y)

    def _refine(self, target: int) -> tuple[int, int] | None:
        """Refine V; two blocks that cannot be separated, None where all are."""
        size, precision = arb(1), START_BITS
        for turn in range(MAX_TURNS):
            ctx.prec = min(target, precision)
            # T in the present coordinates, and the correction E that makes it block by block.
            T = self.V.solve(self.G * self.V, algorithm="approx").mid().tolist()
            self._own = [arb_mat([[T[a][b] for b in places] for a in places]) for places, _ in self.blocks]
            E = [[arb(0)] * len(T) for _ in T]
            largest, worst = arb(0), (0, 0)
            for i, one in enumerate(self.blocks):
                # The functions of time depend on themselves alone: nothing of the motion enters their rows.
                if min(one.places) >= self.drives:
                    continue
                for j, other in enumerate(self.blocks):
                    places = [(a, b) for a in one.places for b in other.places]
                    for (a, b), x in zip(places, _sylvester(T, places), strict=True) if i != j else ():
                        if not x.is_finite():
                            return i, j
                        E[a][b] = x
                        if turn == 0 and b >= self.drives:  # of any size: how far a drive moves the modes
                            size = abs(x) if abs(x) > size else size
                        elif not abs(x) / size <= largest:
                            largest, worst = abs(x) / size, (i, j)
            # Newton's method converges from small corrections only: larger ones mean blocks too close to separate.
            if turn == MAX_TURNS - 1 or not largest < TOO_FAR:
                return worst
            self.V = (self.V + self.V * arb_mat(E)).mid()
            # The next error is the square of this one, and the one after that has to be carried.
            bits = target if largest == 0 else math.floor(-float(largest.log()) / math.log(2.0))
            if ctx.prec == target and 2 * bits > target - 40 and turn > 0:
                return None
            precision = max(START_BITS, 4 * bits + 120)
        return None


def _sylvester(T: list[list[Any]], places: list[tuple[int, int]]) -> list[Any]:
    """E_ij of two blocks, line by line; infinite where it does not exist."""
    matrix = [[(T[d][b] if a == c else 0) - (T[a][c] if b == d else 0) for c, d in places] for a, b in places]
    try:
        return arb_mat(matrix).solve(arb_mat([[T[a][b]] for a, b in places])).mid().entries()
    except ZeroDivisionError:
        return [arb("inf")] * len(places)


def _turning(T: Any) -> tuple[Any, Any, Any] | None:
    """s, w and entries (p, q, r) of T = s I + w J, J = [[p, q], [r, -p]], J^2 = -I; None where T is another.

    exp(T t) = e^(s t) (cos(w t) I + sin(w t) J)
    """
    if T.nrows() != 2:
        return None
    decay, half = (T[0, 0] + T[1, 1]) / 2, (T[0, 0] - T[1, 1]) / 2
    square = -half * half - T[0, 1] * T[1, 0]
    if not square > (TURNING * decay) ** 2:
        return None
    frequency = square.sqrt().mid()
    return decay.mid(), frequency, [(x / frequency).mid() for x in (half, T[0, 1], T[1, 0])]


def by_float64(flow: LinearFlow, G: Any) -> tuple[Any, list[Block]]:
    """Columns V (N, N) and blocks of a regime by float64, and of the drives behind it: the constant, sine and cosine of
    every frequency. A drive in resonance shares the block of its modes."""
    n, V = flow.n, np.eye(flow.N)
    A = np.array([[float(x) for x in line[: 2 * n]] for line in G.tolist()[: 2 * n]])
    # Positions in units that bring both halves of A to one size.
    unit = np.repeat([math.sqrt(float(np.linalg.norm(A[n:, :n], 2))) or 1.0, 1.0], n)
    A *= unit[:, None] / unit
    values: Any
    vectors: Any
    values, vectors = np.linalg.eig(A)
    upper = np.flatnonzero(values.imag >= 0.0)
    nothing = NOTHING * max(np.max(np.abs(values)), *flow.drive.frequencies, 0.0)
    columns, blocks = list[Array](), list[Block]()
    _, label = connected_components(_meet(values[upper, None], values[upper], nothing), directed=False)
    for group in (upper[label == k] for k in np.unique(label)):
        own, begin = values[group], len(columns)
        both = np.concatenate([own, own[own.imag > 0.0].conj()])
        if len(both) == 1 or (len(group) == 1 and own[0].imag > CLOSE * abs(own[0])):  # a real one, or a pair
            vector = vectors[:, group[0]]
            columns += [vector.real, -vector.imag][: len(both)]
        else:  # eigenvalues that meet share the kernel of their polynomial
            P = np.eye(2 * n)
            for x in own:
                step = A - x.real * np.eye(2 * n)
                P = P @ (step @ step + x.imag**2 * np.eye(2 * n) if x.imag > 0.0 else step)
                P /= np.max(np.abs(P)) or 1.0
            columns += list(np.linalg.svd(P)[2][-len(both) :])
        blocks.append(Block(list(range(begin, len(columns))), both.tolist()))
    V[: 2 * n, : 2 * n] = np.transpose(columns) / unit[:, None]
    waves = [(2 * n + 1 + 2 * k, 1j * w) for k, w in enumerate(flow.drive.frequencies)]
    for drive in (Block([2 * n], [0.0]), *(Block([at, at + 1], [w, -w]) for at, w in waves)):
        near = [block for block in blocks if any(_meet(x, y, nothing) for x in block.values for y in drive.values)]
        blocks = [block for block in blocks if block not in near] + [sum(near, drive)]
    return arb_mat([[arb(x) for x in line] for line in V.tolist()]), blocks


def _meet(x: Any, y: Any, nothing: float) -> Any:
    """True for eigenvalues that differ by little, or by nothing beside the largest."""
    return abs(x - y) <= CLOSE * (abs(x) + abs(y)) + nothing
