"""The march against rigid stops: the linear step of a scheme and a complementarity problem at each node."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..kernels.library import AT_A_STOP, OVERFLOW, WHERE_CLOSED, WHERE_PREDICTED, rigid_steps
from ..model.contact import Contact, Stops
from ..model.modes import decoupled_modes
from ..model.system import System
from ..model.time_functions import TimeFunction, evaluate
from ..schemes import RigidScheme
from ..schemes.rigid import AHEAD, POSITION, RESTITUTED, VELOCITY
from ..schemes.rigid import WHERE_CLOSED as CONDITION
from ..trajectory.recorder import impacts_in
from ..trajectory.records import ContactRecord, Ledger, step_ledger
from .propagator import Coordinates, StepMap

STEPS_PER_PIECE = 4096
FREE_STEPS = 200  # after which it has all that one unit force will give it
CODES = {POSITION: AT_A_STOP, RESTITUTED: AT_A_STOP, VELOCITY: WHERE_PREDICTED, CONDITION: WHERE_CLOSED}


class RigidStepper:
    """A scheme for rigid stops on a system in coordinates: what all members of an ensemble share, as of ``Stepper``."""

    kind = "rigid steps"

    def __init__(self, coordinates: Coordinates, scheme: RigidScheme, dt: float) -> None:
        self.coordinates, self.scheme, self.dt = coordinates, scheme, dt
        self.one, self.weights = StepMap(scheme, coordinates, dt, rated=True, reduced=False), _weights(scheme, dt)

    def run(self, member: System, steps: int, every: int | None, since: int) -> dict[str, Any]:
        """Fields of the Trajectory of a member; impacts are counted after step ``since``."""
        diverged, none = np.nan, np.zeros(len(member.contacts))
        start = *member.motions(0.0, member.q0, member.v0), none  # positions, velocities, reactions
        pieces = [[x[None] for x in start]]
        for t, q, v, reactions in self.states(member, steps):
            positions, velocities = member.motions(t, q, v)
            # The first step beyond the bound ends the run.
            bad = ~np.all(np.abs(positions) < OVERFLOW, axis=1)
            if np.any(bad):
                diverged = float(t[np.argmax(bad)])
                break
            pieces.append([x[1:] for x in (positions, velocities, reactions)])
        u, v, R = map(np.concatenate, zip(*pieces, strict=True))
        outputs, tip = slice(None if every else 0, None, every), member.tip_channel
        each = zip(member.contacts, u.T, v.T, R.T, strict=False)  # of the channels the contacts are the first
        records = (self._record(contact.stops, *x, outputs=outputs, since=since) for contact, *x in each)
        fields = {"t": (np.arange(len(u)) * self.dt)[outputs], "tip": u[outputs, tip], "tip_velocity": v[outputs, tip]}
        return fields | {"contacts": tuple(records), "diverged": diverged}

    def _record(self, stops: Stops, u: Array, v: Array, R: Array, outputs: slice, since: int) -> ContactRecord:
        """Record of a contact from positions, velocities and mean reactions R (k + 1,), R[n] of the step before n.

        An impact is a sequence of steps with a reaction of one sign: it begins with the first and ends with the last of
        them. An impact before a contact at t = 0 has opened is part of that contact. A rigid stop has no largest force
        but an impulse, so peaks are NaN. The largest mean of a step, ``max(abs(force))``, grows like 1/dt.
        """
        between = (u > stops.law.g1) & (u < stops.law.g2)
        # The contact at t = 0 lasts to the step before the first position between the stops.
        held = int(np.argmax(between)) if np.any(between) else len(u)
        t, size = np.arange(since, len(R)) * self.dt, np.abs(R[since:]) * self.dt
        size[0] = 0.0
        counted, sides, open_to = R[since + 1 :], -np.sign(R[since:]), max(0, held - since)
        impacts = impacts_in(t, sides, size, lambda k, side: t[k - 1], not since, open_to)
        share, peak = float(np.mean(counted != 0.0)) if len(counted) else 0.0, np.nan if np.any(counted) else 0.0
        kept = u[outputs], v[outputs], R[outputs]
        return ContactRecord(stops, *kept, impacts, share, peak, float(np.sum(np.abs(counted)) * self.dt))

    def ledger(self, member: System, steps: int, outputs: Array) -> Ledger:
        """Energy balance of every step of a member at the times ``outputs``."""
        return step_ledger(member, self.states(member, steps), outputs, impacts=self.scheme.restitutes)

    def states(self, member: System, steps: int) -> Iterator[tuple[Array, Array, Array, Array]]:
        """A run at every step, see ``Pieces``: the forces are the mean reactions of the steps that end there."""
        coordinates, scheme, dt, m = self.coordinates, self.scheme, self.dt, len(member.contacts)
        linear, pulses, shifts_by_load = self._linear(member)
        y = coordinates.start(member.q0, member.v0)
        z = scheme.start(coordinates.equation, dt, y, coordinates.load(member, 0.0))
        shape, z = z.shape, np.ascontiguousarray(z.reshape(-1))
        last = member.q0[None], member.v0[None], np.full((1, m), np.nan)
        for start in range(0, steps, STEPS_PER_PIECE):
            t = np.arange(start, min(start + STEPS_PER_PIECE, steps) + 1) * dt
            at, count = t[:-1], len(t) - 1
            # Loads at the nodes, and what they and moving stops add to the arguments of the nodes.
            nodes = at[:, None] + np.array(scheme.nodes) * dt
            values = np.array([evaluate(f, nodes) for _, f in member.loads]).reshape(-1, *nodes.shape)
            values = np.moveaxis(values, 0, 1).reshape(count, -1)
            shifts = (values @ shifts_by_load).reshape(*nodes.shape, m) + self._offset_shifts(member, at, nodes)
            predicted = np.array([evaluate(c.offset, at + AHEAD * dt) for c in member.contacts])
            predicted = np.ascontiguousarray(predicted.reshape(m, count).T)
            path, reactions = rigid_steps(linear, driven=values @ pulses, shifts=shifts, predicted=predicted, z=z)
            y = np.moveaxis(path.reshape(count, *shape)[:, :2], 1, 0).copy()
            # Each node counts by the momentum that its reaction brings in the end.
            ends = *coordinates.states(y), np.einsum("s,ksc->kc", self.weights, reactions)
            q, v, means = (np.concatenate(both) for both in zip(last, ends, strict=True))
            yield t, q, v, means
            last = q[-1:], v[-1:], means[-1:]

    def _linear(self, member: System) -> tuple[dict[str, Array], Array, Array]:
        """The step as arrays of Rigid in march.h, and what unit loads at nodes add to the state, (L S, D), and to the
        arguments, (L S, S m). Raises InputError where a reaction does not move its own argument."""
        step, kinds, stops = self.one, self.scheme.conditions, [contact.stops for contact in member.contacts]
        (parts, g, k), S, m = step.reading.shape, len(kinds), len(stops)
        D, basis = parts * k, self.coordinates.basis
        # Conditions on velocities and the restituted position read x_new + e x_old, which a step returns in the places
        # of q and q'.
        e = np.array([0.0 if s.restitution is None else s.restitution for s in stops])
        old = np.array([np.zeros(m) if kind == POSITION else e for kind in kinds])

        def arguments(readings: Array) -> Array:
            x_new, x_old = readings[:, step.readers.at_nodes], readings[:, step.readers.node_rates]
            return (x_new + old.ravel() * x_old).reshape(len(readings), S, m)

        reading = arguments(step.reading.transpose(2, 0, 1).reshape(D, g))
        guess = self.scheme.predict(self.coordinates.equation, self.dt, self.coordinates.units(len(step.keep)))[-1]
        ahead = self.coordinates.columns[:, None] * guess
        pushed, moved = step.push.transpose(2, 1, 0).reshape(-1, S, D), arguments(step.at_once.T)
        compliance = moved[: m * S].reshape(m, S, S, m).transpose(1, 2, 0, 3)  # [node, later node, reaction, argument]
        if m:
            self._require_giving_way(compliance)
        # Where the stops stand in the arguments: at (1 + e) g for x_new + e x_old, at 0 for velocities.
        ends = np.array([[s.law.g1, s.law.g2] for s in stops]).reshape(m, 2)
        codes = [CODES[kind] for kind in kinds]
        bounds = [(1.0 + x[:, None]) * ends if c == AT_A_STOP else np.where(np.isfinite(ends), 0.0, ends)
                  for c, x in zip(codes, old, strict=True)]  # fmt: skip
        linear = {
            "reading": reading.transpose(1, 2, 0),
            "predicting": (ahead if basis else np.sum(ahead, axis=-1)).reshape(m, D),
            "responses": pushed[:m].transpose(1, 0, 2),
            "compliance": compliance,
            "kinds": np.array(codes),
            "bounds": np.array(bounds),
            "stops": ends,
            "blocks": step.transition.transpose(1, 2, 0) if basis else np.zeros(0),
            "matrix": np.zeros(0) if basis else step.transition[0],
        }
        by_loads = moved[m * S :].reshape(len(moved) - m * S, S * m)
        linear = {name: np.ascontiguousarray(x) for name, x in linear.items()}
        return linear, pushed[m:].reshape(-1, D), by_loads

    def _require_giving_way(self, compliance: Array) -> None:
        # The complementarity problem of a node has exactly one solution if its compliance is positive definite, by its
        # symmetric part: damping that couples the modes can make it unsymmetric.
        for s in range(len(compliance)):
            least, most = np.linalg.eigvalsh(0.5 * (compliance[s, s] + compliance[s, s].T))[[0, -1]]
            if not least > 1e-12 * most or not most > 0.0:
                rule = "answer the reaction of every contact by itself, for rigid stops"
                remedy = "use MoreauJean, and leave out contacts that follow from others"
                raise InputError("scheme", str(self.scheme), rule, remedy)

    def _offset_shifts(self, member: System, at: Array, nodes: Array) -> Array:
        """Share of moving stops in the arguments, (K, S, m)."""
        shifts = np.zeros((*nodes.shape, len(member.contacts)))
        for c, contact in enumerate(member.contacts):
            o, e = contact.offset, contact.stops.restitution or 0.0
            for s, kind in enumerate(self.scheme.conditions if o is not None else ()):
                if kind == POSITION:
                    shifts[:, s, c] = evaluate(o, nodes[:, s])
                elif kind == RESTITUTED:
                    shifts[:, s, c] = evaluate(o, nodes[:, s]) + e * _places_before(o, at, self.dt)
                else:
                    shifts[:, s, c] = evaluate(o, nodes[:, s], 1) + e * evaluate(o, at, 1)
        return shifts


def _weights(scheme: RigidScheme, dt: float) -> Array:
    """(S,), the momentum over dt that a free mass takes in the end from a unit reaction at each node of a step."""
    mass = System.from_matrices([[1.0]], [[0.0]], contacts=[Contact(np.ones(1), Stops(upper=1.0, stiffness=np.inf))])
    free = StepMap(scheme, Coordinates(mass, decoupled_modes(mass)), dt, reduced=False)
    # Forces act in the first step only; a scheme may spread their momentum over later ones.
    return (np.linalg.matrix_power(free.transition[0], FREE_STEPS) @ free.push[0])[1] / dt


def _places_before(offset: TimeFunction | None, at: Array, dt: float) -> Array:
    """o(t - dt); before t = 0 such that (o(dt) - o(-dt))/(2 dt) is the rate there, as a scheme takes the positions."""
    places = np.array(evaluate(offset, np.maximum(at - dt, 0.0)), float)
    if at[0] == 0.0:
        places[0] = float(evaluate(offset, dt)) - 2.0 * dt * float(evaluate(offset, 0.0, 1))
    return places
