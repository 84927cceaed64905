"""The damped solution in many digits at any time, for motions that are small differences of large amplitudes.

    q(t_i + tau) = Re sum_k W_k c_k exp(rate_k tau)

in float64 is off by eps sum |W_k c_k|. Where that counts, over a tiny time or where a mode creeps, the same sums
are evaluated with the digits that the pieces were carried with, and only their values are rounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb
from numpy.typing import NDArray

from ...basics.arrays import Array
from ...model.system import System
from ..exact.exponential import ExponentialSolution, measured_work
from .rational import Exact, carried


@dataclass(frozen=True, eq=False)
class UnroundedSolution(ExponentialSolution):
    """An ExponentialSolution whose positions, velocities, work and losses come from its ``precise`` pieces.

    precise: with regime.rates (K,), regime.W (n, K), t, bits and the coefficients ``parts(tau)`` (K,), one for every
    piece. given: the problem.
    """

    precise: list[Any]
    given: Exact

    def _inside(self, piece: NDArray[np.int64], t: Array, row: Array) -> tuple[Array, Array]:
        found = []
        for k, when in zip(piece.tolist(), t.tolist(), strict=True):
            with carried(self.precise[k].bits):
                W, rates, parts = self._terms(k, when)
                both = (W * acb_mat([[x, x * rate] for x, rate in zip(parts, rates, strict=True)])).tolist()
                found.append([[float(line[i].real) for line in both] for i in (0, 1)])
        q, v = np.array(found).reshape(len(t), 2, -1).transpose(1, 0, 2)
        return q @ np.transpose(row), v @ np.transpose(row)

    def work(self, system: System, edges: Array) -> tuple[Array, Array]:
        """Work of the loads and viscous loss between consecutive edges, which include every switch.

        With records by quadrature, see ``measured_work``.
        """
        if self.drive.records:
            return measured_work(self, system, edges)
        found = []
        for k, (a, b) in zip(self.piece_at(edges[:-1]).tolist(), pairwise(edges.tolist()), strict=True):
            with carried(self.precise[k].bits):
                found.append([float(x) for x in self._work(k, a, b)])
        given, taken = np.array(found).reshape(-1, 2).T
        return given, taken

    def _terms(self, k: int, t: float) -> tuple[Any, list[Any], list[Any]]:
        """W, the rates and the coefficients at time t of piece k."""
        regime, tau = self.precise[k].regime, arb(t) - self.precise[k].t
        return regime.W, regime.rates, self.precise[k].parts(tau)

    def _work(self, k: int, a: float, b: float) -> tuple[Any, Any]:
        """int (f . q' - sum_c F_c o_c') dt and int q'^T C q' dt over [a, b] in piece k, F = kappa (g - row q - o)."""
        W, rates, parts = self._terms(k, a)
        own = len(rates) - 1 - len(self.drive.frequencies)
        h, driven = arb(b) - arb(a), rates[own:]
        spin = parts[own:]  # (1, exp(i Omega a), ...)
        q = [[x * part for x, part in zip(line, parts, strict=True)] for line in W.tolist()]
        v = [[x * rate for x, rate in zip(line, rates, strict=True)] for line in q]
        force = [_phasors(list(column), spin) for column in zip(*self.given.basis.tolist(), strict=True)]
        total = _integral(force, driven, v, rates, h)
        for contact, side in zip(self.given.contacts, self.sides[k].tolist(), strict=True):
            if abs(side) == 1 and any(x != 0 for x in contact.offset[1:]):
                o = _phasors(contact.offset, spin)
                seen = (acb_mat([[acb(x) for x in contact.row]]) * acb_mat(q)).tolist()[0]
                push = [-contact.kappa * (x + (o[i - own] if i >= own else 0)) for i, x in enumerate(seen)]
                push[own] += contact.kappa * contact.stop(side)
                total -= _integral([push], rates, [[x * w for x, w in zip(o, driven, strict=True)]], driven, h)
        lost = (acb_mat(self.given.damping) * acb_mat(v)).tolist()
        return total, _integral(v, rates, lost, rates, h)


def _phasors(coefficients: list[Any], spin: list[Any]) -> list[Any]:
    """Drive coefficients (d,) as amplitudes of (1, exp(i Omega s), ...), turned by ``spin``: cosine - i sine."""
    pairs = zip(coefficients[1::2], coefficients[2::2], strict=True)
    return [x * y for x, y in zip([acb(coefficients[0]), *(acb(c, -s) for s, c in pairs)], spin, strict=True)]


def _integral(x: list[Any], x_rates: list[Any], y: list[Any], y_rates: list[Any], h: Any) -> Any:
    """int_0^h Re(sum_k x_k exp(x_rates_k s)) . Re(sum_l y_l exp(y_rates_l s)) ds; x (n, k), y (n, l)."""
    turned, total = acb_mat(x).transpose(), arb(0)
    grown = [(r * h).exp() for r in x_rates]
    for conjugate in (False, True):
        other, rates = y, y_rates
        if conjugate:
            other, rates = [[z.conjugate() for z in line] for line in y], [z.conjugate() for z in y_rates]
        ends = [(r * h).exp() for r in rates]
        for line, r, p in zip((turned * acb_mat(other)).tolist(), x_rates, grown, strict=True):
            for weight, s, e in zip(line, rates, ends, strict=True):
                z = (r + s).mid()
                total += (weight * (h if z == 0 else (p * e - 1) / z)).real.mid()
    return total / 2
