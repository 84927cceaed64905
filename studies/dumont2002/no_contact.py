"""Section 5.1: the beam without stops under a load whose exact solution is known, and its error curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from stiffbeam.basics.arrays import Array
from stiffbeam.figures.chart import new_figure
from stiffbeam.march.integrate import integrate
from stiffbeam.model.beam import roots
from stiffbeam.model.problem import BeamProblem, DistributedLoad
from stiffbeam.model.semidiscretisation import semidiscretise
from stiffbeam.model.time_functions import Harmonic
from stiffbeam.references import reference
from stiffbeam.schemes.labels import parse_run

from .figures import EXACT, STYLE
from .table import Reading, equation_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STIFFNESS, CELLS, DT = 8000.0, 25, 1e-3  # the paper's k^2, 1/h and dt
T_END = 6.0  # not stated; about two periods of the load, 300 of the beam's first mode
RUNS = (
    "BDF2@velocity-curvature", "BDF2@displacement", "HHT(alpha=-0.1)@displacement",
    "SDIRK(gamma=0.4359)@velocity-curvature",
    "SDIRK(gamma=0.4359, nystrom=True)@displacement",
)  # fmt: skip
WINDOW = 0.1  # the largest error within this time is drawn: it crosses zero with every oscillation
GRIDS = ("(3.5) exact in time", "(3.12) exact in time")


def mode(root: float, x: ArrayLike) -> Array:
    """X(x) = r (cosh lx - cos lx) + sin lx - sinh lx, r = (sin l + sinh l)/(cos l + cosh l).

    x is a share of the length. Written over e^{-lx} and e^{-l(1-x)}: the difference of cosh and sinh
    cancels for large l.
    """
    x = np.asarray(x, float)
    c, s, small = np.cos(root), np.sin(root), np.exp(-root)
    below = c + 0.5 * (np.exp(root) + small)
    r = (s + 0.5 * (np.exp(root) - small)) / below
    # sinh l - cosh l = -e^-l by hand: in float64 the difference of the two would lose it.
    growing = 0.5 * (s - c - small) / below  # (r - 1)/2, of size e^{-l}
    return growing * np.exp(root * x) + 0.5 * (r + 1.0) * np.exp(-root * x) - r * np.cos(root * x) + np.sin(root * x)


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """error (k,): |u - X_1(1) sin 2t| at the tip over X_1(1), at the times t (k,).

    name: the paper's equation, or a discretisation in space solved exactly in time. in_time (k,): the
    part of the error that is the scheme's, against its own discretisation solved exactly.
    """

    name: str
    label: str
    form: str
    t: Array
    error: Array
    in_time: Array


def problem() -> BeamProblem:
    """u_tt + k^2 u_xxxx = (k^2 l^4 - 4) X_1(x) sin 2t, u0 = 0, v0 = 2 X_1: exact u = X_1(x) sin 2t."""
    root = float(roots(1)[0])
    return BeamProblem(
        stiffness=STIFFNESS,
        loads=(DistributedLoad(lambda x: (STIFFNESS * root**4 - 4.0) * mode(root, x), Harmonic(1.0, 2.0)),),
        initial_velocity=lambda x: 2.0 * mode(root, x),
    )


def tip_exact(t: Array) -> Array:
    """X_1(1) sin 2t."""
    return float(mode(float(roots(1)[0]), 1.0)) * np.sin(2.0 * t)


def error_curves(reading: Reading, dt: float = DT, t_end: float = T_END, cells: int = CELLS) -> list[ErrorCurve]:
    """The error against time of every scheme, and of both discretisations solved exactly in time."""
    found = []
    size = abs(float(tip_exact(np.array(np.pi / 4.0))))
    t = np.arange(round(t_end / dt) + 1) * dt
    systems = {form: semidiscretise(problem(), cells, form) for form in ("displacement", "velocity-curvature")}
    exact = {form: reference(system, t_end, t_eval=t) for form, system in systems.items()}
    for name, (form, solution) in zip(GRIDS, exact.items(), strict=True):
        error = np.abs(solution.tip - tip_exact(t)) / size
        found.append(ErrorCurve(name, solution.label, form, t, error, np.zeros_like(t)))
    for text in RUNS:
        scheme, form = parse_run(text)
        run = integrate(systems[form], reading.scheme(scheme), dt, t_end)
        error, in_time = (np.abs(run.tip - u) / size for u in (tip_exact(t), exact[form].tip))
        found.append(ErrorCurve(equation_of(scheme, form), run.label, form, t, error, in_time))
    return found


def picture(curves: Sequence[ErrorCurve]) -> Figure:
    """|u - exact| at the tip against time; below, |u - the same discretisation solved exactly in time|."""
    figure = new_figure(7.0)
    axes = figure.subplots(2, 1, sharex=True)
    for curve in curves:
        colour, dashes = EXACT[curve.form] if curve.name in GRIDS else STYLE[curve.name]
        look = {"color": colour, "dashes": dashes or (None, None), "label": curve.name}
        look |= {"lw": 3.0, "alpha": 0.3} if curve.name in GRIDS else {"lw": 1.2}
        axes[0].plot(*_envelope(curve, curve.error), **look)
        if curve.name not in GRIDS:
            axes[1].plot(*_envelope(curve, curve.in_time), **look)
    axes[0].set(yscale="log", ylabel="error at the tip over $X_1(1)$", xlim=(0.0, curves[0].t[-1]))
    axes[1].set(yscale="log", ylabel="part of the scheme", xlabel="time $t$")
    axes[0].legend(frameon=False, fontsize=8, ncols=4)
    return figure


def _envelope(curve: ErrorCurve, error: Array) -> tuple[Array, Array]:
    """The largest error of every window."""
    steps = max(1, round(WINDOW / float(curve.t[1] - curve.t[0])))
    blocks = len(error) // steps
    largest = np.max(error[: blocks * steps].reshape(blocks, steps), axis=1)
    return curve.t[: blocks * steps : steps] + 0.5 * WINDOW, largest
