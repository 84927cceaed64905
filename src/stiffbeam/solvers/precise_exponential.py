"""The exact solution with damping or several contacts in many digits: the sums of exponential.py.

    q(t_i + tau) = Re sum_k W_k c_k exp(rate_k tau)

over the eigenvalues of the regime, one of each conjugate pair, and i Omega of the drive. The contact
state is a symmetric pencil, [[C, M], [M, 0]] (q', q'') = [[-K, 0], [0, M]] (q, q') + (f, 0), so that its
eigenvectors x = (phi, lambda phi), x^T [[C, M], [M, 0]] x = 1, give the coefficients without an inverse:
c = lambda phi^T M q + phi^T (C q + M q').
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, ctx

from ..drive import Drive
from ..system import System
from .exponential import ExponentialSolution, Regime
from .exponential_tracer import next_switch, regime_of
from .precise_modes import dot, eigenvectors, locate, precision_at, refine, response
from .rational import Exact, exact_problem


@dataclass(eq=False)
class PreciseRegime:
    """rates: (K,), the k eigenvalues and then i Omega, the constant first. W: (n, K). rows, row_rates:
    (m, K), the contact positions and their rates. from_q, from_v: (k, n). rounded: the same in float64."""

    rates: list[Any]
    W: Any
    rows: list[list[Any]]
    row_rates: list[list[Any]]
    from_q: Any
    from_v: Any
    rounded: Regime


def precise_exponential(system: System, t_end: float, full: int) -> ExponentialSolution:
    """The solution on [0, t_end] carried with ``full`` bits at the start; ctx.prec has room to spare."""
    room = ctx.prec
    drive = Drive.of(system)
    problem = exact_problem(system, drive)
    regimes: dict[tuple[int, ...], PreciseRegime] = {}
    t, q, v = arb(0), problem.q0, problem.v0
    spin = _spin(drive, t)
    chi = []
    for contact, exact in zip(system.contacts, problem.contacts, strict=True):
        u = dot(exact.row, q) + dot(_phasors(exact.offset), spin).real
        chi.append(int(contact.stops.state(float(u))))
    times, sides, coefficients, resting, evaluations = [], [], [], -1, 0
    while True:
        key = tuple(chi)
        if key not in regimes:
            before, ctx.prec = ctx.prec, room
            regimes[key] = _regime(system, problem, drive, key)
            ctx.prec = before
        regime = regimes[key]
        c = _coefficients(regime, q, v, spin)
        times.append(float(t))
        sides.append(list(chi))
        coefficients.append(np.array([complex(x) for x in c[: len(c) - len(spin)]]))
        ctx.prec = precision_at(full, float(t), t_end)
        start, contact, side, used = next_switch(
            system, drive, regime.rounded, coefficients[-1], np.array(chi), resting, times[-1], t_end
        )
        evaluations += used
        if contact < 0 or times[-1] + start >= t_end:
            break
        stop = problem.contacts[contact].stop(side)
        fastest = float(np.max(np.abs(regime.rounded.eigenvalues)))
        shortest = 2.0 * np.pi / max(float(np.max(regime.rounded.eigenvalues.imag)), *drive.frequencies, 1e-300)
        tau, shift, parts = locate(partial(_gap, regime, c, contact, stop), start, fastest, shortest, times[-1])
        t = (t + tau + shift).mid()
        q, v = _state(regime, parts, shift)
        spin = _spin(drive, t)
        chi[contact] = side if chi[contact] == 0 else 0
        resting = contact
    return ExponentialSolution(
        drive,
        {key: regime.rounded for key, regime in regimes.items()},
        np.array(times),
        np.array(sides, np.int64).reshape(len(times), len(chi)),
        coefficients,
        evaluations,
    )


def _regime(system: System, problem: Exact, drive: Drive, chi: tuple[int, ...]) -> PreciseRegime:
    stiffness, basis = problem.closed(chi)
    start = regime_of(system, drive, chi)  # refuses what float64 refuses
    pencil = DampedPencil(acb_mat(problem.mass), acb_mat(problem.damping), acb_mat(stiffness))
    shapes, values = refine(pencil, *pencil.normalised(*_both_of_each_pair(start)))  # phi, (n, 2n)
    kept, weights = [], []
    for j, value in enumerate(values):
        real = abs(value.imag).mid() <= abs(value).mid() * arb(2) ** (-ctx.prec // 3)
        if real or value.imag > 0:
            kept.append(j)
            weights.append(1 if real else 2)
        values[j] = acb(value.real, 0) if real else (value if system.damped else acb(0, value.imag))
    forces = (acb_mat([_phasors(list(line)) for line in zip(*basis, strict=True)]).transpose() * shapes).tolist()
    drive_rates = [acb(0, f) for f in (0.0, *drive.frequencies)]
    gains = [
        [response(f, rate - value, value) for f, value in zip(line, values, strict=True)]
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
        for value, line, other in zip(eigenvalues, through_mass, (turned * problem.damping).tolist(), strict=True)
    ]
    rates = eigenvalues + drive_rates
    rows = []
    for contact in problem.contacts:
        row = (acb_mat([contact.row]) * W).tolist()[0]
        offset = [acb(0)] * len(eigenvalues) + _phasors(contact.offset)
        rows.append([(a + b).mid() for a, b in zip(row, offset, strict=True)])
    k = len(eigenvalues)
    rounded = Regime(
        _complex([eigenvalues])[0], _complex(W.tolist())[:, :k], _complex(from_q), _complex(through_mass),
        _complex(X),
    )  # fmt: skip
    row_rates = [[(x * rate).mid() for x, rate in zip(row, rates, strict=True)] for row in rows]
    return PreciseRegime(rates, W, rows, row_rates, acb_mat(from_q).mid(), acb_mat(through_mass).mid(), rounded)


@dataclass(frozen=True, eq=False)
class DampedPencil:
    """A = [[C, M], [M, 0]], B = [[-K, 0], [0, M]] on x = (phi, lambda phi), of which phi (n, 2n) is held."""

    mass: Any
    damping: Any
    stiffness: Any

    def products(self, phi: Any, values: list[Any]) -> tuple[Any, Any]:
        turned = phi.transpose()
        M, C, K = ((turned * (matrix * phi)).tolist() for matrix in (self.mass, self.damping, self.stiffness))
        n = range(len(values))
        A = [[C[i][j] + (values[i] + values[j]) * M[i][j] for j in n] for i in n]
        return acb_mat(A), acb_mat([[values[i] * values[j] * M[i][j] - K[i][j] for j in n] for i in n])

    def normalised(self, phi: Any, values: list[Any]) -> tuple[Any, list[Any]]:
        """phi with x^T A x = 1."""
        norms = self.products(phi, values)[0].tolist()
        return acb_mat([[(x / norms[j][j].sqrt()).mid() for j, x in enumerate(line)] for line in phi.tolist()]), values

    def from_scratch(self) -> tuple[Any, list[Any]]:
        n = self.mass.nrows()
        M, C, K = (matrix.tolist() for matrix in (self.mass, self.damping, self.stiffness))
        nothing = [acb(0)] * n
        A = acb_mat([[*C[i], *M[i]] for i in range(n)] + [[*M[i], *nothing] for i in range(n)])
        B = acb_mat([[-x for x in K[i]] + nothing for i in range(n)] + [[*nothing, *M[i]] for i in range(n)])
        columns, values = eigenvectors(A, B)
        return self.normalised(acb_mat([column[:n] for column in columns]).transpose(), values)


def _both_of_each_pair(regime: Regime) -> tuple[Any, list[Any]]:
    """All 2n float64 vectors phi and eigenvalues."""
    pairs = regime.eigenvalues.imag > 0.0
    values = np.concatenate([regime.eigenvalues, regime.eigenvalues[pairs].conj()])
    phi = np.concatenate([regime.W, regime.W[:, pairs].conj()], axis=1)
    return acb_mat([[acb(x.real, x.imag) for x in line] for line in phi.tolist()]), [
        acb(x.real, x.imag) for x in values.tolist()
    ]


def _gap(regime: PreciseRegime, c: list[Any], contact: int, stop: Any, tau: Any) -> tuple[Any, Any, list[Any]]:
    """u - stop and u' of a contact at tau, and the terms c exp(rate tau) they are made of."""
    parts = [x * (rate * tau).exp() for x, rate in zip(c, regime.rates, strict=True)]
    u, speed = (dot(rows[contact], parts).real for rows in (regime.rows, regime.row_rates))
    return (u - stop).mid(), speed.mid(), parts


def _coefficients(regime: PreciseRegime, q: list[Any], v: list[Any], spin: list[Any]) -> list[Any]:
    """c (K,) from the contact state, the drive's phasors at its end."""
    k = len(regime.rates) - len(spin)
    driven, driven_rate = _columns(regime.W, [acb(0)] * k + spin, regime.rates)
    q, v = ([[(a - b).mid()] for a, b in zip(*pair, strict=True)] for pair in ((q, driven), (v, driven_rate)))
    modal = regime.from_q * acb_mat(q) + regime.from_v * acb_mat(v)
    return [line[0].mid() for line in modal.tolist()] + spin


def _state(regime: PreciseRegime, parts: list[Any], shift: Any) -> tuple[list[Any], list[Any]]:
    """q, q' at ``shift`` after the time of the ``parts``, a Taylor step of second order."""
    ahead = []
    for part, rate in zip(parts, regime.rates, strict=True):
        x = rate * shift
        ahead.append(part * (1 + x + x * x / 2))
    return _columns(regime.W, ahead, regime.rates)


def _columns(W: Any, parts: list[Any], rates: list[Any]) -> tuple[list[Any], list[Any]]:
    """Re(W parts) and Re(W (rates parts))."""
    both = (W * acb_mat([[part, part * rate] for part, rate in zip(parts, rates, strict=True)]).mid()).tolist()
    return [line[0].real for line in both], [line[1].real for line in both]


def _spin(drive: Drive, t: Any) -> list[Any]:
    """(1, exp(i Omega t), ...)."""
    return [acb(1), *(acb(0, f * t).exp().mid() for f in map(arb, drive.frequencies))]


def _phasors(coefficients: list[Any]) -> list[Any]:
    """Drive coefficients (d,) as complex amplitudes of (1, exp(i Omega t), ...): cosine - i sine."""
    pairs = zip(coefficients[1::2], coefficients[2::2], strict=True)
    return [acb(coefficients[0]), *(acb(cosine, -sine) for sine, cosine in pairs)]


def _complex(matrix: list[list[Any]]) -> Any:
    return np.array([[complex(x) for x in line] for line in matrix])
