"""Systems as users bring them, none of the paper's: each with a step and a time span in which it meets its stops."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from systems import one_mass

import stiffbeam as sb

Bench = tuple[sb.System, float, float]  # system, dt, t_end
GRAVITY = sb.Constant(-9.81)
SHAKEN = sb.Harmonic(0.01, 40.0)


def at_rest_on_its_stops(bench: Bench) -> Bench:
    """A bench with every gap closed, by its upper stop where there is one, and every body at rest."""
    system, dt, t_end = bench
    contacts = []
    for contact in system.contacts:
        side = "upper" if np.isfinite(contact.stops.law.g2) else "lower"
        contacts.append(replace(contact, stops=replace(contact.stops, **{side: 0.0})))
    still = np.zeros(system.size)
    return replace(system, contacts=tuple(contacts), q0=still, v0=still), dt, t_end


def floor(stiffness: float, **law: float) -> sb.Stops:
    return sb.Stops(lower=0.0, stiffness=stiffness, **law)


def rigid(restitution: float, lower: float | None = None, upper: float | None = None) -> sb.Stops:
    return sb.Stops(lower, upper, stiffness=np.inf, restitution=restitution)


def chain(masses: list[float], springs: list[float], held: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Masses and stiffness of masses in a row, the first held by its spring or free."""
    n = len(masses)
    stretch = np.eye(n) - np.eye(n, k=-1)
    stretch = stretch if held else stretch[1:]
    return np.diag(masses), stretch.T @ np.diag(springs) @ stretch


def bodies(
    mass: Any, stiffness: Any, damping: Any = None, contacts: Any = (), loads: Any = (), v: Any = None, **others: Any
) -> sb.System:
    """Contacts: pairs of a row and stops."""
    made = [sb.Contact(row, stops) for row, stops in contacts]
    return sb.System.from_matrices(mass, stiffness, damping, loads, made, initial_velocity=v, **others)


def record(t_end: float, size: float) -> sb.Sampled:
    """A measured ground acceleration: a few frequencies under an envelope, every 10 ms."""
    t = np.arange(0.0, t_end + 0.02, 0.01)
    return sb.Sampled(t, size * np.exp(-0.2 * t) * (np.sin(9.0 * t) + 0.6 * np.sin(14.3 * t + 1.0)), "linear")


PAIRS = np.eye(4)[:-1] - np.eye(4)[1:]
SPRINGS = np.diag([40.0, 140.0, 60.0])
LINK = [[60.0, -30.0], [-30.0, 30.0]]  # a body on a spring, and another on it
DRIVEN = [([1.0, 0.0], sb.Harmonic(5.0, 9.8))]
LAST = np.diag([0.0, 0.8])
HERTZ = {"stiffness": 1e4, "exponent": 1.5}
MASS, STIFFNESS = chain([1.0, 1.2, 0.8], [60.0, 60.0, 30.0])

BENCHES: dict[str, Bench] = {
    "ball on a vibrating table": (one_mass(0.0, rigid(0.8, 0.0), load=GRAVITY, offset=SHAKEN, q=0.05), 1e-3, 1.0),
    "feeder": (one_mass(0.0, rigid(0.0, 0.0), load=GRAVITY, offset=SHAKEN, q=0.01), 1e-3, 1.0),
    "drop on a Kelvin-Voigt stop": (one_mass(0.0, floor(2e3, damping=5.0), load=GRAVITY, q=0.1), 1e-3, 1.0),
    "drop on a Hunt-Crossley stop": (
        one_mass(0.0, floor(2e4, exponent=1.5, dissipation=0.3), load=GRAVITY, q=0.1), 1e-3, 1.0,
    ),
    "impact damper": (bodies(
        np.diag([1.0, 0.1]), np.diag([100.0, 0.0]), None, [([-1.0, 1.0], sb.Stops(-0.05, 0.05, stiffness=5e3))], DRIVEN,
    ), 1e-3, 3.0),
    "rigid impact damper": (bodies(
        np.diag([1.0, 0.1]), np.diag([100.0, 0.0]), np.diag([0.4, 0.0]), [([-1.0, 1.0], rigid(0.6, -0.05, 0.05))],
        DRIVEN,
    ), 1e-3, 3.0),
    "pounding under a record": (bodies(
        np.diag([1.0, 1.5, 0.8]), SPRINGS, 0.003 * SPRINGS,
        [(PAIRS[0, :3], sb.Stops(upper=0.02, stiffness=5e3)), (PAIRS[1, :3], sb.Stops(upper=0.03, stiffness=5e3))],
        [([-1.0, -1.5, -0.8], record(3.0, 3.0))],
    ), 1e-3, 3.0),
    "two bodies with a dashpot between": (bodies(
        np.diag([2.0, 1.0]), [[80.0, -20.0], [-20.0, 60.0]], [[1.5, -1.5], [-1.5, 1.5]],
        [([-1.0, 1.0], sb.Stops(-0.1, 0.1, stiffness=2e3))], [([1.0, 0.0], sb.Harmonic(12.0, 5.0))],
    ), 1e-3, 4.0),
    "ball on a chain, Hertz": (bodies(
        *chain([1.0, 1.0, 1.0, 0.5], [400.0, 400.0, 400.0, 0.0]), None,
        [([0.0, 0.0, 1.0, -1.0], sb.Stops(upper=0.05, **HERTZ))], v=[0.0, 0.0, 0.0, -1.0],
    ), 1e-3, 1.0),
    "pressed on a rigid stop": (one_mass(
        100.0, rigid(0.8, 0.0), load=sb.Superposition(sb.Constant(-3.0), sb.Harmonic(1.0, 3.0))
    ), 1e-3, 2.0),
    "preloaded stop": (one_mass(
        50.0, sb.Stops(upper=-0.02, stiffness=1e3), damping=0.2, load=sb.Harmonic(4.0, 6.0), q=-0.02
    ), 1e-3, 3.0),
    "chain": (bodies(
        MASS, STIFFNESS, 1e-3 * STIFFNESS, [([0.0, 0.0, 1.0], sb.Stops(-0.35, 0.25, stiffness=900.0))],
        [([0.0, 0.0, 1.0], sb.Harmonic(6.0, 2.2, 0.3))], [0.2, 0.0, 1.0],
    ), 2e-3, 4.0),
    "free rod between two stops": (bodies(
        *chain([0.5, 1.0, 1.0, 0.5], [900.0] * 3, held=False), None,
        [(np.eye(4)[0], sb.Stops(lower=-0.1, stiffness=4e3)), (np.eye(4)[3], sb.Stops(upper=0.1, stiffness=4e3))],
        v=np.ones(4),
    ), 1e-3, 1.5),
    "isolator with a dashpot": (bodies(
        np.diag([3.0, 1.0]), [[150.0, -120.0], [-120.0, 120.0]], np.diag([4.0, 0.0]),
        [([1.0, 0.0], sb.Stops(-0.08, 0.08, stiffness=6e3, damping=10.0))], [([-3.0, -1.0], record(4.0, 4.0))],
    ), 1e-3, 3.0),
    "oscillator under a record, rigid": (
        one_mass(64.0, rigid(0.7, -0.08, 0.08), damping=0.8, load=record(4.0, -6.0)), 1e-3, 3.0,
    ),
    # Granular: spheres that touch and nothing else; the first is thrown.
    "one-sided Hertz chain": (bodies(
        np.eye(4), np.zeros((4, 4)), None, [(row, sb.Stops(upper=0.0, **HERTZ)) for row in PAIRS],
        v=np.eye(4)[0], observe=np.eye(4)[-1],
    ), 1e-4, 0.2),
    # Rigid stops and damping that couples the modes.
    "coupled oscillator, rigid": (bodies(
        np.eye(2), LINK, LAST, [([0.0, 1.0], rigid(0.8, upper=0.15))], [([1.0, 0.0], sb.Harmonic(6.0, 3.0))],
    ), 1e-3, 4.0),
    "free oscillator with a dashpot, no stops": (bodies(
        np.eye(2), LINK, LAST, initial_displacement=[0.0, 0.1], observe=[0.0, 1.0],
    ), 1e-2, 4.0),
}  # fmt: skip
