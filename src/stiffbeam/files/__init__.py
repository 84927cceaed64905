"""Case files, and the tables of the paper as text: what only prints them needs no SciPy, which a case loads."""

from __future__ import annotations

import re
import tomllib
from importlib import resources


def paper_text() -> str:
    """The data file of the paper's tables, as a start for a case file."""
    return resources.files(__name__).joinpath("paper.toml").read_text(encoding="utf-8")


def case_blocks(text: str) -> dict[str, str]:
    """The text of each case of a TOML file as it stands there, with its comments, by name."""
    blocks = ["[[case]]" + block.rstrip() + "\n" for block in re.split(r"(?m)^\[\[case\]\]", text)[1:]]
    return {tomllib.loads(block)["case"][0].get("name"): block for block in blocks}
