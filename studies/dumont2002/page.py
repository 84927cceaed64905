"""The page: one HTML file with everything in it, page.html filled in."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import date
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

import stiffbeam as sb
from stiffbeam.basics.storage import write_whole
from stiffbeam.measures.report import DASH

from . import no_contact
from .costs import CPU_TABLES
from .numbers import PERIODS, SPREAD, Numbers, spread
from .table import Reading, drive_of, published

DOI = "10.1016/S0378-4754(02)00003-4"  # by the number printed at the foot of its first page
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def write_page(
    file: Path, parts: Mapping[int, Mapping[str, Any]], reading: Reading, command: str, across: Mapping[str, Any]
) -> Path:
    """Write the tables, what is measured of them, and where it comes from; ``across`` is {} unless all are made."""
    numbers = {number: part["numbers"] for number, part in parts.items()}
    packages = ", ".join(f"{name} {version(name)}" for name in ("stiffbeam", "numpy", "scipy", "matplotlib"))
    context: dict[str, Any] = {
        "parts": parts, "numbers": numbers, "reading": reading, "command": command, "across": across,
        "case": sb.paper_case, "parameters": parameters, "measures": measures, "impacts": impacts, "cpu": cpu,
        "table": pd.DataFrame, "spread": spread, "without_contact": no_contact, "DOI": DOI, "PERIODS": PERIODS,
        "SPREAD": SPREAD, "today": date.today().isoformat(),
        "versions": f"{packages}; Python {platform.python_version()}, {platform.machine()}",
    }  # fmt: skip
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=StrictUndefined,
    )  # fmt: skip
    filters: Any = environment.filters
    filters |= {"typeset": typeset, "frame": frame}
    return write_whole(file, environment.get_template("page.html").render(context))


def frame(table: pd.DataFrame, caption: str, words: bool = False) -> Markup:
    """An HTML table; ``words`` aligns its columns to the left."""
    texts = table.astype(object).map(lambda value: typeset(cell(value)))
    text = texts.to_html(index=False, border=0, classes="words" if words else None)
    return Markup(text.replace("<thead>", f"<caption>{escape(typeset(caption))}</caption>\n  <thead>", 1))


def typeset(text: str) -> str:
    """Powers of ten and minus signs as on paper."""
    text = re.sub(r"(\d)e([+-]\d+)", lambda m: f"{m[1]} × 10{str(int(m[2])).translate(RAISED)}", text)
    return re.sub(r"(?<![\w)=])-(?=\d)", "−", text)


def cell(value: Any, digits: int = 3) -> str:
    """A number in few digits, a count in all of them, a dash for none, and a text as it is."""
    if value is None:
        return DASH
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


# ---------------------------------------------------------------- tables


def parameters(number: int) -> Iterator[tuple[str, str]]:
    """The paper's table in its symbols, with T beside it."""
    case = sb.paper_case(number)
    problem, stops, drive = case.beam, case.beam.all_stops[0], drive_of(case)
    yield "k²", cell(problem.stiffness, 6)
    yield "a" if problem.base is not None and number != 17 else "w", cell(drive.frequency)
    yield "E", cell(drive.amplitude, 6)
    for load in problem.loads:
        assert isinstance(load, sb.PointLoad)
        yield "x_d", cell(load.position)
    yield "h", cell(1.0 / case.cells)
    yield "dt", cell(case.dt)
    for name, place in (("g₁", stops.lower), ("g₂", stops.upper)):
        yield name, "none" if place is None else cell(place)
    yield "κ", cell(stops.stiffness)
    yield from {("α", cell(scheme.alpha)): None for scheme, _ in case.runs if isinstance(scheme, sb.HHT)}
    yield from {("γ", cell(scheme.gamma, 4)): None for scheme, _ in case.runs if isinstance(scheme, sb.SDIRK)}
    yield "T (inferred)", cell(case.t_end)


def measures(number: int, numbers: Numbers) -> pd.DataFrame:
    """Measures of every run and of the true motion of a table as texts, beside the paper's impacts."""
    counts = published(sb.paper_case(number), "impacts")
    named = [(f"{name} {row['scheme']}", counts.get(name), row) for name, row in numbers["runs"].items()]
    named += [(f"true, {form}", None, row) for form, row in numbers["exact"].items()]
    columns = {
        "contact, %": ("fraction", 100.0), "peak |σ|": ("peak_force", 1.0), "energy lost, %": ("energy_lost", 100.0),
        "tip error, %": ("tip_error", 100.0), "impacts match until": ("matched_until", 1.0),
        "fast velocity": ("fast", 1.0), "horizon": ("horizon", 1.0),
    }  # fmt: skip
    rows = []
    for name, count, row in named:
        values = {head: None if row.get(key) is None else scale * row[key] for head, (key, scale) in columns.items()}
        rows.append({"motion": name, "impacts": row["impacts"], "paper's": count} | values)
    table = pd.DataFrame(rows, dtype=object).map(cell)
    return table if counts else table.drop(columns="paper's")


def impacts(numbers: Mapping[int, Numbers]) -> pd.DataFrame:
    """The paper's counts, those of the ensembles, and the true ones."""
    rows = []
    for table, found in numbers.items():
        counts = published(sb.paper_case(table), "impacts")
        for equation, row in found["runs"].items():
            exact = found["exact"][row["form"]]
            rows.append(
                {
                    "table": table, "scheme": equation, "paper": counts.get(equation),
                    "ensemble": spread(row, "impacts"), "exact ensemble": spread(exact, "impacts"),
                    "true": exact["impacts"],
                    "contact, %": spread(row, "fraction", 100.0),
                    "exact contact, %": spread(exact, "fraction", 100.0),
                }
            )  # fmt: skip
    return pd.DataFrame(rows, dtype=object)


def cpu(costs: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, pd.DataFrame]]:
    """(caption, the paper's seconds beside times per step here) of the groups of tables."""
    for tables in CPU_TABLES:
        group = [row for row in costs if row["table"] in tables]
        unit = group[0]["unit"]
        rows = [
            {
                "table": row["table"], "scheme": row["equation"], "paper, s": cell(row["paper_seconds"], 6),
                f"paper over {unit}": row["paper_ratio"], "here, ns per step": row["ns_per_step"],
                f"here over {unit}": row["ratio"],
            }
            for row in group
        ]  # fmt: skip
        yield f"CPU time, Tables {tables[0]} to {tables[-1]}", pd.DataFrame(rows, dtype=object)
