"""One contact regime of a system with damping, several contacts or records: its sums of complex exponentials.

    q(t_0 + tau) = Re [ W y(tau) ] + Re [ X exp(i Omega (t_0 + tau)) ]
    y' = Lambda y + push r(t),  y(tau) = c exp(lambda tau) + sum_j f_j psi_j(lambda, tau)

with one eigenvalue of each conjugate pair. Where eigenvalues meet each other or a drive i Omega, a ``Chain`` has these
y instead, and X leaves out what it answers: a resonant answer grows, a response to it does not exist.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..basics.arrays import Array
from ..model.drive import Drive
from ..model.graded import congruence, uncoupled
from ..model.modes import Modes, undamped_modes
from ..model.system import System
from .chains import Chain
from .polynomial_answer import forced
from .rounding import Perturbation, rounded_sum
from .spectrum import Group, groups

CLOSE = 0.01  # |lambda - i Omega|/(|lambda| + Omega) below which a mode answers a drive from rest
UNFELT = 1e-14  # of the terms of a modal force: less is the rounding of none
Complex = Any  # arrays of complex128


@dataclass(frozen=True, eq=False)
class Regime:
    """eigenvalues: lambda (k,), those of chains among them. W, W_rate: (n, k), q and q' of the homogeneous part.
    from_q, from_v: (k, n), c = from_q q + from_v q' of the homogeneous part. response, response_rate: X (n, 1 + F)
    complex, to the constant and to exp(i Omega t) of every drive frequency, and what it adds to q'.
    push: (k, R), y' = lambda y + push r(t) under the records r."""

    eigenvalues: Complex
    W: Complex
    W_rate: Complex
    from_q: Complex
    from_v: Complex
    response: Complex
    response_rate: Complex
    push: Complex
    chains: tuple[Chain, ...] = ()

    @cached_property
    def single(self) -> NDArray[np.bool_]:
        """(k,), whether a coefficient is no part of a chain."""
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

    def ahead(self, c: Complex, spin: Complex, force: Complex, tau: Array) -> Complex:
        """y (p, k) at tau (p,) after starts with the coefficients c (p, k), where the drives are ``spin`` (p, 1 + F)
        and the records push by sum_j force_j tau^j (p, k, P)."""
        y = np.exp(np.multiply.outer(tau, self.eigenvalues)) * c
        if force.shape[2]:
            answer = np.empty_like(y)
            forced(self.eigenvalues, np.ascontiguousarray(tau), np.ascontiguousarray(force), answer)
            y += answer
        for chain in self.chains:
            y[:, chain.modes] = chain.ahead(c, spin, force, tau)
        return y

    def free(self, c: Complex, tau: float) -> Complex:
        """The homogeneous coefficients (k, columns) at tau after c."""
        still = np.zeros((c.shape[1], 1 + max((int(np.max(x.drives, initial=0)) for x in self.chains), default=0)))
        none = np.zeros((c.shape[1], len(c), 0))
        return self.ahead(c.T, still, none, np.full(c.shape[1], tau)).T


def regime_of(
    system: System,
    drive: Drive,
    chi: tuple[int, ...],
    span: float,
    perturbation: Perturbation | None = None,
    basis: Modes | None = None,
) -> Regime:
    """The regime with every contact on the given side, 0 free; span: the longest time that is asked for; basis: its
    undamped modes, of a perturbed copy where that is asked for."""
    closed = [(i, c, side) for i, (c, side) in enumerate(zip(system.contacts, chi, strict=True)) if side]
    springs = tuple((c.row, c.stops.spring(side)[0]) for _, c, side in closed)
    rng = None if perturbation is None else np.random.default_rng([perturbation.seed, *(side + 1 for side in chi)])
    basis = undamped_modes(system, springs) if basis is None else basis
    omega, shapes = basis.omega, basis.shapes
    force, rest = drive.split(system.loads, system.size)
    offsets, moving = drive.offsets(system)
    records, moved = drive.recorded(rest, system.size), drive.recorded(moving, offsets.shape[1])
    C = system.damping.copy()
    for i, contact, side in closed:
        # sigma = kappa (gap - row q - offset) - c (row q' + offset'): the second terms are in the matrices.
        kappa, constant = contact.stops.spring(side)
        c = float(contact.stops.damping)
        C += c * np.outer(contact.row, contact.row)
        force = force - np.outer(kappa * offsets[:, i] + c * drive.derivative().T @ offsets[:, i], contact.row)
        records = records - kappa * np.outer(moved[:, i], contact.row)
        force[0] += constant * contact.row
    modal_force = phasors(force) @ shapes  # (1 + F, n)
    terms_of_force = np.abs(phasors(force)) @ np.abs(shapes)
    push = records @ shapes  # (R, n)
    damping = _modal_damping(C, omega, shapes)
    to_modal = shapes.T @ system.mass
    order = np.arange(system.size)
    if rng is not None and perturbation is not None:
        size = perturbation.state
        modal_force += size * rounded_sum(phasors(force), shapes) * rng.uniform(-1.0, 1.0, modal_force.shape)
        push += size * rounded_sum(records, shapes) * rng.uniform(-1.0, 1.0, push.shape)
        terms = rounded_sum(shapes.T, rounded_sum(C, shapes))
        damping += np.where(damping == 0.0, 0.0, size * terms * rng.uniform(-1.0, 1.0, damping.shape))
        # Shapes that are not quite inverse to the way into them err alike at every switch.
        to_modal += size * rounded_sum(shapes.T, system.mass) * rng.uniform(-1.0, 1.0, to_modal.shape)
        shapes = shapes * (1.0 + size * rng.uniform(-1.0, 1.0, shapes.shape))
        order = rng.permutation(order)  # the eigenvalue algorithm rounds otherwise
    forces = modal_force[:, order], terms_of_force[:, order]
    ordered = omega[order], shapes[:, order], to_modal[order], *forces, push[:, order]
    size = 0.0 if perturbation is None else perturbation.state
    return _assembled(drive, *ordered, damping[np.ix_(order, order)], span, size, rng)


def _modal_damping(C: Array, omega: Array, shapes: Array) -> Array:
    """shapes^T C shapes without its rounding beside the diagonal and of rigid-body motions."""
    rigid = omega == 0.0
    return uncoupled(C, shapes, congruence(C, shapes) if np.any(rigid) else shapes.T @ C @ shapes, rigid)


def _assembled(
    drive: Drive, omega: Array, shapes: Array, to_modal: Array, force: Complex, terms: Array, push: Array,
    damping: Array, span: float, size: float, rng: np.random.Generator | None,
) -> Regime:  # fmt: skip
    """From the modes: force (1 + F, n) of the drives, sums of terms of the sizes ``terms``, push (R, n) of the records,
    all modal. size, rng: as in ``groups``."""
    n, rates = len(omega), 1j * np.array([0.0, *drive.frequencies])
    s, found = groups(omega, damping, span, size, rng)
    begins = np.cumsum([0, *(len(group.T) for group in found)])
    chains = [
        _chain(g, np.arange(a, a + len(g.T)), force, terms, rates, span) for g, a in zip(found, begins, strict=False)
    ]
    eigenvalues = np.concatenate([np.linalg.eigvals(g.T) for g in found])
    # With or without a force on them: of modes close to a drive the response is not asked for.
    apart = np.abs(eigenvalues[:, None] - rates)
    close = np.any(apart <= CLOSE * (np.abs(eigenvalues)[:, None] + np.abs(rates)), axis=0)
    resonant = np.unique(np.concatenate([np.flatnonzero(close), *(chain.drives for chain in chains)]))
    response = np.empty((2 * n, len(rates)), complex)
    for k, rate in enumerate(rates):
        response[:, k] = (
            _without(found, chains, force[k], terms[k], rates, k)
            if k in resonant or np.any(omega == 0.0)
            else _answer(omega, s, damping, force[k], rate)
        )
    weights = np.concatenate([np.full(len(g.T), 2.0 if g.paired else 1.0) for g in found])
    V, L = np.hstack([g.V for g in found]) * weights, np.vstack([g.L for g in found])
    return Regime(
        np.minimum(np.real(eigenvalues), 0.0) + 1j * np.imag(eigenvalues),
        shapes @ (V[:n] / s[:, None]),
        shapes @ V[n:],
        (L[:, :n] * s) @ to_modal,
        L[:, n:] @ to_modal,
        shapes @ (response[:n] / s[:, None]),
        shapes @ response[n:],
        L[:, n:] @ push.T,
        tuple(chain for chain in chains if len(chain.T) > 1 or len(chain.drives)),
    )


def _chain(group: Group, modes: NDArray[np.int64], force: Complex, terms: Array, rates: Complex, span: float) -> Chain:
    """A group with the drives in resonance with it, or the same as it over the span; what nothing holds or damps
    answers every drive."""
    n, values = force.shape[1], np.linalg.eigvals(group.T)
    pull = group.L[:, n:] @ force.T  # (k, 1 + F)
    if group.paired:
        pull = pull / 2.0  # exp(i Omega t) is half of the cosine
    pulled = np.any(np.abs(pull) > UNFELT * (np.abs(group.L[:, n:]) @ terms.T), axis=0)
    apart = np.min(np.abs(values[:, None] - rates), axis=0)
    near = apart <= CLOSE * (np.min(np.abs(values)) + np.abs(rates))
    if not group.paired:
        near |= (apart <= 1.0 / span) | (np.min(np.abs(values)) <= 1.0 / span)
    drives = np.flatnonzero(near & pulled)
    return Chain(modes, group.T, drives, rates[drives], pull[:, drives])


def _answer(omega: Array, s: Array, damping: Array, force: Complex, rate: complex) -> Complex:
    """The response (2n,) to force exp(rate t), row by row to size one, so that stiff modes do not drown the soft."""
    matrix = np.diag(omega**2 + rate**2) + rate * damping
    size = np.maximum(omega**2, np.abs(rate) ** 2)
    size = np.where(size > 0.0, size, 1.0)
    eta = np.linalg.solve(matrix / size[:, None], force / size)
    return np.concatenate([s * eta, rate * eta])


def _without(found: list[Group], chains: list[Chain], force: Complex, terms: Array, rates: Complex, k: int) -> Complex:
    """The response to drive k of all groups but those it is in resonance with: -V (T - i Omega)^-1 L force."""
    n, total = len(force), np.zeros(2 * len(force), complex)
    for group, chain in zip(found, chains, strict=True):
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
