"""Random vibro-impact systems as plain data, made to be hard: a seed and an index name one for ever."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.linalg
from witness import Case, Contact, Wave

Rng = np.random.Generator


def case(seed: int, index: int) -> Case:
    """System ``index`` of the campaign ``seed``: its family goes round, its numbers are random.

    From ``MEETING_FROM`` on the families are those whose eigenvalues meet.
    """
    families = FAMILIES if index < MEETING_FROM else MEETING
    name = list(families)[index % len(families)]
    made = families[name](np.random.default_rng([seed, index]))
    return replace(made, notes=name)


def _log(rng: Rng, low: float, high: float) -> float:
    """A number between low and high, its logarithm uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _chain(rng: Rng, n: int, full_mass: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness of a chain held at its first mass, or of any positive definite pair."""
    mass = np.diag(rng.uniform(0.5, 2.0, n))
    if full_mass:
        x = rng.normal(size=(n, n)) / n
        mass = mass + 0.3 * x @ x.T
    springs = 10.0 ** rng.uniform(0.5, 3.0, n)
    stiffness = np.diag(springs + np.append(springs[1:], 0.0))
    stiffness -= np.diag(springs[1:], 1) + np.diag(springs[1:], -1)
    return mass, stiffness


def _omegas(mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    return np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True))


def _damping(rng: Rng, mass: np.ndarray, stiffness: np.ndarray, kind: str) -> np.ndarray:
    first = float(_omegas(mass, stiffness)[0])
    if kind == "none":
        return np.zeros_like(mass)
    if kind == "proportional":
        return _log(rng, 1e-4, 0.3) * first * mass + _log(rng, 1e-5, 0.05) / first * stiffness
    if kind == "dashpot":
        d = np.zeros(len(mass))
        d[rng.integers(len(mass))] = 1.0
        return _log(rng, 1e-3, 3.0) * first * np.outer(d, d)
    return _log(rng, 1.0, 1e3) * first * mass + _log(rng, 0.1, 10.0) / first * stiffness  # overdamped


def _harmonic(rng: Rng, size: float, frequency: float) -> Wave:
    return ("harmonic", size * _sign(rng) * rng.uniform(0.3, 1.0), frequency, float(rng.uniform(0.0, 6.3)))


def _stops(rng: Rng, reach: float) -> tuple[float, float]:
    lower, upper = -reach * rng.uniform(0.1, 1.0), reach * rng.uniform(0.1, 1.0)
    kind = rng.integers(3)
    return (-np.inf if kind == 1 else lower), (np.inf if kind == 2 else upper)


def _base(rng: Rng, n: int | None = None, damping: str | None = None, contacts: int = 1, periods: float = 6.0) -> Case:
    """A driven chain that meets its stops a few times in ``periods`` of its first mode."""
    n = int(rng.integers(1, 5)) if n is None else n
    mass, stiffness = _chain(rng, n, bool(rng.integers(2)))
    C = _damping(rng, mass, stiffness, damping or str(rng.choice(["none", "none", "proportional", "dashpot"])))
    first = float(_omegas(mass, stiffness)[0])
    period = 2.0 * np.pi / first
    row = np.eye(n)[-1] if rng.random() < 0.7 else rng.normal(size=n)
    load = rng.normal(size=n)
    loads = [(load, _harmonic(rng, first**2, first * _log(rng, 0.2, 4.0)))]
    if rng.random() < 0.4:
        loads.append((rng.normal(size=n), ("constant", float(rng.normal()) * first**2)))
    if rng.random() < 0.2:
        loads.append((rng.normal(size=n), _harmonic(rng, first**2, first * _log(rng, 0.2, 8.0))))
    kappa = _log(rng, 1.0, 3e4) * first**2
    made = [Contact(row, *_stops(rng, 0.7), kappa)]
    for _ in range(contacts - 1):
        other = rng.choice([0, 1, 2])
        new = row if other == 0 else (np.eye(n)[rng.integers(n)] if other == 1 else rng.normal(size=n))
        made.append(Contact(np.array(new, float), *_stops(rng, 0.7), kappa * _log(rng, 0.1, 10.0)))
    v0 = rng.normal(size=n) * first * (rng.random() < 0.7)
    q0 = 0.05 * rng.normal(size=n) * (rng.random() < 0.4)
    return Case(
        mass, C, stiffness, q0, v0, tuple(loads), tuple(made), row, float(period * periods * rng.uniform(0.3, 1.0))
    )


def _damped(rng: Rng) -> Case:
    return _base(rng, damping=str(rng.choice(["proportional", "dashpot", "overdamped"])))


def _several(rng: Rng) -> Case:
    return _base(rng, contacts=int(rng.integers(2, 4)), periods=4.0)


def _moving(rng: Rng) -> Case:
    made = _base(rng, contacts=int(rng.integers(1, 3)), periods=4.0)
    first = float(made.frequencies[0])
    move = lambda c: replace(c, offset=_harmonic(rng, 0.3, first * _log(rng, 0.2, 5.0)))  # noqa: E731
    return replace(made, contacts=tuple(move(c) for c in made.contacts))


def _pulse(rng: Rng) -> Case:
    """At rest, or nearly, until a record's pulse comes and goes: 1e-1 to 1e-5 of the time long."""
    made = _base(rng, contacts=int(rng.integers(1, 3)), periods=3.0)
    n, first = made.size, float(made.frequencies[0])
    pulses = []
    for _ in range(int(rng.integers(1, 3))):
        width = made.t_end * _log(rng, 1e-5, 1e-1)
        begin = float(rng.uniform(0.01, 0.9)) * made.t_end
        strength = rng.uniform(0.5, 2.0) * first / width  # a momentum that takes a mass to its stops
        times = np.array([0.0, begin, begin + 0.5 * width, begin + width, 1.5 * made.t_end])
        pulses.append((rng.normal(size=n), ("sampled", times, strength * _sign(rng) * np.eye(5)[2])))
    loads = pulses if rng.random() < 0.6 else [*made.loads, *pulses]
    still = rng.random() < 0.7
    zero = np.zeros(n)
    return replace(made, loads=tuple(loads), q0=zero if still else made.q0, v0=zero if still else made.v0)


def _edge(rng: Rng) -> Case:
    """Stops at zero, equal to the offset, touched at the start, loaded at rest, almost equal rows and gaps."""
    made = _base(rng, n=int(rng.integers(1, 4)), contacts=int(rng.integers(1, 3)), periods=3.0)
    n, first = made.size, float(made.frequencies[0])
    kind = int(rng.integers(7))
    zero = np.zeros(n)
    at_zero = tuple(replace(c, lower=-np.inf, upper=0.0) for c in made.contacts)
    row, kappa = made.contacts[0].row, made.contacts[0].kappa
    push = (row, ("constant", float(rng.choice([-1.0, 1.0])) * first**2 * rng.uniform(0.2, 2.0)))
    if kind == 0:  # at rest on the stop, pressed or pulled
        return replace(made, contacts=at_zero, loads=(push,), q0=zero, v0=zero)
    if kind == 1:  # on the stop, moving in or out, pressed or pulled back
        return replace(made, contacts=at_zero, loads=(push,), q0=zero)
    if kind == 2:  # a lower stop equal to the offset
        shift = float(rng.uniform(0.1, 0.5))
        contacts = tuple(replace(c, lower=shift, upper=shift + 1.0, offset=("constant", shift)) for c in made.contacts)
        return replace(made, contacts=contacts, loads=(push,), q0=zero, v0=zero if rng.random() < 0.5 else made.v0)
    if kind == 3:  # two contacts on one row with one stop
        c = replace(made.contacts[0], lower=-np.inf, upper=0.1)
        return replace(made, contacts=(c, replace(c, kappa=kappa * rng.uniform(0.1, 10.0))))
    if kind == 4:  # two contacts that close at once, or almost
        gap = float(rng.choice([0.0, 1e-12, 1e-9]))
        c = replace(made.contacts[0], lower=-np.inf, upper=0.1)
        return replace(made, contacts=(c, replace(c, row=2.0 * row, upper=0.2 + gap)))
    if kind == 5:  # in both stops' reach: a slit as narrow as 1e-12
        width = _log(rng, 1e-12, 1e-2)
        return replace(made, contacts=(replace(made.contacts[0], lower=-width, upper=width),), q0=zero)
    deep = replace(made.contacts[0], lower=-np.inf, upper=-0.2)  # in the stop at the start
    return replace(made, contacts=(deep,), q0=zero)


def _resonant(rng: Rng) -> Case:
    """A drive at a natural frequency, but for a detuning of 1e-1 to nothing."""
    made = _base(rng, damping=str(rng.choice(["none", "none", "proportional"])))
    frequency = float(rng.choice(made.frequencies))
    detuning = float(rng.choice([0.0, _log(rng, 1e-16, 1e-1)])) * _sign(rng)
    load = (rng.normal(size=made.size), _harmonic(rng, 0.3 * frequency**2, frequency * (1.0 + detuning)))
    contacts = made.contacts if rng.random() < 0.7 else ()
    return replace(made, loads=(load,), contacts=contacts)


def _tiny(rng: Rng) -> Case:
    """A time so short that almost nothing happens."""
    made = _base(rng, contacts=int(rng.integers(1, 3)))
    return replace(
        made, t_end=made.t_end * _log(rng, 1e-12, 1e-2), contacts=made.contacts if rng.random() < 0.6 else ()
    )


def _long(rng: Rng) -> Case:
    made = _base(rng, n=int(rng.integers(1, 3)), periods=100.0)
    return made if rng.random() < 0.5 else replace(made, contacts=(), t_end=made.t_end * _log(rng, 1.0, 100.0))


def _units(rng: Rng) -> Case:
    """Another family's system in units of length, time and force of 1e-6 to 1e6."""
    length, time, force = (10.0 ** rng.uniform(-6.0, 6.0, 3)).tolist()
    made = list(FAMILIES.values())[int(rng.integers(6))](rng)

    def wave(w: Wave | None, factor: float) -> Wave | None:
        if w is None or w[0] == "constant":
            return w and ("constant", w[1] * factor)
        if w[0] == "harmonic":
            return ("harmonic", w[1] * factor, w[2] / time, w[3])
        return ("sampled", w[1] * time, w[2] * factor)

    k = force / length
    contacts = tuple(
        replace(c, lower=c.lower * length, upper=c.upper * length, kappa=c.kappa * k, offset=wave(c.offset, length))
        for c in made.contacts
    )
    return Case(
        made.mass * k * time**2, made.damping * k * time, made.stiffness * k, made.q0 * length,
        made.v0 * length / time, tuple((p, wave(w, force)) for p, w in made.loads), contacts, made.observe,
        made.t_end * time,
    )  # fmt: skip


def _ratios(rng: Rng) -> Case:
    """Masses, springs and dashpots many powers of ten apart, with or without contact."""
    n = int(rng.integers(1, 3))
    mass = np.diag(10.0 ** rng.uniform(-3.0, 3.0, n))
    stiffness = np.diag(10.0 ** rng.uniform(-5.0, 6.0, n))
    if n == 2:
        stiffness += 10.0 ** rng.uniform(-3.0, 6.0) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    damping = np.diag(10.0 ** rng.uniform(-6.0, 7.0, n)) if rng.random() < 0.5 else np.zeros((n, n))
    omega = _omegas(mass, stiffness)
    scale = _log(rng, float(np.min(omega)), float(np.max(omega)) * 1.001)
    t_end = (
        rng.uniform(0.5, 20.0) / scale
        if np.max(omega) / np.min(omega) < 1e3
        else rng.uniform(0.5, 20.0) / np.max(omega)
    )
    loads = [(rng.normal(size=n), ("constant", 1.0)), (rng.normal(size=n), _harmonic(rng, 1.0, scale))]
    row = np.eye(n)[-1]
    size = 1.0 / float(np.max(np.diag(stiffness)))
    contacts = () if rng.random() < 0.5 else (Contact(row, -0.3 * size, 0.2 * size, _log(rng, 1e-2, 1e3) / size),)
    keep = loads if rng.random() < 0.5 else loads[int(rng.integers(2)) :][:1]
    return Case(mass, damping, stiffness, np.zeros(n), np.zeros(n), tuple(keep), contacts, row, float(t_end))


def _rigid(rng: Rng) -> Case:
    """A motion without stiffness: K is singular."""
    made = _base(rng, n=int(rng.integers(1, 4)), contacts=int(rng.integers(1, 3)), periods=3.0)
    n = made.size
    k = float(np.max(np.diag(made.stiffness)))
    stiffness = k * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    stiffness[0, 0] = stiffness[-1, -1] = k if n > 1 else 0.0
    damping = made.damping if rng.random() < 0.5 else 0.0 * made.damping
    return replace(made, stiffness=stiffness, damping=damping)


FAMILIES: dict[str, Callable[[Rng], Case]] = {
    "plain": _base,
    "damped": _damped,
    "several contacts": _several,
    "moving stop": _moving,
    "pulse": _pulse,
    "edge": _edge,
    "near resonance": _resonant,
    "tiny time": _tiny,
    "long time": _long,
    "units": _units,
    "ratios": _ratios,
    "rigid motion": _rigid,
}


def _held(rng: Rng, made: Case) -> np.ndarray:
    """K with each contact on a stop or not, as chance has it."""
    return made.stiffness + sum(c.kappa * np.outer(c.row, c.row) for c in made.contacts if rng.random() < 0.5)


def _detuned(rng: Rng) -> float:
    return 1.0 + float(rng.choice([0.0, 0.0, _log(rng, 1e-16, 1e-3)])) * _sign(rng)


def _critical(rng: Rng) -> Case:
    """Critical damping of one mode or of all, of the free system or of one regime, exactly or nearly."""
    made = _base(rng, contacts=int(rng.integers(1, 3)), damping="none", periods=4.0)
    squares, shapes = scipy.linalg.eigh(_held(rng, made), made.mass)
    ratios = np.where(rng.random(made.size) < 0.6, _detuned(rng), rng.uniform(0.01, 2.0, made.size))
    turned = made.mass @ shapes
    return replace(made, damping=turned @ np.diag(2.0 * ratios * np.sqrt(squares)) @ turned.T)


def _free(rng: Rng) -> Case:
    """A free chain with dampers between its masses, on the ground or none; several contacts, or none."""
    made = _base(rng, n=int(rng.integers(1, 5)), contacts=int(rng.integers(1, 4)), damping="none", periods=3.0)
    n, first = made.size, float(made.frequencies[0])
    stretch = np.eye(n)[1:] - np.eye(n)[:-1]
    stiffness = stretch.T @ np.diag(10.0 ** rng.uniform(0.5, 3.0, n - 1)) @ stretch
    inner = stretch.T @ np.diag(first * 10.0 ** rng.uniform(-3.0, 0.5, n - 1)) @ stretch
    ground = first * _log(rng, 1e-12, 3.0) * np.outer(np.eye(n)[0], np.eye(n)[0])
    kind = int(rng.integers(5))
    damping = [inner, ground, inner + ground, first * _log(rng, 1e-3, 1.0) * made.mass, 0.0 * ground][kind]
    contacts = made.contacts if rng.random() < 0.8 else ()
    return replace(made, stiffness=stiffness, damping=damping, contacts=contacts)


def _resonant_regime(rng: Rng) -> Case:
    """A drive at a frequency of the free system or of a contact regime, with several contacts or a little damping."""
    made = _base(rng, contacts=int(rng.integers(1, 4)), damping="none", periods=5.0)
    frequency = float(rng.choice(_omegas(made.mass, _held(rng, made)))) * _detuned(rng)
    damping = made.damping if rng.random() < 0.6 else _log(rng, 1e-12, 1e-2) * frequency * made.mass
    size = 0.3 * float(made.frequencies[0]) * frequency
    loads = [(rng.normal(size=made.size), _harmonic(rng, size, frequency)) for _ in range(int(rng.integers(1, 3)))]
    return replace(made, damping=damping, loads=tuple(loads))


def _tangled(rng: Rng) -> Case:
    """Equal modes damped alike, and a matrix whose contact state has one eigenvector to four eigenvalues."""
    made = _base(rng, n=2, contacts=int(rng.integers(1, 3)), damping="none", periods=4.0)
    w = float(made.frequencies[0])
    if rng.random() < 0.5:
        mass = np.eye(2)
        return replace(made, mass=mass, stiffness=w**2 * mass, damping=2.0 * w * _detuned(rng) * mass)
    # det(x^2 + C x + K) = (x + 1)^4
    damping = w * np.array([[3.2, 0.9], [0.9, 0.8]])
    return replace(made, mass=np.eye(2), stiffness=w**2 * np.diag([4.0, 0.25]), damping=damping)


MEETING: dict[str, Callable[[Rng], Case]] = {
    "critical damping": _critical,
    "free body": _free,
    "resonance of a regime": _resonant_regime,
    "tangled modes": _tangled,
}
MEETING_FROM = 1_000_000
