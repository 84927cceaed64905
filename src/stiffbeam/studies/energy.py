"""The energy ledger of every scheme in every form, beside the exact flow's, which closes to rounding."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..basics.units import Units
from ..figures import Axis, Bars, Level, Mark, Note, Panel, Picture, column, curves, groups, short
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.report import DASH, percent
from ..trajectory.ledger import Ledger, supplied
from ..trajectory.trajectory import Trajectory
from . import common
from .engine.study import Answer, Point, Records, Row, Rows, Study

OUTPUTS = 200  # times at which the ledger is kept
FIRST_ORDER = ", first order"  # (3.5): the same system, marched in (v, v')


def points(
    case: Case,
    *,
    schemes: common.Schemes = None,
    forms: common.Forms = None,
    dt: common.Dt,
    t_end: common.End,
    contact: common.Treatment = "implicit",
) -> list[Point]:
    """The exact flow and every scheme on every form that the case can take; first-order marches for two schemes.

    The exact flow is followed to its horizon, to which the float64 solution holds.
    """
    labels = common.scheme_labels(case, schemes)
    kinds = forms or list(case.forms)
    span = {"t_end": t_end, "contact": contact}
    found: list[Point] = []
    for form in kinds:
        found.append({"scheme": "exact", "form": form, "dt": 0.0} | span)
        found += [{"scheme": label, "form": form, "dt": dt} | span for label in labels]
    # The direct march of the paper's (3.5) is slow, and the same scheme to rounding: a tenth of the span shows it.
    first = [label for label in labels if not common.scheme_of(label).second_order_only][:1] if forms is None else []
    short = {"t_end": dt * max(2, round(0.1 * t_end / dt)), "contact": contact}
    found += [{"scheme": label, "form": kinds[0] + FIRST_ORDER, "dt": dt} | short for label in first]
    return found


def evaluate(case: Case, point: Point) -> list[Row]:
    """The ledger of one run at OUTPUTS times; that of the exact flow ends at its horizon."""
    form = point["form"]
    system = common.system_of(case, form.removesuffix(FIRST_ORDER))
    if point["scheme"] == "exact":
        run: Trajectory = common.solve_once(system, point["t_end"])
        ledger = run.energy
        last = int(np.searchsorted(ledger.t, run.horizon, side="right"))
        keep = np.unique(np.linspace(0, max(0, last - 1), OUTPUTS).astype(int))
    else:
        steps = round(point["t_end"] / point["dt"])
        chosen = system.first_order() if form.endswith(FIRST_ORDER) else system
        every = common.to_the_end(steps, OUTPUTS)
        run = integrate(chosen, common.scheme_of(point["scheme"]), point["dt"], point["t_end"], point["contact"], every)
        ledger = run.energy
        keep = np.arange(len(ledger.t))
    return [_row(ledger, int(k)) for k in keep]


def _row(ledger: Ledger, k: int) -> Row:
    names = ("t", "kinetic", "elastic", "stops", "energy", "input", "viscous", "spread", "loss")
    row = {name: float(getattr(ledger, name)[k]) for name in names}
    sure = ledger.is_resolved(k)
    parts = {"lost_in_contact": ledger.loss_in_contact[k], "lost_free": ledger.loss_without_contact[k]}
    row |= {name: float(x) if sure else float("nan") for name, x in parts.items()}
    return row | {"sure": sure, "lost_fraction": ledger.lost_fraction(k)}


def last_rows(rows: Rows) -> list[Row]:
    """The last line of every run's ledger."""
    return list({(row["scheme"], row["form"]): row for row in rows}.values())


def answer(rows: Rows, case: Case) -> Answer:
    """The energy that every run has lost at its end, as a share of the most energy given, and its part in contact."""
    units, table, lost, ends = case.units, [], {}, []
    closed = [
        f"{abs(row['lost_fraction']):.0e} ({row['form']}, to t = {units.measure(format(row['t'], '.3g'), 'time')})"
        for row in last_rows(rows)
        if row["scheme"] == "exact"
    ]
    for row in last_rows(rows):
        if row["scheme"] == "exact" or row["form"] != rows[0]["form"]:
            continue
        share = row["lost_in_contact"] / row["loss"] if row["loss"] else float("nan")
        if not row["sure"]:
            said = UNKNOWN
        elif np.isfinite(row["lost_fraction"]):
            lost[row["scheme"]], said = row["lost_fraction"], percent(row["lost_fraction"])
        else:  # on balance nothing was put in
            said = units.measure(f"{row['loss']:.2g}", "energy") + " in all"
        ends.append(row["t"])
        part = f"{100 * share:z.0f} %" if row["sure"] else DASH
        table.append({"scheme": row["scheme"], "energy lost": said, "of it in contact": part})
    end = units.measure(f"{max(ends or [row['t'] for row in rows]):g}", "time")
    unknown = f" {UNKNOWN.capitalize()}: the steps do not resolve the damping." if UNKNOWN in str(table) else ""
    return Answer(
        f"Energy lost to t = {end}, of the most that start and loads have given: {common.extremes(lost, percent)}.",
        table,
        f"Single runs. The ledger of the exact flow closes to {', '.join(closed) or DASH}.{unknown}",
    )


UNKNOWN = "not known"
MOST = 120.0  # per cent: longer bars are cut, their numbers stand beside them
ROUNDING = 1e-9  # of the largest energy: less is no loss
PARTS = (("lost_in_contact", "in contact", {"color": "0.3"}),
         ("lost_free", "between impacts", {"color": "0.75", "hatch": "///"}))  # fmt: skip


def picture(records: Records) -> Picture:
    """Energies over time, and in the end their share of the most energy given."""
    rows = records.numbers
    main = [row for row in rows if row["form"] == rows[0]["form"]]
    sizes = [abs(row["energy"]) + abs(row["input"]) for row in main]
    had = max((x for x in sizes if np.isfinite(x)), default=0.0)
    upper = []
    for name, words, _ in PARTS:
        lines = curves(main, "t", name, "scheme", exact=3.0, marker="")
        real = any(np.any(np.abs(line.values) > ROUNDING * had) for line in lines)
        scale: dict[str, Any] = {"scale": "signed log"} if real else {"limits": (-had, had)} if had else {}
        title = f"lost {words} ({main[0]['form']} form, exact to its horizon)"
        upper.append(Panel(title, Axis("time $t$", "time"), Axis("energy lost so far", "energy", **scale), lines))
    return Picture([upper, [_bars(rows, records.case.units)]], 8.2, heights=(1.0, 1.15))


def _bars(rows: Rows, units: Units) -> Panel:
    """The last share of every run, in contact and free side by side, cut at +-MOST; the forms apart."""
    runs = {key: own for key, own in groups(rows, "form", "scheme").items() if key[1] != "exact"}
    forms = list(dict.fromkeys(form for form, _ in runs))
    x = np.array([i + 0.5 * forms.index(form) for i, (form, _) in enumerate(runs)])
    marks: list[Mark] = [Level(0.0, look={"ls": "-"})]
    for k, (name, words, style) in enumerate(PARTS):
        shares = np.array([_share(own, name) if own[-1]["sure"] else np.nan for own in runs.values()])
        texts = [f"{'' if abs(share) < MOST else '↑'}{_percent(share)}" for share in shares]
        marks.append(Bars(x + 0.4 * k - 0.2, np.clip(shares, -MOST, MOST), words, style, texts))
    unsure = [place for place, own in zip(x, runs.values(), strict=True) if not own[-1]["sure"]]
    marks += [Note(UNKNOWN, place, 0.02, "y", {"rotation": 90, "ha": "center"}) for place in unsure]
    for (form, _), place in reversed(list(zip(runs, x, strict=True))):
        if place == min(p for (f, _), p in zip(runs, x, strict=True) if f == form):
            end = units.measure(f"{runs[form, next(s for f, s in runs if f == form)][-1]['t']:g}", "time")
            words = form.replace(FIRST_ORDER, ",\nfirst order")
            marks += [Level(place - 0.75, of="x"), Note(f"{words} to t = {end}", place - 0.7, 0.98, "y", {"va": "top"})]
    ticks = {place: short(scheme) for place, (_, scheme) in zip(x, runs, strict=True)}
    across = Axis(ticks=ticks, limits=(-0.7, float(x[-1]) + 0.9) if len(x) else (None, None))
    return Panel("lost in the end, of initial energy and the most work put in", across,
                 Axis("per cent of the most energy given"), marks, legend="inside")  # fmt: skip


def _share(own: Rows, name: str) -> float:
    """Per cent of the most energy given; NaN where that is nothing."""
    most = supplied(column(own, "energy")[0], column(own, "input"))[-1]
    return 100.0 * own[-1][name] / most if most > 0.0 else np.nan


def _percent(height: float) -> str:
    """A share as it stands over its bar: two digits while it is below 10, "0" for rounding errors only."""
    if abs(height) < 0.05:
        return "0" if abs(height) < 1e-6 else "<0.1"
    return f"{height:.2g}" if abs(height) < 10.0 else f"{height:.0f}" if abs(height) < 1e4 else f"{height:.0e}"


STUDY = Study(
    name="energy",
    question="Where does the energy go: how much does each scheme lose, in contact and between impacts?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    picture=picture,
    needs_motion=True,
    smoke={"schemes": ["HHT(alpha=-0.1)", "BDF2"], "t_end": 0.05},
)
