"""The leaps of the exact solution: sines in vector registers, the bound of a leap's cubic, the first switch."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest
from scipy.optimize import brentq

import stiffbeam as sb
from stiffbeam.piecewise.search import safe_step, search
from stiffbeam.piecewise.terms import (
    CONSTANT,
    LEVEL,
    OMEGA,
    SIGMA,
    SQUARE,
    X,
    Y,
    carry,
    cubic,
    layout,
    measure,
    oscillations,
    resolved,
)


def test_a_kernel_without_an_entry_for_python_refuses_a_call():
    """Before it is compiled and after: numba alone would jump to address 0."""
    for t_end in (0.0, 0.01):
        if t_end:
            sb.reference(sb.paper_case(10).system(), t_end)
        with pytest.raises(TypeError, match="safe_step is compiled for other kernels"):
            safe_step(1.0, 1.0, 1.0)


def random_terms(rng, damped, m=1, K=9):
    """Sums of oscillations over five decades of frequency, the slow ones largest, and what they are at any time."""
    speeds, terms, seen, pairs = layout(m, K, 0)
    speeds[OMEGA] = np.sort(10.0 ** rng.uniform(0.0, 4.0, K))
    if damped:
        speeds[SIGMA] = -speeds[OMEGA] * 10.0 ** rng.uniform(-4.0, 0.0, K)
        speeds[OMEGA, 2] = 0.0  # one that only decays
        order = np.argsort(np.hypot(speeds[SIGMA], speeds[OMEGA]))
        speeds[[SIGMA, OMEGA]] = speeds[[SIGMA, OMEGA]][:, order]
    speeds[SQUARE] = speeds[OMEGA] ** 2
    still = speeds[OMEGA] == 0.0
    size = rng.normal(size=(m, K)) / np.maximum(1.0, speeds[OMEGA]) ** 0.7
    terms[:, X], terms[:, Y] = size, np.where(still, 0.0, rng.normal(size=(m, K)) * speeds[OMEGA] * np.abs(size))
    terms[:, LEVEL] = 0.0 if damped else rng.normal(size=(m, K)) * np.abs(size) * speeds[SQUARE]
    seen[:, CONSTANT] = 0.1 * rng.normal(size=m)

    def position(i, tau):
        w, decay = np.where(still, 1.0, speeds[OMEGA]), np.exp(np.multiply.outer(tau, speeds[SIGMA]))
        angle = np.multiply.outer(tau, speeds[OMEGA])
        c, s, level = np.cos(angle), np.sin(angle) / w, 2.0 * np.sin(0.5 * angle) ** 2 / w**2
        return seen[i, CONSTANT] + np.sum(
            decay * (terms[i, X] * c + terms[i, Y] * s) + terms[i, LEVEL] * level, axis=-1
        )

    return speeds, terms, seen, pairs, position


def test_sines_in_vector_registers_are_those_of_the_library():
    """Two roundings of values up to one; the arguments are the same doubles."""
    rng = np.random.default_rng(3)
    for tau in (0.0, 1e-9, 1e-3, 1.0, 37.0, 4e2, 1e7):
        omega = np.concatenate([[0.0], 10.0 ** rng.uniform(-6.0, 4.0, 200)])
        c, s, v = (np.empty(omega.size) for _ in range(3))
        oscillations(omega, tau, c, s, v)
        x = omega * tau
        assert np.max(np.abs(c - np.cos(x))) < 5e-16
        assert np.max(np.abs(omega * s - np.sin(x))) < 5e-16
        assert np.max(np.abs(omega**2 * v - 2.0 * np.sin(0.5 * x) ** 2)) < 5e-16
        slow = x < 1e-2
        assert np.allclose(s[slow], tau * (1.0 - x[slow] ** 2 / 6.0), rtol=1e-9)
        assert np.allclose(v[slow], 0.5 * tau**2 * (1.0 - x[slow] ** 2 / 12.0), rtol=1e-9)


@pytest.mark.parametrize("damped", [False, True])
def test_the_error_of_a_leaps_cubic_is_bounded(damped):
    rng = np.random.default_rng([5, damped])
    largest = 0.0
    for _ in range(300):
        speeds, terms, seen, pairs, position = random_terms(rng, damped)
        tau, step = rng.uniform(0.0, 1.0), 10.0 ** rng.uniform(-4.5, -1.0)
        carry(speeds, terms, seen, pairs, damped, 0.0, tau, 0)
        carry(speeds, terms, seen, pairs, damped, 0.0, tau + step, 1)
        measure(speeds, terms, damped, 0)
        p = cubic(speeds, terms, seen, pairs, damped, 0.0, tau, step, resolved(speeds, step), 0, 0)
        s = np.linspace(0.0, step, 41)
        off = np.max(np.abs(np.polyval(p[3::-1], s) - position(0, tau + s)))
        assert off <= p[4] + 1e-14 * np.sum(np.abs(terms[0, X]))
        largest = max(largest, off / p[4] if p[4] > 1e-9 else 0.0)
    assert largest > 0.2  # the bound is no bound of nothing


@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("m", [1, 3])
@pytest.mark.fast(1)
def test_the_first_switch_is_that_of_dense_samples(damped, m):
    rng = np.random.default_rng([7, damped, m])
    found = 0
    for _ in range(40):
        speeds, terms, seen, pairs, position = random_terms(rng, damped, m, 6)
        end = 30.0 / np.max(speeds[OMEGA]) * 10.0 ** rng.uniform(0.0, 1.5)
        t = np.linspace(0.0, end, 20_001)
        u = np.array([position(i, t) for i in range(m)])
        # Stops around the start that some motions reach.
        g2 = u[:, 0] + 1e-3 + rng.uniform(0.1, 1.1, m) * np.max(u - u[:, :1], axis=1)
        g1 = u[:, 0] - 1e-3 - rng.uniform(0.1, 1.1, m) * np.max(u[:, :1] - u, axis=1)
        none = np.zeros(m, np.int64)
        tau, contact, side, _ = search(speeds, terms, seen, pairs, none, g1, g2, none, 0.0, end)
        beyond = np.where(u > g2[:, None], 1, np.where(u < g1[:, None], -1, 0))
        first = np.flatnonzero(np.any(beyond != 0, axis=0))
        if not len(first):
            assert contact == -1
            continue
        k = int(first[0])
        i = int(np.flatnonzero(beyond[:, k])[0])
        stop = g2[i] if beyond[i, k] > 0 else g1[i]
        exact = brentq(lambda x, u=position, i=i, stop=stop: float(u(i, x) - stop), t[k - 1], t[k], xtol=1e-15)
        assert (contact, side) == (i, beyond[i, k])
        assert abs(tau - exact) < 1e-11 * end
        found += 1
    assert found > 20


def work_of(system, t_end):
    """Of the exact solution with its horizon and its ledger: switches, and gaps evaluated and functions called."""
    calls = 0

    def count(frame, event, argument):
        nonlocal calls
        calls += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        run = sb.reference(system, t_end)
        assert run.energy.kinetic[-1] > 0.0
    finally:
        sys.setprofile(before)
    return len(run.solution.times), run.solution.evaluations, calls


@pytest.mark.parametrize("viscosity", [0.0, 0.01])
@pytest.mark.fast(1)
def test_the_work_grows_with_the_switches(viscosity):
    """Not with their square: with ten times the switches that takes a hundred times the work."""
    case = sb.paper_case(10)
    system = sb.semidiscretise(dataclasses.replace(case.problem, viscosity=viscosity), cells=12)
    work_of(system, 0.2)  # what is made once
    few, many = (np.array(work_of(system, t_end)) for t_end in (0.2, 3.0))
    switches, *work = many / few
    assert switches > 5.0
    assert max(work) < 1.5 * switches
