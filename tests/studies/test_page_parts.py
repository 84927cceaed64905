"""What the page is made of: elements, tables, sentences, numbers, captions, one picture's span."""

from __future__ import annotations

import re

import numpy as np

import stiffbeam as sb
from dumont2002.page import environment
from dumont2002.rows import Table, parts
from dumont2002.typeset import percent, short, written
from stiffbeam.figures.runs import first_contact
from stiffbeam.files.cases import paper_cases

MACROS = environment().get_template("macros.html").module


def table(headings: list[str], rows: list[list[str]], caption: str, **options) -> str:
    return str(MACROS.table(Table(caption, headings, rows, **options)))


def test_what_is_put_into_the_page_is_escaped():
    made = table(["a < b"], [["c & d"]], '"quoted"')
    assert "a &lt; b" in made
    assert "c &amp; d" in made
    assert 'aria-label="&#34;quoted&#34;"' in made


def test_numbers_of_a_column_stand_on_their_decimal_point():
    made = table(["name", "value"], [["a", "1.25"], ["b", "310"], ["c", "12.5 ± 3"]], "numbers")
    widths = re.findall(r'class="f" style="width:(\d+)ch"', made)
    assert widths == ["6", "6", "6"]  # ".5 ± 3"
    assert 'scope="row">a' in made
    assert parts("1\u202f234.5 ± 3") == ("1\u202f234", ".5\u00a0±\u00a03")
    assert parts("overflow") == ("overflow", "")


def test_the_close_up_ends_where_the_first_contacts_do():
    """The tip of Table 13 leaves its lower stop after 0.003, a quarter of the span in which contacts are looked for."""
    case = paper_cases()["table13"]
    exact = sb.reference(case.system("displacement"), t_end=0.02)
    start, end = first_contact(exact, exact.system, 0.02)
    period = 2.0 * np.pi / sb.modes(exact.system).omega[0]
    assert end - start < 0.6 * period / 8.0
    u = exact.at(np.linspace(start, end, 1000))[0]
    lower = case.problem.stops.lower
    touching = np.flatnonzero(u < lower)
    assert 0.1 < touching[0] / 1000 < touching[-1] / 1000 < 0.85  # it comes, and it goes
    assert u[-1] > 0.7 * lower


def test_numbers_are_written_as_the_paper_does():
    assert [written(x) for x in (300.0, -0.1, 5e6, 1e-4, 2.5e-5)] == ["300", "−0.1", "5 × 10⁶", "10⁻⁴", "2.5 × 10⁻⁵"]
    assert [short(x) for x in (3904, None, -0.25)] == ["3\u202f904", "–", "−0.25"]
    assert [percent(x) for x in (0.0398, 0.38, 0.0994)] == ["4 %", "38 %", "9.9 %"]
