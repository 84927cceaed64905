"""The amplification of one step: the kernel's propagator against closed forms and published values."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.schemes import registered

GRID = np.logspace(-3, 3, 121)
MEASURES = ("spectral_radius", "period_elongation", "damping_ratio")
PAPER = [sb.HHT(-0.1).printed(), sb.SDIRK().printed("sigma")]
PARAMETERS = [
    *(sb.HHT(a) for a in np.linspace(-1 / 3, 0.0, 7)),
    *(sb.SDIRK(g) for g in (0.2, 0.35, 0.5, 0.8)),
    *(sb.GeneralisedAlpha(r) for r in np.linspace(0.0, 0.9, 4)),
]


@pytest.mark.parametrize("xi", [0.0, 0.05])
@pytest.mark.parametrize("scheme", [*registered(), *PAPER, *PARAMETERS], ids=str)
@pytest.mark.fast(12)
def test_the_kernel_amplifies_like_the_closed_form_from_a_thousandth_of_the_period_to_a_thousand(scheme, xi):
    """To 1e-10, elongation relative to the period it elongates.

    rho = 1 is the exception: near its triple root -1 the roots move by the third root of rounding over
    the cube of their distance, 3e-10 of eps/|distance|^2 at dt/T = 1000.
    """
    measured, theory = sb.amplification(scheme, GRID, xi), sb.amplification(scheme, GRID, xi, source="closed form")
    defective = isinstance(scheme, sb.GeneralisedAlpha) and scheme.rho == 1.0
    for name in MEASURES:
        found, wanted = getattr(measured, name), getattr(theory, name)
        scale = 1.0 + np.abs(wanted) if name == "period_elongation" else 1.0
        assert np.array_equal(np.isnan(found), np.isnan(wanted))
        assert np.nanmax(np.abs(found - wanted) / scale) < (1e-8 if defective else 1e-10)


def test_the_trapezoidal_rule_shortens_no_amplitude_and_has_the_elongation_of_its_arctangent():
    x = np.array([1e-3, 0.1, 1.0, 100.0])
    found = sb.amplification(sb.Trapezoidal(), x)
    omega_dt = 2 * np.pi * x
    assert np.max(np.abs(found.spectral_radius - 1.0)) < 1e-12
    assert np.max(np.abs(found.damping_ratio)) < 1e-12
    exact = omega_dt / (2 * np.arctan(omega_dt / 2)) - 1
    assert np.max(np.abs(found.period_elongation - exact) / (1 + exact)) < 1e-11


@pytest.mark.parametrize(
    ("scheme", "elongation", "damping"),
    [
        (sb.HHT(-0.1), 0.0395, None),
        (sb.BDF2(), 0.102, None),
        # Expansions at dt -> 0: (w dt)^2/12 and none; (w dt)^2/3 and (w dt)^3/4 of BDF2.
        (sb.Trapezoidal(), 0.0318, 0.0),
    ],
    ids=str,
)
def test_the_period_elongation_at_a_tenth_of_the_period_is_the_literatures(scheme, elongation, damping):
    found = sb.amplification(scheme, 0.1)
    assert abs(found.period_elongation[0] - elongation) < 0.0006
    if damping is not None:
        assert abs(found.damping_ratio[0] - damping) < 1e-12


def test_small_steps_follow_the_schemes_error_expansions():
    """BDF2: elongation x^2/3, damping x^3/4; HHT: damping -alpha x^... of order 3; x = w dt."""
    x = np.array([2e-3, 4e-3])
    bdf = sb.amplification(sb.BDF2(), x)
    assert np.allclose(bdf.period_elongation, (2 * np.pi * x) ** 2 / 3, rtol=1e-3)
    assert np.allclose(bdf.damping_ratio, (2 * np.pi * x) ** 3 / 4, rtol=1e-3)
    # A stiffly accurate third-order scheme: both errors of order 3 and above.
    sdirk = sb.amplification(sb.SDIRK(), 10 * x)
    assert 7.0 < sdirk.damping_ratio[1] / sdirk.damping_ratio[0] < 8.5
    assert sdirk.period_elongation[0] < 0.1 * bdf.period_elongation[0] * 100


@pytest.mark.parametrize("scheme", list(registered()), ids=str)
def test_a_damped_oscillators_own_damping_is_what_remains_for_small_steps(scheme):
    found = sb.amplification(scheme, 1e-3, damping_ratio=0.05)
    x = 2 * np.pi * 1e-3  # every scheme errs by x^2 times a constant below 1
    assert abs(found.damping_ratio[0] - 0.05) < x**2
    assert abs(found.period_elongation[0]) < x**2


def test_the_radius_at_infinity_is_what_the_parameter_says():
    # The three roots of generalised-alpha coalesce at -rho like x^(-2/3), x = w dt.
    for rho in (0.0, 0.5, 0.8):
        radius = sb.amplification(sb.GeneralisedAlpha(rho), [1e4, 1e5]).spectral_radius
        assert np.all(np.abs(radius - rho) < 1.1 * (2 * np.pi * np.array([1e4, 1e5])) ** (-2 / 3))
    for scheme in (sb.BDF2(), sb.SDIRK(), sb.Bathe(), sb.Bathe(2 - 2**0.5)):
        assert sb.amplification(scheme, 1e5).spectral_radius[0] < 2e-3  # L-stable


def test_bathe_with_the_tr_bdf2_split_amplifies_like_tr_bdf2():
    """R(z) of Bank et al. with gamma = 2 - sqrt 2, written from its tableau."""
    g = 2 - np.sqrt(2)
    d, w = g / 2, np.sqrt(2) / 4
    A, b = np.array([[0, 0, 0], [d, d, 0], [w, w, d]]), np.array([w, w, d])
    for x in (0.05, 0.3, 2.0):
        z = 2j * np.pi * x
        R = 1 + z * b @ np.linalg.solve(np.eye(3) - z * A, np.ones(3))
        assert abs(sb.amplification(sb.Bathe(g), x).spectral_radius[0] - abs(R)) < 1e-12


class SymplecticEuler(sb.Scheme):
    """v^{n+1} = v^n + dt a^n, q^{n+1} = q^n + dt v^{n+1}: explicit, stable to w dt = 2; no theory stated."""

    nodes = (0.0,)

    def step(self, equation, dt, z, loads, reactions):
        q, v = z
        v_new = v + dt * equation.acceleration(z, loads[0] + reactions[0])
        return np.stack([q + dt * v_new, v_new]), [z]


def test_the_stability_limit_of_an_explicit_scheme_is_found_and_beyond_it_there_is_no_period():
    x = np.linspace(0.01, 0.6, 1000)
    found = sb.amplification(SymplecticEuler(), x)
    assert abs(found.stable_to - 1 / np.pi) < x[1] - x[0]
    assert np.all(np.isnan(found.period_elongation[x > 1 / np.pi + 1e-3]))
    assert sb.amplification(sb.HHT(), x).stable_to == np.inf
    with pytest.raises(sb.InputError, match="kernel"):
        sb.amplification(SymplecticEuler(), x, source="closed form")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (([0.1, -1.0],), "positive"),
        (([],), "one or more"),
        ((np.ones((2, 2)),), "one or more"),
        ((0.1, 1.0), r"\[0, 1\)"),
        ((0.1, 0.0, "theory"), "closed form"),
    ],
)
def test_bad_arguments_are_refused(arguments, word):
    with pytest.raises(sb.InputError, match=word):
        sb.amplification(sb.HHT(), *arguments)
