"""The energy ledger of every scheme in every form, beside the exact flow's, which closes to rounding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.units import Units
from ..figures import column, heading, look, new_figure, numeric, say_empty, shared_legend, short, signed_log
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.report import DASH, percent
from ..trajectory.ledger import Ledger, given
from ..trajectory.trajectory import Trajectory
from .common import Dt, End, Forms, Schemes, Treatment, scheme_labels, scheme_of, solve_once, system_of, to_the_end
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OUTPUTS = 200  # times at which the ledger is kept
FIRST_ORDER = ", first order"  # (3.5): the same system, marched in (v, v')


def points(
    case: Case,
    schemes: Schemes = None,
    forms: Forms = None,
    dt: Dt = None,
    t_end: End = None,
    contact: Treatment = "implicit",
) -> list[Point]:
    """The exact flow and every scheme on every form that the case can take; first-order marches for two schemes.

    The exact flow is followed to its horizon, to which the float64 solution holds.
    """
    dt, t_end = case.dt if dt is None else dt, case.t_end if t_end is None else t_end
    labels = scheme_labels(case, schemes)
    kinds = forms or list(case.forms)
    span = {"t_end": t_end, "contact": contact}
    found: list[Point] = []
    for form in kinds:
        found.append({"scheme": "exact", "form": form, "dt": 0.0} | span)
        found += [{"scheme": label, "form": form, "dt": dt} | span for label in labels]
    # The direct march of the paper's (3.5) is slow, and the same scheme to rounding: a tenth of the span shows it.
    first = [label for label in labels if not scheme_of(label).second_order_only][:1] if forms is None else []
    short = {"t_end": dt * max(2, round(0.1 * t_end / dt)), "contact": contact}
    found += [{"scheme": label, "form": kinds[0] + FIRST_ORDER, "dt": dt} | short for label in first]
    return found


def evaluate(case: Case, point: Point) -> list[Row]:
    """The ledger of one run at OUTPUTS times; that of the exact flow ends at its horizon."""
    form = point["form"]
    system = system_of(case, form.removesuffix(FIRST_ORDER))
    if point["scheme"] == "exact":
        run: Trajectory = solve_once(system, point["t_end"])
        ledger = run.energy
        last = int(np.searchsorted(ledger.t, run.horizon, side="right"))
        keep = np.unique(np.linspace(0, max(0, last - 1), OUTPUTS).astype(int))
    else:
        steps = round(point["t_end"] / point["dt"])
        chosen = system.first_order() if form.endswith(FIRST_ORDER) else system
        every = to_the_end(steps, OUTPUTS)
        run = integrate(chosen, scheme_of(point["scheme"]), point["dt"], point["t_end"], point["contact"], every)
        ledger = run.energy
        keep = np.arange(len(ledger.t))
    return [_row(ledger, int(k)) for k in keep]


def _row(ledger: Ledger, k: int) -> Row:
    names = ("t", "kinetic", "elastic", "stops", "energy", "input", "viscous", "spread", "loss")
    row = {name: float(getattr(ledger, name)[k]) for name in names}
    sure = ledger.sure(k)
    parts = {"lost_in_contact": ledger.contact[k], "lost_free": ledger.free[k]}
    row |= {name: float(x) if sure else float("nan") for name, x in parts.items()}
    return row | {"sure": sure, "lost_fraction": ledger.lost_fraction(k)}


def last_rows(rows: Rows) -> list[Row]:
    """The last line of every run's ledger."""
    return list({(row["scheme"], row["form"]): row for row in rows}.values())


def answer(rows: Rows, case: Case) -> str:
    """What every run has lost at its end, relative to the most energy given, and how much of it in contact."""
    units = case.units
    parts, exact, table = [], [], []
    ends: list[float] = []  # of the schemes' ledgers
    for row in last_rows(rows):
        if row["scheme"] == "exact":
            end = units.measure(f"{row['t']:.3g}", "time")
            exact.append(f"{abs(row['lost_fraction']):.0e} ({row['form']}, to t = {end})")
        elif row["form"] == rows[0]["form"]:
            share = row["lost_in_contact"] / row["loss"] if row["loss"] else float("nan")
            lost = percent(row["lost_fraction"])
            if not row["sure"]:
                lost = UNKNOWN
            elif not np.isfinite(row["lost_fraction"]):
                lost = units.measure(f"{row['loss']:.2g}", "energy") + " in all"  # on balance nothing was put in
            part = f"{100 * share:z.0f} %" if row["sure"] else DASH
            ends.append(row["t"])
            parts.append(f"{row['scheme']} {lost} ({part} of it in contact)")
            table.append({"scheme": row["scheme"], "energy lost": lost, "of it in contact": part})
    end = units.measure(f"{max(ends or [row['t'] for row in rows]):g}", "time")
    head, tail = (
        f"Of the most energy that start and loads have given to t = {end}, one realisation each",
        f"The exact flow closes to {', '.join(exact)}.",
    )
    if any(UNKNOWN in part for part in parts):
        tail += f" {UNKNOWN.capitalize()}: the steps do not resolve the damping, and leave open what it took."
    return Answer(f"{head}, lost: {', '.join(parts)}. {tail}", table, f"{head}. {tail}")


UNKNOWN = "not known"
MOST = 120.0  # per cent: longer bars are cut, their numbers stand beside them
LEAST = 0.05  # per cent, of the axis
ROUNDING = 1e-9  # of the largest energy: less is no loss
PARTS = (("lost_in_contact", "in contact"), ("lost_free", "between impacts"))


def _percent(height: float) -> str:
    """A share as it stands over its bar: two digits while it is below 10, "0" for rounding errors only."""
    if abs(height) < 0.05:
        return "0" if abs(height) < 1e-6 else "<0.1"
    return f"{height:.2g}" if abs(height) < 10.0 else str(round(height)) if abs(height) < 1e4 else f"{height:.0e}"


def draw(records: Records) -> Figure:
    """Energies over time, and in the end their share of the most energy given."""
    rows = numeric(records.found)
    runs: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        runs.setdefault((row["form"], row["scheme"]), []).append(row)
    forms = list(dict.fromkeys(form for form, _ in runs))
    main = forms[0] if forms else "displacement"
    figure = new_figure(8.2)
    units = records.case.units
    figure.suptitle(heading(records.case, "the energy that each scheme loses, in contact and between impacts"))
    axes = figure.subplot_mosaic([["contact", "free"], ["bars", "bars"]], height_ratios=(1.0, 1.15))
    for (name, words), panel, letter in zip(PARTS, ("contact", "free"), "ab", strict=True):
        axis = axes[panel]
        for (form, scheme), own in runs.items():
            if form == main:
                style: dict[str, Any] = look(scheme) | {"marker": ""}
                label = "exact, to its horizon" if scheme == "exact" else short(scheme)
                (line,) = axis.plot(column(own, "t"), column(own, name), label=label, **style)
                line.set_linewidth(3.0 if scheme == "exact" else 1.3)
        axis.axhline(0.0, color="0.6", lw=0.7, zorder=0)
        axis.grid(color="0.92")
        axis.set(xlabel=units.label("time $t$", "time"), ylabel=units.label("energy lost so far", "energy"))
        axis.set_title(f"({letter}) lost {words} ({main} form)", loc="left")
        if not rows:
            say_empty(axis)
        shown = np.concatenate([np.asarray(line.get_ydata(), float) for line in axis.get_lines()])
        top = float(np.max(np.abs(shown), initial=0.0, where=np.isfinite(shown)))
        sizes = [abs(row["energy"]) + abs(row["input"]) for row in rows]
        had = max((x for x in sizes if np.isfinite(x)), default=0.0)
        if top > ROUNDING * had:
            signed_log(axis, [shown], 1e-3 * top)
        elif had:  # on the scale of what could be lost
            axis.set_ylim(-had, had)
    shared_legend(figure, 4)
    _bars(axes["bars"], runs, units)
    return figure


def _share(own: Sequence[Row], name: str) -> Array:
    """Per cent of the most energy given so far; NaN where that is nothing."""
    most = given(column(own, "energy")[0], column(own, "input"))
    return 100.0 * column(own, name) / np.where(most > 0.0, most, np.nan)


def _bars(axis: Axes, runs: dict[tuple[str, str], list[Row]], units: Units) -> None:
    """The last share of every run, in contact and free side by side on either side of zero, cut at +-MOST."""
    place, ticks, names = 0.0, [], []
    last_form = None
    for (form, scheme), own in runs.items():
        if scheme == "exact":
            continue
        if last_form not in (None, form):
            axis.axvline(place - 0.25, color="0.8", lw=0.8)
            place += 0.5
        end = units.measure(f"{own[-1]['t']:g}", "time")
        if form != last_form:
            words, at, side = form + " ", place - 0.5, "left"
            if form.endswith(FIRST_ORDER):  # one bar, the last
                words, at, side = "as a first-order system,\n", place + 0.5, "right"
            axis.text(at, 1.02, f"{words}to t = {end}", fontsize=9, color="0.25", ha=side,
                      transform=axis.get_xaxis_transform())  # fmt: skip
        last_form = form
        if not own[-1]["sure"]:
            axis.text(place, 0.02, UNKNOWN, rotation=90, fontsize=8, color="0.25", ha="center", va="bottom",
                      transform=axis.get_xaxis_transform())  # fmt: skip
        for k, ((name, words), colour, hatch) in enumerate(zip(PARTS, ("0.3", "0.75"), ("", "///"), strict=True)):
            height = _share(own, name)[-1]
            axis.bar(place + 0.4 * k - 0.2, np.clip(height, -MOST, MOST), 0.38, color=colour, hatch=hatch,
                     edgecolor="white", label=words if not ticks else None)  # fmt: skip
            if np.isfinite(height):
                at = (place + 0.4 * k - 0.2, np.clip(height, -MOST, MOST))
                axis.annotate(_percent(height), at, (0, 2 if height > -0.5 else -10), textcoords="offset points",
                              ha="center", fontsize=8)  # fmt: skip
        ticks.append(place)
        names.append(short(scheme))
        place += 1.0
    axis.axhline(0.0, color="0.3", lw=0.8)
    axis.set_xticks(ticks, names, rotation=30, ha="right", fontsize=8.5)
    axis.set(ylabel="per cent of the most energy given")
    axis.set_title("(c) lost in the end, of initial energy and the most work put in", loc="left", pad=30)
    axis.margins(y=0.12)
    if ticks:
        axis.set_xlim(-0.6, place - 0.4)
        low, high = axis.get_ylim()
        axis.set_ylim(min(low, -LEAST), max(high, LEAST))
        axis.legend(frameon=False, fontsize=9, loc="lower right", bbox_to_anchor=(1.0, 1.1), ncols=2)
    else:
        say_empty(axis)


STUDY = Study(
    name="energy",
    question="Where does the energy go: how much does each scheme lose, in contact and between impacts?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    needs_motion=True,
    smoke={"schemes": ["hht(alpha=-0.1)", "bdf2"], "t_end": 0.05},
)
