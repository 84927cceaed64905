"""contact="averaged": the force of a stop averaged over a step around the node, and the schemes that take it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from systems import one_mass

import stiffbeam as sb
from stiffbeam.model.contact_law import Law
from stiffbeam.model.stage import AVERAGED, averaged_force, solve_stage

pytestmark = pytest.mark.usefixtures("numpy_kernel")

SCHEMES = [sb.Trapezoidal(), sb.BDF2(), sb.HHT(-0.1), sb.GeneralisedAlpha(0.8), sb.Theta(0.6)]


def oscillator(stiffness: float = 200.0, **law: float) -> sb.System:
    """One damped mass on a spring, driven into its stop."""
    contact, load = sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=stiffness, **law)), sb.Harmonic(2.0, 1.3, 0.4)
    return sb.System.from_matrices([[1.0]], [[4.0]], [[0.1]], [([1.0], load)], [contact])


def average(u: float, h: float, force) -> float:
    """Mean of a force over [u - h, u + h] by quadrature, which knows the stops."""
    edges = [x for x in (-0.3, 0.2) if u - abs(h) < x < u + abs(h)]
    return quad(force, u - abs(h), u + abs(h), points=edges or None, epsabs=1e-13, epsrel=1e-13)[0] / (2.0 * abs(h))


@pytest.mark.filterwarnings("ignore::scipy.integrate.IntegrationWarning")
def test_the_averaged_force_solves_its_equation():
    rng = np.random.default_rng(3)
    for _ in range(100):
        p, kappa = float(rng.choice([1.0, 1.5, 2.7])), float(10.0 ** rng.uniform(-1, 4))
        stops = sb.Stops(-0.3, 0.2, stiffness=kappa, exponent=p)
        s = float(10.0 ** rng.uniform(-6, 0))
        s_rate, r, w = s * rng.random(), rng.normal() * 0.5, rng.normal() * 10.0 ** rng.uniform(-3, 0)
        F, *slopes = averaged_force(r, w, s, s_rate, Law(*stops.law))

        def off(force: float, r=r, w=w, s=s, s_rate=s_rate, stops=stops) -> float:
            return force - average(r + s * force, w + s_rate * force, lambda x: float(stops.force(x)))

        largest = max(abs(float(stops.force(r + w))), abs(float(stops.force(r - w))), 1e-3)
        assert abs(F - brentq(off, -largest, largest, xtol=1e-14)) <= 1e-8 * largest
        for value, step in zip(slopes, ((1.0, 0.0), (0.0, 1.0)), strict=True):
            h = 1e-6
            ends = [averaged_force(r + k * h * step[0], w + k * h * step[1], s, s_rate, Law(*stops.law))[0]
                    for k in (1.0, -1.0)]  # fmt: skip
            assert value == pytest.approx((ends[0] - ends[1]) / (2.0 * h), abs=2e-4 * kappa)


@pytest.mark.filterwarnings("ignore::scipy.integrate.IntegrationWarning")
def test_several_averaged_forces_at_once():
    rng = np.random.default_rng(5)
    for _ in range(50):
        m = int(rng.integers(2, 4))
        stops = [sb.Stops(-0.3, 0.2, stiffness=10.0 ** rng.uniform(0, 3)) for _ in range(m)]
        A = rng.normal(size=(m, m))
        S, r, w = A @ A.T * 10.0 ** rng.uniform(-6, 0), rng.normal(size=m), 0.3 * rng.normal(size=m)
        F = solve_stage(r, w, S, 0.8 * S, np.zeros(m), AVERAGED, np.array([x.law for x in stops]))
        u, h = r + S @ F, w + 0.8 * S @ F
        for c in range(m):
            want = average(u[c], h[c], lambda x, stop=stops[c]: float(stop.force(x)))
            assert abs(F[c] - want) <= 1e-8 * (abs(want) + np.abs(S[c]) @ np.abs(F) / S[c, c])


@pytest.mark.fast(4)
@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_marches_agree(scheme, exponent):
    system = replace(oscillator(exponent=exponent))
    run = sb.integrate(system, scheme, 1e-2, 6.0, contact="averaged")
    assert run.impacts.count > 2
    plain = sb.integrate(system, scheme, 1e-2, 6.0, contact="averaged", engine="numpy")
    direct = sb.integrate(system, scheme, 1e-2, 6.0, contact="averaged", engine="direct")
    for other in (plain, direct):
        assert np.max(np.abs(other.tip - run.tip)) < 1e-12
        assert np.allclose(other.impacts.times, run.impacts.times, atol=1e-10)
        assert np.allclose(other.energy.loss, run.energy.loss, atol=1e-9 * run.energy.input[-1])
    ensemble = sb.integrate_ensemble(system, scheme, 1e-2, 6.0, [system, system], contact="averaged", every=1)
    assert np.array_equal(ensemble.tip[1], run.tip)


def test_a_plain_loop_takes_the_same_steps():
    """The trapezoidal rule on one mass: every step by a root search over the end position."""
    system, dt = oscillator(), 0.02
    run = sb.integrate(system, sb.Trapezoidal(), dt, 6.0, contact="averaged")
    q, v, force = 0.0, 0.0, 2.0 * math.sin(0.4)
    for n in range(300):
        load = 2.0 * math.sin(1.3 * dt * (n + 1) + 0.4)

        def rest(u: float, q=q, v=v, force=force, load=load) -> float:
            speed = 2.0 * (u - q) / dt - v
            inside = quad(lambda x: 200.0 * max(x - 0.1, 0.0), u - 0.5 * dt * speed, u + 0.5 * dt * speed,
                          points=[0.1], epsabs=1e-15)[0] if abs(speed) > 0 else 0.0  # fmt: skip
            pressed = inside / (dt * speed) if abs(speed) > 0 else 200.0 * max(u - 0.1, 0.0)
            rate = force - 0.1 * v - 4.0 * q + load - pressed - 0.1 * speed - 4.0 * u
            return speed - v - 0.5 * dt * rate

        u = brentq(rest, q - 1.0, q + 1.0, xtol=1e-15)
        speed = 2.0 * (u - q) / dt - v
        force = 2.0 * (speed - v) / dt - (force - 0.1 * v - 4.0 * q) + 0.1 * speed + 4.0 * u
        q, v = u, speed
        assert q == pytest.approx(run.tip[n + 1], abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES[:4], ids=str)
def test_value_and_derivative_have_order_two(scheme):
    """Differences of runs against the exact derivative; with implicit contact its order is below 1.5."""
    system, end = oscillator(), 5.0
    exact = sb.reference(system, end, t_eval=[0.0, end])
    slope = exact.derivative(["v0[0]"]).tip[-1, 0]
    orders = {}
    for contact in ("implicit", "averaged"):
        errors = []
        for n in (1000, 2000, 4000, 8000):
            ends = [
                sb.integrate(replace(system, v0=np.array([x])), scheme, end / n, end, contact=contact, every=n).tip[-1]
                for x in (-1e-5, 0.0, 1e-5)
            ]
            errors.append([abs(ends[1] - exact.tip[-1]), abs((ends[2] - ends[0]) / 2e-5 - slope)])
        logs = np.log2(np.array(errors))
        orders[contact] = (logs[0] - logs[-1]) / 3.0
    assert orders["averaged"] == pytest.approx(2.0, abs=0.2)
    assert orders["implicit"][1] < 1.3


class TestRefusals:
    @pytest.mark.parametrize("scheme", [sb.SDIRK(), sb.Bathe(), sb.ExponentialFlow()], ids=str)
    def test_schemes_with_several_forces_in_a_step_or_with_one_of_too_little_effect(self, scheme):
        with pytest.raises(sb.InputError, match="trapezoidal, hht or bdf2"):
            sb.integrate(oscillator(), scheme, 1e-2, 0.1, contact="averaged")

    def test_stops_that_dissipate(self):
        with pytest.raises(sb.InputError, match=r"stops\.dissipation.*implicit contact"):
            sb.integrate(oscillator(dissipation=0.1), sb.Trapezoidal(), 1e-2, 0.1, contact="averaged")

    def test_rigid_stops(self):
        system = one_mass(4.0, sb.Stops(upper=0.1, stiffness=math.inf, restitution=0.5))
        with pytest.raises(sb.InputError, match="implicit"):
            sb.integrate(system, sb.MoreauJean(), 1e-2, 0.1, contact="averaged")
