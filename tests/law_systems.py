"""Random systems with every law of contact, and a solver for them that shares nothing with the package.

SciPy's DOP853 from switch to switch. A side is free or pressed; a free one is entered where its gap closes or,
already inside, where its force would be > 0 again; a pressed one is left where its force is zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

import stiffbeam as sb

LAWS = ("power", "kelvin-voigt", "hunt-crossley", "all")


def stops_of(rng: np.random.Generator, law: str) -> sb.Stops:
    """Stops at a random distance, on one side or both."""
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
    return _system(np.random.default_rng([seed, 1302]), [LAWS[(seed + c) % len(LAWS)] for c in range(1 + seed % 2)])


def kelvin_voigt_system(seed: int) -> sb.System:
    """The same with damped linear stops."""
    return _system(np.random.default_rng([seed, 77]), ["kelvin-voigt"] * (1 + seed % 2))


def _system(rng: np.random.Generator, laws: list[str]) -> sb.System:
    n = int(rng.integers(1, 5))
    A, B = rng.normal(size=(2, n, n))
    mass, stiffness = np.eye(n) + 0.1 * A @ A.T, 4.0 * np.eye(n) + B @ B.T
    damping = rng.choice([0.0, 0.05]) * mass + rng.choice([0.0, 0.02]) * stiffness
    contacts = []
    for c, law in enumerate(laws[:n]):
        offset = sb.Harmonic(0.03, float(rng.uniform(1.0, 4.0)), 0.3) if rng.random() < 0.25 else None
        contacts.append(sb.Contact(np.eye(n)[c], stops_of(rng, law), offset))
    loads = [(rng.normal(size=n), sb.Harmonic(float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.5, 5.0))))]
    return sb.System.from_matrices(
        mass, stiffness, damping, loads, contacts, initial_displacement=np.zeros(n), initial_velocity=rng.normal(size=n)
    )


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
    """The motion of such a system."""

    def __init__(self, system: sb.System) -> None:
        self.system, self.n = system, len(system.mass)
        self.inverse = np.linalg.inv(system.mass)
        self.sides = []
        for contact in system.contacts:
            for sign, stop in ((1.0, contact.stops.upper), (-1.0, contact.stops.lower)):
                if stop is not None:
                    self.sides.append((contact, sign, float(stop)))
        self.pressed = [False] * len(self.sides)

    def depth(self, k, t, y):
        contact, sign, stop = self.sides[k]
        o = contact.offset
        shift = 0.0 if o is None else o.amplitude * np.sin(o.frequency * t + o.phase)
        rate = 0.0 if o is None else o.amplitude * o.frequency * np.cos(o.frequency * t + o.phase)
        return sign * (contact.row @ y[: self.n] + shift - stop), sign * (contact.row @ y[self.n :] + rate)

    def force(self, k, t, y):
        stops, (d, rate) = self.sides[k][0].stops, self.depth(k, t, y)
        size = np.sign(d) * abs(d) ** float(stops.exponent)
        return stops.stiffness * size * (1.0 + stops.dissipation * rate) + stops.damping * rate

    def rhs(self, t, y):
        s = self.system
        f = -s.stiffness @ y[: self.n] - s.damping @ y[self.n :]
        for vector, load in s.loads:
            level = getattr(load, "level", None)
            f = f + vector * (load.amplitude * np.sin(load.frequency * t + load.phase) if level is None else level)
        for k, (contact, sign, _) in enumerate(self.sides):
            if self.pressed[k]:
                f = f - sign * contact.row * self.force(k, t, y)
        return np.concatenate([y[self.n :], self.inverse @ f])

    def switch(self, k, t, y):
        """> 0 where the side presses: beyond the stop, and with a force that is no pull."""
        stops, (d, rate) = self.sides[k][0].stops, self.depth(k, t, y)
        return min(d, 1.0 + stops.dissipation * rate if stops.damping == 0.0 else self.force(k, t, y))

    def solve(self, times, rtol=1e-12):
        """(tip, switches): the first contact's position at ``times`` and how often a side was entered or left."""
        t, y, out, switches = 0.0, np.concatenate([self.system.q0, self.system.v0]), [], 0
        end, floors = times[-1], np.zeros(len(self.sides))
        for k in range(len(self.sides)):
            self.pressed[k] = self.switch(k, t, y) > 0.0
        while True:
            # A switch just made is looked for a little past where it was.
            for k, closed in enumerate(self.pressed):
                here = self.switch(k, t, y)
                floors[k] = min(here, 0.0) - 1e-14 if closed else max(here, 0.0) + 1e-14
            events = []
            for k, closed in enumerate(self.pressed):
                event = lambda t, y, k=k: self.switch(k, t, y) - floors[k]  # noqa: E731
                event.terminal, event.direction = True, -1.0 if closed else 1.0
                events.append(event)
            due = times[len(out) :]
            path = solve_ivp(
                self.rhs, (t, end), y, "DOP853", t_eval=due, events=events, rtol=rtol, atol=1e-13, max_step=0.02
            )
            assert path.success
            if np.size(path.y):
                out += list(path.y.T)
            if path.status != 1:
                break
            k = next(k for k, found in enumerate(path.t_events) if len(found))
            t, y = float(path.t_events[k][0]), path.y_events[k][0]
            self.pressed[k] = not self.pressed[k]
            switches += 1
        row = self.system.contacts[0].row
        return np.array(out)[:, : self.n] @ row, switches
