"""The paper's statements that can be tested: where they stand, how they are measured, whether they hold."""

from __future__ import annotations

from collections.abc import Iterator

from stiffbeam.basics.validation import InputError
from stiffbeam.trajectory.trajectory import Diverged, SolverFailure

from . import claims_bdf, claims_linear, claims_other, claims_pair, claims_sdirk
from .ensembles import SEEDS
from .evidence import Evidence, NotMeasured
from .verdicts import NOT_MEASURED, OPEN, Claim, Finding


def claims() -> list[Claim]:
    """All of them in the paper's order."""
    files = (claims_linear, claims_bdf, claims_sdirk, claims_pair, claims_other)
    return sorted((claim for file in files for claim in file.CLAIMS), key=lambda claim: _place(claim.section))


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


def _place(section: str) -> list[float]:
    """Sections and then tables in reading order: ``5.2, Table 3`` after ``5.2, Table 2``."""
    section, _, table = section.partition(", Table ")
    parts = [float(x) for x in section.split(".")]
    return [*parts, *[0.0] * (4 - len(parts)), float(table or 0)]
