"""How long contacts last: from the entry into a stop to the exit from it, at every stop.

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
from string import ascii_lowercase
from typing import TYPE_CHECKING, Annotated

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import integer
from ..figures import column, heading, log_scale, look, new_figure, numeric, say_empty, shared_legend, short
from ..files.cases import Case
from ..march.ensemble import integrate_ensemble
from ..march.integrate import integrate
from ..measures.impacts import longest_delay, match
from ..measures.report import percent
from ..model.members import SPREAD, perturbed
from ..references.ensemble import reference_ensemble
from ..trajectory.trajectory import Diverged
from .common import (
    Dt,
    End,
    Form,
    Halvings,
    ImpactCount,
    Schemes,
    afford_halvings,
    by_contact,
    first_impacts,
    scheme_labels,
    scheme_of,
    solve_once,
    system_of,
)
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIDES = {1: "upper", -1: "lower"}
LEVELS = np.linspace(0.01, 0.99, 50)  # of the cumulative distribution


def points(
    case: Case,
    schemes: Schemes = None,
    form: Form = "displacement",
    dt: Dt = None,
    t_end: End = None,
    halvings: Halvings = 10,
    impacts: ImpactCount = 4,
    members: Annotated[int, "perturbed runs of each method"] = 48,
) -> list[Point]:
    """Contact by contact at ``dt`` (the case's), dt/2, ... until the first impacts are over, as
    many as ``impacts`` says; the
    distributions at ``dt`` to ``t_end``, over ``members`` perturbed runs of every scheme and of the exact solution."""
    afford_halvings(case, halvings, dt, t_end)
    integer("members", members, 1)
    dt, t_end = case.dt if dt is None else dt, case.t_end if t_end is None else t_end
    rest = {"form": form, "t_end": t_end, "members": members}
    labels = scheme_labels(case, schemes)
    found = [{"task": "ensemble", "method": label, "dt": dt} | rest for label in ["exact", *labels]]
    end = first_impacts(case, form, impacts)
    pairs = [
        {"task": "pairs", "method": label, "dt": end / max(4, round(end / dt * 2**k))} | rest | {"t_end": end}
        for label in labels
        for k in range(halvings)
    ]
    return found + pairs


def evaluate(case: Case, point: Point) -> list[Row]:
    """Rows of matched contacts, or of an ensemble, as the point says."""
    return {"pairs": _pairs, "ensemble": _ensemble}[point["task"]](case, point)


def _pairs(case: Case, point: Point) -> list[Row]:
    """The durations of a run over the exact ones, of the contacts that match."""
    system, end = system_of(case, point["form"]), point["t_end"]
    exact = solve_once(system, case.t_end)
    run = integrate(system, scheme_of(point["method"]), point["dt"], end, every=round(end / point["dt"]))
    rows = []
    for number, (own, other) in enumerate(zip(run.contacts, exact.contacts, strict=True), 1):
        first = slice(0, match(own.impacts, other.impacts, end, longest_delay(system, case.t_end)).matched)
        found, wanted = own.impacts.take(first), other.impacts.take(first)
        for side, name in SIDES.items():
            lasting = np.nan_to_num(wanted.durations) > 0.0  # not so at rigid stops
            here = (wanted.stops == side) & lasting & np.isfinite(found.durations)
            errors = np.abs(found.durations[here] / wanted.durations[here] - 1.0)
            there = int(np.sum(other.impacts.until(end).stops == side))
            row = {"kind": "pairs", "contact_number": number, "stop": name, "exact": there, "pairs": len(errors)}
            largest = float(np.max(errors)) if len(errors) else float("nan")
            rows.append(row | {"error": largest})
    return rows


def _ensemble(case: Case, point: Point) -> list[Row]:
    """The distribution of durations over all contacts of all members, stop by stop."""
    system, t_end = system_of(case, point["form"]), point["t_end"]
    members = perturbed(system, point["members"], SPREAD, t_end=t_end)
    if point["method"] == "exact":
        many = reference_ensemble(system, t_end, members)
    else:
        many = integrate_ensemble(system, scheme_of(point["method"]), point["dt"], t_end, members)
    if np.any(np.isfinite(many.diverged)):
        raise Diverged(point["method"], float(np.nanmin(many.diverged)), "use a smaller dt")
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


def answer(rows: Rows, case: Case) -> str:
    """A sentence and a table line for every stop of every contact."""
    found = {
        (name, place): said
        for place, own in by_contact(rows).items()
        for name in SIDES.values()
        if (said := _answer([row for row in own if row["stop"] == name], case))
    }
    if not found:
        nothing = "No contact came to an end."
        return Answer(nothing, rest=nothing)
    rigid = any(contact.stops.rigid for contact in case.system(case.forms[0]).contacts)
    blows = ["An exact blow on a rigid stop takes no time, that of a scheme a step or two."] if rigid else []
    return Answer(
        " ".join([f"The {name} stop{place}: {said}" for (name, place), said in found.items()] + blows),
        [{"stop": f"{name}{place}"} | line for (name, place), said in found.items() for line in said.table],
        " ".join(
            [f"The {name} stop{place}: {said.rest}" for (name, place), said in found.items() if said.rest] + blows
        ),
    )


def _answer(rows: Rows, case: Case) -> Answer:
    """What is found at one stop; empty where no contact came to an end."""
    units = case.units
    parts, table = [], []
    for row in (row for row in rows if row["kind"] == "summary"):
        median, half = (units.measure(f"{row[name]:.2g}", "time") for name in ("median", "half_time"))
        parts.append(f"{row['method']} {row['contacts']:.4g} contacts a run of median {median}, half of the time "
                     f"in contacts of {half} and longer")  # fmt: skip
        table.append({"method": short(row["method"]), "contacts a run": f"{row['contacts']:.4g}", "median": median,
                      "half of the time from": half})  # fmt: skip
    paired = sorted((row for row in rows if row["kind"] == "pairs" and row["pairs"]), key=lambda row: -row["dt"])
    finest = {row["method"]: row for row in paired}  # the last of a method
    pairs = [
        f"at most {percent(row['error'])} with {method} ({row['pairs']} contact{'s' * (row['pairs'] > 1)})"
        for method, row in finest.items()
    ]
    sentences = ["; ".join(parts) + "."] if parts else []
    if pairs:
        dt = units.measure(format(paired[-1]["dt"], ".2g"), "time")
        sentences.append(f"Of the first contacts, at dt = {dt}, durations are off by {', '.join(pairs)}.")
    return Answer(" ".join(sentences), table, " ".join(sentences[len(sentences) - bool(pairs) :]))


def draw(records: Records) -> Figure:
    """For every contact: the error of the durations over the step while impacts match, then for each of its
    stops the cumulative distribution over the members; the exact one is black."""
    rows = numeric(records.found)
    units = records.case.units
    blocks = [
        (place, _sides(records.case, own[0]) if own else ["upper"], own) for place, own in by_contact(rows).items()
    ]
    letter = iter(ascii_lowercase)
    figure = new_figure(5.2 * len(blocks), heading(records.case, "how long contacts last, from entry to exit"))
    lines = figure.subplots(len(blocks), 1 + max(len(names) for _, names, _ in blocks), squeeze=False)
    for axes, (place, names, own) in zip(lines, blocks, strict=True):
        _errors(axes[0], [row for row in own if row["kind"] == "pairs"])
        axes[0].set(xlabel=units.label(r"step $\Delta t$", "time"), ylabel="error of the duration, largest, relative")
        axes[0].set_title(f"({next(letter)}) the first contacts{place}", loc="left")
        for axis, name in zip(axes[1:], names, strict=False):
            _distributions(axis, [row for row in own if row["kind"] == "quantile" and row["stop"] == name])
            axis.set(xlabel=units.label("duration", "time"), ylabel="share of the contacts that are shorter")
            axis.set_title(f"({next(letter)}) {name} stop{place}", loc="left")
        for axis in axes[1 + len(names) :]:
            axis.remove()
    shared_legend(figure, 5)
    return figure


def _sides(case: Case, row: Row) -> list[str]:
    """The sides on which the contact of this row has a stop."""
    stops = system_of(case, row["form"]).contacts[row["contact_number"] - 1].stops
    return [name for side, name in SIDES.items() if np.isfinite(stops.g2 if side > 0 else stops.g1)]


def _errors(axis: Axes, rows: Sequence[Row]) -> None:
    """The largest error at any stop; hollow where some of the exact contacts have no match."""
    for label in dict.fromkeys(row["method"] for row in rows):
        own: dict[float, list[Row]] = {}
        for row in (row for row in rows if row["method"] == label and row["exact"]):
            own.setdefault(row["dt"], []).append(row)
        errors_at = {dt: column(stops, "error") for dt, stops in sorted(own.items())}
        some = {dt: np.max(e[np.isfinite(e)]) for dt, e in errors_at.items() if np.any(np.isfinite(e))}
        steps, errors = np.array(list(some)), np.array(list(some.values()))
        whole = np.array([all(row["pairs"] == row["exact"] for row in own[dt]) for dt in some], bool)
        style = look(label)
        axis.plot(steps, np.where(whole, errors, np.nan), ms=4.5, lw=1.1, label=short(label), **style)
        axis.plot(steps[~whole], errors[~whole], ms=4.0, mfc="white", **dict(style, linestyle=""))
    axis.grid(color="0.92")
    if axis.get_lines() and np.isfinite(axis.dataLim.minposy):
        log_scale(axis)
        axis.plot([], [], "o", ms=4, mfc="white", mec="0.35", label="some contacts do not match")
    else:
        say_empty(axis, "no contact matches" if any(row["exact"] for row in rows) else "no impact so early")


def _distributions(axis: Axes, rows: Sequence[Row]) -> None:
    for label in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == label]
        style = dict(look(label), marker="", lw=2.2 if label == "exact" else 1.2)
        axis.plot(column(own, "duration"), column(own, "level"), label=short(label), **style)
    steps = [row["dt"] for row in rows if row["method"] != "exact"]
    if steps and np.isfinite(steps[0]):
        axis.axvline(steps[0], color="0.5", lw=0.9, ls=":", label="one step")
    axis.grid(color="0.92")
    if rows:
        log_scale(axis, y=False)
        axis.set_ylim(0.0, 1.0)
    else:
        say_empty(axis, "no contact came to an end")


STUDY = Study(
    name="contact_duration",
    question="How long do contacts last, and have the schemes' contacts the durations of the exact ones?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    needs_motion=True,
    smoke={"schemes": ["hht(alpha=-0.1)"], "halvings": 3, "impacts": 2, "members": 3, "t_end": 0.4},
    needs_stops=True,
)
