"""Claims of Sections 5.2 to 6 about the motion, judged by the numbers of the tables."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from ..cases import paper_cases
from ..march.ensemble import integrate_ensemble
from ..march.members import perturbed
from ..measures.peaks import EXCITED
from ..semidiscretisation import semidiscretise
from ..solvers.tangent import lyapunov
from .claims import FAILS, HOLDS, PARTLY, Claim, Evidence, Finding, verdict
from .numbers import Numbers

PREFERENCE = 1.5  # times: what counts as higher amplitudes of one kind of multiples than of the other
BROAD = 1 / 3  # share of the frequencies to 15a that are excited; lines at all odd multiples fill half of it at most
PERIODIC = 0.03  # aperiodicity below which a motion counts as periodic: about the width of a line in print


def percent(value: float) -> str:
    return f"{100 * value:.2g} %"


def lines(row: Numbers, highest: int = 9) -> list[int]:
    """The multiples of the drive among the peaks, from 2 to ``highest``, that are EXCITED."""
    least = EXCITED * max(row["multiples"])
    return [round(p["multiple"]) for p in row["peaks"] if p["name"] in _multiples(highest) and p["amplitude"] > least]


def _multiples(highest: int) -> set[str]:
    return {f"{k}a" for k in range(2, highest + 1)}


def _named(orders: list[int]) -> str:
    return ", ".join(f"{k}a" for k in orders) or "none"


def _odd(row: Numbers, wanted: tuple[int, ...]) -> bool:
    """The ``wanted`` multiples are peaks, and odd ones stand clearly above even ones."""
    return set(wanted) <= set(lines(row)) and row["even_over_odd"] < 1.0 / PREFERENCE


def _odd_multiples(table: int, wanted: tuple[int, ...]):
    def check(e: Evidence) -> Finding:
        runs = "; ".join(f"{name} {_named(lines(row))}" for name, row in e.runs(table).items())
        truth = e.true(table)
        of_runs = all(_odd(row, wanted) for row in e.runs(table).values())
        return Finding(
            f"Peaks from 2a to 9a above a hundredth of the largest: {runs}; true motion {_named(lines(truth))}.",
            verdict(of_runs, _odd(truth, wanted)),
        )

    return check


def _decaying(e: Evidence) -> Finding:
    def decays(row: Numbers) -> bool:
        odd = row["multiples"][0:10:2]
        return all(a > b for a, b in pairwise(odd))

    truth = e.true(2)["multiples"]
    ratios = ", ".join(f"{truth[k - 1] / truth[0]:.3f}" for k in (3, 5, 7, 9))
    return Finding(
        f"True amplitudes at 3a, 5a, 7a, 9a over that at a: {ratios}.",
        verdict(all(decays(row) for row in e.runs(2).values()), decays(e.true(2))),
    )


def _long_contact(table: int):
    def check(e: Evidence) -> Finding:
        shares = {name: row["fraction"] for name, row in e.runs(table).items()}
        truth = e.true(table)["fraction"]
        runs = ", ".join(f"{name} {percent(share)}" for name, share in shares.items())
        return Finding(
            f"Share of time in contact: {runs}; true motion {percent(truth)}.",
            verdict(all(share > 0.5 for share in shares.values()), truth > 0.5),
        )

    return check


def _broad(table: int):
    def check(e: Evidence) -> Finding:
        runs = {name: row["band"] for name, row in e.runs(table).items()}
        truth = e.true(table)["band"]
        written = ", ".join(f"{name} {percent(x)}" for name, x in runs.items())
        return Finding(
            f"Frequencies to 15a with more than a hundredth of the largest amplitude: {written}; true "
            f"{percent(truth)}.",
            verdict(all(x > BROAD for x in runs.values()), truth > BROAD),
        )

    return check


def _prefers_odd(table: int):
    def check(e: Evidence) -> Finding:
        runs = {name: row["even_over_odd"] for name, row in e.runs(table).items()}
        truth = e.true(table)["even_over_odd"]
        written = ", ".join(f"{name} {x:.2f}" for name, x in runs.items())
        return Finding(
            f"Even over odd multiples, 2a to 15a: {written}; true {truth:.2f} (below {1 / PREFERENCE:.2f} would be "
            "odd).",
            verdict(all(x < 1 / PREFERENCE for x in runs.values()), truth < 1 / PREFERENCE),
        )

    return check


def _hht_noisier(e: Evidence) -> Finding:
    fast = {name: row["fast"] for name, row in e.runs(1).items()}
    truth = e.true(1)["fast"]
    others = [x for name, x in fast.items() if name != "(4.13)"]
    written = ", ".join(f"{name} {x:.2g}" for name, x in fast.items())
    ok = fast["(4.13)"] > max(others)
    return Finding(
        f"Rms tip velocity above the second natural frequency: {written}; true {truth:.2g}. The noise is the beam's, "
        "and HHT keeps more of it.",
        HOLDS if ok else FAILS,
    )


def _deflection(e: Evidence) -> Finding:
    depth = {name: row["penetration"] for name, row in e.runs(1).items()}
    written = ", ".join(f"{name} {x:.2g}" for name, x in depth.items())
    truth = e.true(1)["penetration"], e.true(1, "velocity-curvature")["penetration"]
    ok = depth["(4.5)"] == min(depth.values())
    return Finding(
        f"Largest deflection of a stop to the horizon: {written}; true {truth[0]:.2g} on (3.5), {truth[1]:.2g} on "
        "(3.12).",
        HOLDS if ok else FAILS,
    )


def _more_impacts(e: Evidence) -> Finding:
    soft, stiff = ({name: row["impacts"] for name, row in e.runs(t).items()} for t in (2, 1))
    true_soft, true_stiff = e.true(2)["impacts"], e.true(1)["impacts"]
    written = ", ".join(f"{name} {soft[name]} for {stiff[name]}" for name in soft)
    return Finding(
        f"Impacts of Table 2 for Table 1: {written}; true {true_soft} for {true_stiff}.",
        verdict(all(soft[name] > stiff[name] for name in soft), true_soft > true_stiff),
    )


def _smoother(e: Evidence) -> Finding:
    fast = {name: row["fast"] for name, row in e.runs(6).items()}
    truth = e.true(6)["fast"], e.true(6, "velocity-curvature")["fast"]
    written = ", ".join(f"{name} {x:.3g}" for name, x in fast.items())
    return Finding(
        f"Rms tip velocity above the second natural frequency: {written}; true {truth[0]:.3g} on (3.5), "
        f"{truth[1]:.3g} on (3.12).",
        verdict(fast["(4.10)"] < min(fast["(4.12)"], fast["(4.14)"]), truth[1] < truth[0]),
    )


def _same_lines(e: Evidence) -> Finding:
    sets = {name: lines(row) for name, row in e.runs(10).items()}
    written = "; ".join(f"{name} {_named(orders)}" for name, orders in sets.items())
    first, *rest = sets.values()
    same = all(orders == first for orders in rest)
    truth = lines(e.true(10))
    return Finding(
        f"Peaks from 2a to 9a above a hundredth of the largest: {written}; true {_named(truth)}.",
        (HOLDS if truth == first else PARTLY) if same else FAILS,
    )


def _counts_differ(e: Evidence) -> Finding:
    parts, apart = [], []
    for table in (10, 11, 12, 13):
        a, b = (e.run(table, name)["ensemble"] for name in ("(4.13)", "(4.14)"))
        gap = abs(a["impacts"] - b["impacts"]) / math.hypot(a["impacts_sd"], b["impacts_sd"])
        truth = e.true(table)["impacts"]
        parts.append(f"Table {table}: HHT {a['impacts']:.0f}, SDIRK {b['impacts']:.0f}, true {truth}")
        apart.append(gap > 3.0)
    return Finding(
        f"Ensemble means {'; '.join(parts)}. HHT and SDIRK are more than three standard deviations apart in "
        f"{sum(apart)} of 4 tables.",
        HOLDS if all(apart) else PARTLY if any(apart) else FAILS,
    )


def _one_stop_lines(e: Evidence) -> Finding:
    run, truth = e.run(14, "(4.13)"), e.true(14)
    a = truth["multiples"]
    six = a[5] > max(a[2:5] + a[6:])  # of 3a and above
    return Finding(
        f"Even over odd multiples, 2a to 15a: HHT {run['even_over_odd']:.2f}, true {truth['even_over_odd']:.2f}; "
        f"true amplitudes at 2a to 7a: {', '.join(f'{x:.4f}' for x in a[1:7])}; 6a is "
        f"{'the highest' if six else 'not the highest'} from 3a on.",
        HOLDS if min(run["even_over_odd"], truth["even_over_odd"]) > PREFERENCE and six
        else PARTLY if min(run["even_over_odd"], truth["even_over_odd"]) > 1.0 and six else FAILS,
    )  # fmt: skip


def _periodic(table: int, equation: str = "(4.13)"):
    def check(e: Evidence) -> Finding:
        run, truth = e.run(table, equation), e.true(table)
        rates = growth(table)
        return Finding(
            f"From one drive period to the next the tip changes by {percent(run['aperiodicity'])} with HHT and by "
            f"{percent(truth['aperiodicity'])} truly; neighbouring motions part like exp({rates[0]:.0f} t) and "
            f"exp({rates[1]:.0f} t).",
            verdict(run["aperiodicity"] < PERIODIC, truth["aperiodicity"] < PERIODIC),
        )

    return check


def _chaotic(e: Evidence) -> Finding:
    rates = growth(17)
    run, truth = e.run(17, "(4.13)"), e.true(17)
    return Finding(
        f"Neighbouring motions part like exp({rates[0]:.0f} t) with HHT and exp({rates[1]:.0f} t) truly; "
        f"aperiodicity {run['aperiodicity']:.2f} and {truth['aperiodicity']:.2f}.",
        verdict(rates[0] > 1.0, rates[1] > 1.0),
    )


def growth(table: int, members: int = 6) -> tuple[float, float]:
    """The rates at which neighbours part: of the table's first run, and of the true motion (tangent flow).

    The run's is ln(10^4) over the delay between perturbations of 1e-8 and of 1e-12 reaching a thousandth
    of its own motion, medians over ``members``; 0 where one of them does not within the span.
    """
    case = paper_cases()[f"table{table}"]
    scheme, form = case.runs[0]
    system, every = semidiscretise(case.problem, case.cells, form), 5

    def tips(size: float, count: int):
        copies = perturbed(system, count, size)
        return integrate_ensemble(system, scheme, case.dt, case.t_end, copies, every=every)

    undisturbed = tips(0.0, 1)
    own, t = undisturbed.tip[0], undisturbed.t
    times = []
    for size in (1e-8, 1e-12):
        apart = np.abs(tips(size, members).tip - own) > 1e-3 * np.max(np.abs(own))
        times.append(float(np.median(np.where(np.any(apart, axis=1), t[np.argmax(apart, axis=1)], np.inf))))
    early, late = times
    rate = math.log(1e4) / (late - early) if math.isfinite(late) and late > early else 0.0
    return rate, lyapunov(system, case.t_end).exponent


def _longer_contact(e: Evidence) -> Finding:
    run, truth = ([row["fraction"] for row in rows] for rows in (
        (e.run(15, "(4.13)"), e.run(16, "(4.13)")), (e.true(15), e.true(16))
    ))  # fmt: skip
    return Finding(
        f"Share of time in contact, Table 15 then 16: HHT {percent(run[0])}, {percent(run[1])}; true "
        f"{percent(truth[0])}, {percent(truth[1])}.",
        verdict(run[1] > run[0], truth[1] > truth[0]),
    )


def _load_lines(e: Evidence) -> Finding:
    run, truth = lines(e.run(16, "(4.13)")), lines(e.true(16))
    return Finding(
        f"Peaks above w, to 9w: HHT {_named(run)}; true {_named(truth)} (a stands for w).",
        verdict(len(run) >= 2, len(truth) >= 2),
    )


def _wide_at_resonance(e: Evidence) -> Finding:
    stiff, flexible, fast = (e.true(table)["band"] for table in (1, 2, 5))
    return Finding(
        "True share of the frequencies to 15a with more than a hundredth of the largest amplitude: Table 1 (stiff, "
        f"a = 10) {percent(stiff)}, Table 2 (flexible, a = 10) {percent(flexible)}, Table 5 (flexible, a = 60) "
        f"{percent(fast)}.",
        HOLDS if fast > BROAD and stiff < flexible < fast else PARTLY if fast > BROAD else FAILS,
    )


def _similar(table: int):
    def check(e: Evidence) -> Finding:
        a, b = e.run(table, "(4.13)"), e.run(table, "(4.14)")
        truth = e.true(table)
        return Finding(
            f"Impacts {a['impacts']} and {b['impacts']}, true {truth['impacts']}; contact {percent(a['fraction'])} "
            f"and {percent(b['fraction'])}, true {percent(truth['fraction'])}; rms tip error to the horizon "
            f"{percent(a['tip_error'])} and {percent(b['tip_error'])} of the largest displacement.",
            PARTLY if abs(a["fraction"] - b["fraction"]) < 0.1 else FAILS,
        )

    return check


CLAIMS = [
    Claim("5.2, Table 1", "The FFT shows odd multiples of the driving frequency: 3a, 5a, …", _odd_multiples(1, (3, 5))),
    Claim("5.2, Table 1", "The phase portrait obtained with HHT is more noisy", _hht_noisier),
    Claim("5.2, Table 1", "The deflection is smaller with the first BDF scheme (4.5)", _deflection),
    Claim("5.2, Table 1", "There is contact over considerable periods of time", _long_contact(1)),
    Claim("5.2, Table 2", "The number of impacts is higher than with the stiff beam", _more_impacts),
    Claim("5.2, Table 2", "Odd multiples are excited, 3a, 5a, …", _odd_multiples(2, (3, 5))),
    Claim("5.2, Table 2", "… with decaying amplitudes", _decaying),
    Claim("5.2, Table 3", "Free flights are very short compared with contacts", _long_contact(3)),
    Claim("5.2, Table 3", "The FFT shows a wide band of excited frequencies", _broad(3)),
    Claim("5.2, Table 4", "A large band of frequencies is excited", _broad(4)),
    Claim("5.2, Table 4", "… but the odd multiples have higher amplitudes", _prefers_odd(4)),
    Claim("5.2, Table 5", "The motion becomes noisy", _broad(5)),
    Claim("5.3, Table 6", "The portrait of the third discretisation (4.10) is smoother", _smoother),
    Claim("5.3, Table 6", "The odd multiples are excited, in particular the first four", _odd_multiples(6, (3, 5, 7))),
    Claim("5.3, Table 7", "A wide band of frequencies is excited", _broad(7)),
    Claim("5.3, Table 8", "A large band is excited and odd multiples are higher", _prefers_odd(8)),
    Claim("5.4, Table 10", "HHT and SDIRK show the same excited frequencies", _same_lines),
    Claim("5.4, Table 11", "Results are similar; the free flight between the stops is very short", _similar(11)),
    Claim("5.4, Table 12", "The results obtained by both methods are similar, except for some impacts", _similar(12)),
    Claim("5.4", "The number of impacts could depend on the choice of the method", _counts_differ),
    Claim("5.5.1, Table 14", "With one stop the motion is periodic", _periodic(14)),
    Claim("5.5.1, Table 14", "Multiples of a are excited, even ones much higher; 6a has high "
    "amplitude", _one_stop_lines),
    Claim("5.5.2, Table 15", "The contact time is long compared with the free flight", _long_contact(15)),
    Claim("5.5.2, Table 15", "The shear stress indicates that the motion is periodic", _periodic(15)),
    Claim("5.5.2, Table 16", "With the load at 0.7 the contact time is longer", _longer_contact),
    Claim("5.5.2, Table 16", "Multiples of w are excited", _load_lines),
    Claim("5.5.2, Table 16", "The motion seems to be periodic", _periodic(16)),
    Claim("5.5.3, Table 17", "The motion may be considered as chaotic", _chaotic),
    Claim("5.5.3, Table 17", "A wide band of frequencies is excited", _broad(17)),
    Claim("6", "At high driving frequencies or low stiffness a wide range of frequencies is "
    "excited", _wide_at_resonance),
]  # fmt: skip
