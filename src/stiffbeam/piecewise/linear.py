"""One contact regime of a system with damping, several contacts or records, as sums of complex exponentials.

    q(t_0 + tau) = Re [ W y(tau) ] + Re [ X exp(i Omega (t_0 + tau)) ]
    y' = Lambda y + push r(t),  y(tau) = c exp(lambda tau) + sum_j f_j psi_j(lambda, tau)

with one eigenvalue of each conjugate pair. Where eigenvalues meet each other or a drive i Omega, a ``Chain`` has these
y instead, and X leaves out what it answers: a resonant answer grows, a response to it does not exist.

The answers psi_j to polynomial forces start from rest, in a form that does not cancel where a mode is slow:

    psi_j(lambda, tau) = int_0^tau exp(lambda (tau - s)) s^j ds = j! tau^(j+1) phi_{j+1}(lambda tau)

with the functions phi_l(z) = sum_i z^i/(i + l)! of the exponential integrators. A particular solution that is
a polynomial would hold j! f_j/lambda^(j+1), without bound for slow modes, and the free motion beside it would
take all of it away again. Re(lambda) <= 0.

Copies of a solution that is perturbed by as much as float64 rounds take their modes from ``Correction.perturbed``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array, IntArray
from ..basics.compiled import compiled, inner, inner_inlined
from ..model.modes import Modes, congruence, uncoupled
from ..model.system import System
from ..model.time_functions import Drive
from .spectrum import Chain, Group, groups

CLOSE = 0.01  # |lambda - i Omega|/(|lambda| + Omega) below which a mode answers a drive from rest
NO_DRIVES = np.zeros(0, np.int64)
UNFELT = 1e-14  # of the terms of a modal force: less is the rounding of none
Complex = Any  # arrays of complex128


@dataclass(frozen=True, eq=False)
class Regime:
    """eigenvalues: lambda (k,), those of chains among them. W, W_rate: (n, k), q and q' of the homogeneous part.
    from_q, from_v: (k, n), c = from_q q + from_v q' of the homogeneous part. response, response_rate: X (n, 1 + F)
    complex, to the constant and to exp(i Omega t) of every drive frequency, and what it adds to q'.
    push: (k, R), y' = lambda y + push r(t) under the records r. frame: what no load changes of it."""

    eigenvalues: Complex
    W: Complex
    W_rate: Complex
    from_q: Complex
    from_v: Complex
    response: Complex
    response_rate: Complex
    push: Complex
    chains: tuple[Chain, ...]
    frame: Frame

    @cached_property
    def single(self) -> NDArray[np.bool_]:
        """(k,), True for a coefficient that is not part of a chain."""
        # Coefficients of a chain act on each other: they are not single exponentials.
        alone = np.ones(len(self.eigenvalues), bool)
        for chain in self.chains:
            alone[chain.modes] = False
        return alone

    def coefficients(self, q: Array, v: Array, spin: Complex) -> Complex:
        """c (k,) of the contact state at a time when the drives are ``spin`` (1 + F,)."""
        c = self.from_q @ (q - (self.response @ spin).real)
        return c + self.from_v @ (v - (self.response_rate @ spin).real)

    def state(self, y: Complex, spin: Complex) -> tuple[Array, Array]:
        """q and q' (n,)."""
        return (self.W @ y + self.response @ spin).real, (self.W_rate @ y + self.response_rate @ spin).real

    def ahead(self, c: Complex, spin: Complex, force: Complex, tau: Array, start: IntArray) -> Complex:
        """y (p, k) at tau (p,) after the given of s starts, with the coefficients c (s, k), where the drives are
        ``spin`` (s, 1 + F) and the records push by sum_j force_j tau^j (s, k, P)."""
        y = np.empty((len(tau), len(self.eigenvalues)), complex)
        c, force, tau = (np.ascontiguousarray(x) for x in (c, force, tau))
        respond(self.eigenvalues, tau, start, c, force, y)
        for chain in self.chains:
            y[:, chain.modes] = chain.ahead(c[start], spin[start], force[start], tau)
        return y

    def free(self, c: Complex, tau: float) -> Complex:
        """The homogeneous coefficients (k, columns) at tau after c."""
        still = np.zeros((c.shape[1], 1 + max((int(np.max(x.drives, initial=0)) for x in self.chains), default=0)))
        none = np.zeros((c.shape[1], len(c), 0))
        columns = np.arange(c.shape[1])
        return self.ahead(c.T, still, none, np.full(len(columns), tau), columns).T


class Pushed(NamedTuple):
    """Loads of a system and motions of its stops in the functions of its drive, (d, n) and (d, channels), and of its
    records, (R, n) and (R, channels)."""

    loads: Array
    offsets: Array
    records: Array
    moved: Array

    @classmethod
    def of(cls, system: System, drive: Drive) -> Pushed:
        """Both of a system. Raises InputError for functions that are none of these."""
        loads, rest = drive.split(system.loads, system.size)
        offsets, moving = drive.offsets(system)
        return cls(loads, offsets, drive.recorded(rest, system.size), drive.recorded(moving, offsets.shape[1]))


def regime_of(
    system: System, drive: Drive, pushed: Pushed, chi: tuple[int, ...], span: float, perturbation: Perturbation | None,
    basis: Modes, frame: Frame | None = None,
) -> Regime:  # fmt: skip
    """The regime with every contact on the given side, 0 free; span: the longest time that is asked for; basis: its
    undamped modes, of a perturbed copy where that is asked for; frame: that of a system with equal matrices."""
    closed = [(i, c, side) for i, (c, side) in enumerate(zip(system.contacts, chi, strict=True)) if side]
    # Seeded by the sides: a copy has the same regimes in whichever order its motion enters them.
    rng = None if perturbation is None else perturbation.random(*(side + 1 for side in chi))
    omega, shapes = basis.omega, basis.shapes
    force, offsets, records, moved = pushed.loads.copy(), pushed.offsets, pushed.records, pushed.moved
    for i, contact, side in closed:
        # sigma = kappa (gap - row q - offset) - c (row q' + offset'): the second terms are in the matrices.
        kappa, constant = contact.stops.spring(side)
        c = float(contact.stops.damping)
        moves = kappa * offsets[:, i] + (c * drive.derivative().T @ offsets[:, i] if c else 0.0)
        force = force - np.outer(moves, contact.row)
        records = records - kappa * np.outer(moved[:, i], contact.row)
        force[0] += constant * contact.row
    # Modal forces, and the sizes of their terms, which separate a force from rounding.
    modal_force = phasors(force) @ shapes  # (1 + F, n)
    terms_of_force = np.abs(phasors(force)) @ np.abs(shapes)
    push = records @ shapes  # (R, n)
    if frame is not None:
        return _driven(frame, drive, modal_force, terms_of_force, push, span)
    C = system.damping.copy()
    for _, contact, _ in closed:
        C += float(contact.stops.damping) * np.outer(contact.row, contact.row)
    damping = _modal_damping(C, omega, shapes)
    to_modal = shapes.T @ system.mass
    order = np.arange(system.size)
    if rng is not None and perturbation is not None:
        # A perturbed copy: every sum is changed by about its rounding. Damping that is exactly zero stays so,
        # since modes that no damping joins are solved apart.
        size = perturbation.state
        modal_force += size * rounded_sum(phasors(force), shapes) * rng.uniform(-1.0, 1.0, modal_force.shape)
        push += size * rounded_sum(records, shapes) * rng.uniform(-1.0, 1.0, push.shape)
        terms = rounded_sum(shapes.T, rounded_sum(C, shapes))
        damping += np.where(damping == 0.0, 0.0, size * terms * rng.uniform(-1.0, 1.0, damping.shape))
        # Shapes that are not the exact inverse of the way into them err alike at every event.
        to_modal += size * rounded_sum(shapes.T, system.mass) * rng.uniform(-1.0, 1.0, to_modal.shape)
        shapes = shapes * (1.0 + size * rng.uniform(-1.0, 1.0, shapes.shape))
        order = rng.permutation(order)  # the eigenvalue algorithm rounds otherwise
    size = 0.0 if perturbation is None else perturbation.state
    frame = _frame(omega[order], shapes[:, order], to_modal[order], damping[np.ix_(order, order)], span, size, rng)
    return _driven(frame, drive, modal_force[:, order], terms_of_force[:, order], push[:, order], span)


def _modal_damping(C: Array, omega: Array, shapes: Array) -> Array:
    """shapes^T C shapes without its rounding beside the diagonal and of rigid-body motions."""
    rigid = omega == 0.0
    return uncoupled(C, shapes, congruence(C, shapes) if np.any(rigid) else shapes.T @ C @ shapes, rigid)


@dataclass(frozen=True, eq=False)
class Frame:
    """The part of a regime of k coefficients that no load changes.

    omega: (n,), s: (n,), damping: (n, n), see ``groups``. begins: of each group among the coefficients, and k. values:
    (k,). paired: (k,). L: (k, 2n). shapes and the others: as in ``Regime``.
    """

    omega: Array
    s: Array
    damping: Array
    groups: list[Group]
    begins: list[int]
    values: Complex
    paired: NDArray[np.bool_]
    L: Complex
    shapes: Array
    eigenvalues: Complex
    W: Complex
    W_rate: Complex
    from_q: Complex
    from_v: Complex


def _frame(
    omega: Array, shapes: Array, to_modal: Array, damping: Array, span: float, size: float,
    rng: np.random.Generator | None,
) -> Frame:  # fmt: skip
    """Frame of a regime from its modes. size, rng: as in ``groups``."""
    # Eigenvalues in groups, and the places of these among the coefficients.
    n = len(omega)
    s, found = groups(omega, damping, span, size, rng)
    counts = [len(group.T) for group in found]
    values, L = np.concatenate([g.values for g in found]), np.vstack([g.L for g in found])
    # Conjugates are left out: z = 2 Re(V y).
    paired = np.repeat([g.paired for g in found], counts)
    V = np.hstack([g.V for g in found]) * np.where(paired, 2.0, 1.0)
    return Frame(
        omega, s, damping, found, np.cumsum([0, *counts]).tolist(), values, paired, L, shapes,
        # The damping is positive semidefinite: a positive real part is rounding, and would grow.
        np.minimum(np.real(values), 0.0) + 1j * np.imag(values),
        shapes @ (V[:n] / s[:, None]),
        shapes @ V[n:],
        (L[:, :n] * s) @ to_modal,
        L[:, n:] @ to_modal,
    )  # fmt: skip


def _driven(frame: Frame, drive: Drive, force: Complex, terms: Array, push: Array, span: float) -> Regime:
    """Regime from its frame: force (1 + F, n) of the drives, sums of terms of the sizes ``terms``, push (R, n) of the
    records, all modal."""
    omega, s, found, values, L = frame.omega, frame.s, frame.groups, frame.values, frame.L
    n, rates = len(omega), 1j * np.array([0.0, *drive.frequencies])
    # Chains: groups of several eigenvalues, and single ones that a drive forces in resonance.
    apart, sizes = np.abs(values[:, None] - rates), np.abs(values)[:, None]
    near = apart <= CLOSE * (sizes + np.abs(rates))
    # A force below the rounding of its terms is none: a mode at the frequency of such a drive is not in resonance.
    pulled = np.abs(L[:, n:] @ force.T) > UNFELT * (np.abs(L[:, n:]) @ terms.T)
    slow = ~frame.paired[:, None] & ((apart <= 1.0 / span) | (sizes <= 1.0 / span))
    drawn = pulled & (near | slow)
    # With or without a force on them: of modes close to a drive the response is not asked for.
    near = near.any(axis=0)
    if len(found) == len(values) and not (drawn.any() or near.any() or (omega == 0.0).any()):
        chains, response = [], _answers(omega, s, frame.damping, force, rates)
    else:
        chains = [
            _chain(g, np.arange(a, b), force, terms, rates, span)
            if b > a + 1 or drawn[a].any()
            else Chain(np.array([a]), g.T, NO_DRIVES, rates[:0], g.L[:, :0])
            for g, a, b in zip(found, frame.begins[:-1], frame.begins[1:], strict=True)
        ]
        resonant = near | (omega == 0.0).any()
        resonant[np.concatenate([chain.drives for chain in chains])] = True
        # The equation of the response is singular at resonance and of rigid motions: group by group there.
        response = np.empty((2 * n, len(rates)), complex)
        response[:, ~resonant] = _answers(omega, s, frame.damping, force[~resonant], rates[~resonant])
        for k in np.flatnonzero(resonant).tolist():
            response[:, k] = _without(found, chains, force[k], terms[k], rates, k)
    return Regime(
        frame.eigenvalues, frame.W, frame.W_rate, frame.from_q, frame.from_v,
        frame.shapes @ (response[:n] / s[:, None]), frame.shapes @ response[n:], L[:, n:] @ push.T,
        tuple(chain for chain in chains if len(chain.T) > 1 or len(chain.drives)), frame,
    )  # fmt: skip


def _chain(group: Group, modes: NDArray[np.int64], force: Complex, terms: Array, rates: Complex, span: float) -> Chain:
    """A group with the drives in resonance with it, or the same as it over the span; what nothing holds or damps
    answers every drive."""
    n, values = force.shape[1], group.values
    pull = group.L[:, n:] @ force.T  # (k, 1 + F)
    if group.paired:
        pull = pull / 2.0  # exp(i Omega t) is half of the cosine
    # As in ``_driven``, with the closest eigenvalue of the group.
    pulled = np.any(np.abs(pull) > UNFELT * (np.abs(group.L[:, n:]) @ terms.T), axis=0)
    apart = np.min(np.abs(values[:, None] - rates), axis=0)
    near = apart <= CLOSE * (np.min(np.abs(values)) + np.abs(rates))
    if not group.paired:
        near |= (apart <= 1.0 / span) | (np.min(np.abs(values)) <= 1.0 / span)
    drives = np.flatnonzero(near & pulled)
    return Chain(modes, group.T, drives, rates[drives], pull[:, drives])


def _answers(omega: Array, s: Array, damping: Array, force: Complex, rates: Complex) -> Complex:
    """The responses (2n, k) to forces (k, n) of exp(rate t), row by row to size one, so that stiff modes do not drown
    the soft."""
    # (Omega^2 + rate D + rate^2) eta = force
    each = rates[:, None]
    matrix = each[..., None] * damping
    matrix[:, range(len(omega)), range(len(omega))] += omega**2 + each**2
    size = np.maximum(omega**2, np.abs(each) ** 2)
    size = np.where(size > 0.0, size, 1.0)
    eta = np.linalg.solve(matrix / size[..., None], (force / size)[..., None])[..., 0]
    return np.concatenate([s * eta, each * eta], axis=1).T


def _without(found: list[Group], chains: list[Chain], force: Complex, terms: Array, rates: Complex, k: int) -> Complex:
    """The response to drive k of all groups but those it is in resonance with: -V (T - i Omega)^-1 L force."""
    n, total = len(force), np.zeros(2 * len(force), complex)
    for group, chain in zip(found, chains, strict=True):
        # A drive is in resonance with one of two conjugates only: the other one always responds.
        for turned in (False, True) if group.paired else (False,):
            T, V, L = (x.conj() if turned else x for x in (group.T, group.V, group.L))
            pulled = L[:, n:] @ force
            felt = np.any(np.abs(pulled) > UNFELT * (np.abs(L[:, n:]) @ terms))
            if (turned or k not in chain.drives) and felt:
                total -= V @ np.linalg.solve(T - rates[k] * np.eye(len(T)), pulled)
    return total


def spin_of(drive: Drive, t: Array) -> Complex:
    """(1, exp(i Omega t), ...), (k, 1 + F)."""
    return np.exp(1j * np.multiply.outer(t, np.array([0.0, *drive.frequencies])))


def phasors(basis: Array) -> Complex:
    """Rows g(t) @ basis (d, ...) as complex amplitudes of (1, exp(i Omega t), ...): cosine - i sine."""
    return np.concatenate([basis[:1].astype(complex), basis[2::2] - 1j * basis[1::2]])


TERMS = 24  # of the series for |z| <= 2: the next is below 2^24/28!, 5e-23
MOST = 4  # P at most: cubics
SERIES = 2.0  # up to this |z|
ALIKE = 4e-9  # of the time, and radians of the fastest motion: times as close share their exponentials
REMEMBERED = 64  # times
LEAST = 1e-19  # the series ends with a term below this: the sum is above 1/40, and each term below half of the last


@compiled
def answers(eigenvalue: complex, tau: float, psi: Array) -> None:
    """psi_j(eigenvalue, tau) into psi (P,), P <= 4.

    Series and downward recursion phi_l = z phi_{l+1} + 1/l! for |z| <= 2, else upward phi_{l+1} = (phi_l - 1/l!)/z:
    either loses a few roundings.
    """
    z = eigenvalue * tau
    phi = np.empty(MOST + 1, np.complex128)
    # phi_4 by its series, then downward: |z phi_(l+1)| is at most 1/l!, to which it is added.
    if abs(z) <= SERIES:
        term = 1.0 / 24.0 + 0.0j
        total = term
        for i in range(1, TERMS):
            term *= z * (1.0 / (i + MOST))
            total += term
            if abs(term.real) + abs(term.imag) < LEAST:
                break
        phi[4] = total
        phi[3] = z * phi[4] + 1.0 / 6.0
        phi[2] = z * phi[3] + 0.5
        phi[1] = z * phi[2] + 1.0
    else:
        # phi_1 from exp(z), then upward: each division by |z| > 2 shrinks the rounding before it.
        decay, inverse = math.exp(z.real), 1.0 / z
        phi[1] = (decay * complex(math.cos(z.imag), math.sin(z.imag)) - 1.0) * inverse
        phi[2] = (phi[1] - 1.0) * inverse
        phi[3] = (phi[2] - 0.5) * inverse
        phi[4] = (phi[3] - 1.0 / 6.0) * inverse
    scale = tau
    for j in range(psi.size):
        psi[j] = scale * phi[j + 1]
        scale *= tau * (j + 1)


@inner
def basis_at(eigenvalues: Array, tau: float, decay: Array, psi: Array) -> None:
    """exp(lambda tau) and psi_j(lambda, tau) into decay (k,) and psi (k, P)."""
    for k in range(eigenvalues.size):
        z = eigenvalues[k] * tau
        decay[k] = math.exp(z.real) * complex(math.cos(z.imag), math.sin(z.imag))
        answers(eigenvalues[k], tau, psi[k])


@inner_inlined
def response(
    eigenvalues: Array, c: Array, force: Array, decay: Array, psi: Array, base: float, late: float, out: Array
) -> None:
    """c exp(lambda tau) + sum_j force_j psi_j(lambda, tau) at tau = base + late into out (k,); c: (k,), force: (k, P);
    decay, psi: at the base, see ``basis_at``. What is late counts to first order."""
    for k in range(eigenvalues.size):
        y, push = c[k] * decay[k], 0.0j
        for j in range(force.shape[1] - 1, -1, -1):
            y += force[k, j] * psi[k, j]
            push = push * base + force[k, j]
        # y' = lambda y + push
        out[k] = y + late * (eigenvalues[k] * y + push)


@inner
def alike(eigenvalues: Array, tau: float, base: float) -> bool:
    """True if tau may share the exponentials of the base: what ``response`` leaves out is below ALIKE^2, 2e-17."""
    late, fastest = abs(tau - base), 0.0
    if late > ALIKE * tau:  # of most times that are not alike
        return False
    for k in range(eigenvalues.size):
        fastest = max(fastest, abs(eigenvalues[k].real) + abs(eigenvalues[k].imag))
    return late * fastest <= ALIKE


@compiled
def respond(eigenvalues: Array, tau: Array, start: IntArray, c: Array, force: Array, out: Array) -> None:
    """``response`` at times tau after the starts of c (starts, k) and force (starts, k, P), into out (times, k).

    The exponentials of the last REMEMBERED times are kept: equal cells have the same nodes, in the same order.
    """
    K, P = eigenvalues.size, force.shape[2]
    decay, psi = np.empty((REMEMBERED, K), np.complex128), np.empty((REMEMBERED, K, P), np.complex128)
    base = np.full(REMEMBERED, -math.inf)
    newest = g = -1
    for i in range(tau.size):
        # The time remembered after the last one comes first, then the others.
        for _ in range(REMEMBERED):
            g = (g + 1) % REMEMBERED
            if alike(eigenvalues, tau[i], base[g]):
                break
        else:
            newest = (newest + 1) % REMEMBERED
            g = newest
            base[g] = tau[i]
            basis_at(eigenvalues, tau[i], decay[g], psi[g])
        s = start[i]
        response(eigenvalues, c[s], force[s], decay[g], psi[g], base[g], tau[i] - base[g], out[i])


@inner
def forced_derivatives(eigenvalues: Array, seen: Array, shift: Array, tau: float, d: Array) -> None:
    """Add to d (ORDER + 1,) the derivatives at tau of Re sum_kj seen_kj psi_j(lambda_k, .) + sum_j shift_j tau^j.

    ``seen`` are the forces as a row sees them. A position's row has Re sum_k seen_kj = 0: a force makes no speed.
    """
    P = seen.shape[1]
    psi = np.empty(P, np.complex128)
    for k in range(eigenvalues.size):
        answers(eigenvalues[k], tau, psi)
        for j in range(P):
            x = psi[j]
            d[0] += (seen[k, j] * x).real
            power, factor = tau**j, 1.0 * j  # (tau^j)^(i), and what the next derivative multiplies it by
            for i in range(1, d.size):
                x = eigenvalues[k] * x + power
                d[i] += (seen[k, j] * x).real
                power = factor * tau ** (j - i) if factor > 0.0 else 0.0
                factor = factor * (j - i) if factor > 0.0 else 0.0
    for j in range(shift.size):
        value = shift[j]
        for i in range(min(j + 1, d.size)):
            d[i] += value * tau ** (j - i)
            value *= j - i


@inner
def forced_sizes(eigenvalues: Array, seen: Array, shift: Array, rest: float, b: Array) -> None:
    """Bounds of the same derivatives over [0, rest], into b (ORDER + 1,).

    |psi_j| <= rest^(j+1)/(j+1), and by parts 2 rest^j/|lambda|; then psi' = lambda psi + tau^j.
    """
    b[:] = 0.0
    P = seen.shape[1]
    for k in range(eigenvalues.size):
        size = abs(eigenvalues[k])
        for j in range(P):
            amplitude = abs(seen[k, j])
            if amplitude == 0.0:
                continue
            x = rest ** (j + 1) / (j + 1)
            if x * size > 2.0 * rest**j:
                x = 2.0 * rest**j / size
            b[0] += amplitude * x
            power, factor = rest**j, 1.0 * j
            for i in range(1, b.size):
                x = size * x + power
                b[i] += amplitude * x
                power = factor * rest ** (j - i) if factor > 0.0 else 0.0
                factor = factor * (j - i) if factor > 0.0 else 0.0
    for j in range(shift.size):
        value = abs(shift[j])
        for i in range(min(j + 1, b.size)):
            b[i] += value * rest ** (j - i)
            value *= j - i


# ---------------------------------------------------------------- what float64 loses, for perturbed copies

WIDE = 100  # modes up to which extended precision, which no library is fast in, is used for perturbed copies


class Perturbation(NamedTuple):
    """A change of the size of float64's rounding, for a perturbed copy of the solution.

    frequency: of the modes, see ``Correction.perturbed``; state: of every initial modal amplitude
    relative to the largest in energy, of every modal force, of the change between modes and at every switch
    of every amplitude relative to the terms it is made of, of the time of the switch, and relative to its norm of
    every matrix that damped modes are taken of; seed: of the random signs and sizes.
    """

    frequency: float
    state: float
    seed: int

    def random(self, *place: int) -> np.random.Generator:
        """The random numbers at a place of the calculation, which is named by whole numbers >= 0."""
        # Of a list of integers NumPy takes three times as long to make the same generator.
        return np.random.default_rng(np.array([self.seed, *place], np.uint32))


def rounded_sum(a: Array, b: Array) -> Array:
    """sqrt(sum_k (a_ik b_kj)^2): what rounding takes from the product a b, in units of eps."""
    return np.sqrt(np.abs(a) ** 2 @ np.abs(b) ** 2)


class Correction(NamedTuple):
    """Modes in extended precision, as far as float64 can hold them: ``base`` with the frequencies sqrt(squares) and the
    shapes X (I + E). lost_shapes (n, n) and lost_squares (n,): what rounding takes from E and from the squares, in
    units of eps."""

    base: Modes
    squares: Array
    E: Array
    lost_shapes: Array
    lost_squares: Array

    def perturbed(self, size: float, rng: np.random.Generator) -> Modes:
        """These modes, off by ``size`` and by size/eps times what the correction loses; what strains nothing does so in
        every copy."""
        n = len(self.squares)
        noise = rng.uniform(-1.0, 1.0, (n + 1, n))
        # abs: the change of a square near zero may exceed it.
        lost = size * self.lost_squares * noise.diagonal()
        omega = np.sqrt(np.abs(self.squares * (1.0 + size * noise[n]) + lost))
        omega[self.base.omega == 0.0] = 0.0
        shapes = self.base.shapes + self.base.shapes @ (self.E + size * self.lost_shapes * noise[:n])
        return Modes(omega, shapes, self.base.damping, self.base.mass)


def correction(system: System, springs: Sequence[tuple[Array, float]], base: Modes) -> Correction:
    """Errors of the modes ``base``.

    It shows in S = X^T K X and R = X^T M X in extended precision: with lambda_j = S_jj/R_jj the right
    shapes are X (I + E), E_ij = (S_ij - lambda_j R_ij)/(lambda_j - lambda_i), E_jj = (1 - R_jj)/2, and -R_ij/2
    between equal ones (Ogita and Aishima). A hard stop mixes the slow modes by eps w_max^2/w_1^2.
    """
    wide = np.longdouble if base.omega.size <= WIDE else np.float64
    X, mass, factor = base.shapes.astype(wide), system.mass, system.stiffness_factor
    sizes = np.abs(base.shapes)
    # The factor G, K = G^T G, loses the digits of w_max/w_1, and K those of its square.
    if factor is not None:
        bent = factor.astype(wide) @ X
        S, terms = bent.T @ bent, np.abs(bent.astype(float)).T @ (np.abs(factor) @ sizes)
    else:
        S, terms = X.T @ (system.stiffness.astype(wide) @ X), sizes.T @ (np.abs(system.stiffness) @ sizes)
    # Springs are added in extended precision: beside a hard one, K would lose its soft digits.
    for row, kappa in springs:
        seen = row.astype(wide) @ X
        S = S + wide(kappa) * np.outer(seen, seen)
        terms = terms + kappa * np.outer(np.abs(seen).astype(float), np.abs(row) @ sizes)
    lumped = np.diag(mass)  # n^2 operations for n^3, where the mass is
    R = X.T @ (lumped[:, None] * X if np.count_nonzero(mass) == np.count_nonzero(lumped) else mass.astype(wide) @ X)
    squares = np.diag(S) / np.diag(R)
    apart = (squares[None, :] - squares[:, None]).astype(float)
    # Squares that agree to half the digits of float64 count as equal: a quotient by their difference is rounding.
    near = np.abs(apart) <= 1e-8 * np.maximum(squares[None, :], squares[:, None]).astype(float)
    rigid = base.omega == 0.0  # any two rigid motions are as good as two others
    near |= rigid[:, None] & rigid[None, :]
    apart = np.where(near, 1.0, apart)
    E = np.where(near, -0.5 * R.astype(float), (S - squares * R).astype(float) / apart)
    np.fill_diagonal(E, (0.5 * (1 - np.diag(R))).astype(float))
    # Rounding of S in the precision used, in units of the eps of float64.
    lost = float(np.finfo(wide).eps) / float(np.finfo(float).eps) * (terms + terms.T)
    return Correction(base, squares.astype(float), E, np.where(near, 0.0, lost / apart), np.diag(lost).copy())
