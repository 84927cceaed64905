"""Section 5.1: the beam without stops under a load whose exact solution is known, and its error curves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import stiffbeam as sb
from stiffbeam.basics.arrays import Array
from stiffbeam.figures.chart import Figure, new_figure
from stiffbeam.schemes.labels import parse_run

from .figures import style
from .table import Reading, equation_of, roots

STIFFNESS, CELLS, DT = 8000.0, 25, 1e-3  # the paper's k^2, 1/h and dt
T_END = 6.0  # not stated; about two periods of the load, 300 of the beam's first mode
RUNS = (
    "BDF2@velocity-curvature", "BDF2@displacement", "HHT(alpha=-0.1)@displacement",
    "SDIRK(gamma=0.4359)@velocity-curvature",
    "SDIRK(gamma=0.4359, nystrom=True)@displacement",
)  # fmt: skip
WINDOW = 100  # steps: the largest error within them is drawn, since it crosses zero with every oscillation
GRIDS = {"(3.5) exact in time": "displacement", "(3.12) exact in time": "velocity-curvature"}


def mode(x: ArrayLike) -> Array:
    """X_1(x) = r (cosh lx - cos lx) + sin lx - sinh lx, r = (sin l + sinh l)/(cos l + cosh l), l = l_1."""
    root = float(roots(1)[0])
    lx, r = root * np.asarray(x, float), (np.sin(root) + np.sinh(root)) / (np.cos(root) + np.cosh(root))
    return r * (np.cosh(lx) - np.cos(lx)) + np.sin(lx) - np.sinh(lx)


def problem() -> sb.BeamProblem:
    """u_tt + k^2 u_xxxx = (k^2 l^4 - 4) X_1(x) sin 2t, u0 = 0, v0 = 2 X_1: exact u = X_1(x) sin 2t."""
    root = float(roots(1)[0])
    return sb.BeamProblem(
        stiffness=STIFFNESS,
        loads=(sb.DistributedLoad(lambda x: (STIFFNESS * root**4 - 4.0) * mode(x), sb.Harmonic(1.0, 2.0)),),
        initial_velocity=lambda x: 2.0 * mode(x),
    )


def tip_exact(t: ArrayLike) -> Array:
    """X_1(1) sin 2t."""
    return mode(1.0) * np.sin(2.0 * np.asarray(t))


def error_curves(reading: Reading, t_end: float = T_END, cells: int = CELLS) -> dict[str, Array]:
    """Errors at the tip over X_1(1) at multiples of DT, by grid solved exactly in time and by the paper's equation.

    (2, k): |u - X_1(1) sin 2t|, and the part of it that is the scheme's, against its grid solved exactly in time.
    """
    t, size = np.arange(round(t_end / DT) + 1) * DT, abs(float(mode(1.0)))
    systems = {form: sb.semidiscretise(problem(), cells, form) for form in GRIDS.values()}
    exact = {form: sb.reference(system, t_end, t_eval=t).tip for form, system in systems.items()}
    tips = {name: (form, exact[form]) for name, form in GRIDS.items()}
    for text in RUNS:
        scheme, form = parse_run(text)
        tips[equation_of(scheme, form)] = form, sb.integrate(systems[form], reading.scheme(scheme), DT, t_end).tip
    return {name: np.abs(tip - [tip_exact(t), exact[form]]) / size for name, (form, tip) in tips.items()}


def picture(curves: dict[str, Array]) -> Figure:
    """|u - exact| at the tip against time; below, |u - the same discretisation solved exactly in time|."""
    figure = new_figure(7.0)
    above, below = figure.subplots(2, 1, sharex=True)
    for name, errors in curves.items():
        look = style(GRIDS.get(name, name)) | {"label": name, "lw": 1.2}
        if name in GRIDS:
            look |= {"lw": 3.0, "alpha": 0.3}
        for axis, error in zip((above, below), errors, strict=True):
            blocks = len(error) // WINDOW
            largest = np.max(error[: blocks * WINDOW].reshape(blocks, WINDOW), axis=1)
            if np.any(largest > 0.0):
                axis.plot((np.arange(blocks) + 0.5) * WINDOW * DT, largest, **look)
    above.set(yscale="log", ylabel="error at the tip over $X_1(1)$", xlim=(0.0, T_END))
    below.set(yscale="log", ylabel="part of the scheme", xlabel="time $t$")
    above.legend(frameon=False, fontsize=8, ncols=4)
    return figure
