"""Claims of Section 5.2: HHT beside BDF2, Tables 1 to 5."""

from __future__ import annotations

from itertools import pairwise
from statistics import median

from .costs import ratios, written_ratios
from .evidence import Evidence
from .rules import (
    BAND,
    DEPTH,
    EVEN,
    EXPLAINED_RULE,
    FAST,
    IMPACTS,
    LINE_WIDTH,
    LINES_RULE,
    LITTLE,
    RATE,
    SHARE,
    SIMILAR_RULE,
    Check,
    elongation_explains,
    least,
    less_than,
    more_than,
    multiples,
    odd_multiples,
    of_motions,
    similar,
)
from .sample import Sample, above, every, some
from .verdicts import FAILS, HOLDS, PARTLY, Claim, Finding, of_both, plain_verdict

CONSIDERABLE = 0.25
LONGER = 0.5
WIDE = 0.1
WIDE_RULE = "more than a tenth of the frequencies are excited, which is what lines at all multiples fill in ten periods"
ODD_RULE = "the geometric mean of the even multiples is below that of the odd ones, outside the spread"
LONGER_RULE = "more than half of the time is contact"
LITTLE_RULE = "the deepest visit is less than a tenth of the clearance"
PERIODIC_RULE = f"its change over a period is below {100 * LINE_WIDTH:g} %, the width of a line in print"


def _decaying(e: Evidence) -> Finding:
    def decays(motion: str) -> bool | None:
        sizes = multiples(e, 2, motion)
        return every(above(a, b) for a, b in pairwise(sizes[0:10:2]))

    motions = [*e.runs(2), *e.forms(2)]
    written = []
    for motion in motions:
        sizes = [x.mean for x in multiples(e, 2, motion)]
        written.append(f"{e.name(2, motion)} " + ", ".join(f"{sizes[k - 1] / sizes[0]:.3f}" for k in (3, 5, 7, 9)))
    return of_both(
        f"Lines at 3a, 5a, 7a, 9a over that at a: {'; '.join(written)}.",
        every(map(decays, e.runs(2))),
        every(map(decays, e.forms(2))),
    )


def _hht_noisier(e: Evidence) -> Finding:
    hht = FAST.of(e, 1, "(4.13)")
    return Finding(
        f"{FAST.sentence(e, 1)}. The noise is the beam's: HHT takes less of it away than BDF2.",
        plain_verdict(every(above(hht, FAST.of(e, 1, name)) for name in e.runs(1) if name != "(4.13)")),
    )


def _more_impacts(e: Evidence) -> Finding:
    def more(motions: list[str]) -> bool | None:
        return every(above(IMPACTS.of(e, 2, m), IMPACTS.of(e, 1, m)) for m in motions)

    return of_both(
        f"{IMPACTS.sentence(e, 2, True)}. {IMPACTS.sentence(e, 1, True)}.",
        more(e.runs(2)),
        more(e.forms(2)),
    )


def _bdf_alike(e: Evidence) -> Finding:
    """By the curves, and by what happens at the stops: gaps between the counts of impacts."""
    e.runs(2)
    between, to_hht = e.apart(2, "(4.5)", "(4.11)"), [e.apart(2, "(4.13)", name) for name in ("(4.5)", "(4.11)")]
    counts = {name: IMPACTS.of(e, 2, name) for name in e.runs(2)}
    gap = abs(counts["(4.5)"].mean - counts["(4.11)"].mean)
    far = min(abs(counts["(4.13)"].mean - counts[name].mean) for name in ("(4.5)", "(4.11)"))
    by_curves = every(above(x, between) for x in to_hht)
    by_counts = every(_differ(counts["(4.13)"], counts[name]) for name in ("(4.5)", "(4.11)"))
    if by_counts:
        by_counts = far > 2.0 * gap
    return Finding(
        f"Rms difference of the tips: {between.written(100.0, ' %')} between (4.5) and (4.11), "
        f"{' and '.join(x.written(100.0, ' %') for x in to_hht)} from HHT; two members of HHT "
        f"{e.apart(2, '(4.13)', '(4.13)').written(100.0, ' %')}. {IMPACTS.sentence(e, 2)}.",
        plain_verdict(by_curves) if by_curves == by_counts else PARTLY,
    )


def _differ(a: Sample, b: Sample) -> bool | None:
    return None if above(a, b) is None else True


def _similar_little(table: int) -> Check:
    """Similar, with little deflection."""
    alike, little = similar(table), of_motions(table, DEPTH, less_than(LITTLE))

    def check(e: Evidence) -> Finding:
        a, b = alike(e), little(e)
        both = {a.verdict, b.verdict}
        return Finding(
            f"{a.measured} {b.measured}",
            both.pop() if len(both) == 1 else FAILS if both == {FAILS} else PARTLY,
        )

    return check


def _depends_at_stops(e: Evidence) -> Finding:
    runs = e.runs(5)
    shares = [SHARE.of(e, 5, name) for name in runs]
    apart = some(_differ(a, b) for i, a in enumerate(shares) for b in shares[:i])
    return Finding(f"{SHARE.sentence(e, 5)}. {IMPACTS.sentence(e, 5)}.", plain_verdict(bool(apart)))


def _same_time(e: Evidence) -> Finding:
    parts, own = [], []
    for equation in ("(4.5)", "(4.11)"):
        paper, ours = ratios(e.costs, (1, 2, 3, 4, 5), equation)
        parts.append(f"{equation} {written_ratios(ours)} times HHT (paper {written_ratios(paper)})")
        own += ours
    return Finding(
        f"Time a step, median and range over the tables: {'; '.join(parts)}. In modal coordinates the forms are one "
        "kernel.",
        HOLDS if own and 0.5 < median(own) < 2.0 else FAILS,
    )


CLAIMS = [
    Claim(
        "5.2, Table 1",
        "There is contact “over considerable periods of time”",
        "contact takes a quarter of the time or more: a plateau that shows in every period",
        of_motions(1, SHARE, more_than(CONSIDERABLE)),
        (1,),
    ),
    Claim("5.2, Table 1", "“The results are similar for the displacement”", SIMILAR_RULE, similar(1), (1,)),
    Claim(
        "5.2, Table 1",
        "“There is little deflection at the stops”",
        LITTLE_RULE,
        of_motions(1, DEPTH, less_than(LITTLE)),
        (1,),
    ),
    Claim(
        "5.2, Table 1",
        "“The deflection is smaller with the first BDF scheme”",
        "the deepest visit of (4.5) is shallower than that of the others, outside the spread",
        least(1, DEPTH, "(4.5)"),
        (1,),
    ),
    Claim(
        "5.2, Table 1",
        "“The phase portrait obtained with the HHT method is more noisy”",
        "HHT keeps more fast motion than both others, outside the spread",
        _hht_noisier,
        (1,),
    ),
    Claim(
        "5.2, Table 1",
        "“The excited frequencies are odd multiples”: 3a, 5a, …",
        LINES_RULE,
        odd_multiples(1, (3, 5)),
        (1,),
    ),
    Claim("5.2, Table 2", "The displacements are similar, lower elastic modulus", SIMILAR_RULE, similar(2), (2,)),
    Claim(
        "5.2, Table 2",
        "“The phase portraits are irregular”",
        f"the velocity changes by more than {100 * LINE_WIDTH:g} % over a period, the width of a line in print",
        of_motions(2, RATE, more_than(LINE_WIDTH)),
        (2,),
    ),
    Claim(
        "5.2, Table 2",
        "“At contact, there is no deflection”",
        f"the deepest visit is less than {100 * LINE_WIDTH:g} % of the clearance, the width of a line in print",
        of_motions(2, DEPTH, less_than(LINE_WIDTH)),
        (2,),
    ),
    Claim(
        "5.2, Table 2",
        "“The number of impact is higher” than with the stiff beam",
        "more impacts to T than on Table 1, outside the spread",
        _more_impacts,
        (1, 2),
    ),
    Claim(
        "5.2, Table 2",
        "At contact the two BDF schemes are “near similar whereas the HHT scheme gives (very) different results”",
        "HHT's tip is farther from both than they are from each other, and its count of impacts twice as far; in "
        "part for one of these",
        _bdf_alike,
        (2,),
    ),
    Claim(
        "5.2, Table 2",
        "Period elongation and phase lag in the lower modes “could explain the difference” between HHT and BDF",
        EXPLAINED_RULE,
        elongation_explains(2, "(4.13)", "(4.11)"),
        (2,),
    ),
    Claim(
        "5.2, Table 2",
        "“Odd multiples of the driving frequency are excited: 3a, 5a, …”",
        LINES_RULE,
        odd_multiples(2, (3, 5)),
        (2,),
    ),
    Claim(
        "5.2, Table 2",
        "… “with decaying amplitudes peaks”",
        "each of a, 3a, 5a, 7a, 9a is above the next, outside the spread",
        _decaying,
        (2,),
    ),
    Claim(
        "5.2, Table 3",
        "“The duration of free flights is very short comparing with the duration of contacts”",
        LONGER_RULE,
        of_motions(3, SHARE, more_than(LONGER)),
        (3,),
    ),
    Claim(
        "5.2, Table 3",
        "The results are “similar with a small deflection at contact”",
        f"{SIMILAR_RULE}; {LITTLE_RULE}",
        _similar_little(3),
        (3,),
    ),
    Claim(
        "5.2, Table 3",
        "“The FFT shows a wide band of excited frequencies”",
        WIDE_RULE,
        of_motions(3, BAND, more_than(WIDE)),
        (3,),
    ),
    Claim(
        "5.2, Table 4",
        "“For both methods the results look similar”, until after some contacts",
        SIMILAR_RULE,
        similar(4),
        (4,),
    ),
    Claim(
        "5.2, Table 4",
        "“A large band of frequencies are excited”",
        WIDE_RULE,
        of_motions(4, BAND, more_than(WIDE)),
        (4,),
    ),
    Claim(
        "5.2, Table 4",
        "… “but the odd multiples have higher amplitudes”",
        ODD_RULE,
        of_motions(4, EVEN, less_than(0.0)),
        (4,),
    ),
    Claim(
        "5.2, Table 5",
        "“The motion becomes noisy”",
        f"the velocity changes by more than {100 * LITTLE:g} % over a period",
        of_motions(5, RATE, more_than(LITTLE)),
        (5,),
    ),
    Claim(
        "5.2, Table 5",
        "The displacement near the stops “depends on the scheme used”",
        "the schemes' shares of contact differ outside the spread",
        _depends_at_stops,
        (5,),
    ),
    Claim(
        "5.2, Table 5",
        "“Except for some computations, the three methods need the same CPU-time”",
        "the median ratio to HHT lies between 1/2 and 2, as the paper's do",
        _same_time,
        evidence="Timings of this machine, see CPU time",
    ),
]
