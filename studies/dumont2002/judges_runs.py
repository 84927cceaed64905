"""Judges of statements about costs, orders, other parameters and chaos, which make runs."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from statistics import median

import numpy as np

from stiffbeam.files.cases import paper_case
from stiffbeam.march.ensemble import integrate_ensemble
from stiffbeam.march.integrate import integrate
from stiffbeam.measures.errors import tip_error
from stiffbeam.model.members import perturbed_members
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.references import reference
from stiffbeam.references.horizon import lyapunov
from stiffbeam.schemes import HHT, SDIRK, Trapezoidal

from .costs import CPU_TABLES, ERRORS, ratios, steps_needed, written_ratios
from .ensembles import PERTURBATION, elsewhere
from .evidence import Evidence, NotMeasured
from .judges_motions import IMPACTS, LITTLE, MEASURES, SHARE
from .misprints import forced_order
from .reading import Reading
from .sample import Sample, above, below, every, no
from .typeset import percent
from .verdicts import FAILS, HOLDS, OPEN, PARTLY, UNTESTABLE, Finding, judge, of_both, plain_verdict, shared_verdict

# ---------------------------------------------------------------- costs and orders


def _ratios(e: Evidence, tables: tuple[int, ...], equation: str, unit: str) -> tuple[str, list[float]]:
    """Times a step here over those of the tables' reference scheme, beside the paper's in a text, and alone."""
    paper, ours = ratios(e.costs, tables, equation)
    return f"{written_ratios(ours)} times {unit} (paper {written_ratios(paper)})", ours


@judge
def same_time(e: Evidence) -> Finding:
    """BDF and HHT take the same time a step within a factor of two."""
    (first, a), (second, b) = (_ratios(e, CPU_TABLES[0], equation, "HHT") for equation in ("(4.5)", "(4.11)"))
    return Finding(
        f"Time a step, median and range over the tables: (4.5) {first}; (4.11) {second}. In modal coordinates "
        "the forms are one kernel.",
        HOLDS if a + b and 0.5 < median(a + b) < 2.0 else FAILS,
    )


@judge
def time_by_scheme(e: Evidence) -> Finding:
    """SDIRK schemes differ in time with the paper's matrices, which are not used."""
    first, second = (_ratios(e, CPU_TABLES[1], equation, "(4.14)")[0] for equation in ("(4.10)", "(4.12)"))
    return Finding(
        f"Time a step: (4.10) {first}; (4.12) {second}. Here all three are one kernel in modal coordinates by "
        "construction, so that this says nothing of the paper's band and full matrices.",
        UNTESTABLE,
    )


@judge
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


@judge
def third_order(e: Evidence) -> Finding:
    """SDIRK-OS has order three with the right sign of sigma."""
    right, printed = (forced_order(s) for s in (SDIRK(), SDIRK().printed("sigma")))
    return Finding(
        f"Order: {right} with the corrected sign of sigma, {printed} as printed.",
        plain_verdict(abs(right.slope - 3.0) < 0.1),
    )


# ---------------------------------------------------------------- SDIRK with other parameters


@judge
def bad_at_third_order(e: Evidence) -> Finding:
    """Tip errors on Table 6 are larger with gamma = 0.4359 than with 1; in part for one form."""
    case, forms = paper_case(6), {"(4.10)": "velocity-curvature", "(4.12)": "displacement"}
    systems = {name: semidiscretise(case.problem, case.cells, form) for name, form in forms.items()}
    end = case.dt * int(min(float(e.row(6, form)["horizon"]) for form in forms.values()) / case.dt)
    parts, errors = [], {}
    for gamma in (0.4359, 1.0):
        for name, system in systems.items():
            run = integrate(system, e.reading.scheme(SDIRK(gamma)), case.dt, end, e.reading.contact)
            errors[gamma, name] = tip_error(run.tip, reference(system, end, t_eval=run.t).tip).rms
            parts.append(f"{name} {percent(errors[gamma, name])} at gamma = {gamma:g}")
    worse = [errors[0.4359, name] > errors[1.0, name] for name in forms]
    return Finding(
        f"Rms tip error on Table 6 to t = {end:.2g}: {'; '.join(parts)}. (4.12) is (4.14), which Section 5.4 uses "
        "there.",
        shared_verdict(all(worse), any(worse)),
    )


@judge
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


def _elsewhere(e: Evidence, table: int, run: str, what: str) -> np.ndarray:
    """Measure of the members of a run that the table does not have; empty where all members overflow."""
    members = e.tables[table]["span"]["members"]
    return np.array([x for seed in e.seeds for x in elsewhere(table, run, e.reading, members, seed).get(what, [])])


@judge
def sensitive(e: Evidence, table: int) -> Finding:
    """gamma changes the share of contact of (4.10) by a larger factor than that of (4.12)."""
    parts, changes = [], []
    for name, form in (("(4.10)", "velocity-curvature"), ("(4.12)", "displacement")):
        values = {g: _elsewhere(e, table, f"SDIRK(gamma={g})@{form}", "fraction") for g in (1.0, 0.4359)}
        for gamma, found in values.items():
            if not len(found):
                raise NotMeasured(f"{name} with gamma = {gamma:g} overflowed on Table {table}")
        m = min(map(len, values.values()))
        changes.append(Sample(np.abs(np.log(values[1.0][:m] / values[0.4359][:m]))))
        parts.append(f"{name} from " + " to ".join(Sample(x).written(100.0, " %") for x in values.values()))
    return Finding(
        f"Share of time in contact on Table {table}, gamma = 1 to 0.4359: {'; '.join(parts)}.",
        plain_verdict(above(*changes)),
    )


# ---------------------------------------------------------------- other damping on Table 10


@judge
def damping_avoids(e: Evidence, table: int) -> Finding:
    """HHT counts fewer impacts with every step of alpha, in the end fewer than the exact motion; in part for one."""
    alphas = (-0.05, -0.1, -0.2, -0.3, 0.0)
    counts = {a: Sample(_elsewhere(e, table, f"HHT(alpha={a})@displacement", "impacts")) for a in alphas}
    written = ", ".join(
        f"{x.written() if len(x.values) else 'overflow'} at alpha = {alpha:g}" for alpha, x in counts.items()
    )
    damped = [x for alpha, x in counts.items() if alpha and len(x.values)]
    if len(damped) < 2:
        raise NotMeasured(f"HHT overflows on Table {table}: {written}")
    falls = every(above(a, b) for a, b in pairwise(damped))
    fewer = below(damped[-1], IMPACTS.of(e, table, "displacement"))
    exact = IMPACTS.written(e, table, "displacement")
    return Finding(
        f"Impacts of HHT to T on Table {table}: {written}; exact {exact}.",
        HOLDS if falls and fewer else PARTLY if falls or fewer else OPEN if None in (falls, fewer) else FAILS,
    )


@judge
def trapezoidal(e: Evidence, table: int) -> Finding:
    """The trapezoidal rule has a worse share of contact than HHT; in part where it is better but gains energy."""
    share, fast = (Sample(_elsewhere(e, table, "Trapezoidal@displacement", x)) for x in ("fraction", "fast"))
    if not len(share.values):
        return Finding(f"All members overflow on Table {table} in this reading.", HOLDS)
    exact, hht = SHARE.of(e, table, "displacement"), SHARE.of(e, table, "(4.13)")
    members = e.tables[table]["span"]["members"]
    gain = Sample(np.array([x for seed in e.seeds for x in _energy_gains(table, e.reading.contact, members, seed)]))
    nearer, grows = below(*(Sample(np.abs(x.values - exact.mean)) for x in (share, hht))), above(gain, 0.0)
    return Finding(
        f"Table {table}, share of time in contact {share.written(100.0, ' %')} (exact "
        f"{SHARE.written(e, table, 'displacement')}, HHT {SHARE.written(e, table, '(4.13)')}); rms fast "
        f"velocity {fast.written()} (exact {e.sample(table, 'displacement', 'fast').written()}). It gains energy: "
        f"{gain.written(100.0, ' %')} of the most energy it was given, which no beam does; HHT loses it.",
        FAILS if nearer and no(grows) else PARTLY if nearer and grows else HOLDS if no(nearer) else OPEN,
    )


@lru_cache(maxsize=8)
def _energy_gains(table: int, contact: str, members: int, seed: int) -> tuple[float, ...]:
    """Energy that the trapezoidal rule adds to T, over the most energy that the beam was given, by member."""
    case = paper_case(table)
    copies = perturbed_members(semidiscretise(case.problem, case.cells), members, PERTURBATION, seed)
    runs = (integrate(member, Trapezoidal(), case.dt, case.t_end, contact, every=100) for member in copies)
    return tuple(-run.energy.lost_fraction() for run in runs)


# ---------------------------------------------------------------- chaos


@lru_cache(maxsize=8)
def growth(table: int, reading: Reading, members: int, seed: int) -> tuple[float | None, tuple[float, ...]]:
    """Rates at which neighbouring motions diverge: of the table's first run, and of exact members (tangent flow).

    The run's is ln(10^4) over the delay between perturbations of 1e-8 and of 1e-12 reaching a thousandth
    of the largest displacement, medians over ``members``; None where one of them does not within the span.
    """
    case = paper_case(table)
    scheme, form = case.runs[0]
    system, chosen = semidiscretise(case.problem, case.cells, form), reading.scheme(scheme)

    def tips(size: float) -> tuple[np.ndarray, np.ndarray]:
        copies = perturbed_members(system, members, size, seed) if size else [system]
        run = integrate_ensemble(system, chosen, case.dt, case.t_end, copies, reading.contact, every=5)
        return run.t, run.tip

    (t, (alone,)), times = tips(0.0), []
    for size in (1e-8, 1e-12):
        apart = np.abs(tips(size)[1] - alone) > 1e-3 * np.max(np.abs(alone))
        times.append(float(np.median(np.where(np.any(apart, axis=1), t[np.argmax(apart, axis=1)], np.inf))))
    early, late = times
    rate = math.log(1e4) / (late - early) if math.isfinite(late) and late > early else None
    return rate, tuple(lyapunov(x, case.t_end).exponent for x in perturbed_members(system, members, PERTURBATION, seed))


@judge
def chaotic(e: Evidence, table: int) -> Finding:
    """Neighbouring motions diverge exponentially, and one drive period does not resemble the next."""
    e.runs(table)
    change = MEASURES["aperiodicity"]
    found = [growth(table, e.reading, e.tables[table]["span"]["exact_members"], seed) for seed in e.seeds]
    rates, exact = [rate for rate, _ in found], Sample(np.array([x for _, exponents in found for x in exponents]))
    written = " and ".join("not within the span" if r is None else f"like exp({r:.0f} t)" for r in rates)
    irregular = [above(change.of(e, table, motion), LITTLE) for motion in ("(4.13)", "displacement")]
    return of_both(
        f"Neighbouring motions of HHT part {written}, exact ones with the exponent {exact.written()}. "
        f"{change.sentence(e, table)}.",
        every([None not in rates, irregular[0]]),
        every([above(exact, 0.0), irregular[1]]),
    )
