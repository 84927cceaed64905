"""Phase lag and dissipation mode by mode, measured on runs without contact and compared with the theory of one step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from ..basics.arrays import Array
from ..basics.text import several
from ..figures.chart import Figure, log_scale, look, shared_legend, short, signed_log
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.amplification import amplification, free_mode_errors
from ..measures.frequencies import without_contact
from ..measures.report import DASH, extremes, number, percent
from ..model.modes import modes, undamped_modes
from . import base
from .base import Answer, Row, Study, Table, option

ROUNDING = 1e-12
STEPS = np.linspace(0.005, 1.0, 200)  # dt/T at which stability is tested
QUANTITIES = (  # with the size below which the axis is linear
    ("period_elongation", "relative period elongation", 1e-11),
    ("damping_ratio", "damping ratio", 1e-10),
)


@dataclass(frozen=True, kw_only=True)
class Modes(Study):
    """How late and how damped is each mode of a run without contact, and does the theory of one step predict that?

    Each scheme runs ``steps`` time steps from initial data that excite every mode equally. Modes with fewer than two
    steps per period are left out, because their samples are aliased. Theory: one step on a damped oscillator.
    """

    schemes: base.Labels = option(*base.SCHEME_LABELS)
    form: str | None = option(*base.FORM)
    steps: int = option(4000, "number of time steps of a run", least=1)

    free: ClassVar = True
    height: ClassVar = 8.6
    labels: ClassVar = {"dt_over_period": (r"$\Delta t/T$ of the mode", "")}

    def points(self, case: Case) -> list[Row]:
        """A run of every scheme."""
        return [{"scheme": label} for label in base.chosen_schemes(case, self.schemes)]

    def run(self, case: Case, scheme: str) -> list[Row]:
        """One row for each mode: elongation and damping, measured and in theory."""
        made = base.chosen_schemes(case, self.schemes)[scheme]
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
            for name, *_ in QUANTITIES:
                row |= {name: float(getattr(errors, name)[j]), f"{name}_theory": float(getattr(theory, name)[0])}
            rows.append(row)
        return rows

    def answer(self, table: Table, case: Case) -> Answer:
        """Lag and damping of the first mode of each scheme, and the largest distance of all modes from theory."""
        measured = table[table.period_elongation.notna()] if "period_elongation" in table else table[:0]
        if not len(measured):
            return Answer(
                f"0 of {len(table)} modes are measured: each dies too soon, or is followed for less than half a "
                "period. Take more steps."
            )
        first = measured.groupby("scheme", sort=False).first()
        late, damped = (_known(first, name) for name, *_ in QUANTITIES)
        small = pd.DataFrame({
            f"mode {first['mode'].iloc[0]:g}": first.index, "late": late.map(percent).to_numpy(),
            "damping ratio": damped.map(number).to_numpy(),
        })  # fmt: skip
        off = [float(np.nanmax(_distances(measured, name))) for name, *_ in QUANTITIES]
        notes, left = list[str](), len(table) - len(measured)
        if late.isna().any() or damped.isna().any():
            notes.append(f"{DASH}: less than the run differs from theory.")
        if left:
            notes.append(f"Not measured: {several(left, 'mode')}, damped out or followed for less than half a period.")
        for label, scheme in base.chosen_schemes(case, self.schemes).items():
            limit = amplification(scheme, STEPS).stable_to
            if np.isfinite(limit):
                limit = max(limit, amplification(scheme, limit + STEPS[0] * np.linspace(0.01, 1.0, 100)).stable_to)
                notes.append(f"{short(label)} is stable to dt/T = {limit:.4f}.")
        return Answer(
            f"Mode {measured['mode'].iloc[0]:g} is late by {extremes(late.to_dict(), percent)}, "
            f"with a damping ratio of {extremes(damped.to_dict(), number)}. In all modes runs "
            f"differ from theory by at most {off[0]:.1g} in the period and {off[1]:.1g} in the damping ratio.",
            small,
            " ".join(notes),
        )

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """Lines are theory, markers runs; below their distance."""
        across, axes = table.attrs["labels"]["dt_over_period"], figure.subplots(2, 2, height_ratios=(1.6, 1.0))
        for upper, lower, (name, words, threshold) in zip(*axes, QUANTITIES, strict=True):
            by_scheme = table.sort_values("dt_over_period").groupby("scheme", sort=False)
            for k, (label, group) in enumerate(by_scheme):
                # Hollow and of growing size: markers at one point do not hide each other.
                style: Any = look(str(label)) | {"ms": 3.5 + 1.2 * k, "mfc": "none"}
                upper.plot(group.dt_over_period, group[f"{name}_theory"], **style | {"marker": "", "lw": 1.1})
                upper.plot(group.dt_over_period, group[name], label=short(str(label)), **style | {"linestyle": ""})
                lower.plot(group.dt_over_period, _distances(group, name), **style | {"linestyle": ""})
            log_scale(upper, y=False)
            signed_log(upper, threshold)
            upper.set(title=f"{words}: markers runs, lines theory", xlabel=across, ylabel=words)
            log_scale(lower)
            lower.set(title=f"{words}: distance of runs from theory", xlabel=across, ylabel="|run - theory|")
        shared_legend(figure, axes=list(axes[0]))


def _known(rows: Table, name: str) -> Any:
    """The measured values with the digits that theory confirms, 0 for rounding, NaN where it confirms none."""
    values = rows[name].where(rows[name].abs() > ROUNDING, 0.0)
    digits = np.log10(values.abs().clip(lower=ROUNDING) / _distances(rows, name)).clip(upper=15.0)
    rounded = [float(f"{x:.{max(1, int(n))}g}") for x, n in zip(values, digits, strict=True)]
    return pd.Series(rounded, values.index).where((values == 0.0) | (digits > 0.0))


def _distances(table: Table, name: str) -> Array:
    """|measured - theory| of every row, a value of rounding where they are equal."""
    return np.maximum(np.abs(table[name] - table[f"{name}_theory"]).to_numpy(float), np.finfo(float).eps)
