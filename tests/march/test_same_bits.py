"""The same call gives the same bits: in a fresh process, after an ensemble, in any order, on any threads."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.model.semidiscretisation import semidiscretise

CALLS = ("bdf2", "hht", "dense", "exact", "perturbed", "ledger")
PAST_THE_HORIZON = 2.0  # where one bit more or less changes every impact


def bits(*arrays) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(x).tobytes() for x in arrays)).hexdigest()


def call(name: str, end: float = PAST_THE_HORIZON) -> str:
    """The bits of one call; which ones came before must not matter."""
    case = sb.paper_case(10)
    system = semidiscretise(case.problem, case.cells)
    if name == "exact":
        run = sb.reference(system, 0.3, "exact")
    elif name == "dense":
        run = sb.integrate(replace(system, damping=np.diag(np.arange(25.0))), sb.SDIRK(), 1e-4, 0.02)
    elif name == "perturbed":
        many = sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, end, sb.perturbed_members(system, 5), every=100)
        return bits(many.tip, many.impacts.times, many.impulse)
    else:
        run = sb.integrate(system, sb.BDF2() if name == "bdf2" else sb.HHT(-0.1), 1e-4, end)
        if name == "ledger":
            return bits(run.energy.loss, *run.states)
    return bits(run.tip, run.tip_velocity, run.impacts.times, run.impacts.peaks, run.contact_force)


@pytest.fixture(scope="module")
def first() -> dict[str, str]:
    return {name: call(name) for name in CALLS}


def in_a_process(names, **environment: str) -> list[str]:
    code = f"from test_same_bits import call; print(*[call(name) for name in {list(names)!r}])"
    settings = os.environ | {"PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path])} | environment
    found = subprocess.run([sys.executable, "-c", code], env=settings, capture_output=True, text=True, check=True)
    return found.stdout.split()


@pytest.mark.slow
@pytest.mark.parametrize("threads", ["1", "2"])
def test_in_a_fresh_process_and_in_another_order(first, threads):
    names = CALLS[::-1]
    found = in_a_process(names, STIFFBEAM_THREADS=threads, OPENBLAS_NUM_THREADS=threads, OMP_NUM_THREADS=threads)
    assert dict(zip(names, found, strict=True)) == first


@pytest.mark.slow
def test_with_nothing_compiled_yet(first, tmp_path):
    """A short run first, which no more chooses another engine."""
    found = in_a_process(["dense", "hht", "bdf2"], STIFFBEAM_CACHE_DIR=str(tmp_path))
    assert found == [first[name] for name in ("dense", "hht", "bdf2")]


@pytest.mark.slow
def test_after_ensembles_of_other_sizes(first, monkeypatch):
    """A member has the same bits in any company; and what was called before an ensemble, after it."""
    case = sb.paper_case(10)
    system = semidiscretise(case.problem, case.cells)
    tips = []
    for members, threads in ((1, "1"), (7, "2"), (70, "1"), (70, "3")):
        monkeypatch.setenv("STIFFBEAM_THREADS", threads)
        many = sb.integrate_ensemble(system, sb.SDIRK(), 1e-4, 1.0, sb.perturbed_members(system, members), every=50)
        tips.append(many.tip[0])
        exact = sb.reference_ensemble(
            system, 0.2, sb.perturbed_members(system, min(members, 9)), np.linspace(0.0, 0.2, 50)
        )
        tips.append(exact.tip[0])
    assert len({bits(tip) for tip in tips[::2]}) == len({bits(tip) for tip in tips[1::2]}) == 1
    assert {name: call(name) for name in CALLS} == first


def test_the_count_of_table_10_does_not_depend_on_what_ran_before():
    """As it was met: 335 impacts to t = 2, and 324 after an ensemble, when NumPy ran what was short."""
    case = sb.paper_case(10)
    system = semidiscretise(case.problem, case.cells)
    counts = {sb.integrate(system, sb.HHT(-0.1), 1e-4, 2.0).impacts.count for _ in range(2)}
    sb.integrate_ensemble(system, sb.HHT(-0.1), 1e-4, 2.0, sb.perturbed_members(system, 3))
    counts.add(sb.integrate(system, sb.HHT(-0.1), 1e-4, 2.0).impacts.count)
    assert len(counts) == 1
