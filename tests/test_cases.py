"""The paper's tables, the notation of runs, and case files of one's own."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stiffbeam as sb
from stiffbeam.cases import find_case, load_cases, paper_cases, paper_text, parse_run, split_runs
from stiffbeam.schemes import GAMMA_THIRD_ORDER, registered
from stiffbeam.schemes.sdirk import GAMMA_MIN

# ---------------------------------------------------------------- the paper's tables


def test_all_seventeen_tables_load_in_order():
    cases = paper_cases()
    assert list(cases) == [f"table{k}" for k in range(1, 18)]
    for case in cases.values():
        assert case.title
        assert case.runs
        assert case.cells in (25, 40, 50)
        assert abs(round(case.t_end / case.dt) * case.dt - case.t_end) < 1e-9 * case.t_end


# table: k^2, a, h, dt, g2, kappa, alpha (None: no HHT run), gamma (None: no SDIRK run)
PARAMETERS = {
    1: (8000.0, 10.0, 0.04, 1e-4, 0.1, 4e6, -0.1, None),
    3: (300.0, 10.0, 0.02, 2e-5, 0.001, 2e7, -0.1, None),
    4: (300.0, 60.0, 0.02, 1e-5, 0.001, 3e7, -0.3, None),
    6: (300.0, 10.0, 0.04, 1e-4, 0.1, 5e6, None, 1.0),
    10: (300.0, 10.0, 0.04, 1e-4, 0.1, 5e6, -0.1, 0.435866521508459),
    11: (300.0, 10.0, 0.025, 2.5e-5, 0.001, 2e7, -0.1, 0.435866521508459),
    12: (300.0, 60.0, 0.02, 1e-5, 0.001, 6e7, -0.1, 0.435866521508459),
    13: (300.0, 60.0, 0.02, 2e-5, 0.01, 4e7, -0.1, 0.435866521508459),
    17: (300.0, 60.0, 0.025, 2e-5, 0.1, 5e7, -0.1, None),
}


@pytest.mark.parametrize("table", PARAMETERS)
def test_a_table_has_the_papers_parameters(table):
    k2, a, h, dt, g2, kappa, alpha, gamma = PARAMETERS[table]
    case = sb.paper_case(table)
    problem = case.problem
    assert (problem.stiffness, problem.viscosity, case.dt) == (k2, 0.0, dt)
    assert 1.0 / case.cells == h
    assert problem.stops == sb.Stops(-g2, g2, stiffness=kappa)
    assert problem.base == sb.Harmonic(0.2, a)
    assert problem.loads == ()
    assert {s.alpha for s, _ in case.runs if isinstance(s, sb.HHT)} == ({alpha} if alpha is not None else set())
    assert {s.gamma for s, _ in case.runs if isinstance(s, sb.SDIRK)} == ({gamma} if gamma is not None else set())


def test_table_6_runs_sdirk_on_all_three_discretisations():
    runs = [(s.name, s.nystrom, form) for s, form in sb.paper_case(6).runs]
    assert runs == [
        ("sdirk", False, "velocity-curvature"),
        ("sdirk", False, "displacement"),
        ("sdirk", True, "displacement"),
    ]


def test_table_14_has_a_lower_stop_only():
    case = sb.paper_case(14)
    assert case.problem.stops == sb.Stops(lower=-0.001, stiffness=7e6)
    assert [s.alpha for s, _ in case.runs] == [-0.01]


@pytest.mark.parametrize(("table", "position"), [(15, 0.23), (16, 0.70)])
def test_tables_15_and_16_have_a_point_load_and_a_clamp_at_rest(table, position):
    problem = sb.paper_case(table).problem
    assert problem.stiffness == 282.84
    assert problem.base is None
    (load,) = problem.loads
    assert load.position == position
    t = np.linspace(0.0, 2.0, 9)
    assert np.max(np.abs(load.time.value(t) - 67.024 * np.cos(6.0 * t))) < 67.024 * 1e-14


@pytest.mark.parametrize(
    ("table", "kind", "hht", "sdirk"),
    [
        (10, "impacts", 3904, 4494),
        (10, "cpu_seconds", 15.59, 43.24),
        (11, "impacts", 291, 266),
        (12, "impacts", 688, 824),
        (13, "impacts", 2062, 1130),
    ],
)
def test_published_numbers_belong_to_the_runs(table, kind, hht, sdirk):
    case = sb.paper_case(table)
    by_run = {parse_run(name)[0].name: value for name, value in case.published[kind].items()}
    assert by_run == {"hht": hht, "sdirk": sdirk}


def test_every_published_number_is_of_a_run_the_case_makes():
    def key(scheme, form):
        return type(scheme), tuple(scheme.parameters.items()), form

    for case in paper_cases().values():
        runs = {key(*run) for run in case.runs}
        for numbers in case.published.values():
            assert {key(*parse_run(name)) for name in numbers} <= runs
            assert all(value > 0 for value in numbers.values())


def test_what_is_inferred_is_noted_with_its_reason():
    for case in paper_cases().values():
        noted = {note.partition(":")[0] for note in case.notes}
        assert {"initial data", "t_end"} <= noted
        assert all(note.partition(":")[2].strip() for note in case.notes)
        third = [s for s, _ in case.runs if isinstance(s, sb.SDIRK) and s.gamma == GAMMA_THIRD_ORDER]
        assert bool(third) == ("scheme" in noted)
        assert bool(case.problem.loads) == ("load" in noted)
    assert any(note.startswith("dt: printed 25 x 10^-5") for note in sb.paper_case(11).notes)


def test_the_papers_file_is_one_that_users_can_load(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(paper_text(), encoding="utf-8")
    mine = load_cases(file)
    assert list(mine) == list(paper_cases())
    for name, case in paper_cases().items():
        assert mine[name].problem == case.problem
        assert str(mine[name].runs) == str(case.runs)


# ---------------------------------------------------------------- the notation of runs

PRINTED = [sb.HHT(-0.2).printed(), sb.SDIRK().printed("sigma"), sb.SDIRK(1.0, nystrom=True).printed("stage-matrix")]


@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
@pytest.mark.parametrize("scheme", [*registered(), sb.Theta(0.75), *PRINTED], ids=str)
def test_a_run_reads_back_from_its_own_label(scheme, form):
    again, same_form = parse_run(f"{scheme}@{form}")
    assert type(again) is type(scheme)
    assert (again.parameters, again.erratum, same_form) == (scheme.parameters, scheme.erratum, form)


@given(st.integers(-333, 0))
def test_a_parameter_of_three_digits_reads_back_from_the_label(thousandths):
    scheme = sb.HHT(thousandths / 1000.0)
    assert parse_run(str(scheme))[0].alpha == scheme.alpha


@pytest.mark.parametrize("scheme", [sb.HHT(-1.0 / 3.0), sb.HHT(-0.12345678), sb.SDIRK(GAMMA_MIN)], ids=repr)
def test_a_parameter_of_many_digits_reads_back_from_the_label(scheme):
    assert parse_run(str(scheme))[0].parameters == scheme.parameters


def test_a_run_may_leave_out_what_has_a_default():
    scheme, form = parse_run(" hht ")
    assert (type(scheme), scheme.alpha, form) == (sb.HHT, -0.1, "displacement")
    assert parse_run("bdf2", "velocity-curvature")[1] == "velocity-curvature"
    assert parse_run("sdirk.printed")[0].erratum == "sigma"
    sdirk = parse_run("sdirk( gamma = 0.4359 , nystrom=TRUE ) @ displacement")[0]
    assert (sdirk.gamma, sdirk.nystrom) == (GAMMA_THIRD_ORDER, True)  # the paper's digits mean the root
    assert str(sdirk) == "sdirk(gamma=0.4359, nystrom=true)"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hhtt", "scheme must be a registered scheme, got 'hhtt': did you mean hht?"),
        ("xyz", "known: bdf2, sdirk, hht"),
        ("", "scheme must read name(parameter=value, ...)@form, got ''"),
        ("hht(alpha=-0.1", "scheme must read name(parameter=value, ...)@form"),
        ("hht@displacement@displacement", "e.g. hht(alpha=-0.1)@displacement"),
        ("hht(alpha=small)", "scheme must give alpha a number, true or false, got 'hht(alpha=small)'"),
        ("hht(alpha)", "scheme must name every parameter"),
        ("hht(alhpa=-0.1)", "'alhpa'"),
        ("hht(alpha=0.1)", "alpha must lie in [-0.333333, 0], got 0.1: if your alpha is in [0, 1/3], pass -alpha"),
        ("hht(alpha='-0.1')", "alpha must lie in [-0.333333, 0], got '-0.1'"),
        ("sdirk(gamma=0.1)", "outside it the scheme is not L-stable"),
        ("sdirk.printed(sgma)", "erratum must be one the paper prints for this scheme, got 'sgma': did you mean sigma"),
        ("bdf2.printed", "have a printed form"),
        ("bdf2@displacment", "form must be one of the paper's forms, got 'displacment': did you mean displacement?"),
    ],
)
def test_a_bad_run_is_refused_with_the_way_out(text, message):
    with pytest.raises(sb.InputError, match=re.escape(message)):
        parse_run(text)


def test_commas_inside_parentheses_belong_to_the_run():
    text = "bdf2, sdirk(gamma=0.5, nystrom=true)@displacement,sdirk.printed(sigma),"
    assert [part.strip() for part in split_runs(text)] == [
        "bdf2",
        "sdirk(gamma=0.5, nystrom=true)@displacement",
        "sdirk.printed(sigma)",
    ]


# ---------------------------------------------------------------- case files

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
    assert [f"{s.name}@{form}" for s, form in case.runs] == [
        "bdf2@displacement",
        "sdirk@displacement",
        "hht@displacement",
    ]
    assert (case.published, case.notes) == ({}, ())
    assert case.problem == sb.BeamProblem(stiffness=300.0)


def test_a_full_file_says_everything_that_python_can(write):
    case = find_case(
        str(
            write(
                HEAD.replace("cells", 'title = "All of it"\ncells')
                + """
runs = ["theta(theta=0.6)"]
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
"theta(theta=0.6)" = 3
"""
            )
        )
    )
    problem, x = case.problem, np.array([0.0, 0.5, 1.0])
    assert (case.title, case.notes) == ("All of it", ("dt: a guess",))
    assert case.published == {"impacts": {"theta(theta=0.6)": 3}}
    assert [(s.theta, form) for s, form in case.runs] == [(0.6, "displacement")]
    assert (problem.stiffness, problem.viscosity) == (300, 0.5)
    assert problem.stops == sb.Stops(upper=0.1, stiffness=1e6)
    assert problem.base == sb.Harmonic(0.2, 10, 0.5)
    assert problem.loads[:2] == (
        sb.PointLoad(0.5, sb.Harmonic(3.0, 2.0)),
        sb.PointLoad(1, sb.Constant(-4)),
    )
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
time_unit = 0.05
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
        time_unit=0.05,
        stops=sb.Stops(lower=-0.004, stiffness=2e4),
        base=sb.Harmonic(0.01, 60.0),
        loads=(sb.PointLoad(1.5, sb.Constant(5.0)),),
    )
    assert find_case(str(write(text))).problem == expected
    assert expected.units.length == 2.0


def test_a_case_among_several_is_named_after_a_colon(write):
    file = write(PLAIN + PLAIN.replace("mine", "other").replace("300.0", "500.0"))
    assert list(load_cases(file)) == ["mine", "other"]
    assert find_case(f"{file}:other").problem.stiffness == 500.0
    with pytest.raises(sb.InputError, match=re.escape(f"{file}:mine or {file}:other")):
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
        (PLAIN.replace("cells", 'runs = ["hhtt"]\ncells'), "mine: scheme", "hhtt", "be a registered scheme"),
        (PLAIN.replace("cells", 'runs = ["hht(alpha=0.2)"]\ncells'), "mine: alpha", 0.2, "lie in [-0.333333, 0]"),
        (PLAIN.replace("cells", 'runs = ["hht@disp"]\ncells'), "mine: form", "disp", "be one of the paper's forms"),
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
        (problem_with("stops = [0.1]"), "mine.problem: stops", [0.1], "be a table"),
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
        (PLAIN.replace("stiffness", "stifness"), "did you mean stiffness?"),
        (problem_with("base = { ampltude = 1, frequency = 1 }"), "did you mean amplitude?"),
        (PLAIN.replace("dt = 1e-3", "dt = 0.03"), "the nearest step that does is 0.0333333"),
        (PLAIN.replace("cells", 'runs = ["hhtt"]\ncells'), "did you mean hht?"),
        (PLAIN.replace("cells", 'runs = ["hht(alpha=0.2)"]\ncells'), "pass -alpha"),
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
