"""Rows of the page's tables, and the parameters and legend above the figure of a table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stiffbeam.files.cases import paper_cases
from stiffbeam.model.problem import PointLoad
from stiffbeam.model.time_functions import Harmonic
from stiffbeam.schemes import HHT, SDIRK

from .costs import CPU_TABLES
from .ensembles import Numbers
from .figures import EXACT, ONE, STYLE
from .numbers import exact_name
from .sample import of_members
from .table import equation_of
from .typeset import DASH, MINUS, short, typeset, written


@dataclass(frozen=True)
class Table:
    """headings over rows of texts. text: columns of words; the others are numbers, aligned on the decimal point.

    cards: on a phone every row is a card of its own, whose cells stand below each other under their headings.
    """

    caption: str
    headings: list[str]
    rows: list[list[str]]
    text: Sequence[int] = (0,)
    cards: bool = False

    @property
    def places(self) -> dict[int, int]:
        """Width of what stands behind the point, in characters, by column of numbers."""
        columns = (i for i in range(len(self.headings)) if i not in self.text)
        return {i: max((len(parts(row[i])[1]) for row in self.rows), default=0) for i in columns}


def parts(number: str) -> tuple[str, str]:
    """``("1", ".25 ± 3")`` of ``1.25 ± 3``; a word and nothing. A box drops a space at its start, so none breaks."""
    match = re.match(r"[−-]?\d[\d\u202f]*", number)
    end = match.end() if match else len(number)
    return number[:end], number[end:].replace(" ", "\u00a0")


def spread(row: Numbers, what: str, scale: float = 1.0) -> str:
    """Mean and standard deviation over all members."""
    sample = of_members(row, what)
    return typeset(sample.written(scale)) if len(sample.values) else DASH


def decimals(value: float | None, scale: float, places: int) -> str:
    """Number to so many places; a dash for none."""
    return DASH if value is None else f"{scale * value:.{places}f}".replace("-", MINUS)


def parameters(number: int) -> Iterator[tuple[str, str]]:
    """The paper's table in its symbols, with T beside it."""
    case = paper_cases()[f"table{number}"]
    problem, stops = case.problem, case.problem.single_stops("case")
    yield "k²", written(problem.stiffness)
    if problem.loads:
        load = problem.loads[0]
        assert isinstance(load, PointLoad)
        assert isinstance(load.time, Harmonic)
        yield "w", written(load.time.frequency)
        yield "x_d", written(load.position)
        yield "E", written(load.time.amplitude)
    else:
        assert isinstance(problem.base, Harmonic)
        yield "w" if number == 17 else "a", written(problem.base.frequency)
        yield "E", written(problem.base.amplitude)
    yield "h", written(1 / case.cells)
    yield "dt", written(case.dt)
    for name, place in (("g₁", stops.lower), ("g₂", stops.upper)):
        yield name, "none" if place is None else written(place)
    yield "κ", written(stops.stiffness)
    alphas = (written(scheme.alpha) for scheme, _ in case.runs if isinstance(scheme, HHT))
    gammas = (f"{scheme.parameters['gamma']:g}" for scheme, _ in case.runs if isinstance(scheme, SDIRK))
    for name, values in (("α", alphas), ("γ", gammas)):
        for value in dict.fromkeys(values):
            yield name, value
    yield "T (inferred)", f"{case.t_end:g}"


def legend(numbers: Numbers) -> Iterator[dict[str, Any]]:
    """Line of every curve: its look and label."""
    from matplotlib.colors import to_hex

    def line(colour: str, dashes: Sequence[float], width: int, opacity: float, label: str) -> dict[str, Any]:
        stroke = {"colour": to_hex(colour), "dashes": " ".join(f"{2 * x:g}" for x in dashes)}
        return stroke | {"width": width, "opacity": opacity, "label": label}

    for form, row in numbers["exact"].items():
        known = "true motion" if row["digits"] else "exact motion to the horizon"
        yield line(*EXACT[form], 4, 0.5, f"{known}, {form} form")
    if not all(row["digits"] for row in numbers["exact"].values()):
        yield line(ONE["color"], ONE["dashes"], 3, 1.0, "one realisation of it past the horizon")
    for name, row in numbers["runs"].items():
        yield line(*STYLE[name], 2, 1.0, f"{name} {row['scheme']}")


def measures(number: int, numbers: Numbers) -> Table:
    """Measures of every run and of the exact motion of a table."""
    named_rows = [(f"{name} {row['scheme']}", row) for name, row in numbers["runs"].items()]
    named_rows += [(exact_name(form, row), row) for form, row in numbers["exact"].items()]
    errors = (("energy_lost", 100.0, 1), ("tip_error", 100.0, 2), ("parted", 1.0, 4))
    return Table(
        f"Table {number}: one run each over the whole span; tip error (rms) and matching impacts to the horizon",
        ["motion", "impacts", "contact, %", "peak |σ|", "energy lost, %", "tip error, %", "impacts match until",
         "fast velocity", "horizon"],
        [[name, short(row["impacts"]), f"{100 * row['fraction']:.1f}", f"{row['peak_force']:.0f}",
          *(decimals(row.get(what), scale, places) for what, scale, places in errors),
          f"{row['fast']:.3g}", decimals(row.get("horizon"), 1.0, 3)] for name, row in named_rows],
    )  # fmt: skip


def impacts(numbers: Mapping[int, Numbers], known: bool) -> Table:
    """The paper's counts, those of the ensembles, and the true ones where they are known."""
    rows, contacts = [], set()
    for table, found in numbers.items():
        case = paper_cases()[f"table{table}"]
        labels = {equation_of(*run): "{}@{}".format(*run) for run in case.runs}
        for equation, row in found["runs"].items():
            exact, other = found["exact"][row["form"]], row["other contact"]
            true = [short(exact["impacts"] if exact["digits"] else None)] if known else []
            contacts.add(other["contact"])
            rows.append(
                [
                    f"{table} {equation}", short(case.published.get("impacts", {}).get(labels[equation])),
                    spread(row, "impacts"), "overflow" if "failed" in other else short(other["impacts"]),
                    spread(exact, "impacts"), *true,
                    spread(row, "fraction", 100.0), spread(exact, "fraction", 100.0),
                ]
            )  # fmt: skip
    return Table(
        "Impacts and share of time in contact",
        ["table, scheme", "paper", "ensemble", f"{', '.join(sorted(contacts))} contact, one run", "exact ensemble",
         *(["true"] if known else []), "contact, %", "exact contact, %"],
        rows,
    )  # fmt: skip


def without_contact(curves: Sequence[Mapping[str, Any]]) -> Table:
    """Largest errors of Section 5.1."""
    return Table(
        "Section 5.1: largest errors at the tip over X₁(1)",
        ["curve", "largest error", "of it the scheme's"],
        [
            [row["name"], *(typeset(f"{x:.1e}") if x else DASH for x in (row["error"], row["in_time"]))]
            for row in curves
        ],
    )


def cpu(costs: Sequence[Mapping[str, Any]]) -> Iterator[Table]:
    """The paper's seconds beside times a step here, group by group."""
    for tables in CPU_TABLES:
        own = [row for row in costs if row["table"] in tables]
        if own:
            unit = own[0]["unit"]
            yield Table(
                f"CPU time, Tables {tables[0]} to {tables[-1]}",
                ["table, scheme", "paper, s", f"over {unit}", "here, ns a step", f"over {unit}, here"],
                [[f"{row['table']} {row['equation']}", f"{row['paper_seconds']:g}", f"{row['paper_ratio']:.2f}",
                  short(row["ns_per_step"], 3), decimals(row["ratio"], 1.0, 2)] for row in own],
            )  # fmt: skip


def misprints(entries: Sequence[Mapping[str, str]]) -> Table:
    """Misprints and their measured effect."""
    return Table(
        "Misprints and their effect",
        ["where", "printed", "right", "effect, measured"],
        [[row["where"], row["printed"], row["right"], typeset(row["effect"])] for row in entries],
        text=(0, 1, 2, 3),
        cards=True,
    )
