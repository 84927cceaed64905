"""Case files of one's own: defaults, units, and what is said of bad fields."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.files.cases import _parse, find_case, load_cases
from stiffbeam.files.paper import case_blocks, paper_text

HEAD = """
[[case]]
name = "mine"
cells = 8
dt = 1e-3
t_end = 0.1
"""


PLAIN = HEAD + "[case.problem]\nstiffness = 300.0\n"


@pytest.fixture
def write(tmp_path):
    def to_file(text, name="mine.toml"):
        file = tmp_path / name
        file.write_text(text, encoding="utf-8")
        return file

    return to_file


def test_a_minimal_file_takes_the_defaults(write):
    case = find_case(str(write(PLAIN)))
    assert (case.name, case.title, case.cells, case.dt, case.t_end) == ("mine", "mine", 8, 1e-3, 0.1)
    assert [f"{type(s).__name__}@{form}" for s, form in case.runs] == [
        "BDF2@displacement",
        "SDIRK@displacement",
        "HHT@displacement",
    ]
    assert (case.published, case.notes) == ({}, ())
    assert case.problem == sb.BeamProblem(stiffness=300.0)


FULL = (
    HEAD.replace("cells", 'title = "All of it"\ncells')
    + """
runs = ["Theta(theta=0.6)"]
inferred = ["dt: a guess"]
[case.problem]
supports = "clamped-free"
stiffness = 300
viscosity = 0.5
length = 1.5
mass_per_length = 0.7
mass_damping = 0.3
modal_damping = [0.01, 0.02]
tip_mass = 0.4
stops = [
  { upper = 0.1, stiffness = 1e6 },
  { lower = -0.03, stiffness = 4e4, position = 0.6, motion = { amplitude = 0.004, frequency = "pi/5" } },
]
base = { amplitude = 0.2, frequency = 10, phase = 0.5 }
loads = [
  { position = 0.5, amplitude = 3.0, frequency = 2.0 },
  { position = 1, constant = -4 },
  { shape = [1.0, 0.0, 2.0], constant = 7.0 },
]
initial_displacement = [0.0958851077208406, 0.0, 0.25]
initial_velocity = [0.0, 3.0]
[case.published.impacts]
"Theta(theta=0.6)" = 3
"""
)


def test_a_full_file_holds_everything_that_python_can(write):
    case = find_case(str(write(FULL)))
    problem, x = case.problem, np.array([0.0, 0.5, 1.0])
    assert (case.title, case.notes) == ("All of it", ("dt: a guess",))
    assert case.published == {"impacts": {"Theta(theta=0.6)": 3}}
    assert [(s.theta, form) for s, form in case.runs] == [(0.6, "hermite")]
    assert (problem.stiffness, problem.viscosity, problem.length) == (300, 0.5, 1.5)
    assert (problem.mass_per_length, problem.tip_mass, problem.mass_damping) == (0.7, 0.4, 0.3)
    assert (problem.supports, problem.modal_damping) == ("clamped-free", (0.01, 0.02))
    moving = sb.Stops(-0.03, stiffness=4e4, position=0.6, motion=sb.Harmonic(0.004, "pi/5"))
    assert problem.stops == (sb.Stops(upper=0.1, stiffness=1e6), moving)
    assert problem.base == sb.Harmonic(0.2, 10, 0.5)
    assert problem.loads[:2] == (sb.PointLoad(0.5, sb.Harmonic(3.0, 2.0)), sb.PointLoad(1, sb.Constant(-4)))
    assert problem.loads[2].time == sb.Constant(7.0)
    assert np.allclose(problem.loads[2].shape(x), [1.0, 1.5, 3.0], rtol=1e-15)
    assert np.allclose(problem.initial_displacement(x), 0.2 * np.sin(0.5) + 0.25 * x**2, rtol=1e-14)
    assert np.allclose(problem.initial_velocity(x), 3.0 * x, rtol=1e-15)


PHYSICAL = HEAD + "[case.problem]\nlength = 2.0\nstiffness = 875.0\nmass_per_length = 3.925\n"


def test_a_case_among_several_is_named_after_a_colon(write):
    file = write(PLAIN + PLAIN.replace("mine", "other").replace("300.0", "500.0"))
    assert list(load_cases(file)) == ["mine", "other"]
    assert find_case(f"{file}:other").problem.stiffness == 500.0
    with pytest.raises(sb.InputError, match=re.escape("add :mine or :other to it")):
        find_case(str(file))
    with pytest.raises(sb.InputError, match=r"got 'othre': did you mean other\?") as caught:
        find_case(f"{file}:othre")
    assert str(file) in str(caught.value)


BEAM, LINE = "mine.problem", PLAIN + "%s\n"
FAULTS = [  # text, field, value, rule
    (HEAD, "mine.problem", None, "be given, or a system"),
    (HEAD + "problem = 3", BEAM, 3, "be a table"),
    (PLAIN.replace('name = "mine"', ""), "case.name", None, "be given"),
    (PLAIN.replace('"mine"', "7"), "7.name", 7, "be a text"),
    (PLAIN.replace("cells = 8", ""), "mine.cells", None, "be an integer >= 4"),
    (PLAIN.replace("cells = 8", "cells = 3"), "mine.cells", 3, "be an integer >= 4"),
    (PLAIN.replace("cells = 8", "cells = true"), "mine.cells", True, "be an integer"),
    (PLAIN.replace("dt = 1e-3", 'dt = "small"'), "mine.dt", "small", "be a number"),
    (PLAIN.replace("dt = 1e-3", "dt = 0.03"), "mine.dt", 0.03, "divide t_end = 0.1"),
    (PLAIN.replace("t_end = 0.1", "t_end = -1"), "mine.t_end", -1, "be > 0"),
    (PLAIN.replace("cells", 'runs = "hht"\ncells'), "mine.runs", "hht", "be a list"),
    (PLAIN.replace("cells", "runs = [1]\ncells"), "mine.runs[0]", 1, "be a text"),
    (PLAIN.replace("cells", 'runs = ["this:Zen"]\ncells'), "mine.runs", "this:Zen", "be schemes of the package"),
    (PLAIN.replace("cells", 'runs = ["HHT(alpha=0.2)"]\ncells'), "mine.alpha", 0.2, "lie in [-0.333333, 0]"),
    (PLAIN.replace("300.0", "true"), f"{BEAM}.stiffness", True, "be a number"),
    (PLAIN.replace("300.0", "-1.0"), f"{BEAM}.stiffness", -1.0, "be > 0"),
    (LINE % "stops = { stiffness = 1 }", f"{BEAM}.stops", "no side", "have a lower or an upper"),
    (LINE % "stops = { lower = 0.1 }", f"{BEAM}.stops.stiffness", None, "be given"),
    (LINE % "stops = { lower = 0.1, upper = 0, stiffness = 1 }", f"{BEAM}.stops.upper", 0, "be > stops.lower"),
    (LINE % "stops = [0.1]", f"{BEAM}.stops[0]", 0.1, "be a table"),
    (LINE % "base = { amplitude = 1 }", f"{BEAM}.base.frequency", None, "be given"),
    (LINE % "base = { sum = [{ constant = nan }] }", f"{BEAM}.base.sum[0].level", np.nan, "be finite"),
    (LINE % "base = { sampled = { t = [0, 1] } }", f"{BEAM}.base.sampled.values", None, "be given"),
    (LINE % "loads = [{}]", f"{BEAM}.loads[0].position", None, "be given"),
    (LINE % "loads = [{ position = 0.0, constant = 1 }]", f"{BEAM}.loads[0].position", 0.0, "be > 0"),
    (LINE % "loads = [{ position = 1.5, constant = 1 }]", f"{BEAM}.load.position", 1.5, "lie on the beam"),
    (LINE % "loads = [{ shape = [1], position = 1, constant = 1 }]", f"{BEAM}.loads[0].position", 1, "be a known"),
    (LINE % "initial_velocity = ['fast']", f"{BEAM}.initial_velocity", ["fast"], "be a list of polynomial"),
    (LINE % "initial_displacement = [0.0, 1.0]", f"{BEAM}.initial_displacement", 1.0, "have zero slope"),
    (PHYSICAL.replace("875.0", "-1.0"), f"{BEAM}.stiffness", -1.0, "be > 0"),
    (PHYSICAL + "units = { length = 3 }", f"{BEAM}.units", [3, "s", "N"], "be the names of the units"),
    (PHYSICAL + "bending_stiffness = 1.0", f"{BEAM}.bending_stiffness", 1.0, "be a known field"),
    (PLAIN + "[case.published]\nimpacts = 3", "mine.published.impacts", 3, "be a table"),
    (PLAIN + '[case.uncertain]\nviscosity = [2, 1]', "mine.uncertain.viscosity", [2.0, 1.0], "be a range of two"),
    (PLAIN + PLAIN, "name", "mine", "be given once"),
    ("", "case", None, "be one or more [[case]] tables"),
    ("case = [1]", "case", 1, "be a table"),
    ("title = 'x'\n" + PLAIN, "title", "x", "stand inside a [[case]] table"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "path", "value", "rule"), FAULTS, ids=[path for _, path, *_ in FAULTS])
def test_a_fault_names_file_path_value_and_rule(write, text, path, value, rule):
    with pytest.raises(sb.InputError) as caught:
        load_cases(file := write(text))
    assert caught.value.field == f"{file}: {path}"
    assert caught.value.rule.startswith(rule)
    np.testing.assert_equal(caught.value.value, value)


def entries(table, path=()):
    """(table, key) of every entry of tables in tables."""
    for key, value in table.items() if isinstance(table, dict) else enumerate(table):
        if isinstance(table, dict):
            yield table, key
        if isinstance(value, (dict, list)):
            yield from entries(value)


@pytest.mark.parametrize("name", ["table10", "full"])
def test_any_misspelt_field_is_refused_with_the_nearest_name(name):
    """Every field of every table of a case, with its last letter left out."""
    text = FULL if name == "full" else case_blocks(paper_text())[name]
    count = len(list(entries(tomllib.loads(text)["case"][0])))
    for i in range(count):
        data = tomllib.loads(text)
        table, key = list(entries(data["case"][0]))[i]
        if "@" in key or "(" in key or key in ("t", "impacts", "cpu_seconds", "x"):  # a run, or free names
            continue
        table[key[:-1] + "_"] = table.pop(key)
        with pytest.raises(
            sb.InputError, match=rf"be a known field.*{key}|{key} must be given|must be given, or|or shape = "
        ):
            _parse(data, "text")


@pytest.mark.parametrize("seed", range(60))
def test_any_damaged_text_is_one_sentence_or_a_case(seed, write):
    """Letters left out, doubled, exchanged with others of the file; what is no case is an InputError of one line."""
    rng, letters = np.random.default_rng([57, seed]), list(FULL)
    for place in rng.integers(0, len(letters), rng.integers(1, 4)):
        letters[place] = rng.choice(["", letters[place] * 2, letters[rng.integers(len(letters))], "-", '"', "e9"])
    file = write("".join(letters))
    try:
        said = str(load_cases(file))
    except sb.InputError as error:
        said = str(error) if "\n" not in str(error) and len(str(error)) <= 300 else ""
    assert said


def test_a_file_that_is_no_toml_or_not_there_is_named(write, tmp_path):
    broken = write("[[case]\nname = 'x'\n")
    with pytest.raises(sb.InputError, match=r"be valid TOML, got .*mine\.toml.*line 1"):
        load_cases(broken)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(sb.InputError, match=r"be valid TOML, got .*binary\.toml"):
        find_case(str(binary))
    with pytest.raises(sb.InputError, match=r"case file must exist, got .*none\.toml"):
        find_case(str(tmp_path / "none.toml"))


def test_a_bad_case_name_lists_near_ones():
    with pytest.raises(sb.InputError) as caught:
        find_case("tabel10")
    assert "got 'tabel10': did you mean table10" in str(caught.value)
    with pytest.raises(sb.InputError, match=r"known: table1, table2, .*, table17$"):
        find_case("cantilever")
    with pytest.raises(sb.InputError, match="got 'table18': did you mean"):
        sb.paper_case(18)
