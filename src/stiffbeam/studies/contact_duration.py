"""Durations of contacts: from the entry into a stop to the exit from it, at every stop.

    duration = t_exit - t_entry

Of the exact motion both are events, of a scheme crossings of the stop by the cubic Hermite interpolant of its
steps. Through the first impacts the i-th contact of a run is compared with the i-th exact one, as long as they
match. Past it only distributions over perturbed members can be compared. Most contacts are short bounces, most of
the time in contact is spent in a few long ones; so two numbers are given, the median over the contacts and the
duration beyond which half of the time in contact is spent. Contacts that are open at the end are left out, and
counted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..basics.arrays import Array
from ..figures.chart import Axis, Curve, Level, Mark, Panel, Picture, column, curves, groups, look, short
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.errors import longest_delay, match
from ..measures.report import percent
from ..model.members import SPREAD, perturbed_members
from . import common
from .interface import Answer, Point, Records, Row, Rows, by_contact, declared

SIDES = {1: "upper", -1: "lower"}
LEVELS = np.linspace(0.01, 0.99, 50)  # of the cumulative distribution


def points(
    case: Case,
    *,
    schemes: common.Schemes = None,
    form: common.Form,
    dt: common.Dt,
    t_end: common.End,
    halvings: common.Halvings = 10,
    impacts: common.ImpactCount = 4,
    members: common.Members = 48,
) -> list[Point]:
    """Durations of the first ``impacts`` contacts at ``dt`` (the case's), dt/2, ..., compared one by one.

    Distributions of durations to ``t_end`` at ``dt``, over ``members`` perturbed runs of each scheme and of the exact
    solution."""
    shared = {"form": form, "t_end": t_end, "members": members}
    labels = common.scheme_labels(case, schemes)
    plan = [{"task": "ensemble", "method": label, "dt": dt} | shared for label in ["exact", *labels]]
    end = common.first_impacts(case, form, impacts)
    pairs = [
        {"task": "pairs", "method": label, "dt": end / steps} | shared | {"t_end": end}
        for label in labels
        for steps in common.halved(end, dt, halvings)
    ]
    return plan + pairs


def evaluate(case: Case, point: Point) -> list[Row]:
    """Rows of matched contacts, or of an ensemble, as the point says."""
    return {"pairs": _pairs, "ensemble": _ensemble}[point["task"]](case, point)


def _pairs(case: Case, point: Point) -> list[Row]:
    """The durations of a run over the exact ones, of the contacts that match."""
    system, end = case.system(point["form"]), point["t_end"]
    exact = common.solve_once(system, case.t_end)
    run = integrate(system, common.scheme_of(point["method"]), point["dt"], end, every=round(end / point["dt"]))
    rows = []
    for number, (contact, exact_contact) in enumerate(zip(run.contacts, exact.contacts, strict=True), 1):
        first = slice(0, match(contact.impacts, exact_contact.impacts, end, longest_delay(system, case.t_end)).matched)
        run_impacts, exact_impacts = contact.impacts.take(first), exact_contact.impacts.take(first)
        for side, name in SIDES.items():
            lasting = np.nan_to_num(exact_impacts.durations) > 0.0  # not so at rigid stops
            here = (exact_impacts.stops == side) & lasting & np.isfinite(run_impacts.durations)
            errors = np.abs(run_impacts.durations[here] / exact_impacts.durations[here] - 1.0)
            there = int(np.sum(exact_contact.impacts.until(end).stops == side))
            row = {"kind": "pairs", "contact_number": number, "stop": name, "exact": there, "pairs": len(errors)}
            largest = float(np.max(errors)) if len(errors) else float("nan")
            rows.append(row | {"error": largest})
    return rows


def _ensemble(case: Case, point: Point) -> list[Row]:
    """The distribution of durations over all contacts of all members, stop by stop."""
    system, t_end = case.system(point["form"]), point["t_end"]
    members = perturbed_members(system, point["members"], SPREAD, t_end=t_end)
    many = common.run_members(point["method"], members, point["dt"], t_end)
    rows: list[Row] = []
    for number, seen in enumerate(many.contacts, 1):
        for side, name in SIDES.items():
            durations = seen.impacts.durations[seen.impacts.stops == side]
            closed = np.sort(durations[np.isfinite(durations)])
            if not len(closed):
                continue
            where = {"contact_number": number, "stop": name}
            summary = {
                "kind": "summary",
                "contacts": len(closed) / len(many), "open": (len(durations) - len(closed)) / len(many),
                "mean": float(np.mean(closed)), "median": float(np.median(closed)),
                "half_time": half_time(closed), "longest": float(closed[-1]),
            }  # fmt: skip
            rows.append(where | summary)
            levels = zip(LEVELS, np.quantile(closed, LEVELS), strict=True)
            rows += [where | {"kind": "quantile", "level": float(q), "duration": float(d)} for q, d in levels]
    return rows


def half_time(durations: Array) -> float:
    """The duration of the contact in which half of the time in contact is reached, from the shortest on."""
    durations = np.sort(durations)
    spent = np.cumsum(durations)
    return float(durations[np.searchsorted(spent, 0.5 * spent[-1])])


def answer(rows: Rows, case: Case) -> Answer:
    """The median duration and the one from which half of the time in contact is spent, at every stop of one contact."""
    units, table, parts = case.units, [], []
    for name in SIDES.values():
        group = [row for row in rows if row["stop"] == name]
        paired = sorted((row for row in group if row["kind"] == "pairs" and row["pairs"]), key=lambda row: -row["dt"])
        finest = {row["method"]: row for row in paired}  # the last of a method
        summaries = {row["method"]: row for row in group if row["kind"] == "summary"}
        for method in dict.fromkeys([*summaries, *finest]):
            line = {"stop": name, "method": short(method)}
            if row := summaries.get(method):
                median, half = (units.measure(row[key], "time", ".2g") for key in ("median", "half_time"))
                line |= {"contacts a run": f"{row['contacts']:.4g}", "median": median, "half of the time from": half}
            if row := finest.get(method):
                dt = units.measure(row["dt"], "time", ".2g")
                line["error of the first ones"] = f"{percent(row['error'])} (at most, of {row['pairs']}, dt = {dt})"
            table.append(line)
        medians = {method: row["median"] for method, row in summaries.items()}
        exact = medians.pop("exact", np.nan)
        if summaries:
            known = "" if np.isnan(exact) else f"exact {units.measure(exact, 'time', '.2g')}, "
            schemes = common.extremes(medians, lambda value: units.measure(value, "time", ".2g"))
            parts.append(f"{known}schemes {schemes} at the {name} stop")
    if not table:
        return Answer("No contact came to an end.")
    notes = "Half of the time from: half of the time in contact is spent in contacts of at least this duration."
    if case.system().rigid:
        notes += " An exact impact on a rigid stop takes no time, that of a scheme a step or two."
    return Answer(f"Median duration of a contact: {'; '.join(parts) or 'not known'}.", table, notes)


def picture(records: Records) -> Picture:
    """For every contact: the error of the durations over the step while impacts match, then for each of its
    stops the cumulative distribution over the members; the exact one is black."""
    lines = []
    for place, group in by_contact(records.numbers).items():
        pairs = [row for row in group if row["kind"] == "pairs" and row["exact"]]
        first = Panel(f"the first contacts{place}", common.STEP,
                      Axis("largest relative error of the duration", scale="log"), _errors(pairs),
                      empty="no contact matches" if pairs else "no impact so early")  # fmt: skip
        panels = [first]
        for name in _sides(records.case, group[0]):
            rows = [row for row in group if row["kind"] == "quantile" and row["stop"] == name]
            step = next((row["dt"] for row in rows if row["method"] != "exact"), np.nan)
            marks = curves(rows, "duration", "level", "method", exact=2.2, marker="")
            marks.append(Level(step, "one time step", "x"))
            shorter = Axis("share of the contacts that are shorter", limits=(0.0, 1.0))
            panels.append(Panel(f"{name} stop{place}", Axis("duration", "time", "log"), shorter, marks,
                                empty="no contact came to an end"))  # fmt: skip
        lines.append(panels)
    return Picture(lines, 5.2 * len(lines), 5)


def _sides(case: Case, row: Row) -> list[str]:
    """The sides on which the contact of this row has a stop."""
    stops = case.system(row["form"]).contacts[row["contact_number"] - 1].stops
    return [SIDES[side] for side, _ in stops.sides]


def _errors(rows: Sequence[Row]) -> list[Mark]:
    """The largest error at any stop; hollow where some of the exact contacts have no match."""
    marks: list[Mark] = []
    for label, group in groups(rows, "method").items():
        at = {
            dt: here for dt, here in sorted(groups(group, "dt").items()) if np.any(np.isfinite(column(here, "error")))
        }
        steps, errors = np.array(list(at)), np.array([np.nanmax(column(here, "error")) for here in at.values()])
        whole = np.array([all(row["pairs"] == row["exact"] for row in group) for group in at.values()], bool)
        marks += [Curve(steps, np.where(whole, errors, np.nan), short(label), look(label)),
                  Curve(steps[~whole], errors[~whole], look=look(label) | HOLLOW)]  # fmt: skip
    if any(row["pairs"] < row["exact"] for row in rows):
        marks.append(Curve([], [], "hollow: some contacts do not match", HOLLOW | {"marker": "o", "mec": "0.35"}))
    return marks


HOLLOW = {"linestyle": "", "mfc": "white", "ms": 4.0}
STUDY = declared(
    __name__,
    "How long do contacts last, and do the contacts of the schemes last as long as the exact ones?",
    needs_motion=True,
    each_contact=True,
    smoke={"schemes": ["HHT(alpha=-0.1)"], "halvings": 3, "impacts": 2, "members": 3, "t_end": 0.4},
    needs_stops=True,
)
