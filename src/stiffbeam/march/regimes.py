"""A regime: the contacts that are closed, and the motion while they stay so as a sum of powers.

With the same contacts closed at every node, a scheme's step is one linear map, and every position at a
node of step l of a stretch is

    w(l) = Re sum_i c_i y_i lambda_i^l,        y_i(n + L) = lambda_i^L y_i(n),

over the eigenvalues lambda_i of the scheme on the system with the closed stops as springs, and over what
drives it: e^{i W dt} for a load of frequency W, 1 for constants and for the closed stops' places g_c. Loads
act through their particular solution of the *discrete* map, so a resonance within SEPARATED is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..basics.arrays import Array, aligned, padded
from ..model.contact import laws
from ..model.contact_law import G1, G2
from ..model.drive import Drive
from ..model.equations import Modal
from ..model.system import System
from .kernels.sums import Regimes
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


SEPARATED = 1e-3  # of a drive from an eigenvalue, relative to the larger of the two lambda - 1
REACH = 1e5  # of the size of the motion: 1e-11 of that is lost then
TURN = 0.1  # radians, or of the time that a decay takes
DAMPED = 1e-25  # what is left of a coordinate that may be forgotten


@dataclass(frozen=True, eq=False)
class Sum:
    """The coordinates of one regime, sorted by |lambda - 1|, and what reads them; not yet padded."""

    shift: Array  # (N,): lambda - 1
    nodes: Array  # (S m, N): the factors c of the contacts' positions at the nodes
    ends: Array  # (C, N): of the channels' positions at the ends of the steps
    rates: Array  # (C, N)
    enter: Array  # (N, a n): y = enter z + held g
    held: Array  # (N, 1 + m + 2 F), g = (1, g_1, .., g_m, cos W_1 t, .., sin W_1 t, ..)
    leave: Array  # (a n, N): z = Re leave y
    slowest: float = 0.0  # the least |lambda - 1| of the scheme on a mode
    reach: float = 0.0  # how far constant loads would put the contacts, every mode in the same direction

    def holds(self, steps: int, size: float) -> bool:
        """True where the sum has the digits of a run of so many steps whose contacts are met at positions of that size.

        A mode that does not turn by TURN in the run drifts: it is the small difference of amplitudes v/omega and
        f/omega^2, and rounding is 1/(omega T)^2 times as large. For omega = 0 there are none. Nor has it them where
        stops hold back what would go REACH times as far.
        """
        return self.slowest * steps >= TURN and (size == 0.0 or self.reach <= REACH * size)


def regime(block: Propagator, system: System, closed: Sequence[int]) -> Sum:
    """The regime of ``system`` with the contacts ``closed``; ``block``: a propagator with harmonic and constant drive.

    Raises NoRegime where there is none.
    """
    coordinates, dt = block.coordinates, Real(block.dt)
    rows = coordinates.rows  # (C, n), free modes
    kappa = np.array([system.contacts[c].stops.stiffness for c in closed], float)
    one = step_map(block, np.sqrt(kappa)[:, None] * rows[np.array(closed, int)])
    shift, V, W, times_counted = eigen(one.transition)
    (n, a), S, m, C = shift.shape, len(block.scheme.nodes), len(system.contacts), len(rows)
    turned_rows = rows.astype(Real) @ one.shapes.T

    # Everything that drives: (a column of g or two, lambda - 1, modal force, offsets of the channels).
    drive = Drive.of(system)
    loads = drive.split(coordinates.loads(system), system.size)[0].astype(Real)
    offsets = drive.offsets(system)[0].astype(Real)
    F = len(drive.frequencies)
    for c, k in zip(closed, kappa, strict=True):  # a spring pulls at offset + row q, not at row q alone
        loads = loads - k * np.outer(offsets[:, c], rows[c])
    loads = loads @ one.shapes.T
    nothing = np.zeros(C, Real)
    drives: list[tuple[int, Any, Any, Any, Any]] = [(0, Real(0.0), Real(0.0), loads[0], offsets[0])]
    for c, k in zip(closed, kappa, strict=True):
        drives.append((1 + c, Real(0.0), Real(0.0), k * turned_rows[c], nothing))
    for f, frequency in enumerate(drive.frequencies):
        W_f = Real(frequency)  # S sin + C cos = Re (C - i S) e^{i W t}
        parts = (x[2 + 2 * f] - 1j * x[1 + 2 * f] for x in (loads, offsets))
        half = np.sin(0.5 * W_f * dt)
        drives.append((1 + m + f, W_f, -2.0 * half**2 + 1j * np.sin(W_f * dt), *parts))

    at_nodes, times = one.nodes @ V, np.array(block.scheme.nodes, Real) * dt  # (n, S, a)
    at_end = (one.rates[:, None] @ V)[:, 0]
    into = W[..., None] * one.shapes[:, None, None]  # (n, a, a, n)
    held = np.zeros((n, a, 1 + m + 2 * F), Complex)
    nodes_of = np.einsum("nsa,cn->scna", at_nodes, turned_rows[:m])
    rates_of = np.einsum("na,cn->cna", at_end, turned_rows)
    ends_of = np.einsum("na,cn->cna", at_nodes[:, -1], turned_rows)
    leave_of = np.einsum("nca,nj->cjna", V, one.shapes)
    columns: list[Sum] = []
    reach = 0.0
    for place, W_f, shift_f, force, offset in drives:
        phase = np.exp(1j * W_f * times)
        act = np.einsum("nsa,s->na", one.of_force, phase) * force[:, None]
        if not (np.any(force) or np.any(offset)):
            continue
        gap = shift_f - shift
        inner = np.einsum("nia,na->ni", W, act)
        acts = np.abs(force)[:, None] > 0.0
        if np.any(acts & (np.abs(gap) <= SEPARATED * np.maximum(np.abs(shift), np.abs(shift_f)))):
            raise NoRegime("a load is in resonance with a mode")
        amplitude = np.where(acts, inner / np.where(acts, gap, 1.0), 0.0)
        response = np.einsum("nai,ni->na", V, amplitude)  # of the kept components
        of_nodes = np.einsum("nsa,na->sn", one.nodes, response)
        of_nodes = of_nodes + np.einsum("nsr,r,n->sn", one.nodes_of_force, phase, force)
        of_rate = np.einsum("na,na->n", one.rates, response) + one.rates_of_force @ phase * force
        if not W_f:
            g = (
                max((abs(x) for x in laws(system.contacts)[place - 1, [G1, G2]] if np.isfinite(x)), default=0.0)
                if place
                else 1.0
            )
            reach += g * float(np.max(np.abs(turned_rows[:m]) @ np.abs(of_nodes[-1]), initial=0.0))
        moved = np.einsum("s,c->sc", phase, offset)
        at_node = of_nodes @ turned_rows[:m].T + moved[:, :m]
        unit = np.zeros((1, held.shape[2]), Complex)
        unit[0, place] = 1.0
        columns.append(
            Sum(
                shift=np.array([shift_f], Complex),
                nodes=at_node.reshape(-1, 1),
                ends=(turned_rows @ of_nodes[-1] + phase[-1] * offset)[:, None],
                rates=(turned_rows @ of_rate + 1j * W_f * phase[-1] * offset)[:, None],
                enter=np.zeros((1, a * n), Complex),
                held=unit,
                leave=np.einsum("na,nj->aj", response, one.shapes).reshape(-1, 1),
            )
        )
        own = -np.einsum("nia,na->ni", W, response.real if W_f else response)
        held[..., place] += own
        if W_f:
            unit[0, place + F] = 1j
            held[..., place + F] += np.einsum("nia,na->ni", W, response.imag)

    chosen = times_counted > 0.0
    twice = times_counted[chosen]
    columns.append(
        Sum(
            shift=shift[chosen],
            nodes=nodes_of.reshape(S * m, n, a)[:, chosen] * twice,
            ends=ends_of[:, chosen] * twice,
            rates=rates_of[:, chosen] * twice,
            enter=into[chosen].reshape(-1, a * n),
            held=held[chosen],
            leave=leave_of.reshape(a * n, n, a)[:, chosen] * twice,
        )
    )
    axes = {"shift": 0, "nodes": 1, "ends": 1, "rates": 1, "enter": 0, "held": 0, "leave": 1}
    order = np.argsort(np.abs(np.concatenate([x.shift for x in columns])), kind="stable")
    joined = {k: np.concatenate([getattr(x, k) for x in columns], axis=axis) for k, axis in axes.items()}
    sorted_ = {k: np.take(joined[k], order, axis=axis) for k, axis in axes.items()}
    return Sum(**sorted_, slowest=float(np.min(np.abs(shift))), reach=reach)


def tables(sums: Sequence[Sum], steps: int, every: int, nodes: int, D: int) -> Regimes:
    """Arrays of the regimes for the kernel, for leaps up to ``steps`` >= ``every``."""
    levels = steps.bit_length()
    R, N = len(sums), padded(max(len(x.shift) for x in sums))
    C, m = sums[0].ends.shape[0], sums[0].nodes.shape[0] // nodes

    def pair(*shape: int) -> Array:
        return aligned((2, R, *shape))

    powers, geometric = pair(levels + 1, N), pair(levels, N)
    slow, alive = np.zeros((2, R, levels), np.int64)
    at_nodes, steps_of, ends, rates = pair(nodes * m, N), pair(nodes * m, N), pair(C, N), pair(C, N)
    large, bent = aligned((R, m, N)), aligned((R, m, N))
    enter, held, leave = pair(N, D), pair(N, padded(sums[0].held.shape[1])), pair(N, D)

    def put(where: Array, r: int, values: Any) -> None:
        index = (r, *(slice(0, size) for size in values.shape))
        where[0][index], where[1][index] = values.real, values.imag

    for r, x in enumerate(sums):
        shift, total = x.shift, np.ones_like(x.shift)
        own, levelled = np.zeros_like(shift), np.empty((2, levels, len(shift)), Complex)
        size = np.abs(x.nodes.reshape(nodes, m, len(shift))).max(axis=0)
        fourth = np.abs(x.shift) ** 4 / 96.0
        large[r, :, : len(shift)], bent[r, :, : len(shift)] = size, size * fourth
        for q in range(levels):
            levelled[:, q] = 1.0 + shift, total
            if every >> q & 1:
                own = own + shift + own * shift  # lambda^every - 1 in the end
            shift, total = shift * (2.0 + shift), total * (2.0 + shift)
        put(powers, r, np.concatenate([levelled[0], 1.0 + own[None]]))
        put(geometric, r, levelled[1])
        # Level 0 is exact; at the others the cubic holds the coordinates it is good for.
        good = 0.25 * fourth * 16.0 ** np.arange(levels)[:, None] <= 1.0
        slow[r] = np.where(good.all(axis=1), len(shift), np.argmin(good, axis=1))
        living = np.abs(levelled[0]) > DAMPED
        alive[r] = len(shift) - np.argmax(living[:, ::-1], axis=1)
        for where, values in ((at_nodes, x.nodes), (steps_of, x.nodes * x.shift), (ends, x.ends), (rates, x.rates)):
            put(where, r, values)
        for where, values in ((enter, x.enter), (held, x.held), (leave, x.leave.T)):
            put(where, r, values)
    return Regimes(slow, alive, powers, geometric, at_nodes, steps_of, large, bent, ends, rates, enter, held, leave)
