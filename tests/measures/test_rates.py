"""Rates of a long run: coverage of their intervals on motions with known rates, work against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from noise import noise
from scipy.integrate import quad
from scipy.signal import lfilter
from scipy.stats import norm
from systems import one_mass

import stiffbeam as sb
from stiffbeam.measures.rates import stationary_mean, windows

CASES = 300
QUADRATURE = 5e-5  # of works: midpoints of 243 cells a contact, a rule of order 2
LEAST, MOST = 0.912, 0.988  # of 300 intervals of 95 %: three deviations of the count, 1.26 %


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_interval_of_a_correlated_series_covers_its_mean(memory):
    """x_k = memory x_k-1 + noise: the effective size of n values is n (1 - memory)/(1 + memory)."""
    rng, inside, sizes, n = np.random.default_rng(11), 0, [], 600
    for _ in range(CASES):
        mean = stationary_mean(3.0 + lfilter([1.0], [1.0, -memory], rng.normal(size=n + 200))[200:])
        inside += mean.low <= 3.0 <= mean.high
        sizes.append(mean.effective)
    assert LEAST <= inside / CASES <= MOST
    assert np.median(sizes) == pytest.approx(n * (1 - memory) / (1 + memory), rel=0.15)


@pytest.mark.parametrize(("n", "holds"), [(8, 0.86), (20, 0.93)])
def test_the_interval_of_few_values_holds_as_often_as_its_limitation_states(n, holds):
    rng, cases = np.random.default_rng(3), 1500
    means = [stationary_mean(rng.normal(size=n)) for _ in range(cases)]
    assert np.mean([mean.low <= 0.0 <= mean.high for mean in means]) == pytest.approx(holds, abs=0.025)


@pytest.mark.slow
def test_the_intervals_of_rates_cover_those_of_a_gaussian_motion():
    """A stop too soft to be felt counts crossings of an oscillator under noise, whose rate is Rice's:
    sigma_v/(2 pi sigma_u) exp(-g^2/2 sigma_u^2), and the share of the time beyond it is that of the normal law."""
    zeta, band, span, gap = 0.05, (0.4, 2.0), 400.0, 1.0

    def moment(power: int) -> float:  # of the response to noise of rms 1, flat in the band
        def density(w: float) -> float:
            return w**power / ((1 - w**2) ** 2 + (2 * zeta * w) ** 2)

        return quad(density, *band, points=[1.0], limit=200)[0] / (band[1] - band[0])

    u, v = np.sqrt(moment(0)), np.sqrt(moment(2))
    known = {"impact": v / u / (2 * np.pi) * np.exp(-0.5 * (gap / u) ** 2), "contact": norm.sf(gap / u)}
    inside = dict.fromkeys(known, 0)
    for seed in range(CASES):
        load = noise(4 * span, rms=1.0, band=band, rng=seed)
        system = one_mass(1.0, sb.Stops(upper=gap, stiffness=1e-9), damping=2 * zeta, load=load)
        rates = sb.contact_rates(sb.integrate(system, sb.Trapezoidal(), 0.16, span), since=60.0).rates[0]
        for name, value in known.items():
            inside[name] += rates[name].low <= value <= rates[name].high
    assert all(LEAST <= count / CASES <= MOST for count in inside.values()), inside


def pressed(damping: float = 0.0) -> sb.System:
    """A mass that a prescribed base carries: u = q + 0.3 sin(2 t), q of mass 1e12 at rest, and a second, free mass."""
    stops = sb.Stops(upper=0.1, stiffness=400.0, damping=damping)
    contact = sb.Contact([1.0, 0.0], stops, sb.Harmonic(0.3, 2.0))
    return sb.System.from_matrices(
        np.diag([1e12, 1.0]), np.diag([1e12, 9.0]), contacts=[contact], initial_velocity=[0.0, 0.7]
    )  # fmt: skip


@pytest.mark.parametrize("damping", [0.0, 15.0])
def test_work_of_a_prescribed_motion(damping):
    """u = 0.3 sin(2 t) into a stop at 0.1: F and v in closed form, w = 0.7 cos(3 t), integrated by SciPy."""
    t_end = 4.0 * np.pi

    def force(t):
        depth, rate = 0.3 * np.sin(2 * t) - 0.1, 0.6 * np.cos(2 * t)
        return max(0.0, 400.0 * depth + damping * rate) if depth > 0.0 else 0.0

    first, last = 0.5 * np.arcsin(1 / 3), 0.5 * (np.pi - np.arcsin(1 / 3))

    def work(size, omega):
        halves = ((first, np.pi / 4), (np.pi / 4, last))
        spans = [(n * np.pi + a, n * np.pi + b) for n in range(4) for a, b in halves]
        return sum(quad(lambda t: force(t) * abs(size * np.cos(omega * t)), *span, limit=200)[0] for span in spans)

    works = [work(0.6, 2), work(0.7, 3)]
    spans = [(n * np.pi + first, n * np.pi + last) for n in range(4)]
    rms = np.sqrt(sum(quad(lambda t: force(t) ** 2, *span, limit=200)[0] for span in spans) / t_end)
    if not damping:  # twice the energy of the deepest point, once in and once out
        assert works[0] == pytest.approx(4 * 400.0 * 0.2**2, rel=1e-9)
    system, tangents = pressed(damping), [[0.0, 1.0]]
    solutions = {
        "exact": (sb.reference(system, t_end), QUADRATURE),
        "scheme": (sb.integrate(system, sb.Trapezoidal(), t_end / 20_000, t_end), 3e-4),
    }
    for name, (run, tolerance) in solutions.items():
        result = sb.contact_rates(run, tangents=tangents)
        rates = [result.rates[0][x].value * t_end for x in ("normal_work", "sliding_work")]
        np.testing.assert_allclose(rates, works, rtol=tolerance, err_msg=name)
        force_rms = result.rates[0]["force_rms"]
        assert force_rms.value == pytest.approx(rms, rel=tolerance), name
        assert force_rms.low <= force_rms.value <= force_rms.high
        assert result.sources[0] == ("events" if name == "exact" else "every step")
    assert "normal_work_rate_low" in str(result)
    assert result.to_dataframe()["force_rms"].iloc[0] == result.rates[0]["force_rms"].value
    assert result.to_dataframe()["sliding_work_rate"].iloc[0] == pytest.approx(works[1] / t_end, rel=1e-3)


@pytest.mark.parametrize(("damping", "method"), [(0.02, "exact"), (0.5, "exact"), (0.02, "cvode")])
def test_the_stated_quadrature_holds(damping, method):
    """Work of a damped mass in each contact with either stop against a fine trapezoidal rule."""
    spring = sb.Contact([1.0, 0.0], sb.Stops(-0.2, 0.1, stiffness=400.0))
    system = sb.System.from_matrices(
        np.eye(2), np.diag([4.0, 900.0]), np.diag([damping, 0.0]), contacts=[spring], initial_velocity=[1.0, 3.0]
    )
    exact = sb.reference(system, 12.0, method)
    result, impacts, works = sb.contact_rates(exact, tangents=[[0.0, 1.0]]), exact.contacts[0].impacts, np.zeros(2)
    for start, end in zip(impacts.times, np.where(np.isnan(impacts.ends), 12.0, impacts.ends), strict=True):
        t = np.linspace(start, end, 100_001)
        u, v = exact.at(t, contact=0)
        speeds = np.abs([v, 3.0 * np.cos(30.0 * t)])
        works += np.trapezoid(np.abs(exact.contacts[0].stops.force(u, v)) * speeds, t)
    found = [12.0 * result.rates[0][name].value for name in ("normal_work", "sliding_work")]
    np.testing.assert_allclose(found, works, rtol=QUADRATURE)


def test_a_contact_that_the_start_of_the_rates_cuts():
    """A mass that never leaves its stop: integrals from a time within the contact, against the trapezoidal rule."""
    loads = [([1.0], sb.Constant(30.0)), ([1.0], sb.Harmonic(3.0, 2.7))]
    stop = sb.Contact([1.0], sb.Stops(upper=0.0, stiffness=100.0))
    system = sb.System.from_matrices([[1.0]], [[4.0]], [[0.1]], loads, [stop], initial_displacement=[0.2])
    exact = sb.reference(system, 12.0)
    rates, t = sb.contact_rates(exact, since=5.3).rates[0], np.linspace(5.3, 12.0, 200_001)
    u, v = exact.at(t, contact=0)
    force = np.abs(exact.contacts[0].stops.force(u, v))
    wanted = [np.trapezoid(x, t) / 6.7 for x in (force, force * np.abs(v))]
    assert [rates["impulse"].value, rates["normal_work"].value] == pytest.approx(wanted, rel=QUADRATURE)
    assert rates["contact"].value == pytest.approx(1.0, rel=1e-12)


def test_whole_periods_have_their_parts_whatever_the_rounding():
    for omega in np.arange(1.0, 40.0):
        system = sb.System.from_matrices([[1.0]], [[omega**2]], observe=[1.0], initial_velocity=[1.0])
        assert len(windows(system, 0.0, np.nextafter(40.0 * (2.0 * np.pi / omega), 0.0))) == 21


def test_what_is_not_known_is_said(tmp_path):
    system = pressed()
    run = sb.integrate(system, sb.Trapezoidal(), 1e-3, 6.0)
    loaded = sb.contact_rates(sb.load(run.save(tmp_path / "run.nc")))
    whole = sb.contact_rates(run).rates[0]["normal_work"].value
    assert loaded.rates[0]["normal_work"].value == pytest.approx(whole, rel=1e-12)
    assert np.isnan(loaded.rates[0]["sliding_work"].value)
    with pytest.raises(sb.InputError, match="every=1"):
        sb.contact_rates(sb.integrate(system, sb.Trapezoidal(), 1e-3, 6.0, every=10))
    ball = one_mass(0.0, sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.8), load=sb.Constant(-9.81), q=1.0)
    exact = sb.reference(ball, 2.0)
    rates = sb.contact_rates(exact).rates[0]
    assert np.isnan([rates[name].value for name in ("contact", "normal_work", "force_rms")]).all()
    assert rates["impulse"].value * 2.0 == pytest.approx(exact.contacts[0].impulse)
    assert rates["impact"].value * 2.0 == pytest.approx(exact.contacts[0].impacts.count)
    for wrong in ([[1.0]], [[1.0, 0.0], None]):
        with pytest.raises(sb.InputError, match="tangents"):
            sb.contact_rates(run, tangents=wrong)
    with pytest.raises(sb.InputError, match="since"):
        sb.contact_rates(run, since=6.0)


@pytest.mark.parametrize(("gap", "bounds"), [(0.1, (0.6187, 3.0, 8.7673)), (1.0, (0.0, 0.0, 3.6889))])
def test_the_rate_of_few_impacts_has_the_interval_of_poisson(gap, bounds):
    """Three impacts, and none: the bounds of tables of Poisson's law."""
    system = one_mass(4.0, sb.Stops(upper=gap, stiffness=400.0), v=1.0)
    rate = sb.contact_rates(sb.reference(system, 5.0)).rates[0]["impact"]
    assert [5.0 * x for x in (rate.low, rate.value, rate.high)] == pytest.approx(bounds, rel=1e-4)
