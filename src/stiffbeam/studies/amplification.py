"""One step on a free oscillation: spectral radius, period elongation, damping, for every scheme and parameter."""

from __future__ import annotations

import warnings
from typing import Annotated

import numpy as np

from ..basics.validation import InputError
from ..figures.chart import Axis, Curve, Level, Mark, Note, Panel, Picture, column, look, short
from ..files.cases import Case
from ..measures.amplification import amplification
from ..schemes import HHT, SCHEMES, GeneralisedAlpha, Scheme, registered
from ..schemes.labels import make
from ..schemes.sdirk import GAMMA_MIN
from .common import Schemes, extremes, scheme_labels, scheme_of, significant
from .interface import Answer, Point, Records, Row, Rows, declared

TENTH = 0.1  # of a period: where the literature compares


def families() -> list[str]:
    """HHT over alpha, SDIRK-OS over gamma (its poles left out), generalised-alpha over rho."""
    gammas = [float(g) for g in np.round(np.arange(0.19, 1.01, 0.03), 2) if g > GAMMA_MIN and not 0.24 < g < 0.31]
    schemes = [
        *(HHT(round(a, 4)) for a in np.linspace(-0.33, 0.0, 12)),
        *(f"SDIRK(gamma={gamma})" for gamma in gammas),
        *(GeneralisedAlpha(round(r, 2)) for r in np.linspace(0.0, 1.0, 11)),
    ]
    return [str(scheme) for scheme in schemes]


def _scheme(label: str) -> Scheme:
    """Return a scheme of the families; that its nodes may lie beyond the step is part of what they show."""
    with warnings.catch_warnings(category=UserWarning, action="ignore"):
        return scheme_of(label)


def points(
    case: Case,
    schemes: Schemes = None,
    damping: Annotated[float, "physical damping ratio of the oscillator"] = 0.0,
    per_decade: Annotated[int, "values of dt/T per decade"] = 40,
) -> list[Point]:
    """Every scheme at dt/T from 1e-3 to 1e3, and at 0.1; by default with several values of its parameters."""
    labels = families() + [str(s) for s in registered()] if schemes is None else scheme_labels(case, schemes)
    return [{"scheme": label, "damping": damping, "per_decade": per_decade} for label in dict.fromkeys(labels)]


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row for every dt/T: spectral radius, period elongation and damping ratio, measured and in closed form."""
    scheme, xi = _scheme(point["scheme"]), point["damping"]
    x = np.union1d(np.logspace(-3, 3, 6 * point["per_decade"] + 1), [TENTH])
    errors = amplification(scheme, x, xi)
    try:
        theory = amplification(scheme, x, xi, source="closed form")
    except InputError:
        theory = None  # the scheme states no polynomial
    rows = []
    for i, value in enumerate(x):
        row = {"name": scheme.name, **scheme.parameters, "dt_over_period": float(value), "stable_to": errors.stable_to}
        for name in ("spectral_radius", "period_elongation", "damping_ratio"):
            row[name] = float(getattr(errors, name)[i])
            row[f"{name}_theory"] = float(getattr(theory, name)[i]) if theory else float("nan")
        rows.append(row)
    return rows


def answer(rows: Rows, _: Case) -> Answer:
    """Elongation and damping of every scheme at dt/T = 0.1."""
    at = [r for r in rows if r["dt_over_period"] == TENTH]
    base = [r for r in at if r["scheme"] in {str(s) for s in registered()}] or at
    base.sort(key=lambda r: abs(r["period_elongation"]))
    texts = {
        "period_elongation": lambda value: f"{significant(100.0 * value, '.3g')} %",
        "damping_ratio": lambda value: significant(value, ".2g"),
    }
    elongation, damping = (extremes({r["scheme"]: r[name] for r in base}, text) for name, text in texts.items())
    unstable = sorted({r["scheme"] for r in rows if np.isfinite(r["stable_to"])})
    gaps = [abs(r["spectral_radius"] - r["spectral_radius_theory"]) for r in rows]
    return Answer(
        f"At dt/T = 0.1 the period elongation is {elongation} and the damping ratio {damping}.",
        [
            {"dt/T = 0.1": r["scheme"]} | {name.replace("_", " "): text(r[name]) for name, text in texts.items()}
            for r in base
        ],
        f"Unstable at some step: {', '.join(unstable) or 'none of these and their families'}. The spectral "
        "radii of the kernel and of the closed form differ by at most "
        f"{max((gap for gap in gaps if np.isfinite(gap)), default=float('nan')):.1e}.",
    )


FAMILIES = {  # the parameter of a scheme, its symbol, and the gap across which no line is drawn, that of a pole
    "hht": ("alpha", "HHT over α", r"$\alpha$", np.inf), "sdirk": ("gamma", "SDIRK-OS over γ", r"$\gamma$", 0.05),
    "generalised-alpha": ("rho", "generalised-α over ρ", r"$\rho_\infty$", np.inf),
}  # fmt: skip
HALF = 0.5  # of a period: beyond it the samples alias
NO_DAMPING = 1e-12
PANELS = (
    ("spectral_radius", "below 1: the mode is damped", Axis(r"spectral radius $\rho$", limits=(0.0, None), cap=3.0)),
    ("period_elongation", "above 0: late",
     Axis("relative period elongation", scale="signed log", threshold=1e-11)),
    ("damping_ratio", "numerical damping", Axis("numerical damping ratio", scale="log", limits=(1e-10, 1.0))),
)  # fmt: skip


def picture(records: Records) -> Picture:
    """Lines: closed form; markers: the kernel's own step. Below: dt/T = 0.1 over the parameter of a family."""
    rows = records.numbers
    labels = list(dict.fromkeys(row["scheme"] for row in rows))
    defaults = [label for name in SCHEMES if name != "theta" and (label := str(make(name))) in labels]
    shown = labels if records.options.get("schemes") else defaults or labels
    by_label = {label: [row for row in rows if row["scheme"] == label] for label in shown}
    undamped = [short(x) for x in by_label if max(r["damping_ratio"] for r in by_label[x] if _sampled(r)) <= NO_DAMPING]
    upper = []
    for name, title, axis in PANELS:
        limits = (None, None) if name == "spectral_radius" else (1e-3, HALF)
        marks: list[Mark] = [mark for label in shown for mark in _curves(by_label[label], name, label)]
        if name == "damping_ratio" and undamped:
            marks.append(Note(f"none: {', '.join(undamped)}", 0.97, 0.03, "xy", {"ha": "right"}))
        upper.append(Panel(title, Axis(r"$\Delta t/T$", scale="log", limits=limits), axis, marks))
    lower = [panel for name in FAMILIES if (panel := _family(rows, name)) is not None]
    return Picture([upper, lower] if lower else [upper], 7.4 if lower else 4.6)


def _sampled(row: Row) -> bool:
    return row["dt_over_period"] <= HALF


def _curves(rows: Rows, name: str, label: str) -> list[Curve]:
    """The closed form, where there is none the measured values, as a line; some of the measured ones as markers."""
    rows = rows if name == "spectral_radius" else [row for row in rows if _sampled(row)]
    x, measured, theory = (column(rows, key) for key in ("dt_over_period", name, f"{name}_theory"))
    line = np.where(np.isfinite(theory), theory, measured)
    if name == "damping_ratio":  # a logarithm of none
        measured, line = (np.where(y > NO_DAMPING, y, np.nan) for y in (measured, line))
    some, look_of = slice(len(x) // 48, None, max(1, len(x) // 24)), look(label)
    return [Curve(x, line, short(label), look_of | {"marker": ""}),
            Curve(x[some], measured[some], short(label), look_of | {"linestyle": "", "ms": 3.6})]  # fmt: skip


def _family(rows: Rows, name: str) -> Panel | None:
    """Elongation and damping at dt/T = 0.1 over the parameter of a scheme; None for fewer than three values of it."""
    parameter, title, symbol, gap = FAMILIES[name]
    at = [row for row in rows if row["name"] == name and row["dt_over_period"] == TENTH]
    values = {float(_scheme(row["scheme"]).parameters[parameter]): row for row in reversed(at)}
    x = np.array(sorted(values))
    if len(x) < 3:
        return None
    breaks = np.flatnonzero(np.diff(x) > gap) + 1
    marks: list[Mark] = [
        Curve(np.insert(x, breaks, np.nan), np.insert(100.0 * column([values[v] for v in x], key), breaks, np.nan),
              words, style | {"ms": 3.6})
        for key, words, style in (
            ("period_elongation", "period elongation", {"color": "black", "marker": "o"}),
            ("damping_ratio", "damping ratio", {"color": "0.5", "marker": "s", "linestyle": "--"}),
        )
    ]  # fmt: skip
    return Panel(f"{title}, Δt/T = 0.1", Axis(symbol), Axis("per cent"), [*marks, Level(0.0)], legend="inside")


STUDY = declared(
    __name__,
    "How does one time step of each scheme change a free oscillation: period, damping, stability?",
    marches=False,
    of_case=False,
    smoke={"schemes": ["BDF2", "HHT(alpha=-0.1)", "SDIRK(gamma=0.4359)"], "per_decade": 10},
)
