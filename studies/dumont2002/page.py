"""The page: one HTML file with everything in it, written whole or not at all."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path

from stiffbeam.basics.whole_file import write_whole

from . import html as h
from .claims_section import filters
from .make import Finished
from .reading import Reading
from .sections import CITATION
from .table_section import section, title
from .typeset import anchor

TITLE = "Vibrations of a beam between stops"
Section = tuple[str, h.Html]  # heading, content


def write_page(
    file: Path,
    tables: Mapping[int, Finished],
    reading: Reading,
    before: Sequence[Section],
    after: Sequence[Section],
    command: str,
    totals: h.Html | str = "",
) -> Path:
    """``before`` the tables, the tables, ``after`` them, and the provenance at the foot.

    totals: the verdicts counted, at the head. The first section stands above the contents where they are given.
    """
    tables_heading = "Tables and figures 1 to 17" if len(tables) == 17 else "Tables and figures"
    heading, lead = _described(tables, bool(totals))
    made = h.joined(*(section(finished) for finished in tables.values()))
    parts: list[Section] = [*before, (tables_heading, made), *after]
    sections = [
        h.element("section", h.element("h2", heading), content, id=anchor(heading), aria_label=heading)
        for heading, content in parts
    ]
    body = h.joined(
        h.element("a", "To the content", href="#content", class_="skip"),
        h.element(
            "header",
            h.element("h1", heading),
            h.paragraph(CITATION, class_="cited"),
            h.paragraph(lead, class_="lead"),
            totals,
        ),
        h.element(
            "main",
            *sections[: 1 if totals else 0],
            contents(parts, tables, tables_heading),
            *sections[1 if totals else 0 :],
            id="content",
        ),
        provenance(reading, command),
    )
    head = h.joined(
        h.element("meta", charset="utf-8"),
        h.element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        h.element("link", rel="icon", href="data:,"),
        h.element("title", heading),
        h.element("style", h.Html(page_style() + filters())),
    )
    document = h.element("html", h.element("head", head), h.element("body", body), lang="en")
    text = f"<!DOCTYPE html>\n{document}\n"
    return write_whole(file, text)


def _described(tables: Mapping[int, Finished], judged: bool) -> tuple[str, str]:
    """What the page is called and holds."""
    if judged:
        lead = "Every table and figure remade beside the exact motion of the same equations; every claim that can be "
        return f"{TITLE}, reproduced and judged", lead + "tested, tested."
    numbers = ", ".join(map(str, tables))
    name = f"Table{'s' * (len(tables) > 1)} {numbers}"
    lead = (
        f"{name} and Fig{'s' * (len(tables) > 1)}. {numbers}, remade beside the exact motion of the same equations. "
        "The paper's claims need all its tables: stiffbeam reproduce all."
    )
    return f"{TITLE}: {name} reproduced", lead


def page_style() -> str:
    """The style sheet that is put into the page."""
    return Path(__file__).with_name("style.css").read_text(encoding="utf-8")


def contents(parts: Sequence[Section], tables: Mapping[int, Finished], tables_heading: str) -> h.Html:
    """The list of contents, tables below their heading."""
    items = []
    for heading, _ in parts:
        link = h.element("a", heading, href=f"#{anchor(heading)}")
        inner: h.Html | str = ""
        if heading == tables_heading:
            entries = (
                h.element("li", h.element("a", title(number), href=f"#{anchor(f'table {number}')}"))
                for number in tables
            )
            inner = h.element("ol", *entries)
        items.append(h.element("li", link, inner))
    return h.element("nav", h.element("h2", "Contents"), h.element("ol", *items), aria_label="Contents")


def provenance(reading: Reading, command: str) -> h.Html:
    """Versions, options and date."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("stiffbeam", "numpy", "scipy", "numba", "matplotlib"))
    return h.element(
        "footer",
        h.element("h2", "Provenance"),
        h.paragraph("Made with ", h.code(command), f" on {date.today().isoformat()}."),
        h.paragraph(f"{packages}; Python {platform.python_version()}, {platform.machine()}."),
        h.paragraph(
            f"Contact {reading.contact}, schemes {'as printed' if reading.printed else 'corrected'}, references "
            f"{'frozen multiprecision solutions' if reading.references else 'the exact solution in float64'}; "
            "parameters read as decimals, ensembles with the doubles next to them. Past "
            "the horizon every count and every curve of a run is one realisation of a chaotic motion. All "
            "quantities are non-dimensional, as the paper's; seconds are those of computing."
        ),
        id="provenance",
    )
