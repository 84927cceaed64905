"""Verdicts on claims, and the functions that reach them."""

from __future__ import annotations

from dataclasses import dataclass

HOLDS = "holds"
PARTLY = "holds in part"
FAILS = "does not hold"
SCHEME_ONLY = "of the schemes only"  # of the paper's computation, and not of the beam it computes
OPEN = "open"  # the spread of the members leaves it undecided, or other members decide it otherwise
UNTESTABLE = "cannot be tested here"
NOT_MEASURED = "not measured"
PLURAL = {
    HOLDS: "hold", PARTLY: "hold in part", FAILS: "do not hold", SCHEME_ONLY: "hold of the schemes only",
    OPEN: "stay open", UNTESTABLE: "cannot be tested here", NOT_MEASURED: "could not be measured",
}  # fmt: skip
VERDICTS = tuple(PLURAL)


@dataclass(frozen=True)
class Finding:
    """Measurement as a sentence with numbers, and the verdict."""

    measured: str
    verdict: str


def of_both(measured: str, of_runs: bool | None, of_beam: bool | None) -> Finding:
    """Finding on a statement about the motion; an open one says which part is open."""
    found = verdict(of_runs, of_beam)
    if found == OPEN:
        words = {True: "holds", False: "does not hold", None: "is open"}
        measured += f" Of the runs it {words[of_runs]}, of the exact motion it {words[of_beam]}."
    return Finding(measured, found)


def verdict(of_runs: bool | None, of_beam: bool | None) -> str:
    """Verdict on a statement about the motion, from the paper's runs and the exact motion."""
    if of_runs is None or of_beam is None:
        return OPEN
    if of_beam:
        return HOLDS if of_runs else PARTLY
    return SCHEME_ONLY if of_runs else FAILS


def plain_verdict(statement: bool | None) -> str:
    """Verdict on a statement that holds, fails or stays open."""
    return OPEN if statement is None else HOLDS if statement else FAILS


def shared_verdict(all_of: bool | None, any_of: bool | None) -> str:
    """HOLDS where all cases agree, PARTLY where some do."""
    return HOLDS if all_of else OPEN if all_of is None else PARTLY if any_of else FAILS
