"""Every answer of the test set, and derivatives, by a way that shares no code with the one that made it.

Piecewise-linear motions: matrix exponentials between switches, in mpmath where the system is small. All: the references
of the package, and the textbook's formulas in 40 digits.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from systems import case_of
from witness import solve

import stiffbeam as sb

mp = pytest.importorskip("mpmath")
FOLDER = Path(__file__).parents[2] / "reference" / "problems"
FILES = {file.stem: tomllib.loads(file.read_text(encoding="utf-8")) for file in FOLDER.glob("*.toml")}
CONTACT = {name: file["system"]["contacts"][0] for name, file in FILES.items()}
LINEAR = [n for n, c in CONTACT.items() if c["stiffness"] < math.inf and not {"exponent", "damping"} & c.keys()]
SMALL = [n for n in LINEAR if len(FILES[n]["system"]["initial_displacement"]) <= 2]
LARGE = [n for n in LINEAR if n not in SMALL]
RIGID = [n for n, c in CONTACT.items() if c["stiffness"] == math.inf]


def test_there_are_two_dozen_problems_with_all_that_is_promised():
    assert len(FILES) >= 24
    for file in FILES.values():
        assert len(file["answers"]["tip"]["value"]) == len(file["answers"]["tip_velocity"]["value"]) == file["samples"]
        assert all(steps % file["samples"] == 0 for steps in file["steps"])
    assert list(sb.problems()) == sorted(FILES, key=lambda name: FILES[name]["number"])


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n == "hammer-pulse" else n for n in SMALL])
@pytest.mark.fast(2)
def test_small_piecewise_linear_motions_to_28_digits(name):
    """Matrix exponentials in mpmath between switches; samples and impact times."""
    file, problem = FILES[name], sb.problem(name)
    with mp.workdps(45):
        found = solve(case_of(problem.system, problem.t_end), 45)
        n = found.case.size
        worst = mp.mpf(0)
        known, rates = file["answers"]["tip"]["value"], file["answers"]["tip_velocity"]["value"]
        scale, rate_scale = (max(abs(mp.mpf(x)) for x in values) for values in (known, rates))
        for k in range(0, file["samples"], 7):
            state = found.state(float(problem.times[k]))
            u, v = (sum(mp.mpf(r) * x for r, x in zip(found.case.observe, half, strict=True))
                    for half in (state[:n], state[n:]))  # fmt: skip
            worst = max(worst, abs(u - mp.mpf(known[k])) / scale, abs(v - mp.mpf(rates[k])) / rate_scale)
        assert worst < mp.mpf(10) ** -28
        sides = [piece.chi[0] for piece in found.pieces]
        entries = [p.t for a, b, p in zip(sides, sides[1:], found.pieces[1:], strict=False) if b and not a and p.t > 0]
        listed = [mp.mpf(x) for x in file["answers"].get("impacts", {"value": []})["value"]]
        assert len(entries) == len(listed)
        assert all(abs(a - b) < mp.mpf(10) ** -28 * file["t_end"] for a, b in zip(entries, listed, strict=True))


@pytest.mark.parametrize("name", LARGE)
@pytest.mark.fast(2)
def test_large_piecewise_linear_motions_to_the_rounding_of_float64(name):
    """Matrix exponentials in float64, whose rounding the contacts of the beams magnify."""
    problem = sb.problem(name)
    found, known = solve(case_of(problem.system, problem.t_end)), problem.answers["tip"].value
    error = np.abs(found.tip(problem.times) - known) / np.max(np.abs(known))
    assert np.max(error) < (1e-6 if name.startswith("table") else 1e-8)
    entries = np.array([episode.begin for episode in found.episodes(0) if episode.begin > 0.0])
    assert np.allclose(entries, problem.answers["impacts"].value, rtol=0.0, atol=1e-8 * problem.t_end)


def test_what_textbooks_say_in_28_digits():
    with mp.workdps(40):
        close = lambda a, b: abs(a - mp.mpf(b)) < mp.mpf(10) ** -28 * abs(a)  # noqa: E731
        answer = lambda name, what: FILES[name]["answers"][what]["value"]  # noqa: E731
        q = mp.mpf(5) / 2
        depth = (q / (2 * mp.mpf(10) ** 6)) ** (1 / q)
        assert close(depth, answer("hertz", "largest_depth"))
        assert close(
            2 * mp.sqrt(mp.pi) * mp.gamma(1 + 1 / q) / mp.gamma(0.5 + 1 / q) * depth, answer("hertz", "contact_time")
        )
        assert close(mp.mpf(10) ** 6 * depth ** mp.mpf(1.5), answer("hertz", "peak_force"))
        # lambda v (1 + e) = ln[(1 + lambda v)/(1 - e lambda v)], lambda v = 1
        assert close(mp.findroot(lambda e: 1 + e - mp.log(2 / (1 - e)), 0.6), answer("hunt-crossley", "restitution"))
        w1, w2 = mp.sqrt(10), mp.sqrt(60)
        assert close(2 * w1 * w2 / (w1 + w2), answer("bilinear-oscillator", "frequency"))
        assert close(mp.pi / w1 + mp.pi / w2, answer("bilinear-oscillator", "period"))
        v = w1 * mp.sqrt(mp.mpf(0.02) ** 2 - mp.mpf(0.01) ** 2)
        g = mp.mpf(0.01)
        # free: 2/w1 (pi - acos(1/2)); pressed: about u = w1^2 g/w2^2 - ... a sine with the same g and v at both ends
        pressed = 2 / w2 * mp.atan2(v, w2 * (g - g * 50 / 60))
        assert close(2 / w1 * (mp.pi - mp.acos(g / mp.mpf(0.02))) + pressed, answer("bilinear-gap", "period"))
        impacts = [mp.mpf(x) for x in answer("bilinear-gap", "impacts")]
        assert close(impacts[2] - impacts[1], answer("bilinear-gap", "period"))
        w = mp.sqrt(10100)
        assert close(mp.pi / w, answer("mass-on-a-stop", "contact_time"))
        assert close(mp.mpf(10) ** 6 / w, answer("mass-on-a-stop", "peak_force"))
        drop = mp.sqrt(2 / mp.mpf(9.81))
        assert close(3 * drop, answer("bouncing-ball", "accumulation"))
        assert close(drop, answer("bouncing-ball", "impacts")[0])
        assert close(2 * drop, answer("bouncing-ball", "impacts")[1])
        assert close(mp.pi / 2, answer("preloaded-chatter", "impacts")[0])
        zeta = mp.mpf(0.2) / 2
        root = mp.sqrt(1 - zeta**2)
        release = (mp.pi - mp.atan2(2 * zeta * root, 1 - 2 * zeta**2)) / root
        assert close(mp.exp(-zeta * release), answer("kelvin-voigt", "restitution"))


EXACT = [*SMALL, *RIGID, "elastic-bar", "bouncing-bar", "aster-beam", "stop-along-the-beam", "moving-dashpot"]
MANY = [pytest.param(name, "multiprecision", marks=pytest.mark.slow) for name in ("table10", "table12", "table14")]


@pytest.mark.parametrize(
    ("name", "method"),
    [*((name, "exact") for name in EXACT), *MANY, *((x, "dop853") for x in ("kelvin-voigt", "hertz", "hunt-crossley"))],
)
@pytest.mark.fast(12)
def test_the_references_meet_the_answers(name, method):
    known, options = sb.problem(name), {"rtol": 1e-13} if method == "dop853" else {}
    run = sb.reference(known.system, known.t_end, method, t_eval=np.append(0.0, known.times), **options)
    tip = known.answers["tip"].value
    assert np.max(np.abs(run.tip[1:] - tip)) < 1e-12 * np.max(np.abs(tip))
    impacts = known.answers["impacts"].value if "impacts" in known.answers else np.zeros(0)
    assert np.allclose(run.impacts.times[: len(impacts)], impacts, rtol=0.0, atol=1e-11 * known.t_end)
    if "releases" in known.answers:
        ends = known.answers["releases"].value
        ends = ends[ends > impacts[0]]  # a contact at the start is no impact
        assert np.allclose(run.impacts.ends[: len(ends)], ends, rtol=0.0, atol=1e-11 * known.t_end)
    if method == "exact" and "peak_force" in known.answers:
        assert run.contacts[0].peak_force == pytest.approx(known.answers["peak_force"].value, rel=1e-11)


@pytest.mark.slow
def test_the_generator_makes_the_files_that_are_there():
    script = FOLDER.parents[1] / "studies" / "test_set" / "make.py"
    subprocess.run([sys.executable, script, "--check"], check=True)


# ---------------------------------------------------------------- derivatives

KNOWN = sorted(name for name, file in FILES.items() if "derivatives" in file)
POWERS = ("hertz", "hunt-crossley")
KAPPA, DISSIPATION = "contacts[0].stops.stiffness", "contacts[0].stops.dissipation"


@pytest.mark.parametrize("name", [name for name in KNOWN if name not in POWERS])
def test_the_derivatives_of_the_exact_solution(name):
    """In double precision, segment by segment: no code of either way."""
    problem = sb.problem(name)
    paths = list(problem.derivatives["tip"])
    found = sb.reference(problem.system, problem.t_end).derivative(paths)
    for what, values in (("tip", found.tip), ("tip_velocity", found.tip_velocity)):
        known = [problem.derivatives[what][path].value for path in paths]
        assert values[-1] == pytest.approx(known, rel=1e-10, abs=1e-13)


def restitution(x):
    """e of Hunt and Crossley at lambda v = x."""
    return mp.findroot(lambda e: x * (1 + e) - mp.log((1 + x) / (1 - e * x)), mp.mpf("0.6"))


def test_power_laws_by_their_scaling():
    """T is proportional to kappa^(-2/5) v^(-1/5) for Hertz and to kappa^(-2/5) for Hunt and Crossley, whose e depends
    on lambda v only: lambda v (1 + e) = ln[(1 + lambda v)/(1 - e lambda v)]."""
    with mp.workdps(40):
        for name in POWERS:
            file = FILES[name]
            tip, velocity = (
                {path: mp.mpf(x) for path, x in file["derivatives"][what].items()} for what in ("tip", "tip_velocity")
            )
            answers = {key: mp.mpf(x["value"]) for key, x in file["answers"].items() if isinstance(x["value"], str)}
            T, e, kappa = answers["contact_time"], answers["restitution"], mp.mpf(CONTACT[name]["stiffness"])
            assert abs(tip[KAPPA] / (-mp.mpf(2) / 5 * e * T / kappa) - 1) < mp.mpf(10) ** -21
            assert velocity[KAPPA] == 0
            if name == "hertz":  # tip = -v (t_end - t_0 - T), t_0 = -q0/v, v = 1
                after = mp.mpf(file["t_end"]) + mp.mpf(file["system"]["initial_displacement"][0]) - T
                entry = -mp.mpf(file["system"]["initial_displacement"][0])
                assert abs(tip["v0[0]"] - (-after - entry - T / 5)) < mp.mpf(10) ** -21
                assert (tip["q0[0]"], velocity["v0[0]"]) == (-1, -1)
            else:
                slope = mp.diff(restitution, 1)
                assert abs(velocity[DISSIPATION] / -slope - 1) < mp.mpf(10) ** -12
                assert abs(velocity["v0[0]"] / -(e + slope) - 1) < mp.mpf(10) ** -12
