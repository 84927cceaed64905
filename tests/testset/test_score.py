"""The score: right integrators pass, planted errors are flagged with a reason, and strangers can use it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from processes import passed

import stiffbeam as sb
from stiffbeam.schemes import RIGID, registered
from stiffbeam.testing import check_scheme, check_solver
from stiffbeam.testset.measure import read_trajectory
from stiffbeam.testset.problem import folder, read
from stiffbeam.testset.score import (
    CONVERGES,
    FAILED,
    LOW_ORDER,
    MISSED,
    NOT_JUDGED,
    NOT_TAKEN,
    STAYS,
    score_trajectories,
)

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "reference" / "problems" / "README.md").read_text(encoding="utf-8")
SOME = ["free-oscillator", "bilinear-oscillator", "bilinear-gap", "mass-on-a-stop"]


def outcomes(card):
    return {entry.problem.name: entry.outcome for entry in card.entries}


def newmark(system, dt, t_end, kappa=1.0, late=False, pull=False):
    """The trapezoidal rule for one mass, with an error on request: the stop's stiffness times kappa, its force of the
    step before, or a damper that may pull."""
    m, k, c = system.mass[0, 0], system.stiffness[0, 0], system.contacts[0].stops
    stiff, damp, g = kappa * c.stiffness, c.damping, c.upper_bound
    steps = round(t_end / dt)
    u, v = np.empty(steps + 1), np.empty(steps + 1)
    u[0], v[0] = system.q0[0], system.v0[0]

    def touches(x, w):
        return x > g and (pull or stiff * (x - g) + damp * w > 0.0)

    def force(x, w):
        return stiff * (x - g) + damp * w if touches(x, w) else 0.0

    a = (-k * u[0] - force(u[0], v[0])) / m
    for n in range(steps):
        for pressed in (False,) if late else (False, True):  # does the step end on the stop?
            K, C, F = (k + stiff, damp, stiff * g) if pressed else (k, 0.0, 0.0)
            F -= force(u[n], v[n]) if late else 0.0
            x, w = u[n] + dt * v[n] + 0.25 * dt**2 * a, v[n] + 0.5 * dt * a
            new = (F - K * x - C * w) / (m + 0.5 * dt * C + 0.25 * dt**2 * K)
            x, w = x + 0.25 * dt**2 * new, w + 0.5 * dt * new
            if touches(x, w) == pressed:
                break
        u[n + 1], v[n + 1], a = x, w, new
    return np.arange(steps + 1) * dt, u, v


@pytest.mark.parametrize("scheme", [*registered(), *(kind() for kind in RIGID.values())], ids=str)
def test_every_scheme_obeys_the_laws(scheme):
    assert set(check_scheme(scheme)["law"]) >= {"order", "energy", "zero data", "units", "stiff contact"}


@pytest.mark.parametrize("solver", ["exact", "dop853", "cvode-adams", newmark])
@pytest.mark.fast(1)
def test_solvers_obey_the_laws(solver):
    if solver is newmark:
        with pytest.raises(AssertionError, match=r"known answers: two-mass-chain: "):
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
    [(Wrong(), "order off the stated one by 1.0"), (Other(), "amplification"), (Leaking(), "stiff stop")],
    ids=str,
)
def test_a_law_that_does_not_hold_is_named(scheme, law):
    with pytest.raises(AssertionError, match=rf"{type(scheme).__name__}.*: .*{law}.* \(at most "):
        check_scheme(scheme)


@pytest.mark.parametrize("label", ["trapezoidal", "hht", "sdirk", "bdf2", "GeneralisedAlpha(rho=0.8)"])
@pytest.mark.fast(2)
def test_a_good_scheme_is_not_flagged(label):
    card = sb.score(label, [*SOME, "kelvin-voigt", "hertz", "hunt-crossley"])
    assert set(outcomes(card).values()) == {CONVERGES}
    for entry in card.entries:
        assert entry.best["impacts"] == len(entry.problem.answers["impacts"].digits)
        assert abs(entry.order.slope - entry.expected) < 0.6 or entry.order.slope > entry.expected


def off(**error):
    """``newmark`` with an error."""
    return lambda system, dt, t_end: newmark(system, dt, t_end, **error)


@pytest.mark.parametrize(
    ("integrator", "problems", "found"),
    [
        (sb.HHT(alpha=-0.1).printed(), SOME[:3], [CONVERGES, LOW_ORDER, LOW_ORDER]),
        (off(late=True), SOME[:3], [CONVERGES, LOW_ORDER, LOW_ORDER]),
        (off(kappa=1.01), SOME[:3], [CONVERGES, STAYS, STAYS]),
        (off(), ["kelvin-voigt"], [CONVERGES]),
        (off(pull=True), ["kelvin-voigt"], [STAYS]),
    ],
    ids=["misprinted", "contact a step late", "wrong stiffness", "damper", "damper that pulls"],
)
def test_a_planted_error_is_found(integrator, problems, found):
    assert list(outcomes(sb.score(integrator, problems)).values()) == found


def moreau_jean(data, steps, t_end, e=None):
    """Moreau and Jean's scheme, theta = 1/2, for one mass and a rigid stop, from a problem's file: t, u, v."""
    (m,), (k,), contact, h = data["mass"][0], data["stiffness"][0], data["contacts"][0], t_end / steps
    side, stop = (1.0, contact["upper"]) if "upper" in contact else (-1.0, contact["lower"])
    e = contact["restitution"] if e is None else e
    sine = lambda t, w: w["amplitude"] * np.sin(w["frequency"] * t + w["phase"])  # noqa: E731
    wave = [lambda t, w=w: w["constant"] if "constant" in w else sine(t, w) for w in data.get("loads", ())]
    t, u, v = np.arange(steps + 1) * h, np.empty(steps + 1), np.empty(steps + 1)
    u[0], v[0] = data["initial_displacement"][0], data["initial_velocity"][0]
    W = m + (0.5 * h) ** 2 * k
    for n in range(steps):
        f = sum(0.5 * (w(t[n]) + w(t[n + 1])) for w in wave)
        new = v[n] + h * (f - k * (u[n] + 0.5 * h * v[n])) / W
        if side * (u[n] + 0.5 * h * v[n] - stop) >= 0.0:
            new -= side * max(0.0, side * (new + e * v[n]))
        v[n + 1], u[n + 1] = new, u[n] + 0.5 * h * (v[n] + new)
    return t, u, v


@pytest.mark.parametrize("name", ["bouncing-ball", "preloaded-chatter", "impact-oscillator"])
def test_rigid_stops_by_a_strangers_moreau_jean(name):
    """Right with the restitution of the file, found out with another."""
    data = tomllib.loads((folder() / f"{name}.toml").read_text(encoding="utf-8"))
    steps, e = sb.problem(name).steps, data["system"]["contacts"][0]["restitution"]
    runs = [[moreau_jean(data["system"], n, data["t_end"], e) for n in steps] for e in (None, 0.98 * e)]
    right, wrong = (score_trajectories(name, r).entries[0] for r in runs)
    assert (right.outcome, wrong.outcome) == (CONVERGES, STAYS)
    assert right.order.slope == pytest.approx(1.0, abs=0.4)
    if name == "impact-oscillator":
        assert right.best["impacts"] == 3
        assert right.best["impact_time_error"] < 2.0 * data["t_end"] / steps[-1]


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
    ("kind", "outcome", "reason"),
    [("", CONVERGES, ""), ("late by a thousandth", STAYS, "tip from"),
     ("velocity 5 % too large", STAYS, "velocity from"),
     ("velocity of the step before", LOW_ORDER, "velocity: 1."),
     ("velocity of half a step before", LOW_ORDER, "velocity: 1."),
     ("ends in NaN where steps are short", FAILED, "overflowed at t = 20"),
     ("in reverse", NOT_TAKEN, "sort the rows by time")],
)  # fmt: skip
def test_an_error_that_stays_is_found_however_small_beside_those_of_coarse_steps(kind, outcome, reason):
    """Outcome and reason name the same quantity."""
    (entry,) = sb.score(spoilt(kind), "two-mass-chain").entries
    assert entry.outcome == outcome
    assert reason in entry.reason


@pytest.mark.parametrize(
    ("kind", "outcome"),
    [("", CONVERGES), ("damping left out", STAYS),
     ("dashpots apart", STAYS), ("load of the step before", LOW_ORDER)],
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
        t, u, v = newmark(system, dt, t_end)
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
        return newmark(system, dt, t_end)

    card = sb.score([broken, "exact"], ["bilinear-gap", "two-mass-chain"])
    assert card.entry("broken", "two-mass-chain").outcome == FAILED
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
    card = sb.score(["trapezoidal", newmark], ["bilinear-gap", "bouncing-ball"])
    names = {file.name for file in card.save(tmp_path)}
    assert names == {"score.txt", "score.csv", "score.json", "bilinear-gap.png", "bouncing-ball.png"}
    again = json.loads((tmp_path / "score.json").read_text(encoding="utf-8"))
    assert again == json.loads(json.dumps(card.to_dict()))
    assert len(card.to_dataframe()) == sum(len(e.runs) for e in card.entries)
    axes = card.figure("bilinear-gap").axes
    assert len(axes) == 3
    assert all(axis.get_xlabel() and axis.get_ylabel() for axis in axes)


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (["t,u", "0,1", "0.5,x"], "line 3"),
        (["0 1", "1 2 3"], "line 2: 3 columns"),
        (["0,1,2", "1,,3"], "a cell is empty"),
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
    t, u, v = newmark(sb.problem("bilinear-gap").system, 0.001, 5.0)
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
    for header in ("u,v", "t,x,v"):
        row = ",".join("123"[: len(header.split(","))])
        file.write_text("\n".join([header, *[row] * 5]), encoding="utf-8")
        with pytest.raises(sb.InputError, match="name t, u and perhaps v"):
            read_trajectory(file)
    file.write_text("\n".join(["t,u", *["1,2,3"] * 5]), encoding="utf-8")
    with pytest.raises(sb.InputError, match="name every column"):
        read_trajectory(file)


@pytest.mark.slow
def test_the_page_runs_as_written(tmp_path):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    done = subprocess.run([sys.executable, "-W", "error", "-c", block], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "5 converges" in done.stdout
    for name in sb.problems():
        assert f"## {name}\n" in PAGE
        assert (ROOT / "reference" / "problems" / f"{name}.png").is_file()


@pytest.mark.slow
def test_the_plugin_asks_every_problem(tmp_path):
    text = (
        "import numpy as np\n"
        "def test_mine(known_problem):\n"
        "    tip = known_problem.answers['tip'].value\n"
        "    assert tip.shape == known_problem.times.shape\n"
    )
    assert f"{len(sb.problems())} passed" in passed(tmp_path, text)
