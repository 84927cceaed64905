"""Phase lag and dissipation mode by mode, measured on runs without contact and compared with the theory of one step."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd

from ..basics.arrays import Array
from ..basics.text import several
from ..figures.chart import log_scale, look, shared_legend, short, signed_log
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.amplification import amplification, free_mode_errors
from ..measures.frequencies import without_contact
from ..model.modes import undamped_modes
from ..model.natural_modes import modes
from ..schemes import HHT, SDIRK, GeneralisedAlpha, Scheme
from ..schemes.sdirk import GAMMA_MIN
from . import common
from .base import Answer, Row, Study, Table, option

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TENTH, HALF = 0.1, 0.5  # of a period: where the literature compares; beyond it samples alias
QUANTITIES = (  # with the size below which the axis is linear
    ("period_elongation", "relative period elongation", 1e-11),
    ("damping_ratio", "damping ratio", 1e-10),
)
FAMILIES = (  # class, its parameter, symbol, and the gap across which no line is drawn, that of a pole
    ("HHT", "alpha", "HHT over α", r"$\alpha$", np.inf), ("SDIRK", "gamma", "SDIRK over γ", r"$\gamma$", 0.05),
    ("GeneralisedAlpha", "rho", "generalised-α over ρ", r"$\rho_\infty$", np.inf),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Modes(Study):
    """How late and how damped is each mode of a run without contact, and does the theory of one step predict that?

    Each scheme runs ``steps`` time steps from initial data that excite every mode equally. Modes with fewer than two
    steps per period are left out, because their samples are aliased. Theory: one step on a damped oscillator.
    """

    schemes: common.Labels = common.schemes()
    form: str | None = common.form()
    steps: int = option(4000, "number of time steps of a run", least=1)
    families: bool = option(False, "also one step at dt/T = 0.1 over the parameters of HHT, SDIRK, generalised-alpha")

    smoke: ClassVar = {"schemes": ["BDF2", "HHT(alpha=-0.1)"], "steps": 400, "families": True}
    free: ClassVar = True
    height: ClassVar = 8.6
    labels: ClassVar = {"dt_over_period": (r"$\Delta t/T$ of the mode", "")}

    def points(self, case: Case) -> list[Row]:
        """A run of every scheme, and where asked one step over the parameters of the families."""
        runs: list[Row] = [{"kind": "mode", "scheme": label} for label in common.chosen_schemes(case, self.schemes)]
        return runs + ([{"kind": "family", "scheme": str(x)} for x in _families()] if self.families else [])

    def run(self, case: Case, kind: str, scheme: str) -> list[Row]:
        """One row for each mode: elongation and damping, measured and in theory; or those at dt/T = 0.1."""
        if kind == "family":
            made = next(x for x in _families() if str(x) == scheme)
            errors = amplification(made, [TENTH], 0.0)
            named = {name: float(getattr(errors, name)[0]) for name, *_ in QUANTITIES}
            return [{"dt_over_period": TENTH} | made.parameters | named]
        made = common.chosen_schemes(case, self.schemes)[scheme]
        system = replace(without_contact(case.system(self.form)), loads=())
        basis, natural = undamped_modes(system), modes(system)
        if not np.any(natural.omega):
            return [{"lost": "no mode oscillates: without its stops the system has no stiffness"}]
        # Every mode starts with the same energy.
        amplitudes = np.where(basis.omega > 0.0, 1.0, 0.0) / np.where(basis.omega > 0.0, basis.omega, 1.0)
        system = replace(system, q0=basis.to_nodal(amplitudes), v0=np.zeros(system.size))
        errors = free_mode_errors(integrate(system, made, case.dt, self.steps * case.dt))
        rows: list[Row] = []
        for j, omega in enumerate(natural.omega):
            if omega == 0.0 or omega * case.dt >= np.pi:
                continue
            row: Row = {"mode": j + 1, "omega": float(omega)}
            xi, x = float(natural.damping_ratio[j]), float(omega * case.dt / (2.0 * np.pi))
            if xi >= 1.0:
                reason = "a mode with damping ratio 1 or more does not oscillate: it has no period to be late by"
                rows.append(row | {"lost": reason})
                continue
            theory = amplification(made, x, xi)
            row |= {"dt_over_period": x, "spectral_radius": float(theory.spectral_radius[0])}
            for name, error in (("period_elongation", "elongation_error"), ("damping_ratio", "damping_error")):
                row |= {
                    name: float(getattr(errors, name)[j]),
                    f"{name}_error": float(getattr(errors, error)[j]),
                    f"{name}_theory": float(getattr(theory, name)[0]),
                }
            rows.append(row)
        return rows

    def answer(self, table: Table, case: Case) -> Answer:
        """Lag and damping of the first mode of each scheme, and the largest distance of all modes from theory."""
        every = table[table.kind == "mode"]
        measured = every[every.period_elongation.notna()] if "period_elongation" in every else every[:0]
        if not len(measured):
            return Answer(
                f"0 of {len(every)} modes are measured: each dies too soon, or is followed for less than half a "
                "period. Take more steps."
            )
        first = measured.groupby("scheme", sort=False).first()

        def late(value: float) -> str:
            return f"{common.significant(100.0 * value, '.2g')} %"

        def damped(value: float) -> str:
            return common.significant(value, ".1e")

        small = pd.DataFrame({
            f"mode {first['mode'].iloc[0]:g}": first.index, "late": first.period_elongation.map(late).to_numpy(),
            "damping ratio": first.damping_ratio.map(damped).to_numpy(),
        })  # fmt: skip
        off = [float(np.nanmax(_distances(measured, name))) for name, *_ in QUANTITIES]
        left = len(every) - len(measured)
        return Answer(
            f"Mode {measured['mode'].iloc[0]:g} is late by {common.extremes(first.period_elongation.to_dict(), late)}, "
            f"with a damping ratio of {common.extremes(first.damping_ratio.to_dict(), damped)}. In all modes runs "
            f"differ from theory by at most {off[0]:.1g} in the period and {off[1]:.1g} in the damping ratio.",
            small,
            f"Not measured: {several(left, 'mode')}, damped out too soon or followed for less than half a period."
            if left
            else "",
        )

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """Lines are theory, markers runs; below their distance, or elongation and damping of the families."""
        families = table[table.kind == "family"]
        grid = figure.add_gridspec(2, 6, height_ratios=(1.6, 1.0))
        upper = [figure.add_subplot(grid[0, 3 * i : 3 * i + 3]) for i in range(2)]
        if len(families):
            for i, family in enumerate(FAMILIES):
                _family(figure.add_subplot(grid[1, 2 * i : 2 * i + 2]), families, *family)
        lower = list[Any]()
        if not len(families):
            lower = [figure.add_subplot(grid[1, 3 * i : 3 * i + 3]) for i in range(2)]
        rows = table[table.kind == "mode"]
        for i, (name, words, threshold) in enumerate(QUANTITIES if len(rows) else ()):
            for label, group in rows.sort_values("dt_over_period").groupby("scheme", sort=False):
                style: Any = look(str(label)) | {"ms": 4.0}
                upper[i].plot(group.dt_over_period, group[f"{name}_theory"], **style | {"marker": "", "lw": 1.1})
                upper[i].plot(group.dt_over_period, group[name], label=short(str(label)), **style | {"linestyle": ""})
                if not len(families):
                    lower[i].plot(group.dt_over_period, _distances(group, name), **style | {"linestyle": ""})
            log_scale(upper[i], y=False)
            signed_log(upper[i], [rows[name].to_numpy(float), rows[f"{name}_theory"].to_numpy(float)], threshold)
            across = table.attrs["labels"]["dt_over_period"]
            upper[i].set(title=f"{words}: markers runs, lines theory", xlabel=across, ylabel=words)
            if not len(families):
                log_scale(lower[i])
                lower[i].set(title="distance of runs from theory", xlabel=across, ylabel="|run - theory|")
        shared_legend(figure, axes=upper)


def _families() -> list[Scheme]:
    """HHT over alpha, SDIRK over gamma (its poles left out), generalised-alpha over rho."""
    gammas = [float(g) for g in np.round(np.arange(0.19, 1.01, 0.03), 2) if g > GAMMA_MIN and not 0.24 < g < 0.31]
    with warnings.catch_warnings(category=UserWarning, action="ignore"):  # of nodes beyond the step
        return [
            *(HHT(round(a, 4)) for a in np.linspace(-0.33, 0.0, 12)),
            *(SDIRK(gamma) for gamma in gammas),
            *(GeneralisedAlpha(round(r, 2)) for r in np.linspace(0.0, 1.0, 11)),
        ]


def _family(axis: Axes, table: Table, name: str, parameter: str, title: str, symbol: str, gap: float) -> None:
    """Elongation and damping at dt/T = 0.1 over the parameter of a scheme."""
    rows = table[table.scheme.str.startswith(f"{name}(")].sort_values(parameter)
    breaks = np.flatnonzero(np.diff(rows[parameter]) > gap) + 1
    x = np.insert(rows[parameter].to_numpy(float), breaks, np.nan)
    styles: list[dict[str, Any]] = [{"color": "black", "marker": "o"}, {"color": "0.5", "marker": "s", "ls": "--"}]
    for (column, *_), words, style in zip(QUANTITIES, ("period elongation", "damping ratio"), styles, strict=True):
        y = np.insert(100.0 * rows[column].to_numpy(float), breaks, np.nan)
        axis.plot(x, y, label=words, ms=3.6, lw=1.1, **style)
    axis.axhline(0.0, color="0.5", lw=0.9, ls=":")
    axis.set(title=rf"{title}, $\Delta t/T$ = 0.1", xlabel=symbol, ylabel="per cent")
    axis.legend(frameon=False, fontsize=8)


def _distances(table: Table, name: str) -> Array:
    """|measured - theory| of every row, a value of rounding where they are equal."""
    return np.maximum(np.abs(table[name] - table[f"{name}_theory"]).to_numpy(float), np.finfo(float).eps)
