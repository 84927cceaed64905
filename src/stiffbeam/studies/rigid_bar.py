"""All schemes on a rigid wall: the bouncing bar, whose solution is known in rational numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..basics.validation import InputError, integer, positive
from ..figures import COLOURS, column, log_scale, new_figure, numeric, say_empty, short
from ..files.cases import Case
from ..march.integrate import RIGID as BY_REACTIONS
from ..march.integrate import integrate
from ..measures.errors import Order, observed_order
from ..measures.report import percent
from ..model.contact import Stops
from . import bouncing_bar as bar
from .common import label_of, scheme_of
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# How the wall is made: a node with mass that an impact law turns round, one without mass, a spring.
REACTION, MASSLESS, SPRING, CONSERVING = "rigid", "massless node", "spring", "conserving spring"
WALLS = (REACTION, MASSLESS, SPRING, CONSERVING)
KAPPA = 10.0  # of the spring, in units of the stiffness of an element
ENTRIES: tuple[tuple[str, str, float | None], ...] = (
    ("trapezoidal", REACTION, None), ("hht(alpha=-0.1)", REACTION, None), ("bdf2", REACTION, None),
    ("sdirk", REACTION, None), ("bathe", REACTION, None),
    ("moreau-jean", REACTION, 0.0), ("moreau-jean", REACTION, 0.5), ("moreau-jean", REACTION, 1.0),
    ("moreau-jean-bilbao", REACTION, 0.0), ("moreau-jean-bilbao", REACTION, 1.0),
    ("paoli-schatzman", REACTION, 0.0), ("paoli-schatzman", REACTION, 1.0),
    ("contact-stabilised", REACTION, None),
    ("nonsmooth-alpha(rho=0.8)", REACTION, 0.0), ("nonsmooth-alpha(rho=1.0)", REACTION, 0.0),
    ("nonsmooth-alpha(rho=1.0)", REACTION, 1.0),
    ("trapezoidal", SPRING, None), ("trapezoidal", CONSERVING, None),
    ("trapezoidal", MASSLESS, None), ("sdirk", MASSLESS, None), ("trapezoidal conserving", MASSLESS, None),
)  # fmt: skip
PERIODS = 3
FLIGHT = 3.0  # the foot is compared until then: over the first contact and most of the flight after it
EDGE = 0.05  # of the first contact at either end, where the front of the wave is as wide as the cells


def points(
    case: Case,
    schemes: Annotated[list[str] | None, "with commas between them; default: the table of the study"] = None,
    cells: Annotated[list[int] | None, "elements, with commas between them; default: 25,50,100"] = None,
    courant: Annotated[float, "c dt/dx"] = 1.0,
    starts: Annotated[int, "runs, each begun a share of a step later"] = 32,
) -> list[Point]:
    """Every entry of the table on every mesh, at one Courant number; whatever the case is. ``schemes``: only the
    entries of these."""
    integer("starts", starts, 1)
    positive("courant", courant)
    wanted = None if schemes is None else {label_of(scheme) for scheme in schemes}
    meshes = [25, 50, 100] if cells is None else cells
    for number in meshes:
        integer("cells", number, 2)
    chosen = [entry for entry in ENTRIES if wanted is None or label_of(entry[0].removesuffix(" conserving")) in wanted]
    if not chosen:
        raise InputError("schemes", schemes, "be among those of the study", ", ".join(sorted({e[0] for e in ENTRIES})))
    return [
        {
            "scheme": label_of(scheme.removesuffix(" conserving")), "wall": wall,
            "conserving": scheme.endswith(" conserving") or wall == CONSERVING, "restitution": e, "cells": int(number),
            "courant": float(courant), "starts": starts,
        }
        for scheme, wall, e in chosen
        for number in meshes
    ]  # fmt: skip


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row per start."""
    cells, wall = point["cells"], point["wall"]
    dt = point["courant"] * bar.LENGTH / (cells * bar.SPEED)
    steps = int(np.ceil(float(PERIODS * bar.PERIOD) / dt - 1e-9))
    scheme = scheme_of(point["scheme"])
    stiffness = np.inf if wall in (REACTION, MASSLESS) else KAPPA * bar.MODULUS * cells / bar.LENGTH
    stops = Stops(lower=0.0, stiffness=stiffness, restitution=point["restitution"])
    found = []
    for start in range(point["starts"]):
        fallen = dt * start / point["starts"]
        system = bar.bar(cells, stops, fallen)
        whole = system.massless_contacts() if wall == MASSLESS else system
        run = integrate(whole, scheme, dt, steps * dt, contact="conserving" if point["conserving"] else "implicit")
        # A reaction is the mean over the step before.
        centre = 0.5 * dt if run.provenance["march"] == BY_REACTIONS else 0.0
        t, force, height = run.t + fallen, run.contact_force, run.contacts[0].position
        node = np.maximum(height, 0.0) if wall == MASSLESS else height
        within = (t - centre > 1.0 + EDGE) & (t - centre < 5.0 / 3.0 - EDGE)
        early = t <= FLIGHT
        energy = run.energy
        found.append(
            {
                "start": start,
                "energy": float((energy.energy[-1] - energy.energy[0] - energy.input[-1]) / bar.ENERGY),
                "by_impacts": float(energy.stop_dissipation[-1] / bar.ENERGY),
                "by_scheme": float(energy.loss[-1] / bar.ENERGY),
                "pressure": float(np.sqrt(np.mean((force - bar.pressure(t - centre))[within] ** 2)) / 400.0),
                "penetration": float(max(0.0, -np.min(node)) / bar.HEIGHT),
                "foot": float(np.mean(np.abs(node - bar.foot(t))[early]) / bar.HEIGHT),
                "impacts": run.impacts.count,
            }
        )
    return found


def name_of(row: Row) -> str:
    """An entry in words."""
    e = row.get("restitution")
    impact = "" if e is None or np.isnan(e) else f", e = {e:g}"
    scheme = short(row["scheme"]) + (" conserving" if row["conserving"] and row["wall"] == MASSLESS else "")
    return f"{scheme}{impact}" + ("" if row["wall"] == REACTION else f", {row['wall']}")


def _entries(rows: Rows) -> dict[str, list[dict[str, Any]]]:
    grouped: dict[str, list[dict[str, Any]]] = {}
    for row in numeric(rows):
        grouped.setdefault(name_of(row), []).append(row)
    return grouped


def _finest(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    most = max(row["cells"] for row in rows)
    return [row for row in rows if row["cells"] == most]


def _middle(rows: list[dict[str, Any]], name: str) -> float:
    values = column(rows, name)
    return float(np.median(values[np.isfinite(values)])) if np.any(np.isfinite(values)) else float("nan")


def _order(rows: list[dict[str, Any]], name: str) -> Order | None:
    """The observed order, None where there is one mesh only."""
    kept = [row for row in rows if row[name] > 0.0]
    if len({row["cells"] for row in kept}) < 2:
        return None
    return observed_order([1.0 / row["cells"] for row in kept], [row[name] for row in kept])


def answer(rows: Rows, case: Case) -> str:
    """Errors of energy, pressure, penetration and foot on the finest grid, for every scheme and wall."""
    parts, table = [], []
    for name, own in _entries(rows).items():
        fine = _finest(own)
        table.append({
            "scheme": name,
            "energy": f"{percent(_middle(fine, 'energy'), '+')}",
            "pressure off": percent(_middle(fine, 'pressure')),
            "penetration": percent(_middle(fine, 'penetration')),
            "foot off": percent(_middle(fine, 'foot')),
            "order": str(_order(own, "foot") or "–"),
        })  # fmt: skip
        parts.append(
            f"{name}: energy {percent(_middle(fine, 'energy'), '+')}, pressure {percent(_middle(fine, 'pressure'))} "
            f"off, penetration {percent(_middle(fine, 'penetration'))}, foot {percent(_middle(fine, 'foot'))} "
            f"of the fall off, order {_order(own, 'foot') or '–'}"
        )
    if not parts:
        return "Nothing was found."
    count = max(row["cells"] for row in rows)
    head = f"The bouncing bar on {count} elements after {PERIODS} periods (medians over starts)"
    return Answer(f"{head}: {'; '.join(parts)}.", table, f"{head}; penetration and foot as shares of the fall.")


# Key, axis, title, and what counts as nothing: smaller values stand there.
PANELS = (
    ("energy", "|change|/(M g h), hollow: gained", "energy, 3 periods", 1e-12),
    ("pressure", "rms error/400", "contact pressure", 1e-6),
    ("penetration", "deepest/fall, left: none", "penetration", 1e-4),
    ("foot", "mean error/fall", "height of the foot", 1e-6),
)


def draw(records: Records) -> Figure:
    """A line per entry: the median and the range over the starts, on every mesh; the finest is filled dark."""
    entries = _entries(records.found)
    names = list(entries)
    figure = new_figure(1.6 + 0.3 * max(4, len(names)))
    figure.suptitle("A bar bounces on a rigid wall: what each scheme makes of it, from few elements (light) to many")
    for axis, (key, words, title, least), letter in zip(
        figure.subplots(1, 4, sharey=True), PANELS, "abcd", strict=True
    ):
        for i, name in enumerate(names):
            meshes = sorted({row["cells"] for row in entries[name]})
            colour = COLOURS[WALLS.index(entries[name][0]["wall"])]
            for k, cells in enumerate(meshes):
                values = column([row for row in entries[name] if row["cells"] == cells], key)
                values = values[np.isfinite(values)]
                if not len(values):
                    continue
                sizes = np.maximum(np.abs(values), least)
                at = i + 0.22 * (k - 0.5 * (len(meshes) - 1))
                shade = 0.35 + 0.65 * (k + 1) / len(meshes)
                middle = float(np.median(values))
                axis.plot([sizes.min(), sizes.max()], [at, at], color=colour, lw=1.2, alpha=shade)
                hollow = key == "energy" and middle > 0.0
                axis.plot(
                    np.median(sizes), at, "o", ms=4.5, color=colour, alpha=shade, mfc="white" if hollow else colour
                )
            if key == "foot":
                order = _order(entries[name], key)
                text = f"order {order.slope:.1f}" if order else ""
                axis.annotate(text, (1.02, i), xycoords=("axes fraction", "data"), fontsize=8, va="center")
        log_scale(axis, y=False)
        axis.set(xlabel=words)
        axis.set_title(f"({letter}) {title}", loc="left", fontsize=10)
        axis.grid(axis="x", color="0.92")
        axis.set_yticks(range(len(names)), names, fontsize=9)
        axis.set_ylim(len(names) - 0.4, -0.6)
        if not names:
            say_empty(axis)
    return figure


STUDY = Study(
    name="rigid_bar",
    question="A bar bounces on a rigid wall: which scheme keeps its energy, and which finds the pressure?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    smoke={"schemes": ["moreau-jean", "trapezoidal"], "cells": [10, 20], "starts": 2},
)
