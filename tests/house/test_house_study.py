"""The table of studies/house.py: size of the package, and files that calls enter."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

HOUSE = Path(__file__).parents[2] / "studies" / "house.py"
MOST = {"integrate, HHT": 28}  # files that a call may enter


@pytest.fixture(scope="module")
def house():
    return SimpleNamespace(**runpy.run_path(str(HOUSE)))


@pytest.mark.parametrize("name", MOST)
def test_a_call_enters_few_files(house, name, tmp_path):
    entered = house.files_entered(house.calls(tmp_path)[name])
    assert "march/integrate.py" in entered
    assert len(entered) <= MOST[name], sorted(entered)


@pytest.mark.slow
def test_the_table_has_a_line_for_every_call(house, tmp_path):
    done = subprocess.run([sys.executable, HOUSE], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert re.search(r"package: \d+ lines in \d+ files, [\d.]+ % of the lines comments", done.stdout)
    for name in house.calls(tmp_path):
        assert re.search(rf"^    {re.escape(name)} +[1-9]\d*$", done.stdout, re.MULTILINE)


def test_sentences_are_those_of_the_prose(house):
    prose = "# Head\n\nOne [two](three/four.md). Five `six`!\n\n* seven\n\n"
    page = prose + "| eight |\n\n```text\nnine. ten.\n```\n\n    eleven\n"
    assert house.sentences(page) == ["One [two.", "Five six!", "seven"]
    assert re.fullmatch(r"pages: \d+, \d+ words, 90 % of sentences have at most \d+, .*", house.words(None))


def test_the_pages_are_in_short_sentences(house):
    said = [sentence for text in house.pages(None) for sentence in house.sentences(text)]
    lengths = sorted(len(sentence.split()) for sentence in said)
    assert lengths[9 * len(lengths) // 10] < 28
