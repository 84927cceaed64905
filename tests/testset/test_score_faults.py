"""Planted faults that the score finds: in the restitution, besides the displacement, in a file's columns."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from test_score import PAGE, moreau_jean, newmark
from test_score_exact_motions import ball

import stiffbeam as sb
from stiffbeam.testset.measure import CONVERGES, FAILED, LOW_ORDER, NOT_FALLING, ONE_RUN, TOO_ALIKE, read_trajectory
from stiffbeam.testset.problem import folder
from stiffbeam.testset.score import score_trajectories
from stiffbeam.testset.scorecard import Scorecard, reasons


@pytest.mark.parametrize("name", ["bouncing-ball", "impact-oscillator"])
def test_a_restitution_two_per_cent_too_small_is_found(name):
    data = tomllib.loads((folder() / f"{name}.toml").read_text(encoding="utf-8"))
    e = 0.98 * data["system"]["contacts"][0]["restitution"]
    runs = [moreau_jean(data["system"], n, data["t_end"], e) for n in sb.problem(name).steps]
    assert score_trajectories(name, runs).entries[0].outcome == NOT_FALLING


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
    assert (right.outcome, wrong.outcome) == (CONVERGES, NOT_FALLING)
    assert len(right.runs) > len(wrong.runs)


def planted(kind, t, u, v):
    """A run that is right in u at the sample times, and wrong otherwise."""
    if kind == "velocity doubled":
        return t, u, 2.0 * v
    if kind == "velocity reversed":
        return t, u, -v
    if kind == "right at the samples only":
        at = np.isclose(t[:, None], sb.problem("bilinear-gap").times).any(axis=1)
        return t, np.where(at, u, 0.3 * u)
    return t, u, v


def test_an_impact_that_the_steps_do_not_resolve_is_named():
    """Between the second and the third impact of Table 14 are 1.6e-5, eight of the shortest steps."""
    known = sb.problem("table14")
    runs = [sb.integrate(known.system, sb.HHT(alpha=-0.1), known.t_end / n, known.t_end) for n in known.steps]
    for used, told in ((runs, True), (runs[:3], False)):
        card = score_trajectories(known, [(run.t, run.tip) for run in used])
        assert card.entries[0].outcome == CONVERGES
        assert ("trajectory on table14: the finest run has 2 of the first 3 impacts" in str(card)) == told


@pytest.mark.parametrize(
    ("kind", "missed"),
    [("", ()), ("velocity doubled", ("velocity",)), ("velocity reversed", ("velocity",)),
     ("right at the samples only", ("impact times",))],
)  # fmt: skip
def test_what_is_wrong_besides_the_displacement_is_found(kind, missed):
    known = sb.problem("bilinear-gap")
    runs = [planted(kind, *newmark(known.system, known.t_end / n, known.t_end)) for n in (480, 960, 1920)]
    runs = [(t, *(x[:, 0] if x.ndim == 2 else x for x in rest)) for t, *rest in runs]
    (entry,) = score_trajectories("bilinear-gap", runs).entries
    assert entry.missed == missed
    assert entry.outcome == (NOT_FALLING if missed else CONVERGES)
    assert "≤ 2" in str(score_trajectories("bilinear-gap", runs))
    assert ("3 time steps may mislead" in str(score_trajectories("bilinear-gap", runs))) == (
        missed == ("impact times",)
    )
    same = score_trajectories("bilinear-gap", [runs[-1]] * 3).entries[0]
    assert same.outcome == ONE_RUN
    fewer = [tuple(np.delete(x, 7) for x in run) for run in runs]
    (uneven,) = score_trajectories("bilinear-gap", fewer).entries
    assert (uneven.best.impacts, uneven.outcome) == (entry.best.impacts, entry.outcome)
    told = score_trajectories("bouncing-ball", [ball(steps) for steps in (60, 120, 240)])
    assert str(told).count("they are not counted") == 1
    both = Scorecard((told.entries[0], replace(told.entries[0], problem=sb.problem("hertz"))))
    (counted,) = (line for line in reasons(both) if "not counted" in line)
    assert counted.startswith("trajectory on bouncing-ball, hertz: positions only")
    with pytest.raises(sb.InputError, match="another unit"):
        score_trajectories("bilinear-gap", [(1e3 * runs[0][0], *runs[0][1:])])


def test_columns_are_known_by_their_names(tmp_path):
    file = tmp_path / "run.csv"
    names = [
        ("v,time,u", [1, 2, 0]),
        ("t;tip", [0, 1]),
        ("", [0, 1, 2]),
        ("# t v u", [0, 2, 1]),
        ("# my run", [0, 1, 2]),
    ]
    for header, found in names:
        width = len(found)
        rows = [",".join(f"{10 * k + column}" for column in range(width)) for k in range(5)]
        file.write_text("\n".join([header, *rows]), encoding="utf-8")
        assert [int(column[0]) for column in read_trajectory(file)] == found
    for header in ("u,v,w", "t,x,v", "t,u,u"):
        file.write_text("\n".join([header, *["1,2,3"] * 5]), encoding="utf-8")
        with pytest.raises(sb.InputError, match="name t, u and perhaps v"):
            read_trajectory(file)
    for separator in ";\t ":  # not t = 1, u = 0, v = 5
        file.write_text("\n".join(f"{k}{separator}0,5" for k in range(5)), encoding="utf-8")
        assert [column[1] for column in read_trajectory(file)] == [1.0, 0.5]
    file.write_text("\n".join(["t,u", *["1,2,3"] * 5]), encoding="utf-8")
    with pytest.raises(sb.InputError, match="name every column"):
        read_trajectory(file)


def spoilt(kind):
    """The trapezoidal rule with an error that stays, small beside those of its coarse steps, or that breaks it."""

    def solve(system, dt, t_end):
        run = sb.integrate(system, sb.Trapezoidal(), dt, t_end)
        t, u, v = run.t, run.tip.copy(), run.tip_velocity.copy()
        if kind == "late by a thousandth":
            u, v = (np.interp(t - 1e-3 * t_end, t, x) for x in (u, v))
        if kind == "velocity 5 % too large":
            v *= 1.05
        for x in {"velocity": [v], "motion": [u, v]}[kind.split()[0]] if kind.endswith("before") else []:
            x[1:] = x[:-1] if "half" not in kind else 0.5 * (x[1:] + x[:-1])
        if kind == "ends in NaN where steps are short" and len(t) > 1000:
            u[-1] = np.nan
        return (t, u, v) if kind != "in reverse" else (t[::-1], u[::-1], v[::-1])

    return solve


@pytest.mark.parametrize(
    ("kind", "outcome", "says"),
    [("", CONVERGES, ""), ("late by a thousandth", NOT_FALLING, "does not fall"),
     ("velocity 5 % too large", NOT_FALLING, "not velocity"),
     ("velocity of the step before", LOW_ORDER, "the velocity is that of 1.00 steps before its time"),
     ("velocity of half a step before", LOW_ORDER, "the velocity is that of 0.50 steps before its time"),
     ("motion of the step before", LOW_ORDER, "chain: the motion is that of 1.00 steps before its time"),
     ("motion of half a step before", CONVERGES, "the motion is that of 0.50 steps before its time"),
     ("ends in NaN where steps are short", FAILED, "overflowed at t = 20"),
     ("in reverse", FAILED, "sort the rows by time")],
)  # fmt: skip
def test_an_error_that_stays_is_found_however_small_beside_those_of_coarse_steps(kind, outcome, says):
    card = sb.score(spoilt(kind), "two-mass-chain")
    assert card.entries[0].outcome == outcome
    assert says in str(card)


def test_an_error_that_is_the_same_at_every_step_is_said_to_be():
    """As of an adaptive solver whose tolerance does not depend on the step."""
    card = sb.score(lambda system, dt, t_end: sb.integrate(system, sb.Trapezoidal(), t_end / 2000, t_end), "hertz")
    assert card.entries[0].outcome == NOT_FALLING
    assert str(card).endswith("a fixed tolerance, or another system?")


@pytest.mark.parametrize(
    ("kind", "outcome"),
    [("", CONVERGES), ("damping left out", NOT_FALLING),
     ("dashpots apart", NOT_FALLING), ("load of the step before", LOW_ORDER)],
)  # fmt: skip
def test_wrong_damping_and_a_late_load_are_found(kind, outcome):
    """By the one problem with a damping matrix and a smooth drive."""

    def solve(system, dt, t_end):
        C, loads = system.damping, system.loads
        wrong = {"damping left out": 0.0 * C, "dashpots apart": np.diag(np.diag(C))}
        if kind.startswith("load"):
            loads = tuple((vector, replace(f, phase=f.phase - f.frequency * dt)) for vector, f in loads)
        return sb.integrate(replace(system, damping=wrong.get(kind, C), loads=loads), sb.Trapezoidal(), dt, t_end)

    assert sb.score(solve, ["free-oscillator", "damped-chain"]).entries[1].outcome == outcome


@pytest.mark.parametrize(("rate", "outcome"), [("c.offset.rate(t)", CONVERGES), ("0.0", NOT_FALLING)])
def test_a_dashpot_that_ignores_the_motion_of_its_stop_is_found(rate, outcome):
    """The page's integrator, with and without it."""
    (block,) = re.findall(r"```python\n(.*?)\n\nproblems = ", PAGE, re.DOTALL)
    names = {}
    exec(block.replace("c.offset.rate(t)", rate), names)
    (entry,) = sb.score(names["central_differences"], "moving-dashpot").entries
    assert entry.outcome == outcome
    assert entry.best.impacts == 2


def test_a_run_that_grows_beyond_its_square_is_left_out():
    """Its errors overflow, without a warning; the finer ones are judged."""

    def solve(system, dt, t_end):
        t, u, v = (x.copy() for x in planted("", *newmark(system, dt, t_end)))
        return (t, u * (1e200 if len(t) < 100 else 1.0), v)

    card = sb.score(solve, "bilinear-gap")
    assert card.entries[0].outcome == CONVERGES
    assert "in 60 steps it overflowed at t = " in str(card)


def test_a_method_whose_coarse_steps_overflow_is_judged_by_shorter_ones():
    """Of its ten steps only the shortest holds."""

    def solve(system, dt, t_end):
        t, u, v = newmark(system, dt, t_end)
        return t, u * (np.inf if len(t) < 1500 else 1.0), v

    card = sb.score(solve, "bilinear-gap")
    assert card.entries[0].outcome == CONVERGES
    assert [run.level for run in card.entries[0].runs] == [1920, 3840, 7680]
    assert "in 60 to 1440 steps it overflowed at t = " in str(card)
    assert "judged by 1920 to 7680 steps" in str(card)


def test_no_scheme_is_late_as_a_whole():
    """The errors of right schemes are no shift in time."""
    card = sb.score(["BDF2", "HHT(alpha=-0.3)", "moreau-jean"], ["free-oscillator", "bilinear-gap", "bouncing-ball"])
    assert "before its time" not in str(card)


def test_runs_with_like_steps_are_not_judged():
    known = sb.problem("bilinear-gap")
    runs = [(t, np.full(n, 0.3)) for n in (481, 961, 1441) for t in [np.linspace(0.0, known.t_end, n)]]
    assert score_trajectories(known, runs).entries[0].outcome == TOO_ALIKE
    runs.append((np.linspace(0.0, known.t_end, 1921), np.full(1921, 0.3)))
    assert score_trajectories(known, runs).entries[0].outcome == NOT_FALLING


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bilinear-gap", "mass-on-a-stop", "two-mass-chain", "hammer-pulse"])
def test_the_verdict_does_not_hang_on_the_steps(name):
    """Ten random families of steps: impacts lie elsewhere within them, the schemes are right all the same."""
    known, rng = sb.problem(name), np.random.default_rng(7)
    for _ in range(10):
        near = np.array(known.steps) * rng.uniform(0.7, 1.4, len(known.steps))
        steps = np.unique(known.samples * np.maximum(1, np.round(near / known.samples)).astype(int))
        for scheme in (sb.Trapezoidal(), sb.SDIRK(), sb.BDF2()):
            made = (sb.integrate(known.system, scheme, known.t_end / n, known.t_end) for n in steps)
            (entry,) = score_trajectories(known, [(run.t, *run.states) for run in made]).entries
            assert entry.outcome == CONVERGES
