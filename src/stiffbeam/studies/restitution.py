"""Restitution wanted against restitution delivered: the formulas that turn an e into the damping of a stop.

    Hunt-Crossley law   F = kappa d^p (1 + lambda d'):   e delivered by lambda v, see ``restitution_of``
    Kelvin-Voigt law    F = kappa d + c d', no pull:     e = exp(-zeta t), t = (pi - atan2(2 zeta w, 1 - 2 zeta^2))/w,
                                                         w = sqrt(1 - zeta^2), zeta = c/(2 sqrt(kappa m)) < 1

A free mass m meets the stop at speed v. The formulas are approximations but for the last; what each delivers is known
in closed form, and measured here on a ball that DOP853 takes through the stop. Sources: Hunt and Crossley (1975);
Herbert and McWhannell (1977); Lee and Wang (1983); Lankarani and Nikravesh (1990); Gonthier et al. (2004); Flores et
al. (2011); Hu and Guo (2015), all as compared in Rodrigues da Silva et al., Mech. Mach. Theory 167 (2022) 104501; of
the Kelvin-Voigt law the formula by which a ball leaves where d = 0, Anagnostopoulos (1988), and the release where F = 0
of Schwager and Poeschel, Granular Matter 9 (2007) 465-469.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..basics.validation import InputError, number
from ..figures import COLOURS, MARKERS, column, new_figure, numeric, say_empty, shared_legend
from ..files.cases import Case
from ..model.contact import Contact, Stops
from ..model.restitution import dissipation_for, restitution_of
from ..model.system import System
from ..references import solve
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMULAS: dict[str, Callable[[float], float]] = {  # lambda v from the e that is wanted
    "Hunt-Crossley": lambda e: 1.5 * (1.0 - e),
    "Herbert-McWhannell": lambda e: 6.0 * (1.0 - e) / ((2.0 * e - 1.0) ** 2 + 3.0),
    "Lee-Wang": lambda e: 0.75 * (1.0 - e),
    "Lankarani-Nikravesh": lambda e: 0.75 * (1.0 - e * e),
    "Gonthier": lambda e: (1.0 - e * e) / e,
    "Flores": lambda e: 1.6 * (1.0 - e) / e,
    "Hu-Guo": lambda e: 1.5 * (1.0 - e) / e,
    "from_restitution": lambda e: dissipation_for(e, 1.0),
}
KELVIN_VOIGT = "Kelvin-Voigt"
OWN = "from_restitution"
WANTED = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
EXPONENT = 1.5  # of the ball's stop; what is delivered does not depend on it


def points(
    case: Case,
    wanted: Annotated[list[float] | None, "restitutions in (0, 1), with commas between them"] = None,
    formulas: Annotated[list[str] | None, "names, with commas between them; default: all"] = None,
) -> list[Point]:
    """Every formula at every restitution, whatever the case is."""
    names = [*FORMULAS, KELVIN_VOIGT]
    for name in formulas or ():
        if name not in names:
            raise InputError("formulas", name, "be among those of the study", ", ".join(names))
    for e in wanted or ():
        if not 0.0 < number("wanted", e) < 1.0:
            raise InputError("wanted", e, "lie in (0, 1)", "for example 0.5")
    return [{"formula": name, "wanted": float(e)} for name in formulas or names for e in wanted or WANTED]


def evaluate(case: Case, point: Point) -> list[Row]:
    """What is found at one point."""
    e = point["wanted"]
    if point["formula"] == KELVIN_VOIGT:
        parameter = zeta_of(e)
        delivered, law = kelvin_voigt_restitution(parameter), {"damping": 2.0 * parameter}
    else:
        parameter = FORMULAS[point["formula"]](e)
        delivered, law = restitution_of(parameter, 1.0), {"dissipation": parameter, "exponent": EXPONENT}
    return [{"parameter": parameter, "delivered": delivered, "measured": measured(law, delivered)}]


def zeta_of(e: float) -> float:
    """The damping ratio of a ball that leaves at e times its speed where d = 0 again: e = exp(-pi zeta/w)."""
    return -math.log(e) / math.hypot(math.pi, math.log(e))


def kelvin_voigt_restitution(zeta: float) -> float:
    """What it is where the stop does not pull."""
    w = math.sqrt(1.0 - zeta * zeta)
    return math.exp(-zeta * (math.pi - math.atan2(2.0 * zeta * w, 1.0 - 2.0 * zeta * zeta)) / w)


def measured(law: dict[str, Any], delivered: float) -> float:
    """The speed of a mass 1 behind a stop of stiffness 1, met at speed 1: by DOP853, from stop to stop."""
    stops = Stops(upper=0.0, stiffness=1.0, **law)
    ball = System.from_matrices(
        [[1.0]], [[0.0]], contacts=[Contact(np.ones(1), stops)],
        initial_displacement=[-0.1], initial_velocity=[1.0],
    )  # fmt: skip
    end = 10.0 * (1.0 + 1.0 / delivered)  # d is 2 at most, and left at the speed delivered or faster
    return float(-solve(ball, end, "dop853", np.array([0.0, end]), 1e-12, None).tip_velocity[-1])


def answer(rows: Rows, case: Case) -> str:
    """By how much each formula misses the restitution that is wanted, where it does most."""
    numbers = numeric(rows)
    off = {name: max(own, key=_error) for name in _names(rows) if (own := [r for r in numbers if r["formula"] == name])}
    parts = [(name, f"{x['delivered'] - x['wanted']:+.2g}", f"{x['wanted']:g}") for name, x in off.items()]
    table = [{"formula": name, "delivered less wanted": less, "at e": wanted} for name, less, wanted in parts]
    said = "; ".join(f"{name} {less} at e = {wanted}" for name, less, wanted in parts)
    apart = max((abs(row["measured"] - row["delivered"]) for row in numbers), default=math.nan)
    rest = f"Balls taken through the stops agree with the closed forms to {apart:.1g}."
    return Answer(f"Delivered less wanted, where it is largest: {said}. {rest}", table, rest)


def _error(row: dict[str, Any]) -> float:
    return abs(row["delivered"] - row["wanted"])


def _names(rows: Rows) -> list[str]:
    return list(dict.fromkeys(row["formula"] for row in rows))


def draw(records: Records) -> Figure:
    """Lines: closed forms; markers: balls."""
    rows = numeric(records.found)
    figure = new_figure(4.8)
    figure.suptitle("The restitution that a damped stop delivers, by its formula (lines: closed forms; markers: runs)")
    axes = figure.subplots(1, 2)
    for i, name in enumerate(_names(records.found)):
        own = sorted((row for row in rows if row["formula"] == name), key=lambda row: row["wanted"])
        wanted, delivered = column(own, "wanted"), column(own, "delivered")
        style = {
            "color": "k" if name == OWN else COLOURS[i % len(COLOURS)],
            "ls": "--" if name == KELVIN_VOIGT else "-",
        }
        label = "exact: Stops.from_restitution" if name == OWN else name
        for axis, line, mark in zip(
            axes,
            (delivered, delivered - wanted),
            (column(own, "measured"), column(own, "measured") - wanted),
            strict=True,
        ):
            points = {"marker": MARKERS[i % len(MARKERS)], "ms": 3.5, "mfc": "white", "color": style["color"]}
            axis.plot(wanted, line, lw=1.2, **style)
            axis.plot(wanted, mark, ls="", **points)
            axis.plot([], [], lw=1.2, label=label, **style | points)
    for axis, title, words in zip(
        axes,
        ("(a) e delivered", "(b) too much of it"),
        ("e delivered", "e delivered \N{MINUS SIGN} e wanted"),
        strict=True,
    ):
        axis.set(xlabel="e wanted", ylabel=words)
        axis.set_title(title, loc="left")
        axis.grid(color="0.92")
        if not rows:
            say_empty(axis)
    shared_legend(figure, 5)
    return figure


STUDY = Study(
    name="restitution",
    question="A stop is made to give back a share e of the speed: which formula delivers that e?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    marches=False,
    smoke={"wanted": [0.3, 0.9], "formulas": ["Hunt-Crossley", "from_restitution", "Kelvin-Voigt"]},
)
