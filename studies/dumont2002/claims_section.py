"""The section of the claims: verdicts counted, every claim with what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from . import html as h
from .typeset import anchor, typeset
from .verdicts import FAILS, HOLDS, NOT_MEASURED, OPEN, PLURAL, SCHEME_ONLY, UNTESTABLE


def totals(judged: Sequence[Mapping[str, str]]) -> h.Html:
    """How many claims got which verdict, each a link to the claims."""
    chips = (
        h.element("a", f"{n} {PLURAL[x]}", href="#claims", class_=f"verdict {_colour(x)}")
        for x, n in _counts(judged).items()
    )
    return h.element(
        "p", f"{len(judged)} claims: ", h.joined(*(h.joined(chip, " ") for chip in chips)), class_="totals"
    )


def _counts(judged: Sequence[Mapping[str, str]]) -> dict[str, int]:
    found = [row["verdict"] for row in judged]
    return {x: found.count(x) for x in sorted(set(found), key=lambda x: (-found.count(x), x))}


def claims(judged: Sequence[Mapping[str, str]]) -> h.Html:
    """Every claim with what was measured, a row with an anchor each; one verdict can be shown alone."""
    counts = _counts(judged)
    rows = [
        h.element(
            "tr",
            h.element("th", *_place(row["section"]), " ", h.element("a", f"#{i}", href=f"#claim-{i}"), scope="row"),
            h.element("td", typeset(row["claim"])),
            h.element(
                "td",
                typeset(row["measured"]),
                h.element("div", "Holds if ", typeset(row["rule"]), ". ", typeset(row["evidence"]), ".", class_="rule"),
            ),
            h.element("td", h.element("span", row["verdict"], class_=f"verdict {_colour(row['verdict'])}")),
            id=f"claim-{i}",
            class_=f"is-{anchor(row['verdict'])}",
        )
        for i, row in enumerate(judged, start=1)
    ]
    summary = ", ".join(f"{n} {PLURAL[x]}" for x, n in counts.items())
    columns = ("section", "the paper says", "measured", "verdict")
    head = h.element("tr", *(h.element("th", x, scope="col") for x in columns))
    caption = "Claims and verdicts"
    table = h.element(
        "table",
        h.element("caption", caption),
        h.element("thead", head),
        h.element("tbody", *rows),
        class_="claims cards",
    )
    choices = [("all", f"all {len(judged)}"), *((anchor(x), f"{x}, {n}") for x, n in counts.items())]
    buttons = (
        h.element(
            "label",
            h.element(
                "input", type="radio", name="verdict", value=value, checked="checked" if value == "all" else None
            ),
            f" {text}",
        )
        for value, text in choices
    )
    return h.joined(
        h.paragraph(
            f"Of {len(judged)} claims: {summary}. “{SCHEME_ONLY[0].upper()}{SCHEME_ONLY[1:]}” is what the paper's "
            "computations show and the exact motion of the same equations does not. “Open” is what the spread leaves "
            "undecided, or what one set of seeds decides otherwise than the other."
        ),
        h.element(
            "div",
            h.element("fieldset", h.element("legend", "Show"), *buttons, class_="choice"),
            h.boxed(
                table,
                caption,
                [columns, *([row[x] for x in ("section", "claim", "measured", "verdict")] for row in judged)],
            ),
            class_="filtered",
        ),
    )


def _place(section: str) -> list[object]:
    """The paper's section; its table leads to what is measured there."""
    section, comma, table = section.partition(", ")
    return [section, comma, h.element("a", table, href=f"#{anchor(table)}")] if table else [section]


def _colour(verdict: str) -> str:
    if verdict in (OPEN, UNTESTABLE, NOT_MEASURED):
        return "open"
    return "holds" if verdict == HOLDS else "fails" if verdict in (FAILS, SCHEME_ONLY) else "partly"


def filters() -> str:
    """Which rows are shown is decided by the style sheet alone."""
    return "\n".join(
        f'.filtered:has(input[value="{anchor(x)}"]:checked) tbody tr:not(.is-{anchor(x)}) {{ display: none; }}'
        for x in PLURAL
    )
