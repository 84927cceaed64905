"""The limit of rigid elastic stops: closed forms of one mass, its ledger, the rate at which stiff stops approach it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.measures.errors import observed_order
from stiffbeam.model.modes import modes
from stiffbeam.model.semidiscretisation import FORMS
from stiffbeam.references.exact.rigid_reference import rigid_limit


def oscillator(stiffness: float, kappa: float, lower: float, upper: float, start: float, speed: float) -> sb.System:
    stops = sb.Stops(lower, upper, stiffness=kappa)
    return one_mass(stiffness, stops, mass=2.0, q=start, v=speed)


def test_a_mass_on_a_spring_bounces_when_it_must():
    """q = A sin(w t) until A sin = g; then from stop to stop in 2 asin(g/A)/w, the speed turned round."""
    omega, amplitude, g = 3.0, 0.5, 0.2
    system = oscillator(2.0 * omega**2, 1e4, -g, g, 0.0, amplitude * omega)
    found = rigid_limit(system, 20.0)
    first = np.arcsin(g / amplitude) / omega
    expected = first * (1.0 + 2.0 * np.arange(found.impacts.count))
    assert found.impacts.count == int((20.0 / first + 1.0) // 2)
    assert np.max(np.abs(found.impacts.times - expected)) < 1e-12
    assert list(found.impacts.stops[:4]) == [1, -1, 1, -1]
    impulse = 2.0 * 2.0 * omega * np.sqrt(amplitude**2 - g**2)
    assert np.allclose(found.impacts.impulses, impulse, rtol=1e-12)
    # Between two impacts it is the same sine, mirrored.
    u, _ = found.at(expected[0] + np.array([0.5, 1.0]) * first)
    assert np.allclose(u, [amplitude * np.sin(0.5 * omega * first), 0.0], atol=1e-13)


def test_a_free_mass_bounces_at_even_intervals():
    found = rigid_limit(oscillator(0.0, 1e4, -0.3, 0.5, 0.1, 2.0), 10.0)
    expected = 0.2 + 0.4 * np.arange(found.impacts.count)
    assert found.impacts.count == 25
    assert np.max(np.abs(found.impacts.times - expected)) < 1e-12


def test_compliant_stops_approach_rigid_ones_at_rate_one_half():
    """Each contact costs half a period pi sqrt(m/kappa) of the mass on its spring, and so much the tip lags."""
    omega, amplitude, g = 3.0, 0.5, 0.2
    first = np.arcsin(g / amplitude) / omega
    end, count = 6.0 * first, 3
    kappas = 4.0 ** np.arange(10, 16)
    rigid = rigid_limit(oscillator(2.0 * omega**2, 1.0, -g, g, 0.0, amplitude * omega), end)
    assert rigid.impacts.count == count
    errors = []
    for kappa in kappas:
        compliant = sb.reference(oscillator(2.0 * omega**2, kappa, -g, g, 0.0, amplitude * omega), end)
        errors.append(abs(compliant.at(end)[0][0] - rigid.at(end)[0][0]))
    # At the end the mass passes the middle with its largest speed.
    expected = amplitude * omega * count * np.pi * np.sqrt(2.0 / kappas)
    assert abs(observed_order(1.0 / kappas, errors).slope - 0.5) < 0.01
    assert errors[-1] == pytest.approx(expected[-1], rel=0.01)


@pytest.mark.parametrize("form", FORMS)
def test_the_ledger_of_rigid_stops_closes_without_them(form, table10):
    """Elastic impacts take nothing: kinetic and elastic energy change by the work put in, to rounding."""
    found = rigid_limit(sb.semidiscretise(table10, 10, form), 0.5)
    assert found.impacts.count > 10
    ledger = found.energy
    had = np.max(np.abs(ledger.input) + ledger.energy)
    assert np.max(np.abs(ledger.stops)) == 0.0
    # Every impact rounds the state by eps (w_max/w_1) of its largest velocity.
    omega = modes(sb.semidiscretise(table10, 10, form)).omega
    rounding = np.finfo(float).eps * omega[-1] / omega[0] * found.impacts.count
    assert np.max(np.abs(ledger.kinetic + ledger.elastic - ledger.energy[0] - ledger.input)) < 10 * rounding * had
    assert np.max(np.abs(ledger.viscous)) == 0.0


def test_rigid_stops_refuse_what_they_cannot_take(table10):
    with pytest.raises(InputError, match="undamped"):
        rigid_limit(sb.semidiscretise(replace(table10, viscosity=0.1), 6), 0.1)
    with pytest.raises(InputError, match="one contact"):
        rigid_limit(sb.semidiscretise(replace(table10, stops=None), 6), 0.1)
    with pytest.raises(InputError, match="between rigid stops"):
        rigid_limit(oscillator(1.0, 1e4, -0.3, 0.5, 0.6, 0.0), 1.0)
    with pytest.raises(InputError, match="t_end"):
        rigid_limit(oscillator(1.0, 1e4, -0.3, 0.5, 0.1, 0.0), -1.0)
    with pytest.raises(InputError, match="offset"):
        rigid_limit(one_mass(1.0, sb.Stops(upper=1.0, stiffness=1.0), offset=sb.Constant(0.1)), 1.0)
