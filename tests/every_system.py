"""Systems as users bring them, none of the paper's: each with a step and a time span in which it meets its stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from systems import one_mass

import stiffbeam as sb

Bench = tuple[sb.System, float, float]  # system, dt, t_end
GRAVITY = 9.81
BENCHES: dict[str, Callable[[], Bench]] = {}


def at_rest_on_its_stops(bench: Bench) -> Bench:
    """A bench with every gap closed, by its upper stop where there is one, and every body at rest."""
    system, dt, t_end = bench
    contacts = []
    for contact in system.contacts:
        side = "upper" if np.isfinite(contact.stops.upper_bound) else "lower"
        contacts.append(replace(contact, stops=replace(contact.stops, **{side: 0.0})))
    still = np.zeros(system.size)
    return replace(system, contacts=tuple(contacts), q0=still, v0=still), dt, t_end


def bench(name: str) -> Callable[[Callable[[], Bench]], Callable[[], Bench]]:
    """Register a system under ``name``."""

    def register(make: Callable[[], Bench]) -> Callable[[], Bench]:
        BENCHES[name] = make
        return make

    return register


def ball(stops: sb.Stops, height: float, table: sb.Harmonic | None = None) -> sb.System:
    """A mass 1 that falls on a floor or on a moving table."""
    return sb.System.from_matrices(
        [[1.0]],
        [[0.0]],
        loads=[([-GRAVITY], sb.Constant(1.0))],
        contacts=[sb.Contact([1.0], stops, table)],
        initial_displacement=[height],
    )


def chain(masses: list[float], springs: list[float], held: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Masses and stiffness of masses in a row, the first held by its spring or free."""
    n = len(masses)
    stretch = np.eye(n) - np.eye(n, k=-1)
    stretch = stretch if held else stretch[1:]
    return np.diag(masses), stretch.T @ np.diag(springs) @ stretch


def record(t_end: float, size: float = 1.0) -> sb.Sampled:
    """A measured ground acceleration: a few frequencies under an envelope, every 10 ms."""
    t = np.arange(0.0, t_end + 0.02, 0.01)
    return sb.Sampled(t, size * np.exp(-0.2 * t) * (np.sin(9.0 * t) + 0.6 * np.sin(14.3 * t + 1.0)), "linear")


@bench("ball on a vibrating table")
def _vibrating_table() -> Bench:
    return ball(sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.8), 0.05, sb.Harmonic(0.01, 40.0)), 1e-3, 1.0


@bench("feeder")
def _feeder() -> Bench:
    return ball(sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.0), 0.01, sb.Harmonic(0.01, 40.0)), 1e-3, 1.0


@bench("drop on a Kelvin-Voigt stop")
def _kelvin_voigt_drop() -> Bench:
    return ball(sb.Stops(lower=0.0, stiffness=2e3, damping=5.0), 0.1), 1e-3, 1.0


@bench("drop on a Hunt-Crossley stop")
def _hunt_crossley_drop() -> Bench:
    return ball(sb.Stops(lower=0.0, stiffness=2e4, exponent=1.5, dissipation=0.3), 0.1), 1e-3, 1.0


@bench("impact damper")
def _impact_damper() -> Bench:
    system = sb.System.from_matrices(
        np.diag([1.0, 0.1]),
        [[100.0, 0.0], [0.0, 0.0]],
        loads=[([1.0, 0.0], sb.Harmonic(5.0, 9.8))],
        contacts=[sb.Contact([-1.0, 1.0], sb.Stops(-0.05, 0.05, stiffness=5e3))],
    )
    return system, 1e-3, 3.0


@bench("rigid impact damper")
def _rigid_impact_damper() -> Bench:
    system = sb.System.from_matrices(
        np.diag([1.0, 0.1]),
        [[100.0, 0.0], [0.0, 0.0]],
        [[0.4, 0.0], [0.0, 0.0]],
        loads=[([1.0, 0.0], sb.Harmonic(5.0, 9.8))],
        contacts=[sb.Contact([-1.0, 1.0], sb.Stops(-0.05, 0.05, stiffness=np.inf, restitution=0.6))],
    )
    return system, 1e-3, 3.0


@bench("pounding under a record")
def _pounding() -> Bench:
    masses, springs = np.array([1.0, 1.5, 0.8]), np.array([40.0, 140.0, 60.0])
    system = sb.System.from_matrices(
        np.diag(masses),
        np.diag(springs),
        0.003 * np.diag(springs),
        loads=[(-masses, record(3.0, 3.0))],
        contacts=[
            sb.Contact([1.0, -1.0, 0.0], sb.Stops(upper=0.02, stiffness=5e3)),
            sb.Contact([0.0, 1.0, -1.0], sb.Stops(upper=0.03, stiffness=5e3)),
        ],
    )
    return system, 1e-3, 3.0


@bench("two bodies with a dashpot between")
def _dashpot_between() -> Bench:
    system = sb.System.from_matrices(
        np.diag([2.0, 1.0]),
        [[80.0, -20.0], [-20.0, 60.0]],
        [[1.5, -1.5], [-1.5, 1.5]],
        loads=[([1.0, 0.0], sb.Harmonic(12.0, 5.0))],
        contacts=[sb.Contact([-1.0, 1.0], sb.Stops(-0.1, 0.1, stiffness=2e3))],
    )
    return system, 1e-3, 4.0


@bench("ball on a chain, Hertz")
def _ball_on_a_chain() -> Bench:
    mass, stiffness = chain([1.0, 1.0, 1.0, 0.5], [400.0, 400.0, 400.0, 0.0])
    system = sb.System.from_matrices(
        mass,
        stiffness,
        contacts=[sb.Contact([0.0, 0.0, 1.0, -1.0], sb.Stops(upper=0.05, stiffness=1e4, exponent=1.5))],
        initial_velocity=[0.0, 0.0, 0.0, -1.0],
    )
    return system, 1e-3, 1.0


@bench("preloaded stop")
def _preloaded() -> Bench:
    system = one_mass(50.0, sb.Stops(upper=-0.02, stiffness=1e3), damping=0.2, load=sb.Harmonic(4.0, 6.0), q=-0.02)
    return system, 1e-3, 3.0


@bench("chain")
def _chain() -> Bench:
    mass, stiffness = chain([1.0, 1.2, 0.8], [60.0, 60.0, 30.0])
    system = sb.System.from_matrices(
        mass,
        stiffness,
        1e-3 * stiffness,
        loads=[([0.0, 0.0, 1.0], sb.Harmonic(6.0, 2.2, 0.3))],
        contacts=[sb.Contact([0.0, 0.0, 1.0], sb.Stops(-0.35, 0.25, stiffness=900.0))],
        initial_velocity=[0.2, 0.0, 1.0],
    )
    return system, 2e-3, 4.0


@bench("free rod between two stops")
def _free_rod() -> Bench:
    mass, stiffness = chain([0.5, 1.0, 1.0, 0.5], [900.0] * 3, held=False)
    system = sb.System.from_matrices(
        mass,
        stiffness,
        contacts=[
            sb.Contact([1.0, 0.0, 0.0, 0.0], sb.Stops(lower=-0.1, stiffness=4e3)),
            sb.Contact([0.0, 0.0, 0.0, 1.0], sb.Stops(upper=0.1, stiffness=4e3)),
        ],
        initial_velocity=np.ones(4),
    )
    return system, 1e-3, 1.5


@bench("isolator with a dashpot")
def _isolator() -> Bench:
    system = sb.System.from_matrices(
        np.diag([3.0, 1.0]),
        [[150.0, -120.0], [-120.0, 120.0]],
        [[4.0, 0.0], [0.0, 0.0]],
        loads=[([-3.0, -1.0], record(4.0, 4.0))],
        contacts=[sb.Contact([1.0, 0.0], sb.Stops(-0.08, 0.08, stiffness=6e3, damping=10.0))],
    )
    return system, 1e-3, 3.0


@bench("oscillator under a record, rigid")
def _rigid_oscillator() -> Bench:
    system = sb.System.from_matrices(
        [[1.0]],
        [[64.0]],
        [[0.8]],
        loads=[([-1.0], record(4.0, 6.0))],
        contacts=[sb.Contact([1.0], sb.Stops(-0.08, 0.08, stiffness=np.inf, restitution=0.7))],
    )
    return system, 1e-3, 3.0


@bench("one-sided Hertz chain")
def _hertz_chain() -> Bench:
    """Granular: spheres that touch and nothing else; the first is thrown."""
    n = 4
    pairs = np.eye(n)[:-1] - np.eye(n)[1:]
    stops = sb.Stops(upper=0.0, stiffness=1e4, exponent=1.5)
    system = sb.System.from_matrices(
        np.eye(n),
        np.zeros((n, n)),
        contacts=[sb.Contact(row, stops) for row in pairs],
        initial_velocity=[1.0, 0.0, 0.0, 0.0],
        observe=np.eye(n)[-1],
    )
    return system, 1e-4, 0.2


@bench("coupled oscillator, rigid")
def _rigid_dashpot() -> Bench:
    """Rigid stops and damping that couples the modes."""
    system = sb.System.from_matrices(
        np.diag([1.0, 1.0]),
        [[60.0, -30.0], [-30.0, 30.0]],
        [[0.0, 0.0], [0.0, 0.8]],
        loads=[([1.0, 0.0], sb.Harmonic(6.0, 3.0))],
        contacts=[sb.Contact([0.0, 1.0], sb.Stops(upper=0.15, stiffness=np.inf, restitution=0.8))],
    )
    return system, 1e-3, 4.0


@bench("free oscillator with a dashpot, no stops")
def _no_stops() -> Bench:
    system = sb.System.from_matrices(
        np.diag([1.0, 1.0]),
        [[60.0, -30.0], [-30.0, 30.0]],
        [[0.0, 0.0], [0.0, 0.8]],
        initial_displacement=[0.0, 0.1],
        observe=[0.0, 1.0],
    )
    return system, 1e-2, 4.0
