"""The score: right integrators pass, planted errors are flagged with a reason, and strangers can use it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.schemes import RIGID, UnweightedHHT, registered
from stiffbeam.testing import check_scheme, check_solver
from stiffbeam.testset.problem import folder, read
from stiffbeam.testset.score import (
    CONVERGES,
    FAILED,
    LOW_ORDER,
    MISSED,
    NOT_JUDGED,
    NOT_TAKEN,
    STAYS,
    read_trajectory,
    score_trajectories,
)

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "reference" / "problems" / "README.md").read_text(encoding="utf-8")
SOME = ["free-oscillator", "bilinear-oscillator", "bilinear-gap", "mass-on-a-stop"]


def outcomes(card):
    return {entry.problem.name: entry.outcome for entry in card.entries}


def wrong(stiffness=1.0, restitution=1.0, damping=1.0, late=0.0, delay=0.0, velocity=1.0):
    """A solver with planted errors: numbers of the system off by factors, loads ``late`` steps late, and the run late
    by a share ``delay`` of its span and its velocity off by a factor."""

    def solve(system, dt, t_end):
        stops = [c.stops for c in system.contacts]
        changed = [replace(x, restitution=x.restitution * restitution) if x.rigid
                   else replace(x, stiffness=x.stiffness * stiffness) for x in stops]  # fmt: skip
        contacts = tuple(replace(c, stops=x) for c, x in zip(system.contacts, changed, strict=True))
        other = replace(system, contacts=contacts, damping=damping * system.damping)
        if late:
            shifted = lambda f: replace(f, phase=f.phase - late * f.frequency * dt)  # noqa: E731
            other = replace(other, loads=tuple((vector, shifted(f)) for vector, f in system.loads))
        run = sb.integrate(other, sb.MoreauJean(theta=0.5) if system.rigid else sb.Trapezoidal(), dt, t_end)
        u, v = (np.interp(run.t - delay * t_end, run.t, x) for x in (run.tip, run.tip_velocity))
        return run.t, u, velocity * v

    return solve


right = wrong()


@pytest.mark.parametrize("scheme", [*registered(), *(kind() for kind in RIGID.values())], ids=str)
def test_every_scheme_obeys_the_laws(scheme):
    assert set(check_scheme(scheme)["law"]) >= {"order", "energy", "zero data", "units", "stiff contact"}


@pytest.mark.parametrize("solver", ["exact", "dop853", "cvode-adams", wrong(stiffness=1.01)])
@pytest.mark.fast(1)
def test_solvers_obey_the_laws(solver):
    if callable(solver):
        with pytest.raises(AssertionError, match=r"known answers: "):
            check_solver(solver)
    else:
        assert len(check_solver(solver)) == 4


class Wrong(sb.Scheme):
    """Backward Euler, which states order 2 and an amplification that it does not have."""

    order = 2

    def step(self, equation, dt, z, loads, reactions):
        y = z + dt * equation.implicit_rate(dt, z, loads[0] + reactions[0])
        return y, [y]


class Other(Wrong):
    order = 1

    def characteristic(self, x, xi):
        return sb.Trapezoidal().characteristic(x, xi)


class Leaking(Wrong):
    """Explicit Euler: unstable on a stiff stop."""

    order, nodes = 1, (0.0,)

    def step(self, equation, dt, z, loads, reactions):
        return z + dt * equation.rate(z, loads[0] + reactions[0]), [z]


@pytest.mark.parametrize(
    ("scheme", "law"),
    [(Wrong(), "order 1"), (Other(), "amplification"), (Leaking(), "stiff contact")],
    ids=str,
)
def test_a_law_that_does_not_hold_is_named(scheme, law):
    with pytest.raises(AssertionError, match=rf"{type(scheme).__name__}.*: .*{law}.*, allowed "):
        check_scheme(scheme)


@pytest.mark.parametrize("label", ["trapezoidal", "hht", "sdirk", "bdf2", "GeneralisedAlpha(rho=0.8)"])
@pytest.mark.fast(2)
def test_a_good_scheme_is_not_flagged(label):
    card = sb.score(label, [*SOME, "kelvin-voigt", "hertz", "hunt-crossley"])
    assert set(outcomes(card).values()) == {CONVERGES}
    for entry in card.entries:
        assert entry.best["impacts"] == len(entry.problem.answers["impacts"].digits)
        assert abs(entry.order.slope - entry.expected) < 0.6 or entry.order.slope > entry.expected


@pytest.mark.parametrize(
    ("integrator", "problem", "outcome", "reason"),
    [
        (UnweightedHHT(alpha=-0.1), "bilinear-gap", LOW_ORDER, "tip"),
        (wrong(stiffness=1.01), "bilinear-gap", STAYS, "tip from"),
        (wrong(delay=1e-3), "two-mass-chain", STAYS, "tip from"),
        (wrong(velocity=1.05), "two-mass-chain", STAYS, "velocity from"),
        (wrong(velocity=1.2), "table10", STAYS, "velocity"),
        (wrong(velocity=1.2), "aster-beam", STAYS, "velocity"),
        (wrong(damping=0.0), "damped-chain", STAYS, "tip"),
        (wrong(late=1.0), "damped-chain", LOW_ORDER, "tip"),
        *((wrong(restitution=0.98), x, STAYS, "") for x in ("bouncing-ball", "preloaded-chatter", "impact-oscillator")),
        *((right, x, CONVERGES, "") for x in ("two-mass-chain", "damped-chain", "table10", "bouncing-ball",
                                              "preloaded-chatter", "impact-oscillator")),
    ],
)  # fmt: skip
def test_a_planted_error_is_found(integrator, problem, outcome, reason):
    """Outcome and reason name the same quantity. The order on smooth motion is that of the free oscillator."""
    entry = sb.score(integrator, ["free-oscillator", problem]).entries[-1]
    assert entry.outcome == outcome
    assert reason in entry.reason


def test_an_impact_at_one_time_in_nested_steps_is_no_fault():
    """Symplectic Euler's first impact is at 0.4515625 in 960, 1920, 2880 and 3840 steps, and its error is the same."""

    def euler(restitution):
        def solve(system, dt, t_end):
            u, v = [system.q0[0]], [system.v0[0]]
            for _ in range(round(t_end / dt)):
                v.append(v[-1] + dt * system.load(0.0)[0])
                u.append(u[-1] + dt * v[-1])
                if u[-1] < 0.0 > v[-1]:
                    u[-1], v[-1] = 0.0, -restitution * v[-1]
            return np.arange(len(u)) * dt, np.array(u), np.array(v)

        return solve

    right, wrong = sb.score([euler(0.5), euler(0.49)], "bouncing-ball").entries
    assert (right.outcome, wrong.outcome) == (CONVERGES, STAYS)


@pytest.mark.parametrize(
    ("change", "outcome", "reason"),
    [
        (lambda t, u, v: (t, u, np.append(v[:1], v[:-1])), LOW_ORDER, "velocity: 1."),
        (lambda t, u, v: (t, u, np.append(v[:1], 0.5 * (v[1:] + v[:-1]))), LOW_ORDER, "velocity: 1."),
        (lambda t, u, v: (t, np.where((t < t[-1]) | (len(t) <= 1000), u, np.nan), v), FAILED, "overflowed at t = 20"),
        (lambda t, u, v: (t[::-1], u[::-1], v[::-1]), NOT_TAKEN, "sort the rows by time"),
    ],
    ids=["velocity of the step before", "of half a step before", "ends in NaN where steps are short", "in reverse"],
)
def test_spoilt_arrays_are_found(change, outcome, reason):
    card = sb.score(lambda *arguments: change(*right(*arguments)), "two-mass-chain")
    (entry,) = card.entries
    assert entry.outcome == outcome
    assert reason in entry.reason
    if outcome == LOW_ORDER:  # the row has the numbers that are judged
        row = card.table().iloc[0]
        assert entry.reason == f"{row.order}, {row.expected} expected"
        assert card.to_latex().count(row.order) == 1


def test_an_error_that_no_longer_falls_is_quoted_where_it_does_not():
    """Of a tip that is cut off at the stop the coarse runs are worse, and the last ones alike."""

    def cut(system, dt, t_end):
        t, u, v = right(system, dt, t_end)
        return t, np.minimum(u, 0.999 * system.contacts[0].stops.law.g2), v

    (entry,) = sb.score(cut, "two-mass-chain").entries
    errors = [float(x) for x in re.findall(r"\d\.\de-\d+", entry.reason)]
    assert entry.outcome == STAYS
    assert entry.runs[0]["tip_error"] > 2.0 * max(errors)
    assert max(errors) <= 1.1 * min(errors)


def test_a_missing_impact_is_flagged_and_never_converges():
    """Between the second and the third impact of Table 14 are 1.6e-5, eight of the shortest steps."""
    known = sb.problem("table14")
    runs = [sb.integrate(known.system, sb.HHT(alpha=-0.1), known.t_end / n, known.t_end) for n in known.steps]
    (entry,) = score_trajectories(known, [(run.t, run.tip, run.tip_velocity) for run in runs]).entries
    assert (entry.outcome, entry.flagged) == (MISSED, True)
    assert entry.reason == "the finest run has 2 of the first 3 impacts"
    (entry,) = sb.score("HHT(alpha=-0.1)", "table14").entries  # which adds shorter steps
    assert (entry.outcome, entry.best["impacts"]) == (CONVERGES, 3)


def test_impacts_where_there_are_none():
    def spurious(system, dt, t_end):
        steps = round(t_end / dt)
        t, w = np.arange(steps + 1) * dt, np.sqrt(10.0)
        u, v = system.q0[0] * np.cos(w * t), -system.q0[0] * w * np.sin(w * t)
        asked = np.arange(steps + 1) % (steps // 60) == 0
        u[~asked & (np.abs(t - 2.03) < 0.04)] = 0.02  # the stop is at 0.01; right wherever the answers are known
        return t, u, v

    entry = sb.score(spurious, "free-oscillator").entries[0]
    assert entry.outcome == STAYS
    assert "impacts where there are none" in entry.reason


def test_a_method_whose_coarse_steps_overflow_is_judged_by_shorter_ones():
    """Of its ten steps only the shortest holds."""

    def solve(system, dt, t_end):
        t, u, v = right(system, dt, t_end)
        return t, u * (np.inf if len(t) < 1500 else 1.0), v

    card = sb.score(solve, "bilinear-gap")
    assert card.entries[0].outcome == CONVERGES
    assert [run["level"] for run in card.entries[0].runs] == [1920, 3840, 7680]


def test_runs_with_like_steps_are_not_judged():
    known = sb.problem("bilinear-gap")
    runs = [(t, np.full(n, 0.3)) for n in (481, 961, 1441) for t in [np.linspace(0.0, known.t_end, n)]]
    assert score_trajectories(known, runs).entries[0].outcome == NOT_JUDGED
    runs.append((np.linspace(0.0, known.t_end, 1921), np.full(1921, 0.3)))
    assert score_trajectories(known, runs).entries[0].outcome == STAYS


def sampled(name, steps, everything=False):
    """The exact motion of a problem at ``steps`` equal steps."""
    known = sb.problem(name)
    t = np.arange(steps + 1) * known.t_end / steps
    run = sb.reference(known.system, known.t_end, t_eval=t)
    return (t, *run.states) if everything else (t, run.tip, run.tip_velocity)


@pytest.mark.parametrize("name", ["mass-on-a-stop", "elastic-bar", "hammer-pulse", "bilinear-gap"])
@pytest.mark.parametrize("steps", [60, 100, 240])
@pytest.mark.fast(4)
def test_exact_motions_at_halved_steps(name, steps):
    """Halved steps share the one next to the peak of the force: its error there does not fall."""
    (entry,) = score_trajectories(name, [sampled(name, k * steps) for k in (1, 2, 4)]).entries
    assert (entry.outcome, entry.reason) == (CONVERGES, "")


def test_a_stop_that_moves():
    """With all unknowns its impacts are counted and its peak is known, with the tip alone neither is."""
    name = "stop-along-the-beam"
    whole = score_trajectories(name, [sampled(name, steps, everything=True) for steps in (3840, 7680, 15360)])
    entry = whole.entries[0]
    assert entry.outcome == CONVERGES
    assert entry.best["impacts"] == len(sb.problem(name).answers["impacts"].value)
    assert entry.best["impact_time_error"] < 1e-4
    assert abs(entry.best["peak_force_error"]) < 1e-3
    tip = score_trajectories(name, [sampled(name, steps) for steps in (3840, 7680, 15360)]).entries[0]
    assert tip.best["impacts"] == -1


def test_what_is_not_taken_and_what_fails_is_said():
    def broken(system, dt, t_end):
        if system.size == 2:
            raise ZeroDivisionError("no second mass")
        return right(system, dt, t_end)

    card = sb.score([broken, "exact"], ["bilinear-gap", "two-mass-chain"])
    assert card.entries[1].outcome == FAILED
    refused = sb.score(["trapezoidal", "exact"], ["hertz"])
    assert [e.outcome for e in refused.entries] == [CONVERGES, NOT_TAKEN]
    text = f"{card} {refused}"
    assert "ZeroDivisionError: no second mass" in text
    assert re.search(r"exact on hertz: not taken, stops.exponent must be 1", text)
    assert [e.outcome for e in card.flagged] == [FAILED]


def test_a_file_with_an_unknown_field_is_refused():
    text = (folder() / "hertz.toml").read_text(encoding="utf-8")
    with pytest.raises(sb.InputError, match=r"hertz: system.contacts\[0\].exponant must be a known field.*exponent"):
        _ = read(text.replace("exponent = 1.5", "exponant = 1.5")).system


def test_adaptive_solvers_stay_within_their_tolerance_and_a_loose_one_is_found(monkeypatch):
    from stiffbeam import integrators

    assert outcomes(sb.score("dop853", SOME)) == dict.fromkeys(SOME, CONVERGES)
    honest = integrators.solve
    monkeypatch.setattr(integrators, "solve", lambda s, T, m, t, rtol, atol: honest(s, T, m, t, 3e-2, None))
    assert outcomes(sb.score("dop853", "bilinear-gap")) == {"bilinear-gap": STAYS}


@pytest.mark.slow
def test_a_scorecard_is_saved_drawn_and_written_as_json(tmp_path):
    card = sb.score(["trapezoidal", right], ["bilinear-gap", "bouncing-ball"])
    names = {file.name for file in card.save(tmp_path)}
    assert names == {"score.txt", "score.csv", "score.json", "bilinear-gap.png", "bouncing-ball.png"}
    again = json.loads((tmp_path / "score.json").read_text(encoding="utf-8"))
    assert again == json.loads(json.dumps(card.to_dict()))
    assert len(card.to_dataframe()) == sum(len(e.runs) for e in card.entries)
    (axis,) = card.figure("bilinear-gap").axes
    assert axis.get_xlabel()
    assert axis.get_ylabel()


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (["t,u", "0,1", "0.5,x"], "line 3"),
        (["0 1", "1 2", "2 3"], "at least 4"),
        (["0 0 0", "1 0 0", "2 0 0", "3 0 0"], "reach t_end"),
        (["0 0 0", "1 nan 0", "2 0 0", "5 0 0"], "finite"),
    ],
)
def test_a_trajectory_that_cannot_be_scored_is_refused(lines, says, tmp_path, command):
    (file := tmp_path / "run.csv").write_text("\n".join(lines), encoding="utf-8")
    code, _, error = command("score", "--trajectory", str(file), "--problem", "impact-transient")
    assert code == 2
    assert re.search(says, error)


def test_a_trajectory_file_is_scored(tmp_path, command):
    t, u, v = right(sb.problem("bilinear-gap").system, 0.001, 5.0)
    np.savetxt(tmp_path / "run.csv", np.column_stack([t, u, v]), delimiter=",", header="t,u,v", comments="")
    code, out, _ = command("score", "--trajectory", "run.csv", "--problem", "bilinear-gap", "--json", "-")
    assert code == 0
    (entry,) = json.loads(out)["entries"]
    assert entry["outcome"] == NOT_JUDGED
    run = entry["runs"][0]
    assert run["impacts"] == 3
    assert 1e-6 < run["tip_error"] < 1e-3
    assert abs(run["energy_error"]) < 1e-3
    code, out, error = command("score", "--trajectory", "run.csv")
    assert code == 2
    assert "--problem must name one problem" in error


@pytest.mark.parametrize(
    ("header", "found"),
    [("v,time,u", [1, 2, 0]), ("t;tip", [0, 1]), ("", [0, 1, 2]), ("# t v u", [0, 2, 1]), ("# my run", [0, 1, 2]),
     ("u,v", None), ("t,x,v", None)],
)  # fmt: skip
def test_columns_are_known_by_their_names(header, found, tmp_path):
    rows = [",".join(f"{10 * k + i}" for i in range(len(found or header.split(",")))) for k in range(5)]
    (file := tmp_path / "run.csv").write_text("\n".join([header, *rows]), encoding="utf-8")
    if found is None:
        with pytest.raises(sb.InputError, match="name t, u and perhaps v"):
            read_trajectory(file)
    else:
        assert [int(column[0]) for column in read_trajectory(file)] == found


@pytest.mark.slow
def test_the_page_runs_as_written(tmp_path):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    done = subprocess.run([sys.executable, "-W", "error", "-c", block], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "4 converges" in done.stdout
    for name in sb.problems():
        assert f"## {name}\n" in PAGE
        assert (ROOT / "reference" / "problems" / f"{name}.png").is_file()
