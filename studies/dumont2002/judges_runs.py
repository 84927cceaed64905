"""Judges of statements about costs and orders, which make runs."""

from __future__ import annotations

from statistics import median

import numpy as np

from stiffbeam.files.cases import paper_case
from stiffbeam.march.integrate import integrate
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.schemes import HHT, SDIRK

from .costs import CPU_TABLES, ERRORS, ratios, steps_needed, written_ratios
from .evidence import Evidence, NotMeasured
from .misprints import forced_order
from .verdicts import FAILS, HOLDS, PARTLY, Finding, plain_verdict


def _ratios(e: Evidence, tables: tuple[int, ...], equation: str, unit: str) -> tuple[str, list[float]]:
    """Times a step here over those of the tables' reference scheme, beside the paper's in a text, and alone."""
    paper, ours = ratios(e.costs, tables, equation)
    return f"{written_ratios(ours)} times {unit} (paper {written_ratios(paper)})", ours


def same_time(e: Evidence) -> Finding:
    """BDF and HHT take the same time a step within a factor of two."""
    (first, a), (second, b) = (_ratios(e, CPU_TABLES[0], equation, "HHT") for equation in ("(4.5)", "(4.11)"))
    return Finding(
        f"Time a step, median and range over the tables: (4.5) {first}; (4.11) {second}. In modal coordinates "
        "the forms are one kernel.",
        HOLDS if a + b and 0.5 < median(a + b) < 2.0 else FAILS,
    )


def hht_faster(e: Evidence) -> Finding:
    """HHT is faster than SDIRK a step, and at every equal error: steps there times the ratio of times a step."""
    text, own = _ratios(e, CPU_TABLES[2], "(4.14)", "the time of HHT")
    if not own:
        raise NotMeasured("no table of the four could be timed")
    a_step, work = median(own), []
    for table in CPU_TABLES[2]:
        hht, sdirk = (steps_needed(table, s) for s in (HHT(-0.1), SDIRK(nystrom=True)))
        pairs = ((hht[error], sdirk[error]) for error in ERRORS)
        work += [b * a_step / a for a, b in pairs if a is not None and b is not None]
    wins = sum(x < 1.0 for x in work)
    return Finding(
        f"At equal steps (4.14) takes {text}. At equal tip error ({', '.join(f'{error:g}' for error in ERRORS)} over "
        f"four impacts, Tables 10 to 13) it takes {written_ratios(work)} times that of HHT and is the faster in {wins} "
        f"of {len(work)}.",
        FAILS if a_step <= 1.0 else PARTLY if wins else HOLDS,
    )


def third_order(e: Evidence) -> Finding:
    """SDIRK-OS has order three with the right sign of sigma."""
    right, printed = (forced_order(s) for s in (SDIRK(), SDIRK().printed("sigma")))
    return Finding(
        f"Order: {right} with the corrected sign of sigma, {printed} as printed.",
        plain_verdict(abs(right.slope - 3.0) < 0.1),
    )


def exactly_similar(e: Evidence) -> Finding:
    """(4.12) and (4.14) differ by rounding until chaos magnifies it."""
    parts, same = [], []
    for table in (6, 8):
        case = paper_case(table)
        system = semidiscretise(case.problem, case.cells)
        a, b = (
            integrate(system, e.reading.scheme(SDIRK(1.0, nystrom)), case.dt, case.t_end, e.reading.contact)
            for nystrom in (False, True)
        )
        gap = np.abs(a.tip - b.tip) / np.max(np.abs(a.tip))
        early, late = float(np.max(gap[: len(gap) // 100])), np.flatnonzero(gap > 1e-3)
        until = f"a thousandth at t = {a.t[late[0]]:.2g}" if len(late) else f"{np.max(gap):.0e} at most to the end"
        parts.append(f"Table {table}: {early:.0e} in the first hundredth, {until}")
        same.append(early < 1e-9)
    return Finding(
        f"Difference of (4.12) and (4.14) over the largest displacement, from rounding alone: {'; '.join(parts)}.",
        plain_verdict(all(same)),
    )
