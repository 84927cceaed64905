"""Claims about the schemes and discretisations, judged by short computations of their own."""

from __future__ import annotations

from itertools import pairwise
from statistics import median

import numpy as np

from ..cases import paper_case
from ..march.integrate import integrate
from ..measures.amplification import amplification
from ..measures.regression import observed_order
from ..schemes import HHT, SDIRK, Trapezoidal
from ..schemes.newmark import WeightedNewmark
from ..schemes.sdirk import GAMMA_MAX, GAMMA_MIN
from ..semidiscretisation import semidiscretise
from ..solvers import reference
from ..studies import space
from .claims import FAILS, HOLDS, PARTLY, Claim, Evidence, Finding
from .claims_motion import percent
from .costs import largest_step
from .misprints import forced_order
from .no_contact import GRIDS, error_curves

GAMMAS = (0.18043, 0.2, 0.35, 0.4359, 0.7, 0.8, 1.0)  # away from the poles of the tableau


class FirstOrderNewmark(WeightedNewmark):
    """Newmark with gamma > 1/2 and beta = (gamma + 1/2)^2/4, undamped at no frequency (Remark 11)."""

    alpha_m = alpha_f = 0.0
    order = 1

    def __init__(self, gamma: float) -> None:
        self.gamma, self.beta = gamma, (gamma + 0.5) ** 2 / 4.0


def _space_order(e: Evidence) -> Finding:
    case, grids, parts, orders = paper_case(2), (20, 28, 40, 56, 80, 112), [], []
    for form, name in (("displacement", "(3.5)"), ("velocity-curvature", "(3.12)")):
        errors = [space.evaluate(case, {"kind": "response", "form": form, "cells": n})[0]["error"] for n in grids]
        order = observed_order([1.0 / n for n in grids], errors)
        orders.append(order.slope)
        parts.append(f"{name} {order}")
    return Finding(
        f"Order in h of the steady tip response to the moving clamp, against the closed form: {', '.join(parts)}.",
        HOLDS if all(abs(slope - 2.0) < 0.1 for slope in orders) else FAILS,
    )


def _imaginary(e: Evidence) -> Finding:
    system = semidiscretise(paper_case(2).problem, 25, "velocity-curvature").first_order()
    values = np.linalg.eigvals(system.matrix)
    values = values[np.abs(values) > 1.0]
    share = float(np.max(np.abs(values.real) / np.abs(values)))
    return Finding(
        f"Largest |Re|/|lambda| of the matrix of (3.12), h = 0.04: {share:.1e}.", HOLDS if share < 1e-6 else FAILS
    )


def _higher_gamma(e: Evidence) -> Finding:
    # R(z) at z = 10 i: an oscillation with 10/(2 pi) steps a radian.
    radii = [float(amplification(SDIRK(g), 10.0 / (2.0 * np.pi)).spectral_radius[0]) for g in GAMMAS]
    falls = all(a > b for a, b in pairwise(radii))
    written = ", ".join(f"{r:.3f} at {g:.4g}" for g, r in zip(GAMMAS, radii, strict=True))
    return Finding(f"|R(10 i)|: {written}.", HOLDS if falls else FAILS)


def _l_stable(e: Evidence) -> Finding:
    y = np.logspace(-3, 4, 4000)

    def largest(g: float) -> float:
        z = 1j * y
        numerator = (3 * g**2 - 3 * g + 0.5) * z**2 - (3 * g - 1) * z + 1
        return float(np.max(np.abs(numerator / (1 - g * z) ** 3))) - 1.0

    inside = max(largest(g) for g in np.linspace(GAMMA_MIN, GAMMA_MAX, 60))
    outside = min(largest(GAMMA_MIN - 0.002), largest(GAMMA_MAX + 0.02))
    return Finding(
        f"max |R(iy)| - 1 over y: at most {max(inside, 0.0):.0e} inside [{GAMMA_MIN:.5f}, {GAMMA_MAX:.5f}], at least "
        f"{outside:.0e} just outside; R vanishes at infinity.",
        HOLDS if inside < 1e-12 < outside else FAILS,
    )


def _hht_control(e: Evidence) -> Finding:
    alphas = (0.0, -0.05, -0.1, -0.2, -0.3, -1.0 / 3.0)
    radii = [float(amplification(HHT(a), 1e4).spectral_radius[0]) for a in alphas]
    falls = all(a > b for a, b in pairwise(radii))
    written = ", ".join(f"{r:.2f} at {a:.3g}" for a, r in zip(alphas, radii, strict=True))
    return Finding(f"Spectral radius at high frequency: {written}.", HOLDS if falls else FAILS)


def _newmark(e: Evidence) -> Finding:
    x = 0.01
    newmark, hht = amplification(FirstOrderNewmark(0.6), x), amplification(HHT(-0.1), x)
    a, b = float(newmark.damping_ratio[0]), float(hht.damping_ratio[0])
    return Finding(
        f"Damping ratio of a low mode, 100 steps a period: {a:.1e} for Newmark with gamma = 0.6, {b:.1e} for "
        "HHT(-0.1).",
        HOLDS if a > 10.0 * b else FAILS,
    )


def _trapezoidal(e: Evidence) -> Finding:
    case = paper_case(10)
    system = semidiscretise(case.problem, case.cells)
    run = integrate(system, Trapezoidal(), case.dt, case.t_end, every=1000)
    truth, hht = e.true(10), e.run(10, "(4.13)")
    share = run.contacts[0].fraction
    nearer = abs(share - truth["fraction"]) < abs(hht["fraction"] - truth["fraction"])
    return Finding(
        f"Table 10, trapezoidal rule: {percent(share)} in contact and {run.impacts.count} impacts; HHT "
        f"{percent(hht['fraction'])} and {hht['impacts']}; true {percent(truth['fraction'])} and {truth['impacts']}.",
        FAILS if nearer else HOLDS,
    )


def _period_errors(e: Evidence) -> Finding:
    hht = float(amplification(HHT(-0.1), 0.1).period_elongation[0])
    sdirk = {g: float(amplification(SDIRK(g), 0.1).period_elongation[0]) for g in (0.4359, 1.0)}
    smaller = [abs(x) < abs(hht) for x in sdirk.values()]
    return Finding(
        f"Period elongation at ten steps a period: HHT(-0.1) {percent(hht)}; SDIRK-OS {percent(sdirk[0.4359])} with "
        f"gamma = 0.4359, {percent(sdirk[1.0])} with gamma = 1.",
        HOLDS if all(smaller) else PARTLY if any(smaller) else FAILS,
    )


def _no_contact(e: Evidence) -> Finding:
    curves = error_curves(e.reading)
    schemes = [curve for curve in curves if curve.name not in GRIDS]
    worst = max(schemes, key=lambda curve: float(np.max(curve.in_time)))
    grid = {curve.name: float(np.max(curve.error)) for curve in curves if curve.name in GRIDS}
    return Finding(
        f"Errors stay bounded, but they are those of the grid: {grid[GRIDS[0]]:.1e} on (3.5) and "
        f"{grid[GRIDS[1]]:.1e} on (3.12), solved exactly in time; a scheme adds at most {np.max(worst.in_time):.1e} "
        f"({worst.name}).",
        HOLDS if max(float(np.max(c.error)) for c in schemes) < 0.01 else FAILS,
    )


def _bdf_alike(e: Evidence) -> Finding:
    case, end = paper_case(2), 2.85
    systems = {form: semidiscretise(case.problem, case.cells, form) for _, form in case.runs}
    hht, bdf_curvature, bdf = (
        integrate(systems[form], e.reading.scheme(scheme), case.dt, end, e.reading.contact)
        for scheme, form in case.runs
    )

    def apart(a, b) -> float:
        return float(np.sqrt(np.mean((a.tip - b.tip) ** 2)) / np.max(np.abs(a.tip)))

    between, to_hht = apart(bdf, bdf_curvature), min(apart(hht, bdf), apart(hht, bdf_curvature))
    return Finding(
        f"Rms difference on [0, 2.85]: {percent(between)} between (4.5) and (4.11), {percent(to_hht)} from HHT to "
        "the nearer.",
        HOLDS if to_hht > 3.0 * between else PARTLY if to_hht > between else FAILS,
    )


def _bad_at_third_order(e: Evidence) -> Finding:
    case = paper_case(6)
    systems = {form: semidiscretise(case.problem, case.cells, form) for form in ("velocity-curvature", "displacement")}
    horizon = min(float(e.true(6, form)["horizon"]) for form in systems)
    end = case.dt * int(horizon / case.dt)
    parts, errors = [], {}
    for gamma in (0.4359, 1.0):
        for name, form in (("(4.10)", "velocity-curvature"), ("(4.12)", "displacement")):
            run = integrate(systems[form], e.reading.scheme(SDIRK(gamma)), case.dt, end, e.reading.contact)
            u = reference(systems[form], end, t_eval=run.t).tip
            errors[gamma, name] = float(np.sqrt(np.mean((run.tip - u) ** 2)) / np.max(np.abs(u)))
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
        HOLDS if all(same) else FAILS,
    )


def _space_at_resonance(e: Evidence) -> Finding:
    parts, apart = [], []
    for table in (6, 9):
        case = paper_case(table)
        solved = [
            reference(semidiscretise(case.problem, case.cells, form), case.t_end / 5.0)
            for form in ("displacement", "velocity-curvature")
        ]
        end = min(run.horizon for run in solved)
        t = np.linspace(0.0, min(end, case.t_end / 5.0), 4000)
        u, w = (run.at(t)[0] for run in solved)
        apart.append(float(np.sqrt(np.mean((u - w) ** 2)) / np.max(np.abs(u))))
        parts.append(f"{percent(apart[-1])} on Table {table} to t = {t[-1]:.2g}")
    return Finding(
        f"True motions of (3.5) and (3.12) differ by (rms) {', '.join(parts)}.",
        HOLDS if apart[1] > 2.0 * apart[0] else PARTLY if apart[1] > 0.05 else FAILS,
    )


def _ratio(e: Evidence, tables: tuple[int, ...], equation: str) -> tuple[list[float], list[float]]:
    rows = [r for r in e.costs if r["table"] in tables and r["equation"] == equation and r["ratio"] is not None]
    return [r["paper_ratio"] for r in rows], [r["ratio"] for r in rows]


def _span(values: list[float]) -> str:
    """The median, and from where to where: one table's ratio can be off on a busy machine."""
    return f"{median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def _same_time(e: Evidence) -> Finding:
    parts, own = [], []
    for equation in ("(4.5)", "(4.11)"):
        paper, ours = _ratio(e, (1, 2, 3, 4, 5), equation)
        parts.append(f"{equation} {_span(ours)} times HHT (paper {_span(paper)})")
        own += ours
    return Finding(
        f"Time a step, median and range over the tables: {'; '.join(parts)}.",
        HOLDS if 0.5 < median(own) < 2.0 else FAILS,
    )


def _sdirk_time(e: Evidence) -> Finding:
    parts, own = [], []
    for equation in ("(4.10)", "(4.12)"):
        paper, ours = _ratio(e, (6, 7, 8, 9), equation)
        parts.append(f"{equation} {_span(ours)} times (4.14) (paper {_span(paper)})")
        own += ours
    return Finding(
        f"Time a step, median and range over the tables: {'; '.join(parts)}. "
        "In modal coordinates the three are one kernel.",
        FAILS if 0.67 < median(own) < 1.5 else HOLDS,
    )


def _hht_faster(e: Evidence) -> Finding:
    paper, own = _ratio(e, (10, 11, 12, 13), "(4.14)")
    hht, sdirk = (largest_step(scheme) for scheme in (HHT(-0.1), SDIRK(nystrom=True)))
    ratio = median(own)
    equal = "no step tried gives both a tip error of 0.1 %"
    slower = median(own) > 1.0
    if hht and sdirk:
        slower = ratio * hht / sdirk > 1.0
        equal = (
            f"for a tip error of 0.1 % over four impacts of Table 10 HHT needs dt = {hht:.1e} and SDIRK {sdirk:.1e}, "
            f"so that SDIRK takes {ratio * hht / sdirk:.2f} times the time of HHT"
        )
    return Finding(
        f"A step of (4.14) takes {_span(own)} times one of HHT (paper {_span(paper)}); {equal}.",
        (HOLDS if slower else PARTLY) if median(own) > 1.1 else FAILS,
    )


def _damping_avoids(e: Evidence) -> Finding:
    case = paper_case(10)
    system = semidiscretise(case.problem, case.cells)
    counts = {}
    for alpha in (0.0, -0.05, -0.1, -0.2, -0.3):
        run = integrate(system, HHT(alpha), case.dt, case.t_end, e.reading.contact, every=1000)
        counts[alpha] = run.impacts.count
    written = ", ".join(f"{n} at alpha = {alpha:g}" for alpha, n in counts.items())
    ordered = list(counts.values())
    return Finding(
        f"Table 10, HHT: {written} impacts; true {e.true(10)['impacts']}.",
        HOLDS if all(a > b for a, b in pairwise(ordered)) else PARTLY,
    )


def _third_order(e: Evidence) -> Finding:
    right, printed = (forced_order(s) for s in (SDIRK(), SDIRK().printed("sigma")))
    return Finding(
        f"Order on a smooth forced problem: {right} with the corrected sign of sigma, {printed} as printed.",
        HOLDS if abs(right.slope - 3.0) < 0.1 else FAILS,
    )


CLAIMS = [
    Claim("3", "Both discretisations in space are of second order (Remark 5)", _space_order),
    Claim("4.1", "The matrix of (3.12) has purely imaginary eigenvalues only (Remark 6)", _imaginary),
    Claim("4.1", "Higher is the value of gamma, higher is the damping", _higher_gamma),
    Claim("4.3", "L-stable for gamma in [0.1804, 2.1856]", _l_stable),
    Claim("4.3", "HHT controls the numerical dissipation through alpha", _hht_control),
    Claim("4.3", "The trapezoid method does not give satisfactory results", _trapezoidal),
    Claim("4.3", "First-order Newmark damps the low modes, HHT dissipates better (Remark 11)", _newmark),
    Claim("4.3", "SDIRK-OS has smaller relative period errors than HHT", _period_errors),
    Claim("5.1", "Without contact the schemes are stable and accurate", _no_contact),
    Claim("5.2, Table 2", "At contact the two BDF schemes are near similar, HHT is very different", _bdf_alike),
    Claim("5.2, Table 5", "Except for some computations the three methods need the same CPU time", _same_time),
    Claim("5.3", "(4.10) and (4.12) give bad results when gamma = 0.4359", _bad_at_third_order),
    Claim("5.3, Table 8", "The solutions of (4.12) and (4.14) are exactly similar", _exactly_similar),
    Claim("5.3, Table 9", "At resonance the solutions depend strongly on the space "
    "discretisation", _space_at_resonance),
    Claim("5.3, Table 9", "The CPU time depends on the SDIRK scheme used", _sdirk_time),
    Claim("5.4", "With gamma = 0.4359 the SDIRK scheme becomes third order accurate", _third_order),
    Claim("5.4, Table 13", "Too much damping can avoid some impacts", _damping_avoids),
    Claim("5.4, Table 13", "HHT is clearly the faster algorithm", _hht_faster),
]  # fmt: skip
