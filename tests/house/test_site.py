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

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "studies" / "first_beam.ipynb"
RECORDS = (ROOT / "studies" / "guide" / "records.md").read_text(encoding="utf-8")


def documented(command: str) -> set[str]:
    """The entries that the guide names for a command."""
    (line,) = re.findall(rf"^\| {re.escape(command)} \| (.*) \|$", RECORDS, re.MULTILINE)
    return set(re.findall(r"`(\w+)`", line.partition(": a list of")[0] if command == "`cases`" else line))


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site as the command builds it, each study in its smallest configuration."""
    pytest.importorskip("sphinx")
    out = tmp_path_factory.mktemp("site") / "site"
    strict = ["-W", "error", "-W", "ignore::DeprecationWarning", "-W", "ignore::PendingDeprecationWarning"]
    command = [sys.executable, *strict, str(ROOT / "studies" / "site.py"), "--out", str(out), "--smoke"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


@pytest.mark.slow
def test_the_site_has_every_page(site):
    """A link that leads nowhere would have ended the build."""
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


def test_the_page_of_variables_is_the_schema():
    from stiffbeam.trajectory.schema import COORDINATES, SCHEMA

    page = runpy.run_path(str(ROOT / "studies" / "site.py"))["variables"]()
    assert [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")] == [
        variable.name for variable in (*SCHEMA, *COORDINATES)
    ]
    assert "| `energy_loss` | `energy.loss` | time | J | numerical loss since t = 0 |" in page


@pytest.mark.slow
def test_a_chapter_shows_sentence_and_picture_of_its_pages(site):
    page = (site / "how-to.html").read_text(encoding="utf-8")
    assert "A scheme advances the system by a fixed time step." in page
    assert page.count("<h2") > 10
    assert len(re.findall(r'<img[^>]*src="_images/[^"]*"', page)) >= 6  # of every script


def test_what_a_chapter_shows_of_a_page():
    entry = runpy.run_path(str(ROOT / "studies" / "site.py"))["entry"]
    page = "# Head\n\n    python x.py\n\n```python\nx\n\ny\n```\n\nSee [a page](b.md): one. Two.\n\n![words](c/d.png)"
    picture = "```{image} /studies/c/d.png\n:width: 480px\n:alt: words\n```"
    assert entry("studies/e.md", page) == f"## [Head](/studies/e.md)\n\nSee a page\n\n{picture}"


@pytest.mark.slow
def test_the_reference_of_names_holds_every_public_name(site):
    import stiffbeam as sb

    pages = "".join(page.read_text(encoding="utf-8") for page in (site / "studies" / "names").glob("*.html"))
    assert [name for name in sb.__all__ if f'id="stiffbeam.{name}"' not in pages] == []


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::PendingDeprecationWarning")
def test_a_broken_link_ends_the_build(tmp_path, monkeypatch, capfd):
    pytest.importorskip("sphinx")

    spec = importlib.util.spec_from_file_location("stiffbeam_site", ROOT / "studies" / "site.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
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

    from stiffbeam.cli import app
    from stiffbeam.cli.application import EXAMPLES

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
