"""The march against rigid stops: any scheme as a linear step and a complementarity problem at each node."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..kernels.march import AT_A_STOP, OVERFLOW, WHERE_CLOSED, WHERE_PREDICTED, Linear, rigid_steps, solve_node
from ..model.contact import Contact, Stops, channel_motion
from ..model.modes import decoupled_modes
from ..model.system import System
from ..model.time_functions import TimeFunction, evaluate, offset_rate, offset_values
from ..schemes import RigidScheme, Scheme
from ..schemes.scheme import AHEAD, POSITION, RESTITUTED, VELOCITY
from ..schemes.scheme import WHERE_CLOSED as CONDITION
from ..trajectory.recorder import reaction_counts
from ..trajectory.records import ContactRecord
from .block_march import initial_channels
from .probe import Coordinates, StepMap

STEPS_PER_PIECE = 4096
FREE_STEPS = 200  # after which it has all that one unit force will give it
CODES = {POSITION: AT_A_STOP, RESTITUTED: AT_A_STOP, VELOCITY: WHERE_PREDICTED, CONDITION: WHERE_CLOSED}
GROWTH = 1e-3  # a step, beyond the rounding of a multiple eigenvalue


Piece = tuple[int, Array, Array, Array]  # steps, those of the piece among them; q and q' at their ends, mean reactions


def rigid_run(system: System, scheme: Scheme, dt: float, steps: int, every: int | None, since: int) -> dict[str, Any]:
    """Fields of the Trajectory; impacts are counted after step ``since``."""
    diverged, none = np.nan, np.zeros(len(system.contacts))
    pieces = [[x[None] for x in (*initial_channels(system), none)]]  # positions, velocities, reactions
    for t, q, v, reactions in rigid_states(system, scheme, dt, steps):
        motion = [channel_motion(row, offset, t, q, v) for row, offset in system.channels]
        positions, velocities = (np.stack(x, axis=1) for x in zip(*motion, strict=True))
        # The first step beyond the bound ends the run.
        bad = ~np.all(np.abs(positions) < OVERFLOW, axis=1)
        if np.any(bad):
            diverged = float(t[np.argmax(bad)])
            break
        pieces.append([x[1:] for x in (positions, velocities, reactions)])
    u, v, R = map(np.concatenate, zip(*pieces, strict=True))
    outputs, tip, contacts = slice(None if every else 0, None, every), system.tip_channel, []
    for c, contact in enumerate(system.contacts):
        counts = reaction_counts(contact.stops, dt, u[:, c], R[1:, c], since)
        contacts.append(ContactRecord(contact.stops, u[outputs, c], v[outputs, c], R[outputs, c], **counts))
    fields = {"t": (np.arange(len(u)) * dt)[outputs], "tip": u[outputs, tip], "tip_velocity": v[outputs, tip]}
    return fields | {"contacts": tuple(contacts), "diverged": diverged}


def rigid_states(system: System, scheme: Scheme, dt: float, steps: int) -> Iterator[tuple[Array, Array, Array, Array]]:
    """See ``Pieces``: the forces are the reactions of the steps that end there."""
    last, none = (system.q0[None], system.v0[None]), np.full((1, len(system.contacts)), np.nan)
    for done, *states, reactions in _pieces(system, scheme, dt, steps):
        q, v = (np.concatenate(both) for both in zip(last, states, strict=True))
        yield (done + 1 - len(q) + np.arange(len(q))) * dt, q, v, np.concatenate([none, reactions])
        last = q[-1:], v[-1:]


def _pieces(system: System, scheme: Scheme, dt: float, count: int) -> Iterator[Piece]:
    """The run in pieces."""
    basis, done, history = decoupled_modes(system), 0, []
    view = Coordinates(system, basis)
    y = view.start(system.q0, system.v0)
    # A multistep scheme begins with its starter, whose states are its history, newest first.
    if scheme.starter is not None:
        history = [y]
        for piece, z in _march(view, system, scheme.starter, dt, y, [y], 0, min(count, scheme.history - 1)):
            history.insert(0, z[:2])
            done = piece[0]
            yield piece
    if done < count:
        for piece, _ in _march(view, system, scheme, dt, y, history or [y], done, count - done):
            yield piece


def _march(
    view: Coordinates, system: System, scheme: Scheme, dt: float, y: Array, history: list[Array], first: int, count: int
) -> Iterator[tuple[Piece, Array]]:
    m, S, n = len(system.contacts), len(scheme.nodes), view.rows.shape[1]
    is_rigid = isinstance(scheme, RigidScheme)
    kinds = scheme.conditions if is_rigid else (POSITION,) * S
    loads = np.array([view.vector(vector) for vector, _ in system.loads]).reshape(-1, n)
    # All that the kernel needs of the scheme, from its step with unit states and forces.
    linear, pulses, shifts_by_load = _probed(view, scheme, dt, kinds)
    weights = _weights(scheme, dt)
    force = np.array([evaluate(f, np.asarray(first * dt)) for _, f in system.loads]) @ loads
    if is_rigid:
        z = scheme.start(view.equation, dt, y, force)
    else:
        # The initial force includes the reactions of contacts that begin at rest on their stops.
        force = force + _first_reactions(view, y, force) if first == 0 else force
        z = scheme.initial(view.equation, history, force)
    shape, z = z.shape, np.ascontiguousarray(z.reshape(-1))
    for start in range(first, first + count, STEPS_PER_PIECE):
        length = min(STEPS_PER_PIECE, first + count - start)
        at = (start + np.arange(length)) * dt
        # Loads at the nodes, and what they and moving stops add to the arguments of the nodes.
        nodes = at[:, None] + np.array(scheme.nodes) * dt
        values = np.array([evaluate(f, nodes) for _, f in system.loads]).reshape(len(system.loads), length, S)
        values = np.moveaxis(values, 0, 1).reshape(length, -1)
        shifts = (values @ shifts_by_load).reshape(length, S, m) + _offset_shifts(system, kinds, at, nodes, dt)
        predicted = np.array([offset_values(c.offset, at + AHEAD * dt) for c in system.contacts]).reshape(m, length).T
        path, reactions = rigid_steps(linear, values @ pulses, shifts, np.ascontiguousarray(predicted), z)
        states = path.reshape(length, *shape)
        # Each node counts by the momentum that its reaction brings in the end.
        means, both = np.einsum("s,ksc->kc", weights, reactions), np.moveaxis(states[:, :2], 1, 0).copy()
        yield (start + length, *view.states(both), means), states[-1]


def _probed(view: Coordinates, scheme: Scheme, dt: float, kinds: tuple[str, ...]) -> tuple[Linear, Array, Array]:
    """The step as arrays, and what unit loads at nodes add to the state, (L S, D), and to the arguments, (L S, S m).
    Raises InputError where a reaction does not move its own argument."""
    step = StepMap(scheme, view, dt, rated=True, reduced=False)
    (parts, g, k), S, stops = step.reading.shape, len(kinds), [contact.stops for contact in view.system.contacts]
    m, D = len(stops), parts * k
    # Conditions on velocities and the restituted position read x_new + e x_old, which a step returns in the places of
    # q and q'.
    e = np.array([0.0 if s.restitution is None else s.restitution for s in stops])
    old = np.array([np.zeros(m) if kind == POSITION else e for kind in kinds])

    def arguments(readings: Array) -> Array:
        x_new, x_old = readings[:, step.readers.at_nodes], readings[:, step.readers.node_rates]
        return (x_new + old.ravel() * x_old).reshape(len(readings), S, m)

    reading = arguments(step.reading.transpose(2, 0, 1).reshape(D, g))
    ahead = view.columns[:, None] * scheme.predict(view.equation, dt, view.units(len(step.keep)))[-1]
    pushed, moved = step.push.transpose(2, 1, 0).reshape(-1, S, D), arguments(step.at_once.T)
    compliance = moved[: m * S].reshape(m, S, S, m).transpose(1, 2, 0, 3)  # [node, later node, reaction, argument]
    if m:
        _require_giving_way(scheme, compliance)
    # Where the stops stand in the arguments: at (1 + e) g for x_new + e x_old, at 0 for velocities.
    ends = np.array([[s.lower_bound, s.upper_bound] for s in stops]).reshape(m, 2)
    codes = [CODES[kind] for kind in kinds]
    bounds = [(1.0 + x[:, None]) * ends if c == AT_A_STOP else np.where(np.isfinite(ends), 0.0, ends)
              for c, x in zip(codes, old, strict=True)]  # fmt: skip
    linear = Linear(
        blocks=step.transition.transpose(1, 2, 0) if view.basis else np.zeros((0, 0, parts)),
        matrix=np.zeros((0, 0)) if view.basis else step.transition[0],
        reading=reading.transpose(1, 2, 0),
        predicting=(ahead if view.basis else np.sum(ahead, axis=-1)).reshape(m, D),
        responses=pushed[:m].transpose(1, 0, 2),
        compliance=compliance,
        kinds=np.array(codes),
        bounds=np.array(bounds),
        stops=ends,
    )
    by_loads = moved[m * S :].reshape(len(moved) - m * S, S * m)
    return Linear(*map(np.ascontiguousarray, linear)), pushed[m:].reshape(-1, D), by_loads


def _require_giving_way(scheme: Scheme, compliance: Array) -> None:
    # The complementarity problem of a node has exactly one solution if its compliance is positive definite, by its
    # symmetric part: damping that couples the modes can make it unsymmetric.
    for s in range(len(compliance)):
        least, most = np.linalg.eigvalsh(0.5 * (compliance[s, s] + compliance[s, s].T))[[0, -1]]
        if not least > 1e-12 * most or not most > 0.0:
            rule = "move the argument of every node by the reaction there, each contact on its own, for rigid stops"
            remedy = "use MoreauJean, and contacts that do not follow from each other"
            raise InputError("scheme", str(scheme), rule, remedy)


def _weights(scheme: Scheme, dt: float) -> Array:
    """(S,), the momentum over dt that a free mass takes in the end from a unit reaction at each node of a step.

    Raises InputError for a scheme of compliant stops where reactions grow from step to step. Held on a stop, q = 0 at
    every node, the mass goes by z <- (T - P G^-1 R) z with the responses T, P of the state and R, G of the positions at
    the nodes. The trapezoidal rule, whose reactions swing about their mean for ever, has the spectral radius 1.
    """
    mass = System.from_matrices([[1.0]], [[0.0]], contacts=[Contact(np.ones(1), Stops(upper=1.0, stiffness=np.inf))])
    free = StepMap(scheme, Coordinates(mass, decoupled_modes(mass)), dt, reduced=False)
    T, P, at_nodes = free.transition[0], free.push[0], free.readers.at_nodes
    if not isinstance(scheme, RigidScheme):
        held = T - P @ np.linalg.solve(free.at_once[at_nodes], free.reading[0, at_nodes])
        if np.max(np.abs(np.linalg.eigvals(held))) > 1.0 + GROWTH:
            rule = "have reactions that do not grow while a contact lasts, for rigid stops"
            raise InputError("scheme", str(scheme), rule, "use MoreauJean")
    # Forces act in the first step only; a scheme may spread their momentum over later ones.
    return (np.linalg.matrix_power(T, FREE_STEPS) @ P)[1] / dt


def _offset_shifts(system: System, kinds: tuple[str, ...], at: Array, nodes: Array, dt: float) -> Array:
    """Share of moving stops in the arguments, (K, S, m)."""
    shifts = np.zeros((len(at), len(kinds), len(system.contacts)))
    for c, contact in enumerate(system.contacts):
        o, e = contact.offset, contact.stops.restitution or 0.0
        for s, kind in enumerate(kinds if o is not None else ()):
            if kind == POSITION:
                shifts[:, s, c] = offset_values(o, nodes[:, s])
            elif kind == RESTITUTED:
                shifts[:, s, c] = offset_values(o, nodes[:, s]) + e * _places_before(o, at, dt)
            else:
                shifts[:, s, c] = offset_rate(o, nodes[:, s]) + e * offset_rate(o, at)
    return shifts


def _first_reactions(view: Coordinates, y: Array, force: Array) -> Array:
    """The reactions at t = 0 of contacts at rest on their stops, on the unknowns."""
    rows, contacts = view.columns, view.system.contacts
    # In accelerations: a contact at rest on its stop must not accelerate into it, any other is free.
    law = np.full((len(rows), 3), np.inf)
    r = np.empty(len(rows))
    acceleration = view.equation.acceleration(y, force)
    for c, contact in enumerate(contacts):
        u = float(rows[c] @ y[0] + offset_values(contact.offset, 0.0))
        rate = float(rows[c] @ y[1] + offset_rate(contact.offset, 0.0))
        rest = abs(rate) == 0.0
        law[c, 1] = 0.0 if rest and u <= contact.stops.lower_bound else -np.inf
        law[c, 2] = 0.0 if rest and u >= contact.stops.upper_bound else np.inf
        # The position against a moving stop accelerates with it.
        pull = 0.0 if contact.offset is None else float(contact.offset.acceleration(0.0))  # type: ignore[union-attr]
        r[c] = rows[c] @ acceleration + pull
    if not len(rows):
        return np.zeros_like(force)
    compliance = view.equation.solve(0.0, 0.0, rows) @ rows.T
    return solve_node(r, np.ascontiguousarray(compliance), law) @ rows


def _places_before(offset: TimeFunction | None, at: Array, dt: float) -> Array:
    """o(t - dt); before t = 0 such that (o(dt) - o(-dt))/(2 dt) is the rate there, as a scheme takes the positions."""
    places = np.array(offset_values(offset, np.maximum(at - dt, 0.0)), float)
    if at[0] == 0.0:
        places[0] = float(offset_values(offset, dt)) - 2.0 * dt * float(offset_rate(offset, 0.0))
    return places
