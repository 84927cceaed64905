"""Adaptive references: short loads, restarts at events, integrals, other units."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from systems import bouncing_chain, one_mass

import stiffbeam as sb
from stiffbeam.pytest_plugin import within_reference
from stiffbeam.references import REFERENCES, solve
from stiffbeam.references.adaptive.restarts import smooth_intervals
from stiffbeam.references.registry import Request

SLOW = ("radau", "kvaerno3", "kvaerno5")
STIFFNESS = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
RADAU = pytest.param("radau", marks=pytest.mark.slow)
PHASED = [m.name for m in REFERENCES.values() if m.kind == "adaptive" and m.name not in SLOW]


def pulse(width: float):
    """Half a sine of 500 as a user writes it, and where it begins, turns and ends."""

    def load(t):
        s = (np.asarray(t) - 0.5) / width
        return np.where((s > 0.0) & (s < 1.0), 500.0 * np.sin(np.pi * s), 0.0)

    return load, (0.5, 0.5 + 0.5 * width, 0.5 + width)


def struck(load) -> sb.System:
    """Two masses at rest, the outer one struck by the load and stopped at 1e-3."""
    contacts = [sb.Contact([0.0, 1.0], sb.Stops(upper=1e-3, stiffness=1e6))]
    return sb.System.from_matrices(
        np.diag([1.0, 0.5]), STIFFNESS, 1e-4 * STIFFNESS, loads=[([0.0, 1.0], load)], contacts=contacts
    )


@pytest.mark.parametrize("method", PHASED)
@pytest.mark.parametrize(("width", "impacts", "peak"), [(2e-3, 10, 0.008955748138), (2e-4, 0, 0.001120889584)])
@pytest.mark.fast(1)
def test_a_short_load_on_a_system_at_rest_is_seen(method, width, impacts, peak):
    """Steps double at rest: without breakpoints they leap over a load of .2 ms in 1 s, and every tolerance agrees."""
    load, times = pulse(width)
    ref = sb.reference(struck(load), 1.0, method, rtol=1e-8, breakpoints=times)
    assert ref.impacts.count == impacts
    assert abs(np.max(np.abs(ref.tip)) - peak) < 1e-5 * peak
    assert ref.horizon == 1.0
    assert "seen at steps of at most 0.005" in ref.provenance["horizon_against"]
    with pytest.raises(AssertionError, match="off by"):
        within_reference((ref.t, 0.0 * ref.t), ref, tolerance=1e-3)


def test_intervals_end_at_breakpoints():
    times = (1.0 / 3.0 - 1e-6, 1.0 / 3.0 + 1e-6)
    intervals = smooth_intervals(Request(struck(np.sin), 1.0, "cvode", breakpoints=times))
    assert [p.end for p in intervals[:2]] == pytest.approx(times, abs=1e-15)


def test_breakpoints_that_make_no_sense_are_refused():
    for system, method, times in (
        (struck(pulse(2e-3)[0]), "cvode-adams", [np.inf]),
        (bouncing_chain(), "exact", [0.05]),
    ):
        with pytest.raises(sb.InputError, match="breakpoints"):
            sb.reference(system, 0.1, method, breakpoints=times)


@pytest.mark.parametrize(("method", "rtol"), [("dop853", 1e-5), ("cvode-adams", 1e-5), ("cvode", 1e-6), ("ida", 1e-6)])
def test_both_crossings_inside_one_step_are_seen(method, rtol):
    """A mass on a slow sine grazes a soft stop: DOP853 takes steps of about one, the contact lasts 0.15."""
    stop = 1.0 - 3e-3
    system = one_mass(1.0, sb.Stops(upper=stop, stiffness=1.0), v=1.0)
    exact = solve(system, 15.0, "exact", None, 0.0, None)
    ref = solve(system, 15.0, method, None, rtol, None)
    assert ref.impacts.count == exact.impacts.count == 3
    assert np.allclose(ref.impacts.times, exact.impacts.times, atol=5e-2)
    assert np.allclose(ref.impacts.peaks, exact.impacts.peaks, rtol=0.5)


ON_THE_SECOND_DEVICE = """
import jax
import stiffbeam as sb
from stiffbeam.references.adaptive import diffrax

compiled = diffrax._compiled


def printing(*arguments):
    def march(*numbers):
        found = compiled(*arguments)(*numbers)
        print(*{f"cpu:{device.id}" for array in found for device in array.devices()})
        return found

    return march


diffrax._compiled = printing
jax.config.update("jax_default_device", jax.devices()[1])
sb.reference(sb.problem("bilinear-gap").system, 0.01, "kvaerno3", rtol=1e-4)
"""


@pytest.mark.slow
def test_diffrax_stays_on_the_processor():
    """JAX takes a graphics card by default, on which Kvaerno5 needs seven times as long (Table 10, an H200)."""
    environment = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    done = subprocess.run(
        [sys.executable, "-c", ON_THE_SECOND_DEVICE], env=environment, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == {"cpu:0"}


FORKED = """
import multiprocessing
import stiffbeam as sb


def solve(method):
    try:
        return sb.reference(sb.problem("bilinear-gap").system, 0.01, method, rtol=1e-4).provenance["method"]
    except sb.InputError as error:
        return str(error)


if __name__ == "__main__":
    solve("kvaerno5")
    for kind in ("fork", "spawn"):
        with multiprocessing.get_context(kind).Pool(1) as pool:
            print(*pool.map(solve, ["exact", "kvaerno5"]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_fork_beside_jax_is_refused_and_does_not_wait_for_ever(tmp_path):
    (tmp_path / "forked.py").write_text(FORKED, encoding="utf-8")
    arguments = [sys.executable, "-W", "ignore", tmp_path / "forked.py"]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, timeout=100)
    forked, spawned = done.stdout.splitlines()
    assert forked.startswith("exact process must not be a fork")
    assert spawned == "exact kvaerno5"


class Jump:
    """A stop that is 1 further away from t = 1 on."""

    def value(self, t):
        return np.where(np.asarray(t) < 1.0, 0.0, -1.0)

    def rate(self, t):
        return 0.0 * np.asarray(t)

    acceleration = rate


def held(offset: object, **law: float) -> sb.System:
    """A mass that a load of 0.6 holds at rest, 0.1 deep in its stop; free it is at 0.6 - 0.4 cos(t - 1)."""
    stop = sb.Stops(upper=0.1, stiffness=4.0, **law)  # type: ignore[arg-type]
    return one_mass(1.0, stop, load=sb.Constant(0.6), offset=offset, q=0.2)


@pytest.mark.parametrize("method", PHASED)
@pytest.mark.parametrize("law", [{"damping": 3.0}, {"dissipation": 8.0}, {"exponent": 1.5, "dissipation": 8.0}])
def test_a_damped_stop_lets_go_where_it_starts_to_recede(method, law):
    """The force -3 of the damper, or the factor 1 - 8, jumps at the corner of the polygon, which is no root."""
    corner = sb.Sampled([0.0, 1.0, 2.0, 3.0], [0.0, 0.0, -1.0, -1.0])
    system = held(corner, **law)
    if law.get("exponent"):
        system = dataclasses.replace(system, loads=(([1.0], sb.Constant(0.2 + 4.0 * 0.1**1.5)),))
    force = system.loads[0][1].level  # type: ignore[union-attr]
    t = np.linspace(0.0, 3.0, 61)
    run = sb.reference(system, 3.0, method, t_eval=t)
    free = force - (force - 0.2) * np.cos(t - 1.0)
    assert np.max(np.abs(run.tip - corner.value(t) - np.where(t < 1.0, 0.2, free))) < 1e-7
    assert run.impacts.count == 0
    assert run.impacts.at_start.ends[0] == pytest.approx(1.0, abs=1e-12)
    assert run.contacts[0].fraction == pytest.approx(1.0 / 3.0, abs=1e-12)


@pytest.mark.parametrize("method", PHASED)
@pytest.mark.parametrize("law", [{}, {"dissipation": 1.0}])
def test_a_stop_that_jumps_lets_go_and_takes_its_energy_along(method, law):
    t = np.linspace(0.0, 3.0, 61)
    run = sb.reference(held(Jump(), **law), 3.0, method, t_eval=t, breakpoints=[1.0])
    motion = np.where(t < 1.0, 0.2, 0.6 - 0.4 * np.cos(t - 1.0))
    assert np.max(np.abs(run.tip - Jump().value(t) - motion)) < 1e-7
    assert run.impacts.count == 0
    assert run.impacts.at_start.ends[0] == pytest.approx(1.0, abs=1e-12)
    # The stop leaves with 4 0.1^2/2 = 0.02.
    assert np.max(np.abs(run.energy.input - 0.6 * (motion - 0.2) + np.where(t < 1.0, 0.0, 0.02))) < 1e-7
    assert np.max(np.abs(run.energy.loss)) < 1e-7
    assert np.max(np.abs(run.energy.stop_dissipation)) < 1e-7


def test_a_solve_for_further_times_that_is_interrupted_leaves_no_wrong_states():
    """The times of the interrupted solve counted as solved, with the states of the one before."""
    broken = []

    def push(t):
        if broken:
            raise KeyboardInterrupt
        return np.sin(1.3 * np.asarray(t))

    reference = sb.reference(one_mass(4.0, load=push), 6.0, "dop853", t_eval=[0.0, 3.0, 6.0])
    broken.append(True)
    with pytest.raises(KeyboardInterrupt):
        reference.at([1.0, 2.0, 4.0])
    broken.clear()
    tip, _ = reference.at([1.0, 2.0, 4.0])
    exact = (np.sin([1.3, 2.6, 5.2]) - 0.65 * np.sin([2.0, 4.0, 8.0])) / (4.0 - 1.3**2)
    np.testing.assert_allclose(tip, exact, atol=1e-7)


def test_several_threads_ask_one_reference_for_further_times():
    reference = sb.reference(one_mass(4.0, load=sb.Harmonic(1.0, 1.3)), 6.0, "dop853", t_eval=[0.0, 6.0])
    times = [np.linspace(0.0, 6.0, 50 + k) for k in range(8)]
    with ThreadPoolExecutor(8) as pool:
        for t, (tip, _) in zip(times, pool.map(reference.at, times), strict=True):
            exact = (np.sin(1.3 * t) - 0.65 * np.sin(2.0 * t)) / (4.0 - 1.3**2)
            np.testing.assert_allclose(tip, exact, atol=1e-7)


# ---------------------------------------------------------------- peak forces


def moved_by_a_record():
    """The stop's position at the peak is asked for then, not when the solver has gone on to another segment."""
    times = np.linspace(0.0, 3.0, 13)
    motion = sb.Sampled(times, 0.05 * np.sin(2.0 * times + 0.4), kind="cubic")
    return one_mass(4.0, sb.Stops(upper=0.1, stiffness=100.0), load=sb.Harmonic(1.0, 2.0), offset=motion, v=1.0)


def turned_by_another():
    """No rate of the force is zero: it jumps from above to below where the second stop is met."""
    near, far = sb.Stops(upper=0.05, stiffness=0.5, damping=0.5), sb.Stops(upper=0.15, stiffness=1e3, damping=80.0)
    contacts = [sb.Contact([1.0], far), sb.Contact([1.0], near)]
    return sb.System.from_matrices([[1.0]], [[1.0]], None, [([1.0], sb.Constant(4.0))], contacts)


def halting():
    """It comes towards the mass and goes back: the peak of a linear law is at the kink of its motion."""
    motion = sb.Sampled([0.0, 0.3, 0.5, 3.0], [0.0, 0.5, -0.2, 0.0])
    return one_mass(4.0, sb.Stops(upper=0.1, stiffness=100.0), offset=motion, v=1.0)


@pytest.mark.parametrize(
    ("make", "known", "rel"),
    [
        (moved_by_a_record, None, 1e-6),
        (turned_by_another, pytest.approx(0.57125, rel=1e-4), 1e-5),
        (halting, pytest.approx(26.340479244, rel=1e-9), 1e-6),
    ],
)
@pytest.mark.parametrize("method", [*PHASED, RADAU])
@pytest.mark.fast(12)
def test_peaks_are_those_of_the_exact_solution(method, make, known, rel):
    system = make()
    run, exact = (sb.reference(system, 1.5, x).contacts[-1] for x in (method, "exact"))
    assert run.peak_force == pytest.approx(exact.peak_force, rel=rel)
    assert np.allclose(run.impacts.peaks, exact.impacts.peaks, rtol=10.0 * rel, equal_nan=True)
    assert known is None or exact.peak_force == known
