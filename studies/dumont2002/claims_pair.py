"""Claims of Section 5.4: HHT beside SDIRK, Tables 10 to 13."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from statistics import median

import numpy as np

from stiffbeam.files.cases import paper_case
from stiffbeam.march.integrate import integrate
from stiffbeam.model.members import perturbed
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.schemes import HHT, SDIRK, Trapezoidal

from .claims_bdf import LONGER, LONGER_RULE
from .costs import ERRORS, RUNGS, ratios, steps_needed, written_ratios
from .ensembles import PERTURBATION, elsewhere
from .evidence import Evidence, NotMeasured
from .misprints import forced_order
from .rules import (
    EXPLAINED_RULE,
    IMPACTS,
    SHARE,
    SIMILAR_RULE,
    elongation_explains,
    lines,
    lines_sentence,
    more_than,
    of_motions,
    similar,
)
from .sample import Sample, above, below, every, no
from .verdicts import FAILS, HOLDS, OPEN, PARTLY, Claim, Finding, plain_verdict

TABLES = (10, 11, 12, 13)


def _different_at_impacts(e: Evidence) -> Finding:
    a, b = e.runs(10)
    apart = above(IMPACTS.of(e, 10, a), IMPACTS.of(e, 10, b))
    return Finding(f"{IMPACTS.sentence(e, 10)}. {SHARE.sentence(e, 10)}.", plain_verdict(apart is not None))


def _same_lines(e: Evidence) -> Finding:
    sets = [lines(e, 10, name) for name in e.runs(10)]
    exact = lines(e, 10, "displacement")
    same = all(found == sets[0] for found in sets)
    return Finding(lines_sentence(e, 10), (HOLDS if exact == sets[0] else PARTLY) if same else FAILS)


def _counts_differ(e: Evidence) -> Finding:
    parts, apart = [], []
    for table in TABLES:
        a, b = (IMPACTS.of(e, table, name) for name in e.runs(table))
        apart.append(above(a, b) is not None)
        gap = abs(a.mean - b.mean) / max(np.hypot(a.sd, b.sd), 1e-300)
        parts.append(f"Table {table}: {IMPACTS.sentence(e, table).partition(': ')[2]}, {gap:.0f} deviations apart")
    return Finding(f"Impacts to T. {'; '.join(parts)}.", HOLDS if all(apart) else PARTLY if any(apart) else FAILS)


def _found(e: Evidence, run: str, what: str) -> Sample | None:
    """A measure of a scheme that Table 10 does not run; None where all members overflow."""
    members = e.tables[10]["span"]["members"]
    values = [x for seed in e.seeds for x in elsewhere(10, run, e.reading, members, seed).get(what, [])]
    return Sample(np.array(values)) if values else None


def _damping_avoids(e: Evidence) -> Finding:
    alphas = (-0.05, -0.1, -0.2, -0.3, 0.0)
    counts = {a: _found(e, f"hht(alpha={a})@displacement", "impacts") for a in alphas}
    written = ", ".join(
        f"{'overflow' if found is None else found.written()} at alpha = {alpha:g}" for alpha, found in counts.items()
    )
    damped = [found for alpha, found in counts.items() if found is not None and alpha]
    if len(damped) < 2:
        raise NotMeasured(f"HHT overflows on Table 10: {written}")
    falls = every(above(a, b) for a, b in pairwise(damped))
    fewer = below(damped[-1], IMPACTS.of(e, 10, "displacement"))
    exact = IMPACTS.written(e, 10, "displacement")
    return Finding(
        f"Impacts of HHT to T on Table 10: {written}; exact {exact}.",
        HOLDS if falls and fewer else PARTLY if falls or fewer else OPEN if None in (falls, fewer) else FAILS,
    )


def _trapezoidal(e: Evidence) -> Finding:
    share = _found(e, "trapezoidal@displacement", "fraction")
    if share is None:
        return Finding("All members overflow on Table 10 in this reading.", HOLDS)
    fast, exact = _found(e, "trapezoidal@displacement", "fast"), SHARE.of(e, 10, "displacement")
    assert fast is not None
    members = e.tables[10]["span"]["members"]
    gain = Sample(np.array([x for seed in e.seeds for x in _energy_gains(e.reading.contact, members, seed)]))
    off = [Sample(np.abs(x.values - exact.mean)) for x in (share, SHARE.of(e, 10, "(4.13)"))]
    nearer, grows = below(*off), above(gain, 0.0)
    return Finding(
        f"Table 10, share of time in contact {share.written(100.0, ' %')} (exact "
        f"{SHARE.written(e, 10, 'displacement')}, HHT {SHARE.written(e, 10, '(4.13)')}); rms fast "
        f"velocity {fast.written()} (exact {e.sample(10, 'displacement', 'fast').written()}). It gains energy: "
        f"{gain.written(100.0, ' %')} of the "
        "most energy it was given, which no beam does; HHT loses it.",
        FAILS if nearer and no(grows) else PARTLY if nearer and grows else HOLDS if no(nearer) else OPEN,
    )


@lru_cache(maxsize=8)
def _energy_gains(contact: str, members: int, seed: int) -> tuple[float, ...]:
    """What the trapezoidal rule adds on Table 10 to T, over the most energy that the beam was given, by member."""
    case = paper_case(10)
    system = semidiscretise(case.problem, case.cells)
    runs = (
        integrate(member, Trapezoidal(), case.dt, case.t_end, contact, every=100)
        for member in perturbed(system, members, PERTURBATION, seed)
    )
    return tuple(-run.energy.lost_fraction() for run in runs)


def _third_order(e: Evidence) -> Finding:
    right, printed = (forced_order(s) for s in (SDIRK(), SDIRK().printed("sigma")))
    return Finding(
        f"Order: {right} with the corrected sign of sigma, {printed} as printed.",
        plain_verdict(abs(right.slope - 3.0) < 0.1),
    )


def _hht_faster(e: Evidence) -> Finding:
    """Steps at equal error times the measured ratio of times a step."""
    paper, own = ratios(e.costs, TABLES, "(4.14)")
    if not own:
        raise NotMeasured("no table of the four could be timed")
    a_step, wins, compared, work = median(own), 0, 0, []
    for table in TABLES:
        hht, sdirk = (steps_needed(table, s) for s in (HHT(-0.1), SDIRK(nystrom=True)))
        for error in ERRORS:
            a, b = hht[error], sdirk[error]
            if a is None or b is None:
                continue
            compared += 1
            work.append(b * a_step / a)
            wins += work[-1] < 1.0
    return Finding(
        f"At equal steps (4.14) takes {written_ratios(own)} times the time of HHT (paper {written_ratios(paper)}). At "
        f"equal tip error ({', '.join(f'{error:g}' for error in ERRORS)} over four impacts, Tables 10 to 13) it takes "
        f"{written_ratios(work)} times that of HHT and is the faster in {wins} of {compared}.",
        plain_verdict(wins == 0) if a_step > 1.0 and not wins else PARTLY if a_step > 1.0 else FAILS,
    )


CLAIMS = [
    Claim(
        "4.3",
        "The trapezoid method “does not give satisfactory results because of the presence of high-frequency "
        "oscillations”",
        "its share of contact is farther from the exact one than HHT's; in part where it is nearer but gains energy",
        _trapezoidal,
        (10,),
    ),
    Claim(
        "5.4",
        "With γ = 0.4359 “the SDIRK scheme becomes third order accurate”",
        "the observed order is 3 to 0.1",
        _third_order,
        evidence="A smooth forced problem, steps halved four times",
    ),
    Claim(
        "5.4, Table 10",
        "“These two methods give different results at impacts”",
        "their counts of impacts differ outside the spread",
        _different_at_impacts,
        (10,),
    ),
    Claim(
        "5.4, Table 10",
        "The difference “comes both from the phase lag error, the period elongation” and the clearance",
        EXPLAINED_RULE,
        elongation_explains(10, "(4.13)", "(4.14)"),
        (10,),
    ),
    Claim(
        "5.4, Table 10",
        "“The FFTs indicate the same excited frequencies”",
        "the lines common to all members, of a hundredth of the largest or more, are the same",
        _same_lines,
        (10,),
    ),
    Claim(
        "5.4, Table 11",
        "“The results are similar because the clearance is very small”",
        SIMILAR_RULE,
        similar(11),
        (11,),
    ),
    Claim(
        "5.4, Table 11",
        "“The duration of free flights is very short”",
        LONGER_RULE,
        of_motions(11, SHARE, more_than(LONGER)),
        (11,),
    ),
    Claim(
        "5.4, Table 12",
        "“The results obtained by both methods are similar, except for some impacts”",
        SIMILAR_RULE,
        similar(12),
        (12,),
    ),
    Claim(
        "5.4, Table 13",
        "“The SDIRK and the HHT schemes give approximatively the same results”",
        SIMILAR_RULE,
        similar(13),
        (13,),
    ),
    Claim(
        "5.4, Table 13",
        "With the larger clearance “the phase lag error and the period elongation become significant”",
        EXPLAINED_RULE,
        elongation_explains(13, "(4.13)", "(4.14)"),
        (13,),
    ),
    Claim(
        "5.4, Table 13",
        "“Too much damping can avoid some impacts”",
        "from α = −0.05 on HHT counts fewer impacts with every step of α, and in the end fewer than the exact motion, "
        "outside the spread; in part for one of these",
        _damping_avoids,
        (10,),
    ),
    Claim(
        "5.4, Table 13",
        "“The HHT-α is clearly the faster algorithm”",
        "it is faster a step, and at every equal error; in part where it is faster a step only",
        _hht_faster,
        evidence=f"Timings, and {RUNGS} steps to a factor of two inside the horizon",
    ),
    Claim(
        "5.4, Table 13",
        "“The number of impacts could depend on the choice of the method”",
        "the counts of HHT and SDIRK differ outside the spread on all four tables; in part on some",
        _counts_differ,
        TABLES,
    ),
]
