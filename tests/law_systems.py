"""Random systems with every law of contact, and solvers for them that share nothing with the package.

SciPy's DOP853 from switch to switch. A side is free or pressed; a free one is entered where its gap closes or,
already inside, where its force would be > 0 again; a pressed one is left where its force is zero. On rigid stops a gap
that closes turns the velocity round by Newton's law, a contact that leaves slower than SLOW while it is pressed is
held, one that is held leaves where its reaction ends.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import stiffbeam as sb

LAWS = ("power", "kelvin-voigt", "hunt-crossley", "all")
SLOW = 1e-6  # of bounces on rigid stops that are left out: over within 2 SLOW/(a (1 - e))


def stops_of(rng: np.random.Generator, law: str) -> sb.Stops:
    """Stops at a random distance, on one side or both."""
    if law == "rigid":
        e, gap = float(rng.choice([0.0, rng.uniform(0.1, 0.9)])), float(rng.uniform(0.05, 0.3))
        return sb.Stops(-gap, 0.7 * gap if rng.random() < 0.5 else None, stiffness=np.inf, restitution=e)
    numbers = {"stiffness": float(10.0 ** rng.uniform(1.0, 3.0))}
    if law in ("power", "all"):
        numbers["exponent"] = float(rng.choice([1.5, 2.0, rng.uniform(1.0, 3.0)]))
    if law in ("kelvin-voigt", "all"):
        numbers["damping"] = float(10.0 ** rng.uniform(-2.0, 0.5))
    if law in ("hunt-crossley", "all"):
        numbers["dissipation"] = float(10.0 ** rng.uniform(-1.0, 0.5))
        numbers.setdefault("exponent", float(rng.choice([1.0, 1.5])))
    gap = float(rng.uniform(0.02, 0.3))
    sides = [(-gap, None), (None, gap), (-gap, 0.7 * gap)][rng.integers(3)]
    return sb.Stops(*sides, **numbers)


def random_system(seed: int) -> sb.System:
    """One to four unknowns, one or two contacts, with loads, damping and moving stops now and then."""
    laws = [LAWS[(seed + c) % len(LAWS)] for c in range(1 + seed % 2)]
    return driven(np.random.default_rng([seed, 1302]), [partial(stops_of, law=law) for law in laws])


def kelvin_voigt_system(seed: int) -> sb.System:
    """The same with damped linear stops."""
    return driven(np.random.default_rng([seed, 77]), [partial(stops_of, law="kelvin-voigt")] * (1 + seed % 2))


def rigid_system(seed: int) -> sb.System:
    """One to three unknowns on rigid stops, pressed by a constant load in every other system."""
    stops = [partial(stops_of, law="rigid")] * (1 + seed % 2)
    return driven(np.random.default_rng([seed, 1404]), stops, 3, 0.2, seed % 4 < 2)


def driven(
    rng: np.random.Generator, stops: list[Any], most: int = 4, phase: float = 0.0, pressed: bool = False
) -> sb.System:
    """A driven system of up to ``most`` unknowns, with no more contacts than these.

    stops: functions of rng. pressed: by a constant load.
    """
    n = int(rng.integers(1, most + 1))
    A, B = rng.normal(size=(2, n, n))
    mass, stiffness = np.eye(n) + 0.1 * A @ A.T, 4.0 * np.eye(n) + B @ B.T
    damping = rng.choice([0.0, 0.05]) * mass + rng.choice([0.0, 0.02]) * stiffness
    contacts = []
    for c, make in enumerate(stops[:n]):
        offset = sb.Harmonic(0.03, float(rng.uniform(1.0, 4.0)), 0.3) if rng.random() < 0.25 else None
        contacts.append(sb.Contact(np.eye(n)[c], make(rng), offset))
    loads = [(rng.normal(size=n), sb.Harmonic(float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.5, 5.0)), phase))]
    if pressed:
        loads.append((rng.normal(size=n) * 3.0, sb.Constant(1.0)))
    return sb.System.from_matrices(mass, stiffness, damping, loads, contacts, initial_velocity=rng.normal(size=n))


def free_system(seed: int) -> sb.System:
    """One to three masses in a chain that nothing holds, between damped linear stops at one end or both; pushed on by
    a constant force now and then, stops of a single mass critically damped."""
    rng = np.random.default_rng([seed, 1313])
    n = int(rng.integers(1, 4))
    masses, stretch = rng.uniform(0.5, 2.0, n), np.eye(n)[1:] - np.eye(n)[:-1]
    stiffness = stretch.T @ np.diag(10.0 ** rng.uniform(0.5, 2.5, n - 1)) @ stretch
    damping = rng.choice([0.0, 0.02]) * stiffness + rng.choice([0.0, 0.3]) * np.diag(masses)
    contacts = []
    for c in sorted({0, n - 1})[: 1 + seed % 2]:
        stops = stops_of(rng, "kelvin-voigt")
        if n == 1 and rng.random() < 0.3:
            stops = replace(stops, damping=2.0 * float(np.sqrt(stops.stiffness * masses[0])))
        offset = sb.Harmonic(0.03, float(rng.uniform(1.0, 4.0)), 0.3) if rng.random() < 0.25 else None
        contacts.append(sb.Contact(np.eye(n)[c], stops, offset))
    loads = [(rng.normal(size=n), sb.Harmonic(float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.5, 5.0))))]
    if rng.random() < 0.7:
        loads.append((masses, sb.Constant(float(rng.normal()))))
    return sb.System.from_matrices(
        np.diag(masses), stiffness, damping, loads, contacts, initial_velocity=rng.normal(size=n)
    )


class Witness:
    """The motion of such a system, from event to event."""

    rtol, atol, longest = 1e-12, 1e-13, 0.02

    def __init__(self, system: sb.System) -> None:
        self.system, self.n, self.inverse = system, system.size, np.linalg.inv(system.mass)
        stops = [contact.stops for contact in system.contacts]
        pairs = [(c, sign, stop) for c, x in enumerate(stops) for sign, stop in ((1.0, x.upper), (-1.0, x.lower))]
        self.sides = [(c, sign, float(stop)) for c, sign, stop in pairs if stop is not None]
        self.pressed = [False] * len(self.sides)

    def offset(self, c, t, order=0):
        """The offset of a contact, or its derivative."""
        o = self.system.contacts[c].offset
        phase = 0.0 if o is None else o.frequency * t + o.phase + order * np.pi / 2
        return 0.0 if o is None else o.amplitude * o.frequency**order * np.sin(phase)

    def speed(self, c, t, y):
        return self.system.contacts[c].row @ y[self.n :] + self.offset(c, t, 1)

    def depth(self, k, t, y):
        """How far side k is beyond its stop, and its rate."""
        c, sign, stop = self.sides[k]
        u = self.system.contacts[c].row @ y[: self.n] + self.offset(c, t)
        return sign * (u - stop), sign * self.speed(c, t, y)

    def outer_force(self, t, y):
        """All forces but those of the stops."""
        s = self.system
        f = -s.stiffness @ y[: self.n] - s.damping @ y[self.n :]
        for vector, load in s.loads:
            level = getattr(load, "level", None)
            f = f + vector * (load.amplitude * np.sin(load.frequency * t + load.phase) if level is None else level)
        return f

    def force(self, k, t, y):
        stops, (d, rate) = self.system.contacts[self.sides[k][0]].stops, self.depth(k, t, y)
        size = np.sign(d) * abs(d) ** float(stops.exponent)
        return stops.stiffness * size * (1.0 + stops.dissipation * rate) + stops.damping * rate

    def rhs(self, t, y):
        f = self.outer_force(t, y)
        for k, (c, sign, _) in enumerate(self.sides):
            if self.pressed[k]:
                f = f - sign * self.system.contacts[c].row * self.force(k, t, y)
        return np.concatenate([y[self.n :], self.inverse @ f])

    def switch(self, k, t, y):
        """> 0 where the side presses: beyond the stop, and with a force that is no pull."""
        stops, (d, rate) = self.system.contacts[self.sides[k][0]].stops, self.depth(k, t, y)
        return min(d, 1.0 + stops.dissipation * rate if stops.damping == 0.0 else self.force(k, t, y))

    def start(self, y):
        self.pressed = [self.switch(k, 0.0, y) > 0.0 for k in range(len(self.sides))]

    def events(self, t, y):
        """What may end a piece: (function that falls through zero, what happens then: (t, y) to y)."""
        found = []
        for k, closed in enumerate(self.pressed):
            # A switch just made is looked for a little past where it was.
            here, sign = self.switch(k, t, y), 1.0 if closed else -1.0
            floor = min(here, 0.0) - 1e-14 if closed else max(here, 0.0) + 1e-14
            event = lambda t, y, k=k, sign=sign, floor=floor: sign * (self.switch(k, t, y) - floor)  # noqa: E731
            found.append((event, lambda t, y, k=k: self.toggle(k, y)))
        return found

    def toggle(self, k, y):
        self.pressed[k] = not self.pressed[k]
        return y

    def solve(self, times):
        """(position, switches): of the first contact at ``times``, and how many events."""
        t, y, out, switches = 0.0, np.concatenate([self.system.q0, self.system.v0]), [], 0
        self.start(y)
        while True:
            found = self.events(t, y)
            for event, _ in found:
                event.terminal, event.direction = True, -1.0
            path = solve_ivp(
                self.rhs, (t, times[-1]), y, "DOP853", t_eval=times[len(out) :], events=[event for event, _ in found],
                rtol=self.rtol, atol=self.atol, max_step=self.longest,
            )  # fmt: skip
            assert path.success
            out += list(path.y.T) if np.size(path.y) else []
            if path.status != 1:
                moved = np.array([self.offset(0, t) for t in times])
                return np.array(out)[:, : self.n] @ self.system.contacts[0].row + moved, switches
            k = next(k for k, found in enumerate(path.t_events) if len(found))
            t, y = float(path.t_events[k][0]), path.y_events[k][0]
            y, switches = found[k][1](t, y), switches + 1


class RigidWitness(Witness):
    """The motion of such a system: held is the side by contact."""

    rtol, atol, longest = 1e-11, 1e-13, 0.05

    def start(self, y):
        self.held: dict[int, float] = {}

    def motion(self, t, y):
        """Acceleration and the reactions of the contacts held."""
        f, at = self.outer_force(t, y), list(self.held)
        if not at:
            return self.inverse @ f, np.zeros(0)
        rows = np.array([self.system.contacts[c].row for c in at])
        pull = np.array([self.offset(c, t, 2) for c in at])
        R = -np.linalg.solve(rows @ self.inverse @ rows.T, rows @ self.inverse @ f + pull)
        return self.inverse @ (f + rows.T @ R), R

    def rhs(self, t, y):
        return np.concatenate([y[self.n :], self.motion(t, y)[0]])

    def events(self, t, y):
        found = []
        for k, (c, _, _) in enumerate(self.sides):
            if c not in self.held:
                here = -self.depth(k, t, y)[0]
                floor = max(0.0, -here) + 1e-14 if abs(here) < 1e-11 else 0.0  # on the stop: it has to leave first
                event = lambda t, y, k=k, floor=floor: floor - self.depth(k, t, y)[0]  # noqa: E731
                found.append((event, lambda t, y, k=k: self.bounce(t, y, k)))
        for i, (c, side) in enumerate(self.held.items()):
            event = lambda t, y, i=i, side=side: -side * self.motion(t, y)[1][i]  # noqa: E731
            found.append((event, lambda t, y, c=c: self.let_go(t, y, c)))
        return found

    def let_go(self, t, y, c):
        del self.held[c]
        self.settle(t, y)
        return y

    def settle(self, t, y):
        """Let go of what would be pulled at, the most pulled first."""
        while self.held:
            pull = np.array(list(self.held.values())) * self.motion(t, y)[1]  # > 0: a pull
            if np.max(pull) <= 0.0:
                return
            del self.held[list(self.held)[int(np.argmax(pull))]]

    def bounce(self, t, y, k):
        """Newton's law at side k; those held stay so where that takes a push."""
        (c, side, _), others = self.sides[k], dict(self.held)
        contact = self.system.contacts[c]
        while True:
            at = [c, *others]
            rows = np.array([self.system.contacts[x].row for x in at])
            wanted = np.zeros(len(at))
            wanted[0] = -(1.0 + float(contact.stops.restitution)) * self.speed(c, t, y)
            P = np.linalg.solve(rows @ self.inverse @ rows.T, wanted)
            pulled = [x for x, p in zip(at[1:], P[1:], strict=True) if others[x] * p > 0.0]
            if not pulled:
                break
            for x in pulled:
                del others[x]
        towards = self.inverse @ contact.row
        towards = towards / (contact.row @ towards)
        y = y.copy()
        y[: self.n] -= towards * side * self.depth(k, t, y)[0]  # on the stop
        y[self.n :] += self.inverse @ rows.T @ P
        self.held = others
        if abs(self.speed(c, t, y)) < SLOW:
            y[self.n :] -= towards * self.speed(c, t, y)
            self.held[c] = side
            self.settle(t, y)
        return y
