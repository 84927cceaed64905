"""Requested and delivered restitution: formulas for the damping of a stop with a given e.

    Hunt-Crossley law   F = kappa d^p (1 + lambda d'):   e delivered by lambda v, see ``restitution_of``
    Kelvin-Voigt law    F = kappa d + c d', no pull:     e = exp(-zeta t), t = (pi - atan2(2 zeta w, 1 - 2 zeta^2))/w,
                                                         w = sqrt(1 - zeta^2), zeta = c/(2 sqrt(kappa m)) < 1

A free mass m meets the stop at speed v. All formulas but the last are approximations. The delivered e is known in
closed form, and measured here by DOP853 on a ball. Sources: Hunt and Crossley (1975); Herbert and McWhannell (1977);
Lee and Wang (1983); Lankarani and Nikravesh (1990); Gonthier et al. (2004); Flores et al. (2011); Hu and Guo (2015),
all as compared in Rodrigues da Silva et al., Mech. Mach. Theory 167 (2022) 104501. For the Kelvin-Voigt law:
Anagnostopoulos (1988), whose ball leaves where d = 0, and Schwager and Poeschel, Granular Matter 9 (2007) 465-469, with
the release where F = 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np

from ..basics.validation import InputError, number
from ..figures.chart import Axis, Curve, Panel, Picture, column, groups, style_of
from ..files.cases import Case
from ..model.contact import Contact, Stops, dissipation_for, restitution_of
from ..model.system import System
from ..references import solve
from .common import extremes
from .interface import Answer, Point, Records, Row, Rows, declared

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
    wanted: Annotated[list[float] | None, "restitutions in (0, 1), comma-separated"] = None,
    formulas: Annotated[list[str] | None, "names, comma-separated; default: all"] = None,
) -> list[Point]:
    """Every formula at every wanted restitution. The result does not depend on the case."""
    names = [*FORMULAS, KELVIN_VOIGT]
    for name in formulas or ():
        if name not in names:
            raise InputError("formulas", name, "be among those of the study", ", ".join(names))
    for e in wanted or ():
        if not 0.0 < number("wanted", e) < 1.0:
            raise InputError("wanted", e, "lie in (0, 1)", "for example 0.5")
    return [{"formula": name, "wanted": float(e)} for name in formulas or names for e in wanted or WANTED]


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: the restitution that a formula delivers, in closed form and measured."""
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
    """Return the restitution where the stop does not pull."""
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


def answer(rows: Rows, case: Case) -> Answer:
    """Error of each formula: delivered less wanted restitution, where it is largest."""
    worst = [max(group, key=_error) for group in groups(rows, "formula").values()]
    apart = max((abs(row["measured"] - row["delivered"]) for row in rows), default=math.nan)
    off = extremes({row["formula"]: _error(row) for row in worst}, "{:.2g}".format)
    return Answer(
        f"The formulas miss the wanted restitution by {off}, each where it is worst.",
        [{"formula": row["formula"], "delivered less wanted": f"{row['delivered'] - row['wanted']:+.2g}",
          "at e": f"{row['wanted']:g}"} for row in worst],
        f"Simulated balls agree with the closed forms to {apart:.1g}.",
    )  # fmt: skip


def _error(row: dict[str, Any]) -> float:
    return abs(row["delivered"] - row["wanted"])


def picture(records: Records) -> Picture:
    """Lines: closed forms; markers: balls."""
    panels = []
    for title, words, less in (("e delivered", "e delivered", 0.0),
                               ("its error", "e delivered \N{MINUS SIGN} e wanted", 1.0)):  # fmt: skip
        marks = []
        for i, (name, group) in enumerate(groups(records.numbers, "formula").items()):
            wanted, delivered, measured = (column(group, key) for key in ("wanted", "delivered", "measured"))
            style = style_of(i) | ({"color": "black"} if name == OWN else {})
            line = style | {"linestyle": "--" if name == KELVIN_VOIGT else "-", "marker": ""}
            label = "exact: Stops.from_restitution" if name == OWN else name
            marks += [
                Curve(wanted, delivered - less * wanted, label, line),
                Curve(wanted, measured - less * wanted, label, style | {"linestyle": "", "mfc": "white", "ms": 3.5}),
            ]
        panels.append(Panel(f"{title} (lines: closed forms, markers: runs)", Axis("e wanted"), Axis(words), marks))
    return Picture([panels], 4.8, 5)


STUDY = declared(
    __name__,
    "Which formula for the damping of a stop gives the requested restitution e?",
    marches=False,
    of_case=False,
    smoke={"wanted": [0.3, 0.9], "formulas": ["Hunt-Crossley", "from_restitution", "Kelvin-Voigt"]},
)
