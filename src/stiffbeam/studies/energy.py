"""Energy balance of every scheme in every form, and of the exact flow, which closes to rounding."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..figures.chart import Axis, Level, Mark, Note, Panel, Picture, Ranges, column, curves, groups, short
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.report import DASH, percent
from ..trajectory.records import Ledger, supplied
from ..trajectory.trajectory import Trajectory
from . import common
from .interface import Answer, Point, Records, Row, Rows, declared

OUTPUTS = 200  # times at which the ledger is kept


def points(
    case: Case,
    *,
    schemes: common.Schemes = None,
    forms: common.Forms = None,
    dt: common.Dt,
    t_end: common.End,
    contact: common.Treatment = "implicit",
) -> list[Point]:
    """Every scheme and the exact solution, which ends at its horizon, in every form that the case supports."""
    labels = common.scheme_labels(case, schemes)
    kinds = forms or list(case.forms)
    span = {"t_end": t_end, "contact": contact}
    plan: list[Point] = []
    for form in kinds:
        plan.append({"scheme": "exact", "form": form, "dt": 0.0} | span)
        plan += [{"scheme": label, "form": form, "dt": dt} | span for label in labels]
    return plan


def evaluate(case: Case, point: Point) -> list[Row]:
    """Energy balance of one run at OUTPUTS times; that of the exact flow ends at its horizon."""
    form = point["form"]
    system = case.system(form)
    if point["scheme"] == "exact":
        run: Trajectory = common.solve_once(system, point["t_end"])
        ledger = run.energy
        # To the horizon: past it the float64 solution no longer holds.
        last = int(np.searchsorted(ledger.t, run.horizon, side="right"))
        keep = np.unique(np.linspace(0, max(0, last - 1), OUTPUTS).astype(int))
    else:
        steps = round(point["t_end"] / point["dt"])
        every = common.to_the_end(steps, OUTPUTS)
        run = integrate(system, common.scheme_of(point["scheme"]), point["dt"], point["t_end"], point["contact"], every)
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
    """The last row of every run's energy balance."""
    return list({(row["scheme"], row["form"]): row for row in rows}.values())


def answer(rows: Rows, case: Case) -> Answer:
    """Energy lost at the end of every run, as a share of the energy supplied, and its part in contact."""
    units, table, lost, ends, known, shares = case.units, [], {}, [], True, [0.0]
    last = last_rows(rows)
    closed = [
        f"{abs(row['lost_fraction']):.0e} ({row['form']}, to t = {units.measure(row['t'], 'time', '.3g')})"
        for row in last
        if row["scheme"] == "exact"
    ]
    for row in (row for row in last if row["scheme"] != "exact" and row["form"] == rows[0]["form"]):
        share = row["lost_in_contact"] / row["loss"] if row["loss"] else np.nan
        if not row["sure"]:
            most = _supplied([r for r in rows if r["scheme"] == row["scheme"] and r["form"] == row["form"]])
            said = f"{percent(row['loss'] / most)} ± {percent(row['spread'] / most)}" if most > 0.0 else UNKNOWN
            known = False
        elif np.isfinite(row["lost_fraction"]):
            lost[row["scheme"]], said = row["lost_fraction"], percent(row["lost_fraction"])
        else:  # on balance nothing was put in
            said = units.measure(row["loss"], "energy", ".2g") + " in all"
        ends.append(row["t"])
        part = f"{100 * share:z.0f} %" if row["sure"] else DASH
        shares += [share] if row["sure"] else []
        table.append({"scheme": row["scheme"], "energy lost": said, "of it in contact": part})
    end = units.measure(max(ends or [row["t"] for row in rows]), "time", "g")
    unknown = (
        "" if known else " ±: the difference of two rules for the work of dampers, which takes smaller steps to know."
    )
    verdict = f"Schemes lose {common.extremes(lost, percent)} of the energy supplied to t = {end}, the exact flow none."
    if not lost and not known:
        verdict = (
            f"The steps do not resolve the work of dampers to t = {end}: what schemes lose is known to the ± only."
        )
    return Answer(
        verdict,
        table,
        "Supplied: initial energy plus the most work of the loads. Single runs. The energy balance of the exact flow "
        f"closes to {', '.join(closed) or DASH}.{unknown}{REGAINED if np.nanmax(shares) > 1.005 else ''}",
    )


UNKNOWN = "not known"
REGAINED = " Above 100 %: the scheme regains energy in the first steps after a contact, which still use its force."
MOST = 100.0  # per cent: a share beyond it is a number at the edge, without a bar
ROUNDING = 1e-9  # of the largest energy: less is no loss
PARTS = (("lost_in_contact", "in contact", "0.3", -0.18), ("lost_free", "between impacts", "0.65", 0.18))


def picture(records: Records) -> Picture:
    """Above: energies over time. Below: for each form the shares of the supplied energy lost at the end."""
    rows, units = records.numbers, records.case.units
    main = [row for row in rows if row["form"] == rows[0]["form"]]
    sizes = [abs(row["energy"]) + abs(row["input"]) for row in main]
    had = max((x for x in sizes if np.isfinite(x)), default=0.0)
    upper = []
    for name, words, *_ in PARTS:
        lines = curves(main, "t", name, "scheme", exact=3.0, marker="")
        real = any(np.any(np.abs(line.values) > ROUNDING * had) for line in lines)
        scale: dict[str, Any] = {"scale": "signed log"} if real else {"limits": (-had, had)} if had else {}
        title = f"lost {words}, {main[0]['form']} form"
        upper.append(Panel(title, Axis("time $t$", "time"), Axis("energy lost so far", "energy", **scale), lines))
    runs = {form: groups(group, "scheme") for form, group in groups(rows, "form").items()}
    names = [name for name in dict.fromkeys(row["scheme"] for row in rows) if name != "exact"]
    lower = []
    for form, of_form in runs.items():
        end = units.measure(max(group[-1]["t"] for group in of_form.values()), "time", "g")
        lower.append(_shares(f"{form.rpartition(', ')[2]} to t = {end}", of_form, names))
    return Picture([upper, lower], 8.2, heights=(1.0, 1.15))


def _shares(title: str, runs: dict[str, list[Row]], names: list[str]) -> Panel:
    """Shares in contact and between impacts, a bar each in the line of its scheme; beyond MOST numbers at the edge."""
    lines = [(i, runs[label]) for i, label in enumerate(names) if label in runs]
    bars = [
        (i + place, _share(group, name), words, colour) for name, words, colour, place in PARTS for i, group in lines
    ]
    reach = 1.35 * max([1.0, *(abs(share) for _, share, *_ in bars if abs(share) <= MOST)])
    marks: list[Mark] = [Level(0.0, of="x", look={"ls": "-"})]
    for at, share, words, colour in bars:
        look = {"va": "center", "ha": "left", "fontsize": 7.5}
        if abs(share) <= MOST:
            marks.append(Ranges(at, min(share, 0.0), max(share, 0.0), label=words, look={"color": colour, "lw": 7.0}))
            marks.append(Note(f" {_percent(share)} ", share, at, look=look | ({"ha": "right"} if share < 0.0 else {})))
        elif np.isfinite(share):
            edge = {"ha": "left" if share < 0.0 else "right", "fontweight": "bold"}
            marks.append(Note(f" off scale: {_percent(share)} ", np.sign(share) * reach, at, look=look | edge))
    marks += [Note(f" {UNKNOWN}", 0.0, i, look={"va": "center"}) for i, group in lines if not group[-1]["sure"]]
    across = Axis("per cent of the energy supplied", limits=(-reach, reach))
    return Panel(title, across, Axis(names=[short(name) for name in names]), marks)


def _supplied(group: Rows) -> float:
    """The energy supplied up to the last of these rows of one run."""
    return float(supplied(column(group, "energy")[0], column(group, "input"))[-1])


def _share(group: Rows, name: str) -> float:
    """Per cent of the energy supplied; NaN if that is zero or the loss is not known."""
    most = _supplied(group)
    return 100.0 * group[-1][name] / most if most > 0.0 else np.nan


def _percent(share: float) -> str:
    """A share as text next to its bar: two digits below 10, "0" for rounding errors."""
    if abs(share) < 0.05:
        return "0" if abs(share) < 1e-6 else "<0.1"
    return f"{share:.2g}" if abs(share) < 10.0 else f"{share:.0f}" if abs(share) < 1e4 else f"{share:.0e}"


STUDY = declared(
    __name__,
    "How much energy does each scheme lose, in contact and between impacts?",
    needs_motion=True,
    smoke={"schemes": ["HHT(alpha=-0.1)", "BDF2"], "t_end": 0.05},
)
