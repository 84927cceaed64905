"""Power, Hertz, Kelvin-Voigt and Hunt-Crossley stops: against known answers, an independent solver and theory."""

from __future__ import annotations

import itertools
import math
from functools import partial

import numpy as np
import pytest
from law_systems import Witness, random_system

import stiffbeam as sb
from stiffbeam.kernels.library import contact_forces
from stiffbeam.model import contact
from stiffbeam.model.right_hand_side import THROUGH, contact_force
from stiffbeam.references.adaptive.diffrax import float64_on_the_processor


def ball(stops: sb.Stops, speed: float = 1.0, mass: float = 1.0) -> sb.System:
    """A free mass that moves towards a stop at 0 from 0.1 before it."""
    side = 1.0 if stops.upper is not None else -1.0
    contacts = [sb.Contact([1.0], stops)]
    start = {"initial_displacement": [-0.1 * side], "initial_velocity": [speed * side]}
    return sb.System.from_matrices([[mass]], [[0.0]], contacts=contacts, **start)


@pytest.mark.parametrize("seed", range(412))
@pytest.mark.fast(0, slow=8)
def test_random_systems_against_another_solver(seed):
    system = random_system(seed)
    times = np.linspace(0.0, 3.0, 61)
    want, _ = Witness(system).solve(times)
    scale = np.max(np.abs(want))
    method = ("dop853", "cvode-adams", "radau")[seed % 3]
    run = sb.reference(system, 3.0, method=method, t_eval=times, rtol=1e-11)
    assert np.max(np.abs(run.contacts[0].position - want)) < 2e-7 * scale
    assert np.max(np.abs(run.energy.loss)) < 1e-6 * np.max(run.energy.energy)
    assert np.all(np.diff(run.energy.stop_dissipation) > -1e-7 * np.max(run.energy.energy))
    # A scheme converges to it: the error falls with the step.
    scheme = (sb.Trapezoidal(), sb.HHT(-0.1), sb.BDF2(), sb.SDIRK())[seed % 4]
    errors = []
    for dt in (1e-3, 1.25e-4):
        tip = sb.integrate(system, scheme, dt, 3.0, every=round(0.05 / dt)).contacts[0].position
        errors.append(np.max(np.abs(tip - want)) / scale)
    # An entry with a jump of the force leaves order 1, and where in its step it falls is chance: no single slope.
    assert errors[1] < max(0.6 * errors[0], 2e-4)
    assert errors[1] < 5e-3


@pytest.mark.parametrize("sides", [{"lower": -0.2}, {"upper": 0.1}, {"lower": -0.2, "upper": 0.1}])
@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.5, 3.0, 1.7])
@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("dissipation", [0.0, 0.4])
@pytest.mark.fast(12)
def test_c_numpy_and_jax_have_one_law(sides, exponent, damping, dissipation):
    import jax
    from jax import numpy as jnp

    stops = sb.Stops(**sides, stiffness=3.0, exponent=exponent, damping=damping, dissipation=dissipation)
    u, v = np.random.default_rng(4).normal(size=(2, 200))
    energies, close = np.empty(len(u)), {"rtol": 1e-14, "atol": 1e-15}
    forces = contact_forces(u, v, np.array(stops.law), energies)
    depth, side = np.abs(stops.penetration(u)), -np.sign(stops.penetration(u))
    by_terms = side * np.maximum(0.0, contact.pressure(depth, -side * v, stops.law))
    assert np.allclose(by_terms, stops.force(u, v), **close)
    assert np.all(np.isnan(stops.force([np.nan, 1.0], [1.0, np.nan])))
    assert np.allclose(energies, stops.energy(u), **close)
    assert np.array_equal(-np.sign(forces), stops.state(u, v))
    assert np.all((stops.force(u, v) - stops.force(u, 0.0)) * v <= 1e-15)  # a stop never gives energy
    # The right-hand side of a free unit mass is the force; between events it goes on smoothly across the stop.
    ode = ball(stops).ode()
    for regime in (THROUGH, 0, *(side for side in stops.sides)):
        segment = ode if regime == THROUGH else ode.segment([regime])
        in_c = np.array([segment.rhs(0.0, y)[1] for y in zip(u, v, strict=True)])
        with float64_on_the_processor():
            twin = contact_force(jnp.asarray(u), jnp.asarray(v), regime, stops.law)
            assert np.allclose(in_c, np.broadcast_to(twin, u.shape), **close)
    slopes = np.array([ode.jac(0.0, np.array(y))[1] for y in zip(u, v, strict=True)])
    with float64_on_the_processor():
        of_one = jax.grad(lambda u, v: contact_force(u, v, THROUGH, stops.law), (0, 1))
        assert np.allclose(slopes, np.transpose(jax.vmap(of_one)(u, v)), rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("chosen", list(itertools.product((False, True), repeat=len(contact.LINEAR))))
def test_the_terms_are_of_one_law(chosen):
    """Force, slopes, energy, secants and inverses against each other, whichever parameters are not those of the linear
    law; and a law of which a closed form is promised has it. A term that is forgotten in one of them fails here."""
    rng = np.random.default_rng(7)
    for _ in range(20):
        changed = {
            name: plain + rng.uniform(0.2, 2.0) if use else plain
            for use, (name, plain) in zip(chosen, contact.LINEAR.items(), strict=True)
        }
        stops = sb.Stops(upper=0.0, stiffness=rng.uniform(0.5, 5.0), **changed)
        assert_one_law(stops, *rng.uniform(0.1, 2.0, 3))


def assert_one_law(stops: sb.Stops, d: float, e: float, rate: float, h: float = 1e-5) -> None:
    law = stops.law
    press, U = (partial(x, law=law) for x in (contact.pressure, contact.stored))
    f = partial(press, rate=0.0)
    assert math.isclose(f(d), (U(d + h) - U(d - h)) / (2 * h), rel_tol=1e-6)
    assert math.isclose(contact.chord(d, law), f(d) / d, rel_tol=1e-14)
    assert (f(-d), U(-d)) == (-f(d), U(d))
    assert f(contact.depth_under(f(d), law)) >= f(d) * (1.0 - 1e-12)
    assert U(contact.depth_holding(U(d), law)) >= U(d) * (1.0 - 1e-12)
    assert law.damps == (press(d, rate) != press(d, 0.0))
    assert law.jumps == (press(0.0, rate) != 0.0)
    bent = press(2 * d, 2 * rate) - 2 * press(d, rate)
    affine = abs(bent) <= 1e-12 * press(d, rate)
    assert stops.linear == (affine and not law.damps)
    depths = np.array([-d, 0.0, e])
    assert np.allclose(press(depths, rate), [press(float(x), rate) for x in depths], rtol=1e-14)
