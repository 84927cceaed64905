"""Systems that several tests share, besides the fixtures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from witness import Case, Contact

import stiffbeam as sb


def one_mass(
    stiffness: float, stops: sb.Stops | None = None, *, mass: float = 1.0, damping: float = 0.0,
    load: Any = None, offset: Any = None, q: float = 0.0, v: float = 0.0, **others: Any,
) -> sb.System:  # fmt: skip
    """m x'' + c x' + k x = load(t) between stops or without, from x = q and x' = v; ``offset`` moves the stops."""
    contacts = [] if stops is None else [sb.Contact([1.0], stops, offset)]
    loads = [] if load is None else [([1.0], load)]
    others = {"observe": None if contacts else [1.0], "initial_displacement": [q], "initial_velocity": [v]} | others
    return sb.System.from_matrices([[mass]], [[stiffness]], [[damping]], loads, contacts, **others)


def with_stops(system: sb.System, *stops: sb.Stops) -> sb.System:
    """The system with other stops, one for each contact."""
    pairs = zip(system.contacts, stops, strict=True)
    return replace(system, contacts=tuple(replace(contact, stops=each) for contact, each in pairs))


def two_contacts() -> sb.System:
    """A chain of four masses with stops at two of them, a moving stop and a full mass matrix."""
    unit, neighbours = np.eye(4), np.eye(4, k=1) + np.eye(4, k=-1)
    return sb.System.from_matrices(
        np.diag([1.0, 1.2, 0.8, 1.0]) + 0.1 * neighbours, 40.0 * (2.0 * unit - neighbours),
        loads=[(unit[1], sb.Harmonic(15.0, 4.0)), (unit[3], sb.Harmonic(9.0, 2.5, 1.0))],
        contacts=[
            sb.Contact(unit[3], sb.Stops(-0.25, 0.2, stiffness=3e3)),
            sb.Contact(unit[2], sb.Stops(None, 0.15, stiffness=2e3), sb.Harmonic(0.05, 3.0)),
        ],
        observe=unit[0], initial_velocity=[0.0, 1.0, 0.0, 0.5],
    )  # fmt: skip


def pair(offset: Any = None, **law: float) -> sb.System:
    """Two masses with a drive and a dashpot between them, one of them between stops."""
    stops = sb.Stops(lower=-0.1, upper=0.08, stiffness=4e3, **law)
    return sb.System.from_matrices(
        np.diag([2.0, 1.0]), [[90.0, -40.0], [-40.0, 60.0]], [[0.3, -0.2], [-0.2, 0.4]],
        loads=[([0.0, 1.0], sb.Harmonic(9.0, 7.0, 0.3))], contacts=[sb.Contact([0.0, 1.0], stops, offset)],
        initial_velocity=[0.5, -1.0],
    )  # fmt: skip


def bouncing_chain(**others: Any) -> sb.System:
    """Three masses, full mass matrix, one contact with a moving stop: small enough for every solver."""
    stops, motion = sb.Stops(-0.35, 0.25, stiffness=900.0), sb.Harmonic(0.05, 1.1)
    return sb.System.from_matrices(
        [[1.0, 0.2, 0.0], [0.2, 1.5, 0.1], [0.0, 0.1, 0.7]],
        [[60.0, -30.0, 0.0], [-30.0, 60.0, -30.0], [0.0, -30.0, 30.0]],
        loads=[([0.0, 0.0, 1.0], sb.Harmonic(6.0, 2.2, 0.3)), ([1.0, 0.0, 0.0], sb.Constant(0.4))],
        contacts=[sb.Contact([0.0, 0.2, 1.0], stops, motion)], initial_velocity=[0.2, 0.0, 1.0], **others,
    )  # fmt: skip


def three_masses(damping: Any = None) -> sb.System:
    """A smooth forced linear system with frequencies 0.8 to 3.2, a full mass matrix and no contact."""
    return sb.System.from_matrices(
        [[2.0, 0.5, 0.0], [0.5, 2.0, 0.5], [0.0, 0.5, 1.0]], [[8.0, -3.0, 0.0], [-3.0, 7.0, -3.0], [0.0, -3.0, 5.0]],
        damping, [([1.0, 0.0, -1.0], sb.Harmonic(1.0, 1.3, 0.4)), ([0.0, 0.5, 0.5], sb.Constant(0.7))],
        observe=[0.0, 0.0, 1.0], initial_displacement=[0.3, -0.2, 0.1], initial_velocity=[0.0, 0.4, -0.5],
    )  # fmt: skip


def function_of(wave: Any) -> Any:
    """A witness's function of time as the package takes it."""
    if wave is None:
        return None
    kind, *numbers = wave
    if kind == "sum":
        return sb.Superposition(*map(function_of, numbers))
    return {"constant": sb.Constant, "harmonic": sb.Harmonic, "sampled": sb.Sampled}[kind](*numbers)


def system_of(case: Case) -> sb.System:
    """The system of a witness's case."""
    stops = [
        sb.Stops(*(float(x) if np.isfinite(x) else None for x in (c.lower, c.upper)), stiffness=c.kappa)
        for c in case.contacts
    ]
    contacts = [sb.Contact(c.row, s, function_of(c.offset)) for c, s in zip(case.contacts, stops, strict=True)]
    return sb.System.from_matrices(
        case.mass, case.stiffness, case.damping, [(p, function_of(wave)) for p, wave in case.loads], contacts,
        observe=case.observe, initial_displacement=case.q0, initial_velocity=case.v0,
    )  # fmt: skip


def case_of(system: sb.System, t_end: Any) -> Case:
    """The plain numbers of a system with linear stops, for a witness."""

    def wave(f: Any) -> Any:
        if isinstance(f, sb.Sampled):
            return "sampled", f.t, f.values
        return ("constant", f.level) if isinstance(f, sb.Constant) else ("harmonic", f.amplitude, f.frequency, f.phase)

    contacts = tuple(
        Contact(
            c.row, c.stops.law.g1, c.stops.law.g2, float(c.stops.stiffness), c.offset and wave(c.offset)
        )
        for c in system.contacts
    )  # fmt: skip
    loads = tuple((np.array(row), wave(f)) for row, f in system.loads)
    observe = system.channels[system.tip_channel][0]
    return Case(system.mass, system.damping, system.stiffness, system.q0, system.v0, loads, contacts, observe, t_end)


LAWS = [{}, {}, {"damping": 3.0}, {"dissipation": 0.3}, {"exponent": 1.5}]


def random_chain(seed: int, laws: list[dict[str, float]] = LAWS, stiff: float = 1.0) -> tuple[sb.System, float]:
    """A chain with up to four contacts of any of the laws, stops that move or not, loads of any kind, in its modes or
    coupled by a dashpot; and its slowest angular frequency."""
    rng = np.random.default_rng([seed, 11])
    n, m = int(rng.integers(1, 6)), int(rng.integers(0, 5))
    mass, springs = np.diag(rng.uniform(0.5, 2.0, n)), 10.0 ** rng.uniform(0.5, 3.0, n)
    stiffness = np.diag(springs + np.append(springs[1:], 0.0)) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)
    slow = float(np.sqrt(np.min(np.linalg.eigvals(stiffness / np.diag(mass)[:, None]).real)))
    size, kind = float(np.mean(springs)), int(rng.integers(4))
    damping = (kind > 1) * (rng.uniform(0.0, 0.1) * mass + rng.uniform(0.0, 1e-3) * stiffness)
    damping[-1, -1] += (kind == 3) * slow * rng.uniform(0.0, 1.0)

    def function() -> Any:
        wave = sb.Harmonic(rng.normal(), rng.uniform(0.3, 3.0) * slow, phase=rng.uniform(0.0, 6.0))
        samples = sb.Sampled(np.linspace(0.0, 200.0 / slow, 401), rng.normal(size=401), kind="linear")
        both = sb.Superposition(wave, sb.Constant(rng.normal()))
        return [sb.Constant(rng.normal()), wave, both, samples][rng.integers(4)]

    contacts = []
    for _ in range(m):
        kappa, law = stiff * 10.0 ** rng.uniform(1.0, 4.0) * size / 30.0, laws[rng.integers(len(laws))]
        stops = sb.Stops(-rng.uniform(0.1, 1.0), rng.uniform(0.1, 1.0), stiffness=kappa, **law)
        offset = sb.Harmonic(0.1, rng.uniform(0.3, 3.0) * slow) if rng.random() < 0.3 else None
        contacts.append(sb.Contact(rng.normal(size=n), stops, offset))
    loads = [(size * rng.normal(size=n), function()) for _ in range(rng.integers(0, 4))]
    if seed % 8 == 5:
        loads = [(row, lambda t, f=f: f.value(np.abs(t))) for row, f in loads]  # functions of Python
    system = sb.System.from_matrices(
        mass, stiffness, damping, loads, contacts, observe=None if m else np.eye(n)[0],
        initial_displacement=0.5 * rng.normal(size=n), initial_velocity=rng.normal(size=n),
    )  # fmt: skip
    return system, slow


# Systems with every kind of stop, load and damping.


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


def rotor() -> sb.System:
    """Jeffcott rotor: a disc at (x, y) with two tilts, out of balance, between stops around it. Its gyroscopic moments
    and a whirl of the bearings make C unsymmetric."""
    stiffness = [[100.0, 0.0, 12.0, 0.0], [0.0, 110.0, 0.0, -9.0], [12.0, 0.0, 40.0, 0.0], [0.0, -9.0, 0.0, 36.0]]
    skew = block_diag([[0.0, 0.4], [-0.4, 0.0]], [[0.0, 1.5], [-1.5, 0.0]])
    angles, stops = 0.25 * np.pi * np.arange(8), sb.Stops(upper=0.05, stiffness=2e3)
    return sb.System.from_matrices(
        np.diag([1.0, 1.0, 0.3, 0.3]), stiffness, 0.05 * np.eye(4) + skew,
        loads=[([1, 0, 0, 0], sb.Harmonic(5.0, 7.0, np.pi / 2)), ([0, 1, 0, 0], sb.Harmonic(5.0, 7.0))],
        contacts=[sb.Contact([np.cos(a), np.sin(a), 0.0, 0.0], stops) for a in angles],
        observe=[1.0, 0.0, 0.0, 0.0], initial_velocity=[0.0, 0.3, 0.0, 0.2],
    )  # fmt: skip


def beam_of(form: str, viscosity: float = 0.0) -> sb.System:
    """Table 10 with ten cells."""
    return sb.semidiscretise(replace(sb.paper_case(10).problem, viscosity=viscosity), 10, form)


ONES, MOVING = np.ones(3), sb.Sampled(np.linspace(0, 1, 9), 0.01 * np.sin(np.arange(9.0)), kind="cubic")
SYSTEMS = {  # maker, end of the motion
    "table 10": (lambda: beam_of("displacement"), 0.06),  # its errors grow a thousandfold in a tenth
    "velocity-curvature": (lambda: beam_of("velocity-curvature"), 0.06),
    "viscous": (lambda: beam_of("displacement", 0.5), 0.2),
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
