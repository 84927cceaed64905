"""Random systems on rigid stops, and a solver for them that shares nothing with the package.

The witness of ``law_systems`` from event to event: a gap that closes turns the velocity round by Newton's law, a
contact that leaves slower than SLOW while it is pressed is held, one that is held leaves where its reaction ends.
"""

from __future__ import annotations

import numpy as np
from law_systems import Witness, driven

import stiffbeam as sb

SLOW = 1e-6  # of bounces that are left out: over within 2 SLOW/(a (1 - e))


def stops_of(rng: np.random.Generator) -> sb.Stops:
    """Rigid stops on one side or both."""
    e = float(rng.choice([0.0, rng.uniform(0.1, 0.9)]))
    gap = float(rng.uniform(0.05, 0.3))
    return sb.Stops(-gap, 0.7 * gap if rng.random() < 0.5 else None, stiffness=np.inf, restitution=e)


def random_system(seed: int) -> sb.System:
    """One to three unknowns, one or two contacts, pressed by a constant load in every other system."""
    return driven(np.random.default_rng([seed, 1404]), [stops_of] * (1 + seed % 2), 3, 0.2, seed % 4 < 2)


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
