"""The page and the command that makes it: whole, and self-contained."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from dumont2002 import reproduce as reproducing
from dumont2002.__main__ import main
from dumont2002.claims import FAILS, HOLDS, NOT_MEASURED, SCHEME_ONLY
from dumont2002.page import DOI
from dumont2002.reproduce import reproduce
from dumont2002.table import Reading

STORE = Path(__file__).parents[2] / "reference"


def check(text: str) -> list[str]:
    """The pictures' texts of a page that stands alone: links lead to its ids, nothing is loaded from outside."""
    ids, sources = (re.findall(rf'\s(?:{name})="([^"]*)"', text) for name in ("id", "src|href"))
    paper, images = f"https://doi.org/{DOI}", re.findall(r"<img [^>]*>", text)
    assert len(set(ids)) == len(ids)
    assert sources.count(paper) == 1
    assert {x for x in sources if x != paper and not x.startswith("data:")} <= {f"#{name}" for name in ids}
    assert all('src="data:image/png;base64,' in image for image in images)
    plain = re.sub(r"base64,[A-Za-z0-9+/=]+", "", text)
    assert not re.search(r"<script|<iframe|@import|url\(", plain)
    assert "nan" not in re.sub(r"<[^>]*>", " ", plain).lower().split()
    texts = [re.findall(r'alt="([^"]*)"', image)[0] for image in images]
    assert len(set(texts)) == len(texts) > 0
    assert all(len(words) > 30 for words in texts)
    return texts


def run(*arguments) -> int:
    return main([*map(str, arguments)])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """``figure 17`` as a user runs it: the quickest table, and the one with a panel more."""
    out = tmp_path_factory.mktemp("reproduction")
    code = run("figure", "17", "--references", STORE, "--out", out, "--json", out / "17.json")
    assert code == 0
    return out


@pytest.mark.slow
def test_the_page_of_one_table_is_whole_and_stands_alone(made):
    text = (made / "index.html").read_text(encoding="utf-8")
    assert len(check(text)) == 1
    assert (made / "figure17.png").stat().st_size > 50_000
    assert 'id="table-17"' in text
    assert not list(made.glob("*.partial"))


@pytest.mark.slow
def test_the_numbers_of_a_table_hold_together(made):
    found = json.loads((made / "17.json").read_text(encoding="utf-8"))["tables"]["table17"]
    run_, true = found["runs"]["(4.13)"], found["exact"]["displacement"]
    manifest = json.loads((STORE / "MANIFEST.json").read_text(encoding="utf-8"))["references"]
    entry = next(e for e in manifest if "table17" in e["tables"])
    assert true["impacts"] == entry["impacts"]
    assert true["fraction"] == pytest.approx(entry["contact_fraction"], rel=1e-6)
    assert true["sampled"] <= true["impacts"]  # a step can jump over a short visit
    assert 0.1 < true["horizon"] < 0.4
    assert 0.0 < run_["matched_until"] <= true["horizon"]
    assert run_["fast"] < true["fast"]
    # The run itself belongs to its ensemble, the true motion to the true one: within four deviations.
    for row in (run_, true):
        counts = np.array(row["members"]["impacts"])
        assert abs(row["impacts"] - np.mean(counts)) < 4.0 * np.std(counts, ddof=1) * np.sqrt(1 + 1 / len(counts))
    assert found["periods"] >= 10


@pytest.mark.slow
def test_a_second_run_takes_the_table_from_the_store(made, monkeypatch):
    monkeypatch.setattr(reproducing, "make_table", None)
    before = (made / "index.html").read_text(encoding="utf-8")
    assert run("table", "17", "--references", STORE, "--out", made) == 0
    after = (made / "index.html").read_text(encoding="utf-8")
    footer = re.compile(r"<footer.*</footer>", re.DOTALL)
    assert footer.sub("", after) == footer.sub("", before)


def test_an_interruption_loses_the_running_table_only(monkeypatch, tmp_path):
    asked: list[tuple] = []

    def part(number, reading, members):
        asked.append((number, reading.contact, *members))
        if asked.count(asked[-1]) == 1 and number == 14:
            raise KeyboardInterrupt
        return {"numbers": {"table": number}, "pictures": {}}

    monkeypatch.setattr(reproducing, "table_part", part)
    monkeypatch.setattr(reproducing, "write_page", lambda file, *_: file)
    with pytest.raises(KeyboardInterrupt):
        reproduce([10, 14], Reading(), tmp_path, 1)
    _, made = reproduce([10, 14], Reading(), tmp_path, 1)
    assert made[14]["numbers"] == {"table": 14}
    assert [number for number, *_ in asked] == [10, 14, 14]
    reproduce([10], Reading("extrapolated"), tmp_path, 1, (3, 2))  # another reading is another table
    assert asked[3:] == [(10, "extrapolated", 3, 2)]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["table"], "table N"),
        (["chapter", "3"], "all, table N or figure N"),
        (["all", "3"], "all, table N or figure N"),
        (["table", "18"], "1 to 17"),
        (["table", "3", "--contact", "soft"], "implicit"),
        (["table", "3", "--references", "nowhere"], "MANIFEST"),
        (["table", "3", "--jobs", "0"], ">= 1"),
    ],
)
def test_bad_input_is_refused_with_a_remedy(arguments, words, monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    assert words in capsys.readouterr().err


# ---------------------------------------------------------------- everything


@pytest.mark.campaign
def test_the_whole_reproduction(tmp_path):
    """Every table, claim and misprint on one page; small ensembles, for time."""
    file, tables = reproduce(None, Reading(references=str(STORE)), tmp_path, 2, (6, 2))
    assert list(tables) == list(range(1, 18))
    text = file.read_text(encoding="utf-8")
    assert len(check(text)) == 17 + 3  # Table 10 at its stop, shares of contact, Section 5.1
    assert all(f'id="table-{n}"' in text for n in range(1, 18))
    assert not any(part["numbers"]["failures"] for part in tables.values())
    row = r"<td>([^<]*)</td>\s*<td>[^<]*</td>\s*<td>[^<]*</td>\s*<td>([^<]*)</td>\s*</tr>"
    verdicts = dict(re.findall(row, text[text.index('id="claims"') : text.index('id="without-contact"')]))
    assert len(verdicts) > 20
    assert NOT_MEASURED not in verdicts.values()
    # What other tests and the references' manifest know already.
    known = {
        "“The duration of free flights is very short comparing": SCHEME_ONLY,
        "“The contact time is relatively long in comparison": SCHEME_ONLY,
        "“Higher is the value of γ, higher is the damping”": FAILS,
        "“The solutions obtained with the schemes (4.12) and (4.14) are exactly": HOLDS,
        "“Both discretisations in space are second order": HOLDS,
    }
    for words, verdict in known.items():
        assert [found for claim, found in verdicts.items() if claim.startswith(words)] == [verdict], words
