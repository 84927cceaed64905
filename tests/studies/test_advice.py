"""advise: the run it names meets what was wanted, by an independent solver; what it refuses cannot be had."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from random_systems import FAMILIES
from systems import bouncing_chain, system_of, three_masses
from witness import solve

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.schemes.labels import parse_run
from stiffbeam.studies import advise as module
from stiffbeam.studies.advise import QUANTITIES, WANT, advised, advised_row

TWO = ["HHT(alpha=-0.1)", "BDF2"]
ONE = TWO[:1]


def asked(system, want=None, t_end=6.0, **options):
    return sb.study("advise", system, t_end=t_end, want=want, **options)


def errors_by_another_solver(case, run) -> dict[str, float]:
    """The quantities as advise defines them, against matrix exponentials between switches."""
    truth = solve(case)
    u = truth.tip(run.t)
    found = {"tip": float(np.sqrt(np.mean((run.tip - u) ** 2)) / np.max(np.abs(u))), "impacts": 0.0, "peak_force": 0.0}
    for i, contact in enumerate(case.contacts):
        episodes = truth.episodes(i)
        count = sum(e.begin > 0.0 for e in episodes)
        found["impacts"] = max(found["impacts"], abs(run.contacts[i].impacts.count - count) / max(count, 1))
        peak = contact.kappa * max((e.depth for e in episodes), default=0.0)
        own = run.contacts[i].peak_force
        found["peak_force"] = max(found["peak_force"], abs(own / peak - 1.0) if peak else float(own != 0.0))
    return found


def judged(family, number) -> tuple[bool, str]:
    """Return whether the advice on one random system holds, and what it was."""
    case = family(np.random.default_rng([14, number]))
    system = system_of(case)
    records = asked(system, t_end=case.t_end)
    case = replace(case, t_end=records.table.t_end.max())
    if advised_row(records.table) is not None:
        errors = errors_by_another_solver(case, advised(records))
        return all(errors[name] <= 1.001 * WANT[name] for name in WANT), f"{records.answer.verdict} {errors}"
    # What no run has reached is not reached by another solver's count of the finest one either.
    finest = max(records.table[records.table.kind == "run"].itertuples(), key=lambda p: p.steps)
    run = sb.integrate(system, parse_run(finest.scheme)[0], finest.dt, case.t_end, finest.contact)
    misses = errors_by_another_solver(case, run)
    return any(misses[name] > 0.5 * WANT[name] for name in WANT), records.answer.verdict


@pytest.mark.parametrize(
    "systems", [pytest.param(4, marks=pytest.mark.slow), pytest.param(20, marks=pytest.mark.campaign)]
)
def test_systems_it_has_not_seen(systems):
    """At least nine in ten meet their tolerances by an independent solver."""
    families = [FAMILIES[name] for name in ("plain", "damped", "several contacts", "moving stop", "long time")]
    found = [judged(families[k % len(families)], k) for k in range(systems)]
    for good, words in found:
        print(good, words)
    assert sum(good for good, _ in found) >= 0.9 * systems


def test_the_advised_run_meets_the_want_and_its_double_step_does_not():
    """Errors and numbers of the advice are those of the run; cheaper means fewer solves."""
    system, want = bouncing_chain(), {"tip": 1e-2, "impacts": 0.2}
    records = asked(system, want, schemes=TWO)
    table, row = records.table, advised_row(records.table)
    run, exact = advised(records), sb.reference(system, 6.0)
    error = np.sqrt(np.mean((run.tip - exact.at(run.t)[0]) ** 2)) / np.max(np.abs(exact.at(run.t)[0]))
    assert error == pytest.approx(row.error_tip, rel=1e-9)
    assert error <= 1e-2
    meets = (table.error_tip <= 1e-2) & (table.error_impacts <= 0.2)
    for p in table[meets & (table.work < row.work)].itertuples():  # each is followed by one that does not meet it
        same = (table.scheme == p.scheme) & (table.contact == p.contact)
        finer = meets[same & (table.steps > p.steps) & (table.steps <= 2 * p.steps)]
        assert not len(finer) or not finer.all(), p
    assert {f"error_{x}" for x in QUANTITIES} <= set(table)
    assert f"{row.scheme}, dt = {row.dt:.6g}" in records.answer.verdict
    assert records.figure().axes[0].lines


def test_a_step_that_is_right_by_chance_is_not_advised(monkeypatch):
    """Errors that swing: right at 64 and 128 steps, not between, and from 512 on at all."""

    def swinging(run, exact):
        steps = len(run.t) - 1
        good = steps >= 512 or steps in (64, 128)
        return dict.fromkeys(QUANTITIES, 0.01 if good else 0.2)

    monkeypatch.setattr(module, "errors_of", swinging)
    found = asked(bouncing_chain(), {"impacts": 0.05}, schemes=ONE).table
    assert advised_row(found).steps >= 512
    assert found.steps.between(65, 127).any()


def test_where_no_run_reaches_the_errors_the_nearest_is_named(monkeypatch):
    monkeypatch.setattr(module, "MOST_STEPS", 512)
    records = asked(bouncing_chain(), {"tip": 1e-15, "peak_force": 0.1}, 4.0, schemes=ONE)
    runs = records.table[records.table.kind == "run"]
    assert f"nearest: {runs.scheme[runs.error_tip.idxmin()]}" in records.answer.verdict
    assert f"tip {runs.error_tip.min():.2g} (wanted 1e-15)" in records.answer.verdict
    with pytest.raises(InputError, match="advise a run"):
        advised(records)


def test_past_the_horizon_the_advice_is_for_the_time_to_it(table10):
    records = asked(sb.semidiscretise(table10, 8), {"impacts": 0.3}, 1.0, schemes=ONE)
    facts = records.table.iloc[0]
    assert facts.horizon <= facts.t_end < 1.0
    assert f"to the horizon t = {facts.t_end:.4g}" in records.answer.notes
    assert advised_row(records.table).error_impacts <= 0.3


def test_bad_wants_are_refused():
    system = bouncing_chain()
    for options, words in (
        ({"want": {"speed": 1.0}}, "want"),
        ({"want": {}}, "at least one"),
        ({"want": {"tip": 0.0}}, "want.tip"),
        ({"t_end": None}, "t_end"),
        ({"schemes": ["cvode"]}, "be schemes"),
        ({"contacts": ["elastic"]}, "contacts"),
        ({"contacts": []}, "at least one"),
    ):
        with pytest.raises(InputError, match=words):
            asked(system, **options)
    with pytest.raises(InputError, match="with contacts"):
        asked(three_masses(), {"impacts": 0.1})


def test_a_search_ends_with_its_time_and_says_what_it_knows(table10):
    """1 s of CPU for a chaotic motion of 100 time units: the exact motion ends earlier, and so does the search."""
    begun = time.process_time()
    records = asked(sb.semidiscretise(table10, 8), {"impacts": 0.2}, 100.0, schemes=["Trapezoidal()"], seconds=1.0)
    assert time.process_time() - begun < 6.0
    end, row = records.table.t_end.max(), advised_row(records.table)
    assert end < 100.0
    assert f"to t = {end:.3g} of 100" in records.answer.notes or "to the horizon" in records.answer.notes
    assert row is None or row.error_impacts <= 0.2
