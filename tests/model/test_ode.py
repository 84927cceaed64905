"""A system as a differential equation: the same numbers for NumPy and JAX, and solvers of others."""

from __future__ import annotations

import ctypes
from functools import partial

import numpy as np
import pytest
import scipy.integrate
import systems
from systems import one_mass

import stiffbeam as sb
from stiffbeam.model.right_hand_side import RightHandSide

pair = partial(systems.pair, sb.Harmonic(-0.01, 3.0))  # with stops that move


def acceleration(system: sb.System, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """M^-1 (p f - C v - K q + row F), written down from the law, without the package's kernels."""
    stops = system.contacts[0].stops
    motion = 0.01 * np.sin(3.0 * t), 0.03 * np.cos(3.0 * t)
    force = 0.0
    for side, gap in ((1, 0.08), (-1, -0.1)):
        depth, rate = side * (q[1] - motion[0] - gap), side * (v[1] - motion[1])
        if depth > 0.0:
            elastic = stops.stiffness * depth**stops.exponent * (1.0 + stops.dissipation * rate)
            force -= side * max(0.0, elastic + stops.damping * rate)
    f = np.array([0.0, 9.0 * np.sin(7.0 * t + 0.3) + force]) - system.damping @ v - system.stiffness @ q
    return np.linalg.solve(system.mass, f)


LAWS = [{}, {"damping": 3.0}, {"exponent": 1.5, "dissipation": 0.4}]


@pytest.mark.fast(1)
@pytest.mark.usefixtures("jax_in_float64")
@pytest.mark.parametrize("law", LAWS)
def test_every_variant_is_the_law_written_down(law):
    import jax

    system, rng = pair(**law), np.random.default_rng(1)
    ode, descriptor = system.ode(), RightHandSide(system, descriptor=True)
    traced, (address, data) = jax.jit(ode.jax), ode.cfunc
    called = ctypes.CFUNCTYPE(None, ctypes.c_double, *3 * [ctypes.c_void_p])(address)
    for _ in range(50):
        t, y = float(rng.uniform(0.0, 3.0)), rng.normal(size=4) * [0.2, 0.2, 2.0, 2.0]
        q, v = y[::2], y[1::2]
        rate = ode.rhs(t, y)
        assert rate[::2] == pytest.approx(v, rel=1e-13)
        expected = acceleration(system, t, q, v)
        assert rate[1::2] == pytest.approx(expected, rel=1e-11, abs=1e-11)
        times, rows = np.arange(3.0), np.arange(12.0).reshape(3, 4)
        assert np.array_equal(ode.tip(times, rows.T), ode.tip(times, rows))  # SciPy's shape
        with pytest.raises(sb.InputError, match=r"states \(k, 4\) or \(4, k\)"):
            ode.tip(times, rows[:, :3])
        assert np.asarray(traced(t, y)) == pytest.approx(rate, rel=1e-12, abs=1e-12)
        called(t, y.ctypes.data, (out := np.empty(4)).ctypes.data, data)
        assert out == pytest.approx(rate, rel=1e-12, abs=1e-12)
        z = np.pad(y, (0, descriptor.size - 4))
        assert descriptor.rate(t, z)[:4] == pytest.approx(rate, rel=1e-11, abs=1e-11)
        pressed = [event(t, y) > 0.0 for event in ode.events]
        depth = q[1] - 0.01 * np.sin(3.0 * t)
        if not law:
            assert pressed == [depth > 0.08, depth < -0.1]
        assert np.array_equal(ode.segment([1 if pressed[0] else -1 if pressed[1] else 0]).rhs(t, y), rate)


def test_the_jacobian_is_the_derivative():
    ode, rng = pair(exponent=1.5, dissipation=0.4).ode(), np.random.default_rng(2)
    for _ in range(20):
        t, y = float(rng.uniform(0.0, 3.0)), rng.normal(size=4) * [0.2, 0.2, 2.0, 2.0]
        h = 1e-6
        columns = [(ode.rhs(t, y + h * e) - ode.rhs(t, y - h * e)) / (2 * h) for e in np.eye(4)]
        assert ode.jac(t, y) == pytest.approx(np.array(columns).T, rel=1e-4, abs=1e-4)


def test_a_solver_restarts_segment_by_segment():
    """DOP853 of SciPy by hand: the exact solution at the end, and every entry in time."""
    system, t_end = pair(), 3.0
    ode, exact = system.ode(), sb.reference(system, t_end)
    t, y, side, entries = 0.0, ode.y0, 0, []
    while t < t_end:
        segment = ode.segment([side])
        solution = scipy.integrate.solve_ivp(
            segment.rhs, (t, t_end), y, method="DOP853", events=segment.events, rtol=1e-11, atol=1e-13
        )
        t, y = float(solution.t[-1]), solution.y[:, -1]
        if solution.status == 1:
            k = next(k for k, times in enumerate(solution.t_events) if len(times))
            side = 0 if segment.events[k].side == side else segment.events[k].side
            entries += [t] if side else []
    assert entries == pytest.approx(exact.impacts.times, abs=1e-9)
    assert ode.tip(t_end, y)[0] == pytest.approx(float(exact.tip[-1]), abs=1e-9)


def test_breakpoints_and_bandwidths_are_stated():
    record = sb.Sampled(np.linspace(0.0, 1.0, 5), np.array([0.0, 1.0, 0.0, 2.0, 0.0]))
    system = one_mass(4.0, load=sb.Superposition(record, sb.Harmonic(1.0, 2.0)))
    assert system.ode().breakpoints == (0.0, 0.25, 0.5, 0.75, 1.0)
    beam = sb.semidiscretise(sb.paper_case(10).problem, 25)
    bandwidths = beam.ode().bandwidths
    assert bandwidths is not None
    lower, upper = bandwidths
    jac = beam.ode().jac(0.0, beam.ode().y0)
    rows, columns = np.nonzero(jac)
    assert np.max(rows - columns) <= lower
    assert np.max(columns - rows) <= upper


def test_what_it_cannot_be_is_refused():
    with pytest.raises(sb.InputError, match="sides must hold"):
        pair().ode().segment([2])
    assert one_mass(1.0, load=np.sin).ode().rhs(1.0, [0.0, 0.0])[1] == pytest.approx(np.sin(1.0))
    with pytest.raises(sb.InputError, match="jax_enable_x64"):
        pair().ode().jax  # noqa: B018
