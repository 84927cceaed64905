"""What README and guide print is run as written, and is what they say."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest
from processes import passed

import stiffbeam as sb

ROOT = Path(__file__).parents[2]
STUDIES = ROOT / "studies"
PAGES = [ROOT / "README.md", *sorted([*STUDIES.glob("guide/*.md"), *STUDIES.glob("theory/*.md")])]
TEXTS = {page.stem: page.read_text(encoding="utf-8") for page in PAGES}
BLOCKS = [
    pytest.param(block, shown, id=f"{name}-{i}")
    for name, text in TEXTS.items()
    for i, (block, shown) in enumerate(re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", text, re.DOTALL))
    if "def test_" not in block
]
README = TEXTS["README"]


def run(block, folder):
    done = subprocess.run([sys.executable, "-W", "error", "-c", block], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
@pytest.mark.parametrize(("block", "shown"), BLOCKS)
def test_every_python_block_runs_and_prints_what_is_shown(block, shown, tmp_path):
    printed = run(block, tmp_path)
    assert printed
    assert shown.strip() in ("", printed)


@pytest.mark.slow
def test_the_readme_prints_what_it_says(tmp_path):
    (block,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (printed,) = re.findall(r"```text\n(.*?)```", README, re.DOTALL)
    assert run(block, tmp_path) == printed.strip()


def test_the_readme_is_short():
    assert len(README.split()) < 700


@pytest.mark.parametrize(
    "page",
    [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "studies" / "README.md", ROOT / "tests" / "campaigns" / "README.md"],
    ids=lambda p: p.name,
)
def test_every_link_leads_somewhere(page):
    for target, anchor in re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", without_blocks(page)):
        there = page.parent / target if target else page
        assert target.startswith("https://") or there.exists(), target
        assert not anchor or there.suffix != ".md" or anchor in headings(there), f"{target}#{anchor}"


def without_blocks(page):
    return re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def headings(page):
    """The anchors that GitHub and the site give to the headings of a page."""
    heads = re.findall(r"^#+ (.*)$", without_blocks(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def test_the_paper_has_one_identifier():
    from dumont2002.page import DOI

    assert f"https://doi.org/{DOI}".replace("(", "%28").replace(")", "%29") in README
    assert f"doi     = {{{DOI}}}" in TEXTS["citing"]
    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"    doi: {DOI}\n" in cited


@pytest.mark.slow
def test_the_notebook_prints_what_it_shows(monkeypatch):
    """Every code cell in order in one namespace; the figure is the last cell's value."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict = {}
    notebook = json.loads((STUDIES / "first_beam.ipynb").read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for cell in cells:
        with redirect_stdout(io.StringIO()) as printed:
            exec("".join(cell["source"]), names)
        shown = "".join(text for output in cell["outputs"] for text in output.get("text", []))
        assert printed.getvalue().strip() == shown.strip()
    (picture,) = cells[-1]["outputs"]  # the page of a repository shows the stored one
    assert picture["data"]["image/png"].startswith("iVBOR")


@pytest.mark.slow
def test_the_downstream_test_passes(tmp_path):
    (block,) = (b for b in re.findall(r"```python\n(.*?)```", TEXTS["references"], re.DOTALL) if "def test_" in b)
    output = passed(tmp_path, block)
    rigid = sum(each.rigid for each in sb.problems().values())
    # A test of its own, and one for every problem.
    assert f"{1 + len(sb.problems()) - rigid} passed, {rigid} skipped" in output


def test_the_case_file_runs(tmp_path):
    import stiffbeam as sb
    from stiffbeam.files.cases import load_cases

    toml, bolted = re.findall(r"```toml\n(.*?)```", TEXTS["beam"], re.DOTALL)
    (file := tmp_path / "my-beam.toml").write_text(toml, encoding="utf-8")
    case = load_cases(file)["steel"]
    assert case.problem.units == ("m", "s", "N")
    assert len(case.runs) == 3
    # the commented lines are part of the documentation: they have to be right as well
    loads = re.sub(r"^# (?=loads = \[\{ position = 0.1, a)", "", toml, flags=re.MULTILINE)
    file.write_text(loads, encoding="utf-8")
    assert len(load_cases(file)["steel"].problem.loads) == 2
    t = "0.0,0.0\n" + "".join(f"{0.01 * k},{k % 3}\n" for k in range(1, 40))
    for name, head in (("hammer.csv", "t,force\n"), ("table.csv", "t,x\n")):
        (tmp_path / name).write_text(head + t, encoding="utf-8")
    plain = re.sub(r"^base = .*\n", "", toml, flags=re.MULTILINE)
    measured = re.sub(r"^# (?=loads = \[\{ position = 0.1, s|base)", "", plain, flags=re.MULTILINE)
    file.write_text(measured, encoding="utf-8")
    assert isinstance(load_cases(file)["steel"].problem.loads[0].time, sb.Sampled)
    # the stops of the shaker in place of the others
    plain = re.sub(r"^(stops|base) = .*\n", "", toml, flags=re.MULTILINE)
    file.write_text(plain.replace("[case.problem]\n", f"[case.problem]\n{bolted}"), encoding="utf-8")
    problem = load_cases(file)["steel"].problem
    assert problem.stops.motion == problem.base


def test_public_names_have_numpydoc_sections():
    """Functions: all four, but for those that take nothing; classes: an example, or the fields that they hold."""
    import inspect

    import stiffbeam as sb

    missing = []
    for name in sb.__all__:
        value = getattr(sb, name)
        text = inspect.getdoc(value) or ""
        has = {
            s
            for s in ("Parameters", "Attributes", "Returns", "Raises", "Examples")
            if f"\n{s}\n{'-' * len(s)}\n" in text
        }
        if inspect.isclass(value):
            missing += [] if has & {"Parameters", "Attributes", "Examples"} else [name]
        elif callable(value):
            wanted = (
                {"Parameters", "Returns", "Raises", "Examples"} if inspect.signature(value).parameters else {"Returns"}
            )
            missing += [f"{name}: {', '.join(sorted(wanted - has))}"] if wanted - has else []
    assert missing == []


@pytest.mark.slow
def test_examples_in_docstrings_print_what_they_show():
    import doctest
    import inspect

    import stiffbeam as sb
    from stiffbeam.model.ode import ODE

    runner, tried = doctest.DocTestRunner(), 0
    for value in [*(getattr(sb, name) for name in sb.__all__), ODE]:
        for example in doctest.DocTestFinder(recurse=False).find(value, value.__name__, inspect.getmodule(value), {}):
            tried += runner.run(example).attempted
    assert tried >= 20
    assert runner.failures == 0
