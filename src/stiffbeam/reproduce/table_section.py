"""The section of one table: parameters, legend, panels, what to look at, numbers."""

from __future__ import annotations

from typing import Any

from ..cases import Case, paper_cases
from ..problem import PointLoad
from ..schemes import HHT, SDIRK
from ..time_functions import Harmonic
from . import html as h
from .make import Finished
from .numbers import Numbers, truth_name
from .table import drive_of

MINUS, DASH = "−", "–"


def short(value: Any, digits: int = 4) -> str:
    """A number in few digits, thousands apart; a dash for none."""
    if value is None:
        return DASH
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")
    return f"{value:.{digits}g}".replace("-", MINUS)


def written(value: float) -> str:
    """As the paper writes it: 300, 0.04, −0.1, 5 × 10⁶, 10⁻⁴."""
    size = abs(value)
    if 0.001 <= size < 1e5:
        return f"{value:g}".replace("-", MINUS)
    digits, _, exponent = f"{value:e}".partition("e")
    power = "10" + h.raised(int(exponent))
    factor = f"{float(digits):g}".replace("-", MINUS)
    return power if factor == "1" else f"{factor} × {power}"


def percent(value: float) -> str:
    return f"{100 * value:.2g} %" if value < 0.0995 else f"{100 * value:.0f} %"


def spread(row: Numbers, what: str) -> str:
    """Mean and standard deviation of an ensemble."""
    found = row.get("ensemble")
    if found is None or found[what] is None:
        return DASH
    deviation = found[f"{what}_sd"]
    return f"{found[what]:.0f}" + (f" ± {deviation:.0f}" if deviation is not None else "")


def title(number: int) -> str:
    return f"Table {number}, Fig. {number}: {paper_cases()[f'table{number}'].title}"


def section(finished: Finished) -> h.Html:
    """Everything of one table."""
    number, case = finished.number, paper_cases()[f"table{finished.number}"]
    pictures = [h.image(file, _alt(number, letter, what, finished.numbers)) for letter, what, file in finished.pictures]
    failed = [
        h.paragraph(f"{equation} has no result in this reading: {why}.", class_="note")
        for equation, why in finished.numbers["failures"].items()
    ]
    return h.element(
        "section",
        h.element("h3", title(number)),
        h.definition_list(parameters(case), "parameters"),
        h.figure(pictures, caption(number, finished.numbers), above=legend(finished.numbers)),
        *failed,
        numbers_table(number, finished.numbers),
        id=h.anchor(f"table {number}"),
    )


def parameters(case: Case) -> list[tuple[object, object]]:
    """The paper's table, in its symbols, with T beside it."""
    problem, stops = case.problem, case.problem.stops
    assert stops is not None
    found: list[tuple[object, object]] = [("k²", written(problem.stiffness))]
    if problem.loads:
        load = problem.loads[0]
        assert isinstance(load, PointLoad)
        assert isinstance(load.time, Harmonic)
        found += [
            ("w", written(load.time.frequency)),
            ("x_d", written(load.position)),
            ("E", written(load.time.amplitude)),
        ]
    else:
        assert isinstance(problem.base, Harmonic)
        found += [
            ("w" if case.name == "table17" else "a", written(problem.base.frequency)),
            ("E", written(problem.base.amplitude)),
        ]
    found += [("h", written(1 / case.cells)), ("dt", written(case.dt))]
    found += [("g₁", written(stops.lower) if stops.lower is not None else "none")]
    found += [("g₂", written(stops.upper) if stops.upper is not None else "none"), ("κ", written(stops.stiffness))]
    for scheme, _ in case.runs:
        if isinstance(scheme, HHT):
            found.append(("α", written(scheme.alpha)))
        if isinstance(scheme, SDIRK) and not any(term == "γ" for term, _ in found):
            found.append(("γ", f"{scheme.parameters['gamma']:g}"))
    return [*found, ("T (inferred)", f"{case.t_end:g}")]


def legend(numbers: Numbers) -> h.Html:
    """A line of its look for every curve, as a list."""
    from ..figures.paper import STYLE, TRUTH

    entries = [(TRUTH[form], 4, 0.5, f"true motion, {form} form") for form in numbers["true"]]
    entries += [(STYLE[name], 2, 1.0, f"{name} {row['scheme']}") for name, row in numbers["runs"].items()]
    items = []
    for (colour, dashes), width, opacity, label in entries:
        line = h.element(
            "line", x1=0, y1=5, x2=34, y2=5, stroke=_hex(colour), stroke_width=width, stroke_opacity=opacity,
            stroke_dasharray=" ".join(f"{2 * x:g}" for x in dashes) or None,
        )  # fmt: skip
        items.append(h.element("li", h.element("svg", line, width=34, height=10, aria_hidden="true"), label))
    return h.element("ul", *items, class_="legend")


def _hex(colour: str) -> str:
    from matplotlib.colors import to_hex

    return to_hex(colour)


def caption(number: int, numbers: Numbers) -> str:
    """What to look at."""
    return " ".join([_LOOK.get(number, _LOOK_GROUP[_group(number)]), _contact_sentence(numbers)])


def _contact_sentence(numbers: Numbers) -> str:
    runs = ", ".join(f"{name} {percent(row['fraction'])}" for name, row in numbers["runs"].items())
    true = " and ".join(percent(row["fraction"]) for row in numbers["true"].values())
    return f"In contact: {runs}; true {true} of the time."


def _group(number: int) -> str:
    return "BDF" if number <= 5 else "SDIRK" if number <= 9 else "both" if number <= 13 else "other"


_LOOK_GROUP = {
    "BDF": "In (a), compare the schemes with the grey curves up to the horizon; in (b), how much narrower the "
    "schemes' velocities are than the true ones.",
    "SDIRK": "In (c), (4.12) and (4.14) lie on each other, as they must: they are one scheme. (4.10) follows the "
    "other grid.",
    "both": "In (c), both schemes follow the first impact and then rest where the true tip bounces; in (d), their "
    "floor between the multiples lies below the true one.",
    "other": "In (a) and (b), compare the height of the scheme's velocities with the true ones.",
}
_LOOK = {
    1: "The stiff beam. In (a), the schemes lie on the stop; the true tip chatters there.",
    3: "In (a), the schemes seem to stay on a stop from one half period to the next; the true motion bounces within "
    "the clearance.",
    4: "Near resonance. In (d), the highest line is no multiple of the drive: it is near 4.4a = 267, the first mode "
    "of the beam clamped at one end and resting on a stop at the other.",
    12: "Near resonance. In (d), the highest line lies near 4.4a = 267, the first mode of the beam clamped at one "
    "end and resting on a stop at the other, and not on an odd multiple.",
    14: "One stop. In (d), 2a stands out and so does 6a, near the first mode 60.9; in (b), the portrait is not a "
    "closed curve.",
    15: "In (c), the true stress comes in rare and hard blows, the scheme's in a long soft contact.",
    16: "In (c), the true stress comes in rare and hard blows, the scheme's in a long soft contact.",
    17: "(b) is what the paper prints as delayed: with both coordinates shifted it is the plain portrait. (b′) is "
    "delayed in one of them: a motion of the drive's period would lie on the diagonal.",
}


def numbers_table(number: int, numbers: Numbers) -> h.Html:
    named = [(f"{name} {row['scheme']}", row) for name, row in numbers["runs"].items()]
    named += [(truth_name(form, row), row) for form, row in numbers["true"].items()]
    rows = []
    for name, row in named:
        errors = [DASH] * 3
        if "tip_error" in row:
            errors = [f"{100 * row['energy_lost']:.1f}", f"{100 * row['tip_error']:.2f}", f"{row['parted']:.4f}"]
        horizon = f"{row['horizon']:.3f}" if "horizon" in row else DASH
        counted = [short(row["impacts"]), f"{100 * row['fraction']:.1f}", f"{row['peak_force']:.0f}"]
        rows.append([name, *counted, *errors, f"{row['fast']:.3g}", horizon])
    headings = [
        "motion", "impacts", "contact, %", "peak |σ|", "energy lost, %", "tip error, %", "impacts part at",
        "fast velocity", "horizon",
    ]  # fmt: skip
    return h.table(headings, rows, f"Table {number}: whole span; tip error (rms) and parting of impacts to the horizon")


def _alt(number: int, letter: str, what: str, numbers: Numbers) -> str:
    """What the panel shows, with its main number."""
    truth = next(iter(numbers["true"].values()))
    drive = drive_of(paper_cases()[f"table{number}"])
    runs = ", ".join(numbers["runs"])
    said = {
        "a": f"{runs} follow the true motion to the horizon {truth['horizon']:.2g} at the latest",
        "b": f"fast velocity {truth['fast']:.2g} truly, "
        + ", ".join(f"{row['fast']:.2g} with {name}" for name, row in numbers["runs"].items()),
        "b′": "points spread over the square between the stops",
        "c": f"peak force truly {truth['peak_force']:.0f}, "
        + ", ".join(f"{row['peak_force']:.0f} with {name}" for name, row in numbers["runs"].items()),
        "d": "true peaks at "
        + (", ".join(p["name"] for p in truth["peaks"][:8]) or "no frequency")
        + f", a = {drive:g}",
    }[letter]
    return f"Table {number}, panel {letter}: {what}; {said}."
