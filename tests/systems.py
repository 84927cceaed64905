"""Systems that several tests share, besides the fixtures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from witness import Case, Contact

import stiffbeam as sb


def linear_part(system: sb.System) -> tuple[np.ndarray, ...]:
    """Mass, damping, stiffness, q(0), q'(0): what an oracle is given in place of the System."""
    return system.mass, system.damping, system.stiffness, system.q0, system.v0


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


def two_contacts(**kwargs) -> sb.System:
    """A chain of four masses with stops at two of them, a moving stop and a full mass matrix."""
    mass = np.diag([1.0, 1.2, 0.8, 1.0]) + 0.1 * (np.eye(4, k=1) + np.eye(4, k=-1))
    stiffness = 40.0 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    unit = np.eye(4)
    return sb.System.from_matrices(
        mass,
        stiffness,
        loads=[(unit[1], kwargs.get("load", sb.Harmonic(15.0, 4.0))), (unit[3], sb.Harmonic(9.0, 2.5, 1.0))],
        contacts=[
            sb.Contact(unit[3], sb.Stops(-0.25, 0.2, stiffness=3e3)),
            sb.Contact(unit[2], sb.Stops(None, 0.15, stiffness=2e3), kwargs.get("offset", sb.Harmonic(0.05, 3.0))),
        ],
        observe=unit[0],
        initial_velocity=[0.0, 1.0, 0.0, 0.5],
    )


def bouncing_chain(**kwargs) -> sb.System:
    """Three masses, full mass matrix, one contact with a moving stop: small enough for every solver."""
    mass = np.array([[1.0, 0.2, 0.0], [0.2, 1.5, 0.1], [0.0, 0.1, 0.7]])
    stiffness = np.array([[60.0, -30.0, 0.0], [-30.0, 60.0, -30.0], [0.0, -30.0, 30.0]])
    return sb.System.from_matrices(
        mass,
        stiffness,
        kwargs.pop("damping", None),
        loads=[([0.0, 0.0, 1.0], sb.Harmonic(6.0, 2.2, 0.3)), ([1.0, 0.0, 0.0], sb.Constant(0.4))],
        contacts=[
            sb.Contact(
                [0.0, 0.2, 1.0], sb.Stops(-0.35, 0.25, stiffness=900.0), kwargs.pop("offset", sb.Harmonic(0.05, 1.1))
            )
        ],
        initial_velocity=[0.2, 0.0, 1.0],
        **kwargs,
    )


def three_masses(damping: Any = None) -> sb.System:
    """A smooth forced linear system with frequencies 0.8 to 3.2, a full mass matrix and no contact."""
    mass = np.array([[2.0, 0.5, 0.0], [0.5, 2.0, 0.5], [0.0, 0.5, 1.0]])
    stiffness = np.array([[8.0, -3.0, 0.0], [-3.0, 7.0, -3.0], [0.0, -3.0, 5.0]])
    return sb.System.from_matrices(
        mass,
        stiffness,
        damping,
        loads=[(np.array([1.0, 0.0, -1.0]), sb.Harmonic(1.0, 1.3, 0.4)), (np.array([0.0, 0.5, 0.5]), sb.Constant(0.7))],
        observe=[0.0, 0.0, 1.0],
        initial_displacement=[0.3, -0.2, 0.1],
        initial_velocity=[0.0, 0.4, -0.5],
    )


def function_of(wave: Any) -> Any:
    """A witness's function of time as the package takes it."""
    if wave is None:
        return None
    kinds = {"constant": sb.Constant, "harmonic": sb.Harmonic, "sampled": sb.Sampled}
    return kinds[wave[0]](*wave[1:])


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
            c.row, c.stops.lower_bound, c.stops.upper_bound, float(c.stops.stiffness), c.offset and wave(c.offset)
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
