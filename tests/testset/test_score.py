"""The score: what is right passes, a planted error is found, what is not taken is said, and strangers can use it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from processes import passed

import stiffbeam as sb
from stiffbeam.testset.measure import CONVERGES, FAILED, LOW_ORDER, NOT_FALLING, NOT_TAKEN, ONE_RUN
from stiffbeam.testset.problem import folder, read
from stiffbeam.testset.score import score_trajectories

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


@pytest.mark.parametrize("label", ["trapezoidal", "hht", "sdirk", "bdf2", "GeneralisedAlpha(rho=0.8)"])
@pytest.mark.fast(2)
def test_a_good_scheme_is_not_flagged(label):
    card = sb.score(label, [*SOME, "kelvin-voigt", "hertz", "hunt-crossley"])
    assert set(outcomes(card).values()) == {CONVERGES}
    for entry in card.entries:
        assert entry.best.impacts == len(entry.problem.answers["impacts"].digits)
        assert abs(entry.order.slope - entry.expected) < 0.6 or entry.order.slope > entry.expected


def test_a_written_out_trapezoidal_rule_scores_as_ours():
    """The same scheme through the other door: the same errors to rounding."""
    ours, theirs = (sb.score(x, SOME) for x in (sb.Trapezoidal(), newmark))
    for a, b in zip(ours.entries, theirs.entries, strict=True):
        errors = np.array([[run.errors.tip_rms for run in e.runs] for e in (a, b)])
        assert np.allclose(errors[0], errors[1], rtol=1e-6, atol=1e-11)
        assert a.best.impacts == b.best.impacts
        assert a.best.peak_force == pytest.approx(b.best.peak_force, abs=1e-9, nan_ok=True)


def test_a_misprinted_scheme_is_found():
    card = sb.score(sb.HHT(alpha=-0.1).printed(), SOME[:3])
    assert outcomes(card) == {SOME[0]: CONVERGES, SOME[1]: LOW_ORDER, SOME[2]: LOW_ORDER}
    assert 0.9 < card.entry("HHT(alpha=-0.1).printed(unweighted)", "bilinear-gap").order.slope < 1.2


def test_a_contact_one_step_late_is_found():
    card = sb.score(lambda system, dt, t_end: newmark(system, dt, t_end, late=True), SOME[:3])
    assert outcomes(card) == {SOME[0]: CONVERGES, SOME[1]: LOW_ORDER, SOME[2]: LOW_ORDER}


def test_a_wrong_stiffness_is_found():
    card = sb.score(lambda system, dt, t_end: newmark(system, dt, t_end, kappa=1.01), SOME[:3])
    assert outcomes(card) == {SOME[0]: CONVERGES, SOME[1]: NOT_FALLING, SOME[2]: NOT_FALLING}


@pytest.mark.parametrize(("factor", "word"), [(1000.0, "units"), (-1.0, "signs")])
def test_wrong_units_are_told_by_their_factor(factor, word):
    """Millimetres for metres: the error stands where it is, and the ratio says why."""

    def wrong(system, dt, t_end):
        t, u, v = newmark(system, dt, t_end)
        return t, factor * u, factor * v

    card = sb.score(wrong, SOME[1])
    assert outcomes(card) == {SOME[1]: NOT_FALLING}
    assert card.entries[0].best.factor == pytest.approx(factor, rel=1e-3)
    assert re.search(rf"times a constant factor of {factor:g}\d*: {word}\?", " ".join(str(card).split()))
    assert not np.isfinite(sb.score(newmark, SOME[1]).entries[0].best.factor)


def test_a_function_is_scored_by_its_modules_name(tmp_path, monkeypatch, command):
    lines = ["import numpy as np", "def rest(system, dt, t_end):",
             "    t = np.arange(round(t_end / dt) + 1) * dt", "    return t, 0.0 * t"]  # fmt: skip
    (tmp_path / "of_a_stranger.py").write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    code, out, _ = command("score", "of_a_stranger:rest", "--problem", "bilinear-gap", "--json", "-")
    assert (code, json.loads(out)["entries"][0]["integrator"]) == (1, "of_a_stranger:rest")
    code, _, error = command("study", "energy", "table10", "--schemes", "of_a_stranger:rest")
    assert code == 2
    assert "schemes must be schemes" in error


def test_a_damper_that_pulls_is_found():
    name = "kelvin-voigt"
    right, wrong = (
        sb.score(lambda system, dt, t_end, pull=pull: newmark(system, dt, t_end, pull=pull), name).entries[0]
        for pull in (False, True)
    )
    assert (right.outcome, wrong.outcome) == (CONVERGES, NOT_FALLING)


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


RIGID = ["bouncing-ball", "preloaded-chatter", "impact-oscillator"]


@pytest.mark.parametrize("name", RIGID)
def test_rigid_stops_by_a_strangers_moreau_jean(name):
    """Right with the restitution of the file, found out with another."""
    data = tomllib.loads((folder() / f"{name}.toml").read_text(encoding="utf-8"))
    steps = sb.problem(name).steps
    runs = [[moreau_jean(data["system"], n, data["t_end"], e) for n in steps] for e in (None, 0.6)]
    right, wrong = (score_trajectories(name, r).entries[0] for r in runs)
    assert (right.outcome, wrong.outcome) == (CONVERGES, NOT_FALLING)
    assert right.order.slope == pytest.approx(1.0, abs=0.4)
    if name == "impact-oscillator":
        assert right.best.impacts == 3
        assert right.best.impact_time < 2.0 * data["t_end"] / steps[-1]


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
    assert re.search(r"not taken by exact: hertz: stops.exponent must be 1", text)
    assert [e.outcome for e in card.flagged] == [FAILED]


def test_steps_at_which_a_run_overflows_are_left_out():
    def forward(system, dt, t_end):
        t = np.arange(round(t_end / dt) + 1) * dt
        u, v = system.q0[0], system.v0[0]
        path = []
        for _ in t:
            path.append((u, v))
            u, v = u + dt * v, v - dt * 1e9 * dt**4 * u**3 - dt * 10.0 * u  # blows up at long steps
        return t, *np.array(path).T

    (entry,) = sb.score(forward, "free-oscillator").entries
    assert 0 < len(entry.runs) < len(entry.problem.steps)
    assert re.search(r"in \d+ steps it overflowed at t = ", entry.reason)
    never = sb.score(lambda system, dt, t_end: (np.arange(9) * t_end / 8, np.full(9, np.nan)), "free-oscillator")
    assert never.entries[0].outcome == FAILED


def test_a_file_with_an_unknown_field_is_refused():
    text = (folder() / "hertz.toml").read_text(encoding="utf-8")
    with pytest.raises(sb.InputError, match=r"hertz: system.contacts\[0\].exponant must be a known field.*exponent"):
        _ = read(text.replace("exponent = 1.5", "exponant = 1.5")).system


def test_adaptive_solvers_stay_within_their_tolerance_and_a_loose_one_is_found(monkeypatch):
    from stiffbeam.testset import integrators

    assert outcomes(sb.score("dop853", SOME)) == dict.fromkeys(SOME, CONVERGES)
    honest = integrators.solve
    monkeypatch.setattr(integrators, "solve", lambda s, T, m, t, rtol, atol: honest(s, T, m, t, 3e-2, None))
    assert outcomes(sb.score("dop853", "bilinear-gap")) == {"bilinear-gap": NOT_FALLING}


@pytest.mark.slow
def test_past_the_horizon_the_trapezoidal_rule_is_among_the_exact_motions_and_bdf2_is_not():
    good, bad = (sb.score(x, "table10").entries[0].past for x in ("trapezoidal", "bdf2"))
    assert all(abs(good[-1][what]) < 4.0 for what in ("impacts", "contact_fraction", "median_peak"))
    assert bad[0]["contact_fraction"] > 50.0


@pytest.mark.slow
def test_a_scorecard_is_saved_drawn_and_written_as_json(tmp_path):
    card = sb.score(["trapezoidal", newmark], ["bilinear-gap", "bouncing-ball"])
    files = card.save(tmp_path)
    assert {file.name for file in files} >= {"index.html", "score.json", "bilinear-gap.png"}
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "bilinear-gap.png" in page
    assert card.problems[0].catches.split(":")[0] in page
    again = json.loads((tmp_path / "score.json").read_text(encoding="utf-8"))
    assert again == json.loads(json.dumps(card.to_dict()))
    rows = card.to_dataframe()
    assert len(rows) == sum(len(e.runs) for e in card.entries)
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
    assert entry["outcome"] == ONE_RUN
    run = entry["runs"][0]
    assert run["impacts"] == 3
    assert 1e-6 < run["tip_rms"] < 1e-3
    assert abs(run["energy"]) < 1e-3
    code, out, error = command("score", "--trajectory", "run.csv")
    assert code == 2
    assert "--problem must name one problem" in error


def test_the_tables_of_one_integrator_fit_a_terminal():
    """Two tables without empty columns; their rows are those of the entries."""
    card = sb.score(sb.Trapezoidal(), ["bilinear-gap", "hertz", "stop-along-the-beam", "bouncing-ball"])
    lines = str(card).splitlines()
    tables = [line for line in lines if line.startswith(tuple(p.name for p in card.problems))]
    assert len(tables) == 4 + 3
    assert max(map(len, tables)) <= 80
    assert not any("gradient" in line for line in lines)
    (first,) = (line for line in tables if line.startswith("bilinear-gap") and line.rstrip().endswith("converges"))
    assert f"{card.entries[0].best.tip_rms:.1e}" in first
    (second,) = (line for line in tables if line.startswith("bilinear-gap") and "3 of 3" in line)
    assert f"{abs(card.entries[0].best.peak_force):.1e}" in second


def test_the_problems_are_listed_shown_and_set_in_latex(command):
    code, out, _ = command("score", "--list")
    assert code == 0
    assert all(name in out for name in sb.problems())
    code, out, _ = command("score", "--list", "--problem", "hertz")
    assert read(out).name == "hertz"
    code, out, _ = command("score", "--latex", "--problem", "bilinear-oscillator")
    assert "4.49107970743817688" in out
    assert out.count("\\begin{tabular}") == out.count("\\end{tabular}") == 1
    assert command("score", "--problem", "hertzz")[0] == 2


def test_every_problem_can_be_set_in_latex():
    from stiffbeam.testset.scorecard import latex_table

    for problem in sb.problems().values():
        text = latex_table(problem)
        assert text.count("{") == text.count("}")
        assert not re.search(r"\d[eE]-?\d|inf(?!ty)", text.partition("\n  \\toprule")[2])


@pytest.mark.slow
def test_the_page_runs_as_written(tmp_path):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    done = subprocess.run([sys.executable, "-W", "error", "-c", block], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "5 converges" in done.stdout
    for name in sb.problems():
        assert f"## {name}\n" in PAGE
        assert (ROOT / "reference" / "problems" / f"{name}.png").is_file()


C_PROGRAM = r"""
#include <stdio.h>
int main(void) { /* a bouncing ball, h = 1, g = 9.81, e = 0.5, Moreau's time stepping, as the page describes it */
    double u = 1.0, v = 0.0, t_end = 1.5; int n = 6000;
    printf("t,u,v\n");
    for (int k = 0; k <= n; k++) {
        printf("%.17g,%.17g,%.17g\n", k * t_end / n, u, v);
        double h = t_end / n, new = v - h * 9.81;
        if (u + 0.5 * h * v <= 0.0 && new < -0.5 * v) new = -0.5 * v;
        u += 0.5 * h * (v + new); v = new;
    }
    return 0;
}
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
def test_a_c_program_is_scored(tmp_path, command):
    (tmp_path / "ball.c").write_text(C_PROGRAM, encoding="utf-8")
    subprocess.run(["gcc", "-O1", "-o", "ball", "ball.c"], cwd=tmp_path, check=True)
    done = subprocess.run([str(tmp_path / "ball")], capture_output=True, text=True, check=True)
    (tmp_path / "ball.csv").write_text(done.stdout, encoding="utf-8")
    code, out, _ = command("score", "--trajectory", "ball.csv", "--problem", "bouncing-ball", "--json", "-")
    assert code == 0
    (run,) = json.loads(out)["entries"][0]["runs"]
    assert run["tip_max"] < 2e-3
    assert run["energy"] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.slow
def test_the_plugin_asks_every_problem(tmp_path):
    text = (
        "import numpy as np\n"
        "def test_mine(known_problem):\n"
        "    tip = known_problem.answers['tip'].value\n"
        "    assert tip.shape == known_problem.times.shape\n"
    )
    assert f"{len(sb.problems())} passed" in passed(tmp_path, text)


def test_integrators_of_one_name_stay_apart(tmp_path, monkeypatch):
    """A user's ``radau`` beside SciPy's, and two functions of one name."""
    (tmp_path / "ext.py").write_text(
        "import numpy as np\n\ndef radau(system, dt, t_end):\n"
        "    t = np.linspace(0.0, t_end, round(t_end / dt) + 1)\n    return t, 0.0 * t\n"
    )
    monkeypatch.chdir(tmp_path)

    def radau(system, dt, t_end):
        t = np.linspace(0.0, t_end, round(t_end / dt) + 1)
        return t, 0.0 * t

    card = sb.score(["ext:radau", "radau", radau, radau], "free-oscillator", statistics=False)
    assert [entry.integrator for entry in card.entries] == ["ext:radau", "radau", "radau (2)", "radau (3)"]
