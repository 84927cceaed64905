"""The section of one table: parameters, legend, panels, what to look at, numbers."""

from __future__ import annotations

import numpy as np

from stiffbeam.files.cases import Case, paper_cases
from stiffbeam.model.problem import PointLoad
from stiffbeam.model.time_functions import Harmonic
from stiffbeam.schemes import HHT, SDIRK

from . import html as h
from .ensembles import Numbers
from .figures import EXACT, ONE, STYLE
from .make import Finished
from .numbers import exact_name
from .sample import Sample
from .table import drive_of
from .typeset import DASH, MINUS, anchor, percent, short, typeset, written


def spread(row: Numbers, what: str, scale: float = 1.0) -> str:
    """Mean and standard deviation over all members."""
    values = [x for members in row["ensemble"].values() for x in members[what] if x is not None]
    return typeset(Sample(np.array(values)).written(scale)) if values else DASH


def title(number: int) -> str:
    """The heading of a table and of its figure."""
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
        *_film(finished),
        _numbers_table(number, finished.numbers),
        id=anchor(f"table {number}"),
    )


def _film(finished: Finished) -> list[h.Html]:
    """The film, which begins to play when it is opened."""
    if finished.film is None:
        return []
    shown = (
        f"Table {finished.number}, film: the beam between its stops, the schemes beside the exact motion, which turns "
        "grey past the horizon; a flash is an impact, as large as the root of its peak force."
    )
    moving = h.image(finished.film, shown)
    return [h.element("details", h.element("summary", "Film"), h.figure([moving], shown, "one"), class_="film")]


def parameters(case: Case) -> list[tuple[object, object]]:
    """The paper's table, in its symbols, with T beside it."""
    problem, stops = case.problem, case.problem.one_stops("case")
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
    entries: list[tuple[str, tuple[float, ...], float, float, str]] = []
    for form, row in numbers["exact"].items():
        known = f"true motion, {form} form" if row["digits"] else f"exact motion to the horizon, {form} form"
        entries.append((*EXACT[form], 4, 0.5, known))
    if not all(row["digits"] for row in numbers["exact"].values()):
        entries.append((ONE["color"], ONE["dashes"], 3, 1.0, "one realisation of it past the horizon"))
    entries += [(*STYLE[name], 2, 1.0, f"{name} {row['scheme']}") for name, row in numbers["runs"].items()]
    items = []
    for colour, dashes, width, opacity, label in entries:
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
    """What to look at; every result in it is taken from the numbers."""
    look = _LOOK.get(number, _LOOK_GROUP[_group(number)])
    return typeset(" ".join((look, _spectrum_sentence(numbers), _contact_sentence(numbers))))


def _spectrum_sentence(numbers: Numbers) -> str:
    """Where the highest line of the exact spectrum stands, and how full the spectra are."""
    row = next(iter(numbers["exact"].values()))
    peaks = sorted(row["peaks"], key=lambda peak: -peak["amplitude"])
    highest = f"the highest line of the exact motion is at {peaks[0]['name']}" if peaks else "no line stands out"
    full = [f"{name} {percent(found['band'])}" for name, found in numbers["runs"].items()]
    return (
        f"In (d), {highest}; of the frequencies to 15a {percent(row['band'])} are excited, with "
        f"{', '.join(full) or 'no scheme'}."
    )


def _contact_sentence(numbers: Numbers) -> str:
    runs = ", ".join(f"{name} {percent(row['fraction'])}" for name, row in numbers["runs"].items())
    exact = " and ".join(percent(row["fraction"]) for row in numbers["exact"].values())
    known = all(row["digits"] for row in numbers["exact"].values())
    return f"In contact: {runs}; {'true' if known else 'one exact realisation'} {exact} of the time."


def _group(number: int) -> str:
    return "BDF" if number <= 5 else "SDIRK" if number <= 9 else "both" if number <= 13 else "other"


_LOOK_GROUP = {
    "BDF": "In (a), compare the schemes with the grey curves up to the horizon; in (b), the width of their velocities.",
    "SDIRK": "In (c), compare (4.12) and (4.14), which are one scheme, with (4.10), which has the other grid.",
    "both": "In (c), compare how the schemes and the exact tip leave the stop.",
    "other": "In (a) and (b), compare the height of the scheme's velocities with the exact ones.",
}
_RESONANCE = (
    "Near resonance: 4.4a = 267 is the first mode of the beam clamped at one end and resting on a stop at the other."
)
_LOOK = {
    1: "The stiff beam. In (a), compare the schemes at the stop with the chatter of the exact tip.",
    4: _RESONANCE,
    12: _RESONANCE,
    14: "One stop. In (b), a periodic motion would be a closed curve. 6a is near the first mode, 60.9.",
    15: "In (c), compare the blows of the exact stress with the scheme's.",
    16: "In (c), compare the blows of the exact stress with the scheme's.",
    17: "(b) is what the paper prints as delayed: with both coordinates shifted it is the plain portrait. (b′) is "
    "delayed in one of them: a motion of the drive's period would lie on the diagonal.",
}


def _numbers_table(number: int, numbers: Numbers) -> h.Html:
    """The measures of every run and of the exact motion, one row each."""
    named = [(f"{name} {row['scheme']}", row) for name, row in numbers["runs"].items()]
    named += [(exact_name(form, row), row) for form, row in numbers["exact"].items()]
    rows = []
    for name, row in named:
        errors = [DASH] * 3
        if "tip_error" in row:
            errors = [
                _given(row["energy_lost"], 100.0, 1),
                _given(row["tip_error"], 100.0, 2),
                _given(row["parted"], 1.0, 4),
            ]
        horizon = f"{row['horizon']:.3f}" if "horizon" in row else DASH
        counted = [short(row["impacts"]), f"{100 * row['fraction']:.1f}", f"{row['peak_force']:.0f}"]
        rows.append([name, *counted, *errors, f"{row['fast']:.3g}", horizon])
    headings = [
        "motion", "impacts", "contact, %", "peak |σ|", "energy lost, %", "tip error, %", "impacts match until",
        "fast velocity", "horizon",
    ]  # fmt: skip
    return h.table(
        headings,
        rows,
        f"Table {number}: one run each over the whole span; tip error (rms) and matching impacts to the horizon",
    )


def _given(value: float | None, scale: float, places: int) -> str:
    """A dash for what has no value."""
    return DASH if value is None else f"{scale * value:.{places}f}".replace("-", MINUS)


def _alt(number: int, letter: str, what: str, numbers: Numbers) -> str:
    """What the panel shows, with its main number."""
    exact = next(iter(numbers["exact"].values()))
    drive = drive_of(paper_cases()[f"table{number}"])
    runs, kind = numbers["runs"], "true" if exact["digits"] else "exact"
    said = {
        "a": f"{', '.join(runs) or 'no run'} beside the {kind} motion, horizon {exact['horizon']:.2g}",
        "b": f"fast velocity {exact['fast']:.2g} of the {kind} motion, "
        + ", ".join(f"{row['fast']:.2g} with {name}" for name, row in runs.items()),
        "b′": "a point for every twentieth step, in the square between the stops",
        "c": f"peak force {exact['peak_force']:.0f} of the {kind} motion, "
        + ", ".join(f"{row['peak_force']:.0f} with {name}" for name, row in runs.items()),
        "d": f"peaks of the {kind} motion at "
        + (", ".join(p["name"] for p in exact["peaks"][:8]) or "no frequency")
        + f", a = {drive:g}",
    }[letter]
    return f"Table {number}, panel {letter}: {what}; {said}."
