"""Convergence in time: at which rate each scheme approaches the exact solution, smooth and through contact.

A point enters the slope only where it means something: the motion is resolved, the error is above
rounding, and (in contact) every impact inside the window still has its partner.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..basics.validation import InputError
from ..figures import column, heading, log_scale, look, mark_order, new_figure, numeric, say_empty, short
from ..files.cases import Case
from ..march.integrate import integrate
from ..measures.errors import Order, observed_order, tip_error
from ..measures.impacts import impact_times, matched_until
from ..measures.smooth_motion import slowest_period, smooth_motion, without_contact
from ..model.drive import Drive
from ..model.scales import scales
from ..model.system import System
from .common import (
    Dt,
    Form,
    Halvings,
    ImpactCount,
    Schemes,
    Treatment,
    afford_halvings,
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

KINDS = ("smooth", "contact")
PER_OCTAVE = 4  # steps per halving through contact, where the error varies irregularly: the worst of an octave counts
SAMPLES = 1000  # outputs on which the error is measured
RESOLVED = 0.5  # largest (omega dt)
ASYMPTOTIC = 0.1  # largest relative error
ROUNDING = 10.0 * np.finfo(float).eps  # times the number of steps: what rounding may have added


def points(
    case: Case,
    schemes: Schemes = None,
    kinds: Annotated[list[str] | None, "smooth, contact, or both"] = None,
    form: Form = "displacement",
    dt: Dt = None,
    halvings: Halvings = 10,
    impacts: ImpactCount = 4,
    contact: Treatment = "implicit",
) -> list[Point]:
    """Steps from ``dt`` (the case's) downwards, ``halvings`` times.

    smooth: the case without stops on its slow motion, over one period of the drive or of the lowest
    mode, whichever is longer. contact: the case itself until the first impacts are over, as many as ``impacts`` says.
    """
    afford_halvings(case, halvings, dt, None)
    start = case.dt if dt is None else dt
    system = system_of(case, form)
    found: list[Point] = []
    for kind in KINDS if kinds is None else kinds:
        if kind == "smooth":
            end, per_octave = smooth_end(system, case.t_end), 1
            if not end:
                continue
        elif kind == "contact":
            if not system.contacts:
                continue
            end, per_octave = first_impacts(case, form, impacts), PER_OCTAVE
        else:
            raise InputError("kinds", kind, f"be among {KINDS}", "for example ('smooth',)")
        for label in scheme_labels(case, schemes):
            for k in range(halvings * per_octave):
                steps = max(4, round(end / start * 2.0 ** (k / per_octave)))
                octave = k // per_octave
                found.append({"kind": kind, "scheme": label, "form": form, "contact": contact, "t_end": end,
                              "steps": steps, "octave": octave})  # fmt: skip
    return list({tuple(p.items()): p for p in found}.values())


def smooth_end(system: System, t_end: float) -> float:
    """The end of a run without contact: the longest period, or 0 where the body flies freely away from its stops.

    Raises InputError where there are no stops either.
    """
    try:
        return slowest_period(without_contact(system), t_end)
    except InputError:
        if not system.contacts:
            raise
        return 0.0


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: the tip error at one step, why it does not count in the slope, or "", and the exact motion's impacts."""
    system = system_of(case, point["form"])
    if point["kind"] == "smooth":
        system = smooth_motion(system)
    steps, t_end = point["steps"], point["t_end"]
    exact = solve_once(system, t_end)
    dt = t_end / steps
    run = integrate(system, scheme_of(point["scheme"]), dt, t_end, point["contact"], every=max(1, steps // SAMPLES))
    error = tip_error(run.tip, exact.at(run.t)[0])
    fastest = max([*Drive.of(system).frequencies, 2.0 * np.pi / scales(system, case.t_end).period])
    left_out = ""
    if point["kind"] == "contact" and matched_until(run, exact, t_end) < t_end:
        left_out = "impacts differ"
    if error.rms > ASYMPTOTIC:
        left_out = left_out or "error above 10 %"
    elif fastest * dt > RESOLVED:
        left_out = "motion not resolved"
    elif error.rms < max(ROUNDING * steps, 10.0 * float(exact.provenance.get("rtol", 0.0))):
        left_out = "rounding"
    elif t_end > exact.horizon:
        left_out = "past the horizon"
    impacts = int(np.sum(impact_times(exact) <= t_end))
    return [{"dt": dt, "error_rms": error.rms, "error_max": error.max, "left_out": left_out, "impacts": impacts}]


def envelope(rows: Rows) -> tuple[list[float], list[float]]:
    """(dt, error) of the worst point of every octave whose points all count."""
    steps, errors = [], []
    for octave in sorted({r["octave"] for r in rows}):
        own = [r for r in rows if r["octave"] == octave]
        if all(not r["left_out"] for r in own):
            steps.append(max(r["dt"] for r in own))
            errors.append(max(r["error_rms"] for r in own))
    return steps, errors


def orders(rows: Rows) -> dict[tuple[str, str], Order]:
    """The observed order by (kind, scheme)."""
    keys = dict.fromkeys((r["kind"], r["scheme"]) for r in rows)
    return {key: observed_order(*envelope([r for r in rows if (r["kind"], r["scheme"]) == key])) for key in keys}


def answer(rows: Rows, case: Case) -> str:
    """The observed orders, without contact and through the first impacts, or as the motion starts without any."""
    found = orders(rows)
    start = next((row for row in rows if row["kind"] == "contact" and not row["impacts"]), None)
    through, column = "Through the first impacts", "order through the first impacts"
    if start is not None:
        through = (
            f"No impacts to t = {case.units.measure(format(start['t_end'], 'g'), 'time')}, the motion as it starts"
        )
        column = "order without impacts, as it starts"
    parts = {"smooth": "Observed orders without contact: ", "contact": f"{through} (worst of each octave): "}
    sentences = []
    for kind, head in parts.items():
        own = [f"{scheme} {order}" for (k, scheme), order in found.items() if k == kind and np.isfinite(order.slope)]
        few = [scheme for (k, scheme), order in found.items() if k == kind and not np.isfinite(order.slope)]
        missing = [f"too few points count for {', '.join(few)}"] if few else []
        if own or few:
            sentences.append(head + "; ".join([", ".join(own)] * bool(own) + missing) + ".")
    columns = {"smooth": "order without contact", "contact": column}
    kinds = [kind for kind in columns if any(k == kind for k, _ in found)]
    table = [
        {"scheme": scheme} | {columns[kind]: _shown(found.get((kind, scheme))) for kind in kinds}
        for scheme in dict.fromkeys(scheme for _, scheme in found)
    ]
    return Answer(" ".join(sentences), table, f"{through}: the worst of each octave of steps; ± holds with 95 %.")


def _shown(order: Order | None) -> str:
    if order is None:
        return "–"
    return str(order) if np.isfinite(order.slope) else "too few points"


TITLES = {"smooth": "without contact, slow motion", "contact": "through the first impacts"}
OVERFLOWN = 1e3  # an error that no longer says anything
REASONS = {"impacts differ": "o", "error above 10 %": "^", "motion not resolved": "s", "rounding": "v",
           "past the horizon": "D", "its octave has one of these": "p"}  # fmt: skip


def draw(records: Records) -> Figure:
    """Filled markers enter the slope; hollow ones do not, their shape says why."""
    rows = numeric(records.found)
    kinds = [kind for kind in TITLES if any(row["kind"] == kind for row in rows)] or ["smooth"]
    figure = new_figure(6.4, heading(records.case, "convergence in time, slopes with their 95 % intervals"))
    axes = figure.subplots(1, len(kinds), squeeze=False)[0]
    found = orders(rows)
    for axis, kind, letter in zip(axes, kinds, "ab", strict=False):
        own = [row for row in rows if row["kind"] == kind]
        reasons: dict[str, None] = {}
        for label in dict.fromkeys(row["scheme"] for row in own):
            order = found[kind, label]
            slope = str(order) if np.isfinite(order.slope) else "too few points"
            reasons |= _curve(axis, [row for row in own if row["scheme"] == label], f"{short(label)}: {slope}", order)
        for reason in sorted(reasons, key=list(REASONS).index):
            axis.plot([], [], REASONS[reason], ms=4.5, mfc="white", mec="0.35", label=f"left out: {reason}")
        log_scale(axis)
        axis.set(xlabel=records.case.units.label(r"step $\Delta t$", "time"), ylabel="tip error, rms, relative")
        axis.grid(color="0.92")
        through = kind == "smooth" or any(row["impacts"] for row in own)
        axis.set_title(f"({letter}) {TITLES[kind] if through else 'as it starts, no impacts'}", loc="left")
        if own:
            axis.margins(x=0.06, y=0.04)
            if axis.get_yscale() == "log":
                axis.set_ylim(top=min(axis.get_ylim()[1], OVERFLOWN))
            mark_order(axis, (3, 2, 1))
            axis.legend(frameon=False, fontsize=8.5, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)
        else:
            say_empty(axis)
    return figure


def _curve(axis: Axes, own: Sequence[Row], text: str, order: Order) -> dict[str, None]:
    """Points and slope of one scheme; returns the reasons met."""
    own = sorted(own, key=lambda row: row["dt"])
    style = look(own[0]["scheme"])
    counted = set(envelope(own)[0])
    octaves = {row["octave"] for row in own if row["dt"] in counted}
    reasons: dict[str, None] = {}
    axis.plot(column(own, "dt"), column(own, "error_rms"), lw=0.5, alpha=0.6, **dict(style, marker=""))
    axis.plot([], [], lw=1.3, ms=4.5, label=text, **style)
    for row in own:
        reason = row["left_out"] or ("" if row["octave"] in octaves else "its octave has one of these")
        fill: dict[str, Any] = {} if not reason else {"mfc": "white", "mec": style["color"], "marker": REASONS[reason]}
        axis.plot(row["dt"], row["error_rms"], ms=4.0, mew=0.9, **dict(style, linestyle="", **fill))
        if reason:
            reasons[reason] = None
    if np.isfinite(order.slope) and counted:
        x = np.array([min(counted), max(counted)])
        axis.plot(x, order.constant * x**order.slope, lw=1.5, **dict(style, marker=""))
    return reasons


STUDY = Study(
    name="converge",
    question="At which rate does each scheme approach the exact solution, smooth and through contact?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    smoke={"schemes": ["bdf2", "sdirk(gamma=0.4359, nystrom=true)"], "halvings": 4, "impacts": 2},
)
