"""A witness for the marches: a scheme's own step in extended precision, step by step, each contact's force in turn.

Nothing of the marches is used but the modes in which they work; contacts are solved by Gauss and Seidel's
iteration on v_c = r_c + sum_e s_ce F_e(v_e), whose force on one contact given the others has a closed form.
"""

from __future__ import annotations

import numpy as np

import stiffbeam as sb
from stiffbeam.model.equations import Modal
from stiffbeam.model.modes import modes

Real = np.longdouble


def _value(function, t: Real) -> Real:
    """A harmonic, a constant or nothing at t."""
    if function is None:
        return Real(0.0)
    if isinstance(function, sb.Harmonic):
        return Real(function.amplitude) * np.sin(Real(function.frequency) * t + Real(function.phase))
    return Real(function.level)


def march(system: sb.System, scheme: sb.Scheme, dt: float, steps: int) -> np.ndarray:
    """Positions (steps + 1, channels)."""
    basis = modes(system)
    assert basis is not None
    equation, h = Modal(basis.omega.astype(Real), basis.damping.astype(Real)), Real(dt)
    rows = [basis.force(row).astype(Real) for row, _ in system.channels]
    offsets = [offset for _, offset in system.channels]
    loads = [(basis.force(vector).astype(Real), function) for vector, function in system.loads]
    laws = [(Real(c.stops.stiffness), Real(c.stops.lower_bound), Real(c.stops.upper_bound)) for c in system.contacts]
    m, nothing = len(laws), np.zeros(system.size, Real)

    def load(t: Real) -> np.ndarray:
        return sum((_value(function, t) * vector for vector, function in loads), nothing)

    def forces(r: np.ndarray, s: np.ndarray) -> np.ndarray:
        found = np.zeros(m, Real)
        for _ in range(10_000 if m > 1 else 1):
            before = found.copy()
            for c, (kappa, g1, g2) in enumerate(laws):
                own = r[c] + s[c] @ found - s[c, c] * found[c]
                found[c] = kappa / (1 + kappa * s[c, c]) * (min(max(own, g1), g2) - own)
            if np.all(np.abs(found - before) <= 1e-19 * np.abs(found)):
                break
        return found

    path = np.zeros((steps + 1, len(rows)), Real)
    y = np.stack([basis.to_modal(system.q0), basis.to_modal(system.v0)]).astype(Real)
    path[0] = [row @ y[0] + _value(o, Real(0.0)) for row, o in zip(rows, offsets, strict=True)]
    history, n = [y], 0
    stages_of = [(scheme.starter, scheme.history - 1)] if scheme.starter is not None else []
    for part, count in [*stages_of, (scheme, steps - scheme.history + 1)]:
        held = load(n * h)
        for c, (kappa, g1, g2) in enumerate(laws):
            held = held - kappa * (path[n, c] - min(max(path[n, c], g1), g2)) * rows[c]
        z, S = part.initial(equation, history, held), len(part.nodes)
        none = [nothing] * S
        pushes = []  # what a unit force of contact c at node s does: to the state, to positions at nodes
        for s in range(S):
            for c in range(m):
                unit = list(none)
                unit[s] = rows[c]
                new, stages = part.step(equation, h, np.zeros_like(z), none, unit)
                pushes.append((s, c, new, np.array([[row @ q[0] for row in rows[:m]] for q in stages])))
        for k in range(n, n + count):
            times = [(k + Real(node)) * h for node in part.nodes]
            z, stages = part.step(equation, h, z, [load(t) for t in times], none)
            w = np.array(
                [[rows[c] @ q[0] + _value(offsets[c], t) for c in range(m)] for q, t in zip(stages, times, strict=True)]
            ).reshape(S, m)
            for s in range(S):
                own = [(c, new, moved) for at, c, new, moved in pushes if at == s]
                compliance = np.array([moved[s] for _, _, moved in own]).reshape(m, m).T
                for (_, new, moved), force in zip(own, forces(w[s], compliance), strict=True):
                    if force:
                        z, w = z + force * new, w + force * moved
            end = _value
            path[k + 1] = [row @ z[0] + end(o, (k + 1) * h) for row, o in zip(rows, offsets, strict=True)]
        history, n = [z[:2], *history], n + count
    return path
