"""What README and guide print is run as written, and is what they say."""

from __future__ import annotations

import re
import subprocess
import sys
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


@pytest.mark.slow
def test_the_guide_counts_what_the_study_finds(tmp_path, monkeypatch):
    """Means of 200 chaotic runs: another rounding draws other members, so to four deviations of their difference."""
    import stiffbeam as sb

    monkeypatch.chdir(tmp_path)
    lines = {line["method"]: line for line in sb.study("ensemble", "table10").answer.table}
    text = TEXTS["ensembles"].replace("\n", " ")

    def held(label: str, count: str, share: str) -> None:
        mean, _, deviation = lines[label]["impacts"].split()
        part = lines[label]["contact, %"].split()[0]
        assert abs(float(mean) - float(count)) < 0.5 + 4.0 * float(deviation) * (2 / 200) ** 0.5, label
        assert abs(float(part) - float(share)) < 0.1 * float(share), label

    hht, exact, hht_share, exact_share = re.search(
        r"as the exact motion, (\d+) against (\d+), .*? for (\d+) % .*? instead of ([\d.]+) %", text
    ).groups()
    sdirk, bdf2, sdirk_share, bdf2_share = re.search(
        r"SDIRK-OS has (\d+) and BDF2 (\d+), with (\d+) and (\d+) %", text
    ).groups()
    share, trapezoidal = re.search(
        r"for ([\d.]+) %, but gains energy at the stops and has (\d+) impacts", text
    ).groups()
    held("exact", exact, exact_share)
    held("HHT(alpha=-0.1)", hht, hht_share)
    held("SDIRK(gamma=0.4359)", sdirk, sdirk_share)
    held("BDF2", bdf2, bdf2_share)
    held("Trapezoidal", trapezoidal, share)


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


def test_every_question_of_the_studies_has_its_answer_below():
    text = (STUDIES / "README.md").read_text(encoding="utf-8")
    answers = (STUDIES / "answers.md").read_text(encoding="utf-8")
    for file, page, mark in (("", text, "###"), ("answers.md", answers, "##")):
        asked = re.findall(rf"^\* \[[^]]*\]\({re.escape(file)}#([^)]*)\) `", text, re.MULTILINE)
        headings = {heading.replace(" ", "-") for heading in re.findall(rf"^{mark} (.*)$", page, re.MULTILINE)}
        assert asked
        assert set(asked) <= headings


def test_the_answers_hold_every_study_with_its_question():
    from stiffbeam.studies import STUDIES as NAMES
    from stiffbeam.studies import find_study

    answers = (STUDIES / "answers.md").read_text(encoding="utf-8")
    for name in NAMES:
        assert f"## {name.replace('_', ' ')}\n\n{find_study(name).question}\n" in answers


def test_the_guides_quote_the_answers():
    """Numbers of the ensemble on Table 10, of two guides, are those of the page that the last build wrote."""
    answers = (STUDIES / "answers.md").read_text(encoding="utf-8")
    table = answers.partition("## ensemble\n")[2].partition("## chaos")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines() if line.startswith("| ")]
    heads, numbers = rows[0], {row[0].partition("(")[0]: row for row in rows[2:]}

    def value(method: str, head: str) -> float:
        return float(numbers[method][heads.index(head)].split()[0])

    ensembles, choose = (TEXTS[name].replace("\n", " ") for name in ("ensembles", "choose"))
    counts = {method: f"{value(method, 'impacts'):.0f}" for method in numbers}
    shares = {method: f"{value(method, 'contact, %'):g}" for method in numbers}
    assert f"{counts['HHT']} against {counts['exact']}, but stays in contact for {shares['HHT']} %" in ensembles
    assert f"SDIRK-OS has {counts['SDIRK']} and BDF2 {counts['BDF2']}, with {shares['SDIRK']}" in ensembles
    trapezoidal = (
        f"for {shares['Trapezoidal']} %, but gains energy at the stops and has {counts['Trapezoidal']} impacts"
    )
    assert trapezoidal in ensembles
    losses = [value(m, "lost, %") for m in ("BDF2", "SDIRK", "HHT", "GeneralisedAlpha", "Bathe")]
    assert f"have lost {min(losses):.0f} to {max(losses):.0f} %" in choose
    damped = [value(m, "contact, %") for m in ("HHT", "GeneralisedAlpha", "Bathe")]
    assert f"{min(damped):.0f} to {max(damped):.0f} % of the time, for {shares['exact']} % in truth" in choose


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
    assert str(case.problem.units) == "m, s, N"
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
