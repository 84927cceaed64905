"""The paper's misprints: place, printed and correct formula, and the measured effect."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from scipy.integrate import quad

import stiffbeam as sb
from stiffbeam.measures.errors import Order
from stiffbeam.schemes import PrintedSigma, PrintedStageMatrix, UnweightedHHT
from stiffbeam.studies.converge import orders

from .no_contact import mode
from .table import drive_of, roots


def forced_order(scheme: sb.Scheme) -> Order:
    """The observed order on two forced oscillators, at steps small against every period."""
    system = sb.System.from_matrices(
        np.eye(2), [[3.0, -1.0], [-1.0, 2.0]], loads=[([1.0, 0.5], sb.Harmonic(1.0, 1.3, 0.4))], observe=[0.0, 1.0]
    )
    records = sb.study("converge", system, dt=0.01, t_end=4.0, integrators=[scheme], kinds=["smooth"], halvings=5)
    (order,) = orders(records.table).values()
    return order


def _orders(printed: sb.Scheme, right: sb.Scheme) -> str:
    return f"order {forced_order(printed)} instead of {forced_order(right)}"


def _unweighted() -> str:
    return _orders(UnweightedHHT(-0.1), sb.HHT(-0.1))


def _sigma() -> str:
    scheme = sb.SDIRK()
    node, right = scheme.gamma - scheme.sigma, (1 + scheme.gamma) / 2
    return f"{_orders(PrintedSigma(), scheme)}; the second node is {node:.4f}, not (1 + γ)/2 = {right:.4f}"


def _stage_matrix() -> str:
    found = sb.amplification(PrintedStageMatrix(), np.linspace(0.005, 0.5, 200))
    worst = int(np.argmax(found.spectral_radius))
    growth = f"at dt/T = {found.dt_over_period[worst]:.2f} by {found.spectral_radius[worst]:.2f} a step"
    return f"{_orders(PrintedStageMatrix(), sb.SDIRK(nystrom=True))}; a free oscillation grows, {growth}"


def _update() -> str:
    scheme = sb.SDIRK(nystrom=True)
    weights, nodes = scheme.b @ scheme.A, np.array(scheme.nodes)
    printed = np.array([weights[0], weights[1] + weights[2], 0.0])
    return f"sum B_j c_j = {printed @ nodes:.4f} instead of 1/6 = {weights @ nodes:.4f}: the displacement is of order 2"


def _real_roots(*coefficients: float) -> list[float]:
    """In increasing order; the polynomial begins with its highest power."""
    return sorted(x.real for x in np.roots(coefficients) if abs(x.imag) < 1e-9)


def _gamma() -> str:
    (printed,), right = _real_roots(-1.0, 3.0, -2.0 / 3.0, 1.0 / 6.0), _real_roots(-1.0, 3.0, -1.5, 1.0 / 6.0)
    return f"the printed one has the real root {printed:.4f} only; the right one {right[1]:.6f}, the paper's 0.4359"


def _interval() -> str:
    printed = ", ".join(f"{x:.4f}" for x in _real_roots(-6.0, 18.0, -9.0, 1.0))
    right = ", ".join(f"{x:.5f}" for x in _real_roots(24.0, -72.0, 48.0, -12.0, 1.0))
    return f"the printed one has the roots {printed}; the right one {right}"


def _frequencies() -> str:
    first, second = roots(2) ** 2
    off = f"{100 * (3.5148 / first - 1):.2f} % and {100 * (22.3480 / second - 1):.1f} %"
    return f"w0 = {first:.4f} k, w1 = {second:.4f} k; printed, they are off by {off}"


def _normalisation() -> str:
    square = quad(lambda x: float(mode(x)) ** 2, 0.0, 1.0)[0]
    return f"int X_1^2 = {square:.4f}: the first coefficient would come out {1 / square:.3f} times the right one"


def _delta() -> str:
    case, load = sb.paper_case(15), drive_of(sb.paper_case(15))
    peaks = []
    for amplitude in (load.amplitude / case.cells, load.amplitude):
        forces = (replace(case.beam.loads[0], time=replace(load, amplitude=amplitude)),)
        free = replace(case, problem=replace(case.beam, loads=forces, stops=None))
        peaks.append(float(np.max(np.abs(sb.reference(free.system(), case.t_end).tip))))
    return (
        f"without stops the tip of Table 15 would reach {peaks[0]:.2e} with 1 on the nodes and {peaks[1]:.2e} with "
        f"the Dirac load; the stop is at {case.beam.all_stops[0].law.g2:g}"
    )


def _impacts() -> str:
    case = sb.paper_case(10)
    run = sb.integrate(case.system(), case.runs[0][0], case.dt, case.t_end)
    free = int(np.sum(case.beam.all_stops[0].state(run.tip[:-1]) == 0))
    return f"Table 10, HHT: read as printed there are {free} impacts, with contact at the new step {run.impacts.count}"


def _mass_for_stiffness() -> str:
    """(4.12) as printed on one mode: with K = i w its matrix is M = 1 - (2 dt/3) i w, near 1, not i w."""
    case, scheme = sb.paper_case(8), sb.SDIRK(1.0)
    first = roots(1)[0] ** 2 * np.sqrt(case.beam.stiffness)
    turn = []
    for rate in (1j * first, 1.0 - 2.0 * case.dt / 3.0 * 1j * first):
        z = rate * case.dt
        root = 1.0 + z * scheme.b @ np.linalg.solve(np.eye(3) - z * scheme.A, np.ones(3))
        turn.append(float(np.angle(root)))
    return (
        f"Table 8, mode 1 would turn by {turn[1]:.1e} rad a step instead of {turn[0]:.1e} (exact "
        f"{first * case.dt:.1e}): it would not vibrate"
    )


def _spurious_factor() -> str:
    """(4.11) with B = I - (2 dt/3) K_d, the matrix of (4.5), in M_d = I - (2 dt/3) B K_d, on modes of Table 1.

    Of y' = z y/dt: (1 - s z + s^2 z^2) r^2 = 4/3 r - 1/3 with s = 2/3.
    """
    case, s = sb.paper_case(1), 2.0 / 3.0
    first, second = 1j * roots(2) ** 2 * np.sqrt(case.beam.stiffness) * case.dt

    def root(z: complex) -> complex:
        return max(np.roots([1.0 - s * z + (s * z) ** 2, -4.0 / 3.0, 1.0 / 3.0]), key=abs)

    whole, half = (abs(root(z) - np.exp(z)) for z in (first, first / 2.0))
    return (
        f"M_d = I − (2dt/3)K_d + (2dt/3)²K_d²: of order {np.log2(whole / half) - 1.0:.2f} instead of 2, and "
        f"mode 2 of Table 1 would grow by {abs(root(second)):.4f} a step"
    )


def _time_step() -> str:
    case, outcomes = sb.paper_case(11), list[str]()
    for dt in (2.5e-4, 2.5e-5):
        try:
            run = sb.integrate(case.system(), sb.HHT(-0.1), dt, case.t_end, "extrapolated")
            outcomes.append(f"{dt:g} gives {run.impacts.count} impacts")
        except sb.Diverged as error:
            outcomes.append(f"{dt:g} overflows at t = {error.t:.2g}")
    return f"with extrapolated contact dt = {' and '.join(outcomes)}"


def _bdf3() -> str:
    # 11/6 y - 3 y_n + 3/2 y_n-1 - 1/3 y_n-2 = z y on z = i y.
    y = np.linspace(0.01, 3.0, 600)
    radii = [float(np.max(np.abs(np.roots([11.0 / 6.0 - 1j * x, -3.0, 1.5, -1.0 / 3.0])))) for x in y]
    worst = int(np.argmax(radii))
    return f"BDF3 grows on the imaginary axis, by {radii[worst]:.3f} a step at |z| = {y[worst]:.2f}"


# Place, printed, right, and a function that measures the effect or words where nothing computed depends on it.
MISPRINTS: list[tuple[str, str, str, Callable[[], str] | str]] = [
    ("(3.3)", "−f(x_M, t)", "+f(x_M, t)", "none: f = 0 at the tip in every table, and (3.5) has +"),
    ("(3.8)", "v_xx(1, t) = 0", "2 φ(t)", "none: (3.10) uses the right one"),
    ("below (3.7), (4.6)", "v_xx(x, 0) = u0″; v_xx,M vanishes", "u0″ + 2 φ(0); 2 φ",
     "none here, since φ(0) = 0; else a pre-stress that stays"),
    ("(4.9), σ of SDIRK", "(γ³ − 3γ² + 2γ − 1/3)/(γ² − 2γ + 1/2)", "minus that", _sigma),
    ("Section 4.1.2, third order", "root of 1/6 − (2/3)γ + 3γ² − γ³", "1/6 − (3/2)γ + 3γ² − γ³", _gamma),
    ("p. 58, L-stability", "roots of −6γ³ + 18γ² − 9γ + 1", "24γ⁴ − 72γ³ + 48γ² − 12γ + 1, as on p. 61", _interval),
    ("(4.10), (4.12), (4.14)", "right sides without M Vⁿ, K Yⁿ, k²H(y + c dt y′)", "with them",
     "does not run: what is known of the displacement would exert no force"),
    ("(4.11), M_d", "I − (2dt/3) B K_d", "I − (2dt/3) K_d", _spurious_factor),
    ("(4.12)", "M_d in the stage matrix", "K_d", _mass_for_stiffness),
    ("(4.13)", "F + G of the new time, unweighted", "(1 + α)(·) of the new − α(·) of the old", _unweighted),
    ("(4.14), stage matrix", "−σ dt², −b₁(γ dt)², −b₂(γ dt)²", "entries of A A", _stage_matrix),
    ("(4.14), update", "B₃K₂", "B₃K₃", _update),
    ("Remark 5, Vⁿ, grid", "R^2N; M equations; i = 1..M−1", "R^2M; 2M and v_M; 0..M", "none: a count"),
    ("Remark 6", "high order “up to three”", "three and above", _bdf3),
    ("Section 4.1.2", "only one three-stage method", "a family of two parameters, as it says next", "none: wording"),
    ("Section 5", "k = √300 a large, √8000 a small Young modulus", "the other way round", "none: wording"),
    ("Section 5.1, T_i", "1/(∫X²)²", "1/∫X²", _normalisation),
    ("Section 5.2", "w0 = 3.5148 k, w1 = 22.3480 k", "3.5160 k, 22.0345 k", _frequencies),
    ("Section 5.4", "σ = 0.4359", "γ = 0.4359", "none: the table has γ"),
    ("Section 5.4, impact", "not in contact at tⁿ", "and in contact at tⁿ⁺¹", _impacts),
    ("Table 11", "dt = 25 × 10⁻⁵", "2.5 × 10⁻⁵, read so", _time_step),
    ("Tables 15, 16", "δ = 1 at x_d", "Dirac: E/h spread on the nodes beside x_d", _delta),
    ("Fig. 17b", "(u(1, t + T), u_t(1, t + T)) as delayed", "(u(1, t), u(1, t + T))",
     "the printed one is the plain phase portrait, both are shown"),
]  # fmt: skip


def measured() -> Iterator[dict[str, str]]:
    """Every misprint with its effect."""
    for where, printed, right, effect in MISPRINTS:
        words = effect if isinstance(effect, str) else effect()
        yield {"where": where, "printed": printed, "right": right, "effect": words}
