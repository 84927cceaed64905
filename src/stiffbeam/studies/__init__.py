"""Studies: questions asked of a case, records out. A new study is one module and one line here."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ..validation import InputError, near
from .study import Records, Study

# The order in which they answer: one step, one run, many runs, many steps.
STUDIES = (
    "amplification", "modes", "energy", "converge", "space", "rigid", "errata", "impacts", "precision", "ensemble",
    "chaos", "sweep",
)  # fmt: skip


def find_study(name: str) -> Study:
    """The registered study ``name``."""
    if name not in STUDIES:
        raise InputError("study", name, "be a registered study", near(name, STUDIES))
    return import_module(f".{name}", __name__).STUDY


def study(name: str, case: Any = "table10", **options: Any) -> Records:
    """Run a study on a case; options are those of ``run_study`` and the study's own.

    >>> records = study("amplification", schemes=["bdf2", "hht(alpha=-0.1)"])  # doctest: +SKIP
    >>> records.answer, records.to_dataframe(), records.figure()  # doctest: +SKIP
    """
    from .runner import run_study

    return run_study(find_study(name), case, **options)


__all__ = ["STUDIES", "Records", "Study", "find_study", "study"]
