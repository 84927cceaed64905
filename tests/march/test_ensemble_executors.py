"""Ensembles on other processes: the bits of one process, and no member lost with a process."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb

SMALL = replace(sb.paper_case(10), cells=8).system()
SCHEME, DT, T_END = sb.HHT(alpha=-0.1), 1e-3, 0.4


class Elsewhere(Executor):
    """Executor whose calls travel as they would to another process. It breaks after so many."""

    def __init__(self, most: int = 10**9, accepts: bool = True) -> None:
        self.calls, self.most, self.accepts = 0, most, accepts

    def submit(self, function, /, *arguments, **options):
        self.calls += 1
        if self.calls > self.most and not self.accepts:
            raise BrokenExecutor("gone")
        future = Future()
        if self.calls > self.most:
            future.set_exception(BrokenExecutor("gone"))
            return future
        function, arguments = pickle.loads(pickle.dumps((function, arguments)))
        future.set_result(pickle.loads(pickle.dumps(function(*arguments, **options))))
        return future


def bits(many) -> tuple:
    contacts = [(c.fraction, c.peak_force, c.impulse, c.impacts.times, c.impacts.peaks, c.offsets)
                for c in many.contacts]  # fmt: skip
    arrays = [many.t, many.tip, many.tip_velocity, many.diverged, *(x for c in contacts for x in c)]
    return *(np.ascontiguousarray(x).tobytes() for x in arrays), many.provenance["method"]


def with_record(rate):
    record = (SMALL.contacts[0].row, sb.Sampled([0.0, 0.2, 0.4], [0.0, rate, -rate]))
    return replace(SMALL, loads=(*SMALL.loads, record))


TRAVELLERS = {
    "initial data": sb.perturbed_members(SMALL, 9),
    "stiffness of the stops": sb.varied_members(SMALL, {"stops.stiffness": np.linspace(1e4, 5e6, 5)}),
    "matrices": sb.varied_members(SMALL, {"stiffness": [290.0, 300.0, 310.0]}),
    "records": [with_record(x) for x in (1.0, 2.0, 3.0)],
}


@pytest.mark.parametrize("scheme", [SCHEME, sb.BDF2()], ids=str)
@pytest.mark.parametrize("kind", TRAVELLERS)
def test_an_executor_finds_the_bits_of_one_process(kind, scheme):
    members, executor, done = TRAVELLERS[kind], Elsewhere(), []
    system, given = members[0] if isinstance(members, list) else SMALL, {"every": 50, "since": 0.1}
    many = sb.integrate_ensemble(system, scheme, DT, T_END, members, executor=executor, progress=done.append, **given)
    assert bits(many) == bits(sb.integrate_ensemble(system, scheme, DT, T_END, members, **given))
    assert executor.calls == len(members) == len(done)
    assert done[-1] == len(members) * round(T_END / DT)
    energy = sb.integrate(members[1], scheme, DT, T_END).energy.energy[-1]
    np.testing.assert_array_equal(many.ledger(1).energy[-1], energy)


@pytest.mark.fast(2)
@pytest.mark.parametrize("kind", TRAVELLERS)
def test_references_on_an_executor_are_those_of_one_process(kind):
    members, executor, done = TRAVELLERS[kind], Elsewhere(), []
    system, t = members[0] if isinstance(members, list) else SMALL, np.linspace(0.0, T_END, 7)
    many = sb.reference_ensemble(system, T_END, members, t, executor=executor, progress=done.append)
    assert bits(many) == bits(sb.reference_ensemble(system, T_END, members, t))
    assert executor.calls == len(members) - 1
    assert done == list(range(2, len(members) + 1))


@pytest.mark.parametrize("accepts", [True, False])
def test_what_a_broken_executor_loses_is_computed_here(accepts):
    members = TRAVELLERS["initial data"]
    with pytest.warns(RuntimeWarning, match="lost 5 of 9 members"):
        many = sb.integrate_ensemble(SMALL, SCHEME, DT, T_END, members, executor=Elsewhere(4, accepts))
    assert bits(many) == bits(sb.integrate_ensemble(SMALL, SCHEME, DT, T_END, members))


@pytest.mark.slow
def test_two_processes_find_the_bits_of_one_and_one_may_be_killed():
    members, killed = sb.perturbed_members(SMALL, 200), []
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        many = sb.integrate_ensemble(SMALL, SCHEME, DT, T_END, members, executor=pool)
        exact = sb.reference_ensemble(SMALL, T_END, members[:6], executor=pool)

        def kill(_done):
            if not killed:
                killed.append(next(iter(pool._processes)))
                os.kill(killed[0], signal.SIGKILL)

        with pytest.warns(RuntimeWarning, match="with a process"):
            rest = sb.integrate_ensemble(SMALL, SCHEME, DT / 64, T_END, members, executor=pool, progress=kill)
    assert bits(many) == bits(sb.integrate_ensemble(SMALL, SCHEME, DT, T_END, members))
    assert bits(exact) == bits(sb.reference_ensemble(SMALL, T_END, members[:6]))
    assert bits(rest) == bits(sb.integrate_ensemble(SMALL, SCHEME, DT / 64, T_END, members))


def test_what_cannot_travel_is_refused_before_anything_is_sent():
    system, executor = replace(SMALL, loads=(*SMALL.loads, (SMALL.contacts[0].row, lambda t: np.sin(t)))), Elsewhere()
    with pytest.raises(sb.InputError, match="travel to other processes"):
        sb.integrate_ensemble(system, SCHEME, DT, T_END, sb.perturbed_members(system, 3, scale=1.0), executor=executor)
    assert not executor.calls
    with pytest.raises(sb.InputError, match="be an Executor"):
        sb.reference_ensemble(SMALL, T_END, TRAVELLERS["initial data"], executor="dask")
    members = sb.varied_members(SMALL, {"stops.damping": [0.0, 1.0]})
    with pytest.raises(sb.InputError, match="extrapolated"):  # an error of a member ends the ensemble
        sb.integrate_ensemble(SMALL, SCHEME, DT, T_END, members, "extrapolated", executor=executor)
