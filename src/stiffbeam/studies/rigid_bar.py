"""All schemes on a rigid wall: the elastic bar that bounces under gravity, with its solution in rational numbers.

E = 900, rho = 1, L = 10, so that c = 30; gravity 10, dropped at rest from 5: it lands at t = 1 with speed 10, stays
for 2L/c = 2/3 and flies again, with period 16/3. Source: Doyen, Ern and Piperno, SIAM J. Sci. Comput. 33 (2011)
223-249, their second test.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import Annotated

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..figures.chart import COLOURS, Axis, Curve, Mark, Note, Panel, Picture, Ranges, column, groups, short
from ..files.cases import Case
from ..march.integrate import RIGID as BY_REACTIONS
from ..march.integrate import integrate
from ..measures.report import DASH, percent
from ..model.contact import Contact, Stops
from ..model.system import System
from ..model.time_functions import Constant
from .common import Cells, extremes, label_of, order_over, scheme_of
from .interface import Answer, Point, Records, Row, Rows, declared

SPEED, LENGTH, MODULUS, GRAVITY, HEIGHT = 30, 10, 900, 10, 5
PERIOD = Fraction(16, 3)
ENERGY = 500.0  # M g h, all that there is
SEGMENT = Fraction(1, 3)  # between changes of the contact or of the waves' slope
# How the wall is made: a node with mass that an impact law turns round, or a spring.
REACTION, SPRING, CONSERVING = "rigid", "spring", "conserving spring"
WALLS = (REACTION, SPRING, CONSERVING)
KAPPA = 10.0  # of the spring, in units of the stiffness of an element
ENTRIES: tuple[tuple[str, str, float | None], ...] = (
    ("Trapezoidal", REACTION, None), ("HHT(alpha=-0.1)", REACTION, None), ("BDF2", REACTION, None),
    ("SDIRK", REACTION, None), ("Bathe", REACTION, None),
    ("MoreauJean", REACTION, 0.0), ("MoreauJean", REACTION, 0.5), ("MoreauJean", REACTION, 1.0),
    ("MoreauJeanBilbao", REACTION, 0.0), ("MoreauJeanBilbao", REACTION, 1.0),
    ("PaoliSchatzman", REACTION, 0.0), ("PaoliSchatzman", REACTION, 1.0),
    ("ContactStabilisedNewmark", REACTION, None),
    ("NonsmoothGeneralisedAlpha(rho=0.8)", REACTION, 0.0), ("NonsmoothGeneralisedAlpha(rho=1.0)", REACTION, 0.0),
    ("NonsmoothGeneralisedAlpha(rho=1.0)", REACTION, 1.0),
    ("Trapezoidal", SPRING, None), ("Trapezoidal", CONSERVING, None),
)  # fmt: skip
PERIODS = 3
FLIGHT = 3.0  # the foot is compared until then: over the first contact and most of the flight after it
EDGE = 0.05  # of the first contact at either end, where the front of the wave is as wide as the cells


def points(
    case: Case,
    schemes: Annotated[list[str] | None, "comma-separated; default: all in the table"] = None,
    cells: Cells = None,
    courant: Annotated[float, "Courant number c dt/dx"] = 1.0,
    starts: Annotated[int, "number of runs, each started a fraction of a step later"] = 32,
) -> list[Point]:
    """Every scheme on every mesh, by default of 25, 50 and 100 elements, at one Courant number.

    The result does not depend on the case.
    """
    wanted = None if schemes is None else {label_of(scheme) for scheme in schemes}
    meshes = [25, 50, 100] if cells is None else cells
    chosen = [entry for entry in ENTRIES if wanted is None or label_of(entry[0]) in wanted]
    if not chosen:
        raise InputError("schemes", schemes, "be among those of the study", ", ".join(sorted({e[0] for e in ENTRIES})))
    return [
        {
            "scheme": label_of(scheme), "wall": wall,
            "conserving": wall == CONSERVING, "restitution": e, "cells": int(number),
            "courant": float(courant), "starts": starts,
        }
        for scheme, wall, e in chosen
        for number in meshes
    ]  # fmt: skip


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row per start."""
    cells, wall = point["cells"], point["wall"]
    dt = point["courant"] * LENGTH / (cells * SPEED)
    steps = int(np.ceil(float(PERIODS * PERIOD) / dt - 1e-9))
    scheme = scheme_of(point["scheme"])
    stiffness = np.inf if wall == REACTION else KAPPA * MODULUS * cells / LENGTH
    stops = Stops(lower=0.0, stiffness=stiffness, restitution=point["restitution"])
    rows = []
    for start in range(point["starts"]):
        # The starts differ by less than a step, so that the impact lies at another place of its step in each.
        fallen = dt * start / point["starts"]
        system = bouncing_bar(cells, stops, fallen)
        run = integrate(system, scheme, dt, steps * dt, contact="conserving" if point["conserving"] else "implicit")
        # A reaction is the mean over the step before.
        centre = 0.5 * dt if run.provenance["march"] == BY_REACTIONS else 0.0
        t, force, node = run.t + fallen, run.contact_force, run.contacts[0].position
        within = (t - centre > 1.0 + EDGE) & (t - centre < 5.0 / 3.0 - EDGE)
        early = t <= FLIGHT
        energy = run.energy
        rows.append(
            {
                "start": start,
                "energy": float((energy.energy[-1] - energy.energy[0] - energy.input[-1]) / ENERGY),
                "by_impacts": float(energy.stop_dissipation[-1] / ENERGY),
                "by_scheme": float(energy.loss[-1] / ENERGY),
                "pressure": float(np.sqrt(np.mean((force - pressure(t - centre))[within] ** 2)) / 400.0),
                "penetration": float(max(0.0, -np.min(node)) / HEIGHT),
                "foot": float(np.mean(np.abs(node - foot(t))[early]) / HEIGHT),
                "impacts": run.impacts.count,
            }
        )
    return rows


def bouncing_bar(cells: int, stops: Stops, fallen: float = 0.0) -> System:
    """Linear elements with lumped masses over stops at 0, falling for the time ``fallen`` already."""
    dx = LENGTH / cells
    mass = np.full(cells + 1, dx)
    mass[[0, -1]] *= 0.5
    ends = np.r_[1.0, np.full(cells - 1, 2.0), 1.0]
    stiffness = MODULUS / dx * (np.diag(ends) - np.eye(cells + 1, k=1) - np.eye(cells + 1, k=-1))
    return System.from_matrices(
        np.diag(mass),
        stiffness,
        loads=[(-GRAVITY * mass, Constant(1.0))],
        contacts=[Contact(np.eye(cells + 1)[0], stops, Constant(float(HEIGHT)))],
        initial_displacement=np.full(cells + 1, -0.5 * GRAVITY * fallen**2),
        initial_velocity=np.full(cells + 1, -GRAVITY * fallen),
    )


def foot(t: Array) -> Array:
    """The exact height of the foot at times t >= 0."""
    s, (wave, slope, closed, height) = _at(t)
    return np.where(closed, 0.0, height + wave * s + 0.5 * slope * s**2)


def pressure(t: Array) -> Array:
    """The exact force on the wall."""
    s, (wave, slope, closed, _) = _at(t)
    return np.where(closed, -(MODULUS / SPEED) * (wave + slope * s), 0.0)


def _at(t: Array) -> tuple[Array, Array]:
    t = np.asarray(t, float)
    k = np.floor(t / float(SEGMENT) + 1e-12).astype(int)
    return t - k * float(SEGMENT), np.array(segments(int(np.max(k, initial=0)) + 1), float)[k].T


@lru_cache
def segments(count: int) -> tuple[tuple[Fraction, Fraction, bool, Fraction], ...]:
    """(wave, slope, closed, height) at the starts k/3 of the segments, by characteristics.

    ``wave`` is v + c u_x, which comes down to the foot: what went up 2L/c before, turned round at the free top, less
    2L/c g. Free, the foot moves by it, v = wave, and sends it up again; on the wall v = 0, it sends up -wave, and the
    force is -(E/c) wave, as long as that presses.
    """
    states: list[tuple[Fraction, Fraction, bool, Fraction]] = []
    height = Fraction(HEIGHT)
    for k in range(count):
        wave, slope = -GRAVITY * SEGMENT * k, Fraction(-GRAVITY)
        if k >= 2:
            before, slope_before, was_closed, _ = states[k - 2]
            sign = -1 if was_closed else 1
            wave, slope = sign * before - Fraction(2 * LENGTH * GRAVITY, SPEED), sign * slope_before
        closed = height == 0 and (wave < 0 or (wave == 0 and slope < 0))
        states.append((wave, slope, closed, height))
        if not closed:
            height += wave * SEGMENT + slope * SEGMENT**2 / 2
    return tuple(states)


def name_of(row: Row) -> str:
    """An entry in words."""
    e = row.get("restitution")
    impact = "" if e is None or np.isnan(e) else f", e = {e:g}"
    scheme = short(row["scheme"])
    return f"{scheme}{impact}" + ("" if row["wall"] == REACTION else f", {row['wall']}")


def _entries(rows: Rows) -> dict[str, list[Row]]:
    return groups([row | {"entry": name_of(row)} for row in rows], "entry")


def _middle(rows: Rows, name: str) -> float:
    """The median over the starts on the finest mesh."""
    finest = max(row["cells"] for row in rows)
    values = column([row for row in rows if row["cells"] == finest], name)
    return float(np.median(values[np.isfinite(values)])) if np.any(np.isfinite(values)) else float("nan")


def _width(row: Row) -> float:
    """The width of an element, as a share of the bar's length."""
    return 1.0 / row["cells"]


def answer(rows: Rows, case: Case) -> Answer:
    """Errors of energy, pressure, penetration and foot on the finest mesh, for every scheme and wall."""
    entries = _entries(rows)
    off = extremes({name: _middle(group, "pressure") for name, group in entries.items()}, percent)
    energy = extremes({name: _middle(group, "energy") for name, group in entries.items()}, lambda x: percent(x, "+"))
    return Answer(
        f"On {max(row['cells'] for row in rows)} elements the energy changes by {energy} in {PERIODS} periods; the "
        f"pressure is off by {off}.",
        [
            {
                "scheme": name,
                "energy": percent(_middle(group, "energy"), "+"),
                "pressure off": percent(_middle(group, "pressure")),
                "penetration": percent(_middle(group, "penetration")),
                "foot off": percent(_middle(group, "foot")),
                "order": str(order) if np.isfinite((order := order_over(group, _width, "foot")).slope) else DASH,
            }
            for name, group in entries.items()
        ],
        "Medians over the starts. Penetration, and foot, the mean error of the height of the lower end, as shares of "
        "the fall. Order of the foot.",
    )


# Column, axis, title, and the size below which a value counts as nothing and stands there.
PANELS = (
    ("energy", "|change|/(M g h), hollow: gained", "energy", 1e-12),
    ("pressure", "rms error/400", "contact pressure", 1e-6),
    ("penetration", "deepest/fall, left: none", "penetration", 1e-4),
    ("foot", "mean error/fall", "height of the foot", 1e-6),
)


def picture(records: Records) -> Picture:
    """A line per entry: the median and the range over the starts, on every mesh; the finest is filled dark."""
    entries = _entries(records.numbers)
    panels = []
    for name, words, title, least in PANELS:
        marks: list[Mark] = []
        for i, group in enumerate(entries.values()):
            colour = COLOURS[WALLS.index(group[0]["wall"])]
            meshes = groups(sorted(group, key=lambda row: row["cells"]), "cells").values()
            for k, mesh in enumerate(meshes):
                values = column(mesh, name)
                values = values[np.isfinite(values)]
                if not len(values):
                    continue
                sizes, at = np.maximum(np.abs(values), least), i + 0.22 * (k - 0.5 * (len(meshes) - 1))
                style = {"color": colour, "alpha": 0.35 + 0.65 * (k + 1) / len(meshes)}
                gained = name == "energy" and np.median(values) > 0.0
                dot = style | {"marker": "o", "linestyle": "", "mfc": "white" if gained else colour}
                marks += [Ranges(at, np.min(sizes), np.max(sizes), look=style | {"lw": 1.2}),
                          Curve(np.median(sizes), at, look=dot)]  # fmt: skip
            if name == "foot" and (order := order_over(group, _width, name)).slope > -np.inf:
                marks.append(Note(f"order {order.slope:.1f}", 1.02, i, "x", {"va": "center"}))
        panels.append(Panel(title, Axis(words, scale="log"), Axis(names=list(entries)), marks))
    return Picture([panels], 1.6 + 0.3 * max(4, len(entries)))


STUDY = declared(
    __name__,
    "A bar bounces on a rigid wall: which scheme conserves its energy, and which gives the right pressure?",
    of_case=False,
    smoke={"schemes": ["MoreauJean", "Trapezoidal"], "cells": [10, 20], "starts": 2},
)
