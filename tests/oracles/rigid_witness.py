"""Random systems on rigid stops, and a solver for them that shares nothing with the package.

SciPy's DOP853 from event to event: a gap that closes turns the velocity round by Newton's law, a contact that leaves
slower than SLOW while it is pressed is held, one that is held leaves where its reaction ends.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

import stiffbeam as sb

SLOW = 1e-6  # of bounces that are left out: over within 2 SLOW/(a (1 - e))


def random_system(seed: int) -> sb.System:
    """One to three unknowns, one or two contacts, pressed by a constant load in every other system."""
    rng = np.random.default_rng([seed, 1404])
    n = int(rng.integers(1, 4))
    A, B = rng.normal(size=(2, n, n))
    mass, stiffness = np.eye(n) + 0.1 * A @ A.T, 4.0 * np.eye(n) + B @ B.T
    damping = rng.choice([0.0, 0.05]) * mass + rng.choice([0.0, 0.02]) * stiffness
    contacts = []
    for c in range(min(n, 1 + seed % 2)):
        offset = sb.Harmonic(0.03, float(rng.uniform(1.0, 4.0)), 0.3) if rng.random() < 0.25 else None
        e = float(rng.choice([0.0, rng.uniform(0.1, 0.9)]))
        gap = float(rng.uniform(0.05, 0.3))
        stops = sb.Stops(-gap, 0.7 * gap if rng.random() < 0.5 else None, stiffness=np.inf, restitution=e)
        contacts.append(sb.Contact(np.eye(n)[c], stops, offset))
    loads = [(rng.normal(size=n), sb.Harmonic(float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.5, 5.0)), 0.2))]
    if seed % 4 < 2:
        loads.append((rng.normal(size=n) * 3.0, sb.Harmonic(1.0, 1e-12, np.pi / 2.0)))  # a constant
    return sb.System.from_matrices(mass, stiffness, damping, loads, contacts, initial_velocity=rng.normal(size=n))


def signed_impulses(system: sb.System, motion: sb.Reference, t_end: float) -> np.ndarray:
    """What each contact gave the system in [0, t_end], by the balance of momentum: of independent rows,

    M (q'(t_end) - q'(0)) + C (q(t_end) - q(0)) + integral (K q - f) = sum of row J.
    """
    points, weights = np.polynomial.legendre.leggauss(12)
    switches = [t for c in motion.contacts for t in (*c.impacts.times, *c.impacts.ends) if t < t_end]
    edges = np.unique(np.concatenate([switches, np.linspace(0.0, t_end, 121)]))
    half = np.diff(edges) / 2.0
    times = (edges[:-1] + half)[:, None] + half[:, None] * points
    q, v = motion.state_at(np.append(times.ravel(), t_end))
    f = sum(
        np.outer(load.amplitude * np.sin(load.frequency * times.ravel() + load.phase), p) for p, load in system.loads
    )
    area = (half[:, None] * weights).ravel() @ (q[:-1] @ system.stiffness - f)
    gained = system.mass @ (v[-1] - system.v0) + system.damping @ (q[-1] - system.q0) + area
    return np.linalg.lstsq(np.array([c.row for c in system.contacts]).T, gained, rcond=None)[0]


class Witness:
    """The motion of such a system: held is the side by contact."""

    def __init__(self, system: sb.System) -> None:
        self.s, self.n, self.inverse = system, len(system.mass), np.linalg.inv(system.mass)
        self.held: dict[int, int] = {}
        self.impacts: list[list[float]] = [[] for _ in system.contacts]

    def offset(self, c, t, order=0):
        o = self.s.contacts[c].offset
        return (
            0.0
            if o is None
            else o.amplitude * o.frequency**order * np.sin(o.frequency * t + o.phase + order * np.pi / 2)
        )

    def gap(self, c, side, t, y):
        stops = self.s.contacts[c].stops
        return side * (
            (stops.upper if side > 0 else stops.lower) - self.s.contacts[c].row @ y[: self.n] - self.offset(c, t)
        )

    def speed(self, c, t, y):
        return self.s.contacts[c].row @ y[self.n :] + self.offset(c, t, 1)

    def motion(self, t, y, held):
        """Acceleration and the reactions of the contacts held."""
        s, at = self.s, list(held)
        f = -s.stiffness @ y[: self.n] - s.damping @ y[self.n :]
        for vector, load in s.loads:
            f = f + vector * load.amplitude * np.sin(load.frequency * t + load.phase)
        if not at:
            return self.inverse @ f, np.zeros(0)
        rows = np.array([s.contacts[c].row for c in at])
        pull = np.array([self.offset(c, t, 2) for c in at])
        R = -np.linalg.solve(rows @ self.inverse @ rows.T, rows @ self.inverse @ f + pull)
        return self.inverse @ (f + rows.T @ R), R

    def settle(self, t, y):
        """Let go of what would be pulled at, the most pulled first."""
        while self.held:
            _, R = self.motion(t, y, self.held)
            pull = np.array([side * r for side, r in zip(self.held.values(), R, strict=True)])  # > 0: a pull
            if np.max(pull) <= 0.0:
                return
            del self.held[list(self.held)[int(np.argmax(pull))]]

    def bounce(self, t, y, c, side):
        """Newton's law at c; those held stay so where that takes a push."""
        self.impacts[c].append(t)
        others = dict(self.held)
        e = float(self.s.contacts[c].stops.restitution)
        while True:
            at = [c, *others]
            rows = np.array([self.s.contacts[x].row for x in at])
            wanted = np.zeros(len(at))
            wanted[0] = -(1.0 + e) * self.speed(c, t, y)
            P = np.linalg.solve(rows @ self.inverse @ rows.T, wanted)
            pulled = [x for x, p in zip(at[1:], P[1:], strict=True) if others[x] * p > 0.0]
            if not pulled:
                break
            for x in pulled:
                del others[x]
        y = y.copy()
        towards = self.inverse @ self.s.contacts[c].row
        y[: self.n] += towards * side * self.gap(c, side, t, y) / (self.s.contacts[c].row @ towards)  # on the stop
        y[self.n :] += self.inverse @ rows.T @ P
        self.held = others
        if abs(self.speed(c, t, y)) < SLOW:
            y[self.n :] -= towards * self.speed(c, t, y) / (self.s.contacts[c].row @ towards)
            self.held[c] = side
            self.settle(t, y)
        return y

    def solve(self, times):
        """The first contact's position at ``times``."""
        t, y, out = 0.0, np.concatenate([self.s.q0, self.s.v0]), []
        sides = [
            (c, side)
            for c, x in enumerate(self.s.contacts)
            for side in (1, -1)
            if np.isfinite((x.stops.lower_bound, x.stops.upper_bound)[side > 0])
        ]
        while len(out) < len(times):
            events, what = [], []
            for c, side in sides:
                if c in self.held:
                    continue
                here = self.gap(c, side, t, y)
                floor = max(0.0, -here) + 1e-14 if abs(here) < 1e-11 else 0.0  # on the stop: it has to leave first
                event = lambda t, y, c=c, side=side, floor=floor: self.gap(c, side, t, y) + floor  # noqa: E731
                events.append(event)
                what.append((c, side, False))
            for i, (c, side) in enumerate(self.held.items()):
                events.append(lambda t, y, i=i, side=side: -side * self.motion(t, y, self.held)[1][i])
                what.append((c, side, True))
            for event in events:
                event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
            held = dict(self.held)
            right = lambda t, y, held=held: np.concatenate([y[self.n :], self.motion(t, y, held)[0]])  # noqa: E731
            due = times[len(out) :]
            path = solve_ivp(
                right, (t, times[-1]), y, "DOP853", t_eval=due, events=events, rtol=1e-11, atol=1e-13, max_step=0.05
            )
            assert path.success
            out += list(path.y.T) if np.size(path.y) else []
            if path.status != 1:
                break
            k = next(k for k, found in enumerate(path.t_events) if len(found))
            t, y = float(path.t_events[k][0]), path.y_events[k][0]
            c, side, leaves = what[k]
            if leaves:
                del self.held[c]
                self.settle(t, y)
            else:
                y = self.bounce(t, y, c, side)
        return np.array(out)[:, : self.n] @ self.s.contacts[0].row


FAMILIES = "silence", "growing", "pair", "pressed"


def recorded_system(family: str, seed: int) -> tuple[sb.System, float]:
    """One or two bodies between walls, driven by a dense record, and a time to end at.

    silence: the start decays before the record begins. growing: the record grows by 1e6. pair: two bodies hit each
    other. pressed: a constant load holds the first body on its wall from the start.
    """
    rng = np.random.default_rng([FAMILIES.index(family), seed, 33])
    n = 2 if family == "pair" or rng.random() < 0.3 else 1
    zeta, e = float(rng.uniform(0.03, 0.1)), float(rng.uniform(0.85, 0.95))
    omega = float(rng.uniform(4.0, 8.0))
    coupling = np.array([[1.3, -0.3], [-0.3, 1.6]])[:n, :n]
    stiffness = omega**2 * coupling
    begin, dt = float(rng.uniform(8.0, 14.0)), float(rng.uniform(0.03, 0.06))
    t_end = begin + float(rng.uniform(20.0, 25.0))
    t = np.arange(0.0, t_end + 2.0 * dt, dt)
    after = np.maximum(t - begin, 0.0)
    size, fast = rng.uniform(20.0, 40.0, 2), rng.uniform(2.0, 9.0, 2)
    force = size @ np.sin(np.outer(fast, after))
    if family == "growing":
        force = size @ np.sin(np.outer(fast, t)) * 10.0 ** (6.0 * (np.minimum(t / t_end, 1.0) - 1.0))
    loads = [(np.eye(n)[-1], sb.Sampled(t, force))]
    gap = float(rng.uniform(0.05, 0.2))
    stops = sb.Stops(-gap, gap, stiffness=np.inf, restitution=e)
    contacts = [sb.Contact(np.eye(n)[0], stops)]
    if family == "pair":
        between = sb.Stops(lower=-0.5 * gap, stiffness=np.inf, restitution=e)
        contacts.append(sb.Contact([-1.0, 1.0], between))
    start = np.zeros(n)
    if family == "pressed":
        start[0] = -gap
        held = stiffness @ start
        loads.append((np.eye(n)[0], sb.Constant(float(held[0]) - float(rng.uniform(1.0, 10.0)))))
    velocity = np.zeros(n) if family == "pressed" else rng.normal(size=n) * 0.3
    system = sb.System.from_matrices(
        np.eye(n), stiffness, 2.0 * zeta * omega * np.eye(n), loads, contacts,
        initial_displacement=start, initial_velocity=velocity,
    )  # fmt: skip
    return system, t_end
