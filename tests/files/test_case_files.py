"""Case files of one's own: defaults, units, and what is said of bad fields."""

from __future__ import annotations

import re

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.files.cases import find_case, load_cases

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


def test_a_full_file_says_everything_that_python_can(write):
    case = find_case(
        str(
            write(
                HEAD.replace("cells", 'title = "All of it"\ncells')
                + """
runs = ["Theta(theta=0.6)"]
inferred = ["dt: a guess"]
[case.problem]
stiffness = 300
viscosity = 0.5
stops = { upper = 0.1, stiffness = 1e6 }
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
        )
    )
    problem, x = case.problem, np.array([0.0, 0.5, 1.0])
    assert (case.title, case.notes) == ("All of it", ("dt: a guess",))
    assert case.published == {"impacts": {"Theta(theta=0.6)": 3}}
    assert [(s.theta, form) for s, form in case.runs] == [(0.6, "displacement")]
    assert (problem.stiffness, problem.viscosity) == (300, 0.5)
    assert problem.stops == sb.Stops(upper=0.1, stiffness=1e6)
    assert problem.base == sb.Harmonic(0.2, 10, 0.5)
    assert problem.loads[:2] == (sb.PointLoad(0.5, sb.Harmonic(3.0, 2.0)), sb.PointLoad(1, sb.Constant(-4)))
    assert problem.loads[2].time == sb.Constant(7.0)
    assert np.allclose(problem.loads[2].shape(x), [1.0, 1.5, 3.0], rtol=1e-15)
    assert np.allclose(problem.initial_displacement(x), 0.2 * np.sin(0.5) + 0.25 * x**2, rtol=1e-14)
    assert np.allclose(problem.initial_velocity(x), 3.0 * x, rtol=1e-15)


def test_a_physical_file_is_read_in_metres_newtons_and_seconds(write):
    text = (
        HEAD
        + """
[case.problem]
length = 2.0
bending_stiffness = 875.0
mass_per_length = 3.925
bending_viscosity = 0.1
stops = { lower = -0.004, stiffness = 2e4 }
base = { amplitude = 0.01, frequency = 60.0 }
loads = [{ position = 1.5, constant = 5.0 }]
"""
    )
    expected = sb.BeamProblem.from_physical(
        length=2.0,
        bending_stiffness=875.0,
        mass_per_length=3.925,
        bending_viscosity=0.1,
        stops=sb.Stops(lower=-0.004, stiffness=2e4),
        base=sb.Harmonic(0.01, 60.0),
        loads=(sb.PointLoad(1.5, sb.Constant(5.0)),),
    )
    assert find_case(str(write(text))).problem == expected
    assert expected.units == ("m", "s", "N")


PHYSICAL = HEAD + "[case.problem]\nlength = 2.0\nbending_stiffness = 875.0\nmass_per_length = 3.925\n"


def test_a_physical_file_may_name_other_units(write):
    case = find_case(str(write(PHYSICAL + 'units = { length = "mm", time = "s", force = "N" }\n')))
    assert case.problem.units == ("mm", "s", "N")


def test_a_file_that_counts_times_in_another_unit_is_told_what_to_write(write):
    assert find_case(str(write(PHYSICAL + "time_unit = 1.0\n"))).problem.length == 2.0
    with pytest.raises(sb.InputError, match=r"time_unit must be 1, got 0\.05: .* give dt and t_end in seconds"):
        find_case(str(write(PHYSICAL + "time_unit = 0.05\n", "old.toml")))


def test_a_case_among_several_is_named_after_a_colon(write):
    file = write(PLAIN + PLAIN.replace("mine", "other").replace("300.0", "500.0"))
    assert list(load_cases(file)) == ["mine", "other"]
    assert find_case(f"{file}:other").problem.stiffness == 500.0
    with pytest.raises(sb.InputError, match=re.escape("add :mine or :other to it")):
        find_case(str(file))
    with pytest.raises(sb.InputError, match=r"got 'othre': did you mean other\?") as caught:
        find_case(f"{file}:othre")
    assert str(file) in str(caught.value)


def problem_with(line):
    return PLAIN + line + "\n"


@pytest.mark.parametrize(
    ("text", "field", "value", "rule"),
    [
        (HEAD, "mine: problem", None, "be given and be a table"),
        (HEAD + "problem = 3", "mine: problem", 3, "be a table"),
        (PLAIN.replace('name = "mine"', ""), "case: name", None, "be given and be a string"),
        (PLAIN.replace('"mine"', "7"), "7: name", 7, "be a string"),
        (PLAIN.replace("cells = 8", ""), "mine: cells", None, "be given and be an integer >= 4"),
        (PLAIN.replace("cells = 8", "cells = 3"), "mine: cells", 3, "be an integer >= 4"),
        (PLAIN.replace("cells = 8", "cells = 8.0"), "mine: cells", 8.0, "be an integer >= 4"),
        (PLAIN.replace("cells = 8", "cells = true"), "mine: cells", True, "be an integer >= 4"),
        (PLAIN.replace("cells", "cels"), "mine: cels", 8, "be a known field"),
        (PLAIN.replace("dt = 1e-3", 'dt = "small"'), "mine: dt", "small", "be a number"),
        (PLAIN.replace("dt = 1e-3", "dt = true"), "mine: dt", True, "be a number"),
        (PLAIN.replace("dt = 1e-3", "dt = 0.0"), "mine: dt", 0.0, "be > 0"),
        (PLAIN.replace("dt = 1e-3", "dt = 0.03"), "mine: dt", 0.03, "divide t_end = 0.1"),
        (PLAIN.replace("dt = 1e-3", "dt = 1.0"), "mine: dt", 1.0, "divide t_end = 0.1"),
        (PLAIN.replace("t_end = 0.1", ""), "mine: t_end", None, "be given and be a number"),
        (PLAIN.replace("t_end = 0.1", "t_end = -1"), "mine: t_end", -1, "be > 0"),
        (PLAIN.replace("cells", 'runs = "hht"\ncells'), "mine: runs", "hht", "be a list of runs"),
        (PLAIN.replace("cells", "runs = [1]\ncells"), "mine: runs", 1, "be strings like"),
        (PLAIN.replace("cells", 'runs = ["this:Zen"]\ncells'), "mine: runs", "this:Zen", "be schemes of the package"),
        (PLAIN.replace("cells", 'runs = ["hhtt"]\ncells'), "mine: scheme", "hhtt", "be a registered scheme"),
        (PLAIN.replace("cells", 'runs = ["HHT(alpha=0.2)"]\ncells'), "mine: alpha", 0.2, "lie in [-0.333333, 0]"),
        (PLAIN.replace("cells", 'runs = ["HHT@disp"]\ncells'), "mine: form", "disp", "be one that there is"),
        (PLAIN.replace("300.0", '"stiff"'), "mine.problem: stiffness", "stiff", "be a number"),
        (PLAIN.replace("300.0", "true"), "mine.problem: stiffness", True, "be a number"),
        (PLAIN.replace("300.0", "-1.0"), "mine.problem: stiffness", -1.0, "be > 0"),
        (PLAIN.replace("stiffness", "stifness"), "mine.problem: stifness", 300.0, "be a known field"),
        (problem_with("viscosity = -1"), "mine.problem: viscosity", -1, "be >= 0"),
        (problem_with("stops = { stiffness = 1 }"), "mine.problem.stops: stops", "no side", "have a lower or an upper"),
        (problem_with("stops = { lower = 0.1 }"), "mine.problem.stops: stiffness", None, "be given and be a number"),
        (
            problem_with("stops = { lower = 0.1, upper = 0.0, stiffness = 1 }"),
            "mine.problem.stops: stops.upper", 0.0, "be > stops.lower = 0.1",
        ),
        (
            problem_with("stops = { loewr = 0.1, stiffness = 1 }"),
            "mine.problem.stops: loewr", 0.1, "be a known field",
        ),
        (problem_with("stops = [0.1]"), "mine.problem: stops[0]", 0.1, "be a table"),
        (problem_with("base = { amplitude = 1 }"), "mine.problem.base: frequency", None, "be given and be a number"),
        (problem_with("base = { amplitude = 1, frequency = 0 }"), "mine.problem.base: frequency", 0, "be > 0"),
        (problem_with("base = { constant = nan }"), "mine.problem.base: level", np.nan, "be finite"),
        (problem_with("loads = { position = 1 }"), "mine.problem: loads", {"position": 1}, "be a list of tables"),
        (problem_with("loads = [{}]"), "mine.problem.loads[0]: position", None, "be given and be a number"),
        (
            problem_with("loads = [{ position = 0.0, constant = 1 }]"),
            "mine.problem.loads[0]: load.position", 0.0, "be > 0",
        ),
        (
            problem_with("loads = [{ position = 1.5, constant = 1 }]"),
            "mine.problem: load.position", 1.5, "lie on the beam",
        ),
        (
            problem_with("loads = [{ shape = [1], position = 1, constant = 1 }]"),
            "mine.problem.loads[0]: position", 1, "be a known field",
        ),
        (
            problem_with("loads = [{ shape = [], constant = 1 }]"),
            "mine.problem.loads[0]: shape", [], "be a list of polynomial coefficients",
        ),
        (
            problem_with("initial_velocity = ['fast']"),
            "mine.problem: initial_velocity", ["fast"], "be a list of polynomial coefficients",
        ),
        (
            problem_with("initial_displacement = [0.0, 1.0]"),
            "mine.problem: initial_displacement", 1.0, "have zero slope",
        ),
        (
            HEAD + "[case.problem]\nlength = 2.0\nmass_per_length = 1.0\n",
            "mine.problem: bending_stiffness", None, "be given and be a number",
        ),
        (
            HEAD + "[case.problem]\nlength = -2.0\nmass_per_length = 1.0\nbending_stiffness = 1.0",
            "mine.problem: length", -2.0, "be > 0",
        ),
        (
            PHYSICAL + "units = { length = 1 }",
            "mine.problem.units: units", [1, "s", "N"], "be the names of the units",
        ),
        (problem_with('units = { length = "m" }'), "mine.problem: units", {"length": "m"}, "be a known field"),
        (PLAIN + "length = 2.0\n", "mine.problem: stiffness", 300.0, "be a known field"),
        (PLAIN + PLAIN, "name", "mine", "be given once"),
        ("", "case", None, "be one or more [[case]] tables"),
        ("case = []", "case", [], "be one or more [[case]] tables"),
        ("title = 'x'\n" + PLAIN, "title", "x", "stand inside a [[case]] table"),
    ],
)  # fmt: skip
def test_a_bad_field_names_file_field_value_and_rule(write, text, field, value, rule):
    file = write(text)
    with pytest.raises(sb.InputError) as caught:
        load_cases(file)
    error = caught.value
    assert error.field == f"{file}: {field}"
    assert error.rule.startswith(rule)
    np.testing.assert_equal(error.value, value)
    assert str(error).startswith(f"{file}: {field} must {error.rule}, got {error.value!r}")


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        (PLAIN.replace("cells", "cels"), "did you mean cells"),
        (problem_with("base = { time = 1 }"), "constant, frequency, phase, sampled, sum"),
        (PLAIN.replace("stiffness", "stifness"), "did you mean stiffness"),
        (problem_with("base = { ampltude = 1, frequency = 1 }"), "did you mean amplitude"),
        (PLAIN.replace("dt = 1e-3", "dt = 0.03"), "the nearest step that does is 0.0333333"),
        (PLAIN.replace("cells", 'runs = ["hhtt"]\ncells'), "did you mean HHT?"),
        (PLAIN.replace("cells", 'runs = ["HHT(alpha=0.2)"]\ncells'), "pass -alpha"),
        (PLAIN.replace("cells", 'form = "hermite"\ncells'), 'runs = ["HHT@hermite"]'),
        (problem_with('units = { length = "mm" }'), "write length, bending_stiffness and mass_per_length"),
        (problem_with("base = 0.1"), "it is a number: write base = { ... }"),
        (problem_with("initial_displacement = 1"), "it is an integer: write initial_displacement = [...]"),
        (PLAIN.replace('name = "mine"', "name = 3"), 'it is an integer: write name = "..."'),
    ],
)
def test_a_bad_field_is_answered_with_the_near_one(write, text, remedy):
    with pytest.raises(sb.InputError, match=re.escape(remedy)):
        load_cases(write(text))


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


@pytest.mark.parametrize("text", ["case = [1]", PLAIN + "loads = [1]\n", PLAIN + "loads = ['shape']\n"])
def test_a_list_entry_that_is_no_table_is_named(write, text):
    with pytest.raises(sb.InputError, match="be a table"):
        load_cases(write(text))


def test_a_folder_given_as_a_case_file_is_named(tmp_path):
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    with pytest.raises(sb.InputError, match=r"folder\.toml"):
        find_case(str(folder))


def test_a_bad_case_name_lists_near_ones():
    with pytest.raises(sb.InputError) as caught:
        find_case("tabel10")
    assert "got 'tabel10': did you mean table10" in str(caught.value)
    with pytest.raises(sb.InputError, match=r"known: table1, table2, .*, table17$"):
        find_case("cantilever")
    with pytest.raises(sb.InputError, match="got 'table18': did you mean"):
        sb.paper_case(18)
