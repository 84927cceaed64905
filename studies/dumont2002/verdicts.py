"""What a claim is, what is found of it, and the verdicts there are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .evidence import Evidence

HOLDS = "holds"
PARTLY = "holds in part"
FAILS = "does not hold"
SCHEME_ONLY = "of the schemes only"  # of the paper's computation, and not of the beam it computes
OPEN = "open"  # the spread of the members leaves it undecided, or other members decide it otherwise
UNTESTABLE = "cannot be tested here"
NOT_MEASURED = "not measured"
VERDICTS = (HOLDS, PARTLY, FAILS, SCHEME_ONLY, OPEN, UNTESTABLE, NOT_MEASURED)


@dataclass(frozen=True)
class Finding:
    """What was measured, in a sentence with numbers, and the verdict."""

    measured: str
    verdict: str


@dataclass(frozen=True)
class Claim:
    """section: where the paper says it. words: what it says, quoted where the quotation is short.

    rule: when it holds, and where a threshold comes from. check: measures it. tables: those whose
    ensembles are the evidence; such a claim is judged once with each set of seeds. evidence: what else it
    stands on.
    """

    section: str
    words: str
    rule: str
    check: Callable[[Evidence], Finding]
    tables: tuple[int, ...] = ()
    evidence: str = ""

    @property
    def name(self) -> str:
        """An id that stays: section and words."""
        return f"{self.section}: {self.words}"


def of_both(measured: str, of_runs: bool | None, of_beam: bool | None) -> Finding:
    """A finding about the motion; where it is open, what of it is."""
    found = verdict(of_runs, of_beam)
    if found == OPEN:
        measured += f" Of the runs it {_SAID[of_runs]}, of the exact motion it {_SAID[of_beam]}."
    return Finding(measured, found)


_SAID = {True: "holds", False: "does not hold", None: "is open"}


def verdict(of_runs: bool | None, of_beam: bool | None) -> str:
    """Of a statement about the motion, from whether the paper's runs and the exact motion have it."""
    if of_runs is None or of_beam is None:
        return OPEN
    if of_beam:
        return HOLDS if of_runs else PARTLY
    return SCHEME_ONLY if of_runs else FAILS


def plain_verdict(statement: bool | None) -> str:
    """Of a statement that holds or not."""
    return OPEN if statement is None else HOLDS if statement else FAILS
