"""What the page is made of: elements, tables, sentences, numbers, captions, one picture's span."""

from __future__ import annotations

import re

import numpy as np

import stiffbeam as sb
from dumont2002.page import environment
from dumont2002.rows import Table, parts
from dumont2002.typeset import NARROW, percent, raised, short, typeset, written
from dumont2002.verdicts import HOLDS
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


def test_measured_sentences_are_typeset():
    narrow = NARROW
    assert typeset("3.1e-03 for gamma = -0.6, 4 %") == f"3.1{narrow}×{narrow}10⁻³ for γ = −0.6, 4{narrow}%"
    assert typeset("max |R(iy)| - 1, order 2-3") == "max |R(iy)| - 1, order 2-3"
    assert (
        typeset("55 ± 38 %, 2 × 16, 1.4 ×/÷ 1.2")
        == "55\u00a0±\u00a038\u202f%, 2\u00a0×\u00a016, 1.4\u00a0×/\u2060÷\u00a01.2"
    )
    assert raised(-12) == "⁻¹²"


def test_a_table_of_words_names_every_cell_for_a_phone():
    made = table(["where", "right"], [["(3.3)", "+f"]], "Misprints", text=(0, 1), cards=True)
    assert 'class="cards"' in made
    assert '<td data-label="right">+f</td>' in made
    assert "cards" not in table(["where", "right"], [["(3.3)", "+f"]], "Misprints", text=(0, 1))


def test_a_claim_links_to_its_table_and_to_itself():
    row = {"section": "5.2, Table 3", "claim": "c", "measured": "m", "rule": "r", "evidence": "e", "verdict": HOLDS}
    made = MACROS.claim(row, 1) + MACROS.claim(row | {"section": "6"}, 2)
    first, second = re.findall(r'<th scope="row">(.*?)</th>', made)
    assert first == '5.2, <a href="#table-3">Table 3</a> <a href="#claim-1">#1</a>'
    assert second == '6 <a href="#claim-2">#2</a>'


def test_no_caption_points_twice_to_one_panel():
    """The sentence on (d), which follows what is to be looked at, says so itself."""
    looks = environment().get_template("captions.html").module.LOOKS
    assert len(looks) == 10
    assert not any("In (d)" in look for look in looks.values())


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


def test_no_line_ends_within_a_name_or_a_ratio():
    made = table(["table, scheme", "peak |σ|"], [["3 (4.13)", "1"]], "whole")
    assert "3\u00a0(4.13)" in made
    assert "peak |\u2060σ\u2060|" in made
    assert typeset("1.5 ×/÷ 1.2") == "1.5\u00a0×/\u2060÷\u00a01.2"
