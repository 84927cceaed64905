"""The paper's statements that can be tested: where they stand, what was measured, whether they hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from .numbers import Numbers
from .reading import Reading

HOLDS = "holds"
FAILS = "does not hold"
SCHEME_ONLY = "true of the scheme only"  # of the paper's computation, and not of the beam it computes
PARTLY = "holds in part"


@dataclass(frozen=True)
class Finding:
    """What was measured, in a sentence with numbers, and the verdict."""

    measured: str
    verdict: str


@dataclass(frozen=True)
class Evidence:
    """All that a check may look at: the numbers of every table, the costs, and how the paper was read."""

    tables: dict[int, Numbers]
    costs: list[dict[str, Any]]
    reading: Reading

    def run(self, table: int, equation: str) -> Numbers:
        return self.tables[table]["runs"][equation]

    def runs(self, table: int) -> dict[str, Numbers]:
        return self.tables[table]["runs"]

    def true(self, table: int, form: str = "displacement") -> Numbers:
        return self.tables[table]["true"][form]


@dataclass(frozen=True)
class Claim:
    """section: where the paper says it. text: what it says. check: measures it."""

    section: str
    text: str
    check: Callable[[Evidence], Finding]


def claims() -> list[Claim]:
    """All of them in the paper's order."""
    from . import claims_motion, claims_schemes

    return sorted([*claims_schemes.CLAIMS, *claims_motion.CLAIMS], key=lambda claim: _place(claim.section))


def judged(evidence: Evidence) -> Iterator[dict[str, str]]:
    """Every claim with what was measured; one whose run is missing (it overflowed) says so."""
    for claim in claims():
        try:
            finding = claim.check(evidence)
        except KeyError as missing:
            finding = Finding(f"not measured: {missing.args[0]} overflowed in this reading", "not measured")
        yield {
            "section": claim.section,
            "claim": claim.text,
            "measured": finding.measured,
            "verdict": finding.verdict,
        }


def verdict(of_runs: bool, of_truth: bool) -> str:
    """Of a statement about the motion, from whether the paper's runs and the true motion have it."""
    if of_truth:
        return HOLDS if of_runs else PARTLY
    return SCHEME_ONLY if of_runs else FAILS


def _place(section: str) -> list[float]:
    """Sections and then tables in reading order: ``5.2, Table 3`` after ``5.2, Table 2``."""
    section, _, table = section.partition(", Table ")
    parts = [float(x) for x in section.split(".")]
    return [*parts, *[0.0] * (4 - len(parts)), float(table or 0)]
