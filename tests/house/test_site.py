"""The site builds; records are as documented; examples are understood."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from browser import browse

ROOT = Path(__file__).parents[2]
RECORDS = (ROOT / "studies" / "guide" / "records.md").read_text(encoding="utf-8")

AXE = """axe.run(document.querySelector("main") || document, {resultTypes: ["violations"]}).then(
  found => found.violations.map(x => x.id + ": " + x.nodes.map(node => node.html).slice(0, 3).join(" ")))"""


def documented(command: str) -> set[str]:
    """The entries that the guide names for a command."""
    (line,) = re.findall(rf"^\| {re.escape(command)} \| (.*) \|$", RECORDS, re.MULTILINE)
    return set(re.findall(r"`(\w+)`", line.partition(": a list of")[0] if command == "`cases`" else line))


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_site_builds_and_a_browser_shows_every_page(tmp_path):
    """A warning, a broken link or an error in a cell ends the build."""
    pytest.importorskip("myst_nb")
    site = tmp_path / "site"
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-c", str(ROOT / "studies"), str(ROOT), str(site)]
    done = subprocess.run([*command, "-d", str(tmp_path / "doctrees")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    import stiffbeam as sb

    page = (site / "studies" / "guide" / "names.html").read_text(encoding="utf-8")
    assert [name for name in sb.__all__ if f'id="stiffbeam.{name}"' not in page] == []
    check_in_browser(site, tmp_path / "profile")


def check_in_browser(site: Path, profile: Path) -> None:
    """No page is wider than a screen or a telephone or writes to the console; axe finds no violation."""
    pages = sorted(str(page.relative_to(site)) for page in site.rglob("*.html") if "_static" not in page.parts)
    assert len(pages) > 25
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


def test_records_of_cheap_commands_are_as_documented(command):
    for name, arguments in (
        ("cases", ()),
        ("reference", ("table10", "--t-end", "0.01")),
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
    code, out, _ = command("study", "energy", "table10", "--smoke", "--json", "-")
    found = json.loads(out)
    assert (code, set(found) - {"stiffbeam", "command"}) == (0, documented("a study"))
    assert found["command"] == "energy"
    assert [line["scheme"] for line in found["table"]] == ["HHT(alpha=-0.1)", "BDF2"]
    code, out, err = command("study", "energy", "table10", "--smoke", "--quiet")
    assert (code, out, err) == (0, "", "")
    code, out, err = command("study", "energy", "table10", "--smoke", "--verbose")
    assert code == 0
    assert "energy lost" in out
    assert " s  energy: planning" in err


def test_every_command_has_an_example_that_it_understands():
    """Options and arguments are read as the command would; nothing is run."""
    import shlex

    from stiffbeam.cli.commands import application

    for name in ("compare", "advise", "doubt", "reference", "score", "converge", "ensemble", "sweep"):
        app = application(name)
        text = app[name].default_command.__doc__ or ""
        (line,) = re.findall(r"Example: stiffbeam (.*)$", text, re.MULTILINE)
        function, _, _ = app.parse_args(shlex.split(line), exit_on_error=False, print_error=False)
        assert callable(function)
