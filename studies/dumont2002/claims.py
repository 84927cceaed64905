"""The paper's claims about numbers, each with its rule and the function that measures it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from stiffbeam.basics.validation import InputError
from stiffbeam.trajectory.trajectory import Diverged, SolverFailure

from . import judges_linear as linear
from . import judges_motions as motions
from . import judges_runs as runs
from .ensembles import SEEDS
from .evidence import Evidence, NotMeasured
from .verdicts import NOT_MEASURED, OPEN, Finding


@dataclass(frozen=True)
class Claim:
    """A statement of the paper. rule: when it holds. check: measures it.

    tables: those whose ensembles are the evidence; the claim is then judged once with each set of seeds. evidence: what
    else it stands on.
    """

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


def _of(section: str, words: str, rule: str, judge: Callable[..., Finding], *tables: int, **arguments: object) -> Claim:
    """Return a claim about the ensembles of tables."""
    return Claim(section, words, rule, lambda e: judge(e, *tables, **arguments), tables)


def _contact(section: str, words: str, rule: str, table: int, **limits: float) -> Claim:
    return _of(section, words, rule, partial(motions.motions, measure="fraction"), table, **limits)


def _depth(section: str, words: str, rule: str, table: int, **limits: float) -> Claim:
    return _of(section, words, rule, partial(motions.motions, measure="depth"), table, **limits)


HALF = "more than half of the time is contact"
ORDER = "the observed order is the stated one to 0.1, what is left of the next order on the grids used"
SMOOTH = "A smooth forced problem, steps halved four times"
MATRICES = "Amplification matrices"
TIMINGS = "Timings of this machine, see CPU time"
CLAIMS = (
    Claim("3", "“Both discretisations in space are second order discretisations” (Remark 5)", ORDER,
          linear.order_in_space,
          evidence="Steady tip response to the moving clamp in closed form, M = 20 to 112"),
    Claim("4.1", "The matrix of (3.12) “has only purely imaginary eigenvalues” (Remark 6)",
          "real parts vanish to the square root of rounding, what a pair that nearly coincides can gain",
          linear.imaginary_eigenvalues, evidence="Eigenvalues"),
    Claim("4.1", "“Higher is the value of γ, higher is the damping”",
          "the spectral radius of a fast oscillation falls with every γ", linear.higher_gamma,
          evidence="Stability function"),
    Claim("4.1", "SDIRK-OS is “L-stable for all γ” in [0.1804, 2.1856]",
          "|R| ≤ 1 on the imaginary axis inside the interval and not outside", linear.l_stable,
          evidence="Stability function"),
    Claim("4.3", "HHT is “quadratically convergent”", ORDER, linear.hht_order, evidence=SMOOTH),
    Claim("4.3", "HHT is “unconditionally stable for linear problems” for α in [−1/3, 0]",
          "no spectral radius exceeds 1 by more than rounding, at any step", linear.hht_stable, evidence=MATRICES),
    Claim("4.3", "In HHT “the parameter α permits to control the damping of the higher modes”",
          "the spectral radius at high frequency falls with every α", linear.hht_control, evidence=MATRICES),
    Claim("4.3", "First-order Newmark affects the low modes, HHT “has better dissipation properties” (Remark 11)",
          "Newmark with γ > 1/2 damps a low mode ten times as much: order one against order three in dt",
          linear.newmark, evidence=MATRICES),
    Claim("4.3", "SDIRK-OS has “superior stability properties” to HHT",
          "both are stable at every step, and only SDIRK-OS forgets a fast mode within one", linear.superior_stability,
          evidence=MATRICES),
    Claim("4.3", "SDIRK-OS has “relative period errors smaller than the HHT”",
          "its elongation is smaller for both γ of the paper; in part for one", linear.period_errors,
          evidence=MATRICES),
    Claim("5.1", "Without contact the schemes show “stability and accuracy”",
          "the error stays below a hundredth of the motion over the whole span", linear.without_contact,
          evidence="Section 5.1 below"),
    Claim("5.2", "BDF and HHT “introduce numerical damping which lead to period elongation” of the lower modes",
          "elongation and damping are positive at every step up to three a period", linear.elongation_and_damping,
          evidence=MATRICES),
    _contact("5.2, Table 1", "There is contact “over considerable periods of time”",
             "contact takes a quarter of the time or more: a plateau that shows in every period", 1, more_than=0.25),
    _depth("5.2, Table 1", "“There is little deflection at the stops”",
           "the deepest visit is less than a tenth of the clearance", 1, less_than=0.1),
    _depth("5.2, Table 2", "“At contact, there is no deflection”",
           "the deepest visit is less than 1 % of the clearance, the width of a line in print", 2, less_than=0.01),
    _of("5.2, Table 2", "“The number of impact is higher” than with the stiff beam",
        "more impacts to T than on Table 1, outside the spread", partial(motions.between_tables, measure="impacts"),
        1, 2),
    _contact("5.2, Table 3", "“The duration of free flights is very short comparing with the duration of contacts”",
             HALF, 3, more_than=0.5),
    Claim("5.2, Table 5", "“Except for some computations, the three methods need the same CPU-time”",
          "the median ratio to HHT lies between 1/2 and 2, as the paper's do", runs.same_time, evidence=TIMINGS),
    Claim("5.3, Table 8", "“The solutions obtained with the schemes (4.12) and (4.14) are exactly similar”",
          "they differ by rounding until chaos magnifies it", runs.exactly_similar,
          evidence="Tables 6 and 8, one run each to T"),
    Claim("5.4", "With γ = 0.4359 “the SDIRK scheme becomes third order accurate”",
          "the observed order is 3 to 0.1", runs.third_order, evidence=SMOOTH),
    _of("5.4, Table 10", "“These two methods give different results at impacts”",
        "their counts of impacts differ outside the spread", motions.runs_differ, 10, measure="impacts",
        beside="fraction"),
    Claim("5.4, Table 13", "“The HHT-α is clearly the faster algorithm”",
          "it is faster a step, and at every equal error; in part where it is faster a step only", runs.hht_faster,
          evidence="Timings, and 8 steps to a factor of two inside the horizon"),
    _of("5.4, Table 13", "“The number of impacts could depend on the choice of the method”",
        "the counts of HHT and SDIRK differ outside the spread on all four tables; in part on some",
        motions.counts_differ, 10, 11, 12, 13),
    _contact("5.5.1, Table 14", "“The duration of the free flight is longer with respect to the duration of contact”",
             "less than half of the time is contact", 14, less_than=0.5),
    _contact("5.5.2, Table 15", "“The contact time is relatively long in comparison with the free flight”", HALF, 15,
             more_than=0.5),
)  # fmt: skip


def judged(evidence: Evidence) -> Iterator[dict[str, str]]:
    """Every claim with what was measured; one that cannot be measured says why."""
    for claim in CLAIMS:
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
