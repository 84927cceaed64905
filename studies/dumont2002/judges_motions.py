"""Judges of statements about motions: measures of the ensembles held against numbers and against each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from stiffbeam.files.cases import paper_case
from stiffbeam.measures.amplification import amplification
from stiffbeam.model.beam import natural_frequencies

from .evidence import Evidence
from .peaks import EXCITED
from .sample import Sample, above, below, coherent, every, no, some
from .table import equation_of
from .verdicts import FAILS, HOLDS, OPEN, PARTLY, Finding, judge, of_both, plain_verdict, shared_verdict


@dataclass(frozen=True)
class Measure:
    """what: of ``Evidence.sample``. label: as the sentence begins. Values are written times scale with a unit.

    ratio: a quotient, judged by its logarithm and written as the geometric mean with the factor of one
    standard deviation.
    """

    what: str
    label: str
    scale: float = 1.0
    unit: str = ""
    ratio: bool = False

    def of(self, e: Evidence, table: int, motion: str) -> Sample:
        """Members of one motion, as logarithms where the measure is a ratio."""
        values = e.values(table, motion, self.what)
        return Sample(np.log(values) if self.ratio else values)

    def written(self, e: Evidence, table: int, motion: str) -> str:
        """Mean and spread of one motion, as the page prints them."""
        sample = self.of(e, table, motion)
        if self.ratio:
            return f"{np.exp(sample.mean):.2f} ×/÷ {np.exp(sample.sd):.2f}"
        text = sample.written(self.scale, self.unit)
        row = e.row(table, motion)
        if row.get("digits") and self.what in ("impacts", "fraction"):  # the frozen solution knows these over T
            text += f" (true to T: {self.scale * row[self.what]:.4g}{self.unit})"
        return text

    def sentence(self, e: Evidence, table: int, named: bool = False) -> str:
        """Measure of every motion of a table as one sentence; ``named``: it begins with the table."""
        label = f"Table {table}, {self.label[0].lower()}{self.label[1:]}" if named else self.label
        return f"{label}: " + ", ".join(f"{e.name(table, m)} {self.written(e, table, m)}" for m in motions_of(e, table))


MEASURES = {
    measure.what: measure
    for measure in (
        Measure("fraction", "Share of time in contact", 100.0, " %"),
        Measure("impacts", "Impacts to T"),
        Measure("depth", "Deepest deflection of a stop over the clearance", 100.0, " %"),
        Measure("band", "Frequencies to 15a with over a hundredth of the largest amplitude", 100.0, " %"),
        Measure("even_over_odd", "Even over odd multiples, 2a to 15a", ratio=True),
        Measure("aperiodicity", "Change of the tip over a drive period", 100.0, " %"),
        Measure("rate_aperiodicity", "Change of the tip's velocity over a drive period", 100.0, " %"),
        Measure("stress_aperiodicity", "Change of the shear stress over a drive period", 100.0, " %"),
        Measure("fast", "Rms tip velocity above the second natural frequency"),
        Measure("resolved", "rms tip velocity from the second natural frequency to that of mode M/4"),
        Measure("beyond", "rms tip velocity above it"),
    )
}
SHARE, IMPACTS, EVEN, FAST = (MEASURES[name] for name in ("fraction", "impacts", "even_over_odd", "fast"))
LITTLE = 0.1  # of what is drawn: seen, but small
MUCH = 2.0  # times: “much higher”


def motions_of(e: Evidence, table: int) -> list[str]:
    """Runs of a table, then its exact motions."""
    return [*e.runs(table), *e.forms(table)]


def of_every(e: Evidence, table: int, said: str, holds: Callable[[str], bool | None]) -> Finding:
    """Finding where ``holds`` is asked of every run, and of the exact motion in every form."""
    return of_both(said, every(map(holds, e.runs(table))), every(map(holds, e.forms(table))))


# ---------------------------------------------------------------- one measure


@judge
def motions(
    e: Evidence, table: int, *, measure: str, more_than: float = 0.0, less_than: float | None = None, beside: str = ""
) -> Finding:
    """The measure is above or below a number. beside: another measure that the sentence adds."""
    said = ". ".join(MEASURES[name].sentence(e, table) for name in (measure, beside) if name)

    def holds(motion: str) -> bool | None:
        sample = MEASURES[measure].of(e, table, motion)
        return above(sample, more_than) if less_than is None else below(sample, less_than)

    return of_every(e, table, f"{said}.", holds)


@judge
def even_much_higher(e: Evidence, table: int) -> Finding:
    """Even multiples are MUCH times as high as odd ones; in part where they are higher."""
    found = [EVEN.of(e, table, motion) for motion in motions_of(e, table)]
    much, higher = (every(above(x, limit) for x in found) for limit in (math.log(MUCH), 0.0))
    return Finding(f"{EVEN.sentence(e, table)}.", HOLDS if much else PARTLY if higher else plain_verdict(higher))


@judge
def extreme(
    e: Evidence, table: int, *, measure: str, run: str, most: bool = False, forms: Sequence[str] = (), remark: str = ""
) -> Finding:
    """A run has less (or the most) of the measure than every other; on the beam, the first form than the second."""
    chosen, order = MEASURES[measure], above if most else below
    others = (name for name in e.runs(table) if name != run)
    of_runs = every(order(chosen.of(e, table, run), chosen.of(e, table, name)) for name in others)
    said = f"{chosen.sentence(e, table)}. {remark}".rstrip()
    if not forms:
        return Finding(said, plain_verdict(of_runs))
    return of_both(said, of_runs, order(*(chosen.of(e, table, form) for form in forms)))


@judge
def between_tables(e: Evidence, base: int, *others: int, measure: str, less: bool = False) -> Finding:
    """Every motion has more (or less) of the measure on the other tables than on ``base``."""
    chosen, order = MEASURES[measure], below if less else above
    said = ". ".join(chosen.sentence(e, table, True) for table in (base, *others))
    return of_every(
        e, base, f"{said}.", lambda m: every(order(chosen.of(e, t, m), chosen.of(e, base, m)) for t in others)
    )


@judge
def runs_differ(e: Evidence, table: int, *, measure: str, beside: str) -> Finding:
    """The measure of two runs differs. beside: another measure that the sentence adds."""
    samples = [MEASURES[measure].of(e, table, name) for name in e.runs(table)]
    apart = any(above(a, b) is not None for a, b in combinations(samples, 2))
    said = ". ".join(MEASURES[name].sentence(e, table) for name in (measure, beside))
    return Finding(f"{said}.", HOLDS if apart else FAILS)


@judge
def counts_differ(e: Evidence, *tables: int) -> Finding:
    """Both runs count other impacts on every table; in part on some."""
    parts, apart = [], []
    for table in tables:
        a, b = (IMPACTS.of(e, table, name) for name in e.runs(table))
        apart.append(above(a, b) is not None)
        gap = abs(a.mean - b.mean) / max(np.hypot(a.sd, b.sd), 1e-300)
        parts.append(f"Table {table}: {IMPACTS.sentence(e, table).partition(': ')[2]}, {gap:.0f} deviations apart")
    return Finding(f"Impacts to T. {'; '.join(parts)}.", shared_verdict(all(apart), any(apart)))


@judge
def spurious(e: Evidence, table: int) -> Finding:
    """HHT against the exact motion of the same equations, below and above what the grid resolves."""
    e.runs(table)
    parts, lost = [], []
    for measure in (MEASURES["resolved"], MEASURES["beyond"]):
        hht, exact = measure.of(e, table, "(4.13)"), measure.of(e, table, "displacement")
        parts.append(f"{measure.label} {hht.written()} of {exact.written()}")
        lost.append(below(Sample(2.0 * hht.values), exact))  # less than half of it is left
    resolved, beyond = lost
    return Finding(
        f"Table {table}, HHT of exact: {'; '.join(parts)}. What lies below mode M/4 is the beam's own motion.",
        HOLDS if beyond and no(resolved) else PARTLY if beyond and resolved else FAILS if no(beyond) else OPEN,
    )


# ---------------------------------------------------------------- curves


APART = "Rms difference of the tips"


@judge
def similar(e: Evidence, table: int) -> Finding:
    """Tips of two schemes differ by little, or by no more than two members of one; in part for some pairs."""
    runs = e.runs(table)
    own = max((e.apart(table, name, name) for name in runs), key=lambda sample: sample.mean)
    pairs = {(a, b): e.apart(table, a, b) for a, b in combinations(runs, 2)}
    alike = [some([below(x, LITTLE), above(x, own) is not True]) for x in pairs.values()]
    written = ", ".join(f"{a} and {b} {x.written(100.0, ' %')}" for (a, b), x in pairs.items())
    beam = e.apart(table, runs[0], e.row(table, runs[0])["form"]).written(100.0, " %")
    return Finding(
        f"{APART} over the motion: {written}; two members of one scheme at most {own.written(100.0, ' %')}; "
        f"{runs[0]} and the exact motion {beam}.",
        shared_verdict(every(alike), some(alike)),
    )


@judge
def similar_and_little(e: Evidence, table: int) -> Finding:
    """Tips are similar, and deflect the stops by little; in part for one of these."""
    both = similar(e, table), motions(e, table, measure="depth", less_than=LITTLE)
    same = len({finding.verdict for finding in both}) == 1
    return Finding(" ".join(finding.measured for finding in both), both[0].verdict if same else PARTLY)


@judge
def bdf_alike(e: Evidence, table: int) -> Finding:
    """HHT is apart from both BDF runs, in the curves and in the counts of impacts."""
    e.runs(table)
    between, to_hht = e.apart(table, "(4.5)", "(4.11)"), [e.apart(table, "(4.13)", x) for x in ("(4.5)", "(4.11)")]
    hht, *bdf = (IMPACTS.of(e, table, name) for name in ("(4.13)", "(4.5)", "(4.11)"))
    by_curves = every(above(x, between) for x in to_hht)
    differ = all(above(hht, x) is not None for x in bdf)
    far = min(abs(hht.mean - x.mean) for x in bdf) > 2.0 * abs(bdf[0].mean - bdf[1].mean)
    by_counts = far if differ else None
    return Finding(
        f"{APART}: {between.written(100.0, ' %')} between (4.5) and (4.11), "
        f"{' and '.join(x.written(100.0, ' %') for x in to_hht)} from HHT; two members of HHT "
        f"{e.apart(table, '(4.13)', '(4.13)').written(100.0, ' %')}. {IMPACTS.sentence(e, table)}.",
        plain_verdict(by_curves) if by_curves == by_counts else PARTLY,
    )


@judge
def clearly_apart(e: Evidence, table: int) -> Finding:
    """(4.10) is farther from (4.12) than members of either are from each other; the exact motions beside."""
    e.runs(table)
    far, parts = [], []
    for a, b in (("(4.10)", "(4.12)"), ("velocity-curvature", "displacement")):
        between, own = e.apart(table, a, b), [e.apart(table, x, x) for x in (a, b)]
        far.append(every(above(between, x) for x in own))
        parts.append(
            f"{e.name(table, a)} and {e.name(table, b)} {between.written(100.0, ' %')}, two members of one "
            + " and ".join(x.written(100.0, " %") for x in own)
        )
    return Finding(f"{APART} over the motion: {'; '.join(parts)}.", plain_verdict(far[0]))


@judge
def strongly_in_space(e: Evidence, *tables: int) -> Finding:
    """The two grids differ more at resonance, the last two tables, than on the first two."""
    for table in tables:
        e.runs(table)
    runs = {table: e.apart(table, "(4.10)", "(4.12)") for table in tables}
    exact = {table: e.apart(table, "velocity-curvature", "displacement") for table in tables}
    more = [every(above(found[r], found[s]) for r in tables[2:] for s in tables[:2]) for found in (runs, exact)]
    written = "; ".join(
        f"Table {table} {runs[table].written(100.0, ' %')}, exact motions {exact[table].written(100.0, ' %')}"
        for table in tables
    )
    return of_both(
        f"{APART} on (3.12) and (3.5): {written}. Past the horizon two exact motions on one grid differ as much.", *more
    )


@judge
def elongation_explains(e: Evidence, table: int, *, runs: Sequence[str]) -> Finding:
    """Period elongation makes half of the difference of two runs.

    A lag that grows to e w t changes a mode by e w t/sqrt(3) of its size, rms over t.
    """
    a, b = runs
    case, t = paper_case(table), float(e.tables[table]["span"]["t_end"])
    omega = natural_frequencies(case.problem, 2)
    schemes = {equation_of(*run): e.reading.scheme(run[0]) for run in case.runs}
    turns = omega * case.dt / (2.0 * np.pi)
    periods = {name: amplification(schemes[name], turns).period_elongation for name in runs}
    lag = np.abs(periods[a] - periods[b]) * omega * t / np.sqrt(3.0)
    # Mode 1 as large as the whole motion, mode 2 as large as all that is faster.
    fast = max(FAST.of(e, table, name).mean for name in runs)
    share = np.array([1.0, min(1.0, fast / omega[1] / e.sample(table, a, "rms").mean)])
    explained = float(np.sum(np.minimum(lag, np.sqrt(2.0)) * share))
    apart = e.apart(table, a, b)
    written = "; ".join(f"{name} {x[0]:.1e} and {x[1]:.1e}" for name, x in periods.items())
    return Finding(
        f"Period elongation of modes 1 and 2 at dt = {case.dt:g}: {written}. To t = {t:.3g} that makes "
        f"{100 * explained:.1g} % of difference between {a} and {b} at most; measured "
        f"{apart.written(100.0, ' %')}, and {e.apart(table, a, 'displacement').written(100.0, ' %')} from {a} to "
        "the exact motion. The rest comes from the damping of the fast modes at every contact, and from chaos.",
        plain_verdict(below(apart, 2.0 * explained)),
    )


# ---------------------------------------------------------------- lines of the spectrum


def _amplitudes(e: Evidence, table: int, motion: str) -> np.ndarray:
    """Complex amplitudes at the multiples of the drive, (members, multiples)."""
    pairs = e.values(table, motion, "lines")
    return pairs[..., 0] + 1j * pairs[..., 1]


def multiples(e: Evidence, table: int, motion: str) -> tuple[Sample, ...]:
    """|mean c_k| at k drive, k = 1 .. 15, as samples: each member's part along the mean."""
    c = _amplitudes(e, table, motion)
    mean = np.mean(c, axis=0)
    along = np.real(c * np.conj(mean / np.maximum(np.abs(mean), 1e-300)))
    return tuple(Sample(column) for column in along.T)


def lines(e: Evidence, table: int, motion: str) -> list[int]:
    """Multiples from 2a to 9a at which all members have a line in common, of EXCITED of the largest or more."""
    common, sizes = coherent(_amplitudes(e, table, motion)), [x.mean for x in multiples(e, table, motion)]
    return [k for k in range(2, 10) if common[k - 1] and sizes[k - 1] > EXCITED * max(sizes)]


def named(orders: Sequence[int]) -> str:
    """Multiples of the drive frequency a as a text, such as "2a, 3a"."""
    return ", ".join(f"{k}a" for k in orders) or "none"


def _lines_sentence(e: Evidence, table: int) -> str:
    found = (f"{e.name(table, m)} {named(lines(e, table, m))}" for m in motions_of(e, table))
    return "Lines common to all members, 2a to 9a: " + "; ".join(found) + "."


def _heights(e: Evidence, table: int, orders: Sequence[int], scale: float, places: int) -> str:
    """Lines of every motion over that at a."""
    parts = []
    for motion in motions_of(e, table):
        sizes = [x.mean for x in multiples(e, table, motion)]
        written = (f"{scale * sizes[k - 1] / sizes[0]:.{places}f}" for k in orders)
        parts.append(f"{e.name(table, motion)} {', '.join(written)}")
    return "; ".join(parts)


@judge
def odd_multiples(e: Evidence, table: int, *, orders: Sequence[int]) -> Finding:
    """Members have lines at these multiples in common, above both even neighbours."""

    def holds(motion: str) -> bool | None:
        sizes, common = multiples(e, table, motion), coherent(_amplitudes(e, table, motion))
        higher = (above(sizes[k - 1], sizes[j - 1]) for k in orders for j in (k - 1, k + 1))
        return every([*(bool(common[k - 1]) for k in orders), *higher])

    return of_every(e, table, _lines_sentence(e, table), holds)


@judge
def has_lines(e: Evidence, table: int, *, orders: Sequence[int] = (), least: int = 0, remark: str = "") -> Finding:
    """Members have lines at these multiples in common, and at least so many lines."""

    def holds(motion: str) -> bool:
        found = lines(e, table, motion)
        return {*orders} <= {*found} and len(found) >= least

    return of_every(e, table, f"{_lines_sentence(e, table)} {remark}".rstrip(), holds)


@judge
def same_lines(e: Evidence, table: int) -> Finding:
    """Runs have the same lines; in part where the exact motion has others."""
    first, *others = (lines(e, table, name) for name in e.runs(table))
    same, beam = all(found == first for found in others), lines(e, table, "displacement") == first
    return Finding(_lines_sentence(e, table), shared_verdict(same and beam, same))


@judge
def lines_of_every_motion(e: Evidence, *tables: int) -> Finding:
    """Each table has a line that is common to all its motions."""
    parts, have = [], []
    for table in tables:
        first, *others = ({*lines(e, table, motion)} for motion in motions_of(e, table))
        common = sorted(first.intersection(*others))
        parts.append(f"Table {table} {named(common)}")
        have.append(bool(common))
    return Finding(f"Lines of every motion of a table: {'; '.join(parts)}.", plain_verdict(all(have)))


@judge
def decaying(e: Evidence, table: int) -> Finding:
    """Lines at a, 3a, 5a, 7a and 9a are each above the next."""
    return of_every(
        e,
        table,
        f"Lines at 3a, 5a, 7a, 9a over that at a: {_heights(e, table, (3, 5, 7, 9), 1.0, 3)}.",
        lambda motion: every(above(a, b) for a, b in pairwise(multiples(e, table, motion)[0:10:2])),
    )


@judge
def sixth_highest(e: Evidence, table: int) -> Finding:
    """The line at 6a is the highest from 3a to 9a."""

    def holds(motion: str) -> bool | None:
        sizes = multiples(e, table, motion)
        return every(above(sizes[5], sizes[k - 1]) for k in (3, 4, 5, 7, 8, 9))

    return of_every(
        e, table, f"Lines at 2a to 9a, % of that at a: {_heights(e, table, range(2, 10), 100.0, 1)}.", holds
    )
