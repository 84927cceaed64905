"""Claims of Section 5.3: the SDIRK schemes, Tables 6 to 9."""

from __future__ import annotations

import numpy as np

from stiffbeam.files.cases import paper_case
from stiffbeam.march.integrate import integrate
from stiffbeam.measures.tip_error import tip_error
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.references import reference
from stiffbeam.schemes import SDIRK

from .claims_bdf import LITTLE_RULE, ODD_RULE, WIDE, WIDE_RULE
from .costs import ratios, written_ratios
from .ensembles import elsewhere
from .evidence import Evidence, NotMeasured
from .rules import (
    BAND,
    DEPTH,
    EVEN,
    FAST,
    LINES_RULE,
    LITTLE,
    RATE,
    SIMILAR_RULE,
    Check,
    least,
    less_than,
    more_than,
    odd_multiples,
    of_motions,
    similar,
)
from .sample import Sample, above, every
from .table_section import percent
from .verdicts import FAILS, HOLDS, PARTLY, UNTESTABLE, Claim, Finding, of_both, plain_verdict

RESONANT, SLOW = (8, 9), (6, 7)


def _bad_at_third_order(e: Evidence) -> Finding:
    case = paper_case(6)
    systems = {form: semidiscretise(case.problem, case.cells, form) for form in ("velocity-curvature", "displacement")}
    horizon = min(float(e.row(6, form)["horizon"]) for form in systems)
    end = case.dt * int(horizon / case.dt)
    parts, errors = [], {}
    for gamma in (0.4359, 1.0):
        for name, form in (("(4.10)", "velocity-curvature"), ("(4.12)", "displacement")):
            run = integrate(systems[form], e.reading.scheme(SDIRK(gamma)), case.dt, end, e.reading.contact)
            u = reference(systems[form], end, t_eval=run.t).tip
            errors[gamma, name] = tip_error(run.tip, u).rms
            parts.append(f"{name} {percent(errors[gamma, name])} at gamma = {gamma:g}")
    worse = [errors[0.4359, name] > errors[1.0, name] for name in ("(4.10)", "(4.12)")]
    return Finding(
        f"Rms tip error on Table 6 to t = {end:.2g}: {'; '.join(parts)}. (4.12) is (4.14), which Section 5.4 uses "
        "there.",
        HOLDS if all(worse) else PARTLY if any(worse) else FAILS,
    )


def _exactly_similar(e: Evidence) -> Finding:
    parts, same = [], []
    for table in (6, 8):
        case = paper_case(table)
        system = semidiscretise(case.problem, case.cells)
        a, b = (
            integrate(system, e.reading.scheme(SDIRK(1.0, nystrom)), case.dt, case.t_end, e.reading.contact)
            for nystrom in (False, True)
        )
        gap = np.abs(a.tip - b.tip) / np.max(np.abs(a.tip))
        early = float(np.max(gap[: len(gap) // 100]))
        lost = np.flatnonzero(gap > 1e-3)
        until = f"a thousandth at t = {a.t[lost[0]]:.2g}" if len(lost) else f"{np.max(gap):.0e} at most to the end"
        parts.append(f"Table {table}: {early:.0e} in the first hundredth, {until}")
        same.append(early < 1e-9)
    return Finding(
        f"Difference of (4.12) and (4.14) over the largest displacement, from rounding alone: {'; '.join(parts)}.",
        plain_verdict(all(same)),
    )


def _sensitive(e: Evidence) -> Finding:
    """How much the share of contact changes from gamma = 1 to 0.4359, as logarithms, for (4.10) and (4.12)."""
    parts, changes = [], {}
    for name, form in (("(4.10)", "velocity-curvature"), ("(4.12)", "displacement")):
        values = {}
        for gamma in (1.0, 0.4359):
            found: list[float] = []
            for seed in e.seeds:
                one = elsewhere(8, f"sdirk(gamma={gamma})@{form}", e.reading, e.tables[8]["span"]["members"], seed)
                found += one.get("fraction", [])
            if not found:
                raise NotMeasured(f"{name} with gamma = {gamma:g} overflowed on Table 8")
            values[gamma] = np.array(found)
        m = min(map(len, values.values()))
        changes[name] = Sample(np.abs(np.log(values[1.0][:m] / values[0.4359][:m])))
        shares = " to ".join(Sample(x).written(100.0, " %") for x in values.values())
        parts.append(f"{name} from {shares}")
    return Finding(
        f"Share of time in contact on Table 8, gamma = 1 to 0.4359: {'; '.join(parts)}.",
        plain_verdict(above(changes["(4.10)"], changes["(4.12)"])),
    )


def _clearly_apart(table: int) -> Check:
    """(4.10) is farther from (4.12) than members of either are from each other; the exact motions beside."""

    def check(e: Evidence) -> Finding:
        e.runs(table)
        pairs = (("(4.10)", "(4.12)"), ("velocity-curvature", "displacement"))
        far, parts = [], []
        for a, b in pairs:
            between, own = e.apart(table, a, b), [e.apart(table, x, x) for x in (a, b)]
            far.append(every(above(between, x) for x in own))
            parts.append(
                f"{e.name(table, a)} and {e.name(table, b)} {between.written(100.0, ' %')}, two members of one "
                + " and ".join(x.written(100.0, " %") for x in own)
            )
        return Finding(f"Rms difference of the tips over the motion: {'; '.join(parts)}.", plain_verdict(far[0]))

    return check


def _strongly_in_space(e: Evidence) -> Finding:
    """At resonance more than elsewhere."""
    for table in (*SLOW, *RESONANT):
        e.runs(table)
    apart = {table: e.apart(table, "(4.10)", "(4.12)") for table in (*SLOW, *RESONANT)}
    exact = {table: e.apart(table, "velocity-curvature", "displacement") for table in apart}
    more = [every(above(found[r], found[s]) for r in RESONANT for s in SLOW) for found in (apart, exact)]
    written = "; ".join(
        f"Table {table} {apart[table].written(100.0, ' %')}, exact motions {exact[table].written(100.0, ' %')}"
        for table in apart
    )
    return of_both(
        f"Rms difference of the tips on (3.12) and (3.5): {written}. Past the horizon two exact motions on one grid "
        "differ as much.",
        *more,
    )


def _time(e: Evidence) -> Finding:
    parts = []
    for equation in ("(4.10)", "(4.12)"):
        paper, ours = ratios(e.costs, (6, 7, 8, 9), equation)
        parts.append(f"{equation} {written_ratios(ours)} times (4.14) (paper {written_ratios(paper)})")
    return Finding(
        f"Time a step: {'; '.join(parts)}. Here all three are one kernel in modal coordinates by construction, so that "
        "this says nothing of the paper's band and full matrices.",
        UNTESTABLE,
    )


def _little_and_oscillating(e: Evidence) -> Finding:
    found = of_motions(7, DEPTH, less_than(LITTLE))(e)
    return Finding(f"{found.measured} {FAST.sentence(e, 7)}.", found.verdict)


CLAIMS = [
    Claim(
        "5.3",
        "“The schemes (4.10) and (4.12) give bad results when γ = 0.4359”",
        "their tip errors are larger than with γ = 1; in part for one of them",
        _bad_at_third_order,
        evidence="Table 6, one run each inside the horizon",
    ),
    Claim("5.3, Table 6", "“The results obtained by both methods are almost similar”", SIMILAR_RULE, similar(6), (6,)),
    Claim(
        "5.3, Table 6",
        "“The phase portrait obtained by the third spatial discretization is smoother”",
        "(4.10) keeps less fast motion than (4.12) and (4.14), outside the spread, and the exact motion on (3.12) "
        "less than on (3.5)",
        least(6, FAST, "(4.10)", "velocity-curvature", "displacement"),
        (6,),
    ),
    Claim(
        "5.3, Table 6",
        "“The odd multiples of a are excited, in particular the first four ones”",
        LINES_RULE,
        odd_multiples(6, (3, 5, 7, 9)),
        (6,),
    ),
    Claim("5.3, Table 7", "“The displacements are similar”", SIMILAR_RULE, similar(7), (7,)),
    Claim(
        "5.3, Table 7",
        "“There is a little deflection at impact and the solutions oscillate”",
        LITTLE_RULE,
        _little_and_oscillating,
        (7,),
    ),
    Claim(
        "5.3, Table 7",
        "“A wide band of frequencies are excited”",
        WIDE_RULE,
        of_motions(7, BAND, more_than(WIDE)),
        (7,),
    ),
    Claim(
        "5.3, Table 8",
        "“The displacements are irregular”",
        f"the velocity changes by more than {100 * LITTLE:g} % over a period",
        of_motions(8, RATE, more_than(LITTLE)),
        (8,),
    ),
    Claim(
        "5.3, Table 8",
        "“The solutions obtained with the schemes (4.12) and (4.14) are exactly similar”",
        "they differ by rounding until chaos magnifies it",
        _exactly_similar,
        evidence="Tables 6 and 8, one run each to T",
    ),
    Claim(
        "5.3, Table 8",
        "“The scheme (4.10) is very sensitive to the damping parameter”",
        "γ changes its share of contact by a larger factor than that of (4.12), outside the spread",
        _sensitive,
        (8,),
    ),
    Claim(
        "5.3, Table 8",
        "“A large band of frequencies are excited”",
        WIDE_RULE,
        of_motions(8, BAND, more_than(WIDE)),
        (8,),
    ),
    Claim(
        "5.3, Table 8",
        "“The odd multiples of a present higher amplitudes”",
        ODD_RULE,
        of_motions(8, EVEN, less_than(0.0)),
        (8,),
    ),
    Claim(
        "5.3, Table 9",
        "“A difference between (4.12) and (4.14) with (4.10) appears clearly”",
        "(4.10) is farther from (4.12) than two members of one scheme are, outside the spread",
        _clearly_apart(9),
        (9,),
    ),
    Claim(
        "5.3, Table 9",
        "“At resonance, the numerical solutions depend strongly on the space discretization”",
        "the two grids differ more on Tables 8 and 9 than on 6 and 7, outside the spread",
        _strongly_in_space,
        (*SLOW, *RESONANT),
    ),
    Claim(
        "5.3, Table 9",
        "“The CPU-time depends on the SDIRK schemes we used”",
        "with the paper's own matrices, which are not used here, the three need different times a step",
        _time,
        evidence="Timings of this machine, see CPU time",
    ),
]
