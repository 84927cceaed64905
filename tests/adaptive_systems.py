"""Systems with every kind of stop, load and damping, as ``SYSTEMS`` of (maker, end of the motion)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg
from systems import bouncing_chain, two_contacts

import stiffbeam as sb


def chain(size: int, contacts: list[sb.Contact], loads=(), damping: float = 0.0) -> sb.System:
    """Unit masses between springs of 100, both ends held, the last with a velocity."""
    K = 100.0 * (2.0 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1))
    last = np.eye(size)[-1]
    return sb.System.from_matrices(
        np.eye(size), K, damping * K, loads, contacts, observe=last, initial_velocity=last
    )  # fmt: skip


def stop(size: int = 3, offset=None, **law) -> list[sb.Contact]:
    """An upper stop at the last mass."""
    return [sb.Contact(np.eye(size)[-1], sb.Stops(**{"upper": 0.02, "stiffness": 1e4} | law), offset)]


def record(kind: str) -> sb.Sampled:
    """A load that rises and falls within 0.4."""
    t = np.linspace(0.0, 1.0, 21)
    return sb.Sampled(t, 30.0 * np.sin(np.pi * np.minimum(t / 0.4, 1.0)) ** 2, kind=kind)


def rotor(gap: float = 0.05, kappa: float = 2e3, sides: int = 8) -> sb.System:
    """Jeffcott rotor: a disc at (x, y) with two tilts, out of balance, between stops around it. Its gyroscopic moments
    and a whirl of the bearings make C unsymmetric."""
    stiffness = [[100.0, 0.0, 12.0, 0.0], [0.0, 110.0, 0.0, -9.0], [12.0, 0.0, 40.0, 0.0], [0.0, -9.0, 0.0, 36.0]]
    skew = scipy.linalg.block_diag([[0.0, 0.4], [-0.4, 0.0]], [[0.0, 1.5], [-1.5, 0.0]])
    angles = 2.0 * np.pi * np.arange(sides) / sides
    stops = sb.Stops(upper=gap, stiffness=kappa)
    return sb.System.from_matrices(
        np.diag([1.0, 1.0, 0.3, 0.3]), stiffness, 0.05 * np.eye(4) + skew,
        loads=[([1, 0, 0, 0], sb.Harmonic(5.0, 7.0, np.pi / 2)), ([0, 1, 0, 0], sb.Harmonic(5.0, 7.0))],
        contacts=[sb.Contact([np.cos(a), np.sin(a), 0.0, 0.0], stops) for a in angles],
        observe=[1.0, 0.0, 0.0, 0.0], initial_velocity=[0.0, 0.3, 0.0, 0.2],
    )  # fmt: skip


def beam(form: str, viscosity: float = 0.0) -> sb.System:
    """Table 10 with ten cells."""
    return sb.semidiscretise(replace(sb.paper_case(10).problem, viscosity=viscosity), 10, form)


ONES, MOVING = np.ones(3), sb.Sampled(np.linspace(0, 1, 9), 0.01 * np.sin(np.arange(9.0)), kind="cubic")
SYSTEMS = {
    "table 10": (lambda: beam("displacement"), 0.06),  # its errors grow a thousandfold in a tenth
    "velocity-curvature": (lambda: beam("velocity-curvature"), 0.06),
    "viscous": (lambda: beam("displacement", 0.5), 0.2),
    "banded": (lambda: chain(40, stop(40)), 0.5),
    "two sides, damped": (lambda: chain(3, stop(lower=-0.02), damping=1e-3), 0.5),
    "Hertz": (lambda: chain(3, stop(stiffness=1e5, exponent=1.5)), 0.5),
    "Kelvin-Voigt": (lambda: chain(3, stop(damping=5.0)), 0.5),
    "Hunt-Crossley": (lambda: chain(3, stop(stiffness=1e5, exponent=1.5, dissipation=0.3)), 0.5),
    "two contacts": (
        lambda: chain(3, [*stop(), sb.Contact([1.0, -1.0, 0.0], sb.Stops(upper=0.01, stiffness=3e3))]),
        0.5,
    ),
    "polygon": (lambda: chain(3, stop(), [(ONES, record("linear"))]), 0.5),
    "cubic record and a harmonic": (
        lambda: chain(3, stop(), [(ONES, sb.Superposition(record("cubic"), sb.Harmonic(3.0, 11.0)))]),
        0.5,
    ),
    "moving stop": (lambda: chain(3, stop(offset=sb.Harmonic(0.01, 20.0))), 0.5),
    "damped stop under a record": (lambda: chain(3, stop(damping=5.0), [(ONES, record("cubic"))]), 0.5),
    "damped stop that moves by a record": (lambda: chain(3, stop(damping=5.0, offset=MOVING)), 0.5),
    "no contact": (lambda: chain(3, [], [(ONES, sb.Harmonic(3.0, 11.0))]), 0.5),
    "bouncing chain": (bouncing_chain, 4.0),
    "two contacts, one moving": (two_contacts, 4.0),
    "rotor": (rotor, 3.0),
}
