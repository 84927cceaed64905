"""The site is whole; the notebook prints what it shows; records are as documented, examples understood."""

from __future__ import annotations

import importlib.util
import io
import json
import re
import runpy
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest
from browser import browse

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "studies" / "first_beam.ipynb"
RECORDS = (ROOT / "studies" / "guide" / "records.md").read_text(encoding="utf-8")

AXE = """axe.run(document.querySelector("main") || document, {resultTypes: ["violations"]}).then(
  found => found.violations.map(x => x.id + ": " + x.nodes.map(node => node.html).slice(0, 3).join(" ")))"""


def documented(command: str) -> set[str]:
    """The entries that the guide names for a command."""
    (line,) = re.findall(rf"^\| {re.escape(command)} \| (.*) \|$", RECORDS, re.MULTILINE)
    return set(re.findall(r"`(\w+)`", line.partition(": a list of")[0] if command == "`cases`" else line))


@pytest.mark.slow
@pytest.mark.timeout(1800)  # three minutes of a core, and a minute of the browser's
def test_the_site_is_whole(tmp_path):
    """As the command builds it, the longest studies in their smallest configuration. A warning, a link that leads
    nowhere or a typed number ends the build; then a browser opens every page."""
    pytest.importorskip("sphinx")
    out = tmp_path / "site"
    strict = ["-W", "error", "-W", "ignore::DeprecationWarning", "-W", "ignore::PendingDeprecationWarning"]
    command = [sys.executable, *strict, str(ROOT / "studies" / "site.py"), "--out", str(out), "--smoke"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    check_pages(out)
    check_names(out)
    check_chapter(out)
    check_in_browser(out, tmp_path / "profile")


def check_pages(site: Path) -> None:
    sources = [*(ROOT / "studies").glob("guide/*.md"), *(ROOT / "studies").glob("theory/*.md"), NOTEBOOK]
    for source in sources:
        page = (site / source.relative_to(ROOT)).with_suffix(".html")
        assert page.read_text(encoding="utf-8").count("<h1") == 1, source
    assert "oscillation" in (site / "studies" / "gallery.html").read_text(encoding="utf-8")
    assert "Output:" in (site / "studies" / "steel_strip.html").read_text(encoding="utf-8")
    pictures = {picture.name for picture in (site / "_images").glob("*.png") if picture.stat().st_size > 20_000}
    assert {"amplification.png", "steel_strip.png"} <= pictures
    drawn = re.findall(r'src="([^"]*)"', (site / "studies" / "first_beam.html").read_text(encoding="utf-8"))
    assert any("_images" in source for source in drawn)  # a kernel shows what the last line of a cell returns


def check_names(site: Path) -> None:
    """The reference of names holds every public name."""
    import stiffbeam as sb

    pages = "".join(page.read_text(encoding="utf-8") for page in (site / "studies" / "names").glob("*.html"))
    assert [name for name in sb.__all__ if f'id="stiffbeam.{name}"' not in pages] == []


def check_chapter(site: Path) -> None:
    """A chapter shows sentence and picture of its pages."""
    page = (site / "how-to.html").read_text(encoding="utf-8")
    assert "A scheme advances the system by a fixed time step." in page
    assert page.count("<h2") > 10
    assert len(re.findall(r'<img[^>]*src="_images/[^"]*"', page)) >= 6  # of every script


def check_in_browser(site: Path, profile: Path) -> None:
    """No page is wider than a screen or a telephone or writes to the console; axe finds no violation."""
    pages = sorted(str(page.relative_to(site)) for page in site.rglob("*.html") if "_static" not in page.parts)
    assert len(pages) > 50
    wrong = [(x["page"], x["overflow"], x["complaints"]) for x in browse(site, pages, [1400, 390], "null", profile)]
    assert [x for x in wrong if x[1] > 0 or x[2]] == []
    package = importlib.util.find_spec("axe_core_python")
    if package is not None and package.origin is not None:
        axe = (Path(package.origin).parent / "axe.min.js").read_text(encoding="utf-8")
        seen = browse(site, pages, [1400], AXE, profile.with_name("axe"), f"<script>{axe}</script>")
        assert [(x["page"], x["look"]) for x in seen if x["look"]] == []


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


def test_the_page_of_variables_is_the_schema():
    from stiffbeam.trajectory.schema import COORDINATES, SCHEMA

    page = runpy.run_path(str(ROOT / "studies" / "site.py"))["variables"]()
    assert [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")] == [
        variable.name for variable in (*SCHEMA, *COORDINATES)
    ]
    assert "| `energy_loss` | `energy.loss` | time | J | numerical loss since t = 0 |" in page


def test_what_a_chapter_shows_of_a_page():
    entry = runpy.run_path(str(ROOT / "studies" / "site.py"))["entry"]
    page = "# Head\n\n    python x.py\n\n```python\nx\n\ny\n```\n\nSee [a page](b.md): one. Two.\n\n![words](c/d.png)"
    picture = "```{image} /studies/c/d.png\n:width: 480px\n:alt: words\n```"
    assert entry("studies/e.md", page) == f"## [Head](/studies/e.md)\n\nSee a page\n\n{picture}"


def site_module():
    spec = importlib.util.spec_from_file_location("stiffbeam_site", ROOT / "studies" / "site.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_typed_number_ends_the_build(tmp_path, monkeypatch):
    monkeypatch.setattr("quotes.typed", lambda page: [f"{page}: 7 %"] if page == "README.md" else [])
    with pytest.raises(SystemExit, match=r"README.md: 7 %"):
        site_module().build(tmp_path / "site", smoke=True)
    assert not (tmp_path / "site").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")
def test_a_broken_link_ends_the_build(tmp_path, monkeypatch, capfd):
    pytest.importorskip("sphinx")

    module = site_module()
    monkeypatch.setattr(module, "CHAPTERS", {"Theory": ["studies/theory/exact.md"]})  # README links to other pages
    with pytest.raises(SystemExit):
        module.build(tmp_path / "site", smoke=True)
    assert "cross-reference target not found" in capfd.readouterr().err


@pytest.mark.slow
def test_the_notebook_prints_what_it_shows(monkeypatch):
    """Every code cell in order in one namespace; the figure is the last cell's value."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict = {}
    cells = [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    for cell in cells:
        with redirect_stdout(io.StringIO()) as printed:
            exec("".join(cell["source"]), names)
        shown = "".join(text for output in cell["outputs"] for text in output.get("text", []))
        assert printed.getvalue().strip() == shown.strip()
    (picture,) = cells[-1]["outputs"]  # the page of a repository shows the stored one
    assert picture["data"]["image/png"].startswith("iVBOR")


def test_records_of_cheap_commands_are_as_documented(command):
    for name, arguments in (
        ("cases", ()),
        ("reference", ("--check", str(ROOT / "reference" / "table2-displacement.nc"))),
    ):
        code, out, _ = command(name, *arguments, "--json", "-")
        found = json.loads(out)
        assert code == 0
        assert list(found)[:2] == ["stiffbeam", "command"]
        assert set(found) - {"stiffbeam", "command"} == documented(f"`{name}`"), name


@pytest.mark.slow
def test_records_of_a_comparison_and_a_study_are_as_documented(command):
    code, out, _ = command("compare", "table10", "--t-end", "0.02", "--references", "exact", "--json", "-")
    found = json.loads(out)
    assert (code, set(found) - {"stiffbeam", "command"}) == (0, documented("`compare`") - {"doubts"})
    fields = RECORDS.partition("`comparisons` has")[2].partition("|---|")[2].partition("\n\n")[0]
    names = " ".join(line.split("|")[1] for line in fields.splitlines() if line.startswith("| `"))
    assert set(found["comparisons"][0]) == set(re.findall(r"`(\w+)`", names))
    code, out, _ = command("energy", "table10", "--smoke", "--json", "-")
    found = json.loads(out)
    assert (code, set(found) - {"stiffbeam", "command"}) == (0, documented("a study"))
    assert found["command"] == "energy"
    assert [line["scheme"] for line in found["table"]] == ["HHT(alpha=-0.1)", "BDF2"]
    code, out, err = command("energy", "table10", "--smoke", "--quiet")
    assert (code, out, err) == (0, "", "")
    code, out, err = command("energy", "table10", "--smoke", "--verbose")
    assert code == 0
    assert "energy lost" in out
    assert " s  energy: planning" in err


def test_every_command_has_examples_that_it_understands():
    """Options and arguments are read as the command would; nothing is run."""
    import shlex

    import typer
    from stiffbeam.cli.application import EXAMPLES

    from stiffbeam.cli import app

    group = typer.main.get_command(app)
    context = group.make_context("stiffbeam", ["cases"])
    assert set(group.list_commands(context)) == set(EXAMPLES)
    for name, lines in EXAMPLES.items():
        assert lines
        for line in lines:
            program, asked, *arguments = shlex.split(line.partition(" > ")[0])
            assert (program, asked) == ("stiffbeam", name)
            group.get_command(context, name).make_context(name, arguments, parent=context)


def test_a_phase_begins_where_it_is_another():
    from stiffbeam.basics.resources import _Phases

    phases = _Phases()
    calls = [("a", 0, 10), ("a", 5, 10), ("b", 6, 10), ("c", 0, 10), ("cvode", 0, 0), ("cvode", 0, 0), ("exact", 0, 0)]
    assert [phases.begins(*call) for call in calls] == [True, False, False, True, True, False, True]
