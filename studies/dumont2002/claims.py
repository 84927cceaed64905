"""The paper's statements that can be tested, read from claims.toml, each with its verdict."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiffbeam.basics.validation import InputError
from stiffbeam.trajectory.trajectory import Diverged, SolverFailure

# Their functions enter JUDGES.
from . import judges_linear as judges_linear
from . import judges_motions as judges_motions
from . import judges_runs as judges_runs
from .ensembles import SEEDS
from .evidence import Evidence, NotMeasured
from .verdicts import JUDGES, NOT_MEASURED, OPEN, Finding


@dataclass(frozen=True)
class Claim:
    """A statement of claims.toml, whose head explains the entries. check: its judge with tables and arguments."""

    section: str
    words: str
    rule: str
    check: Callable[[Evidence], Finding]
    tables: tuple[int, ...] = ()
    evidence: str = ""

    @property
    def name(self) -> str:
        """Section and words."""
        return f"{self.section}: {self.words}"


def claims() -> list[Claim]:
    """All claims in the paper's order."""
    sections = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    rules = sections.pop("rules")
    return [_claim(section, entry, rules) for section, entries in sections.items() for entry in entries]


def _claim(section: str, entry: dict[str, Any], rules: dict[str, dict[str, Any]]) -> Claim:
    base = rules.get(entry.get("like", ""), {})
    arguments = base.get("arguments", {}) | entry.get("arguments", {})
    whole = base | entry
    evidence, number = entry.get("evidence", ""), section.partition(", Table ")[2]
    tables = tuple(entry.get("tables", [int(number)] if number and not evidence else []))
    function = JUDGES[whole["judge"]]
    return Claim(section, entry["claim"], whole["rule"], lambda e: function(e, *tables, **arguments), tables, evidence)


def judged(evidence: Evidence) -> Iterator[dict[str, str]]:
    """Every claim with what was measured; one that cannot be measured says why."""
    for claim in claims():
        try:
            finding = judge(claim, evidence)
        except (NotMeasured, Diverged, SolverFailure, InputError) as reason:
            finding = Finding(f"Not measured: {reason}.", NOT_MEASURED)
        stands_on = [*(evidence.span(table) for table in claim.tables), *([claim.evidence] if claim.evidence else [])]
        yield {
            "section": claim.section,
            "claim": claim.words,
            "rule": claim.rule,
            "measured": finding.measured,
            "evidence": "; ".join(stands_on),
            "verdict": finding.verdict,
        }


def judge(claim: Claim, evidence: Evidence) -> Finding:
    """The finding with all members, OPEN where one set of seeds alone decides otherwise.

    A set with too few members to decide does not contradict.
    """
    whole = claim.check(evidence)
    if not claim.tables:
        return whole
    each = {seed: claim.check(evidence.of(seed)).verdict for seed in SEEDS}
    if set(each.values()) <= {whole.verdict, OPEN}:
        return whole
    said = "; ".join(f"{verdict} with seeds {seed}" for seed, verdict in each.items())
    return Finding(f"{whole.measured} The verdict depends on the seeds: {said}; {whole.verdict} with both.", OPEN)
