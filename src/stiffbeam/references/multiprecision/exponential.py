"""The exact solution with damping or several contacts in many digits: the sums of exponential.py.

    q(t_i + tau) = Re sum_k W_k (c_k exp(rate_k tau) + sum_j f_kj psi_j(rate_k, tau))

over the eigenvalues of the regime, one of each conjugate pair, and i Omega of the drive, which no record
forces. The contact state is a symmetric pencil, [[C, M], [M, 0]] (q', q'') = [[-K, 0], [0, M]] (q, q') + (f, 0),
so that its eigenvectors x = (phi, lambda phi), x^T [[C, M], [M, 0]] x = 1, give the coefficients without an inverse:
c = lambda phi^T M q + phi^T (C q + M q'). Where float64 has chains (chains.py), eigenvalues meet, and the vectors are
those of a stiffness off by less than the digits carried, which parts them; so many more digits pay for their size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
from flint import acb, acb_mat, arb, arb_mat, ctx

from ...basics.resources import Forecast
from ...model.drive import Drive
from ...model.system import System
from ...trajectory.trajectory import SolverFailure
from ..exact.damped_stops import pressed, side_of, switched_by_force
from ..exact.exponential import ExponentialSolution
from ..exact.exponential_regime import Regime, regime_of
from ..exact.exponential_tracer import Gaps
from ..exact.touching import REMEDY
from .grazes import Switch
from .modes import DampedPencil, Sampler, channels, dot, locate, precision_at, refine, sampler
from .rational import Exact, exact_problem, number
from .recorded import answers, moved, taylor
from .unrounded import UnroundedSolution


@dataclass(eq=False)
class PreciseRegime:
    """rates: (K,), the k eigenvalues and then i Omega, the constant first. W: (n, K). rows, row_rates:
    (channels, K), the observed positions, the contacts first, and their rates. from_q, from_v: (k, n). push:
    (k, R), what the records force. moved: (channels, R), their part of the offsets. rounded: the same in float64.
    lost: bits that its sums cancel."""

    rates: list[Any]
    W: Any
    rows: list[list[Any]]
    row_rates: list[list[Any]]
    from_q: Any
    from_v: Any
    push: list[list[Any]]
    moved: list[list[Any]]
    rounded: Regime
    lost: int


class Piece(NamedTuple):
    """A regime, the time it begins, the coefficients c (K,) there, the records' polynomials (R, P) and the bits
    carried."""

    regime: PreciseRegime
    t: Any
    c: list[Any]
    records: list[list[Any]]
    bits: int

    def parts(self, tau: Any) -> list[Any]:
        """The coefficients (K,) at tau after the start."""
        parts = [x * (rate * tau).exp() for x, rate in zip(self.c, self.regime.rates, strict=True)]
        if self.records:
            for k, force in enumerate(self.forces(arb(0))):
                parts[k] += dot(force, answers(self.regime.rates[k], tau, len(force)))
        return parts

    def forces(self, tau: Any) -> list[list[Any]]:
        """f (k, P) of the records about tau."""
        columns = [list(x) for x in zip_longest(*(moved(r, tau) for r in self.records), fillvalue=arb(0))]  # (P, R)
        return [[dot(push, column) for column in columns] for push in self.regime.push]


def precise_exponential(
    system: System, t_end: float, full: int, guard: int, told: Sequence[Switch] = ()
) -> tuple[ExponentialSolution, Sampler, UnroundedSolution]:
    """The solution on [0, t_end] carried with ``full`` bits at the start and ``guard`` at the end, rounded to
    float64, what samples its channels before it is rounded, and itself unrounded; ctx.prec has room to spare.

    told: switches that float64 does not see, in order.
    """
    room = ctx.prec
    drive = Drive.of(system)
    problem = exact_problem(system, drive)
    regimes: dict[tuple[int, ...], PreciseRegime] = {}
    t, q, v = arb(0), problem.q0, problem.v0
    spin = _spin(drive, t)
    chi = []
    for contact, exact in zip(system.contacts, problem.contacts, strict=True):
        u = dot(exact.row, q) + dot(_phasors(exact.offset), spin).real
        u += dot(exact.recorded, [taylor(record, t)[0] for record in drive.records])
        speed = dot(exact.row, v) + dot(_phasors(exact.rate), spin).real
        chi.append(side_of(contact.stops, float(u), float(speed)))
    times, sides, coefficients, resting, evaluations, carried = [], [], [], -1, 0, None
    gaps = Gaps(system, drive)
    pieces: list[Piece] = []
    forecast, untold = Forecast(t_end), list(told)
    while True:
        key = tuple(chi)
        if key not in regimes:
            before, ctx.prec = ctx.prec, room
            closed = tuple(pressed(key).tolist())
            regimes[key] = regimes.get(closed) or _regime(system, problem, drive, closed, t_end)
            ctx.prec = before
        regime = regimes[key]
        ctx.prec = precision_at(full, guard, float(t), t_end) + regime.lost
        spin = _spin(drive, t)
        c = _coefficients(regime, q, v, spin) if carried is None else carried + spin
        times.append(float(t))
        sides.append(list(chi))
        coefficients.append(_rounded(regime, c, spin))
        piece = Piece(regime, t, c, [taylor(record, t) for record in drive.records], ctx.prec)
        pieces.append(piece)
        edge, carried = drive.next_edge(times[-1], t_end), None
        start, contact, side, used = gaps.next_switch(
            regime.rounded, coefficients[-1], np.array(chi, np.int64), np.arange(len(chi)) == resting, times[-1], edge
        )
        evaluations += used
        if untold and untold[0].t < (times[-1] + start if contact >= 0 else edge):
            start, contact, side = untold[0].t - times[-1], untold[0].contact, untold[0].side
            side = 0 if chi[contact] else side
            del untold[0]
        if contact >= 0 and times[-1] + start < edge:
            forecast.check(times[-1], len(times) * (full / 32.0 + 20.0) * system.size)
            stop, lag = problem.contacts[contact].stop(side or chi[contact]), arb(0)
            if switched_by_force(chi[contact], side):
                lag = problem.contacts[contact].lag
            fastest = float(np.max(np.abs(regime.rounded.eigenvalues)))
            shortest = 2.0 * np.pi / max(float(np.max(regime.rounded.eigenvalues.imag)), *drive.frequencies, 1e-300)
            gap_at = partial(_gap, piece, contact, stop, lag)
            tau, shift, parts = locate(gap_at, start, fastest, shortest, times[-1], regime.lost)
            when = (t + tau + shift).mid()
            if not drive.records or t <= when < edge:
                t, chi[contact], resting = when, side, contact
                q, v = _state(piece, parts, tau, shift)
                continue
            if when < t:
                raise SolverFailure(
                    "multiprecision", times[-1], "a switch at a sample that float64 cannot place", REMEDY
                )
        if edge >= t_end:
            break
        ahead, resting = piece.parts(edge - t), -1
        t, carried = arb(edge), [x.mid() for x in ahead[: len(ahead) - len(spin)]]
    solution = (
        drive,
        {key: regime.rounded for key, regime in regimes.items()},
        np.array(times),
        np.array(sides, np.int64).reshape(len(times), len(chi)),
        coefficients,
        evaluations,
    )
    unrounded = UnroundedSolution(*solution, pieces, problem)
    return ExponentialSolution(*solution), sampler(times, pieces, _sample), unrounded


def _sample(piece: Piece, t: float) -> tuple[list[Any], list[Any]]:
    """Positions and velocities of the channels at t inside a piece."""
    regime, tau = piece.regime, arb(t) - piece.t
    parts = piece.parts(tau)
    u, v = ([dot(row, parts).real for row in rows] for rows in (regime.rows, regime.row_rates))
    moves = [_offset(piece, i, tau) for i in range(len(u))]
    return [x + o for x, (o, _) in zip(u, moves, strict=True)], [x + o for x, (_, o) in zip(v, moves, strict=True)]


def _offset(piece: Piece, channel: int, tau: Any) -> tuple[Any, Any]:
    """The records' part of a channel's offset, and its rate."""
    if not piece.records:
        return arb(0), arb(0)
    here = [moved(record, tau) for record in piece.records]
    amplitudes = piece.regime.moved[channel]
    return tuple(dot(amplitudes, [c[k] if k < len(c) else arb(0) for c in here]) for k in (0, 1))  # type: ignore[return-value]


def _regime(system: System, problem: Exact, drive: Drive, chi: tuple[int, ...], t_end: float) -> PreciseRegime:
    C, stiffness, basis, records = problem.closed(chi)
    damped = any(x != 0 for line in C.tolist() for x in line)
    start = regime_of(system, drive, chi, t_end)  # refuses what float64 refuses
    lost = 0
    if start.chains:
        bits, lost = ctx.prec, 3 * ctx.prec
        ctx.prec += lost
        stiffness = _parted(problem.mass, stiffness, max(float(np.max(np.abs(start.eigenvalues))), 1.0 / t_end), bits)
    pencil = DampedPencil(acb_mat(problem.mass), acb_mat(C), acb_mat(stiffness))
    if lost:
        shapes, values = pencil.from_scratch()
    else:
        shapes, values = refine(pencil, *pencil.normalised(*_both_of_each_pair(start)))  # phi, (n, 2n)
    kept, weights = [], []
    for j, value in enumerate(values):
        real = abs(value.imag).mid() <= abs(value).mid() * arb(2) ** (-ctx.prec // 3)
        if real or value.imag > 0:
            kept.append(j)
            weights.append(1 if real else 2)
        values[j] = acb(value.real, 0) if real else (value if damped else acb(0, value.imag))
    forces = (acb_mat([_phasors(list(line)) for line in zip(*basis, strict=True)]).transpose() * shapes).tolist()
    drive_rates = [acb(0, number(f)) for f in (0.0, *drive.frequencies)]
    gains = [
        [_response(f, rate - value, value) for f, value in zip(line, values, strict=True)]
        for line, rate in zip(forces, drive_rates, strict=True)
    ]
    X = (shapes * acb_mat(gains).transpose()).mid().tolist()  # (n, 1 + F)
    phi = [[line[j] for j in kept] for line in shapes.tolist()]
    W = acb_mat([[w * x for w, x in zip(weights, line, strict=True)] + r for line, r in zip(phi, X, strict=True)]).mid()
    turned = acb_mat(phi).transpose()
    eigenvalues = [values[j] for j in kept]
    through_mass = (turned * problem.mass).tolist()
    from_q = [
        [value * x + y for x, y in zip(line, other, strict=True)]
        for value, line, other in zip(eigenvalues, through_mass, (turned * C).tolist(), strict=True)
    ]
    rates = eigenvalues + drive_rates
    rows, moves = [], []
    for seen, offset_of_seen, recorded in channels(system, problem, drive):
        moves.append(recorded)
        row = (acb_mat([seen]) * W).tolist()[0]
        offset = [acb(0)] * len(eigenvalues) + _phasors(offset_of_seen)
        rows.append([(a + b).mid() for a, b in zip(row, offset, strict=True)])
    k = len(eigenvalues)
    push = (turned * acb_mat(arb_mat(records)).transpose()).mid().tolist() if records else [[] for _ in range(k)]
    rounded = start if lost else _in_float64(eigenvalues, drive_rates, W, from_q, through_mass, X, push)
    row_rates = [[(x * rate).mid() for x, rate in zip(row, rates, strict=True)] for row in rows]
    made = acb_mat(from_q).mid(), acb_mat(through_mass).mid(), push, moves, rounded, lost
    return PreciseRegime(rates, W, rows, row_rates, *made)


def _in_float64(values: list[Any], rates: list[Any], W: Any, from_q: Any, from_v: Any, X: Any, push: Any) -> Regime:
    k, response = len(values), _complex(X)
    eigenvalues, shapes = _complex([values])[0], _complex(W.tolist())[:, :k]
    return Regime(
        eigenvalues, shapes, shapes * eigenvalues, _complex(from_q), _complex(from_v),
        response, response * _complex([rates])[0], _complex(push).reshape(k, -1),
    )  # fmt: skip


def _parted(mass: Any, stiffness: Any, fastest: float, bits: int) -> Any:
    """K + 2^-bits w^2 (M + D), w = fastest, D differing parts of the diagonal of M."""
    size = arb(fastest) ** 2 * arb(2) ** -bits
    pairs = zip(stiffness.tolist(), mass.tolist(), strict=True)
    lines = [[x + size * m for x, m in zip(*pair, strict=True)] for pair in pairs]
    for i, line in enumerate(lines):
        line[i] += size * mass[i, i] * arb((0.6180339887498949 * (i + 1)) % 1.0)
    return arb_mat(lines)


def _rounded(regime: PreciseRegime, c: list[Any], spin: list[Any]) -> Any:
    """The coefficients (k,) in float64, from the contact state where the precise ones are large and cancel."""
    if not regime.lost:
        return np.array([complex(x) for x in c[: len(c) - len(spin)]])
    q, v = _columns(regime.W, c, regime.rates)
    return regime.rounded.coefficients(
        np.array([float(x) for x in q]), np.array([float(x) for x in v]), _complex([spin])[0]
    )


def _response(force: Any, gain: Any, scale: Any) -> Any:
    """force/gain; 0 for a mode at the frequency of a drive that leaves it alone, the others being refused."""
    resonant = abs(gain).mid() <= abs(scale).mid() * arb(2) ** (-ctx.prec // 3)
    return acb(0) if resonant else (force / gain).mid()


def _both_of_each_pair(regime: Regime) -> tuple[Any, list[Any]]:
    """All 2n float64 vectors phi and eigenvalues."""
    pairs = regime.eigenvalues.imag > 0.0
    values = np.concatenate([regime.eigenvalues, regime.eigenvalues[pairs].conj()])
    phi = np.concatenate([regime.W, regime.W[:, pairs].conj()], axis=1)
    return acb_mat([[acb(x.real, x.imag) for x in line] for line in phi.tolist()]), [
        acb(x.real, x.imag) for x in values.tolist()
    ]


def _gap(piece: Piece, contact: int, stop: Any, lag: Any, tau: Any) -> tuple[Any, Any, list[Any]]:
    """u - stop + lag u' of a contact at tau, its rate, and the coefficients they are made of."""
    regime, parts = piece.regime, piece.parts(tau)
    u, speed = (dot(rows[contact], parts).real for rows in (regime.rows, regime.row_rates))
    offset, rate = _offset(piece, contact, tau)
    curve = arb(0)
    if lag != 0:
        ahead = [rate * part for rate, part in zip(regime.rates, parts, strict=True)]
        for k, force in enumerate(piece.forces(tau) if piece.records else []):
            ahead[k] += force[0]
        curve = dot(regime.row_rates[contact], ahead).real
    return (u + offset - stop + lag * (speed + rate)).mid(), (speed + rate + lag * curve).mid(), parts


def _coefficients(regime: PreciseRegime, q: list[Any], v: list[Any], spin: list[Any]) -> list[Any]:
    """c (K,) from the contact state, the drive's phasors at its end."""
    k = len(regime.rates) - len(spin)
    driven, driven_rate = _columns(regime.W, [acb(0)] * k + spin, regime.rates)
    q, v = ([[(a - b).mid()] for a, b in zip(*pair, strict=True)] for pair in ((q, driven), (v, driven_rate)))
    modal = regime.from_q * acb_mat(q) + regime.from_v * acb_mat(v)
    return [line[0].mid() for line in modal.tolist()] + spin


def _state(piece: Piece, parts: list[Any], tau: Any, shift: Any) -> tuple[list[Any], list[Any]]:
    """q, q' at ``shift`` after tau, where the coefficients are ``parts``, a Taylor step of second order."""
    ahead, regime = [], piece.regime
    for part, rate in zip(parts, regime.rates, strict=True):
        x = rate * shift
        ahead.append(part * (1 + x + x * x / 2))
    if piece.records:  # c' = rate c + f, c'' = rate c' + f'
        for k, force in enumerate(piece.forces(tau)):
            f, f_rate = force[0], force[1] if len(force) > 1 else 0
            ahead[k] += shift * f + shift * shift / 2 * (regime.rates[k] * f + f_rate)
    return _columns(regime.W, ahead, regime.rates)


def _columns(W: Any, parts: list[Any], rates: list[Any]) -> tuple[list[Any], list[Any]]:
    """Re(W parts) and Re(W (rates parts))."""
    both = (W * acb_mat([[part, part * rate] for part, rate in zip(parts, rates, strict=True)]).mid()).tolist()
    return [line[0].real for line in both], [line[1].real for line in both]


def _spin(drive: Drive, t: Any) -> list[Any]:
    """(1, exp(i Omega t), ...)."""
    return [acb(1), *(acb(0, number(f) * t).exp().mid() for f in drive.frequencies)]


def _phasors(coefficients: list[Any]) -> list[Any]:
    """Drive coefficients (d,) as complex amplitudes of (1, exp(i Omega t), ...): cosine - i sine."""
    pairs = zip(coefficients[1::2], coefficients[2::2], strict=True)
    return [acb(coefficients[0]), *(acb(cosine, -sine) for sine, cosine in pairs)]


def _complex(matrix: list[list[Any]]) -> Any:
    return np.array([[complex(x) for x in line] for line in matrix])
