"""A witness for the march in blocks: a scheme's ``step`` on matrices, step by step, contact by superposition."""

from __future__ import annotations

import numpy as np

import stiffbeam as sb
from stiffbeam.kernels.contact import solve_node, solve_stage
from stiffbeam.kernels.march import LINEAR, MEAN
from stiffbeam.march.treatment import TREATMENTS
from stiffbeam.model.contact import laws
from stiffbeam.model.equations import Matrices
from stiffbeam.model.time_functions import offset_rate, offset_values


def march(system: sb.System, scheme: sb.Scheme, dt: float, t_end: float, contact: str = "implicit") -> sb.Trajectory:
    """The run as one of another program: impacts and energies are those of its states."""
    treatment, steps = TREATMENTS[contact], round(t_end / dt)
    scheme = treatment.form_of(scheme)
    q, v = np.zeros((2, steps + 1, system.size))
    q[0], v[0] = system.q0, system.v0
    history, done = [np.array([system.q0, system.v0])], 0
    for part, count in ((scheme.starter, scheme.history - 1), (scheme, steps)):
        if part is not None and done < min(count, steps):
            one = _March(system, part, dt, treatment, history, done * dt)
            for n in range(done, min(count, steps)):
                one.step(n * dt)
                q[n + 1], v[n + 1] = one.z[:2]
                history.insert(0, one.z[:2])
            done = count
    return sb.Trajectory.from_arrays(np.arange(steps + 1) * dt, system=system, states=(q, v))


class _March:
    def __init__(self, system, scheme, dt, treatment, history, t) -> None:
        self.system, self.scheme, self.dt, self.treatment = system, scheme, dt, treatment
        self.equation = Matrices(system.mass, system.damping, system.stiffness)
        self.rows = np.array([c.row for c in system.contacts]).reshape(-1, system.size)
        self.rule, self.law = treatment.rule(system.contacts, system.gyroscopic), laws(system.contacts)
        u, rate = self._motion(history[0][0], history[0][1], t)
        pressing = [c.stops.force(x, y) for c, x, y in zip(system.contacts, u, rate, strict=True)]
        force = system.load(t) + (0.0 if treatment.means else np.array(pressing) @ self.rows)
        self.z, self.before = scheme.initial(self.equation, history, force), u
        # Responses of states, positions and velocities at the nodes to a unit force of each contact at each node.
        S, m, zero = len(scheme.nodes), len(self.rows), np.zeros_like(self.z)
        self.of_state, self.of_stages = np.zeros((S, m, *zero.shape)), np.zeros((S, m, S, 2, m))
        for s in range(S):
            for c in range(m):
                reactions = [self.rows[c] if i == s else 0.0 * self.rows[c] for i in range(S)]
                self.of_state[s, c], stages = scheme.step(self.equation, dt, zero, self._nothing(), reactions)
                if not treatment.predicts:
                    self.of_stages[s, c] = np.array(stages) @ self.rows.T

    def _nothing(self) -> list[np.ndarray]:
        return [np.zeros(self.system.size)] * len(self.scheme.nodes)

    def _motion(self, q, v, t) -> tuple[np.ndarray, np.ndarray]:
        shift, rate = (np.array([of(c.offset, t) for c in self.system.contacts]) for of in (offset_values, offset_rate))
        return self.rows @ q + shift.reshape(-1), self.rows @ v + rate.reshape(-1)

    def step(self, t: float) -> None:
        """Take one step from t: without forces, then the forces node by node with all that they move."""
        times = [t + c * self.dt for c in self.scheme.nodes]
        loads = [self.system.load(time) for time in times]
        predicted = self.scheme.predict(self.equation, self.dt, self.z)
        z, stages = self.scheme.step(self.equation, self.dt, self.z, loads, self._nothing())
        where = predicted if self.treatment.predicts else [y[0] for y in stages]
        x = np.array([self._motion(q, y[1], time) for q, y, time in zip(where, stages, times, strict=True)])
        for s in range(len(times)):
            r, w = np.ascontiguousarray(x[s])
            compliance, rates = (np.ascontiguousarray(self.of_stages[s, :, s, i].T) for i in (0, 1))
            if self.rule == LINEAR:
                forces = solve_node(r, compliance, self.law)
            else:
                forces = solve_stage(r, w, compliance, rates, self.before, self.rule, self.law)
            x = x + np.tensordot(forces, self.of_stages[s], 1)
            z = z + np.tensordot(forces, self.of_state[s], 1)
            self.before = x[s, 0].copy() if self.rule == MEAN else self.before
        self.z = z
