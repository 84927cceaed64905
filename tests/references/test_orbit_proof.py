"""Proofs of periodic orbits: against motions in mpmath, closed forms, and orbits that do not exist."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import flint
import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb

mp = pytest.importorskip("mpmath")
from precise_motion import PreciseMotion  # noqa: E402

from stiffbeam.references.ball_flow import BallSystem, SignProver, frame_of  # noqa: E402

DIGITS = 50


def driven(
    frequency: float = 2.2, c: float = 0.4, k: float = 4.0, amplitude: float = 2.0, phase: float = 0.3, **stops: Any
) -> sb.System:
    law, load = sb.Stops(**stops) if stops else None, sb.Harmonic(amplitude, frequency, phase=phase)
    return one_mass(k, law, damping=c, load=load, observe=[1.0])


def random_system(seed: int) -> tuple[sb.System, float]:
    """One to three masses, one or two contacts: springs, Kelvin-Voigt or rigid; and a period."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    A, B = rng.normal(size=(2, n, n))
    stiffness, damping = A @ A.T + np.eye(n), 0.04 * B @ B.T + np.eye(n) * rng.uniform(0.05, 0.4)
    law = [
        {"stiffness": 10.0 ** rng.uniform(0, 3)},
        {"stiffness": 10.0 ** rng.uniform(0, 3), "damping": rng.uniform(0.1, 5.0)},
        {"stiffness": np.inf, "restitution": rng.uniform(0.3, 0.9)},
    ][seed % 3]
    contacts = []
    for _ in range(min(int(rng.integers(1, 3)), n)):
        bounds = {"lower": -rng.uniform(0.05, 0.4), "upper": rng.uniform(0.05, 0.4)}
        bounds = {side: bounds[side] for side in [["lower"], ["upper"], ["lower", "upper"]][rng.integers(3)]}
        contacts.append(sb.Contact(rng.normal(size=n), sb.Stops(**bounds, **law)))
    w = float(np.round(rng.uniform(0.6, 3.0), 3))
    loads = [(rng.normal(size=n), sb.Harmonic(rng.uniform(0.5, 2.5), w, phase=rng.uniform(0, 6)))]
    if rng.random() < 0.3:
        loads.append((rng.normal(size=n), sb.Harmonic(rng.uniform(0.1, 0.5), 2.0 * w)))
    mass = np.diag(rng.uniform(0.5, 2.0, n))
    system = sb.System.from_matrices(
        mass, (stiffness + stiffness.T) / 2.0, (damping + damping.T) / 2.0, loads=loads, contacts=contacts
    )
    return system, 2.0 * np.pi / w


def centre(ball: Any) -> Any:
    return mp.mpf(ball.mid().str(DIGITS + 10, radius=False))


def radius(ball: Any) -> Any:
    return mp.mpf(float(ball.rad()))


def assert_moves_back(system: sb.System, proof: sb.OrbitProof, steps: int) -> None:
    """From the centre of the start the law itself leads through the events of the proof, and back to the start."""
    with mp.workdps(DIGITS):
        motion = PreciseMotion(system, mp.mpf(float(proof.period)) / steps)
        q, v = [mp.matrix([centre(x) for x in values]) for values in (proof.q, proof.v)]
        events, q_end, v_end = motion.over(centre(proof.period), q, v)
        assert [(c, side) for _, c, side in events] == [(c, new) for c, _, new in proof.itinerary]
        near = mp.mpf(10) ** -30
        for (t, *_), ball in zip(events, proof.event_times, strict=True):
            assert abs(t - centre(ball)) <= radius(ball) + near
        assert mp.norm(q_end - q, mp.inf) < near
        assert mp.norm(v_end - v, mp.inf) < near


@pytest.mark.fast(1)
@pytest.mark.parametrize("damping", [3.0, 0.0])
def test_a_mass_on_a_stop_returns_in_50_digits_with_the_multipliers_of_the_proof(damping):
    """Multipliers by differences of 1e-20 of the motion in mpmath."""
    system = driven(upper=0.2, stiffness=300.0, damping=damping)
    proof = sb.periodic_orbit(system, 2.0 * np.pi / 2.2).prove()
    assert proof.proved
    assert proof.stable
    assert len(proof.event_times) == (3 if damping else 2)
    assert proof.radius < 1e-30
    assert_moves_back(system, proof, 20)
    with mp.workdps(DIGITS):
        motion = PreciseMotion(system, mp.mpf(float(proof.period)) / 20)
        start, width = [centre(proof.q[0]), centre(proof.v[0])], mp.mpf(10) ** -20
        D = mp.matrix(2, 2)
        for j in range(2):
            z = [x + width * (i == j) for i, x in enumerate(start)]
            _, q, v = motion.over(centre(proof.period), [z[0]], [z[1]])
            for i, end in enumerate((q[0], v[0])):
                D[i, j] = (end - start[i]) / width
        trace, determinant = D[0, 0] + D[1, 1], D[0, 0] * D[1, 1] - D[0, 1] * D[1, 0]
    with mp.workdps(DIGITS), flint.ctx.workprec(200):
        total, product = sum(proof.multipliers), proof.multipliers[0] * proof.multipliers[1]
        assert abs(centre(total.real) - trace) < mp.mpf(10) ** -18
        assert abs(centre(product.real) - determinant) < mp.mpf(10) ** -18


def test_states_over_the_period_are_those_of_the_float64_flow():
    system = driven(upper=0.2, stiffness=300.0, damping=3.0)
    orbit = sb.periodic_orbit(system, 2.0 * np.pi / 2.2)
    q, v = orbit.prove().states(40)
    run = orbit.reference(t_eval=np.arange(40) * orbit.period / 40)
    for balls, values in zip((q, v), run.states, strict=True):
        assert np.allclose([[float(x) for x in line] for line in balls], values, rtol=0.0, atol=1e-12)
        assert max(float(x.rad()) for line in balls for x in line) < 1e-30
    failed = replace(orbit, q=orbit.q + 0.1).prove()
    with pytest.raises(sb.InputError, match="proof must be a proof that holds"):
        failed.states(4)


def test_the_impact_oscillator():
    """Trace of the closed form, determinant e^2, and the motion in mpmath: rigid, unstable."""
    stops = {"upper": 0.0, "stiffness": np.inf, "restitution": 0.8}
    system = driven(2.8, 0.0, 1.0, 1.0, 7.8, **stops)
    orbit = sb.periodic_orbit(system, 2.0 * np.pi / 2.8, ([-0.48], [-0.03]))
    proof = orbit.prove()
    assert proof.proved
    assert proof.stable is False
    assert abs(float(sum(proof.multipliers).real) + 3.17445052) < 1e-8
    assert abs(float((proof.multipliers[0] * proof.multipliers[1]).real) - 0.8**2) < 1e-15
    assert_moves_back(system, proof, 20)


@pytest.mark.fast(1, slow=4)
@pytest.mark.parametrize("seed", range(200))
def test_random_orbits_that_are_proved_are_motions_of_the_law(seed):
    system, period = random_system(seed)
    try:
        orbit = sb.periodic_orbit(system, period)
    except sb.SolverFailure:
        return
    proof = orbit.prove()
    if proof.proved:
        assert proof.distance < 1e-9
        assert_moves_back(system, proof, 40)
        assert proof.stable == orbit.stable or abs(abs(orbit.multipliers[0]) - 1.0) < 1e-8
    # where all contacts are apart from a graze, nothing else may keep it from being proved
    assert proof.proved or "graze" in proof.reason or "sides" in proof.reason or "hits" in proof.reason


def free_response(frequency: float) -> Any:
    """Amplitude of the response of ``driven`` without contact, exactly of its doubles."""
    c, k, w = mp.mpf(0.4), mp.mpf(4), mp.mpf(frequency)
    return mp.mpf(2) / mp.sqrt((k - w**2) ** 2 + (c * w) ** 2)


@pytest.mark.parametrize("units", [-1e6, -2, -1, 1, 2, 1e6])
@pytest.mark.parametrize("law", [{"stiffness": 300.0}, {"stiffness": 300.0, "damping": 3.0}])
def test_a_gap_that_is_a_rounding_below_the_amplitude_disproves_the_free_orbit(units, law):
    """The orbit without contact exists where the gap is larger than the amplitude, to the last unit."""
    with mp.workdps(DIGITS):
        amplitude = free_response(2.2)
        gap = float(amplitude)
        gap = gap + units * np.spacing(gap)
        exists = mp.mpf(gap) > amplitude
    far = sb.periodic_orbit(driven(upper=10.0, **law), 2.0 * np.pi / 2.2)
    assert len(far.events) == 0
    proof = replace(far, system=driven(upper=gap, **law)).prove()
    assert proof.proved == exists
    assert exists or "another side" in proof.reason


def hidden(orbit: sb.Orbit, times: list[float], sides: list[list[int]]) -> sb.Orbit:
    """An orbit with other events, states left as they are."""
    rows = np.zeros((len(times), orbit.system.size))
    path = replace(orbit.path, times=np.array(times), sides=np.array(sides), q=rows, v=rows)
    return replace(orbit, path=path)


def test_orbits_that_do_not_exist_are_not_proved():
    system = driven(upper=0.2, stiffness=300.0)
    orbit = sb.periodic_orbit(system, 2.0 * np.pi / 2.2)
    truth = orbit.prove()
    t, T = orbit.path.times.tolist(), orbit.period
    wrong = [
        hidden(orbit, [0.0], [[0]]),  # no contact at all
        hidden(orbit, [0.0], [[1]]),  # always in contact
        hidden(orbit, [0.0, t[1], t[2], 0.9 * T, 0.91 * T], [[0], [1], [0], [1], [0]]),  # one more
        hidden(orbit, [0.0, t[1], 0.5 * (t[1] + t[2]), 0.6 * (t[1] + t[2]), t[2]], [[0], [1], [0], [1], [0]]),
        hidden(orbit, [0.0, t[2], t[1]], [[0], [1], [0]]),  # out of order
        hidden(orbit, [0.0, t[1], t[2]], [[1], [0], [1]]),  # inside out
        hidden(orbit, [0.0, t[1]], [[0], [1]]),  # never left
        replace(orbit, q=orbit.q + 1e-4),  # another start
        replace(orbit, system=driven(upper=0.25, stiffness=300.0)),  # another system
    ]
    for other in wrong:
        proof = other.prove()
        assert not proof.proved, proof
        assert proof.reason
        assert proof.remedy
        assert proof.event_times == ()
    # event times a little off lead to the orbit itself, or to none
    for off in (1e-9, 1e-6, 1e-3, 1e-2):
        proof = hidden(orbit, [0.0, t[1] - off, t[2] + off], [[0], [1], [0]]).prove()
        assert not proof.proved or all(a.overlaps(b) for a, b in zip(proof.event_times, truth.event_times, strict=True))


def test_a_contact_of_two_that_is_left_out_is_seen():
    """A second stop inside the motion that the itinerary does not know."""
    first = sb.Contact(np.array([1.0, 0.0]), sb.Stops(upper=0.2, stiffness=100.0))
    load = ([1.0, 0.0], sb.Harmonic(1.0, 1.1))

    def system(lower: float) -> sb.System:
        second = sb.Contact(np.array([0.0, 1.0]), sb.Stops(lower=lower, stiffness=1e-6))
        matrices = np.eye(2), [[2.0, -1.0], [-1.0, 2.0]], 0.2 * np.eye(2)
        return sb.System.from_matrices(*matrices, loads=[load], contacts=[first, second])

    orbit = sb.periodic_orbit(system(-9.0), 2.0 * np.pi / 1.1)
    assert len(orbit.events) >= 2
    assert orbit.prove().proved
    lowest = float(np.min(orbit.reference(t_eval=np.linspace(0.0, orbit.period, 20001)).states[0][:, 1]))
    assert replace(orbit, system=system(lowest * 1.0001)).prove().proved
    proof = replace(orbit, system=system(lowest * 0.9999)).prove()
    assert not proof.proved
    assert "contact 1" in proof.reason


def test_what_a_proof_refuses():
    with pytest.raises(sb.InputError, match="bits must be a whole number from 64"):
        sb.periodic_orbit(driven(), 2.0 * np.pi / 2.2).prove(bits=10)
    load = [([1.0], sb.Harmonic(1.0, w)) for w in (0.1, 0.3)]  # no doubles whose ratio is 3
    system = sb.System.from_matrices([[1.0]], [[4.0]], [[0.4]], loads=load, observe=[1.0])
    orbit = sb.periodic_orbit(system, 2.0 * np.pi / 0.1)
    with pytest.raises(sb.InputError, match="frequency must be an exact multiple of"):
        orbit.prove()
    load = [([1.0], sb.Harmonic(1.0, w)) for w in ("0.1", "0.3")]
    system = sb.System.from_matrices([[1.0]], [[4.0]], [[0.4]], loads=load, observe=[1.0])
    assert sb.periodic_orbit(system, 2.0 * np.pi / 0.1).prove().proved


def test_two_contacts_at_one_time_are_not_proved():
    contacts = [sb.Contact(np.array(row), sb.Stops(upper=0.2, stiffness=50.0)) for row in ([1.0, 0.0], [0.0, 1.0])]
    load = ([1.0, 1.0], sb.Harmonic(1.0, 1.1))
    system = sb.System.from_matrices(np.eye(2), np.eye(2), 0.2 * np.eye(2), loads=[load], contacts=contacts)
    proof = sb.periodic_orbit(system, 2.0 * np.pi / 1.1).prove()
    assert not proof.proved
    assert "not proved" in repr(proof)


@pytest.mark.slow
def test_an_unstable_orbit_of_the_beam_is_proved():
    """90 events; its multiplier as by a prototype, and the moduli of all by Liouville's formula, far below float64."""
    stops = sb.Stops(-0.1, 0.1, stiffness=5e6)
    problem = sb.BeamProblem(stiffness=300.0, viscosity=0.05, stops=stops, base=sb.Harmonic(0.2, 33.0))
    system = sb.semidiscretise(problem, 8)
    orbit = sb.periodic_orbit(system, 2.0 * np.pi / 33.0)
    assert not orbit.prove(bits=64).proved
    proof = orbit.prove()
    assert proof.proved
    assert proof.stable is False
    assert len(proof.event_times) == 90
    assert abs(float(proof.multipliers[0].real) + 1.15880709) < 1e-7
    assert np.allclose([float(t) for t in proof.event_times], orbit.events, rtol=0.0, atol=1e-12)
    assert proof.distance < 1e-11
    assert proof.radius < 1e-30


@pytest.mark.parametrize("seed", [0, 1, 3])
@pytest.mark.parametrize(("time", "length"), [(2.0**-30, 1.0), (2.0**20, 2.0**-30), (1.0, 2.0**40)])
def test_the_subintervals_of_signs_do_not_depend_on_the_units(seed, time, length):
    """In nanoseconds they were 1e6 times as many, and a proof did not end in minutes."""

    def harmonic(f: sb.Harmonic) -> sb.Harmonic:
        return sb.Harmonic(f.amplitude * length / time**2, f.frequency / time, phase=f.phase)

    system, _ = random_system(seed)
    contacts = []
    for contact in system.contacts:
        law = contact.stops
        sides = {name: getattr(law, name) * length for name in ("lower", "upper") if getattr(law, name) is not None}
        stops = sb.Stops(**sides, stiffness=law.stiffness / time**2, damping=law.damping / time)
        contacts.append(sb.Contact(contact.row, stops))
    loads: Any = [(row, harmonic(f)) for row, f in system.loads if isinstance(f, sb.Harmonic)]
    scaled = sb.System.from_matrices(
        system.mass, system.stiffness / time**2, system.damping / time, loads=loads, contacts=contacts
    )
    lengths = []
    for each, unit in ((system, 1.0), (scaled, time)):
        prover = SignProver(BallSystem(each, frame_of(each, 2.0 * np.pi * unit)))
        lengths.append(
            [float(prover.regime(sides)[0]) / unit for sides in ((0,) * len(contacts), (1,) * len(contacts))]
        )
    np.testing.assert_allclose(lengths[1], lengths[0], rtol=1e-15)
