"""The compiled event search for sums of complex exponentials and responses to polynomials, see search.py; and the loop
over the samples of records."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..basics.arrays import Array, IntArray
from ..basics.compiled import compiled, inner
from ..trajectory.trajectory import SolverFailure
from .linear import alike, answers, basis_at, forced_derivatives, forced_sizes, response
from .search import (
    CLOSES,
    EPS,
    FAINT,
    REMEDY,
    ROUNDINGS,
    SHORTEST,
    UNCLEAR,
    as_gap,
    gap_step,
    stands_still,
    taylor_step,
)
from .spectrum import differences, largest
from .terms import ORDER


@inner
def derivatives(sigma: Array, omega: Array, real: Array, imaginary: Array, tau: float, d: Array, b: Array) -> None:
    """The derivatives of Re sum_k (real + i imaginary)_k exp((sigma_k + i omega_k) tau) at tau into d, and the
    sizes of its terms into b, (ORDER + 1,)."""
    d[:] = 0.0
    b[:] = 0.0
    for k in range(sigma.size):
        decay = math.exp(sigma[k] * tau)
        c = math.cos(omega[k] * tau)
        s = math.sin(omega[k] * tau)
        x = decay * (real[k] * c - imaginary[k] * s)
        y = decay * (real[k] * s + imaginary[k] * c)
        # |a exp(...)| does not depend on the phase; every derivative multiplies it by |sigma + i omega|.
        reach = math.hypot(x, y)
        size = math.hypot(sigma[k], omega[k])
        for i in range(ORDER + 1):
            d[i] += x
            b[i] += reach
            x, y = sigma[k] * x - omega[k] * y, sigma[k] * y + omega[k] * x
            reach *= size


@compiled
def search(
    sigma: Array, omega: Array, real: Array, imaginary: Array, chi: IntArray, g1: Array, g2: Array, resting: IntArray,
    t_start: float, t_end: float, eigenvalues: Array, seen: Array, shift: Array, nodes: Array, counts: IntArray,
    chained: Array,
) -> tuple[float, int, int, int]:  # fmt: skip
    """The first event of m contacts whose positions are

        u_c(tau) = Re [sum_k a_ck exp((sigma_k + i omega_k) tau) + sum_kj seen_ckj psi_j(lambda_k, tau)
                       + sum_bj chained_cb0j D_bj(tau)] + sum_j shift_cj tau^j

    a = real + i imaginary: (m, K); sigma <= 0. eigenvalues: lambda (k,); seen: (m, k, P), shift: (m, P), the
    forces and offsets that are polynomials (linear.py); P = 0 where there are none, else t_end is
    as far as they go. nodes: (b, K), counts: (b,), chained: (m, b, ORDER + 1, K), the terms of
    chains and their derivatives (spectrum.py). chi, g1, g2: (m,). resting: (m,), not 0 for a contact
    that has switched at t_start, so that its gap is exactly zero. Returns (tau, contact, side,
    evaluations); contact -1: none before t_end. Every gap that is open or closed is kept positive, see
    ``gap_step``. Raises SolverFailure as ``search.search`` does.
    """
    m, K = real.shape
    series, sizes = np.empty(ORDER + 1), np.empty(ORDER + 1)
    # Rounding of a gap per unit of its terms; the errors of K terms add up like sqrt(K).
    nu = EPS * (ROUNDINGS + 2.0 * math.sqrt(K))
    P = shift.shape[1]
    psi = np.empty((seen.shape[1], P), np.complex128)
    pushed = np.zeros((m, ORDER + 1))
    # Forces that are polynomials may grow: their derivatives are bounded once, over the whole segment.
    if P > 0:
        for contact in range(m):
            forced_sizes(eigenvalues, seen[contact], shift[contact], t_end - t_start, pushed[contact])
    chains, most = nodes.shape
    D = np.empty((chains, most), np.complex128)
    reaches = np.empty((chains, most))
    # The fastest node of the chains sets the length over which these are bounded.
    widest = 0.0
    for b in range(chains):
        for k in range(counts[b]):
            widest = max(widest, abs(nodes[b, k]))
    tau = 0.0
    evaluations = faint = 0
    while True:
        evaluations += 1
        step = math.inf
        if chains > 0:  # what grows is bounded for one radian of the chains at a time
            step = t_end - t_start - tau
            if widest * step > 1.0:
                step = 1.0 / widest
            for b in range(chains):
                differences(nodes[b, : counts[b]], tau, D[b])
                largest(nodes[b], counts[b], tau, step, reaches[b])
        # The answers to polynomials at tau, then position, rate and bounds of every contact.
        if P > 0:
            for k in range(eigenvalues.size):
                answers(eigenvalues[k], tau, psi[k])
        for contact in range(m):
            u = 0.0
            speed = 0.0
            b0 = pushed[contact, 0]
            # Never zero, so that the quotient b2/b3 in ``gap_step`` is a number.
            b2 = 1e-300 + pushed[contact, 2]
            b3 = 1e-300 + pushed[contact, 3]
            for j in range(P):
                for k in range(eigenvalues.size):
                    x = seen[contact, k, j] * psi[k, j]
                    u += x.real
                    # psi_j' = lambda psi_j + tau^j
                    speed += (eigenvalues[k] * x).real + seen[contact, k, j].real * tau**j
            for j in range(P - 1, 0, -1):
                speed = speed + j * shift[contact, j] * tau ** (j - 1)
                u = u + shift[contact, j] * tau**j
            if P > 0:
                u += shift[contact, 0]
            for b in range(chains):
                for j in range(counts[b]):
                    u += (D[b, j] * chained[contact, b, 0, j]).real
                    speed += (D[b, j] * chained[contact, b, 1, j]).real
                    b0 += reaches[b, j] * abs(chained[contact, b, 0, j])
                    b2 += reaches[b, j] * abs(chained[contact, b, 2, j])
                    b3 += reaches[b, j] * abs(chained[contact, b, 3, j])
            for k in range(K):
                decay = math.exp(sigma[k] * tau)
                c = math.cos(omega[k] * tau)
                s = math.sin(omega[k] * tau)
                x = decay * (real[contact, k] * c - imaginary[contact, k] * s)
                y = decay * (real[contact, k] * s + imaginary[contact, k] * c)
                size = sigma[k] * sigma[k] + omega[k] * omega[k]
                u += x
                speed += sigma[k] * x - omega[k] * y
                # sigma <= 0: the size at tau bounds the term from there on.
                reach = decay * math.hypot(real[contact, k], imaginary[contact, k])
                b0 += reach
                b2 += reach * size
                b3 += reach * size * math.sqrt(size)
            if not b0 + b2 + b3 < math.inf:
                raise SolverFailure("exact", t_start + tau, "the motion overflows float64", REMEDY)
            b2 *= 1.0 + 1e-12  # rounding in the sums
            b3 *= 1.0 + 1e-12
            nearest = 1 if abs(u - g2[contact]) <= abs(u - g1[contact]) else -1
            # Every gap that may close, and the least of their safe steps.
            for side in (1, -1):
                stop = g2[contact] if side > 0 else g1[contact]
                if math.isinf(stop) or (chi[contact] != 0 and chi[contact] != side):
                    continue
                sign = -side if chi[contact] == 0 else side
                zero = tau == 0.0 and resting[contact] != 0 and side == nearest
                gap = 0.0 if zero else sign * (u - stop)
                safe, verdict = gap_step(gap, sign * speed, b2, b3, nu * (abs(stop) + b0), t_start + tau)
                if verdict == UNCLEAR:
                    derivatives(sigma, omega, real[contact], imaginary[contact], tau, series, sizes)
                    if P > 0:
                        forced_derivatives(eigenvalues, seen[contact], shift[contact], tau, series)
                        sizes += pushed[contact]
                    for b in range(chains):
                        for i in range(ORDER + 1):
                            for j in range(counts[b]):
                                series[i] += (D[b, j] * chained[contact, b, i, j]).real
                                sizes[i] += reaches[b, j] * abs(chained[contact, b, i, j])
                    as_gap(series, sizes, sign, stop, zero)
                    safe, verdict = taylor_step(series, sizes, nu, zero)
                    if verdict == UNCLEAR and abs(series[1]) > 2.0 * nu * sizes[1]:
                        faint += 1
                if verdict == CLOSES and not zero:
                    return tau + safe, contact, side, evaluations
                step = min(step, safe)
        # No shorter than the rounding of the time, so that time goes on.
        step = max(step, EPS * (t_start + tau), SHORTEST * t_end)
        if t_start + tau + step >= t_end:
            return t_end - t_start, -1, 0, evaluations
        tau += step
        if faint > FAINT:
            raise SolverFailure("exact", t_start + tau, "a contact moves by less than its rounding", REMEDY)
        if stands_still(evaluations, sigma, omega, tau, t_end - t_start):
            raise SolverFailure("exact", t_start + tau, "the search for the next event stands still", REMEDY)


class Cells(NamedTuple):
    """A regime as input of ``pass_samples``, with k coefficients, m watched gaps, R records and b chains.

    eigenvalues: (k,). push: (k, R), the modal forces of the records. frequencies: (F,), of the drives. rows, W: (m, k),
    what the gaps see of all coefficients without their rates, and of those in no chain with them; waves: (m, 1 + F), of
    the drives, recorded: (m, R), of the records; lags: (m,), what of the rates they see. chi, g1, g2: (m,), see
    ``search``. nodes: (b, K), counts: (b,), B: (b, K, K), the chains' nodes and matrices, the records' columns zero;
    modes: (b, K), drives: (b, K), the places of their coefficients and drives, parts: (b, 2), how many these are.
    """

    eigenvalues: Array
    push: Array
    frequencies: Array
    rows: Array
    W: Array
    waves: Array
    recorded: Array
    lags: Array
    chi: IntArray
    g1: Array
    g2: Array
    nodes: Array
    counts: IntArray
    B: Array
    modes: IntArray
    drives: IntArray
    parts: IntArray


@inner
def newton_form(cells: Cells, b: int, c: Array, spin: Array, force: Array, B: Array, g: Array) -> None:
    """Newton's form g (K, K) of chain b from the coefficients c, the drives ``spin`` and the forces (k, P), see
    spectrum.py; and its matrix with these forces into B (K, K)."""
    size, k, d = cells.counts[b], cells.parts[b, 0], cells.parts[b, 1]
    # g_0 = z(0): the coefficients, the drives in resonance, and 1 for the power tau^0.
    B[:], g[:] = cells.B[b], 0.0
    for i in range(k):
        g[0, i] = c[cells.modes[b, i]]
        for j in range(force.shape[1]):
            B[i, k + d + j] = force[cells.modes[b, i], j]
    for i in range(d):
        g[0, k + i] = spin[cells.drives[b, i]]
    if k + d < size:
        g[0, k + d] = 1.0
    for j in range(1, size):
        for i in range(size):
            g[j, i] = -cells.nodes[b, j - 1] * g[j - 1, i]
            for n in range(size):
                g[j, i] += B[i, n] * g[j - 1, n]


@inner
def see_chain(cells: Cells, b: int, B: Array, g: Array, chained: Array) -> None:
    """The derivatives of what the gaps see of chain b into chained (m, b, ORDER + 1, K), from its Newton form g, which
    is changed by that."""
    size, k = cells.counts[b], cells.parts[b, 0]
    turned = np.empty(size, np.complex128)
    chained[:, b] = 0.0
    # A damped stop sees d + lag d': its i-th derivative needs the next one too, hence ORDER + 2 of them.
    for i in range(ORDER + 2):
        for j in range(size):
            for contact in range(cells.lags.size):
                total = 0.0j
                for n in range(k):
                    total += cells.rows[contact, cells.modes[b, n]] * g[j, n]
                if i <= ORDER:
                    chained[contact, b, i, j] += total
                if i > 0:
                    chained[contact, b, i - 1, j] += cells.lags[contact] * total
            # B g, the coefficients of the next derivative.
            for n in range(size):
                turned[n] = 0.0
                for p in range(size):
                    turned[n] += B[n, p] * g[j, p]
            g[j, :size] = turned


@compiled
def pass_samples(
    cells: Cells, edges: Array, records: Array, noise: Array, size: float, c: Array, out: Array
) -> tuple[int, int]:
    """Follow the coefficients c (k,) from sample to sample, up to the first cell with an event: into out (cells, k)
    where each cell ends. Returns (cells without an event, evaluations).

    edges: (cells + 1,), the samples' times. records: (cells, R, P), their polynomials in each cell. noise: (cells, 2,
    k) in [-1, 1], of which ``size`` times the rounding of every end is added to it; none for size 0.
    """
    eigenvalues, W, push = cells.eigenvalues, cells.W, cells.push
    m, K = W.shape
    R, P = records.shape[1], records.shape[2]
    # The terms of the gaps: coefficients first, then the constant and the drives, which do not decay.
    total = K + cells.waves.shape[1]
    sigma, omega = np.zeros(total), np.zeros(total)
    for k in range(K):
        sigma[k], omega[k] = min(eigenvalues[k].real, 0.0), eigenvalues[k].imag
    omega[K + 1 :] = cells.frequencies
    real, imaginary, spin = np.empty((m, total)), np.empty((m, total)), np.empty(total - K, np.complex128)
    force, seen, shift = np.empty((K, P), np.complex128), np.empty((m, K, P), np.complex128), np.empty((m, P))
    # At a sample no contact has just switched.
    resting = np.zeros(m, np.int64)
    # The exponentials of a cell's length are those of the next one as long.
    decay, psi, base = np.empty(K, np.complex128), np.empty((K, P), np.complex128), -math.inf
    chains, most = cells.nodes.shape
    chained, D = np.zeros((m, chains, ORDER + 1, most), np.complex128), np.empty(most, np.complex128)
    B, g = np.empty((most, most), np.complex128), np.empty((most, most), np.complex128)
    evaluations = 0
    for cell in range(edges.size - 1):
        t, end = edges[cell], edges[cell + 1]
        # Modal forces of the records in this cell, and the drives at its start.
        for k in range(K):
            for j in range(P):
                force[k, j] = 0.0
                for r in range(R):
                    force[k, j] += push[k, r] * records[cell, r, j]
        for k in range(spin.size):
            spin[k] = complex(math.cos(omega[K + k] * t), math.sin(omega[K + k] * t))
        # Terms of the gaps at the start of the cell.
        for i in range(m):
            for j in range(P):
                shift[i, j] = 0.0
                for r in range(R):
                    shift[i, j] += cells.recorded[i, r] * records[cell, r, j]
            for k in range(K):
                a = W[i, k] * c[k]
                real[i, k], imaginary[i, k] = a.real, a.imag
                for j in range(P):
                    seen[i, k, j] = W[i, k] * force[k, j]
            # psi_j' = lambda psi_j + tau^j: the powers cancel over all coefficients, so that those outside of chains
            # have what those of the chains leave.
            for b in range(chains):
                for n in range(cells.parts[b, 0]):
                    k = cells.modes[b, n]
                    for j in range(P):
                        shift[i, j] -= cells.lags[i] * (cells.rows[i, k] * force[k, j]).real
            for k in range(spin.size):
                a = cells.waves[i, k] * spin[k]
                real[i, K + k], imaginary[i, K + k] = a.real, a.imag
        for b in range(chains):
            newton_form(cells, b, c, spin, force, B, g)
            see_chain(cells, b, B, g, chained)
        tau, contact, _, used = search(
            sigma, omega, real, imaginary, cells.chi, cells.g1, cells.g2, resting, t, end, eigenvalues, seen, shift,
            cells.nodes, cells.counts, chained,
        )  # fmt: skip
        # The caller searches this cell again and counts its evaluations.
        if contact >= 0 and t + tau < end:
            return cell, evaluations
        evaluations += used
        # No event: the coefficients at the end of the cell.
        tau = end - t
        ahead = out[cell]
        if not alike(eigenvalues, tau, base):
            base = tau
            basis_at(eigenvalues, tau, decay, psi)
        response(eigenvalues, c, force, decay, psi, base, tau - base, ahead)
        for b in range(chains):
            # Anew, since ``see_chain`` has changed g, and B holds the last chain.
            newton_form(cells, b, c, spin, force, B, g)
            count = cells.counts[b]
            differences(cells.nodes[b, :count], tau, D[:count])
            for i in range(cells.parts[b, 0]):
                y = 0.0j
                for j in range(count):
                    y += D[j] * g[j, i]
                ahead[cells.modes[b, i]] = y
        for k in range(K if size > 0.0 else 0):
            # Two bounds of the answer to the force: by its polynomial, and as the difference of the coefficients.
            power, pushed = tau, 0.0
            for j in range(P):
                pushed += abs(force[k, j]) * power
                power *= tau
            lost = size * (abs(ahead[k]) + min(pushed, abs(c[k]) + abs(ahead[k])))
            ahead[k] += lost * complex(noise[cell, 0, k], noise[cell, 1, k])
        c = ahead
    return edges.size - 1, evaluations
