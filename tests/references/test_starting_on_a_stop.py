"""One rule for all: contact at t = 0 is no impact, a start exactly on a stop that does not leave it included."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references import REFERENCES
from stiffbeam.schemes import RIGID, SCHEMES
from stiffbeam.schemes.labels import make


def mass(q: float, v: float, load: float = 0.0, **law: float) -> sb.System:
    """q'' + 100 q = load, a stop at 1 with 1e4 above: a contact lasts 0.031, a flight more than 0.53."""
    stops = sb.Stops(upper=1.0, **{"stiffness": 1e4} | law)
    return one_mass(100.0, stops, load=sb.Constant(load), q=q, v=v)


# How it starts, when it ends, impacts by hand: a flight from u = 1 with speed v takes (2 pi - 2 atan(v/10))/10.
STARTS = [
    ((1.0, 5.0), 0.55, 0),  # moves in: contact from t = 0, the next at 0.567
    ((1.0, 0.0, 200.0), 0.03, 0),  # is pressed in
    ((1.0, -5.0), 0.55, 1),  # leaves, and is back at 0.536
    ((0.9, 5.0), 0.55, 1),
    ((1.01, 0.0), 0.55, 0),
]


@pytest.mark.parametrize(("start", "end", "count"), STARTS)
@pytest.mark.parametrize("damping", [0.0, 5.0])
@pytest.mark.parametrize("method", [x for x in REFERENCES if x != "kvaerno3"])  # kvaerno5 by another table
@pytest.mark.fast(20, slow=20)
def test_references(start, end, count, damping, method):
    run = sb.reference(mass(*start, damping=damping), end, method)
    assert run.impacts.count == count
    if method == "exact":
        assert run.impacts_sampled(1e-3).count == count


@pytest.mark.parametrize(("start", "end", "count"), STARTS)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_every_scheme(start, end, count, scheme):
    for contact in ("implicit", "extrapolated", *(["conserving"] if scheme == "Trapezoidal" else [])):
        assert sb.integrate(mass(*start), make(scheme), 1e-3, end, contact).impacts.count == count


@pytest.mark.parametrize("restitution", [0.8, 1.0])
@pytest.mark.parametrize(("start", "after"), [((1.0, 5.0), True), ((1.0, -5.0), False)])
@pytest.mark.fast(1)
def test_rigid_stops(start, after, restitution):
    """The blow at t = 0 is none; the mass leaves with v and is back after (2 pi - 2 atan(v/10))/10."""
    system = mass(*start, stiffness=np.inf, restitution=restitution)
    v = 5.0 * restitution if after else 5.0
    back = (2.0 * np.pi - 2.0 * np.arctan(v / 10.0)) / 10.0
    found = sb.reference(system, 0.6)
    assert np.allclose(found.impacts.times, [back], rtol=0, atol=1e-12)
    taken = (1.0 + restitution) * v + (5.0 * (1.0 + restitution) if after else 0.0)
    assert found.contacts[0].impulse == pytest.approx(taken)  # the blow at t = 0 is among the impulses
    for scheme in RIGID:
        if scheme != "ContactStabilisedNewmark":  # which takes no restitution
            assert np.allclose(sb.integrate(system, make(scheme), 1e-3, 0.6).impacts.times, [back], rtol=0, atol=5e-3)


@pytest.mark.parametrize("method", [x for x in REFERENCES if x not in ("radau", "kvaerno3", "kvaerno5")])
@pytest.mark.parametrize("force", [0.0, 10.0])
def test_a_mass_in_equilibrium_on_its_stop_stays_there(method, force):
    """Its gap, if no load presses it, and its rate are roots all the time."""
    level = -force / 1e4
    system = one_mass(100.0, sb.Stops(lower=0.0, stiffness=9900.0), load=sb.Constant(-force), q=level)
    run = sb.reference(system, 1.0, method)
    assert run.impacts.count == 0
    assert np.max(np.abs(run.tip - level)) < 1e-12
    assert run.contacts[0].impulse == pytest.approx(0.99 * force, rel=1e-9)
    assert run.contacts[0].fraction == 1.0 or not force


@pytest.mark.fast(1)
@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_a_start_on_a_stop_is_one_however_its_modes_are_rounded(damping):
    """The position is a sum over modes: its distance from the stop is not zero, but 1e-16 to either side."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, row, q, v = rng.normal(size=(4, 4)), np.eye(4)[rng.integers(4)], rng.normal(size=4), rng.normal(size=4)
        system = sb.System.from_matrices(
            np.eye(4), x @ x.T + np.eye(4), damping=damping * np.eye(4),
            contacts=[sb.Contact(row, sb.Stops(upper=float(row @ q), stiffness=1e4))],
            initial_displacement=q, initial_velocity=v * np.sign(row @ v),
        )  # fmt: skip
        contact = sb.reference(system, 1e-3).contacts[0]
        assert contact.impacts.count == 0
        assert contact.fraction == 1.0


def chain(n: int, load: sb.Harmonic | sb.Constant) -> sb.System:
    """n equal masses at rest, the first on its stop, the last under the load."""
    first, last = np.eye(n)[0], np.eye(n)[-1]
    stops = sb.Stops(upper=0.0, stiffness=100.0)
    springs = 10.0 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    return sb.System.from_matrices(np.eye(n), springs, loads=[(last, load)], contacts=[sb.Contact(first, stops)])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("load", [sb.Constant, lambda size: sb.Harmonic(size, 2.0)], ids=["constant", "sine"])
@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("method", [method for method in REFERENCES if method not in ("exact", "rigid")])
@pytest.mark.fast(9, slow=12)
def test_a_body_that_a_later_push_moves_has_its_contact_from_the_start(method, n, load, sign):
    """Acceleration and jerk of the body may vanish: the gap goes like t^2 to t^7."""
    system = chain(n, load(sign))
    exact, run = sb.reference(system, 0.5), sb.reference(system, 0.5, method)  # before any comes back
    assert run.impacts.count == exact.impacts.count
    assert (run.impacts.at_start is not None) == (exact.impacts.at_start is not None) == (sign > 0.0)


@pytest.mark.parametrize("method", ["dop853", "radau", "kvaerno5"])
@pytest.mark.fast(1)
def test_an_event_that_rounding_blurs_moves_no_clock(method):
    """The gap goes like t^8, so that no step places its first root; the state was once that of another time."""
    t = np.linspace(0.0, 3.0, 31)
    exact, run = (sb.reference(chain(4, sb.Constant(1.0)), 3.0, x, t).tip for x in ("exact", method))
    np.testing.assert_allclose(run, exact, rtol=0.0, atol=1e-7 * np.max(np.abs(exact)))


@pytest.mark.parametrize("pull", [0.0, -1.0])
@pytest.mark.parametrize(
    "law", [{"stiffness": np.inf, "restitution": 0.5}, {"stiffness": 1e3}], ids=["rigid", "spring"]
)
def test_what_rests_on_a_stop_touches_it_where_a_force_presses(law, pull):
    system = one_mass(4.0, sb.Stops(lower=0.0, **law), load=sb.Constant(pull) if pull else None)
    scheme = sb.MoreauJean() if system.rigid else sb.BDF2()
    for run in (sb.reference(system, 1.0), sb.integrate(system, scheme, 1e-3, 1.0)):
        assert run.contacts[0].fraction == pytest.approx(-pull)
        assert run.impacts.count == 0
        assert (run.impacts.at_start is not None) == bool(pull)


@pytest.mark.parametrize("rigid", [False, True])
def test_outputs_begin_with_the_start_as_given(rigid, tmp_path):
    """A position of 3e-16 at t = 0, not 0, was an impact to ``compare`` where a file holds the reference."""
    rng, law = np.random.default_rng(0), {"stiffness": np.inf, "restitution": 0.5} if rigid else {"stiffness": 0.5}
    for _ in range(2):
        x, pull = rng.normal(size=(3, 3)), rng.normal(size=3)
        contact = sb.Contact(np.eye(3)[0], sb.Stops(lower=0.0, **law))
        loads = [(pull, sb.Harmonic(1.0, 0.7, 0.4)), (rng.normal(size=3), sb.Constant(-1.0))]
        system = sb.System.from_matrices(np.eye(3), x @ x.T + np.eye(3), loads=loads, contacts=[contact])
        reference = sb.reference(system, 2.0)
        assert reference.contacts[0].position[0] == 0.0
        assert reference.tip[0] == 0.0
        if rigid:
            continue
        assert reference.contact_force[0] == 0.0
        many = sb.reference_ensemble(system, 2.0, sb.perturbed_members(system, 3, 1e-2), reference.t)
        for i, member in enumerate(many.members):
            assert many.tip[i, 0] == member.q0[0]
            assert np.array_equal(many.tip[i], sb.reference(member, 2.0).tip)
        run, stored = sb.integrate(system, sb.BDF2(), 1e-3, 2.0), sb.load(reference.save(tmp_path / "reference.nc"))
        assert sb.compare(run, stored).matched_until == sb.compare(run, reference).matched_until


def resting_chain(seed: int) -> sb.System:
    """Equal springs between fixed ends, at rest, some on their stops, under forces that begin at zero or late."""
    rng = np.random.default_rng([77, seed])
    n = int(rng.integers(1, 6))
    springs = rng.choice([1.0, 10.0, 100.0]) * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    mass = np.diag(rng.uniform(0.5, 2.0, n))
    damping = rng.choice([0.0, 0.01, 0.3]) * mass
    law: dict[str, Any] = [
        {"stiffness": 1e3}, {"stiffness": 1e3, "damping": 5.0},
        {"stiffness": np.inf, "restitution": float(rng.choice([0.0, 0.5, 0.9, 1.0]))},
    ][int(rng.integers(3))]  # fmt: skip
    masses = rng.permutation(n)[: int(rng.integers(1, n + 1))]
    late = np.concatenate([np.zeros(3), rng.normal(size=28)])
    forces = [
        sb.Harmonic(rng.uniform(1.0, 5.0), rng.uniform(0.5, 6.0)),
        sb.Constant(rng.choice([-1.0, 1.0])),
        sb.Sampled(np.linspace(0.0, 6.0, 31), late),
    ]
    loads = [(np.eye(n)[rng.integers(n)], forces[k]) for k in rng.permutation(3)[: rng.integers(1, 3)]]
    contacts = [sb.Contact(np.eye(n)[i], sb.Stops(lower=0.0, **law)) for i in masses]
    return sb.System.from_matrices(mass, springs, damping, loads, contacts)


@pytest.mark.parametrize("seed", range(120))
@pytest.mark.fast(12, slow=36)
def test_chains_at_rest_on_their_stops_have_an_exact_motion(seed):
    """Bodies without a force stay, those whose force begins later leave at once or never, whatever rounding says. In
    many digits it is the same motion or a refusal at once: events of rounding came back for ever."""
    system = resting_chain(seed)
    run = sb.reference(system, 3.0)
    assert run.horizon > 0.3
    if system.rigid:
        assert min(float(np.min(c.position)) for c in run.contacts) > -1e-12
        return
    others = [sb.reference(system, 3.0, "cvode", rtol=1e-9)]
    if not any(isinstance(f, sb.Sampled) for f in system.time_functions):
        try:
            others.append(sb.reference(system, 3.0, "multiprecision", seconds=30.0))
        except sb.SolverFailure as failure:
            assert "float64 cannot place" in str(failure)  # noqa: PT017
        else:
            assert others[1].horizon == 3.0
    for other in others:
        near = run.t <= min(run.horizon, other.horizon)
        assert np.max(np.abs(run.tip - other.tip)[near]) <= 1e-3 * np.max(np.abs(run.tip))


@pytest.mark.parametrize("stiffness", [1e4, 1e7])
@pytest.mark.parametrize("method", ["exact", "multiprecision", "cvode", "ida", "dop853"])
def test_a_load_that_grows_from_zero_holds_a_body_on_its_stop(method, stiffness):
    """From t = 0 on, without an impact, until sin 3t pushes less than the spring of 1 at a stiff stop."""
    system = one_mass(1.0, sb.Stops(upper=0.0, stiffness=stiffness), load=sb.Harmonic(1.0, 3.0))
    impacts = sb.reference(system, 1.5, method).impacts
    assert impacts.count == 0
    assert impacts.at_start.ends == pytest.approx([np.pi / 3.0], rel=1e-2)


@pytest.mark.parametrize("scheme", [sb.MoreauJean(), sb.PaoliSchatzman(), sb.NonsmoothGeneralisedAlpha()], ids=str)
def test_a_start_beyond_a_rigid_stop_by_rounding_is_on_it_for_all(scheme):
    stops = sb.Stops(upper=0.1, stiffness=np.inf, restitution=0.5)
    contact = sb.Contact([1.0], stops)
    start = {"initial_displacement": [0.1 * (1.0 + 5e-13)], "initial_velocity": [-1.0]}
    system = sb.System.from_matrices([[1.0]], [[1.0]], contacts=[contact], **start)
    run, reference = sb.integrate(system, scheme, 1e-3, 4.0), sb.reference(system, 4.0)
    assert run.impacts.count == reference.impacts.count == 1
    np.testing.assert_allclose(run.tip, reference.at(run.t)[0], atol=2e-3)
