"""One step on a free oscillation: spectral radius, period elongation, damping, for every scheme and parameter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np

from ..basics.validation import InputError
from ..figures import (
    column,
    default_label,
    log_scale,
    look,
    new_figure,
    numeric,
    say_empty,
    shared_legend,
    short,
    signed_log,
)
from ..files.cases import Case
from ..measures.amplification import amplification
from ..schemes import HHT, SCHEMES, SDIRK, GeneralisedAlpha, registered
from ..schemes.sdirk import GAMMA_MIN
from .common import Schemes, scheme_labels, scheme_of
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TENTH = 0.1  # of a period: where the literature compares


def families() -> list[str]:
    """HHT over alpha, SDIRK-OS over gamma (its poles left out), generalised-alpha over rho."""
    gammas = [g for g in np.round(np.arange(0.19, 1.01, 0.03), 2) if g > GAMMA_MIN and not 0.24 < g < 0.31]
    schemes = [
        *(HHT(round(a, 4)) for a in np.linspace(-0.33, 0.0, 12)),
        *(SDIRK(float(g)) for g in gammas),
        *(GeneralisedAlpha(round(r, 2)) for r in np.linspace(0.0, 1.0, 11)),
    ]
    return [str(scheme) for scheme in schemes]


def points(
    case: Case,
    schemes: Schemes = None,
    damping: Annotated[float, "physical damping ratio of the oscillator"] = 0.0,
    per_decade: Annotated[int, "values of dt/T a decade"] = 40,
) -> list[Point]:
    """One point a scheme, at dt/T from 1e-3 to 1e3 and at 0.1; by default every registered scheme and the families."""
    labels = families() + [str(s) for s in registered()] if schemes is None else scheme_labels(case, schemes)
    return [{"scheme": label, "damping": damping, "per_decade": per_decade} for label in dict.fromkeys(labels)]


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row for every dt/T: spectral radius, period elongation and damping ratio, measured and in closed form."""
    scheme, xi = scheme_of(point["scheme"]), point["damping"]
    x = np.union1d(np.logspace(-3, 3, 6 * point["per_decade"] + 1), [TENTH])
    found = amplification(scheme, x, xi)
    try:
        theory = amplification(scheme, x, xi, source="closed form")
    except InputError:
        theory = None  # the scheme states no polynomial
    rows = []
    for i, value in enumerate(x):
        row = {"name": scheme.name, **scheme.parameters, "dt_over_period": float(value), "stable_to": found.stable_to}
        for name in ("spectral_radius", "period_elongation", "damping_ratio"):
            row[name] = float(getattr(found, name)[i])
            row[f"{name}_theory"] = float(getattr(theory, name)[i]) if theory else float("nan")
        rows.append(row)
    return rows


def answer(rows: Rows, _: Case) -> str:
    """Elongation and damping of every scheme at dt/T = 0.1."""
    at = [r for r in rows if r["dt_over_period"] == TENTH]
    base = [r for r in at if r["scheme"] in {str(s) for s in registered()}] or at
    parts = [
        f"{r['scheme']} {100 * r['period_elongation']:.3g} % and {r['damping_ratio']:.2g}"
        for r in sorted(base, key=lambda r: abs(r["period_elongation"]))
    ]
    unstable = sorted({r["scheme"] for r in rows if r["stable_to"] is not None and np.isfinite(r["stable_to"])})
    gap = max(
        (abs(r["spectral_radius"] - r["spectral_radius_theory"]) for r in rows if _known(r["spectral_radius_theory"])),
        default=float("nan"),
    )
    stable = f"unstable somewhere: {', '.join(unstable)}" if unstable else "all are stable at every step"
    tail = (
        f"Of these and their families {stable}; "
        f"the kernel's spectral radius and the closed form differ by at most {gap:.1e}."
    )
    table = [
        {
            "dt/T = 0.1": r["scheme"],
            "period elongation": f"{100 * r['period_elongation']:.3g} %",
            "damping ratio": f"{r['damping_ratio']:.2g}",
        }
        for r in sorted(base, key=lambda r: abs(r["period_elongation"]))
    ]
    return Answer(f"Period elongation and damping ratio at dt/T = 0.1: {'; '.join(parts)}. {tail}", table, tail)


def _known(value: float | None) -> bool:
    return value is not None and np.isfinite(value)


TENTH = 0.1
FAMILIES = {"hht": ("alpha", "HHT over α"), "sdirk": ("gamma", "SDIRK-OS over γ"),
            "generalised-alpha": ("rho", "generalised-α over ρ")}  # fmt: skip
SYMBOLS = {"alpha": r"$\alpha$", "gamma": r"$\gamma$", "rho": r"$\rho_\infty$"}
HALF = 0.5  # of a period: beyond it the samples alias
NO_DAMPING = 1e-12
GAP = 0.05  # of a parameter: no line is drawn across a pole


def draw(records: Records) -> Figure:
    """Lines are the closed form, markers the kernel's own step; below, dt/T = 0.1 over the parameter."""
    rows = numeric(records.found)
    families = {name: _family(rows, name) for name in FAMILIES}
    families = {name: own for name, own in families.items() if len(own) > 2}
    figure = new_figure(
        7.4 if families else 4.6, "One step on a free oscillation: markers from the kernel, lines in closed form"
    )
    grid = figure.add_gridspec(2 if families else 1, 3)
    axes = [figure.add_subplot(grid[0, i]) for i in range(3)]
    shown = _shown(records, rows)
    for label in shown:
        _curves(axes, label, [row for row in rows if row["scheme"] == label])
    radius, elongation, damping = axes
    for axis in axes:
        log_scale(axis, y=axis is axes[2])
        axis.set(xlabel=r"$\Delta t/T$")
        axis.grid(color="0.92")
        if not rows:
            say_empty(axis)
    largest = max(column(rows, "spectral_radius"), default=1.0)
    radius.set(ylim=(0.0, min(max(1.05, 1.05 * largest), 3.0)), ylabel=r"spectral radius $\rho$")
    radius.set_title("(a) below 1: the mode is damped", loc="left")
    signed_log(elongation, (np.asarray(line.get_ydata()) for line in elongation.get_lines()), 1e-11)
    elongation.set(xlim=(1e-3, HALF), ylabel="relative period elongation")
    elongation.set_title("(b) above 0: late", loc="left")
    damping.set(xlim=(1e-3, HALF), ylim=(1e-10, 1.0), ylabel="algorithmic damping ratio")
    damping.set_title("(c) the scheme's own damping", loc="left")
    undamped = [short(label) for label in shown if max(_of(rows, label, "damping_ratio")) <= NO_DAMPING]
    if undamped and rows:
        text = f"none: {', '.join(undamped)}"
        damping.annotate(text, (0.97, 0.03), xycoords="axes fraction", ha="right", fontsize=8.5)
    shared_legend(figure, 4)
    for i, (name, own) in enumerate(families.items()):
        _parameter(figure.add_subplot(grid[1, i]), name, own, "def"[i])
    return figure


def _shown(records: Records, rows: Sequence[Row]) -> list[str]:
    """The schemes asked for, else every registered one with its defaults."""
    labels = list(dict.fromkeys(row["scheme"] for row in rows))
    defaults = [default_label(name) for name in SCHEMES if name != "theta"]
    return labels if records.options.get("schemes") else [label for label in defaults if label in labels] or labels


def _of(rows: Sequence[Row], label: str, name: str) -> list[float]:
    return [row[name] for row in rows if row["scheme"] == label and row["dt_over_period"] < HALF]


def _curves(axes: Sequence[Axes], label: str, own: Sequence[Row]) -> None:
    style = look(label)
    for axis, name in zip(axes, ("spectral_radius", "period_elongation", "damping_ratio"), strict=True):
        x, measured, theory = (column(own, key) for key in ("dt_over_period", name, f"{name}_theory"))
        if name == "period_elongation":
            x, measured, theory = (values[x <= HALF] for values in (x, measured, theory))
        line = np.where(np.isfinite(theory), theory, measured)
        if name == "damping_ratio":
            measured, line = (np.where(y > NO_DAMPING, y, np.nan) for y in (measured, line))  # a logarithm of none
        if not np.any(np.isfinite(line)):
            continue
        axis.plot(x, line, lw=1.0, **dict(style, marker=""))
        some = slice(len(x) // 48, None, max(1, len(x) // 24))
        axis.plot(x[some], measured[some], ms=3.6, **dict(style, linestyle=""))
    axes[0].plot([], [], lw=1.0, ms=4, label=short(label), **style)


def _family(rows: Sequence[Row], name: str) -> list[Row]:
    """The rows of a scheme at dt/T = 0.1, one for every value of its parameter, ascending."""
    parameter, _ = FAMILIES[name]
    own: dict[float, Row] = {}
    for row in rows:
        if row["name"] == name and row["dt_over_period"] == TENTH:
            own.setdefault(float(scheme_of(row["scheme"]).parameters[parameter]), row)
    return [own[value] | {"parameter": value} for value in sorted(own)]


def _parameter(axis: Axes, name: str, own: Sequence[Row], letter: str) -> None:
    parameter, title = FAMILIES[name]
    x = column(own, "parameter")
    breaks = np.flatnonzero(np.diff(x) > GAP) + 1 if name == "sdirk" else []
    for quantity, marker, dash, colour, text in (
        ("period_elongation", "o", "-", "black", "period elongation"),
        ("damping_ratio", "s", "--", "0.5", "damping ratio"),
    ):
        y = np.insert(100.0 * column(own, quantity), breaks, np.nan)
        axis.plot(np.insert(x, breaks, np.nan), y, marker=marker, ms=3.6, lw=1.0, ls=dash, color=colour, label=text)
    axis.axhline(0.0, color="0.6", lw=0.7, zorder=0)
    axis.grid(color="0.92")
    axis.set(xlabel=SYMBOLS[parameter], ylabel="per cent")
    axis.set_title(f"({letter}) {title}, Δt/T = 0.1", loc="left")
    axis.legend(frameon=False, fontsize=8.5)


STUDY = Study(
    name="amplification",
    question="What does one step of each scheme make of a free oscillation: how late, how much weaker, how stable?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    marches=False,
    smoke={"schemes": ["bdf2", "hht(alpha=-0.1)", "sdirk(gamma=0.4359)"], "per_decade": 10},
)
