"""The same call gives the same bits: in a fresh process, in any order, on any threads, with shared set-up."""

from __future__ import annotations

import gc
import hashlib
import os
import subprocess
import sys
import weakref
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.basics.arrays import Recent, content
from stiffbeam.march import integrate
from stiffbeam.model import equations
from stiffbeam.model import modes as modes_module
from stiffbeam.model.time_functions import Superposition

CALLS = ("bdf2", "hht", "dense", "exact", "perturbed", "ledger")
DT, T_END = 1e-3, 0.3
CASE = replace(sb.paper_case(10), cells=8)


def digest(*arrays) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(x).tobytes() for x in arrays)).hexdigest()


def call(name: str, end: float = 2.0) -> str:
    """The bits of one call, past the horizon, where one bit changes every impact; which came before must not matter."""
    system = sb.paper_case(10).system()
    if name == "exact":
        run = sb.reference(system, 0.3, "exact")
    elif name == "dense":
        run = sb.integrate(replace(system, damping=np.diag(np.arange(25.0))), sb.SDIRK(), 1e-4, 0.02)
    elif name == "perturbed":
        many = sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, end, sb.perturbed_members(system, 5), every=100)
        return digest(many.tip, many.impacts.times, many.impulse)
    else:
        run = sb.integrate(system, sb.BDF2() if name == "bdf2" else sb.HHT(-0.1), 1e-4, end)
        if name == "ledger":
            return digest(run.energy.loss, *run.states)
    return digest(run.tip, run.tip_velocity, run.impacts.times, run.impacts.peaks, run.contact_force)


@pytest.mark.slow
@pytest.mark.parametrize("threads", ["1", "2"])
def test_in_a_fresh_process_and_in_another_order(threads, tmp_path):
    first, names = {name: call(name) for name in CALLS}, CALLS[::-1]
    code = f"from test_bits import call; print(*[call(name) for name in {names!r}])"
    settings = os.environ | {"PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path])}
    settings |= dict.fromkeys(("STIFFBEAM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), threads)
    settings |= {"STIFFBEAM_CACHE_DIR": str(tmp_path)} if threads == "2" else {}  # with nothing compiled yet
    found = subprocess.run([sys.executable, "-c", code], env=settings, capture_output=True, text=True, check=True)
    assert dict(zip(names, found.stdout.split(), strict=True)) == first


@pytest.mark.slow
def test_after_ensembles_of_other_sizes(monkeypatch):
    """A member has the same bits in any company; and what was called before an ensemble, after it.

    As it was met: 335 impacts to t = 2, and 324 after an ensemble, when NumPy ran what was short.
    """
    first, system, tips = {name: call(name) for name in CALLS}, sb.paper_case(10).system(), []
    for members, threads in ((1, "1"), (7, "2"), (70, "1"), (70, "3")):
        monkeypatch.setenv("STIFFBEAM_THREADS", threads)
        many = sb.integrate_ensemble(system, sb.SDIRK(), 1e-4, 1.0, sb.perturbed_members(system, members), every=50)
        few = sb.perturbed_members(system, min(members, 9))
        tips.append((many.tip[0].tobytes(), sb.reference_ensemble(system, 0.2, few, [0.0, 0.1, 0.2]).tip[0].tobytes()))
    assert len(set(tips)) == 1
    assert {name: call(name) for name in CALLS} == first


# ------------------------------------------------------------------ what equal systems share


def alone(monkeypatch, *arguments, **options):
    """The run with nothing shared."""
    with monkeypatch.context() as patch:
        patch.setattr(integrate, "_RECENT", Recent(1))
        patch.setattr(modes_module, "_RECENT", Recent(1))
        return sb.integrate(*arguments, **options)


def bits(run):
    contact = run.contacts[0]
    arrays = (run.tip, run.tip_velocity, contact.force, contact.impacts.times, contact.impacts.peaks)
    return *(x.tobytes() for x in arrays), contact.impulse, run.energy.energy.tobytes()


@pytest.mark.parametrize("scheme", [sb.HHT(alpha=-0.1), sb.BDF2(), sb.SDIRK(nystrom=True)], ids=str)
def test_runs_one_after_the_other_have_the_bits_of_runs_alone(scheme, monkeypatch):
    """Problems that differ from one to the next in one number, each of them twice."""
    stops = sb.Stops(-0.1, 0.1, stiffness=1e4)
    first = sb.BeamProblem(stiffness=300.0, stops=stops, base=sb.Harmonic(0.2, 10.0))
    load = sb.PointLoad(0.5, sb.Harmonic(3.0, 7.0))
    changes = [
        {}, {"stiffness": np.nextafter(300.0, 301.0)}, {"viscosity": 0.01}, {"stops": replace(stops, stiffness=2e4)},
        {"stops": replace(stops, damping=0.5)}, {"stops": replace(stops, motion=sb.Harmonic(0.01, 10.0))},
        {"base": sb.Harmonic(0.2, 10.0, 0.1)}, {"loads": (load,)},
        {"loads": (replace(load, time=sb.Harmonic(3.0, 7.5)),)}, {"initial_velocity": lambda x: 0.1 * x},
    ]  # fmt: skip
    results = []
    for change in changes:
        for _ in range(2):
            system = sb.semidiscretise(replace(first, **change), 8)
            run = sb.integrate(system, scheme, DT, T_END)
            assert bits(run) == bits(alone(monkeypatch, system, scheme, DT, T_END))
            results.append(run.tip.tobytes())
    assert all((a == b) == (i % 2 == 0) for i, (a, b) in enumerate(pairwise(results)))


def test_scheme_step_length_and_contact_are_told_apart(monkeypatch):
    """A scheme whose number is changed in place is another scheme."""
    system, changed, results = CASE.system(), sb.HHT(alpha=-0.1), set()
    options = [
        (sb.HHT(alpha=-0.1), DT, "implicit"), (sb.HHT(alpha=np.nextafter(-0.1, 0.0)), DT, "implicit"),
        (sb.HHT(alpha=-0.1), DT / 2, "implicit"), (sb.HHT(alpha=-0.1), DT, "extrapolated"),
        (sb.HHT(alpha=-0.1).printed(), DT, "implicit"), (changed, DT, "implicit"),
    ]  # fmt: skip
    changed.beta = 0.4
    for scheme, dt, contact in options:
        run = sb.integrate(system, scheme, dt, T_END / 3, contact)
        assert bits(run) == bits(alone(monkeypatch, system, scheme, dt, T_END / 3, contact))
        results.add(run.tip[: 1 + round(T_END / 3 / DT)].tobytes())
    assert len(results) == len(options)


def test_functions_without_a_formula_are_equal_to_themselves_only():
    forces = [lambda t: np.sin(t), lambda t: np.cos(t), Superposition(sb.Sampled([0.0, 1.0], [0.0, 2.0]))]
    runs = [sb.integrate(one_mass(4.0, load=f), sb.Trapezoidal(), DT, T_END).tip.tobytes() for f in 2 * forces]
    assert len(set(runs)) == 3
    assert runs[:3] == runs[3:]


def test_digests_read_every_bit_and_recent_results_are_few():
    x = np.zeros((2, 3))
    different = [x, x.reshape(3, 2), np.where(np.arange(6).reshape(2, 3) == 5, -0.0, x), None]
    assert len({content(array) for array in different}) == 4
    assert content(x) == content(x.copy())
    recent, calls = Recent[int](2), []
    found = [recent.get(key, lambda key=key: calls.append(key) or key) for key in (1, 2, 1, 3, 1, 2)]
    assert (found, calls) == ([1, 2, 1, 3, 1, 2], [1, 2, 3, 2])
    system = sb.semidiscretise(CASE.problem, 300)  # large systems are not kept
    sb.integrate(system, sb.HHT(alpha=-0.1), 1e-4, 1e-3)
    gone = weakref.ref(system)
    del system
    gc.collect()
    assert gone() is None


def test_schemes_that_flow_exactly_share_the_exponential_of_a_step(monkeypatch):
    """The same matrices and the same step: it takes most of a short run with coupling dashpots."""
    calls, whole = [], equations.responses
    monkeypatch.setattr(equations, "responses", lambda *given: calls.append(given[2]) or whole(*given))
    C, K = np.array([[0.3, -0.1], [-0.1, 0.9]]), np.array([[20.0, -10.0], [-10.0, 10.0]])
    stop = sb.Contact([0.0, 1.0], sb.Stops(upper=0.1, stiffness=1e3))
    make = lambda v, C=C: sb.System.from_matrices(np.eye(2), K, C, contacts=[stop], initial_velocity=[0.0, v])  # noqa: E731
    for dt in (1.25e-3, 2.5e-3):
        for v in (1.0, 2.0):
            sb.integrate(make(v), sb.ExponentialFlow(), dt, 0.1, "conserving")
            sb.integrate(make(v), sb.ExponentialFlow(), dt, 0.1)
    assert calls == [1.25e-3, 2.5e-3]
    sb.integrate(make(0.0, 2.0 * C), sb.ExponentialFlow(), dt, 0.1)
    assert calls == [1.25e-3, 2.5e-3, 2.5e-3]
