"""Case files of one's own, of beams and of matrices, and columns of numbers as others write them."""

from __future__ import annotations

import json
import os
import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from systems import bouncing_chain

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.files import case_blocks, columns, paper_text
from stiffbeam.files.cases import Case, _parse, case_of, default_schemes, find_case, load_cases
from stiffbeam.files.columns import read_samples

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
    assert replace(case, runs=()) == Case("mine", "mine", sb.BeamProblem(stiffness=300.0), 8, 1e-3, 0.1, ())
    assert [(str(scheme), form) for scheme, form in case.runs] == [(str(x), "displacement") for x in default_schemes()]


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
    moving = sb.Stops(-0.03, stiffness=4e4, position=0.6, motion=sb.Harmonic(0.004, "pi/5"))
    loads = [
        sb.PointLoad(0.5, sb.Harmonic(3.0, 2.0)), sb.PointLoad(1, sb.Constant(-4)),
        sb.DistributedLoad(sb.PolynomialProfile([1.0, 0.0, 2.0]), sb.Constant(7.0)),
    ]  # fmt: skip
    assert case.problem == sb.BeamProblem(
        stiffness=300, viscosity=0.5, length=1.5, mass_per_length=0.7, mass_damping=0.3, modal_damping=(0.01, 0.02),
        tip_mass=0.4, supports="clamped-free", stops=[sb.Stops(upper=0.1, stiffness=1e6), moving],
        base=sb.Harmonic(0.2, 10, 0.5), loads=loads, initial_velocity=sb.PolynomialProfile([0.0, 3.0]),
        initial_displacement=sb.PolynomialProfile([0.2 * np.sin(0.5), 0.0, 0.25]),
    )  # fmt: skip
    assert (case.title, case.notes) == ("All of it", ("dt: a guess",))
    assert case.published == {"impacts": {"Theta(theta=0.6)": 3}}
    assert [(str(scheme), form) for scheme, form in case.runs] == [("Theta(theta=0.6)", "hermite")]


def test_a_case_among_several_is_named_after_a_colon(write):
    file = write(PLAIN + PLAIN.replace("mine", "other").replace("300.0", "500.0"))
    assert list(load_cases(file)) == ["mine", "other"]
    assert find_case(f"{file}:other").problem.stiffness == 500.0


BEAM, LINE = "mine.problem", PLAIN + "%s\n"
FAULTS = [  # text, field, value, rule
    (HEAD, "mine.problem", None, "be given, or a system"),
    (HEAD + "problem = 3", BEAM, 3, "be a table"),
    (PLAIN.replace('name = "mine"', ""), "case.name", None, "be given"),
    (PLAIN.replace('"mine"', "7"), "7.name", 7, "be a text"),
    (PLAIN.replace("cells = 8", ""), "mine.cells", None, "be an integer >= 4"),
    (PLAIN.replace("cells = 8", "cells = 3"), "mine.cells", 3, "be an integer >= 4"),
    (PLAIN.replace("dt = 1e-3", 'dt = "small"'), "mine.dt", "small", "be a number"),
    (PLAIN.replace("dt = 1e-3", "dt = 0.03"), "mine.dt", 0.03, "divide t_end = 0.1"),
    (PLAIN.replace("cells", 'runs = "hht"\ncells'), "mine.runs", "hht", "be a list"),
    (PLAIN.replace("cells", "runs = [1]\ncells"), "mine.runs[0]", 1, "be a text"),
    (PLAIN.replace("cells", 'runs = ["this:Zen"]\ncells'), "mine.runs", "this:Zen", "be schemes of the package"),
    (PLAIN.replace("cells", 'runs = ["HHT(alpha=0.2)"]\ncells'), "mine.alpha", 0.2, "lie in [-0.333333, 0]"),
    (PLAIN.replace("300.0", "true"), f"{BEAM}.stiffness", True, "be a number"),
    (LINE % "stops = { stiffness = 1 }", f"{BEAM}.stops", "no side", "have a lower or an upper"),
    (LINE % "stops = { lower = 0.1, upper = 0, stiffness = 1 }", f"{BEAM}.stops.upper", 0, "be > stops.lower"),
    (LINE % "stops = [0.1]", f"{BEAM}.stops[0]", 0.1, "be a table"),
    (LINE % "base = { sum = [{ constant = nan }] }", f"{BEAM}.base.sum[0].level", np.nan, "be finite"),
    (LINE % "base = { sampled = { t = [0, 1] } }", f"{BEAM}.base.sampled.values", None, "be given"),
    (LINE % "loads = [{}]", f"{BEAM}.loads[0].position", None, "be given"),
    (LINE % "loads = [{ position = 1.5, constant = 1 }]", f"{BEAM}.load.position", 1.5, "lie on the beam"),
    (LINE % "loads = [{ shape = [1], position = 1, constant = 1 }]", f"{BEAM}.loads[0].position", 1, "be a known"),
    (LINE % "initial_velocity = ['fast']", f"{BEAM}.initial_velocity.coefficients", "fast", "be a number"),
    (LINE % "initial_velocity = 3.0", f"{BEAM}.initial_velocity.coefficients", 3.0, "be one number or more"),
    (LINE % "initial_displacement = [0.0, 1.0]", f"{BEAM}.initial_displacement", 1.0, "have zero slope"),
    (LINE % "units = { length = 3 }", f"{BEAM}.units", [3, "s", "N"], "be the names of the units"),
    (PLAIN + "[case.published]\nimpacts = 3", "mine.published.impacts", 3, "be a table"),
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


def entries(table):
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


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("two.toml", "add :mine or :other to it"), ("two.toml:othre", r"two\.toml, got 'othre': did you mean other\?"),
        ("broken.toml", r"be valid TOML, got .*broken\.toml.*line 1"), ("binary.toml", "be valid TOML"),
        ("none.toml", r"file, got .*none\.toml.*: it does not exist"), ("tabel10", "'tabel10': did you mean table10"),
        ("cantilever", "known: table1, table2, .*, table17$"), ("table18", "got 'table18': did you mean"),
    ],
)  # fmt: skip
def test_what_is_no_case_is_named_with_what_is_near(name, words, write, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(PLAIN + PLAIN.replace("mine", "other"), "two.toml")
    write("[[case]\nname = 'x'\n", "broken.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(sb.InputError, match=words):
        find_case(name)


# ---------------------------------------------------------------- systems of matrices

TEXT = """
[[case]]
name = "chain"
dt = 1e-3
t_end = 8.0
runs = ["HHT(alpha=-0.1)", "bdf2"]
[case.system]
mass = "M.mtx"
stiffness = "K.npz"
damping = "C.npy"
loads = [
  { row = [0.0, 0.0, 1.0], amplitude = 6.0, frequency = 2.2, phase = 0.3 },
  { row = { 0 = 1.0 }, sampled = "push.csv", kind = "cubic" },
]
observe = "row.npy"
initial_velocity = { 0 = 0.2, 2 = 1 }
[[case.system.contacts]]
row = { 1 = 0.2, 2 = 1.0 }
lower = -0.35
upper = 0.25
stiffness = 900.0
offset = { amplitude = 0.05, frequency = 1.1 }
[[case.system.contacts]]
row = [1.0, 0.0, 0.0]
upper = 0.2
stiffness = 500.0
"""
MASS, STIFFNESS = bouncing_chain().mass, bouncing_chain().stiffness
TIMES = np.linspace(0.0, 8.0, 41)


@pytest.fixture
def file(tmp_path):
    """The case with its matrices in a folder of their own: paths are relative to the file."""
    folder = tmp_path / "model"
    folder.mkdir()
    scipy.io.mmwrite(folder / "M.mtx", scipy.sparse.coo_array(MASS), symmetry="symmetric", precision=17)
    scipy.sparse.save_npz(folder / "K.npz", scipy.sparse.csr_array(STIFFNESS))
    np.save(folder / "C.npy", 1e-3 * STIFFNESS)
    np.save(folder / "row.npy", np.array([0.0, 0.0, 1.0]))
    lines = [f"{t!r},{v!r}" for t, v in zip(TIMES.tolist(), np.cos(TIMES).tolist(), strict=True)]
    (folder / "push.csv").write_text("t,force\n" + "\n".join(lines))
    (folder / "chain.toml").write_text(TEXT)
    return folder / "chain.toml"


def own_system() -> sb.System:
    chain = bouncing_chain(damping=1e-3 * STIFFNESS, observe=[0.0, 0.0, 1.0])
    push = [1.0, 0.0, 0.0], sb.Sampled(TIMES, np.cos(TIMES), "cubic")
    other = sb.Contact([1.0, 0.0, 0.0], sb.Stops(None, 0.2, stiffness=500.0))
    return replace(chain, loads=(chain.loads[0], push), contacts=(*chain.contacts, other))


def test_matrices_have_the_units_that_are_stated(file):
    """In a case file and in Python; a changed or reduced system keeps them, and its runs and files have them."""
    named = TEXT.replace("observe =", 'units = { length = "mm", time = "ms", force = "kN" }\nobserve =')
    file.write_text(named)
    system, units = find_case(str(file)).system(), ("mm", "ms", "kN")
    assert system.units == units
    assert find_case(str(file)).units == units
    own = own_system()
    assert own.units != units
    assert replace(own, units=units).fingerprint != own.fingerprint  # a cache must not mix them
    assert replace(own, units=own.units).fingerprint == own.fingerprint
    assert replace(system, stiffness=2.0 * STIFFNESS).units == units
    stop = sb.Contact([0, 0, 1], sb.Stops(upper=0.1, stiffness=1e3))
    assert sb.reduce_model(MASS, STIFFNESS, contacts=[stop], modes=2, units=units)[0].units == units
    run = sb.integrate(system, sb.HHT(), 1e-2, 1.0)
    assert sb.load(run.save(file.parent / "run.nc")).units == units
    assert "(kN)" in str(sb.compare(run, sb.reference(system, 1.0)))


def damped(system, ratio):
    return replace(system, damping=system.damping + sb.modal_damping(system.mass, system.stiffness, ratio))


def parts(own: sb.System) -> dict:
    names = ("stiffness", "damping", "loads", "contacts", "observe")
    return {name: getattr(own, name) for name in names} | {"initial_velocity": own.v0}


SAME = [  # a line of the file in place of its mass, and the same in Python
    ('mass = "M.mtx"', lambda own: own),
    ('mass = "M.mtx"\nmodes = 1\nmodal_damping = 0.003',
     lambda own: damped(sb.reduce_model(own.mass, **parts(own), modes=1)[0], 0.003)),
    ("mass = [1, 2, 3]", lambda own: sb.System.from_matrices(np.diag([1.0, 2.0, 3.0]), **parts(own))),
    ("mass = [1, 2, 3]", lambda own: sb.System.from_matrices([1, 2, 3], **parts(own))),
    ('mass = "M.mtx"\nmodal_damping = [0.02]',
     lambda own: damped(own, [0.02])),
]  # fmt: skip


@pytest.mark.parametrize(("line", "python"), SAME, ids=[line for line, _ in SAME])
def test_a_file_makes_the_system_that_python_makes(file, line, python):
    """Every number of it: the motions to the last bit, and the exact decimals of the file beside them."""
    file.write_text(TEXT.replace('mass = "M.mtx"', line, 1))
    case, wanted = find_case(str(file)), python(own_system())
    found = case.system()
    assert (case.has_stops, case.grid, case.forms) == (True, "3 unknowns", ("matrices",))
    for name in ("mass", "damping", "stiffness", "q0", "v0", "observe"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))
    runs = [sb.integrate(x, sb.HHT(alpha=-0.1), 1e-3, 8.0) for x in (found, wanted)]
    np.testing.assert_array_equal(runs[0].tip, runs[1].tip)
    assert runs[0].contacts[1].impacts.count > 0
    assert any(text.startswith("contacts") for text in found.exact_parameters)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"M.mtx"', '"missing.mtx"', "mass must be a regular file that exists"),
        ('"M.mtx"', '"M.csv"', ".mtx, .npz, .npy"),
        ('"M.mtx"', '"two.npz"', "be a readable matrix in .npz"),
        ('"M.mtx"', '"model.mat"', r"mass must be a file of .*: write the matrix by scipy.io.mmwrite"),
        ('"M.mtx"', '"pickled.npy"', "be a readable matrix"),
        ('"M.mtx"', '"abaqus.mtx"', r"mass must be a readable matrix in .mtx, got .*: write it by scipy.io.mmwrite"),
        ("upper = 0.2\n", "upper = 0.2\nscale = 2.0\n", r"got 2.0: .*known: damping, .*upper"),
        ('"M.mtx"', "[[1.0, 0.0], [0.0]]", "every row as long"),
        ('"M.mtx"', '"/dev/zero"', "be a file"),
        ('"push.csv"', '"/dev/zero"', "a folder, a device or a pipe"),
        ("{ 0 = 1.0 }", "{ }", "be on an unknown"),
        ("{ 0 = 1.0 }", "{ 3 = 1.0 }", "of an unknown from 0 to 2"),
        ("{ 0 = 1.0 }", '{ "²" = 1.0 }', "of an unknown from 0 to 2"),
        ("[1.0, 0.0, 0.0]", "[1.0, 0.0]", "hold 3 numbers"),
        ('"bdf2"]', '"BDF2@hermite"]', "be without a form"),
        ("upper = 0.2\n", "upper = 0.2\nmotion = { constant = 0.1 }\n", "known field"),
        ("[case.system]", "[case.system]\nunits = { length = 1 }", "units"),
        ("[case.system]", "[case.system]\nmodes = 2.5", "modes"),
        ("[case.system]", "[case.system]\nmodes = 3", "modes"),
        ("[case.system]", "[case.system]\nmodal_damping = -0.02", "modal_damping"),
        ("[case.system]", "[case.problem]\nstiffness = 1.0\n[case.system]", "stand alone"),
    ],
)
def test_what_is_wrong_is_said(file, old, new, words):
    np.savez(file.parent / "two.npz", a=MASS, b=MASS)
    np.save(file.parent / "pickled.npy", np.array([{}], dtype=object))
    (file.parent / "abaqus.mtx").write_text("1,1, 1,1, 2.0\n")
    file.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        find_case(str(file))


def test_a_beam_that_is_given_as_its_system_keeps_its_grid():
    """But not where matrices or data are no longer those of the grid."""
    beam = sb.BeamProblem(stiffness=300.0, base=sb.Harmonic(0.2, 10.0))
    system = sb.semidiscretise(beam, 8)
    case = case_of(system, 1e-3, 0.1)
    assert (case.problem, case.cells) == (beam, 8)
    for changed in (replace(system, stiffness=2.0 * system.stiffness), replace(system, v0=system.v0 + 1.0)):
        assert case_of(changed, 1e-3, 0.1).problem is None


@pytest.mark.slow
def test_the_commands_take_the_file(file, command):
    """compare, with sampled loads and damping; many digits say why not."""
    code, out, err = command("compare", str(file), "--t-end", "1", "--references", "exact", "--json", "-")
    assert code == 0, err
    found = json.loads(out)
    assert (found["case"], found["cells"]) == ("chain", None)
    assert {f"{x}@matrices" for x in ("HHT(alpha=-0.1)", "BDF2", "exact")} <= set(re.findall(r'[^\s"]+@matrices', out))
    code, out, err = command("reference", str(file), "--t-end", "0.3", "--method", "multiprecision", "--out", "r.nc")
    assert code == 2
    assert "use the method exact" in err


# ---------------------------------------------------------------- columns of numbers

T, F = np.arange(12) * 0.25, np.array([0.0, 3.5, -1.25, 2.0, 0.5, -7.0, 1.0, 0.25, -0.5, 4.0, 1.5, 0.0])


@pytest.fixture
def read(tmp_path):
    def samples(text, *options, encoding="utf-8", **more):
        file = tmp_path / "record.csv"
        file.write_text(text, encoding=encoding)
        return read_samples(file, *options, **more)

    return samples


def lines(form, times=T, comma=False):
    rows = (form.format(i=i, t=repr(float(t)), f=repr(float(f))) for i, (t, f) in enumerate(zip(times, F, strict=True)))
    return "\n".join(row.replace(".", ",") if comma else row for row in rows) + "\n"


WRITTEN = {
    "two columns": lines("{t},{f}"), "blanks": lines("  {t}   {f}"), "tabs": lines("{t}\t{f}"),
    "names": "t,force\n" + lines("{t},{f}"), "Excel": "\ufeffTime [s];Kraft [N]\r\n" + lines("{t};{f}", comma=True),
    "swapped": "force,time\n" + lines("{f},{t}"), "pandas": ",t,force\n" + lines("{i},{t},{f}"),
    "numpy": "# force t\n" + lines("{f} {t}"), "comments": "# a logger\n% more\n\n" + lines("{t} {f}") + "# end\n",
    "decimal commas and blanks": lines("{t} {f}", comma=True), "quotes": '"t","F"\n' + lines('"{t}","{f}"'),
    "quoted commas": '"t","F"\n' + lines('"{t}";"{f}"', comma=True), "spaced": lines("{t} ; {f}", comma=True),
    "quoted comment": '"# of a logger"\n' + lines("{t},{f}"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRITTEN)
def test_one_record_is_the_same_however_it_is_written(kind, read):
    for encoding in ("utf-8", "utf-8", "latin-1") if "\ufeff" not in WRITTEN[kind] else ("utf-8",):
        t, values = read(WRITTEN[kind], encoding=encoding)
        np.testing.assert_array_equal(t, T)
        np.testing.assert_array_equal(values, F)


def test_times_are_scaled_shifted_and_made(read):
    ms = "time [ms];F\n" + lines("{t};{f}", 1000.0 * T)
    np.testing.assert_allclose(read(ms, time_factor=1e-3)[0], T, rtol=1e-15)
    np.testing.assert_allclose(read(lines("{t},{f}", 1e6 + T), start=0.0)[0], T, atol=1e-9)
    with pytest.raises(sb.InputError, match="increase"):
        sb.Sampled(*read(lines("{f},{t}")))
    with pytest.raises(sb.InputError, match="by start = 0"):
        sb.Sampled(*read(lines("{t},{f}", 1e6 + T))).value(0.0)
    np.testing.assert_array_equal(read(lines("{f}"), dt=0.25)[0], T)
    np.testing.assert_array_equal(read("a,b\n" + lines("{i},{f}"), "b", dt=0.25, start=1.0)[0], 1.0 + T)
    np.testing.assert_array_equal(read("t,gain,force\n" + lines("{t},1,{f}"), "force")[1], F)


def test_times_in_another_unit_than_the_case_want_their_factor(read, tmp_path):
    """The name of the column has the unit; a case without a unit of time takes seconds only."""
    rows = lines("{t};{f}")
    for unit, units in (("ms", ()), ("min", ("m", "s", "N")), ("s", ("m", "ms", "N")), ("sec", ("m", "s", "N"))):
        for name in (f"time [{unit}]", f"Time ({unit})", f"t / {unit}", f"time, {unit}"):
            with pytest.raises(sb.InputError, match=rf"have its times in \w+, as the case.*in one {unit}"):
                read(f"{name};F\n{rows}", units=units)
            np.testing.assert_array_equal(read(f"{name};F\n{rows}", time_factor=0.5, units=units)[0], 0.5 * T)
        for name in (f"time_{unit}", f"time in {unit}", f"time {unit}"):
            with pytest.raises(sb.InputError, match=r"have one column of times.*name the times t"):
                read(f"{name};F\n{rows}", units=units)
    with pytest.raises(sb.InputError, match="the s in one ms"):
        read("# time [ms], F\n" + lines("{t} {f}"))
    np.testing.assert_array_equal(read(f"time [s];F\n{rows}")[0], T)
    (tmp_path / "c.toml").write_text(
        '[[case]]\nname = "c"\ndt = 1.0\nt_end = 10.0\nsystem = { mass = [[1.0]], stiffness = [[1.0]], observe = [1.0]'
        ', units = { time = "ms" }, loads = [{ row = [1.0], sampled = "record.csv" }] }\n'
    )
    read(f"time [ms];F\n{rows}", units=("m", "ms", "N"))
    (case,) = sb.load_cases(tmp_path / "c.toml").values()
    np.testing.assert_array_equal(case.system().loads[0][1].t, T)
    read(f"time [s];F\n{rows}")
    with pytest.raises(sb.InputError, match="have its times in ms"):
        sb.load_cases(tmp_path / "c.toml")


REFUSED = [  # text, options, words
    *((f"{name},F\n" + lines("{i},{f}"), {}, "have one column of times.*give dt") for name in ("index", "sample", "x")),
    ("sample no,F\n" + lines("{i},{f}"), {}, "have one column of times"), (lines("{i},{f}"), {}, "row numbers.*dt"),
    ("t;acc (mm/s^2)\n" + lines("{t};{f}"), {"units": ("m", "s", "N")}, "units of the case, m, s, N"),
    (lines("{i},{t},{f}"), {"column": "b"}, "row numbers"),
    (lines("{f}"), {}, "give dt"), ("t,F\n" + lines("{t},{f}"), {"dt": 0.1}, "dt must be left out"),
    ("t,time\n" + lines("{t},{f}"), {}, "have one column of times"), ("", {}, "lines of numbers"),
    ("t,F\n", {}, "lines of numbers"), ("0,1\n1,\n", {}, "line 2: ''.*into every cell"),
    ("0,1\n1,nan\n", {}, "line 2: 'nan'"), ("0,1\n1,2,3\n", {}, "line 2: 3 columns"),
    ("t,F,F\n0,1,2\n1,1,3\n", {"column": "F"}, "name of one column"),
    ("t,F,G\n0,1,2\n1,1,3\n", {"column": "H"}, "name of one column.*'F', 'G'"),
    ("t,F,G\n0,1,2\n1,1,3\n", {"column": "t"}, "column of values.*has 'F', 'G'"),
    ("t,F,G\n0,1,2\n1,1,3\n", {}, "got None: it has 'F', 'G'"),
    ("Time;Force\n[s];[N]\n0;1\n1;1\n", {}, r"line 2: '\[s\]'.*below the names"),
    ("t,F,G\n0,1\n1,2\n", {}, "as many names as columns, 2"), (",\n0,1\n", {}, "as many names as columns"),
    ("t,F\nx,1\n1,2\n", {}, "line 2: 'x'"), ("nan\n1\n", {"dt": 0.1}, "line 1: 'nan'"),
    ('t,F\n0,1\n1,"2\n', {}, "inside string"), ("0,1\n1,\x002\n", {}, "line 2: "),
    ("t,\x1b[2J\n0,1\n1,2\n", {"column": "F"}, r"\\x1b\[2J"),
    ("t,F\n0,1\n1," + 200_000 * "1", {}, "line 3: .11"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "options", "words"), REFUSED, ids=[words for *_, words in REFUSED])
def test_what_may_be_misread_is_refused(text, options, words, read):
    with pytest.raises(sb.InputError, match=words) as caught:
        read(text, **options)
    assert "\x1b" not in str(caught.value)


def test_holes_are_named_but_where_nothing_acts(read):
    kept = np.delete(np.arange(12), [5, 6])
    text = "\n".join(f"{t!r},{f!r}" for t, f in zip(T[kept].tolist(), F[kept].tolist(), strict=True))
    with pytest.warns(UserWarning, match="1 place, first from t = 1 to 1.75"):
        read(text + "\n" + "\n".join(f"{3 + 0.25 * k},{k % 2}" for k in range(20)))
    t, _ = read(text[: text.index("1.75")] + "\n".join(f"{1.25 + 0.25 * k},0" for k in range(9)) + "\n99,0\n")
    assert t[-1] == 99.0


@pytest.mark.parametrize("seed", range(40))
def test_any_damaged_record_is_one_sentence_or_numbers(seed, read):
    rng = np.random.default_rng([60, seed])
    text = list(WRITTEN[rng.choice(list(WRITTEN))])
    for place in rng.integers(0, len(text), 3):
        text[place] = rng.choice(["", ",", ";", "\t", "x", "\n", "-", '"', "\x00", "1e999"])
    try:
        t, values = read("".join(text))
        said = "numbers" if np.all(np.isfinite(t)) and len(t) == len(values) else ""
    except sb.InputError as error:
        said = str(error) if "record.csv" in str(error) or "time_factor" in str(error) else ""
    assert said
    assert "\n" not in said


def test_regular_files_of_a_largest_size_alone_are_read(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe.csv")
    for name in ("/dev/zero", tmp_path / "pipe.csv", tmp_path, tmp_path / "none.csv"):
        with pytest.raises(sb.InputError, match="be a readable file"):
            read_samples(tmp_path / name)
        with pytest.raises(sb.InputError, match="case file"):
            sb.load_cases(name)
        with pytest.raises(sb.InputError, match="exist"):
            sb.load(name)
    monkeypatch.setattr(columns, "MOST_BYTES", 20)
    (tmp_path / "long.csv").write_text(WRITTEN["names"])
    with pytest.raises(sb.InputError, match="have at most 20 bytes"):
        read_samples(tmp_path / "long.csv")
