"""The same call gives the same bits: in a fresh process, in any order, on any threads, after calls like it."""

from __future__ import annotations

import gc
import hashlib
import os
import subprocess
import sys
import weakref
from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.basics.arrays import Recent, content
from stiffbeam.march import integrate
from stiffbeam.schemes import UnweightedHHT

CALLS = ("bdf2", "hht", "dense", "exact", "perturbed", "ledger")


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
        return digest(many.tip, many.contacts[0].impacts.times, many.contacts[0].impulse)
    else:
        run = sb.integrate(system, sb.BDF2() if name == "bdf2" else sb.HHT(-0.1), 1e-4, end)
        if name == "ledger":
            return digest(run.energy.loss, *run.states)
    return digest(run.tip, run.tip_velocity, run.impacts.times, run.impacts.peaks, run.contact_force)


@pytest.mark.slow
def test_in_a_fresh_process_in_another_order_and_on_two_threads():
    first, names = {name: call(name) for name in CALLS}, CALLS[::-1]
    code = f"from test_bits import call; print(*[call(name) for name in {names!r}])"
    settings = os.environ | {"PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path])}
    settings |= dict.fromkeys(("STIFFBEAM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "2")
    found = subprocess.run([sys.executable, "-c", code], env=settings, capture_output=True, text=True, check=True)
    assert dict(zip(names, found.stdout.split(), strict=True)) == first


def test_a_recent_plan_is_that_of_its_system_scheme_step_and_contact(monkeypatch):
    """Each run has the bits of a run without earlier ones. A scheme whose number is changed in place is another."""
    system, changed, results = replace(sb.paper_case(10), cells=8).system(), sb.HHT(alpha=-0.1), set()
    changed.beta = 0.4
    for given, scheme, dt, contact in [
        (system, sb.HHT(alpha=-0.1), 1e-3, "implicit"), (system, sb.HHT(alpha=-0.1), 5e-4, "implicit"),
        (system, sb.HHT(alpha=np.nextafter(-0.1, 0.0)), 1e-3, "implicit"),
        (system, sb.HHT(alpha=-0.1), 1e-3, "extrapolated"), (system, UnweightedHHT(alpha=-0.1), 1e-3, "implicit"),
        (system, changed, 1e-3, "implicit"), (replace(system, v0=1.1 * system.v0), changed, 1e-3, "implicit"),
        (system, sb.BDF2(), 1e-3, "implicit"),
    ]:  # fmt: skip
        runs = [sb.integrate(given, scheme, dt, 0.1, contact) for _ in range(2)]
        with monkeypatch.context() as patch:
            patch.setattr(integrate, "_RECENT", Recent(1))
            runs.append(sb.integrate(given, scheme, dt, 0.1, contact))
        (bits,) = {digest(run.tip, run.contact_force, run.impacts.times, run.energy.energy) for run in runs}
        results.add(bits)
    assert len(results) == 8


def test_digests_read_every_bit_and_recent_results_are_few():
    x = np.zeros((2, 3))
    different = [x, x.reshape(3, 2), np.where(np.arange(6).reshape(2, 3) == 5, -0.0, x), None]
    assert len({content(array) for array in different}) == 4
    assert content(x) == content(x.copy())
    recent, calls = Recent[int](2), []
    found = [recent.get(key, lambda key=key: calls.append(key) or key) for key in (1, 2, 1, 3, 1, 2)]
    assert (found, calls) == ([1, 2, 1, 3, 1, 2], [1, 2, 3, 2])
    system = sb.semidiscretise(sb.paper_case(10).problem, 300)  # large systems are not kept
    sb.integrate(system, sb.HHT(alpha=-0.1), 1e-4, 1e-3)
    gone = weakref.ref(system)
    del system
    gc.collect()
    assert gone() is None
