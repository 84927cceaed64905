"""Typed numbers: those in sentences and tables of a page that neither a block nor a record on it holds.

    python studies/quotes.py        # the typed numbers of all pages, one a line; status 1 if there are any

A number is held, to the digits written, by

* a block of code or output on the same page, code inside a sentence, or a table that a script makes;
* a file that its paragraph, with the list or table below it, links to: a section of a page, a script, a record in JSON;
* a file that DEFINED names for it: a constant of the program or of the paper, or the bound of a test.

Integers of one digit without a unit, years, and numbers of tables, figures, sections and versions are not looked at.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = [
    "README.md", "studies/README.md",
    *(f"studies/{path.parent.name}/{path.name}" for room in ("guide", "theory")
      for path in sorted((ROOT / "studies" / room).glob("*.md"))),
]  # fmt: skip
ENGINE = "src/stiffbeam/"
DEFINED: dict[str, dict[str, str]] = {  # page: number: the file that holds it
    "README.md": {"1e-12": ENGINE + "references/__init__.py"},
    "studies/README.md": {"1.65": ENGINE + "studies/first_impact.py", "2 %": "studies/stiff_stops.py"},
    "studies/guide/citing.md": {"3.11": "pyproject.toml"},
    "studies/guide/ensembles.md": {
        "1e-15": ENGINE + "studies/doubt.py",
        "0.9": ENGINE + "studies/doubt.py",
        "1.1": ENGINE + "studies/doubt.py",
        "40": ENGINE + "studies/doubt.py",
        "92 %": ENGINE + "studies/doubt.py",
        "93 %": ENGINE + "studies/doubt.py",
        "95 %": ENGINE + "measures/rates.py",
    },
    "studies/guide/orbits.md": {"1e13": ENGINE + "references/exact/orbit.py", "1e-9": "tests/references/test_orbit.py"},
    "studies/guide/other_tools.md": {"1e-12": ENGINE + "references/__init__.py"},
    "studies/guide/records.md": {"130": "tests/cli/test_interrupts.py", "143": "tests/cli/test_interrupts.py"},
    "studies/guide/references.md": {"16": ENGINE + "references/adaptive/heyoka.py"},
    "studies/guide/runs.md": {"1e-12": ENGINE + "references/__init__.py"},
    "studies/guide/solver.md": {"10⁴ times": ENGINE + "testset/measure.py"},
    "studies/guide/words.md": {"10⁻³": ENGINE + "references/horizon.py"},
    "studies/theory/exact.md": {
        "384 times": ENGINE + "piecewise/search.py",
        "30 digits": "reference/problems/README.md",
    },
    "studies/theory/horizon.md": {
        "1e-12": ENGINE + "references/__init__.py",
        "1e-18": ENGINE + "references/__init__.py",
    },
}
MADE = r"<!-- made by .*?<!-- end -->"  # a table that a script writes into the page
BLOCK = re.compile(rf"^```.*?^```$|{MADE}|^ {{4}}[^\n]*$|`[^`]*`", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
LABEL = re.compile(
    r"\b(?:Tables?|Figs?\.|Sections?|Python|[Vv]ersion|contact) \d[\d.]*(?:(?:–|, | to | and )\d[\d.]*)*|\(\d+\.\d+\)"
    r"|\b(?:19|20)\d\d\b|\d+(?:\.\d+){2,}"
)
RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
NUMBER = re.compile(
    r"(?<![\w.^])(?P<digits>\d+(?: \d{3})*(?:\.\d+)?)(?:e(?P<e>[+-]?\d+)|·10(?P<ten>[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+))?"
    r"(?P<power>[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]*)(?!\w|\.\d)"
    r"(?P<unit>\s?(?:%|times|digits|seconds|minutes|(?:s|ms|μs|N|MB)\b)|(?= (?:to|and) [\d.]+ ?%))?"
)


def numbers(text: str) -> Iterator[tuple[re.Match[str], float, float]]:
    """Yield every number of a text: where it stands, its value and the unit of its last digit."""
    for found in NUMBER.finditer(text):
        digits = found["digits"].replace(" ", "")
        scale = 10.0 ** int(found["e"] or (found["ten"] or "0").translate(RAISED))
        value = float(digits) ** int((found["power"] or "1").translate(RAISED)) * scale
        yield found, value, 10.0 ** -len(digits.partition(".")[2]) * scale


def section(text: str, anchor: str) -> str:
    """Return the part of a page below the heading with this anchor, all of it without one."""
    for part in re.split(r"^(?=#+ )", text, flags=re.MULTILINE):
        heading = re.sub(r"[^\w -]", "", part.partition("\n")[0].lstrip("# ").lower()).replace(" ", "-")
        if anchor and heading == anchor:
            return part
    return "" if anchor else text


def typed(page: str, text: str | None = None) -> list[str]:
    """Return the numbers of a page that nothing holds, each with the words around it."""
    text = (ROOT / page).read_text(encoding="utf-8") if text is None else text
    here = _values(" ".join(BLOCK.findall(text)))
    found = []
    for part in re.split(r"\n\n(?!\* |\|)", BLOCK.sub(" ` ", text)):
        held = list(here)
        for address, anchor in LINK.findall(part):
            path = ROOT / os.path.normpath(Path(page).parent / address) if address else ROOT / page
            whole = path.suffix in (".py", ".json", ".toml")
            if (whole or anchor) and path != ROOT / page and path.is_file():
                held += _values(section(path.read_text(encoding="utf-8"), anchor))
        prose = LABEL.sub("", LINK.sub("]", part))
        for match, value, last in numbers(prose):
            written = match["digits"]
            count = written.isdigit() and match.group("unit", "e", "ten") == (None, None, None) and not match["power"]
            if count and len(written) == 1:
                continue
            file = DEFINED.get(page, {}).get(match[0].strip())
            known = held if file is None else _values((ROOT / file).read_text(encoding="utf-8"))
            if not any(abs(x - value) <= (0.0 if count else 0.5 + 1e-9) * last for x in known):
                around = " ".join(prose[max(0, match.start() - 40) : match.end() + 30].split())
                found.append(f"{page}: {match[0].strip()}: {around}")
    return found


def _values(text: str) -> list[float]:
    """Return the values of all numbers in a text."""
    return [float(x) for x in re.findall(r"\d+(?:\.\d*)?(?:e[+-]?\d+)?", text)] + [x for _, x, _ in numbers(text)]


def main() -> None:
    found = [line for page in PAGES for line in typed(page)]
    print("\n".join(found))
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
