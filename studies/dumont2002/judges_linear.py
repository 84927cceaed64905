"""Judges of statements about discretisations and schemes without contact: Sections 3, 4 and 5.1."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from stiffbeam.files.cases import paper_case
from stiffbeam.measures.amplification import amplification
from stiffbeam.measures.errors import observed_order
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.model.state_space import state_space
from stiffbeam.schemes import BDF2, HHT, SDIRK
from stiffbeam.schemes.newmark import WeightedNewmark
from stiffbeam.schemes.sdirk import GAMMA_MAX, GAMMA_MIN
from stiffbeam.studies import space

from .evidence import Evidence
from .misprints import forced_order
from .no_contact import GRIDS, error_curves
from .typeset import percent
from .verdicts import Finding, plain_verdict, shared_verdict

GAMMAS = (0.18043, 0.2, 0.35, 0.4359, 0.7, 0.8, 1.0)  # away from the poles of the tableau
ALPHAS = (0.0, -0.05, -0.1, -0.2, -0.3, -1.0 / 3.0)


class FirstOrderNewmark(WeightedNewmark):
    """Newmark with gamma > 1/2 and beta = (gamma + 1/2)^2/4, undamped at no frequency (Remark 11)."""

    alpha_m = alpha_f = 0.0
    order = 1

    def __init__(self, gamma: float) -> None:
        self.gamma, self.beta = gamma, (gamma + 0.5) ** 2 / 4.0


def order_in_space(e: Evidence) -> Finding:
    """Both discretisations in space are of second order."""
    case, grids, parts, orders = paper_case(2), (20, 28, 40, 56, 80, 112), [], []
    for form, name in (("displacement", "(3.5)"), ("velocity-curvature", "(3.12)")):
        errors = [space.Space().run(case, "response", form, n)[0]["error"] for n in grids]
        order = observed_order([1.0 / n for n in grids], errors)
        orders.append(order.slope)
        parts.append(f"{name} {order}")
    return Finding(f"Order in h: {', '.join(parts)}.", plain_verdict(all(abs(slope - 2.0) < 0.1 for slope in orders)))


def imaginary_eigenvalues(e: Evidence) -> Finding:
    """The matrix of (3.12) has imaginary eigenvalues only."""
    system = semidiscretise(paper_case(2).problem, 25, "velocity-curvature")
    values = np.linalg.eigvals(state_space(system).matrix)
    values = values[np.abs(values) > 1.0]
    share = float(np.max(np.abs(values.real) / np.abs(values)))
    return Finding(f"Largest |Re|/|lambda|, h = 0.04: {share:.1e}.", plain_verdict(share < 1e-6))


def higher_gamma(e: Evidence) -> Finding:
    """The spectral radius of a fast oscillation falls with every gamma."""
    # R(z) at z = 10 i: an oscillation with 10/(2 pi) steps a radian.
    radii = [float(amplification(SDIRK(g), 10.0 / (2.0 * np.pi)).spectral_radius[0]) for g in GAMMAS]
    written = ", ".join(f"{r:.3f} at {g:.4g}" for g, r in zip(GAMMAS, radii, strict=True))
    return Finding(f"|R(10 i)|: {written}.", plain_verdict(all(a > b for a, b in pairwise(radii))))


def l_stable(e: Evidence) -> Finding:
    """SDIRK-OS is L-stable for gamma inside the interval, and just outside it is not."""
    y = np.logspace(-3, 4, 4000)

    def largest(g: float) -> float:
        z = 1j * y
        numerator = (3 * g**2 - 3 * g + 0.5) * z**2 - (3 * g - 1) * z + 1
        return float(np.max(np.abs(numerator / (1 - g * z) ** 3))) - 1.0

    inside = max(largest(g) for g in np.linspace(GAMMA_MIN, GAMMA_MAX, 60))
    outside = min(largest(GAMMA_MIN - 0.002), largest(GAMMA_MAX + 0.02))
    return Finding(
        f"max |R(iy)| − 1 over y: at most {max(inside, 0.0):.0e} inside [{GAMMA_MIN:.5f}, {GAMMA_MAX:.5f}], at least "
        f"{outside:.0e} just outside; R vanishes at infinity.",
        plain_verdict(inside < 1e-12 < outside),
    )


def hht_control(e: Evidence) -> Finding:
    """The spectral radius at high frequency falls with every alpha."""
    radii = [float(amplification(HHT(a), 1e4).spectral_radius[0]) for a in ALPHAS]
    written = ", ".join(f"{r:.2f} at {a:.3g}" for a, r in zip(ALPHAS, radii, strict=True))
    return Finding(
        f"Spectral radius at high frequency: {written}.", plain_verdict(all(a > b for a, b in pairwise(radii)))
    )


def hht_order(e: Evidence) -> Finding:
    """HHT is of second order."""
    found = {alpha: forced_order(HHT(alpha)) for alpha in (-0.05, -0.1, -0.3)}
    written = ", ".join(f"{order} at alpha = {alpha:g}" for alpha, order in found.items())
    return Finding(
        f"Order on a smooth forced problem: {written}. As (4.13) is printed it is of first order, see the misprints.",
        plain_verdict(all(abs(order.slope - 2.0) < 0.1 for order in found.values())),
    )


def hht_stable(e: Evidence) -> Finding:
    """HHT is stable at every step."""
    steps = np.logspace(-3, 4, 400)
    inside = max(float(np.max(amplification(HHT(a), steps).spectral_radius)) - 1.0 for a in ALPHAS)
    return Finding(
        f"Largest spectral radius less 1, dt/T from {steps[0]:g} to {steps[-1]:g}, {len(ALPHAS)} values of alpha "
        f"from 0 to -1/3: {inside:.0e}. With contact extrapolated HHT does overflow, see the reading.",
        plain_verdict(inside < 1e-9),
    )


def superior_stability(e: Evidence) -> Finding:
    """SDIRK-OS forgets a fast mode within a step, HHT does not; both are stable."""
    steps = np.logspace(-3, 4, 400)
    radii = {s: amplification(s, steps).spectral_radius for s in (SDIRK(), SDIRK(1.0), HHT(-0.1), HHT(-1.0 / 3.0))}
    stable = all(float(np.max(r)) < 1.0 + 1e-9 for r in radii.values())
    ends = [float(r[-1]) for r in radii.values()]
    return Finding(
        f"Both are stable at every step. At high frequency SDIRK-OS has the radius {ends[0]:.1e} (gamma = 0.4359) and "
        f"{ends[1]:.1e} (gamma = 1), HHT {ends[2]:.2f} (alpha = -0.1) and {ends[3]:.2f} at the least (alpha = -1/3).",
        plain_verdict(stable and max(ends[:2]) < 0.01 < min(ends[2:])),
    )


def newmark(e: Evidence) -> Finding:
    """First-order Newmark damps a low mode ten times as much as HHT."""
    x = 0.01
    newmark, hht = amplification(FirstOrderNewmark(0.6), x), amplification(HHT(-0.1), x)
    a, b = float(newmark.damping_ratio[0]), float(hht.damping_ratio[0])
    long = [float(found.period_elongation[0]) for found in (newmark, hht)]
    return Finding(
        f"Damping ratio of a low mode at 100 steps a period: {a:.1e} for Newmark with gamma = 0.6, {b:.1e} for "
        f"HHT(alpha=-0.1); period elongation {long[0]:.1e} and {long[1]:.1e}.",
        plain_verdict(a > 10.0 * b),
    )


def period_errors(e: Evidence) -> Finding:
    """SDIRK-OS has a smaller period elongation than HHT; in part for one of its gamma."""
    hht = float(amplification(HHT(-0.1), 0.1).period_elongation[0])
    sdirk = {g: float(amplification(SDIRK(g), 0.1).period_elongation[0]) for g in (0.4359, 1.0)}
    smaller = [abs(x) < abs(hht) for x in sdirk.values()]
    return Finding(
        f"Period elongation at ten steps a period: HHT(alpha=-0.1) {percent(hht)}; "
        f"SDIRK-OS {percent(sdirk[0.4359])} with gamma = 0.4359, {percent(sdirk[1.0])} with gamma = 1.",
        shared_verdict(all(smaller), any(smaller)),
    )


def elongation_and_damping(e: Evidence) -> Finding:
    """HHT and BDF2 lengthen the period and damp at every step."""
    steps = np.logspace(-3, -0.5, 200)
    found = {s: amplification(s, steps) for s in (HHT(-0.1), BDF2())}
    ten = {s: amplification(s, 0.1) for s in found}
    written = "; ".join(
        f"{s} {100 * float(x.period_elongation[0]):.2g} % and {100 * float(x.damping_ratio[0]):.2g} %"
        for s, x in ten.items()
    )
    longer = all(np.all(x.period_elongation > 0.0) and np.all(x.damping_ratio > 0.0) for x in found.values())
    return Finding(
        f"Period elongation and damping ratio at ten steps a period: {written}. Both fall like dt² and dt³: what "
        "they are at the paper's steps stands with Tables 2, 10 and 13.",
        plain_verdict(bool(longer)),
    )


def without_contact(e: Evidence) -> Finding:
    """The error without contact stays below a hundredth of the motion."""
    curves = error_curves(e.reading)
    schemes = [curve for curve in curves if curve.name not in GRIDS]
    worst = max(schemes, key=lambda curve: float(np.max(curve.in_time)))
    grid = {curve.name: float(np.max(curve.error)) for curve in curves if curve.name in GRIDS}
    most = max(float(np.max(c.error)) for c in schemes)
    return Finding(
        f"Largest error of a scheme {most:.1e}; of the grid alone, solved exactly in time, {grid[GRIDS[0]]:.1e} on "
        f"(3.5) and {grid[GRIDS[1]]:.1e} on (3.12). A scheme adds at most {np.max(worst.in_time):.1e} ({worst.name}).",
        plain_verdict(most < 0.01),
    )
