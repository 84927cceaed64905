"""The command: what it prints and writes, where it stops and with what words, and what it loads."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import matplotlib.image
import numpy as np
import pandas
import pytest

import stiffbeam as sb
from stiffbeam.cli import OWN
from stiffbeam.files.cases import find_case, paper_cases
from stiffbeam.references import registry
from stiffbeam.studies.doubt import Doubt

MINE = """
[[case]]
name = "mine"
cells = 8
dt = 1e-3
t_end = 0.05
runs = ["bdf2", "HHT(alpha=-0.2)"]
[case.problem]
stiffness = 300.0
base = { amplitude = 0.1, frequency = 10.0 }
"""


def shell(*arguments, cwd):
    """The command in a process of its own, with pipes for stdout and stderr."""
    command = [sys.executable, "-W", "error", "-m", "stiffbeam", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=120)


def told(stderr):
    """What a command says beside the line on its work after three seconds, which a busy machine may show."""
    return [line for line in stderr.splitlines() if " s so far, now " not in line]


def words(text):
    """Text with the line breaks of the terminal undone."""
    return " ".join(text.split())


def assert_shows_curves(picture: Path):
    pixels = matplotlib.image.imread(picture)[..., :3]
    assert min(pixels.shape[:2]) > 500
    white = np.all(pixels > 0.99, axis=-1)
    assert 0.02 < np.mean(~white) < 0.5
    coloured = np.ptp(pixels, axis=-1) > 0.3  # the schemes; axes, text and reference are grey
    assert np.mean(coloured) > 0.001


# ---------------------------------------------------------------- compare


@pytest.mark.slow
def test_compare_pipes_json_and_writes_table_picture_rates_and_trajectories(tmp_path):
    process = shell("compare", "table10", "--t-end", "0.05", "--references", "exact", "--rates", "--json", "-",
                    cwd=tmp_path)  # fmt: skip
    records = json.loads(process.stdout, parse_constant=pytest.fail)  # no NaN
    assert (process.returncode, told(process.stderr)) == (0, [])
    assert (records["case"], records["t_end"], records["failures"]) == ("table10", 0.05, [])
    labels = ["HHT(alpha=-0.1)@displacement", "SDIRK(gamma=0.4359, nystrom=True)@displacement", "BDF2@displacement"]
    assert [c["label"] for c in records["comparisons"]] == labels
    hht, sdirk, bdf2 = (c["tip_error_rms"] for c in records["comparisons"])
    assert 0.0 < sdirk < hht < bdf2 < 0.01  # third order, then second order by error constant
    assert all(c["steps"] == 500 and c["window"] == 0.05 for c in records["comparisons"])
    out = tmp_path / "stiffbeam-output" / "table10"
    assert sorted(path.name for path in out.iterdir()) == [
        "BDF2-displacement.nc", "HHT-alpha=-0.1-displacement.nc", "SDIRK-gamma=0.4359-nystrom=True-displacement.nc",
        "comparison-rates.csv", "comparison.json", "comparison.png", "comparison.txt", "exact-displacement.nc",
    ]  # fmt: skip
    listed = json.loads((out / "comparison.json").read_text(encoding="utf-8"))["files"]
    assert {*listed, "comparison.json"} == {path.name for path in out.iterdir()}
    assert_shows_curves(out / "comparison.png")
    table = words((out / "comparison.txt").read_text(encoding="utf-8"))
    assert all(name in table for name in ("exact (reference)", "HHT(alpha=-0.1)", "SDIRK(gamma=0.4359)", "BDF2"))
    assert isinstance(sb.load(out / "exact-displacement.nc"), sb.Reference)
    run = sb.integrate(sb.paper_case(10).system(), sb.BDF2(), 1e-4, 0.05)
    assert np.array_equal(sb.load(out / "BDF2-displacement.nc").tip, run.tip)
    rates = pandas.read_csv(out / "comparison-rates.csv", index_col=["run", "contact"]).loc[(labels[2], 0)]
    assert rates.impact_rate == pytest.approx(sb.contact_rates(run).rates[0]["impact"].value, rel=1e-9)


@pytest.mark.slow
def test_options_replace_schemes_step_folder_and_records(command, tmp_path):
    (tmp_path / "mine.toml").write_text(MINE, encoding="utf-8")
    code, out, err = command(
        "compare", "mine.toml", "--schemes", "hht,HHT(alpha=-0.3),theta", "--dt", "5e-4", "--t-end",
        "0.04", "--references", "exact", "--out", "deep/folder", "--json", "records/all.json",
    )  # fmt: skip
    assert (code, err) == (0, "")
    records = json.loads(Path("records/all.json").read_text(encoding="utf-8"))
    labels = ["HHT(alpha=-0.1)@displacement", "HHT(alpha=-0.3)@displacement", "Theta(theta=0.5)@displacement"]
    assert [c["label"] for c in records["comparisons"]] == labels
    assert {(c["dt"], c["steps"]) for c in records["comparisons"]} == {(5e-4, 80)}
    assert Path("deep/folder/comparison.png").is_file()
    assert not Path("stiffbeam-output").exists()
    assert "files in deep/folder" in out


def test_an_interrupt_keeps_the_schemes_and_the_exact_solution(command, tmp_path, monkeypatch):
    from stiffbeam.studies import comparison

    def stop(system, t_end, method, times, **options):
        if method == "exact":
            return sb.reference(system, t_end, method, times)
        raise KeyboardInterrupt

    monkeypatch.setattr(comparison, "cached_reference", stop)
    (tmp_path / "mine.toml").write_text(MINE, encoding="utf-8")
    code, out, err = command("compare", "mine.toml", "--references", "exact,dop853", "--out", "here")
    assert code == 130
    assert "interrupted" in err
    first = [line.partition(":")[0] for line in out.splitlines()[1:4]]
    assert first == ["BDF2", "HHT(alpha=-0.2)", "exact"]  # as soon as each has run
    for said in (out, Path("here/comparison.txt").read_text(encoding="utf-8")):
        assert any(line.startswith("exact (reference)") for line in said.splitlines())
    assert Path("here/comparison.json").is_file()


# ---------------------------------------------------------------- where it stops


@pytest.mark.slow
def test_a_run_that_overflows_is_named_with_its_time_and_the_remedy(command):
    """Table 11 as printed with extrapolated contact, to where SDIRK, the first scheme, passes 1e100."""
    options = "--dt 2.5e-4 --t-end 0.0205 --contact extrapolated --references exact --out here"
    code, out, err = command("compare", "table11", *options.split())
    assert (code, told(err)) == (1, [])
    label = "SDIRK(gamma=0.4359, nystrom=True)"
    assert f"failed {label}@displacement {label} overflowed at t = 0.02" in words(out)
    assert "use the implicit contact or a smaller dt (omega_max dt is" in words(out)
    assert words(out).count("failed ") == 1
    names = {path.name for path in Path("here").iterdir()}
    assert names >= {"BDF2-displacement.nc", "HHT-alpha=-0.1-displacement.nc", "comparison.png"}
    assert not any(name.startswith("SDIRK") for name in names)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["cmpare"], 'Did you mean "compare"?'),
        (["compare"], "--case requires an argument"),
        (["compare", "table10", "--tend", "1"], "Did you mean --t-end?"),
        (["compare", "table10", "--schemes", "bdf2,hhtt"], "scheme must be a registered scheme, got 'hhtt'"),
        (["compare", "table10", "--form", "displacment"], "did you mean displacement?"),
        (["compare", "table10", "--schemes", "BDF2@displacement"], "be without a form"),
        (["compare", "table10", "--references", "exacct"], "got 'exacct': did you mean exact?"),
        (["compare", "table10", "--contact", "implict", "--references", "exact", "--t-end", "0.01"], "got 'implict'"),
        (["compare", "table10", "--dt", "-1e-4"], "--dt must be > 0, got -0.0001"),
        (["compare", "table10", "--t-end", "nan"], "--t-end must be finite, got nan"),
        (["compare", "none.toml"], "case file must be a readable file, got 'none.toml'"),
        (["converge", "table10", "--halvings", "0"], "halvings must be an integer >= 1, got 0"),
        (["converge", "table10", "--views", "ordr"], "did you mean order"),
        (["study", "space", "table10", "--cells", "1"], "cells must be an integer >= 2, got 1"),
        (["study", "spaces"], "Did you mean"),
        (["sweep", "--values", "8:9:x"], "read start:stop:count"),
        (["score", "bdf2", "--problem", "hertz", "--trajectory", "a.csv"], "be left out with --trajectory"),
        (["reference", "table10", "--method", "cvode", "--digits", "50"], "--digits must be left out"),
        (["reference", "table10", "--rtol", "1e-3"], "--rtol must be left out"),
        (["cases", "--show", "tabel10"], "did you mean table10"),
    ],
    ids=lambda x: " ".join(x[1:4]) if isinstance(x, list) else "",
)
def test_bad_input_exits_with_2_and_one_line(command, tmp_path, arguments, message):
    code, out, err = command(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("stiffbeam: ")
    assert message in err
    assert len(err.splitlines()) == 1
    assert not list(tmp_path.glob("**/*.*"))  # nothing half done


# ---------------------------------------------------------------- what is loaded

HEAVY = ("jax", "diffrax", "sksundae", "matplotlib", "scipy")  # of these scipy takes half a second, the others more
LOADED = """
import sys
sys.argv = ["stiffbeam", *{}]
try:
    {}
finally:
    print("LOADED", sorted(m for m in sys.modules if "." not in m))
"""
LIGHT = ([], ["--help"], ["--version"], ["cases"], ["cases", "--show", "table10"], ["cases", "--json", "-"])


@pytest.mark.fast(3)
@pytest.mark.parametrize("arguments", LIGHT, ids=lambda words: " ".join(words) or "import")
def test_the_import_and_commands_without_numbers_load_no_heavy_library(arguments, tmp_path):
    code = LOADED.format(arguments, "from stiffbeam import cli; cli.main()" if arguments else "import stiffbeam")
    process = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert process.returncode == 0, process.stderr
    loaded = process.stdout.rpartition("[")[2]
    assert f"'{'cyclopts' if arguments else 'stiffbeam'}'" in loaded
    assert not [name for name in HEAVY if f"'{name}'" in loaded]


def test_the_list_of_cases_has_their_tables(command):
    listed = json.loads(command("cases", "--json", "-")[1])["cases"]
    assert [(x["name"], x["dt"]) for x in listed] == [(name, case.dt) for name, case in paper_cases().items()]


def test_the_version_is_said(command):
    code, out, _ = command("--version")
    stated = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]["version"]
    assert (code, out.split()) == (0, ["stiffbeam", stated])
    assert sb.__version__ == stated


def test_a_full_disk_is_one_line():
    command = [sys.executable, "-m", "stiffbeam", "cases"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("stiffbeam: [Errno 28] No space left on device\n")


# ---------------------------------------------------------------- studies


@pytest.mark.parametrize("words", [[], ["converge"], ["study", "energy"], ["advise"], ["compare"]], ids="-".join)
def test_the_help_of_a_command_has_every_option_with_its_help(words, command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    code, out, err = command(*words, "--help")
    assert (code, err) == (0, "")
    wanted = ["--t-end", "--json"] if words else [*OWN, "cases", "compare", "doctor", "reference", "score", "study"]
    assert [name for name in wanted if f" {name} " not in out] == []
    for line in out.splitlines():
        if " --" in line[:8]:
            assert len(line.strip("│ ").split()) > 2, line
    assert not re.search(r"ANY|\(\D?'|\(\d|None|default: \]", out)  # what a user types, not what Python holds


def test_the_remedy_of_doubt_is_one_for_the_command_line(command, monkeypatch, tmp_path):
    """It is followed to the letter: a case of the paper with the two lines at its end."""
    code, _, err = command("doubt", "table10", "--members", "8")
    assert code == 2
    line = re.search(r'stiffbeam (cases --show table10) > (\S+?)"', err)
    head, ranges = re.search(r"with (\[case\.\w+\]) and (\S+ = \[.*?\])", err).groups()
    _, text, _ = command(*line[1].split())
    Path(line[2]).write_text(f"{text}\n{head}\n{ranges}\n", encoding="utf-8")
    case = find_case(line[2])
    Doubt().require(case)
    assert case.uncertain == {"stops.stiffness": (4.5e6, 5.5e6)}


def test_several_trajectories_are_one_score(command):
    known = sb.problem("bilinear-gap")
    for n in (400, 800, 1600):
        run = sb.integrate(known.system, sb.BDF2(), known.t_end / n, known.t_end)
        np.savetxt(f"{n}.csv", np.c_[run.t, run.tip, run.tip_velocity], delimiter=",", header="t,u,v", comments="")
    code, out, err = command("score", "--problem", "bilinear-gap", "--trajectory", "400.csv", "800.csv", "1600.csv")
    assert (code, err) == (0, "")
    assert out.startswith("3 files: 1 converges")


def test_a_study_prints_its_answer_and_writes_table_text_and_picture(command, tmp_path):
    (tmp_path / "mine.toml").write_text(MINE, encoding="utf-8")
    code, out, err = command(
        "study", "modes", "mine.toml", "--schemes", "BDF2,HHT(alpha=-0.2)", "--steps", "200", "--jobs", "1"
    )
    assert (code, err) == (0, "")
    assert out.startswith("How late and how damped is each mode")
    folder = tmp_path / "stiffbeam-output" / "mine"
    assert {path.name for path in folder.iterdir()} == {"modes.csv", "modes.txt", "modes.png", "points"}
    points = sorted((folder / "points").iterdir())
    assert len(points) == 2
    times = [path.stat().st_mtime_ns for path in points]
    code, out, _ = command(
        "study", "modes", "mine.toml", "--schemes", "BDF2,HHT(alpha=-0.2)", "--steps", "200", "--json", "-"
    )
    found = json.loads(out)
    assert (code, found["study"], found["options"]["steps"]) == (0, "modes", 200)
    assert [path.stat().st_mtime_ns for path in points] == times  # read, and not computed again


def session(leader: int) -> list[int]:
    """The processes of the session that ``leader`` began, itself among them."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(session) == leader and state != "Z":
            found.append(int(stat.parent.name))
    return found


def assert_nobody_left(leader: int) -> None:
    """Fails where a process of the session is still there after 20 s, and ends it."""
    end = time.monotonic() + 20
    while session(leader) and time.monotonic() < end:
        time.sleep(0.1)
    left = session(leader)
    for process in left:
        os.kill(process, signal.SIGKILL)
    assert not left


@pytest.mark.fast(0, slow=1)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_interrupted_study_goes_on(number, tmp_path):
    """What was finished is kept, no process is left, and the same command ends as without the signal."""
    options = ["--values", "7:13:40", "--jobs", "2", "--out", str(tmp_path)]
    words = [sys.executable, "-m", "stiffbeam", "sweep", "table10", *options]
    child = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True)
    end = time.monotonic() + 200
    while len(list(tmp_path.glob("points/*.json"))) < 2 and time.monotonic() < end:
        time.sleep(0.1)
    child.send_signal(number)
    said = child.communicate()[1]
    assert child.returncode == 128 + number
    # Beside it loky may say that it cleans up after the workers.
    assert "stiffbeam: interrupted; run the same command again" in told(said)
    assert_nobody_left(child.pid)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("points/*.json")}
    assert len(kept) >= 2
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


# ---------------------------------------------------------------- doctor


@pytest.mark.slow
def test_every_solver_works_here(command):
    code, out, _ = command("doctor", "--json", "-")
    found = json.loads(out)
    assert code == 0
    assert {solver["name"] for solver in found["solvers"]} == {"SDIRK", *registry.REFERENCES}
    assert all(solver["agrees"] for solver in found["solvers"])


def test_a_broken_solver_is_named_and_the_others_go_on(command, monkeypatch):
    real = sb.score

    def broken(name, *arguments):
        if name == "ida":
            raise ImportError("no library")
        return real("trapezoidal", *arguments)

    monkeypatch.setattr("stiffbeam.testset.score.score", broken)
    code, out, _ = command("doctor")
    assert code == 1
    rows = [line.split() for line in out.splitlines() if "works" in line or "fails" in line]
    assert {row[0] for row in rows if "fails," in row} == {"ida"}
    assert "ImportError: no library" in " ".join(out.split())


@pytest.mark.slow
def test_where_jax_finds_no_device_the_remedy_is_stated():
    code = "import stiffbeam as sb; sb.reference(sb.problem('bilinear-gap').system, 0.01, 'kvaerno3', rtol=1e-4)"
    environment = {**os.environ, "JAX_PLATFORMS": "tpu"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert "JAX must start its devices" in done.stderr
    assert "set JAX_PLATFORMS=cpu" in done.stderr
