"""One step of a scheme on the modes of a system whose closed stops are springs, in extended precision.

Everything that is raised to a power is made so: lambda - 1 is of the size of omega dt, and an error of eps in lambda
is one of eps/(omega dt) in the phase of a radian.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..model.equations import Modal
from .probe import InModes
from .propagator import Propagator

Real, Complex = np.longdouble, np.clongdouble
EXTENDED = np.finfo(np.longdouble).eps < 1e-18
CONDITION = 1e5  # of the eigenvectors, component by component
WHOLE = 1e-9  # of a row of the step, that its eigenvectors make up
GROWTH = 1e-10  # of what counts as not growing, per step; a bound over 1e6 steps is 1e-4 too small at most


class NoRegime(Exception):
    """These contacts cannot be leapt over; the message says why."""


@dataclass(frozen=True, eq=False)
class Map:
    """One step of a scheme on modes (n,) with the kept components (a), in extended precision.

    The modes are those of the system with the closed stops as springs; shapes: (n, n), eta_regime = shapes @
    eta_free. S nodes, each with a force of 1 on every mode in ``of_force``.
    """

    shapes: Array
    transition: Array  # (n, a, a)
    nodes: Array  # (n, S, a): q at the nodes
    rates: Array  # (n, a): q' at the end
    of_force: Array  # (n, S, a): the new state
    nodes_of_force: Array  # (n, S, S): q at the first of node s, of a force at the second
    rates_of_force: Array  # (n, S)


def step_map(block: Propagator, springs: Array) -> Map:
    """The map of the scheme of ``block`` with springs (k, n), sqrt(kappa) times contact rows, on its modes."""
    assert isinstance(block.coordinates, InModes)
    scheme, basis, dt = block.scheme, block.coordinates.basis, Real(block.dt)
    omega, shapes = stiffened(basis.omega, springs)
    if len(springs) and np.ptp(basis.damping) > 1e-12 * np.max(np.abs(basis.damping)):
        raise NoRegime("the damping couples the modes of the closed contacts")
    equation, n, S = Modal(omega, basis.damping.astype(Real)), len(omega), len(scheme.nodes)
    a = block.mix.shape[1]

    def step(z: Array, reactions: Array, equation: Modal = equation, dt: Any = dt) -> tuple[Array, Array]:
        new, stages = scheme.step(equation, dt, z, list(np.zeros_like(reactions)), list(reactions))
        return np.asarray(new), np.array(stages)

    z, forces = np.zeros((a, a + S, n), Real), np.zeros((S, a + S, n), Real)
    z[np.arange(a), np.arange(a)] = 1.0
    forces[np.arange(S), a + np.arange(S)] = 1.0
    new, stages = step(z, forces)
    if not len(springs):
        # A third of the input gives a third to rounding: whose, is seen beside the step in double precision.
        rounding = np.sum(np.abs(new - 3 * step(z / 3, forces / 3)[0]), axis=-1)
        coarse = step(z.astype(float), forces.astype(float), basis.equation, block.dt)[0]
        double = np.sum(np.abs(new - coarse), axis=-1)
        seen = double > 0.0
        if new.dtype != Real or (np.any(seen) and np.quantile(rounding[seen] / double[seen], 0.75) > 0.05):
            raise NoRegime("the scheme's step is not carried out in the precision it is given")
        if np.max(np.abs(stages[-1, 0] - new[0])) > 1e-15 * np.max(np.abs(new[0])):
            raise NoRegime("the scheme's last node is not the end of the step")
    else:
        # A closed stop is a spring only to a scheme that weighs stiffness and reactions alike.
        x = np.random.default_rng(0).normal(size=(a, 1, n)).astype(Real)
        sprung, at_nodes = step(x, np.zeros((S, 1, n), Real))
        pull = -(at_nodes[:, 0] @ shapes @ springs.T) @ springs
        free = Modal(basis.omega.astype(Real), basis.damping.astype(Real))
        loose = step(x @ shapes, pull, free)[0] @ shapes.T
        if np.any(np.abs(sprung - loose).max(axis=-1) > 1e-12 * np.abs(sprung).max(axis=-1)):
            raise NoRegime("the scheme does not take a reaction as it takes stiffness")
    keep, of_force = block.keep, slice(a, None)
    mixed = np.einsum("ce,ebj->cbj", refined(block, new, stages), new)
    return Map(
        shapes,
        transition=np.moveaxis(mixed[:, keep], 2, 0),
        nodes=np.moveaxis(stages[:, 0][:, keep], 2, 0),
        rates=new[1, keep].T,
        of_force=np.moveaxis(mixed[:, of_force], (2, 1), (0, 1)),
        nodes_of_force=np.moveaxis(stages[:, 0, of_force], 2, 0),
        rates_of_force=new[1, of_force].T,
    )


def refined(block: Propagator, new: Array, stages: Array) -> Array:
    """``block.mix`` with the rounding of its least squares taken out: what of a left-out component goes to others."""
    keep, mix, a = block.keep, block.mix.astype(Real), block.mix.shape[1]
    effects = np.concatenate([np.moveaxis(x[:, :a], 1, -1).reshape(-1, a) for x in (new, stages[:, 0])])
    scale = np.max(np.abs(effects), axis=1)
    effects = effects[scale > 0.0] / scale[scale > 0.0, None]
    size = np.max(np.abs(effects[:, keep]), axis=0)
    kept = effects[:, keep] / size
    for e in set(range(a)) - set(keep.tolist()):
        left = effects[:, e] - kept @ (mix[:, e] * size)
        mix[:, e] += np.linalg.lstsq(kept.astype(float), left.astype(float), rcond=None)[0] / size
    return mix


def stiffened(omega: Array, springs: Array) -> tuple[Array, Array]:
    """Frequencies and orthogonal shapes (n, n), eta' = shapes @ eta, of diag(omega^2) + springs^T springs."""
    if not len(springs):
        return omega.astype(Real), np.eye(len(omega), dtype=Real)
    _, _, shapes = np.linalg.svd(np.vstack([np.diag(omega), springs]), full_matrices=False)
    shapes = shapes[::-1].astype(Real)
    rows = np.vstack([np.diag(omega), springs]).astype(Real)
    # Two sweeps of first-order perturbation theory: the error of the decomposition is squared by each.
    for _ in range(2):
        turned = shapes @ rows.T
        product, unit = turned @ turned.T, shapes @ shapes.T
        squares = np.diag(product) / np.diag(unit)
        gap = squares[None, :] - squares[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = (squares[:, None] * unit - product) / gap
        close = np.abs(gap) <= 1e-9 * (squares[:, None] + squares[None, :])
        turn = np.where(close, -0.5 * unit, turn)
        np.fill_diagonal(turn, 0.5 - 0.5 * np.diag(unit))
        shapes = shapes + turn @ shapes
    squares = np.sum((shapes @ rows.T) ** 2, axis=1)
    return np.sqrt(np.maximum(squares, 0.0)), shapes


def eigen(transition: Array) -> tuple[Array, Array, Array, Array]:
    """lambda - 1 (n, a), vectors V (n, a, a) and V^-1 of matrices (n, a, a), in extended precision; and how often
    each counts: 1 where it is real, 2 and 0 for two that are conjugate."""
    identity = np.eye(transition.shape[-1])
    near_one = transition - identity.astype(Real)
    found, vectors = np.linalg.eig(near_one.astype(float))
    V = vectors.astype(Complex)
    try:
        W = np.linalg.inv(vectors).astype(Complex)
    except np.linalg.LinAlgError:
        raise NoRegime("two amplification factors of a mode are one") from None
    shift = np.zeros(0)
    for _ in range(4):
        for _ in range(2):
            W = W @ (2.0 * identity - V @ W)
        turned = W @ near_one @ V
        shift = np.diagonal(turned, axis1=1, axis2=2)
        gap = shift[:, None, :] - shift[:, :, None]
        apart = np.abs(gap) > 1e-12 * (np.abs(shift)[:, None, :] + np.abs(shift)[:, :, None])
        change = np.where(apart, turned / np.where(apart, gap, 1.0), 0.0)
        V = V + V @ change
    W = W @ (2.0 * identity - V @ W)
    condition = np.max(np.sum(np.abs(V.transpose(0, 2, 1)) * np.abs(W), axis=2))
    if not condition < CONDITION:
        raise NoRegime(f"two amplification factors of a mode are one to rounding (condition {condition:.1e})")
    # A triangular block of two equal factors has condition 1, component by component, and is no sum of powers.
    missing = np.abs((V * shift[:, None, :]) @ W - near_one)
    if np.any(missing > WHOLE * np.max(np.abs(near_one), axis=2, keepdims=True)):
        raise NoRegime("the amplification factors of a mode do not make up its step")
    if np.max(np.abs(1.0 + shift)) > 1.0 + GROWTH:
        raise NoRegime("the scheme grows")
    return shift.copy(), V, W, 1.0 + np.sign(np.imag(found))
