"""Runs share what equal systems have in common: bits are those of a run that computes everything itself."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.basics.arrays import Recent, content
from stiffbeam.march import block_march
from stiffbeam.model import equations
from stiffbeam.model import modes as modes_module
from stiffbeam.model.time_functions import Superposition

DT, T_END = 1e-3, 0.3
CASE = replace(sb.paper_case(10), cells=8)


def alone(monkeypatch, *arguments, **options):
    """The run with nothing shared."""
    with monkeypatch.context() as patch:
        patch.setattr(block_march, "_RECENT", Recent(1))
        patch.setattr(modes_module, "_RECENT", Recent(1))
        return sb.integrate(*arguments, **options)


def bits(run):
    contact = run.contacts[0]
    arrays = (run.tip, run.tip_velocity, contact.force, contact.impacts.times, contact.impacts.peaks)
    return *(x.tobytes() for x in arrays), contact.impulse, run.energy.energy.tobytes()


def changed_problems():
    """Problems that differ from one to the next in one number, each of them twice."""
    base, stops = sb.Harmonic(0.2, 10.0), sb.Stops(-0.1, 0.1, stiffness=1e4)
    first = sb.BeamProblem(stiffness=300.0, stops=stops, base=base)
    load = sb.PointLoad(0.5, sb.Harmonic(3.0, 7.0))
    changed = [
        first,
        replace(first, stiffness=np.nextafter(300.0, 301.0)),
        replace(first, viscosity=0.01),
        replace(first, stops=replace(stops, stiffness=2e4)),
        replace(first, stops=replace(stops, damping=0.5)),
        replace(first, stops=replace(stops, motion=sb.Harmonic(0.01, 10.0))),
        replace(first, base=replace(base, phase=0.1)),
        replace(first, loads=(load,)),
        replace(first, loads=(replace(load, time=sb.Harmonic(3.0, 7.5)),)),
        replace(first, initial_velocity=lambda x: 0.1 * x),
    ]
    return [problem for problem in changed for _ in range(2)]


@pytest.mark.parametrize("scheme", [sb.HHT(alpha=-0.1), sb.BDF2(), sb.SDIRK(nystrom=True)], ids=str)
def test_runs_one_after_the_other_have_the_bits_of_runs_alone(scheme, monkeypatch):
    results = []
    for problem in changed_problems():
        run = sb.integrate(sb.semidiscretise(problem, 8), scheme, DT, T_END)
        apart = alone(monkeypatch, sb.semidiscretise(problem, 8), scheme, DT, T_END)
        assert bits(run) == bits(apart)
        results.append(run.tip.tobytes())
    assert all((a == b) == (i % 2 == 0) for i, (a, b) in enumerate(pairwise(results)))


def test_scheme_step_length_and_contact_are_told_apart(monkeypatch):
    system = CASE.system()
    options = [
        (sb.HHT(alpha=-0.1), DT, "implicit"),
        (sb.HHT(alpha=np.nextafter(-0.1, 0.0)), DT, "implicit"),
        (sb.HHT(alpha=-0.1), DT / 2, "implicit"),
        (sb.HHT(alpha=-0.1), DT, "extrapolated"),
        (sb.HHT(alpha=-0.1).printed(), DT, "implicit"),
    ]
    results = set()
    for scheme, dt, contact in options:
        run = sb.integrate(system, scheme, dt, T_END / 3, contact)
        assert bits(run) == bits(alone(monkeypatch, system, scheme, dt, T_END / 3, contact))
        results.add(run.tip[: 1 + round(T_END / 3 / DT)].tobytes())
    assert len(results) == len(options)


def test_a_scheme_whose_number_is_changed_is_another_scheme(monkeypatch):
    system, scheme = CASE.system(), sb.HHT(alpha=-0.1)
    before = sb.integrate(system, scheme, DT, T_END)
    scheme.beta = 0.4
    after = sb.integrate(system, scheme, DT, T_END)
    assert not np.array_equal(before.tip, after.tip)
    assert bits(after) == bits(alone(monkeypatch, system, scheme, DT, T_END))


def test_functions_without_a_formula_are_equal_to_themselves_only():
    def system(force):
        return sb.System.from_matrices([[1.0]], [[4.0]], loads=[([1.0], force)], observe=[1.0])

    forces = [lambda t: np.sin(t), lambda t: np.cos(t), Superposition(sb.Sampled([0.0, 1.0], [0.0, 2.0]))]
    runs = [sb.integrate(system(force), sb.Trapezoidal(), DT, T_END) for force in (*forces, *forces)]
    assert len({run.tip.tobytes() for run in runs}) == 3
    for i in range(3):
        assert runs[i].tip.tobytes() == runs[i + 3].tip.tobytes()


def test_digests_read_shape_and_every_bit():
    x = np.zeros((2, 3))
    different = [x, x.reshape(3, 2), np.where(np.arange(6).reshape(2, 3) == 5, -0.0, x), None]
    assert len({content(array) for array in different}) == 4
    assert content(x) == content(x.copy())
    changed = content(x)
    x[0, 0] = 1.0
    assert content(x) != changed


def test_recent_keeps_the_last_and_drops_the_others():
    recent, calls = Recent[int](2), []

    def result(key):
        return recent.get(key, lambda: calls.append(key) or key)

    assert [result(key) for key in (1, 2, 1, 3, 1, 2)] == [1, 2, 1, 3, 1, 2]
    assert calls == [1, 2, 3, 2]


def test_large_systems_are_not_kept():
    system = sb.semidiscretise(CASE.problem, 300)
    sb.integrate(system, sb.HHT(alpha=-0.1), 1e-4, 1e-3)
    gone = weakref.ref(system)
    del system
    gc.collect()
    assert gone() is None


def test_schemes_that_flow_exactly_share_the_exponential_of_a_step(monkeypatch):
    """The same matrices and the same step: it takes most of a short run with coupling dashpots."""
    calls, whole = [], equations.responses
    monkeypatch.setattr(equations, "responses", lambda *given: calls.append(given[2]) or whole(*given))
    C = np.array([[0.3, -0.1], [-0.1, 0.9]])
    stop = sb.Contact([0.0, 1.0], sb.Stops(upper=0.1, stiffness=1e3))
    K = np.array([[20.0, -10.0], [-10.0, 10.0]])
    made = [sb.System.from_matrices(np.eye(2), K, C, contacts=[stop], initial_velocity=[0.0, v]) for v in (1.0, 2.0)]
    for dt in (1.25e-3, 2.5e-3):
        for system in made:
            sb.integrate(system, sb.ExponentialFlow(), dt, 0.1, "conserving")
            sb.integrate(system, sb.ExponentialFlow(), dt, 0.1)
    assert calls == [1.25e-3, 2.5e-3]
    sb.integrate(sb.System.from_matrices(np.eye(2), K, 2.0 * C, contacts=[stop]), sb.ExponentialFlow(), dt, 0.1)
    assert calls == [1.25e-3, 2.5e-3, 2.5e-3]
