"""The cache of references: the same numbers as a fresh one, never those of another problem, never half a file."""

from __future__ import annotations

import dataclasses
import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import test_store

import stiffbeam as sb
from stiffbeam.files import store
from stiffbeam.files.store import BOUND

TIMES = np.linspace(0.0, 0.06, 121)
FINITE = ("cvode-adams", "ida", pytest.param("kvaerno5", marks=pytest.mark.slow))


def assert_same(a, b):
    """Every number and string of the two, but for which was kept."""
    for one in (a, b):
        one.provenance.pop("kept", None)
    test_store.assert_same(a, b)


@pytest.fixture
def folder(own_cache):
    """The folder of the cached files, empty."""
    return own_cache / "references"


@pytest.fixture(scope="module")
def system(table10):
    return sb.semidiscretise(table10, 8)


@pytest.mark.parametrize("method", FINITE)
def test_what_comes_from_the_cache_is_what_was_computed_and_compares_alike(method, folder, system):
    fresh = sb.cached_reference(system, 0.06, method, TIMES, rtol=1e-7)
    [file] = folder.iterdir()
    before = file.stat().st_ino  # a file that is written is a new one
    cached = sb.cached_reference(system, 0.06, method, TIMES, rtol=1e-7)
    assert file.stat().st_ino == before
    assert (fresh.provenance.get("kept"), cached.provenance["kept"], cached.system) == (None, True, system)
    assert_same(cached, fresh)
    assert cached.horizon == fresh.horizon > 0.0
    np.testing.assert_array_equal(cached.at(TIMES[3:9]), fresh.at(TIMES[3:9]))
    # As the reference of a scheme, and as the run held against another reference.
    run, exact = sb.integrate(system, sb.HHT(-0.1), TIMES[1], 0.06), sb.reference(system, 0.06)
    assert sb.compare(run, cached).to_dict() == sb.compare(run, fresh).to_dict()
    assert sb.compare(cached, exact).to_dict() == sb.compare(fresh, exact).to_dict()


@pytest.mark.slow
def test_multiprecision_from_the_cache_answers_at_any_time(folder, system):
    first, again = (sb.cached_reference(system, 0.1, "multiprecision", t_eval=[0.0, 0.05, 0.1]) for _ in range(2))
    assert len(list(folder.iterdir())) == 1
    between = np.linspace(0.0, 0.1, 77)
    assert np.max(np.abs(again.at(between)[0] - first.at(between)[0])) < BOUND


@pytest.mark.slow
def test_every_parameter_has_a_file_of_its_own(folder, system, monkeypatch):
    common = {"method": "cvode-adams", "t_eval": TIMES, "rtol": 1e-6}
    stops = sb.Stops(-0.1, 0.1, stiffness=5e6 * (1 + 1e-15))
    others = [
        sb.semidiscretise(system.problem, 9), sb.semidiscretise(system.problem, 8, "velocity-curvature"),
        sb.semidiscretise(dataclasses.replace(system.problem, stops=stops), 8),
    ]  # fmt: skip
    changes = [{}, {"rtol": 1.01e-6}, {"atol": 1e-7}, {"t_eval": TIMES[:-1]}, {"method": "dop853"}, {"max_step": 0.01}]
    calls = [(system, 0.06, common | change) for change in changes] + [(x, 0.06, common) for x in others]
    for count, (each, t_end, options) in enumerate([*calls, (system, 0.061, common)], 1):
        for _ in range(2):
            sb.cached_reference(each, t_end, **options)
        assert len(list(folder.iterdir())) == count
    monkeypatch.setattr(store, "version", lambda package: "another")
    sb.cached_reference(system, 0.06, **common)
    assert len(list(folder.iterdir())) == count + 1


def test_what_has_no_key_leaves_no_file(folder, system, monkeypatch):
    from stiffbeam.references.adaptive import sundials

    assert sb.cached_reference(system, 0.05).provenance["method"] == "exact"  # solved again, as fast as it is read
    pushed = sb.BeamProblem(stiffness=300.0, loads=(sb.PointLoad(0.5, lambda t: 0 * t),))
    for arguments, options, words in (
        ((sb.semidiscretise(pushed, 8), 0.1, "cvode"), {}, "Harmonic, Constant and Sampled"),
        ((system, -1.0, "cvode"), {}, "t_end"), ((system, 0.1, "cvod"), {}, "method"),
        ((system, 0.1, "cvode"), {"rtol": -1.0}, "rtol"),
    ):  # fmt: skip
        with pytest.raises(sb.InputError, match=words):
            sb.cached_reference(*arguments, **options)
    with pytest.raises(TypeError, match="tolerance"):
        sb.cached_reference(system, 0.1, "cvode", tolerance=1e-6)
    monkeypatch.setattr(sundials, "MAX_STEPS", 20)
    with pytest.raises(sb.SolverFailure):
        sb.cached_reference(system, 0.06, "cvode", TIMES)
    assert not folder.exists()


@pytest.mark.parametrize("method", ["multiprecision", "cvode-adams"])
@pytest.mark.parametrize("damage", ["cut", "flipped bytes", "another problem's file", "empty"])
@pytest.mark.fast(1)
def test_a_damaged_file_is_named_and_remade(method, damage, folder, system):
    fresh = sb.cached_reference(system, 0.06, method, TIMES, rtol=1e-6)
    [file] = folder.iterdir()
    content = bytearray(file.read_bytes())
    if damage == "flipped bytes":
        for position in range(300, len(content), 97):
            content[position] ^= 0x10
    elif damage == "another problem's file":
        sb.cached_reference(sb.semidiscretise(system.problem, 9), 0.06, method, TIMES, rtol=1e-6)
        [other] = set(folder.iterdir()) - {file}
        content = bytearray(other.read_bytes())
        other.unlink()
    else:
        content = content[: len(content) // 2 if damage == "cut" else 0]
    file.write_bytes(content)
    with pytest.warns(UserWarning, match=f"remaking a cached reference: .*{file.name}"):
        remade = sb.cached_reference(system, 0.06, method, TIMES, rtol=1e-6)
    assert [path.name for path in folder.iterdir()] == [file.name]
    again = sb.cached_reference(system, 0.06, method, TIMES, rtol=1e-6)  # no warning: it is good
    for one in (remade, again):
        assert np.max(np.abs(one.tip - fresh.tip)) < BOUND


@pytest.mark.slow
def test_threads_that_ask_for_one_reference_leave_one_good_file(folder, system):
    with ThreadPoolExecutor(4) as pool:
        tips = list(pool.map(lambda _: sb.cached_reference(system, 0.02, "cvode-adams", TIMES[:41]).tip, range(4)))
    for tip in tips:
        np.testing.assert_array_equal(tip, tips[0])
    [file] = folder.iterdir()
    assert sb.load(file, system).horizon == 0.02


@pytest.mark.slow
def test_what_was_not_used_for_longest_goes(folder, system, monkeypatch):
    first, second, third = (np.linspace(0.0, 0.06, n) for n in (101, 102, 103))
    for times in (first, second):
        sb.cached_reference(system, 0.06, "cvode", times, rtol=1e-5)
    old = time.time() - 1000.0
    for file in folder.iterdir():
        os.utime(file, (old, old))
    assert sb.cached_reference(system, 0.06, "cvode", first, rtol=1e-5).provenance["kept"]  # used now
    monkeypatch.setattr(store, "MOST", int(2.5 * max(f.stat().st_size for f in folder.iterdir())))
    sb.cached_reference(system, 0.06, "cvode", third, rtol=1e-5)
    found = [sb.cached_reference(system, 0.06, "cvode", t, rtol=1e-5).provenance.get("kept") for t in (first, third)]
    assert found == [True, True]
    assert len(list(folder.iterdir())) == 2
