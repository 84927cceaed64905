"""Kinds of statement about motions, each a function of the evidence: a measure held against a number, odd
multiples, likeness, and what period elongation can explain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from stiffbeam.files.cases import paper_case
from stiffbeam.measures.amplification import amplification
from stiffbeam.measures.peaks import EXCITED
from stiffbeam.model.closed_form import natural_frequencies
from stiffbeam.schemes import Scheme

from .evidence import Evidence
from .sample import Sample, above, below, coherent, every, some
from .table import equation_of
from .verdicts import FAILS, HOLDS, OPEN, PARTLY, Finding, of_both, plain_verdict

Check = Callable[[Evidence], Finding]


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
        """The members of one motion, as logarithms where the measure is a ratio."""
        values = e.values(table, motion, self.what)
        return Sample(np.log(values) if self.ratio else values)

    def written(self, e: Evidence, table: int, motion: str) -> str:
        """Mean and spread of one motion, as the page prints them."""
        sample = self.of(e, table, motion)
        if self.ratio:
            return f"{np.exp(sample.mean):.2f} ×/÷ {np.exp(sample.sd):.2f}"
        text = sample.written(self.scale, self.unit)
        row = e.row(table, motion)
        if row.get("digits") and self.what in ("impacts", "fraction"):  # what the frozen solution knows over T
            text += f" (true to T: {self.scale * row[self.what]:.4g}{self.unit})"
        return text

    def sentence(self, e: Evidence, table: int, named: bool = False) -> str:
        """The measure of every motion of a table, in one sentence, which names the table where it is one of several."""
        motions = [*e.runs(table), *e.forms(table)]
        label = f"Table {table}, {self.label[0].lower()}{self.label[1:]}" if named else self.label
        return f"{label}: " + ", ".join(
            f"{e.name(table, motion)} {self.written(e, table, motion)}" for motion in motions
        )


SHARE = Measure("fraction", "Share of time in contact", 100.0, " %")
IMPACTS = Measure("impacts", "Impacts to T")
DEPTH = Measure("depth", "Deepest deflection of a stop over the clearance", 100.0, " %")
BAND = Measure("band", "Frequencies to 15a with over a hundredth of the largest amplitude", 100.0, " %")
EVEN = Measure("even_over_odd", "Even over odd multiples, 2a to 15a", ratio=True)
CHANGE = Measure("aperiodicity", "Change of the tip over a drive period", 100.0, " %")
RATE = Measure("rate_aperiodicity", "Change of the tip's velocity over a drive period", 100.0, " %")
STRESS = Measure("stress_aperiodicity", "Change of the shear stress over a drive period", 100.0, " %")
FAST = Measure("fast", "Rms tip velocity above the second natural frequency")

LINE_WIDTH = 0.01  # of what is drawn: the width of a line in print
LITTLE = 0.1  # of what is drawn: seen, but small
LINES_RULE = "the line at each multiple is common to all members, and outside the spread above both even neighbours"


def of_motions(table: int, measure: Measure, holds: Callable[[Sample], bool | None]) -> Check:
    """``holds`` of the measure, asked of every run and of the exact motion in every form."""

    def check(e: Evidence) -> Finding:
        asked = lambda motions: every(holds(measure.of(e, table, m)) for m in motions)  # noqa: E731
        return of_both(measure.sentence(e, table) + ".", asked(e.runs(table)), asked(e.forms(table)))

    return check


def more_than(limit: float) -> Callable[[Sample], bool | None]:
    """The rule that the mean is above ``limit``; None where the spread decides nothing."""
    return lambda sample: above(sample, limit)


def less_than(limit: float) -> Callable[[Sample], bool | None]:
    """The rule that the mean is below ``limit``; None where the spread decides nothing."""
    return lambda sample: below(sample, limit)


def least(table: int, measure: Measure, chosen: str, form: str | None = None, than: str | None = None) -> Check:
    """The run ``chosen`` has less of the measure than every other; on the beam, ``form`` less than ``than``."""

    def check(e: Evidence) -> Finding:
        others = [name for name in e.runs(table) if name != chosen]
        one = measure.of(e, table, chosen)
        of_runs = every(below(one, measure.of(e, table, name)) for name in others)
        said = measure.sentence(e, table) + "."
        if form is None or than is None:
            return Finding(said, plain_verdict(of_runs))
        return of_both(said, of_runs, below(measure.of(e, table, form), measure.of(e, table, than)))

    return check


def multiples(e: Evidence, table: int, motion: str) -> tuple[Sample, ...]:
    """|mean c_k| at k drive, k = 1 .. 15, as samples: each member's part along the mean."""
    pairs = e.values(table, motion, "lines")
    c = pairs[..., 0] + 1j * pairs[..., 1]
    mean = np.mean(c, axis=0)
    along = np.real(c * np.conj(mean / np.maximum(np.abs(mean), 1e-300)))
    return tuple(Sample(column) for column in along.T)


def lines(e: Evidence, table: int, motion: str) -> list[int]:
    """The multiples from 2a to 9a at which all members have a line in common, of EXCITED of the largest or more."""
    pairs = e.values(table, motion, "lines")
    found, sizes = coherent(pairs[..., 0] + 1j * pairs[..., 1]), [x.mean for x in multiples(e, table, motion)]
    return [k for k in range(2, 10) if found[k - 1] and sizes[k - 1] > EXCITED * max(sizes)]


def named(orders: list[int]) -> str:
    """Multiples of the drive frequency a as a text, such as "2a, 3a"."""
    return ", ".join(f"{k}a" for k in orders) or "none"


def lines_sentence(e: Evidence, table: int) -> str:
    """The multiples of the drive that all members have, motion by motion."""
    found = (f"{e.name(table, m)} {named(lines(e, table, m))}" for m in [*e.runs(table), *e.forms(table)])
    return "Lines common to all members, 2a to 9a: " + "; ".join(found) + "."


def odd(e: Evidence, table: int, motion: str, wanted: tuple[int, ...]) -> bool | None:
    """LINES_RULE for the ``wanted`` multiples."""
    sizes = multiples(e, table, motion)
    pairs = e.values(table, motion, "lines")
    there = coherent(pairs[..., 0] + 1j * pairs[..., 1])
    higher = [above(sizes[k - 1], sizes[j - 1]) for k in wanted for j in (k - 1, k + 1)]
    return every([*(bool(there[k - 1]) for k in wanted), *higher])


def odd_multiples(table: int, wanted: tuple[int, ...]) -> Check:
    """The check that schemes and exact motion have lines at the ``wanted`` multiples."""

    def check(e: Evidence) -> Finding:
        asked = lambda motions: every(odd(e, table, m, wanted) for m in motions)  # noqa: E731
        return of_both(lines_sentence(e, table), asked(e.runs(table)), asked(e.forms(table)))

    return check


SIMILAR_RULE = (
    "the tips of two schemes differ (rms) by less than a tenth of the motion, or by no more than two members of "
    "one scheme do"
)


def similar(table: int) -> Check:
    """SIMILAR_RULE for every pair of the table's schemes; in part where it holds for some."""

    def check(e: Evidence) -> Finding:
        runs = e.runs(table)
        own = max((e.apart(table, name, name) for name in runs), key=lambda sample: sample.mean)
        pairs = {(a, b): e.apart(table, a, b) for a, b in combinations(runs, 2)}
        alike = [some([below(x, LITTLE), above(x, own) is not True]) for x in pairs.values()]
        written = ", ".join(f"{a} and {b} {x.written(100.0, ' %')}" for (a, b), x in pairs.items())
        form = e.row(table, runs[0])["form"]
        beam = e.apart(table, runs[0], form).written(100.0, " %")
        return Finding(
            f"Rms difference of the tips over the motion: {written}; two members of one scheme at most "
            f"{own.written(100.0, ' %')}; {runs[0]} and the exact motion {beam}.",
            HOLDS if every(alike) else OPEN if every(alike) is None else PARTLY if some(alike) else FAILS,
        )

    return check


EXPLAINED_RULE = (
    "what the schemes' different periods of modes 1 and 2 can add to the difference of their tips is at least half "
    "of that difference"
)


def elongation_explains(table: int, a: str, b: str) -> Check:
    """EXPLAINED_RULE. A lag that grows to e w t changes a mode by e w t/sqrt(3) of its size, rms over t."""

    def check(e: Evidence) -> Finding:
        case, t = paper_case(table), float(e.tables[table]["span"]["t_end"])
        schemes = {equation_of(*run): e.reading.scheme(run[0]) for run in case.runs}
        omega = natural_frequencies(case.problem, 2)
        periods = {name: elongation(schemes[name], omega * case.dt) for name in (a, b)}
        lag = np.abs(periods[a] - periods[b]) * omega * t / np.sqrt(3.0)
        # Mode 1 as large as the whole motion, mode 2 as large as all that is faster.
        fast = max(FAST.of(e, table, name).mean for name in (a, b))
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

    return check


def elongation(scheme: Scheme, phase: np.ndarray) -> np.ndarray:
    """The relative period elongation at w dt = ``phase``."""
    return amplification(scheme, phase / (2.0 * np.pi)).period_elongation
