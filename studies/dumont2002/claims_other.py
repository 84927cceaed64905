"""Claims of Sections 5.5 and 6: one stop, loads on the beam, chaos, and what the paper concludes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from stiffbeam.files.cases import paper_cases
from stiffbeam.march.ensemble import integrate_ensemble
from stiffbeam.model.members import perturbed
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.model.system import System
from stiffbeam.references.exact.tangent import lyapunov
from stiffbeam.trajectory.ensemble import Ensemble

from .claims_bdf import LONGER, LONGER_RULE, PERIODIC_RULE, WIDE, WIDE_RULE
from .ensembles import PERTURBATION
from .evidence import Evidence
from .reading import Reading
from .rules import (
    BAND,
    CHANGE,
    EVEN,
    LINE_WIDTH,
    LITTLE,
    RATE,
    SHARE,
    STRESS,
    Measure,
    less_than,
    lines,
    lines_sentence,
    more_than,
    multiples,
    named,
    of_motions,
)
from .sample import Sample, above, below, every, no
from .verdicts import FAILS, HOLDS, OPEN, PARTLY, Claim, Finding, of_both, plain_verdict

MUCH = 2.0  # times: “much higher”
RESOLVED = Measure("resolved", "rms tip velocity from the second natural frequency to that of mode M/4")
BEYOND = Measure("beyond", "rms tip velocity above it")


def _multiples_one_stop(e: Evidence) -> Finding:
    wanted = set(range(2, 8))
    has = lambda motions: all(wanted <= set(lines(e, 14, m)) for m in motions)  # noqa: E731
    return of_both(lines_sentence(e, 14), has(e.runs(14)), has(e.forms(14)))


def _even_much_higher(e: Evidence) -> Finding:
    motions = [*e.runs(14), *e.forms(14)]
    found = [EVEN.of(e, 14, m) for m in motions]
    much, higher = (every(above(x, limit) for x in found) for limit in (math.log(MUCH), 0.0))
    return Finding(f"{EVEN.sentence(e, 14)}.", HOLDS if much else PARTLY if higher else plain_verdict(higher))


def _sixth(e: Evidence) -> Finding:
    def highest(motion: str) -> bool | None:
        sizes = multiples(e, 14, motion)
        return every(above(sizes[5], sizes[k - 1]) for k in (3, 4, 5, 7, 8, 9))

    parts = []
    for motion in [*e.runs(14), *e.forms(14)]:
        sizes = [x.mean for x in multiples(e, 14, motion)]
        parts.append(f"{e.name(14, motion)} " + ", ".join(f"{100 * size / sizes[0]:.1f}" for size in sizes[1:9]))
    return of_both(
        f"Lines at 2a to 9a, % of that at a: {'; '.join(parts)}.",
        every(map(highest, e.runs(14))),
        every(map(highest, e.forms(14))),
    )


def _longer_contact(e: Evidence) -> Finding:
    def longer(motions: list[str]) -> bool | None:
        return every(above(SHARE.of(e, 16, m), SHARE.of(e, 15, m)) for m in motions)

    return of_both(
        f"{SHARE.sentence(e, 15, True)}. {SHARE.sentence(e, 16, True)}.",
        longer(e.runs(16)),
        longer(e.forms(16)),
    )


def _more_regular(e: Evidence) -> Finding:
    def regular(motions: list[str]) -> bool | None:
        return every(below(CHANGE.of(e, 16, m), CHANGE.of(e, 15, m)) for m in motions)

    return of_both(
        f"{CHANGE.sentence(e, 15, True)}. {CHANGE.sentence(e, 16, True)}.",
        regular(e.runs(16)),
        regular(e.forms(16)),
    )


def _multiples_of_load(e: Evidence) -> Finding:
    has = lambda motions: all(len(lines(e, 16, m)) >= 2 for m in motions)  # noqa: E731
    return of_both(f"{lines_sentence(e, 16)} Here a is w.", has(e.runs(16)), has(e.forms(16)))


@lru_cache(maxsize=8)
def growth(table: int, reading: Reading, members: int, seed: int) -> tuple[float | None, tuple[float, ...]]:
    """The rates at which neighbouring motions diverge: of the table's first run, and of exact members (tangent flow).

    The run's is ln(10^4) over the delay between perturbations of 1e-8 and of 1e-12 reaching a thousandth
    of the largest displacement, medians over ``members``; None where one of them does not within the span.
    """
    case = paper_cases()[f"table{table}"]
    scheme, form = case.runs[0]
    system, every_ = semidiscretise(case.problem, case.cells, form), 5

    def tips(copies: Sequence[System]) -> Ensemble:
        return integrate_ensemble(
            system, reading.scheme(scheme), case.dt, case.t_end, copies, reading.contact, every=every_
        )

    alone = tips([system])
    own, t, times = alone.tip[0], alone.t, []
    for size in (1e-8, 1e-12):
        apart = np.abs(tips(perturbed(system, members, size, seed)).tip - own) > 1e-3 * np.max(np.abs(own))
        times.append(float(np.median(np.where(np.any(apart, axis=1), t[np.argmax(apart, axis=1)], np.inf))))
    early, late = times
    rate = math.log(1e4) / (late - early) if math.isfinite(late) and late > early else None
    copies = perturbed(system, members, PERTURBATION, seed)
    return rate, tuple(lyapunov(member, case.t_end).exponent for member in copies)


def _chaotic(e: Evidence) -> Finding:
    """Neighbouring motions diverge exponentially, and one drive period does not resemble the next."""
    e.runs(17)
    found = [growth(17, e.reading, e.tables[17]["span"]["exact_members"], seed) for seed in e.seeds]
    rates, exact = [rate for rate, _ in found], Sample(np.array([x for _, exponents in found for x in exponents]))
    parting = all(rate is not None for rate in rates)
    written = " and ".join("not within the span" if r is None else f"like exp({r:.0f} t)" for r in rates)
    irregular = [more_than(LITTLE)(CHANGE.of(e, 17, m)) for m in ("(4.13)", "displacement")]
    return of_both(
        f"Neighbouring motions of HHT part {written}, exact ones with the exponent {exact.written()}. "
        f"{CHANGE.sentence(e, 17)}.",
        every([parting, irregular[0]]),
        every([above(exact, 0.0), irregular[1]]),
    )


def _spurious(e: Evidence) -> Finding:
    """HHT against the exact motion of the same equations, below and above what the grid resolves."""
    e.runs(10)
    parts, kept = [], []
    for measure in (RESOLVED, BEYOND):
        hht, exact = measure.of(e, 10, "(4.13)"), measure.of(e, 10, "displacement")
        parts.append(f"{measure.label} {hht.written()} of {exact.written()}")
        kept.append(below(Sample(2.0 * hht.values), exact))  # less than half of it is left
    lost_resolved, lost_beyond = kept
    return Finding(
        f"Table 10, HHT of exact: {'; '.join(parts)}. What lies below mode M/4 is the beam's own motion.",
        HOLDS if lost_beyond and no(lost_resolved) else PARTLY if lost_beyond and lost_resolved
        else FAILS if no(lost_beyond) else OPEN,
    )  # fmt: skip


def _wide_range(e: Evidence) -> Finding:
    """Table 1: stiff, slowly driven. Table 2: less stiff. Table 5: fast."""

    def wider(motions: tuple[str, ...]) -> bool | None:
        return every(above(BAND.of(e, table, m), BAND.of(e, 1, m)) for m in motions for table in (2, 5))

    for table in (1, 2, 5):
        e.runs(table)
    said = [BAND.sentence(e, table, True) for table in (1, 2, 5)]
    forms = ("displacement", "velocity-curvature")
    return of_both(f"{'. '.join(said)}.", wider(("(4.13)", "(4.5)", "(4.11)")), wider(forms))


def _all_multiples(e: Evidence) -> Finding:
    tables, parts, have = (1, 2, 10, 14, 15, 16), [], []
    for table in tables:
        motions = [*e.runs(table), *e.forms(table)]
        common = [k for k in lines(e, table, motions[0]) if all(k in lines(e, table, m) for m in motions)]
        parts.append(f"Table {table} {named(common)}")
        have.append(bool(common))
    return Finding(f"Lines of every motion of a table: {'; '.join(parts)}.", plain_verdict(all(have)))


CLAIMS = [
    Claim(
        "5.5.1, Table 14",
        "“The motion is periodic”, seen in the phase portrait",
        f"of the velocity, {PERIODIC_RULE}",
        of_motions(14, RATE, less_than(LINE_WIDTH)),
        (14,),
    ),
    Claim(
        "5.5.1, Table 14",
        "“Multiples of the driven frequency a are excited”",
        "2a to 7a are lines common to all members, of a hundredth of the largest or more",
        _multiples_one_stop,
        (14,),
    ),
    Claim(
        "5.5.1, Table 14",
        "“The amplitudes of the even multiples are much higher than the odd ones”",
        f"they are {MUCH:g} times as high or more, outside the spread; in part where they are higher",
        _even_much_higher,
        (14,),
    ),
    Claim(
        "5.5.1, Table 14",
        "6a, “near the first mode”, “has high amplitudes”",
        "6a is the highest line from 3a to 9a, outside the spread",
        _sixth,
        (14,),
    ),
    Claim(
        "5.5.1, Table 14",
        "“The duration of the free flight is longer with respect to the duration of contact”",
        "less than half of the time is contact",
        of_motions(14, SHARE, less_than(LONGER)),
        (14,),
    ),
    Claim(
        "5.5.2, Table 15",
        "“The contact time is relatively long in comparison with the free flight”",
        LONGER_RULE,
        of_motions(15, SHARE, more_than(LONGER)),
        (15,),
    ),
    Claim(
        "5.5.2, Table 15",
        "“The motion is very irregular”",
        f"the velocity changes by more than {100 * LITTLE:g} % over a period",
        of_motions(15, RATE, more_than(LITTLE)),
        (15,),
    ),
    Claim(
        "5.5.2, Table 15",
        "“Only some frequencies are excited”",
        "fewer than a tenth of the frequencies are excited, see the wide bands",
        of_motions(15, BAND, less_than(WIDE)),
        (15,),
    ),
    Claim(
        "5.5.2, Table 15",
        "The shear stress “indicates that the motion is periodic”",
        f"of the stress, {PERIODIC_RULE}",
        of_motions(15, STRESS, less_than(LINE_WIDTH)),
        (15,),
    ),
    Claim(
        "5.5.2, Table 16",
        "“The contact time is longer” than with the load at 0.23",
        "the share of contact is larger, outside the spread",
        _longer_contact,
        (15, 16),
    ),
    Claim(
        "5.5.2, Table 16",
        "“The displacement is more regular”",
        "the tip changes less over a period, outside the spread",
        _more_regular,
        (15, 16),
    ),
    Claim(
        "5.5.2, Table 16",
        "“Multiples of w are excited”",
        "two or more lines above w are common to all members",
        _multiples_of_load,
        (16,),
    ),
    Claim(
        "5.5.2, Table 16",
        "“The motion seems to be periodic”",
        f"of the tip, {PERIODIC_RULE}",
        of_motions(16, CHANGE, less_than(LINE_WIDTH)),
        (16,),
    ),
    Claim(
        "5.5.3, Table 17",
        "“The displacement may be considered as chaotic”",
        f"neighbouring motions diverge exponentially; the tip changes by more than {100 * LITTLE:g} % over a period",
        _chaotic,
        (17,),
    ),
    Claim(
        "5.5.3, Table 17",
        "“A wide band of frequencies is excited”",
        WIDE_RULE,
        of_motions(17, BAND, more_than(WIDE)),
        (17,),
    ),
    Claim(
        "6",
        "HHT “permits to damp out spurious high frequencies”",
        "less than half is left of what the grid does not resolve, and more of what it does; in part where both go",
        _spurious,
        (10,),
    ),
    Claim(
        "6",
        "“At high driving frequencies or for a low stiffness, … a wide range of frequencies is excited”",
        "more frequencies are excited than with the stiff and slowly driven beam, outside the spread",
        _wide_range,
        (1, 2, 5),
    ),
    Claim(
        "6",
        "“Multiples of the driving frequency are excited in the process”",
        "every table with a slow drive has lines common to all members",
        _all_multiples,
        (1, 2, 10, 14, 15, 16),
    ),
]
