"""The paper's claims about numbers, each a function that measures it and returns a sentence and a verdict.

The first line of its docstring is the rule: when the claim holds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import Any

import numpy as np

import stiffbeam as sb
from stiffbeam.measures.errors import Order, observed_order
from stiffbeam.measures.report import percent
from stiffbeam.model.right_hand_side import first_order, over_mass
from stiffbeam.model.semidiscretisation import FORMS
from stiffbeam.schemes import PrintedSigma
from stiffbeam.schemes.newmark import WeightedNewmark
from stiffbeam.schemes.sdirk import GAMMA_MAX, GAMMA_MIN
from stiffbeam.studies.space import Space

from .costs import CPU_TABLES, ratios, step_ratios
from .misprints import forced_order
from .no_contact import GRIDS
from .numbers import Numbers, above, spread
from .table import Reading

HOLDS, PARTLY, FAILS = "holds", "holds in part", "does not hold"
SCHEME_ONLY = "of the schemes only"  # of the paper's computation, and not of the beam it computes
OPEN = "open"  # the spread of the members leaves it undecided
NOT_MEASURED = "not measured"

Finding = tuple[str, str]  # a sentence with numbers, and the verdict


@dataclass(frozen=True)
class Evidence:
    """Numbers of all tables, costs, errors of Section 5.1, and the reading of the paper."""

    tables: dict[int, Numbers]
    costs: list[dict[str, Any]]
    errors: list[dict[str, Any]]
    reading: Reading

    def motions(self, table: int) -> dict[str, Numbers]:
        """Rows of the runs of a table, then of its exact motions. Raises ValueError where a run overflowed."""
        found = self.tables[table]
        rows = {**found["runs"], **{f"exact, {form}": row for form, row in found["exact"].items()}}
        lost = [*found["failures"], *(name for name, row in rows.items() if not row["members"]["impacts"])]
        if lost:
            raise ValueError(f"{', '.join(lost)} overflowed on Table {table}")
        return rows


Judge = Callable[[Evidence], Finding]
CLAIMS: list[tuple[str, str, Judge]] = []  # section, words, function


def claim(section: str, words: str) -> Callable[[Judge], Judge]:
    """Register a function that judges a claim."""

    def register(judge: Judge) -> Judge:
        CLAIMS.append((section, words, judge))
        return judge

    return register


def judged(evidence: Evidence) -> Iterator[dict[str, str]]:
    """Every claim with its rule, what was measured, and the verdict; one that cannot be measured states why."""
    for section, words, judge in CLAIMS:
        try:
            measured, verdict = judge(evidence)
        except (sb.Diverged, sb.SolverFailure, ValueError) as reason:
            measured, verdict = f"Not measured: {reason}.", NOT_MEASURED
        rule = (judge.__doc__ or "").splitlines()[0]
        yield {"section": section, "claim": words, "holds if": rule, "measured": measured, "verdict": verdict}


def in_parts(statements: Iterable[bool | None]) -> str:
    """Verdict on one or several statements of one kind."""
    found = list(statements)
    return HOLDS if all(found) else OPEN if None in found else PARTLY if any(found) else FAILS


def plainly(*statements: Any) -> str:
    """Verdict on statements that hold all, or else fail."""
    return HOLDS if all(statements) else FAILS


def of_order(expected: float, *orders: Order) -> str:
    """Verdict on observed orders: equal to the expected one to 0.1."""
    return plainly(*(abs(order.slope - expected) < 0.1 for order in orders))


def of_both(runs: Iterable[bool | None], beam: Iterable[bool | None]) -> str:
    """Verdict on a statement about the motion, from the paper's runs and the exact motions."""
    ours, true = ([*x] for x in (runs, beam))
    if None in (*ours, *true):
        return OPEN
    return (HOLDS if all(ours) else PARTLY) if all(true) else SCHEME_ONLY if all(ours) else FAILS


def falling(words: str, schemes: dict[float, sb.Scheme], dt_over_period: float) -> Finding:
    """Finding on spectral radii at one step by parameter of the scheme: they fall with it."""
    radii = {x: float(sb.amplification(s, dt_over_period).spectral_radius[0]) for x, s in schemes.items()}
    pairs = ", ".join(f"{radius:.3f} at {x:.4g}" for x, radius in radii.items())
    return f"{words}: {pairs}.", plainly(*(a > b for a, b in pairwise(radii.values())))


# ---------------------------------------------------------------- Sections 3 and 4: discretisations and schemes


@claim("3", "“Both discretisations in space are second order discretisations” (Remark 5)")
def order_in_space(e: Evidence) -> Finding:
    """The observed order is 2 to 0.1."""
    case, grids = sb.paper_case(2), (20, 28, 40, 56, 80, 112)
    errors = ([Space().run(case, "response", form, n)[0]["error"] for n in grids] for form in FORMS)
    first, second = (observed_order([1.0 / n for n in grids], of_form) for of_form in errors)
    return f"Order in h of the steady tip response: (3.5) {first}, (3.12) {second}.", of_order(2.0, first, second)


@claim("4.1", "The matrix of (3.12) “has only purely imaginary eigenvalues” (Remark 6)")
def imaginary_eigenvalues(e: Evidence) -> Finding:
    """Real parts vanish to the square root of rounding."""
    values = np.linalg.eigvals(first_order(*over_mass(sb.paper_case(2).system("velocity-curvature"))[:2]))
    values = values[np.abs(values) > 1.0]
    share = float(np.max(np.abs(values.real) / np.abs(values)))
    return f"Largest |Re|/|lambda|, h = 0.04: {share:.1e}.", plainly(share < 1e-6)


@claim("4.1", "“Higher is the value of γ, higher is the damping”")
def higher_gamma(e: Evidence) -> Finding:
    """The spectral radius of a fast oscillation falls with every γ."""
    gammas = (0.18043, 0.2, 0.35, 0.4359, 0.7, 0.8, 1.0)  # away from the poles of the tableau
    return falling("|R(10 i)|", {g: sb.SDIRK(g) for g in gammas}, 10.0 / (2.0 * np.pi))


@claim("4.1", "SDIRK-OS is “L-stable for all γ” in [0.1804, 2.1856]")
def l_stable(e: Evidence) -> Finding:
    """|R| ≤ 1 on the imaginary axis inside the interval and not outside."""
    z = 1j * np.logspace(-3, 4, 4000)

    def largest(g: float) -> float:
        numerator = (3 * g**2 - 3 * g + 0.5) * z**2 - (3 * g - 1) * z + 1
        return float(np.max(np.abs(numerator / (1 - g * z) ** 3))) - 1.0

    inside = max(largest(g) for g in np.linspace(GAMMA_MIN, GAMMA_MAX, 60))
    outside = min(largest(GAMMA_MIN - 0.002), largest(GAMMA_MAX + 0.02))
    interval = f"[{GAMMA_MIN:.5f}, {GAMMA_MAX:.5f}]"
    measured = f"max |R(iy)| − 1: at most {max(inside, 0.0):.0e} inside {interval}, at least {outside:.0e} outside."
    return measured, plainly(inside < 1e-12 < outside)


@claim("4.3", "HHT is “quadratically convergent”")
def hht_order(e: Evidence) -> Finding:
    """The observed order is 2 to 0.1."""
    found = {alpha: forced_order(sb.HHT(alpha)) for alpha in (-0.05, -0.1, -0.3)}
    orders = ", ".join(f"{order} at α = {alpha:g}" for alpha, order in found.items())
    return f"Order on a smooth forced problem: {orders}.", of_order(2.0, *found.values())


ALPHAS = (0.0, -0.05, -0.1, -0.2, -0.3, -1.0 / 3.0)
STEPS = np.logspace(-3, 4, 400)  # dt/T


@claim("4.3", "HHT is “unconditionally stable for linear problems” for α in [−1/3, 0]")
def hht_stable(e: Evidence) -> Finding:
    """No spectral radius exceeds 1 by more than rounding, at any step."""
    inside = max(float(np.max(sb.amplification(sb.HHT(a), STEPS).spectral_radius)) - 1.0 for a in ALPHAS)
    return f"Largest spectral radius less 1, dt/T from 10⁻³ to 10⁴: {inside:.0e}.", plainly(inside < 1e-9)


@claim("4.3", "In HHT “the parameter α permits to control the damping of the higher modes”")
def hht_control(e: Evidence) -> Finding:
    """The spectral radius at high frequency falls with every α."""
    return falling("Spectral radius at high frequency", {a: sb.HHT(a) for a in ALPHAS}, 1e4)


class FirstOrderNewmark(WeightedNewmark):
    """Newmark with gamma = 0.6 > 1/2 and beta = (gamma + 1/2)^2/4, undamped at no frequency (Remark 11)."""

    order = 1

    def __init__(self) -> None:
        super().__init__(0.0, 0.0)
        self.gamma, self.beta = 0.6, 1.1**2 / 4.0


@claim("4.3", "First-order Newmark affects the low modes, HHT “has better dissipation properties” (Remark 11)")
def newmark(e: Evidence) -> Finding:
    """Newmark with γ > 1/2 damps a low mode ten times as much: order one against order three in dt."""
    a, b = (float(sb.amplification(s, 0.01).damping_ratio[0]) for s in (FirstOrderNewmark(), sb.HHT(-0.1)))
    measured = f"Damping ratio at 100 steps a period: {a:.1e} for Newmark, γ = 0.6, {b:.1e} for HHT(alpha=-0.1)."
    return measured, plainly(a > 10.0 * b)


@claim("4.3", "SDIRK-OS has “superior stability properties” to HHT")
def superior_stability(e: Evidence) -> Finding:
    """Both are stable at every step, and only SDIRK-OS forgets a fast mode within one."""
    radii = [
        sb.amplification(s, STEPS).spectral_radius
        for s in (sb.SDIRK(), sb.SDIRK(1.0), sb.HHT(-0.1), sb.HHT(-1.0 / 3.0))
    ]
    ends = [float(r[-1]) for r in radii]
    measured = f"Radius at high frequency: SDIRK-OS {ends[0]:.1e} (γ = 0.4359), {ends[1]:.1e} (γ = 1), HHT "
    measured += f"{ends[2]:.2f} (α = −0.1), {ends[3]:.2f} at the least (α = −1/3)."
    return measured, plainly(np.max(radii) < 1.0 + 1e-9, max(ends[:2]) < 0.01 < min(ends[2:]))


@claim("4.3", "SDIRK-OS has “relative period errors smaller than the HHT”")
def period_errors(e: Evidence) -> Finding:
    """Its elongation is smaller for both γ of the paper; in part for one."""
    hht, *sdirk = (
        float(sb.amplification(s, 0.1).period_elongation[0]) for s in (sb.HHT(-0.1), sb.SDIRK(), sb.SDIRK(1.0))
    )
    measured = f"Period elongation at ten steps a period: HHT(alpha=-0.1) {percent(hht)}; SDIRK-OS {percent(sdirk[0])} "
    measured += f"with γ = 0.4359, {percent(sdirk[1])} with γ = 1."
    return measured, in_parts(abs(x) < abs(hht) for x in sdirk)


@claim("5.1", "Without contact the schemes show “stability and accuracy”")
def without_contact(e: Evidence) -> Finding:
    """The error stays below a hundredth of the motion over the whole span."""
    largest = {row["curve"]: row["largest error"] for row in e.errors}
    first, second = (largest.pop(grid) for grid in GRIDS)
    most = max(largest.values())
    measured = f"Largest error of a scheme {most:.1e}; of the grid alone {first:.1e} on (3.5), {second:.1e} on (3.12)."
    return measured, plainly(most < 0.01)


@claim("5.2", "BDF and HHT “introduce numerical damping which lead to period elongation” of the lower modes")
def elongation_and_damping(e: Evidence) -> Finding:
    """Elongation and damping are positive at every step up to three a period."""
    parts, positive = [], True
    for scheme in (sb.HHT(-0.1), sb.BDF2()):
        found, ten = sb.amplification(scheme, np.logspace(-3, -0.5, 200)), sb.amplification(scheme, 0.1)
        positive &= bool(np.all(found.period_elongation > 0.0) and np.all(found.damping_ratio > 0.0))
        parts.append(f"{scheme} {percent(float(ten.period_elongation[0]))}, {float(ten.damping_ratio[0]):.1e}")
    return f"Period elongation and damping ratio at ten steps a period: {'; '.join(parts)}.", plainly(positive)


# ---------------------------------------------------------------- Section 5: motions, from the ensembles

MEASURES = {
    "fraction": ("Share of time in contact", 100.0, " %"), "impacts": ("Impacts to T", 1.0, ""),
    "depth": ("Deepest deflection of a stop over the clearance", 100.0, " %"),
}  # fmt: skip


def said(e: Evidence, table: int, measure: str) -> str:
    """A measure of every motion of a table."""
    words, scale, unit = MEASURES[measure]
    parts = (f"{name} {spread(row, measure, scale, unit)}" for name, row in e.motions(table).items())
    return f"{words}, Table {table}: {', '.join(parts)}."


def of_motions(e: Evidence, table: int, measure: str, more: bool, other: Callable[[str], list[float]]) -> str:
    """Verdict on a measure of every motion of a table: more, or less, than that of ``other(motion)``."""
    found: dict[bool, list[bool | None]] = {True: [], False: []}
    for name, row in e.motions(table).items():
        decided = above(row["members"][measure], other(name))
        found[name.startswith("exact")].append(None if decided is None else decided is more)
    return of_both(found[False], found[True])


def limited(table: int, measure: str, limit: float, more: bool) -> Judge:
    """The judge of a measure that is above, or below, a limit."""

    def judge(e: Evidence) -> Finding:
        return said(e, table, measure), of_motions(e, table, measure, more, lambda _: [limit])

    words, scale, unit = MEASURES[measure]
    judge.__doc__ = f"{words} is {'above' if more else 'below'} {scale * limit:g}{unit}."
    return judge


claim("5.2, Table 1", "There is contact “over considerable periods of time”")(limited(1, "fraction", 0.25, True))
claim("5.2, Table 1", "“There is little deflection at the stops”")(limited(1, "depth", 0.1, False))
claim("5.2, Table 2", "“At contact, there is no deflection”")(limited(2, "depth", 0.01, False))


@claim("5.2, Table 2", "“The number of impact is higher” than with the stiff beam")
def more_impacts(e: Evidence) -> Finding:
    """More impacts to T than on Table 1, outside the spread."""
    stiff = e.motions(1)
    verdict = of_motions(e, 2, "impacts", True, lambda name: stiff[name]["members"]["impacts"])
    return f"{said(e, 1, 'impacts')} {said(e, 2, 'impacts')}", verdict


claim("5.2, Table 3", "“The duration of free flights is very short comparing with the duration of contacts”")(
    limited(3, "fraction", 0.5, True)
)


@claim("5.2, Table 5", "“Except for some computations, the three methods need the same CPU-time”")
def same_time(e: Evidence) -> Finding:
    """The median ratio to HHT lies between 1/2 and 2, as the paper's do."""
    parts, all_ratios = [], list[float]()
    for equation in ("(4.5)", "(4.11)"):
        paper, ours = ratios(e.costs, CPU_TABLES[0], equation)
        parts.append(f"{equation} {spread_of(ours)} times HHT (paper {spread_of(paper)})")
        all_ratios += ours
    return f"Time a step: {'; '.join(parts)}.", plainly(all_ratios and 0.5 < median(all_ratios) < 2.0)


@claim("5.3, Table 8", "“The solutions obtained with the schemes (4.12) and (4.14) are exactly similar”")
def exactly_similar(e: Evidence) -> Finding:
    """They differ by rounding until chaos magnifies it."""
    parts, same = [], []
    for case in map(sb.paper_case, (6, 8)):
        system, schemes = case.system(), (e.reading.scheme(sb.SDIRK(1.0, nystrom)) for nystrom in (False, True))
        a, b = (sb.integrate(system, s, case.dt, case.t_end, e.reading.contact).tip for s in schemes)
        gap = np.abs(a - b) / np.max(np.abs(a))
        early = float(np.max(gap[: len(gap) // 100]))
        parts.append(f"{case.name} {early:.0e} in the first hundredth, {np.max(gap):.0e} to the end")
        same.append(early < 1e-9)
    return f"Difference over the largest displacement: {'; '.join(parts)}.", plainly(*same)


@claim("5.4", "With γ = 0.4359 “the SDIRK scheme becomes third order accurate”")
def third_order(e: Evidence) -> Finding:
    """The observed order is 3 to 0.1."""
    right, printed = (forced_order(s) for s in (sb.SDIRK(), PrintedSigma()))
    return f"Order: {right} with the corrected sign of σ, {printed} as printed.", of_order(3.0, right)


def differing(*tables: int) -> Judge:
    """The judge of impacts that the first two runs of each table count differently."""

    def judge(e: Evidence) -> Finding:
        differ = list[bool]()
        for table in tables:
            first, second = (row["members"]["impacts"] for row in list(e.motions(table).values())[:2])
            differ.append(above(first, second) is not None)
        return " ".join(said(e, table, "impacts") for table in tables), in_parts(differ)

    some = f" on Tables {tables[0]} to {tables[-1]}; in part on some" if len(tables) > 1 else ""
    judge.__doc__ = f"The counts of HHT and SDIRK differ outside the spread{some}."
    return judge


claim("5.4, Table 10", "“These two methods give different results at impacts”")(differing(10))


@claim("5.4, Table 13", "“The HHT-α is clearly the faster algorithm”")
def hht_faster(e: Evidence) -> Finding:
    """It is faster a step, and at every equal error; in part where it is faster a step only."""
    paper, ours = ratios(e.costs, CPU_TABLES[2], "(4.14)")
    step = median(ours)  # a ValueError where no table could be timed
    work = [step * ratio for table in CPU_TABLES[2] for ratio in step_ratios(table)]
    wins = sum(x < 1.0 for x in work)
    measured = f"(4.14) takes {spread_of(ours)} times the time of HHT a step (paper {spread_of(paper)}), and "
    measured += f"{spread_of(work)} times at equal tip error, where it is the faster in {wins} of {len(work)}."
    return measured, FAILS if step <= 1.0 else PARTLY if wins else HOLDS


claim("5.4, Table 13", "“The number of impacts could depend on the choice of the method”")(differing(*CPU_TABLES[2]))
claim("5.5.1, Table 14", "“The duration of the free flight is longer with respect to the duration of contact”")(
    limited(14, "fraction", 0.5, False)
)
claim("5.5.2, Table 15", "“The contact time is relatively long in comparison with the free flight”")(
    limited(15, "fraction", 0.5, True)
)


def spread_of(values: list[float]) -> str:
    """Median and range: one table's ratio can be wrong on a busy machine."""
    return f"{median(values):.2f} ({min(values):.2f} to {max(values):.2f})" if values else "none"
