"""No number on a page is typed: a block or a record holds it."""

from __future__ import annotations

import re

import pytest
from quotes import DEFINED, PAGES, ROOT, numbers, typed

TEXTS = {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES}


@pytest.mark.parametrize("page", PAGES)
def test_every_number_of_a_page_is_held(page):
    assert typed(page) == []


@pytest.mark.parametrize(
    ("page", "right", "wrong"),
    [
        ("studies/guide/ensembles.md", "879", "878"),
        ("studies/guide/ensembles.md", "to 1.5 % in", "to 1.77 % in"),
        ("studies/guide/stops.md", "0.021 %", "0.025 %"),
        ("studies/guide/derivatives.md", "0.202 %", "0.212 %"),
        ("studies/theory/horizon.md", "71.6 ± 11", "71.7 ± 11"),
        ("studies/README.md", "7.4e-11", "7.5e-11"),
        ("studies/guide/orbits.md", "0.0039 |", "0.0038 |"),
        ("studies/guide/words.md", "10⁻³", "10⁻²"),
    ],
)
def test_a_number_that_its_record_does_not_hold_is_refused(page, right, wrong):
    """The right number is the one that the page quotes today."""
    assert right in TEXTS[page]
    (line,) = typed(page, TEXTS[page].replace(right, wrong, 1))
    (number,) = re.findall(r"\d[^ ]*", wrong)[:1]
    assert line.startswith(f"{page}: {number}")


def test_what_is_looked_at_and_what_holds_it():
    page = "studies/guide/new.md"
    block = "```python\nx = 12.5\n```\n\n```text\n0.4567 of 88\n```\n\n"
    (line,) = typed(page, f"{block}12.5 m, 0.46, 45.67 %, 88 beams, 7 stops, Table 99, Section 3.2, in 2002, 0.2.0")
    assert line.startswith(f"{page}: 45.67 %: ")
    assert len(typed(page, f"{block}87 beams, 7 % of them, 0.47 and 2·10⁴")) == 4
    quoted = "[the exact flow](../answers.md#chaos): 71.6 in 10 parts"
    assert typed(page, quoted) == []
    assert len(typed(page, quoted.replace("chaos", "energy"))) == 1  # another section of the record
    assert len(typed(page, quoted.replace("#chaos", ""))) == 2  # no section
    assert typed(page, f"{quoted}:\n\n* 87.4\n* 87.6") == []  # the list belongs to the sentence
    assert len(typed(page, f"{quoted}\n\n71.6")) == 1  # another paragraph
    assert typed(page, "<!-- made by x.py -->\n| 3.21 |\n<!-- end -->\n\n3.21") == []


def test_numbers_have_values_and_last_digits():
    found = [(value, last) for _, value, last in numbers("1.50, 2e-3, 4.7·10⁶, 10⁻³, 16 000")]
    wanted = [(1.5, 0.01), (2e-3, 1e-3), (4.7e6, 1e5), (1e-3, 1.0), (16000.0, 1.0)]
    assert found == [pytest.approx(pair) for pair in wanted]


def test_every_definition_is_of_a_number_on_its_page():
    for page, numbers_of_page in DEFINED.items():
        for number in numbers_of_page:
            assert number in TEXTS[page], (page, number)
