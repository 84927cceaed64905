"""The paper's misprints: place, printed and correct formula, and the measured effect."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.integrate

from stiffbeam.files.cases import paper_case
from stiffbeam.march.integrate import integrate
from stiffbeam.measures.amplification import amplification
from stiffbeam.measures.errors import Order, observed_order
from stiffbeam.model.beam import natural_frequencies, roots
from stiffbeam.model.problem import PointLoad
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.model.system import System
from stiffbeam.model.time_functions import Harmonic
from stiffbeam.references import reference
from stiffbeam.schemes import HHT, SDIRK, PrintedSigma, PrintedStageMatrix, Scheme, UnweightedHHT

from .no_contact import mode


@dataclass(frozen=True)
class Misprint:
    """effect: a function that measures it, or words where nothing computed depends on it."""

    where: str
    printed: str
    right: str
    effect: Callable[[], str] | str


def forced_order(scheme: Scheme) -> Order:
    """The observed order on two smooth forced oscillators, at steps small against every period."""
    system = System.from_matrices(
        np.eye(2),
        np.array([[3.0, -1.0], [-1.0, 2.0]]),
        loads=[(np.array([1.0, 0.5]), Harmonic(1.0, 1.3, 0.4))],
        observe=[0.0, 1.0],
        initial_displacement=[0.3, -0.2],
        initial_velocity=[0.0, 0.4],
    )
    end, steps = 4.0, (80, 160, 320, 640, 1280)
    exact = reference(system, end)
    errors = []
    for n in steps:
        run = integrate(system, scheme, end / n, end)
        errors.append(float(np.sqrt(np.mean((run.tip - exact.at(run.t)[0]) ** 2))))
    return observed_order([end / n for n in steps], errors)


def _unweighted() -> str:
    return f"order {forced_order(UnweightedHHT(-0.1))} instead of {forced_order(HHT(-0.1))}"


def _sigma() -> str:
    scheme = SDIRK()
    g = scheme.gamma
    return (
        f"order {forced_order(PrintedSigma())} instead of {forced_order(scheme)}; the second node is "
        f"{g - scheme.sigma:.4f}, not (1 + γ)/2 = {(1 + g) / 2:.4f}"
    )


def _stage_matrix() -> str:
    scheme = PrintedStageMatrix()
    grid = np.linspace(0.005, 0.5, 200)
    radius = amplification(scheme, grid).spectral_radius
    worst = int(np.argmax(radius))
    return (
        f"order {forced_order(scheme)} instead of {forced_order(SDIRK(nystrom=True))}; a free oscillation grows, at "
        f"dt/T = {grid[worst]:.2f} by {radius[worst]:.2f} a step"
    )


def _update() -> str:
    scheme = SDIRK(nystrom=True)
    weights, nodes = scheme.b @ scheme.A, np.array(scheme.nodes)
    printed = np.array([weights[0], weights[1] + weights[2], 0.0])
    return f"sum B_j c_j = {printed @ nodes:.4f} instead of 1/6 = {weights @ nodes:.4f}: the displacement is of order 2"


def _gamma() -> str:
    printed = [r.real for r in np.roots([-1.0, 3.0, -2.0 / 3.0, 1.0 / 6.0]) if abs(r.imag) < 1e-12]
    right = sorted(r.real for r in np.roots([-1.0, 3.0, -1.5, 1.0 / 6.0]))
    return f"the printed one has the real root {printed[0]:.4f} only; the right one {right[1]:.6f}, the paper's 0.4359"


def _interval() -> str:
    printed = sorted(r.real for r in np.roots([-6.0, 18.0, -9.0, 1.0]))
    right = sorted(r.real for r in np.roots([24.0, -72.0, 48.0, -12.0, 1.0]) if abs(r.imag) < 1e-9)
    return (
        f"the printed one has the roots {', '.join(f'{x:.4f}' for x in printed)}; the right one "
        f"{', '.join(f'{x:.5f}' for x in right)}"
    )


def _frequencies() -> str:
    first, second = roots(2) ** 2
    return (
        f"w0 = {first:.4f} k, w1 = {second:.4f} k; printed, they are off by {100 * (3.5148 / first - 1):.2f} % and "
        f"{100 * (22.3480 / second - 1):.1f} %"
    )


def _normalisation() -> str:
    square = scipy.integrate.quad(lambda x: float(mode(float(roots(1)[0]), x)) ** 2, 0.0, 1.0)[0]
    return f"int X_1^2 = {square:.4f}: the first coefficient would come out {1 / square:.3f} times the right one"


def _delta() -> str:
    case = paper_case(15)
    load = case.beam.loads[0]
    assert isinstance(load, PointLoad)
    assert isinstance(load.time, Harmonic)
    weak = replace(load, time=replace(load.time, amplitude=load.time.amplitude / case.cells))
    peaks = []
    for loads in ((weak,), (load,)):
        problem = replace(case.beam, loads=loads, stops=None)
        tip = reference(semidiscretise(problem, case.cells), case.t_end).tip
        peaks.append(float(np.max(np.abs(tip))))
    stop = case.beam.all_stops[0]
    return (
        f"without stops the tip of Table 15 would reach {peaks[0]:.2e} with 1 on the nodes and {peaks[1]:.2e} with "
        f"the Dirac load; the stop is at {stop.upper_bound:g}"
    )


def _impacts() -> str:
    case = paper_case(10)
    scheme, form = case.runs[0]
    run = integrate(semidiscretise(case.beam, case.cells, form), scheme, case.dt, case.t_end)
    stops = case.beam.all_stops[0]
    free = int(np.sum(stops.state(run.tip[:-1]) == 0))
    return f"Table 10, HHT: read as printed there are {free} impacts, with contact at the new step {run.impacts.count}"


def _mass_for_stiffness() -> str:
    """(4.12) as printed on one mode: with K = i w its matrix is M = 1 - (2 dt/3) i w, near 1, not i w."""
    case, scheme = paper_case(8), SDIRK(1.0)
    first, _ = natural_frequencies(case.beam, 2)
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
    """(4.11) with B = I - (2 dt/3) K_d, the matrix of (4.5), in M_d = I - (2 dt/3) B K_d, on modes of Table 1."""
    case = paper_case(1)
    first, second = natural_frequencies(case.beam, 2)
    order, growth = [], 0.0
    for step in (case.dt, case.dt / 2.0):
        z = 1j * first * step
        root = _bdf2_root(z)
        order.append(abs(root - np.exp(z)))
        if step == case.dt:
            growth = abs(_bdf2_root(1j * second * step))
    return (
        f"M_d = I − (2dt/3)K_d + (2dt/3)²K_d²: of order {np.log2(order[0] / order[1]) - 1.0:.2f} instead of 2, and "
        f"mode 2 of Table 1 would grow by {growth:.4f} a step"
    )


def _bdf2_root(z: complex) -> complex:
    """The principal root of (4.11) as printed, y' = z y/dt: (1 - s z + s^2 z^2) r^2 = 4/3 r - 1/3 with s = 2/3."""
    s = 2.0 / 3.0
    roots_ = np.roots([1.0 - s * z + (s * z) ** 2, -4.0 / 3.0, 1.0 / 3.0])
    return complex(roots_[np.argmax(np.abs(roots_))])


def _time_step() -> str:
    case = paper_case(11)
    system = semidiscretise(case.beam, case.cells)
    from stiffbeam.trajectory.trajectory import Diverged

    outcomes = []
    for dt in (2.5e-4, 2.5e-5):
        try:
            run = integrate(system, HHT(-0.1), dt, case.t_end, "extrapolated")
            outcomes.append(f"{dt:g} gives {run.impacts.count} impacts")
        except Diverged as error:
            outcomes.append(f"{dt:g} overflows at t = {error.t:.2g}")
    return f"with extrapolated contact dt = {' and '.join(outcomes)}"


def _bdf3() -> str:
    # 11/6 y - 3 y_n + 3/2 y_n-1 - 1/3 y_n-2 = z y on z = i y.
    y = np.linspace(0.01, 3.0, 600)
    radii = [float(np.max(np.abs(np.roots([11.0 / 6.0 - 1j * x, -3.0, 1.5, -1.0 / 3.0])))) for x in y]
    worst = int(np.argmax(radii))
    return f"BDF3 grows on the imaginary axis, by {radii[worst]:.3f} a step at |z| = {y[worst]:.2f}"


MISPRINTS = [
    Misprint("(3.3)", "−f(x_M, t)", "+f(x_M, t)", "none: f = 0 at the tip in every table, and (3.5) has +"),
    Misprint("(3.8)", "v_xx(1, t) = 0", "2 φ(t)", "none: (3.10) uses the right one"),
    Misprint(
        "below (3.7), (4.6)", "v_xx(x, 0) = u0″; v_xx,M vanishes", "u0″ + 2 φ(0); 2 φ",
        "none here, since φ(0) = 0; else a pre-stress that stays",
    ),
    Misprint(
        "(4.9), σ of SDIRK", "(γ³ − 3γ² + 2γ − 1/3)/(γ² − 2γ + 1/2)", "minus that", _sigma,
    ),
    Misprint("Section 4.1.2, third order", "root of 1/6 − (2/3)γ + 3γ² − γ³", "1/6 − (3/2)γ + 3γ² − γ³", _gamma),
    Misprint("p. 58, L-stability", "roots of −6γ³ + 18γ² − 9γ + 1", "24γ⁴ − 72γ³ + 48γ² − 12γ + 1, as on p. "
    "61", _interval),
    Misprint(
        "(4.10), (4.12), (4.14)", "right sides without M Vⁿ, K Yⁿ, k²H(y + c dt y′)", "with them",
        "does not run: what is known of the displacement would exert no force",
    ),
    Misprint("(4.11), M_d", "I − (2dt/3) B K_d", "I − (2dt/3) K_d", _spurious_factor),
    Misprint("(4.12)", "M_d in the stage matrix", "K_d", _mass_for_stiffness),
    Misprint("(4.13)", "F + G of the new time, unweighted", "(1 + α)(·) of the new − α(·) of the old", _unweighted),
    Misprint("(4.14), stage matrix", "−σ dt², −b₁(γ dt)², −b₂(γ dt)²", "entries of A A", _stage_matrix),
    Misprint("(4.14), update", "B₃K₂", "B₃K₃", _update),
    Misprint("Remark 5, Vⁿ, grid", "R^2N; M equations; i = 1..M−1", "R^2M; 2M and v_M; 0..M", "none: a count"),
    Misprint("Remark 6", "high order “up to three”", "three and above", _bdf3),
    Misprint("Section 4.1.2", "only one three-stage method", "a family of two parameters, as it says next", "none: "
    "wording"),
    Misprint("Section 5", "k = √300 a large, √8000 a small Young modulus", "the other way round", "none: wording"),
    Misprint("Section 5.1, T_i", "1/(∫X²)²", "1/∫X²", _normalisation),
    Misprint("Section 5.2", "w0 = 3.5148 k, w1 = 22.3480 k", "3.5160 k, 22.0345 k", _frequencies),
    Misprint("Section 5.4", "σ = 0.4359", "γ = 0.4359", "none: the table has γ"),
    Misprint("Section 5.4, impact", "not in contact at tⁿ", "and in contact at tⁿ⁺¹", _impacts),
    Misprint("Table 11", "dt = 25 × 10⁻⁵", "2.5 × 10⁻⁵, read so", _time_step),
    Misprint("Tables 15, 16", "δ = 1 at x_d", "Dirac: E/h spread on the nodes beside x_d", _delta),
    Misprint(
        "Fig. 17b", "(u(1, t + T), u_t(1, t + T)) as delayed", "(u(1, t), u(1, t + T))",
        "the printed one is the plain phase portrait, both are shown",
    ),
]  # fmt: skip


def measured() -> Iterator[dict[str, str]]:
    """Every misprint with its effect."""
    for entry in MISPRINTS:
        effect = entry.effect if isinstance(entry.effect, str) else entry.effect()
        yield {"where": entry.where, "printed": entry.printed, "right": entry.right, "effect": effect}
