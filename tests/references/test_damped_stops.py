"""Kelvin-Voigt stops in the exact solution and in many digits: a closed form, another solver, and the tangent flow."""

from __future__ import annotations

import numpy as np
import pytest
from law_systems import Witness, free_system, kelvin_voigt_system
from mpmath import mp, mpf

import stiffbeam as sb

TIMES = np.linspace(0.0, 3.0, 61)


@pytest.mark.parametrize("family", [kelvin_voigt_system, free_system])
@pytest.mark.parametrize("seed", range(408))
@pytest.mark.fast(2, slow=26)
def test_random_systems_against_other_solvers(family, seed):
    """DOP853 from switch to switch, the package's own adaptive solver in what that measures, and many digits."""
    system = family(seed)
    want, _ = Witness(system).solve(TIMES)
    run = sb.reference(system, 3.0, t_eval=TIMES)
    # The witness steps at rtol 1e-12 and places its switches to 1e-14; perturbations grow by e^3 at most in this time.
    assert np.max(np.abs(run.contacts[0].position - want)) < 1e-9 * np.max(np.abs(want))
    scale = np.max(run.energy.energy)
    assert np.max(np.abs(run.energy.loss)) < 1e-11 * scale
    assert np.all(np.diff(run.energy.stop_dissipation) > -1e-13 * scale)
    other = sb.reference(system, 3.0, method="dop853", t_eval=TIMES, rtol=1e-11)
    assert abs(run.energy.stop_dissipation[-1] - other.energy.stop_dissipation[-1]) < 1e-8 * scale
    many = sb.reference(system, 3.0, method="multiprecision", t_eval=TIMES)
    assert many.horizon == run.horizon == 3.0
    # Rounding of 1e-16 grows by 20 or less.
    assert np.max(np.abs(many.tip - run.tip)) < 1e-12 * np.max(np.abs(run.tip))
    assert np.array_equal(many.solution.sides, run.solution.sides)
    assert np.max(np.abs(many.energy.loss)) < 1e-12 * scale
    for a, b, c in zip(run.contacts, other.contacts, many.contacts, strict=True):
        assert a.impacts.count == b.impacts.count
        for name in ("times", "ends", "stops", "peaks", "impulses"):
            x, y = getattr(a.impacts, name), getattr(b.impacts, name)
            assert np.allclose(x, y, rtol=1e-6, atol=1e-7, equal_nan=True), name
        assert np.allclose(c.impacts.times, a.impacts.times, rtol=0.0, atol=1e-12)


@pytest.mark.fast(4)
@pytest.mark.parametrize("method", ["exact", "multiprecision"])
@pytest.mark.parametrize("zeta", [0.01, 0.1, 0.5, 1.0, 3.0])
def test_a_free_mass_on_a_kelvin_voigt_wall(method, zeta):
    """d'' + 2 zeta d' + d = 0 from (0, 1) till d + 2 zeta d' = 0, at d = 2 zeta e, d' = -e."""
    with mp.workdps(40):
        z = mpf(zeta)
        root = mp.sqrt(mp.mpc(1 - z * z))
        if zeta == 1.0:  # d = t exp(-t)
            t, e = mpf(2), mp.exp(-2)
        else:  # (1 + 2 zeta a) exp(a t) = (1 + 2 zeta b) exp(b t)
            a, b = -z + 1j * root, -z - 1j * root
            t = (mp.log(1 + 2 * z * b) - mp.log(1 + 2 * z * a)) / (a - b)
            t = t.real + (mp.pi / root.real if t.real <= 0 else 0)
            e = -((a * mp.exp(a * t) - b * mp.exp(b * t)) / (a - b)).real
        t, e, x = float(t), float(e), float(2 * z * e)
    stops = sb.Stops(upper=0.25, stiffness=1.0, damping=2.0 * zeta)
    system = sb.System.from_matrices([[1.0]], [[0.0]], contacts=[sb.Contact([1.0], stops)], initial_velocity=[1.0])
    run = sb.reference(system, 8.0, method=method, t_eval=[0.0, 8.0])
    assert run.impacts.times == pytest.approx([0.25], abs=1e-15)
    assert run.impacts.ends == pytest.approx([0.25 + t], abs=1e-14)
    assert run.tip_velocity[-1] == pytest.approx(-e, abs=1e-14)
    assert run.tip[-1] == pytest.approx(0.25 + x - e * (7.75 - t), abs=1e-13)
    assert run.impacts.impulses == pytest.approx([1.0 + e], rel=1e-13)
