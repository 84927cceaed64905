"""Pages: blocks and scripts run and print what is shown, versions agree, the site builds and a browser shows it."""

from __future__ import annotations

import doctest
import importlib
import importlib.util
import inspect
import io
import json
import re
import runpy
import shlex
import subprocess
import sys
from contextlib import redirect_stdout
from dataclasses import fields
from pathlib import Path
from types import ModuleType

import pytest
from browser import browse

import stiffbeam as sb
from stiffbeam.measures.comparison import Comparison
from stiffbeam.references import REFERENCES, registry
from stiffbeam.testset.problem import VERSION

ROOT = Path(__file__).parents[2]
STUDIES = ROOT / "studies"
FOLDERS = ("tutorial", "how-to", "explanation", "reference")
PAGES = [ROOT / "README.md", *sorted(page for folder in FOLDERS for page in (STUDIES / folder).glob("*.md"))]
TEXTS = {page.stem: page.read_text(encoding="utf-8") for page in PAGES}
BLOCKS = [
    pytest.param(block, shown, id=f"{name}-{i}")
    for name, text in TEXTS.items()
    for i, (block, shown) in enumerate(re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", text, re.DOTALL))
    if "def test_" not in block
]
AXE = """innerWidth < 1000 || !window.axe ? [] :
  axe.run(document.querySelector("main") || document, {resultTypes: ["violations"]}).then(
    found => found.violations.map(x => x.id + ": " + x.nodes.map(node => node.html).slice(0, 3).join(" ")))"""


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXTS[page], re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize(("block", "shown"), BLOCKS)
def test_every_python_block_runs_and_prints_what_is_shown(block, shown, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "block", "exec"), {"__name__": "__main__"})
    printed = capsys.readouterr().out.strip()
    assert printed
    assert shown.strip() in ("", printed)


@pytest.mark.slow
@pytest.mark.parametrize("script", sorted((STUDIES / "how-to").glob("*.py")), ids=lambda script: script.stem)
def test_a_script_asserts_its_number(script, tmp_path, monkeypatch, capsys):
    text = script.read_text(encoding="utf-8")
    assert text.count("\n") <= 60
    assert "assert" in text
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [script.name, *(["table10"] if script.stem == "ranking" else [])])  # shorter
    runpy.run_path(str(script), run_name="__main__")
    assert len(capsys.readouterr().out) > 20


@pytest.mark.slow
def test_the_notebook_prints_what_it_shows(monkeypatch):
    """Every code cell in order in one namespace; the figure is the last cell's value, whose picture is stored."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    notebook = json.loads((STUDIES / "tutorial" / "first_beam.ipynb").read_text(encoding="utf-8"))
    cells, names = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"], {}
    for cell in cells:
        with redirect_stdout(io.StringIO()) as printed:
            exec("".join(cell["source"]), names)
        shown = "".join(text for output in cell["outputs"] for text in output.get("text", []))
        assert printed.getvalue().strip() == shown.strip()
    assert cells[-1]["outputs"][0]["data"]["image/png"].startswith("iVBOR")


@pytest.mark.slow
def test_the_downstream_test_passes(pytester):
    """A test of its own, and one for every problem."""
    pytester.makepyfile(*blocks("references_in_tests", "python"))
    rigid = sum(each.system.rigid for each in sb.problems().values())
    done = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    done.assert_outcomes(passed=1 + len(sb.problems()) - rigid, skipped=rigid)


def test_the_case_file_runs(tmp_path):
    """Commented lines are part of the page and right as well."""
    toml, bolted, frame = blocks("case_files", "toml")
    t = "0.0,0.0\n" + "".join(f"{0.01 * k},{k % 3}\n" for k in range(1, 40))
    for name, head in (("hammer.csv", "t,force\n"), ("table.csv", "t,x\n")):
        (tmp_path / name).write_text(head + t, encoding="utf-8")

    def read(text: str):
        (tmp_path / "my-beam.toml").write_text(text, encoding="utf-8")
        (case,) = sb.load_cases(tmp_path / "my-beam.toml").values()
        return case

    case = read(toml)
    assert (case.problem.units, len(case.runs)) == (("m", "s", "N"), 3)
    assert len(read(re.sub(r"^# (?=loads.*amplitude)", "", toml, flags=re.MULTILINE)).problem.loads) == 2
    plain = re.sub(r"^base = .*\n", "", toml, flags=re.MULTILINE)
    measured = re.sub(r"^# (?=loads = \[\{ position = 0.1, s|base)", "", plain, flags=re.MULTILINE)
    assert isinstance(read(measured).problem.loads[0].time, sb.Sampled)
    problem = read(re.sub(r"^stops = .*\n", "", plain, flags=re.MULTILINE) + bolted).problem
    assert problem.stops.motion == problem.base
    matrix = "%%MatrixMarket matrix coordinate real general\n3 3 3\n1 1 {0}\n2 2 {0}\n3 3 {0}\n"
    for name, value in (("M.mtx", 1.0), ("K.mtx", 9.0)):
        (tmp_path / name).write_text(matrix.format(value), encoding="utf-8")
    assert read(frame).system().size == 3


def test_pages_are_short_and_agree_on_versions_and_the_paper():
    from dumont2002.page import DOI

    readme, contributing, changes, citation, start = (
        (ROOT / x).read_text(encoding="utf-8")
        for x in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "CITATION.cff", "studies/README.md")
    )
    words = [len(re.findall(r"\S*\w\S*", text)) for text in (*TEXTS.values(), contributing, changes, start)]
    assert sum(words) <= 12_000  # code counts
    assert f"https://doi.org/{DOI}".replace("(", "%28").replace(")", "%29") in readme
    for line in (f"    doi: {DOI}", f"version: {sb.__version__}", f'    version: "{VERSION}"'):
        assert f"{line}\n" in citation


def added(path: str, diff: str, monkeypatch) -> ModuleType:
    """The module that a diff adds."""
    name = path.removeprefix("src/").removesuffix(".py").replace("/", ".")
    monkeypatch.setitem(sys.modules, name, module := ModuleType(name))
    module.__package__ = name.rpartition(".")[0]
    exec(diff, vars(module))
    return module


@pytest.mark.slow
def test_the_additions_of_contributing_work_in_every_place_that_reads_them(monkeypatch, tmp_path):
    """A scheme obeys the laws; a solver needs its file and its line only; a study has its answer and picture."""
    from stiffbeam.figures.chart import look, short
    from stiffbeam.studies import STUDIES as REGISTERED
    from stiffbeam.testing import check_scheme

    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    parts = re.findall(r"^\+\+\+ (\S+)\n((?:\+.*\n)+?)(?=```|\+\+\+)", text, re.MULTILINE)
    files = {path: re.sub(r"^\+", "", diff, flags=re.MULTILINE) for path, diff in parts}
    line = files.pop("src/stiffbeam/references/registry.py")
    scheme, solver, study = (added(path, diff, monkeypatch) for path, diff in files.items())
    assert {"order", "amplification"} <= set(check_scheme(scheme.BackwardEuler())["law"])

    method = eval(line.strip().rstrip(","), vars(registry))
    importlib.import_module("stiffbeam.references.adaptive").rk45 = solver
    monkeypatch.setitem(REFERENCES, method.name, method)
    system = sb.semidiscretise(sb.paper_case(10).problem, 8)
    run = sb.reference(system, 0.01, "rk45", rtol=1e-8)
    assert (run.provenance["method"], run.horizon, "scipy" in run.provenance) == ("rk45", 0.01, True)
    assert sb.cached_reference(system, 0.01, "rk45", rtol=1e-8).horizon == 0.01
    assert short("rk45") == "RK45"
    assert look("rk45") not in [look(name) for name in REFERENCES if name != "rk45"]

    monkeypatch.setitem(REGISTERED, "impulse", REGISTERED.pop("impulse"))
    records = sb.study("impulse", system, dt=1e-4, t_end=0.1, schemes=["BDF2"], progress=False)
    assert records.answer.verdict.startswith("The largest impulse is")
    records.figure().savefig(tmp_path / "impulse.png")
    monkeypatch.delitem(REGISTERED, "impulse")
    assert study.Impulse.question() == "How large is the impulse on the stops, by scheme?"


def test_public_names_have_numpydoc_sections():
    """Functions: all four, but for those that take nothing; classes: an example, or the fields that they hold."""
    missing = []
    for name in sb.__all__:
        value = getattr(sb, name)
        heads = set(re.findall(r"^(\w+)\n-+$", inspect.getdoc(value) or "", re.MULTILINE))
        if inspect.isclass(value):
            missing += [] if heads & {"Parameters", "Attributes", "Examples"} else [name]
        elif callable(value):
            wanted = {"Parameters", "Returns", "Raises", "Examples"} if inspect.signature(value).parameters else set()
            missing += [f"{name}: {', '.join(sorted(wanted - heads))}"] if wanted - heads else []
    assert missing == []


@pytest.mark.slow
def test_examples_in_docstrings_print_what_they_show():
    from stiffbeam.model.right_hand_side import ODE

    runner, tried = doctest.DocTestRunner(), 0
    for value in [*(getattr(sb, name) for name in sb.__all__), ODE]:
        for example in doctest.DocTestFinder(recurse=False).find(value, value.__name__, inspect.getmodule(value), {}):
            tried += runner.run(example).attempted
    assert tried >= 20
    assert runner.failures == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("`cases`", "cases"),
        ("`reference`", "reference table10 --t-end 0.01"),
        ("`compare`", "compare table10 --t-end 0.02 --references exact"),
        ("a study", "study energy table10 --t-end 0.1 --schemes HHT(alpha=-0.1),BDF2 --jobs 1"),
    ],
)
def test_records_are_as_documented(command, name, arguments):
    (line,) = re.findall(rf"^\| {name} \| (.*) \|$", TEXTS["commands"], re.MULTILINE)
    code, out, err = command(*arguments.split(), "--json", "-", "--quiet")
    found = json.loads(out)
    assert (code, err) == (0, "")
    assert list(found)[:2] == ["stiffbeam", "command"]
    assert set(list(found)[2:]) == set(re.findall(r"`(\w+)`", line.partition(": a list of")[0]))
    if name == "`compare`":
        held = {field.name for field in fields(Comparison)} - {"error", "times", "pair"}
        assert set(found["comparisons"][0]) == held
    if name == "a study":
        assert [line["scheme"] for line in found["table"]] == ["HHT(alpha=-0.1)", "BDF2"]


def test_commands_of_pages_and_of_help_are_understood():
    """Options and arguments are read as the command would; nothing is run."""
    from stiffbeam.cli import application

    texts = [
        *TEXTS.values(),
        *((ROOT / x).read_text(encoding="utf-8") for x in ("CONTRIBUTING.md", "studies/README.md")),
    ]
    written = re.compile(r"(?:`stiffbeam|^stiffbeam(?= \w+ .*--)) ([a-z][^`|]*?)(?:`| \||$)", re.MULTILINE)
    lines = {line for text in texts for line in written.findall(text)}
    for name in ("compare", "advise", "doubt", "reference", "score", "converge", "ensemble", "sweep"):
        help_text = application(name)[name].default_command.__doc__ or ""
        lines |= set(re.findall(r"Example: stiffbeam (.*)$", help_text, re.MULTILINE))
    assert len(lines) > 30
    for line in lines - {"study impulse"}:  # the addition of CONTRIBUTING
        words = shlex.split(line.replace("NAME CASE", "energy CASE").replace("[INTEGRATORS]", ""))
        words += ["table10"] * (len(words) == 1 and words[0] not in ("cases", "doctor"))
        app = application(words[0])
        assert callable(app.parse_args(words, exit_on_error=False, print_error=False)[0])


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_site_builds_and_a_browser_shows_every_page(tmp_path):
    """A warning, a broken link or an error in a cell ends the build; the notebook's cells run in a test above. No page
    is wider than a screen or a telephone or writes to the console; axe finds no violation."""
    pytest.importorskip("myst_nb")
    site = tmp_path / "site"
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-c", str(STUDIES), str(ROOT), str(site)]
    done = subprocess.run([*command, "-d", str(tmp_path / "doctrees")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = (site / "studies" / "reference" / "api.html").read_text(encoding="utf-8")
    assert [name for name in sb.__all__ if f'id="stiffbeam.{name}"' not in page] == []
    pages = sorted(str(page.relative_to(site)) for page in site.rglob("*.html") if "_static" not in page.parts)
    assert len(pages) > 25
    package, axe = importlib.util.find_spec("axe_core_python"), ""
    if package is not None and package.origin is not None:
        axe = (Path(package.origin).parent / "axe.min.js").read_text(encoding="utf-8")
    seen = browse(site, pages, [1400, 390], AXE, tmp_path / "profile", f"<script>{axe}</script>")
    assert [x for x in seen if x["overflow"] > 0 or x["complaints"] or x["look"]] == []


@pytest.mark.slow
def test_a_browser_sees_what_is_wrong(tmp_path):
    """A message in the console fails at once; a missing picture, and a page that is too wide, are in the report."""
    (site := tmp_path / "site").mkdir()
    page = "<!DOCTYPE html><html><head></head><body>{}</body></html>"
    (site / "a.html").write_text(page.format('<script>console.warn("oh")</script>'))
    with pytest.raises(AssertionError, match="oh"):
        browse(site, ["a.html"], [1400], "null", tmp_path / "first")
    (site / "a.html").write_text(page.format('<div style="width: 1000px"><img src="missing.png"></div>'))
    wide, narrow = browse(site, ["a.html"], [1400, 390], "1 + 1", tmp_path / "second")
    assert (wide["look"], wide["overflow"]) == (2, 0)
    assert narrow["overflow"] > 600
    assert "missing.png" in wide["complaints"][0]
