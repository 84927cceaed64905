"""Input that nobody means: a result, or a refusal on one line with rule, value and remedy; nothing else, and soon."""

from __future__ import annotations

import time
import warnings

import numpy as np
import pytest
import scipy.sparse
from campaign import campaign
from commands import invoke
from fuzz import LONGEST, WHOLE, case_file, one_case
from fuzz_surfaces import CONSTRUCTORS, beam, exact, mass, run
from wild_values import Unfriendly

import stiffbeam as sb
from stiffbeam.basics.text import printable, shown
from stiffbeam.schemes.labels import parse_run

HUGE = 10**400
STOPS = sb.Stops(-0.1, 0.1, stiffness=1e4)

REFUSED = {
    "an integer beyond float": lambda: sb.Harmonic(HUGE, 1.0),
    "an integer of 5000 digits": lambda: sb.Constant(10**5000),
    "a stop at an integer beyond float": lambda: sb.Stops(upper=HUGE, stiffness=1.0),
    "a scheme's parameter beyond float": lambda: sb.HHT(HUGE),
    "a label of a thousand signs": lambda: parse_run("HHT(alpha=" + "-" * 1000 + "1)"),
    "a label of 180 signs in a list": lambda: parse_run("HHT(alpha=" + "[" * 180 + ")"),
    "loads that are a number": lambda: sb.System.from_matrices([[1.0]], [[1.0]], loads=3.0, observe=[1.0]),
    "a beam's loads that are a function": lambda: sb.BeamProblem(stiffness=1.0, loads=np.sin),
    "members that are a system": lambda: sb.integrate_ensemble(mass(), sb.HHT(), 1e-3, 0.1, mass()),
    "a profile without argument": lambda: sb.BeamProblem(stiffness=1.0, initial_velocity=lambda: 0.0),
    "a profile that fails": lambda: sb.BeamProblem(stiffness=1.0, initial_velocity=lambda x: 1 / 0),
    "a frequency whose square overflows": lambda: sb.varied_members(beam(), {"frequency": [1e300]}),
    "a step longer than all there is": lambda: sb.integrate(beam(), sb.HHT(), 1e300, 1e300),
    "more steps than there are floats": lambda: sb.integrate(beam(), sb.HHT(), 1e-300, 1.0),
    "outputs at 1e15 steps": lambda: sb.integrate(beam(), sb.HHT(), 1e-15, 1.0),
    "ten thousand cells": lambda: sb.semidiscretise(sb.BeamProblem(stiffness=1.0), 10_000),
    "a sparse matrix of 1e6 unknowns": lambda: sb.System.from_matrices(scipy.sparse.eye_array(10**6), np.eye(3)),
    "atol of 1e-300": lambda: sb.reference(mass(), 0.5, "cvode", atol=1e-300),
    "a complex matrix": lambda: sb.System.from_matrices(np.eye(2) + 0j, np.eye(2), observe=[1.0, 0.0]),
    "a complex row": lambda: sb.Contact([1j], STOPS),
    "complex initial data": lambda: sb.System.from_matrices([[1.0]], [[1.0]], observe=[1.0], initial_velocity=[1j]),
    "a complex load": lambda: mass(load=lambda t: 1j * t) and sb.reference(mass(load=lambda t: 1j * t), 0.5, "cvode"),
    "1e18 members": lambda: sb.perturbed_members(beam(), 10**18),
    "a contact that is not there": lambda: exact().at([0.01], contact=5),
    "a contact from behind": lambda: exact().impacts_sampled(1e-3, contact=-1),
    "impacts sampled 1e15 times": lambda: exact().impacts_sampled(1e-17),
    "places that are text": lambda: run().displacement("tip"),
    "a name without a name": lambda: sb.study(["modes"]),
    "a method that is an array": lambda: sb.reference(mass(), 0.5, np.zeros(2)),
    "an object without text": lambda: sb.Harmonic(Unfriendly(), 1.0),
    "ten million dt at once": lambda: sb.amplification(sb.HHT(), np.linspace(0.1, 1.0, 10**7)),
    "a table of half a number": lambda: sb.paper_case(2.5),
    "a file that is a number": lambda: sb.load(3.0),
}  # fmt: skip


@pytest.mark.fast(3)
@pytest.mark.parametrize("what", REFUSED)
def test_what_broke_once_is_refused(what):
    with pytest.raises(sb.InputError) as refused:
        REFUSED[what]()
    _whole(refused.value)


def _whole(refused: sb.InputError):
    """Field, rule, value and remedy, on one line."""
    message = str(refused)
    assert all((refused.field, refused.rule, refused.remedy))
    assert WHOLE.fullmatch(message), message
    assert len(message) <= LONGEST
    assert message.isprintable()


def test_every_refusal_of_a_walk_over_constructors_and_case_files_says_rule_value_and_remedy(monkeypatch):
    for module in ("fuzz", "fuzz_surfaces"):
        monkeypatch.setattr(f"{module}.marched", lambda system, dt=1e-3: [])
    rng, refusals = np.random.default_rng(17), 0
    for wild in 40 * [*(surface.try_one for surface in CONSTRUCTORS), case_file, case_file]:
        try:
            with warnings.catch_warnings(action="ignore"):
                wild(rng)
        except sb.InputError as refused:
            _whole(refused)
            refusals += 1
        except sb.Diverged:
            pass
    assert refusals > 500


def test_a_message_shows_the_value_and_not_only_its_shape_and_cuts_what_is_long():
    with pytest.raises(sb.InputError, match=r"got array\(\[0\., 1\., 0\.\]\)"):
        sb.System.from_matrices(np.eye(2), np.eye(2), observe=[0.0, 1.0, 0.0])
    for value in ("x" * 20_000, list(range(10**5)), "\x1b[31m\n", {"a": "b" * 999}, "\ud800", HUGE, Unfriendly()):
        message = str(sb.InputError("field", value, "be good", "try again"))
        assert len(message) <= 300
        assert message.isprintable()
        assert shown(value).isprintable()
    assert printable("a\x1bb\nc") == "a\\x1bb c"
    failure = sb.SolverFailure("cvode", 0.1, "because\n\x1b", "shorten t_end")
    assert str(failure) == "cvode stopped at t = 0.1: because \\x1b; shorten t_end"


def test_what_work_may_cost_is_set_from_outside(monkeypatch):
    many = {"members": 2000}
    sb.perturbed_members(beam(), **many)
    monkeypatch.setenv("STIFFBEAM_MEMORY", "1e-4")
    with pytest.raises(sb.InputError, match=r"no more than 0.0001 GiB of memory \(it would take some 0.00.*MEMORY"):
        sb.perturbed_members(beam(), **many)
    monkeypatch.setenv("STIFFBEAM_MEMORY", "lots")
    with pytest.raises(sb.InputError, match="STIFFBEAM_MEMORY must be a number > 0, got 'lots': unset it"):
        sb.perturbed_members(beam(), **many)


@pytest.mark.parametrize(("method", "t_end"), [("exact", 1e7), ("cvode-adams", 1e4), ("multiprecision", 1e4)])
def test_a_reference_ends_where_its_seconds_do(method, t_end):
    options = {"digits": 40} if method == "multiprecision" else {}
    sb.reference(mass(), 0.1, method, **options)  # which loads what it needs
    begun = time.process_time()
    found = sb.reference(mass(), t_end, method, seconds=0.5, **options)
    assert 0.0 < found.t[-1] < t_end
    assert f"of {t_end:.3g}: its budget of 0.5 s of CPU, horizon included, ends there" in found.provenance["budget"]
    assert found.horizon <= found.t[-1] == found.provenance["t_end"]
    assert time.process_time() - begun < 2.0


@pytest.mark.parametrize(
    "words",
    [
        ["converge", "table10", "--halvings", "60"], ["ensemble", "table10", "--members", "1000000000000"],
        ["compare", "table10", "--dt", "1e-300"], ["compare", "table10", "--t-end", "1e300"],
        ["sweep", "table10", "--parameter", "frequency", "--values", "8:14:100000000000"],
        ["reference", "table10", "--digits", "9" * 40], ["reference", "table10", "--t-end", "nan"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_a_command_that_asks_too_much_ends_at_once(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = invoke(words)
    if done.exception is None:  # a study whose points were all refused
        assert "left out" in done.output or "it would take" in done.output
    else:
        assert isinstance(done.exception, sb.InputError), done.exception
        assert len(str(done.exception)) <= LONGEST


def test_a_case_file_is_bounded():
    with pytest.raises(sb.InputError, match="50 dots in a key"):
        one_case("a." * 30_000 + "b = 1")
    with pytest.raises(sb.InputError, match="have at most 1048576 bytes"):
        one_case("# comment\n" * 200_000)
    with pytest.raises(sb.InputError, match="be valid TOML"):
        one_case("a = " + "[" * 5000 + "]" * 5000)


@pytest.mark.parametrize(
    "every", [pytest.param(50, marks=pytest.mark.slow), pytest.param(10, marks=pytest.mark.campaign)]
)
def test_wild_inputs_end_in_a_result_or_a_refusal(every):
    """Of the ten thousand of ``python tests/campaigns/campaign.py inputs --seed 1 --count 10000``."""
    assert campaign("inputs", list(range(0, 10_000, every)), 1, jobs=1, limit=60.0)[1] == []
