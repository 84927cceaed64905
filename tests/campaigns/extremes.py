"""Random systems with extreme numbers, and a witness in mpmath that shares no code with the package.

    z' = A z,  z = (q, q', 1, sin w1 t, cos w1 t, ...),  z(t + tau) = exp(A tau) z(t)

with one A per contact state; a switch is where a row of z changes sign, found by small steps and bisection.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import stiffbeam as sb

DIGITS = 60
LEAST = 1e-300  # a number that float64 holds


def decades(rng: np.random.Generator, low: float, high: float, size: int | None = None) -> Any:
    """Log-uniform from 10^low to 10^high."""
    return 10.0 ** rng.uniform(low, high, size)


def linear(rng: np.random.Generator) -> tuple[sb.System, float]:
    """A chain of one to three masses over many decades, at rest or moving, driven near a resonance or not,
    over a tiny or a long time."""
    n = int(rng.integers(1, 4))
    width = rng.choice([0.5, 3.0, 6.0])
    mass = np.diag(decades(rng, -width, width, n))
    stiffness = _chain(decades(rng, -width, width, n))
    damping = np.zeros((n, n))
    if rng.random() < 0.5:
        damping = _chain(decades(rng, -width, width, n) * rng.choice([1e-3, 1.0, 1e3]))
    squares = np.linalg.eigvalsh(np.linalg.solve(np.sqrt(mass), np.linalg.solve(np.sqrt(mass), stiffness).T))
    omega = np.sqrt(np.maximum(squares, 1e-12 * np.max(squares)))
    loads = []
    for _ in range(int(rng.integers(0, 3))):
        if rng.random() < 0.3:
            function: Any = sb.Constant(rng.normal())
        else:
            close = rng.choice([0.0, 1e-14, 1e-10, 1e-6, 1e-3, 1e-1, 3.0])
            w = float(rng.choice(omega)) * abs(1.0 + close * rng.normal())
            function = sb.Harmonic(decades(rng, -3, 3), max(w, 1e-12), rng.choice([0.0, 0.7, np.pi / 2]))
        loads.append((rng.normal(size=n), function))
    moving = rng.random() < 0.6 or not loads
    return sb.System.from_matrices(
        mass, stiffness, damping, loads=loads, observe=np.eye(n)[0],
        initial_displacement=decades(rng, -6, 3) * rng.normal(size=n) * rng.choice([0.0, 1.0]),
        initial_velocity=decades(rng, -6, 3) * rng.normal(size=n) * moving,
    ), float(rng.choice([1e-6, 1e-3, 1.0, 30.0, 1e3]) * 2 * np.pi / rng.choice(omega))  # fmt: skip


def impacting(rng: np.random.Generator) -> tuple[sb.System, float]:
    """One or two masses with one or two contacts, stops near or far, soft or hard, over some ten impacts."""
    n = int(rng.integers(1, 3))
    width = rng.choice([0.3, 2.0])
    mass, stiffness = np.diag(decades(rng, -width, width, n)), _chain(decades(rng, -width, width, n))
    omega = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)
    damping = _chain(decades(rng, -4, 0.5, n)) if rng.random() < 0.4 else np.zeros((n, n))
    close = rng.choice([0.0, 1e-12, 1e-6, 1e-2, 1.0])
    drive = sb.Harmonic(decades(rng, -2, 2), float(rng.choice(omega)) * abs(1.0 + close * rng.normal()), 0.7)
    gap = decades(rng, -6, 1)
    contacts = []
    for i in range(int(rng.integers(1, n + 1))):
        lower, upper = [(-gap, gap), (None, gap), (-2 * gap, 0.5 * gap)][int(rng.integers(3))]
        kappa = float(np.max(stiffness)) * decades(rng, -1, 4)
        contacts.append(sb.Contact(np.eye(n)[i], sb.Stops(lower, upper, stiffness=kappa)))
    return sb.System.from_matrices(
        mass, stiffness, damping, loads=[(rng.normal(size=n), drive)], contacts=contacts,
        initial_velocity=gap * np.max(omega) * rng.normal(size=n) * rng.choice([0.0, 1.0]),
    ), float(rng.choice([1.0, 8.0]) * 2 * np.pi / np.min(omega))  # fmt: skip


def chaotic(rng: np.random.Generator) -> tuple[sb.System, float]:
    """One to four masses driven hard between stiff stops, damped or not, for longer than float64 can follow."""
    n = int(rng.integers(1, 5))
    stiffness = _chain(decades(rng, -0.5, 1.5, n))
    mass = np.diag(decades(rng, -0.3, 0.3, n))
    omega = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)
    damping = _chain(decades(rng, -3, -1, n)) if rng.random() < 0.5 else np.zeros((n, n))
    drive = sb.Harmonic(decades(rng, 0, 1.3), float(rng.uniform(0.5, 3.0) * np.min(omega)), rng.uniform(0, 6))
    contacts = []
    for i in sorted(rng.choice(n, int(rng.integers(1, min(n, 2) + 1)), replace=False)):
        lower, upper = -decades(rng, -2, 0), decades(rng, -2, 0)
        stops = sb.Stops(lower if rng.random() < 0.8 else None, upper, stiffness=decades(rng, 2, 4) * np.max(stiffness))
        contacts.append(sb.Contact(np.eye(n)[i], stops))
    return sb.System.from_matrices(
        mass, stiffness, damping, loads=[(rng.normal(size=n), drive)], contacts=contacts,
        initial_velocity=0.1 * rng.normal(size=n),
    ), float(rng.uniform(8.0, 30.0) * 2 * np.pi / np.min(omega))  # fmt: skip


def truth(system: sb.System, times: np.ndarray) -> Any:
    """q_observed at the times, without contacts, mpmath numbers."""
    import mpmath as mp

    with mp.workdps(DIGITS + 60):
        A, z = _augmented(system, ())
        row = _observed(system)
        last, out, flows = mp.mpf(0), [], {}
        for t in times:
            tau = mp.mpf(float(t)) - last
            if tau not in flows:
                flows[tau] = mp.expm(A * tau)
            z, last = flows[tau] * z, mp.mpf(float(t))
            out.append((row * z)[0])
        return out


def bouncing(system: sb.System, times: np.ndarray, step: float) -> list[Any]:
    """q_observed at the times with contacts: steps no longer than ``step``, switches by bisection in them."""
    import mpmath as mp

    with mp.workdps(40):
        maps: dict[Any, Any] = {}
        _, z = _augmented(system, ())
        row, t, out = _observed(system), mp.mpf(0), []
        sides = [int(c.stops.state(float(c.row @ system.q0))) for c in system.contacts]

        def flow(state: tuple[int, ...], z: Any, tau: Any) -> Any:
            if (state, tau) not in maps:
                A = _augmented(system, tuple((i, s) for i, s in enumerate(state) if s))[0]
                maps[state, tau] = mp.expm(A * tau)
            return maps[state, tau] * z

        def series(state: tuple[int, ...], z: Any, tau: Any) -> Any:
            if state not in maps:
                maps[state] = _augmented(system, tuple((i, s) for i, s in enumerate(state) if s))[0]
            term, total = z, z
            for k in range(1, 60):
                term = maps[state] * term * (tau / k)
                total = total + term
                if mp.norm(term) < mp.mpf(10) ** -45:
                    break
            return total

        def gap(contact: int, side: int, z: Any) -> Any:
            stops, row = system.contacts[contact].stops, system.contacts[contact].row
            u = sum(mp.mpf(float(r)) * z[i] for i, r in enumerate(row))
            stop = mp.mpf(stops.upper if side > 0 else stops.lower)
            return (stop - u) * side * (-1 if sides[contact] else 1)

        def closing(z: Any, ahead: Any) -> list[tuple[int, int]]:
            found = []
            for i, contact in enumerate(system.contacts):
                for side in (1, -1):
                    if (contact.stops.upper if side > 0 else contact.stops.lower) is None:
                        continue
                    if sides[i] in (0, side) and gap(i, side, ahead) < 0:
                        found.append((i, side))
            return found

        for target in times:
            target = mp.mpf(float(target))
            while t < target:
                tau = min(mp.mpf(step), target - t)
                state = tuple(sides)
                ahead = flow(state, z, tau) if tau == step else series(state, z, tau)
                switches = closing(z, ahead)
                first = None
                for contact, side in switches:
                    low, high = mp.mpf(0), tau if first is None else first[0]
                    if gap(contact, side, series(state, z, high)) >= 0:
                        continue
                    for _ in range(110):
                        middle = (low + high) / 2
                        if gap(contact, side, series(state, z, middle)) < 0:
                            high = middle
                        else:
                            low = middle
                    first = (high, contact, side)
                if first is None:
                    z, t = ahead, t + tau
                else:
                    z, t = series(state, z, first[0]), t + first[0]
                    sides[first[1]] = 0 if sides[first[1]] else first[2]
            out.append((row * z)[0])
        return out


def _chain(k: np.ndarray) -> np.ndarray:
    """Springs from the wall to the first mass, from there to the second, and so on."""
    n = len(k)
    B = np.eye(n) - np.eye(n, k=-1)
    return B.T @ np.diag(k) @ B


def _observed(system: sb.System) -> Any:
    import mpmath as mp

    row = system.channels[system.tip_channel][0]
    size = 2 * system.size + 1 + 2 * len(_frequencies(system))
    return mp.matrix([[*map(float, row), *[0.0] * (size - len(row))]])


def _frequencies(system: sb.System) -> list[float]:
    return [f.frequency for _, f in system.loads if isinstance(f, sb.Harmonic)]


def _augmented(system: sb.System, closed: tuple[tuple[int, int], ...]) -> tuple[Any, Any]:
    """A and z(0); closed: (contact, side) of those on a stop."""
    import mpmath as mp

    n, w = system.size, _frequencies(system)
    K, C, M = (mp.matrix(x.tolist()) for x in (system.stiffness, system.damping, system.mass))
    size = 2 * n + 1 + 2 * len(w)
    force = mp.zeros(n, size)  # M q'' = force z
    force[:, :n], force[:, n : 2 * n] = -K, -C
    k = 0
    for vector, f in system.loads:
        for i in range(n):
            if isinstance(f, sb.Constant):
                force[i, 2 * n] += mp.mpf(float(vector[i])) * mp.mpf(f.level)
            else:
                size_i = mp.mpf(float(vector[i])) * mp.mpf(f.amplitude)
                force[i, 2 * n + 1 + 2 * k] += size_i * mp.cos(mp.mpf(f.phase))
                force[i, 2 * n + 2 + 2 * k] += size_i * mp.sin(mp.mpf(f.phase))
        k += isinstance(f, sb.Harmonic)
    for i, side in closed:
        contact = system.contacts[i]
        row, kappa = [mp.mpf(float(x)) for x in contact.row], mp.mpf(contact.stops.stiffness)
        stop = mp.mpf(contact.stops.upper if side > 0 else contact.stops.lower)
        for a in range(n):
            force[a, 2 * n] += kappa * stop * row[a]
            for b in range(n):
                force[a, b] -= kappa * row[a] * row[b]
    A = mp.zeros(size, size)
    for i in range(n):
        A[i, n + i] = 1
    A[n : 2 * n, :] = mp.inverse(M) * force
    for k, f in enumerate(w):
        A[2 * n + 1 + 2 * k, 2 * n + 2 + 2 * k] = mp.mpf(f)
        A[2 * n + 2 + 2 * k, 2 * n + 1 + 2 * k] = -mp.mpf(f)
    z = mp.matrix([*map(float, system.q0), *map(float, system.v0), 1, *[0, 1] * len(w)])
    return A, z


def _errors(tip: np.ndarray, exact: list, scale: Any, promised: float) -> list[float]:
    """Errors over what is promised of them; what float64 cannot hold is zero there."""
    off = (max(abs(float(u) - x) - LEAST, 0) for u, x in zip(tip, exact, strict=True))
    return [float(x / scale) / promised for x in off]


def check_linear(
    seed: int, solve: Callable[[sb.System, float, np.ndarray], sb.Trajectory], promised: float
) -> tuple[str, float]:
    """('refused', 0), ('short', error/promise to the horizon) or ('whole', the same)."""
    system, t_end = linear(np.random.default_rng(seed))
    times = np.linspace(0.0, t_end, 5)
    try:
        found = solve(system, t_end, times)
    except (sb.InputError, sb.SolverFailure) as error:
        return f"refused: {error}", 0.0
    exact = truth(system, times)
    scale = max(abs(x) for x in exact) or 1.0
    errors = _errors(found.tip, exact, scale, promised)
    inside = [e for e, t in zip(errors, times, strict=True) if t <= found.horizon > 0.0]
    return ("whole" if found.horizon >= t_end else "short"), max(inside, default=0.0)


def check_impacting(seed: int) -> tuple[str, float]:
    """('refused', 0) or (what was held against the witness, error/promise to the horizon), exact and multiprecision."""
    system, t_end = impacting(np.random.default_rng([seed, 1]))
    times = np.linspace(0.0, t_end, 9)
    closed = system.stiffness + sum(c.stops.stiffness * np.outer(c.row, c.row) for c in system.contacts)
    fastest = float(np.sqrt(np.max(np.linalg.eigvals(np.linalg.solve(system.mass, closed)).real)))
    exact, worst = None, 0.0
    for method, promised in (("exact", 1e-3), ("multiprecision", 1e-12)):
        try:
            found = sb.reference(system, t_end, method, times)
        except (sb.InputError, sb.SolverFailure) as error:
            return f"refused: {error}", worst
        exact = exact or bouncing(system, times, 0.2 / max(fastest, *_frequencies(system)))
        scale = max(abs(x) for x in exact) or 1.0
        errors = _errors(found.tip, exact, scale, promised)
        inside = [e for e, t in zip(errors, times, strict=True) if t <= found.horizon > 0.0]
        worst = max(worst, *inside, 0.0) if inside else worst
    return "held", worst
