"""Impacts: how many each scheme counts as its step shrinks, how hard, how long, against the exact ones.

Past the horizon one count is one realisation of a chaotic motion. Counts are therefore means over perturbed
members, of the schemes as of the exact solution; the exact motion is one realisation as well, known to the end
where a multiprecision solution is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Annotated

import numpy as np

from ..basics.arrays import Array
from ..basics.units import Units
from ..basics.validation import integer
from ..figures import (
    MARKERS,
    column,
    dashed,
    heading,
    log_scale,
    look,
    new_figure,
    numeric,
    say_empty,
    shared_legend,
    short,
)
from ..files.cases import Case
from ..march.ensemble import integrate_ensemble
from ..march.integrate import integrate
from ..measures.impacts import longest_delay, match
from ..measures.report import percent
from ..model.members import SPREAD, perturbed
from ..references.ensemble import reference_ensemble
from ..schemes import HHT, SDIRK
from ..trajectory.ensemble import Ensemble
from ..trajectory.trajectory import Diverged, Reference
from . import common
from .common import Dt, End, Form, Halvings, Schemes, by_contact, scheme_labels, scheme_of, solve_once, system_of
from .engine.study import Answer, Point, Records, Row, Rows, Study
from .references import frozen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REFERENCE = "reference"  # in the place of a scheme: the exact motion, sampled
EXACT = "exact"  # the ensemble of exact solutions


def points(
    case: Case,
    schemes: Schemes = None,
    form: Form = "displacement",
    dt: Dt = None,
    halvings: Halvings = 7,
    t_end: End = None,
    members: Annotated[int, "perturbed runs behind each mean"] = 24,
    sensitivity: Annotated[bool, "also over alpha, gamma and the contact treatment"] = True,
    references: Annotated[
        str | None, "folder of frozen references; default: ./reference, else those of the package"
    ] = None,
) -> list[Point]:
    """Every scheme at ``dt`` (the case's), dt/2, ...; with ``sensitivity`` also HHT over alpha, SDIRK-OS
    over gamma and the extrapolated contact, at ``dt``. members: perturbed runs of each, eight times as many of
    the exact solution. references: a folder of frozen multiprecision solutions, from which the exact
    counts are taken; else they are float64's.
    """
    integer("members", members, 1)
    common.afford_halvings(case, halvings, dt, t_end)
    dt, t_end = case.dt if dt is None else dt, case.t_end if t_end is None else t_end
    rest = {"form": form, "t_end": t_end, "references": references, "members": members}
    labels = scheme_labels(case, schemes)
    found = [{"scheme": EXACT, "contact": "implicit", "dt": 0.0, "purpose": "step"} | rest]
    found += [
        {"scheme": label, "contact": "implicit", "dt": dt / 2**k, "purpose": "step"} | rest
        for label in [REFERENCE, *labels]
        for k in range(halvings)
    ]
    if sensitivity:
        family = [*(HHT(a) for a in (0.0, -0.05, -0.1, -0.2, -0.3)), *(SDIRK(g) for g in (0.2, 0.35, 0.4359, 0.8, 1.0))]
        family = [scheme for scheme in family if common.takes(case, scheme)]
        found += [{"scheme": str(s), "contact": "implicit", "dt": dt, "purpose": "parameter"} | rest for s in family]
        moved = labels if common.takes_extrapolation(case) else []
        found += [{"scheme": s, "contact": "extrapolated", "dt": dt, "purpose": "contact"} | rest for s in moved]
    return found


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row for each contact: counts, forces and impulses of one scheme, of the exact ensemble or of a reference."""
    system = system_of(case, point["form"])
    dt, t_end = point["dt"], point["t_end"]
    if point["scheme"] == EXACT:
        return _statistics(
            reference_ensemble(system, t_end, perturbed(system, 8 * point["members"], SPREAD, t_end=t_end))
        )
    exact = reference_solution(case, point)
    if point["scheme"] == REFERENCE:
        # What a perfect scheme would count with this step: the sampled rule on the exact position, which never
        # passes a rigid stop.
        return [
            {
                "contact_number": i + 1,
                "count": np.nan if record.stops.rigid else exact.impacts_sampled(dt, t_end, i).count,
                "fraction": record.fraction, "peak_force": record.peak_force, "impulse": record.impulse,
            }
            for i, record in enumerate(exact.contacts)
        ]  # fmt: skip
    scheme, members = scheme_of(point["scheme"]), perturbed(system, point["members"], SPREAD, t_end=t_end)
    many = integrate_ensemble(system, scheme, dt, t_end, members, point["contact"])
    if np.any(np.isfinite(many.diverged)):
        raise Diverged(point["scheme"], float(np.nanmin(many.diverged)), "use the implicit contact or a smaller dt")
    horizon = min(t_end, solve_once(system, t_end).horizon)
    steps = max(2, round(horizon / dt))
    run = integrate(system, scheme, dt, steps * dt, point["contact"], every=steps)
    rows = _statistics(many)
    for row, own, record in zip(rows, run.contacts, exact.contacts, strict=True):
        row |= asdict(match(own.impacts, record.impacts, horizon, longest_delay(system, horizon)))
        row |= {
            "horizon": horizon,
            "reference_count": record.impacts.until(t_end).count,
            "reference_fraction": record.fraction,
            "reference_digits": exact.provenance.get("digits") or 0,
        }
    return rows


def _statistics(many: Ensemble) -> list[Row]:
    """At each contact means over the members, the spread of the count, and the median peak of all impacts."""
    return [
        {
            "contact_number": i,
            "count": float(np.mean(seen.impact_count)),
            "count_spread": float(np.std(seen.impact_count, ddof=1)) if len(many) > 1 else float("nan"),
            "fraction": float(np.mean(seen.fraction)),
            "peak_force": float(np.mean(seen.peak_force)),
            "impulse": float(np.mean(seen.impulse)),
            "median_peak": _median(seen.impacts.peaks),
        }
        for i, seen in enumerate(many.contacts, 1)
    ]


def _median(peaks: Array) -> float:
    """Of the impacts that are over."""
    peaks = peaks[np.isfinite(peaks)]
    return float(np.median(peaks)) if len(peaks) else float("nan")


def reference_solution(case: Case, point: Point) -> Reference:
    """The frozen multiprecision solution where there is one over the span, else float64's exact one."""
    if point["references"] is not None:
        found = frozen(Path(point["references"]), case, point["form"], point["t_end"])
        if found is not None:
            return found
    return solve_once(system_of(case, point["form"]), point["t_end"])


def right_from(rows: Rows, scheme: str, tolerance: float = 0.05) -> float:
    """The largest step from which on the count is exact to ``tolerance`` and the 95 % interval; NaN where none is."""
    exact = next((r for r in rows if r["scheme"] == EXACT), None)
    if exact is None:
        return float("nan")
    own = sorted((r for r in rows if r["scheme"] == scheme and r["purpose"] == "step"), key=lambda r: r["dt"])
    largest = float("nan")
    for row in own:
        spreads = row["count_spread"] ** 2 / row["members"] + exact["count_spread"] ** 2 / (8 * exact["members"])
        if abs(row["count"] - exact["count"]) > tolerance * exact["count"] + 1.96 * np.sqrt(spreads):
            break
        largest = row["dt"]
    return largest


def answer(rows: Rows, case: Case) -> str:
    """What each scheme counts at its largest step and from which step on it is right, contact by contact."""
    return common.joined({place: _answer(own, case) for place, own in by_contact(rows).items()})


def _answer(rows: Rows, case: Case) -> str:
    """What is found at one contact."""
    units = case.units
    steps = [r for r in rows if r["purpose"] == "step" and r["scheme"] not in (REFERENCE, EXACT)]
    exact = next((r for r in rows if r["scheme"] == EXACT), None)
    if not steps or exact is None:
        return f"Without {'schemes' if exact else 'exact members'} there is nothing to compare at {len(rows)} points."
    if not any(row["count"] for row in (exact, *steps)):
        return "No impact, neither of the exact motion nor of a run: there is nothing to count."
    coarse, first, digits = max(r["dt"] for r in steps), steps[0], steps[0]["reference_digits"]
    float64 = f"in float64{', one realisation,' if exact['count_spread'] else ''}"
    known = f"The exact motion {f'({digits} digits, parameters as written)' if digits else float64}"
    parts, table = [], []
    for row in (r for r in steps if r["dt"] == coarse):
        largest = right_from(rows, row["scheme"])
        found = np.isfinite(largest)
        limit = largest if found else min(r["dt"] for r in steps if r["scheme"] == row["scheme"])
        at = f"dt = {units.measure(format(limit, '.2g'), 'time')}"
        right = f"from {at} on" if found else f"not yet at {at}"
        count, share = f"{row['count']:.4g}", percent(row["fraction"])
        parts.append(f"{row['scheme']} {count} and {share}, right to 5 % {right}")
        table.append({"scheme": short(row["scheme"]), "impacts": count, "in contact": share, "right to 5 %": right})
    end, step = (units.measure(f"{x:g}", "time") for x in (rows[0]["t_end"], coarse))
    head = (
        f"{known} has {first['reference_count']} impacts to t = {end}, the exact ensemble "
        f"{exact['count']:.4g} ± {exact['count_spread']:.2g} and {percent(exact['fraction'])} of the time in "
        f"contact; {_runs(first['members'])} at dt = {step}"
    )
    return Answer(f"{head}: {'; '.join(parts)}.", table, f"{head}.")


def _runs(members: int) -> str:
    return f"means over {members} runs whose starts differ by {SPREAD:g}" if members > 1 else "one run each"


OVER_STEP = (
    ("count", "impacts counted", "how many", 1.0),
    ("fraction", "time in contact, per cent", "how long", 100.0),
    ("peak_force", "largest contact force", "how hard", 1.0),
)
PARAMETERS = {"hht": ("alpha", "HHT over -α", -1.0), "sdirk": ("gamma", "SDIRK-OS over γ", 1.0)}


def draw(records: Records) -> Figure:
    """For each contact, above: over the step, with the exact values in black. Below: how long the impacts are
    the exact ones, and at the coarsest step what parameters and the treatment of the contact do."""
    rows = numeric(records.found)
    blocks = by_contact(rows)
    units = records.case.units
    span = f"to t = {units.measure(format(rows[0]['t_end'], 'g'), 'time')}, " if rows else ""
    digits = max((row.get("reference_digits", 0) for row in rows), default=0)
    known = f"{digits} digits" if digits else "float64"
    runs = _runs(rows[0]["members"]) if rows else "no runs"
    figure = new_figure(7.8 * len(blocks), heading(records.case, f"{span}{runs}; in black the exact motion ({known})"))
    axes = figure.subplots(2 * len(blocks), 3, width_ratios=(1.5, 1.0, 1.0), height_ratios=(1.4, 1.0) * len(blocks))
    for i, (place, own) in enumerate(blocks.items()):
        treated = by_contact([row for row in records.rows if row["purpose"] == "contact"]).get(place, [])
        _block(axes[2 * i : 2 * i + 2], own, treated, units, place, ascii_lowercase[6 * i :])
    shared_legend(figure, 5, [*axes[0::2].ravel(), *axes[1::2, 0]])  # the other panels have their own
    return figure


def _block(axes: Array, rows: Sequence[Row], treated: Sequence[Row], units: Units, place: str, letters: str) -> None:
    """The six panels of one contact, lettered in order."""
    runs = [row for row in rows if row["purpose"] == "step" and row["scheme"] not in (REFERENCE, EXACT)]
    sampled = [row for row in rows if row["scheme"] == REFERENCE]
    for axis, (name, words, title, factor), letter in zip(axes[0], OVER_STEP, letters[:3], strict=True):
        _over_step(axis, runs, name, factor)
        _exact_values(axis, runs, sampled, name, factor)
        _exact_ensemble(axis, [row for row in rows if row["scheme"] == EXACT], name, factor)
        axis.set(ylabel=units.label(words, "force") if name == "peak_force" else words)
        axis.set_title(f"({letter}) {title}{place}", loc="left")
        axis.set_ylim(0.0, 1.05 * axis.get_ylim()[1])
    _over_step(axes[1, 0], runs, "matched_until", 1.0)
    axes[1, 0].set(ylabel=units.label("exact impacts followed to $t$", "time"))
    axes[1, 0].set_title(f"({letters[3]}) how far they match{place}", loc="left")
    if runs:
        axes[1, 0].axhline(runs[0]["horizon"], color="black", lw=1.2, ls=":", label="horizon of float64")
    for axis in (*axes[0], axes[1, 0]):
        axis.set(xlabel=units.label(r"step $\Delta t$", "time"))
    count = runs[0]["reference_count"] if runs else float("nan")
    _over_parameters(axes[1, 1], [row for row in rows if row["purpose"] == "parameter"], count, units)
    _contact(axes[1, 2], runs, treated, count, units)
    for axis, letter, words in zip(axes[1, 1:], letters[4:6], ("over the parameter", "how treated"), strict=True):
        axis.set_title(f"({letter}) {words}{place}", loc="left")
    for axis in axes.ravel():
        if not axis.get_lines() and not axis.patches:
            say_empty(axis, "not asked for" if runs else "no point could be evaluated")


def _over_step(axis: Axes, runs: Sequence[Row], name: str, factor: float) -> None:
    for label in dict.fromkeys(row["scheme"] for row in runs):
        own = sorted((row for row in runs if row["scheme"] == label), key=lambda row: row["dt"])
        axis.plot(column(own, "dt"), factor * column(own, name), ms=4.5, lw=1.1, label=short(label), **look(label))
    log_scale(axis, y=False)
    axis.grid(color="0.92")


def _exact_values(axis: Axes, runs: Sequence[Row], sampled: Sequence[Row], name: str, factor: float) -> None:
    own = sorted(sampled, key=lambda row: row["dt"])
    if name == "count":
        axis.plot(
            column(own, "dt"), column(own, name), ms=6, lw=1.1, label="exact, sampled at the steps", **look(REFERENCE)
        )
        value = runs[0]["reference_count"] if runs else float("nan")
    else:
        value = factor * column(own, name)[0] if own else float("nan")
    if np.isfinite(value):
        axis.axhline(value, color="black", lw=1.6, label="exact")


def _exact_ensemble(axis: Axes, exact: Sequence[Row], name: str, factor: float) -> None:
    """The mean over exact members as a dotted line, with the spread of the count as a band."""
    for row in exact:
        mean = factor * row[name]
        if name == "count":
            low, high = mean - row["count_spread"], mean + row["count_spread"]
            axis.axhspan(low, high, color="0.85", lw=0, zorder=0, label="exact members, mean ± spread")
        axis.axhline(mean, color="0.3", lw=1.2, ls=":", zorder=1)


def _over_parameters(axis: Axes, rows: Sequence[Row], count: float, units: Units) -> None:
    for i, (name, (parameter, text, sign)) in enumerate(PARAMETERS.items()):
        own = [row for row in rows if scheme_of(row["scheme"]).name == name]
        points = sorted((sign * scheme_of(row["scheme"]).parameters[parameter], row["count"]) for row in own)
        if points:
            k = list(PARAMETERS).index(name)
            axis.plot(*np.array(points).T, marker=MARKERS[2 - k], ms=4.5, lw=1.1, ls=dashed(i), label=text,
                      color=look(name)["color"])  # fmt: skip
    if rows:
        axis.axhline(count, color="black", lw=1.6)
        dt = units.measure(f"{rows[0]['dt']:g}", "time")
        axis.set(xlabel=f"parameter, at Δt = {dt}", ylabel="impacts counted", ylim=(0.0, 1.08 * axis.get_ylim()[1]))
        axis.grid(color="0.92")
        axis.legend(frameon=False, fontsize=8.5)


def _contact(axis: Axes, runs: Sequence[Row], treated: Sequence[Row], count: float, units: Units) -> None:
    """Implicit beside extrapolated contact at the same step, a cross where it overflowed."""
    schemes = [row["scheme"] for row in treated]
    if not schemes:
        return
    dt = treated[0]["dt"]
    implicit = {row["scheme"]: row["count"] for row in runs if row["dt"] == dt}
    places = np.arange(len(schemes))
    heights = [implicit.get(s, np.nan) for s in schemes]
    axis.bar(places - 0.2, heights, 0.38, color="0.3", label="implicit")
    axis.bar(places + 0.2, column(treated, "count"), 0.38, color="0.75", hatch="///", edgecolor="white",
             label="extrapolated")  # fmt: skip
    failed = [i for i, row in enumerate(treated) if "failed" in row]
    if failed:
        bottom = np.zeros(len(failed))
        axis.plot(places[failed] + 0.2, bottom, "x", ms=8, mew=2, color="black", clip_on=False, label="overflowed")
    axis.axhline(count, color="black", lw=1.6)
    axis.set_xticks(places, [short(s) for s in schemes], rotation=35, ha="right", fontsize=8.5)
    counts = [*heights, *column(treated, "count"), count]
    axis.set(ylabel="impacts counted", ylim=(0.0, 1.45 * max((c for c in counts if np.isfinite(c)), default=1.0)))
    axis.set(xlabel=f"treatment of contact, at Δt = {units.measure(format(dt, 'g'), 'time')}")
    axis.legend(frameon=False, fontsize=8.5)


STUDY = Study(
    name="impacts",
    question="How many impacts does each scheme count, and from which step on is the count right?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    needs_motion=True,
    needs_stops=True,
    smoke={"schemes": ["hht(alpha=-0.1)"], "halvings": 2, "t_end": 0.2, "members": 3, "sensitivity": False},
)
