"""Every answer of the test set, by a way that shares no code with the one that made it.

The files are read here with tomllib alone. Piecewise-linear motions: matrix exponentials between switches, in
mpmath where the system is small. Damped, power-law and rigid stops: Runge-Kutta of order 8 with events, and the
textbook's formulas in 50 digits.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from vibro_impact import Case, Contact
from vibro_march import solve

import stiffbeam as sb

mp = pytest.importorskip("mpmath")
FOLDER = Path(__file__).parents[2] / "reference" / "problems"
FILES = {file.stem: tomllib.loads(file.read_text(encoding="utf-8")) for file in FOLDER.glob("*.toml")}
CONTACT = {name: file["system"]["contacts"][0] for name, file in FILES.items()}
LINEAR = [n for n, c in CONTACT.items() if c["stiffness"] < math.inf and not {"exponent", "damping"} & c.keys()]
SMALL = [n for n in LINEAR if len(FILES[n]["system"]["initial_displacement"]) <= 2]
LARGE = [n for n in LINEAR if n not in SMALL]
RIGID = [n for n, c in CONTACT.items() if c["stiffness"] == math.inf]


def full(given):
    if not isinstance(given, dict):
        return np.array(given, float)
    bands = [np.array(band, float) for band in given["bands"]]
    return sum((np.diag(b, k) + (np.diag(b, -k) if k else 0.0) for k, b in enumerate(bands)), np.zeros(()))


def wave(table):
    if "constant" in table:
        return ("constant", table["constant"])
    if "times" in table:  # the hammer: zero, up, down, zero
        return ("triangular", max(table["values"]), table["times"][1], table["times"][3])
    return ("harmonic", table["amplitude"], table["frequency"], table.get("phase", 0.0))


def case_of(file):
    """The file as the independent solver takes it."""
    data = file["system"]
    mass = full(data["mass"])
    contacts = tuple(
        Contact(np.array(c["row"]), c.get("lower", -np.inf), c.get("upper", np.inf), c["stiffness"],
                wave(c["offset"]) if "offset" in c else None)
        for c in data["contacts"]
    )  # fmt: skip
    return Case(
        mass, full(data["damping"]) if "damping" in data else 0.0 * mass, full(data["stiffness"]),
        np.array(data["initial_displacement"]), np.array(data["initial_velocity"]),
        tuple((np.array(load["vector"]), wave(load)) for load in data.get("loads", ())), contacts,
        np.array(data.get("observe", data["contacts"][0]["row"])), file["t_end"],
    )  # fmt: skip


def times_of(file):
    return np.arange(1, file["samples"] + 1) * file["t_end"] / file["samples"]


def numbers(file, name):
    return np.array([float(x) for x in file["answers"][name]["value"]])


def test_there_are_two_dozen_problems_with_all_that_is_promised():
    assert len(FILES) >= 24
    for name, file in FILES.items():
        assert file["name"] == name
        assert all(len(file[text]) > 20 for text in ("source", "catches")) or name == "hertz"
        assert all(answer["how"] for answer in file["answers"].values())
        assert len(file["answers"]["tip"]["value"]) == len(file["answers"]["tip_velocity"]["value"]) == file["samples"]
        assert all(steps % file["samples"] == 0 for steps in file["steps"])
    assert sorted(file["number"] for file in FILES.values()) == list(range(1, len(FILES) + 1))
    assert list(sb.problems()) == sorted(FILES, key=lambda name: FILES[name]["number"])


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n == "hammer-pulse" else n for n in SMALL])
@pytest.mark.fast(2)
def test_small_piecewise_linear_motions_to_28_digits(name):
    """Matrix exponentials in mpmath between switches; samples and impact times."""
    from vibro_precise import precise, precise_flow

    file = FILES[name]
    with mp.workdps(45):
        found = precise(case_of(file), 45)
        n = found.case.size
        worst = mp.mpf(0)
        known, rates = file["answers"]["tip"]["value"], file["answers"]["tip_velocity"]["value"]
        scale, rate_scale = (max(abs(mp.mpf(x)) for x in values) for values in (known, rates))
        for k in range(0, file["samples"], 7):
            t = times_of(file)[k]
            start, window, chi, z = found.pieces[max(0, int(np.searchsorted(found.starts, t, side="right")) - 1)]
            state = precise_flow(found.equations.regime(window, chi).A, z, mp.mpf(float(t)) - start)
            u, v = (sum(mp.mpf(r) * x for r, x in zip(found.case.observe, half, strict=True))
                    for half in (state[:n], state[n : 2 * n]))  # fmt: skip
            worst = max(worst, abs(u - mp.mpf(known[k])) / scale, abs(v - mp.mpf(rates[k])) / rate_scale)
        assert worst < mp.mpf(10) ** -28
        sides = [piece[2][0] for piece in found.pieces]
        entries = [
            p[0] for a, b, p in zip(sides, sides[1:], found.pieces[1:], strict=False) if b and not a and p[0] > 0
        ]
        listed = [mp.mpf(x) for x in file["answers"].get("impacts", {"value": []})["value"]]
        assert len(entries) == len(listed)
        assert all(abs(a - b) < mp.mpf(10) ** -28 * file["t_end"] for a, b in zip(entries, listed, strict=True))


@pytest.mark.parametrize("name", LARGE)
@pytest.mark.fast(2)
def test_large_piecewise_linear_motions_to_the_rounding_of_float64(name):
    """Matrix exponentials in float64, whose rounding the contacts of the beams magnify."""
    file = FILES[name]
    found = solve(case_of(file))
    known = numbers(file, "tip")
    error = np.abs(found.tip(times_of(file)) - known) / np.max(np.abs(known))
    assert np.max(error) < (1e-6 if name.startswith("table") else 1e-8)
    entries = np.array([episode.begin for episode in found.episodes(0) if episode.begin > 0.0])
    assert np.allclose(entries, numbers(file, "impacts"), rtol=0.0, atol=1e-8 * file["t_end"])


def events(file, force, start, stop, release=None, restitution=None, rtol=1e-13, load=lambda t: 0.0):
    """One mass, event by event, by DOP853: positions and velocities at the sample times, and the times of entry.

    force(d, d'): of the stop pressed to d > 0. release(d, d'): zero where the contact ends. restitution: rigid.
    """
    (m,), (k,) = file["system"]["mass"][0], file["system"]["stiffness"][0]
    t, y, pressed, entries, path = 0.0, np.array(start, float), False, [], np.full((2, file["samples"]), np.nan)
    grid = times_of(file)

    def rhs(t, y):
        return [y[1], (load(t) - k * y[0] - (force(y[0] - stop, y[1]) if pressed else 0.0)) / m]

    while t < file["t_end"]:
        hit = (lambda t, y: release(y[0] - stop, y[1])) if pressed else (lambda t, y: y[0] - stop)
        hit.terminal, hit.direction = True, -1.0 if pressed else 1.0
        run = solve_ivp(rhs, (t, file["t_end"]), y, "DOP853", rtol=rtol, atol=1e-15, events=hit, dense_output=True,
                        first_step=1e-9 if t > 0.0 else None)  # fmt: skip
        inside = (grid > t) & (grid <= run.t[-1])
        if np.any(inside):
            path[:, inside] = run.sol(grid[inside])
        t, y = float(run.t[-1]), run.y[:, -1]
        if run.status != 1:
            return *path, np.array(entries)
        if not pressed:
            entries.append(t)
        if restitution is None:
            pressed = not pressed
        else:
            y = np.array([stop, -restitution * y[1]])
    return *path, np.array(entries)


def test_a_stop_that_moves_and_has_a_dashpot():
    """Runge-Kutta of order 8 between the zeros of depth and force, relative to the moving stop."""
    file, contact = FILES["moving-dashpot"], CONTACT["moving-dashpot"]
    w, grid = contact["offset"]["frequency"], times_of(file)

    def pushed(t, y):
        """Depth and force of the stop."""
        depth = y[0] + 0.5 * np.sin(w * t) - 0.25
        return depth, 100.0 * depth + 4.0 * (y[1] + 0.5 * w * np.cos(w * t))

    t, y, path, found = 0.0, [-0.5, 0.0], np.full((2, len(grid)), np.nan), ([], [])
    while t < file["t_end"]:
        closed = len(found[0]) > len(found[1])
        change = lambda t, y, closed=closed: pushed(t, y)[closed]  # noqa: E731
        change.terminal, change.direction = True, -1.0 if closed else 1.0
        rhs = lambda t, y, closed=closed: [y[1], -10.0 * y[0] - closed * pushed(t, y)[1]]  # noqa: E731
        run = solve_ivp(rhs, (t, file["t_end"]), y, "DOP853", rtol=1e-13, atol=1e-15, events=change, dense_output=True,
                        first_step=1e-9)  # fmt: skip
        inside = (grid > t) & (grid <= run.t[-1])
        path[:, inside] = run.sol(grid[inside])
        t, y = float(run.t[-1]), run.y[:, -1]
        if run.status == 1:
            found[closed].append(t)
    assert np.allclose(path, [numbers(file, "tip"), numbers(file, "tip_velocity")], rtol=0.0, atol=1e-11)
    for times, name in zip(found, ("impacts", "releases"), strict=True):
        assert np.allclose(times, numbers(file, name), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "start", "release"),
    [
        ("kelvin-voigt", (-0.5, 1.0), lambda d, v: d + 0.2 * v),
        ("hertz", (-0.0078125, 1.0), lambda d, v: d),
        ("hunt-crossley", (-0.5, 1.0), lambda d, v: d),
    ],
)
def test_damped_and_power_law_stops(name, start, release):
    file, contact = FILES[name], CONTACT[name]
    lam = {"hunt-crossley": 1.0}.get(name, 0.0)
    law = lambda d, v: contact["stiffness"] * max(d, 0.0) ** 1.5 * (1.0 + lam * v)  # noqa: E731
    u, v, entries = events(file, release if name == "kelvin-voigt" else law, start, 0.0, release)
    assert np.allclose(u, numbers(file, "tip"), rtol=0.0, atol=1e-11 * np.max(np.abs(numbers(file, "tip"))))
    assert np.allclose(v, numbers(file, "tip_velocity"), rtol=0.0, atol=1e-10)  # of 1
    assert np.allclose(entries, numbers(file, "impacts"), rtol=0.0, atol=1e-12)


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


@pytest.mark.parametrize("name", ["impact-oscillator", "impact-transient"])
def test_impacts_of_a_driven_mass(name):
    file = FILES[name]
    data = file["system"]
    drive = data["loads"][0]
    u, _, entries = events(
        file, None, (data["initial_displacement"][0], data["initial_velocity"][0]), 0.0, restitution=0.8,
        load=lambda t: drive["amplitude"] * np.sin(drive["frequency"] * t + drive["phase"]),
    )  # fmt: skip
    assert len(entries) == {"impact-oscillator": 3, "impact-transient": 9}[name]
    assert np.allclose(entries, numbers(file, "impacts"), rtol=0.0, atol=1e-9)
    assert np.allclose(u, numbers(file, "tip"), rtol=0.0, atol=1e-9 * np.max(np.abs(numbers(file, "tip"))))


def test_the_periodic_orbits_are_periodic():
    """Impacts a period apart: pi of the rational orbit, 10 of the nonsmooth mode, 0.95 T_1 of the beam's."""
    beam = FILES["nonsmooth-beam-mode"]["system"]
    values = np.linalg.eigvals(np.linalg.solve(full(beam["mass"]), full(beam["stiffness"])))
    first = 0.95 * 2.0 * np.pi / np.sqrt(np.min(values.real))
    for name, period in (("impact-oscillator", np.pi), ("nonsmooth-mode", 10.0), ("nonsmooth-beam-mode", first)):
        impacts = numbers(FILES[name], "impacts")
        assert len(impacts) >= 2
        assert np.allclose(impacts, period * np.arange(1, len(impacts) + 1), rtol=1e-11)


def test_the_sticking_phase():
    """The flight by matrix exponentials, the rest by a sine: both masses arrive at 1 without speed, and leave so."""
    import scipy.linalg

    file = FILES["sticking-phase"]
    flight, stick, speed = (float(file["answers"][x]["value"]) for x in ("free_flight", "sticking_time", "speed"))
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [np.array([[-2.0, 1.0], [1.0, -1.0]]), np.zeros((2, 2))]])
    start = np.array([1.0, 1.0, -speed, 0.0])
    assert np.allclose(scipy.linalg.expm(A * flight) @ start, [1.0, 1.0, speed, 0.0], atol=1e-12)
    path = np.array([scipy.linalg.expm(A * t) @ start for t in np.linspace(0.05, flight - 0.05, 200)])
    assert np.all(path[:, 1] < 1.0)
    u1 = lambda t: 0.5 + 0.5 * np.cos(2**0.5 * t) + speed / 2**0.5 * np.sin(2**0.5 * t)  # noqa: E731
    assert abs(u1(stick) - 1.0) < 1e-12
    assert np.all(u1(np.linspace(0.01, stick - 0.01, 99)) > 1.0)  # the stop is pressed
    # The double next to the speed arrives where u2 - 1, a cube, is 1e-16: some 1e-5 early or late.
    assert np.allclose(numbers(file, "arrivals"), flight + (flight + stick) * np.arange(2), atol=1e-4)
    flown = np.array([(scipy.linalg.expm(A * t) @ start)[0] for t in times_of(file)[times_of(file) < 5.9]])
    assert np.allclose(numbers(file, "tip")[: len(flown)], flown, atol=1e-12)
    held = times_of(file)[(times_of(file) > flight) & (times_of(file) < flight + stick)]
    assert np.allclose(numbers(file, "tip")[np.isin(times_of(file), held)], u1(held - flight), atol=1e-9)


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
    if method == "exact" and "peak_force" in known.answers:
        assert run.contacts[0].peak_force == pytest.approx(known.answers["peak_force"].value, rel=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(
    "processor", ["this", *(pytest.param(x, marks=pytest.mark.campaign) for x in ("Nehalem", "Haswell"))]
)
def test_the_generator_makes_the_files_that_are_there(tmp_path, processor):
    """Those that take seconds, remade beside the files: their data, and all digits of the answers to these data.

    Two start in eigenvectors, which LAPACK rounds as the processor does, to eps (w_max/w_1)^2 < 1e-11 of them.
    """
    script = FOLDER.parents[1] / "studies" / "test_set" / "make.py"
    code = (
        f"import sys; sys.path.insert(0, {str(script.parent)!r})\n"
        "import dataclasses, make, tomllib\n"
        "import numpy as np\n"
        "for k, d in enumerate(make.DEFINITIONS, start=1):\n"
        "    if d.name not in ('hertz', 'hunt-crossley') and not d.name.startswith('table'):\n"
        "        there = (make.FOLDER / f'{d.name}.toml').read_text(encoding='utf-8')\n"
        "        there = there.partition('\\n[derivatives]')[0]\n"
        "        if d.name in ('stop-along-the-beam', 'nonsmooth-beam-mode'):\n"
        "            starts = [f'initial_{x}' for x in ('displacement', 'velocity')]\n"
        "            start = {x: tomllib.loads(there)['system'][x] for x in starts}\n"
        "            for x in starts:\n"
        "                error = np.abs(np.subtract(start[x], d.data[x]))\n"
        "                assert error.max() <= 1e-11 * np.abs(start[x]).max(), (d.name, x, error)\n"
        "            d = dataclasses.replace(d, data=d.data | start)\n"
        "        text = make.file_text(k, d, d.truth(make.problem_of(d)))\n"
        "        assert text == there, d.name\n"
        "import page, stiffbeam\n"
        "made = page.page_text(list(stiffbeam.problems().values()))\n"
        "assert made == (make.FOLDER / 'README.md').read_text(encoding='utf-8')\n"
    )
    environment = os.environ | ({} if processor == "this" else {"OPENBLAS_CORETYPE": processor})
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert done.returncode == 0, done.stderr
