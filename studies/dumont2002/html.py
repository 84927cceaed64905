"""A few lines of HTML: elements that escape their content, tables aligned on their decimals."""

from __future__ import annotations

import base64
import csv
import html
import io
import re
from collections.abc import Sequence
from pathlib import Path

from .typeset import anchor

VOID = {"img", "input", "link", "meta"}


class Html(str):
    """Text that is already HTML."""


def element(name: str, /, *content: object, **attributes: object) -> Html:
    """``<name attributes>content</name>``; content that is not Html is escaped, ``class_`` is class."""
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{html.escape(str(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    if name in VOID:
        return Html(f"<{name}{written}>")
    return Html(f"<{name}{written}>{joined(*content)}</{name}>")


def joined(*content: object) -> Html:
    """The parts one after the other."""
    return Html("".join(part if isinstance(part, Html) else html.escape(str(part), quote=False) for part in content))


def image(file: Path, alt: str) -> Html:
    """A picture inside the page, as a data URI."""
    kind = {".svg": "image/svg+xml", ".png": "image/png", ".gif": "image/gif"}[file.suffix]
    data = base64.b64encode(file.read_bytes()).decode()
    return element("img", src=f"data:{kind};base64,{data}", alt=alt)


def figure(pictures: Sequence[Html], caption: object, class_: str = "", above: object = "") -> Html:
    """Pictures side by side where there is room, with one caption."""
    grid = element("div", *pictures, class_=f"pictures {class_}".strip())
    return element("figure", above, grid, element("figcaption", caption))


def table(
    headings: Sequence[str], rows: Sequence[Sequence[object]], caption: str, text: Sequence[int] = (0,),
    cards: bool = False,
) -> Html:  # fmt: skip
    """Headings over rows; columns not in ``text`` hold numbers and are aligned on the decimal point.

    The first cell of a row is its heading. A wide table scrolls inside its own box, and can be had as CSV.
    cards: on a phone every row is a card of its own, whose cells stand below each other under their headings.
    """
    numeric = [i for i in range(len(headings)) if i not in text]
    behind = {i: max((len(_fraction(str(row[i]))) for row in rows), default=0) for i in numeric}
    head = element("tr", *(element("th", whole(h), scope="col", class_=_kind(i, text)) for i, h in enumerate(headings)))
    body = []
    for row in rows:
        cells = [element("th", whole(row[0]), scope="row")]
        for i, value in enumerate(row[1:], start=1):
            content = value if i in text else aligned(str(value), behind[i])
            cells.append(element("td", content, class_=_kind(i, text), data_label=headings[i] if cards else None))
        body.append(element("tr", *cells))
    inner = element(
        "table", element("caption", element("span", caption)), element("thead", head), element("tbody", *body),
        class_="cards" if cards else None,
    )  # fmt: skip
    return boxed(inner, caption, [headings, *rows])


def whole(name: object) -> object:
    """A name whose ``3 (4.13)`` or ``|σ|`` no line end divides."""
    if isinstance(name, Html):
        return name
    return re.sub(r"^(\d+) (?=\()", "\\1\u00a0", str(name)).replace("|σ|", "|\u2060σ\u2060|")


def boxed(inner: Html, caption: str, rows: Sequence[Sequence[object]]) -> Html:
    """A table in a box of its own that scrolls, and below it a link to its rows as a CSV file."""
    stream = io.StringIO()
    plain = [[html.unescape(re.sub(r"<[^>]*>", "", str(cell))) for cell in row] for row in rows]
    csv.writer(stream, lineterminator="\n").writerows(plain)
    data = base64.b64encode(stream.getvalue().encode()).decode()
    link = element(
        "a", "CSV", href=f"data:text/csv;charset=utf-8;base64,{data}", download=f"{anchor(caption)}.csv", class_="csv",
        aria_label=f"{caption}, as a CSV file",
    )  # fmt: skip
    return joined(element("section", inner, class_="scroll", tabindex=0, aria_label=caption), link)


def aligned(number: str, places: int) -> Html:
    """``number`` with what stands behind its digits before the point in a box ``places`` characters wide."""
    fraction = _fraction(number)
    whole = number[: len(number) - len(fraction)]
    fraction = fraction.replace(" ", "\u00a0")  # a box drops a space at its start
    if not places:
        return joined(number)
    return joined(whole, element("span", fraction, class_="f", style=f"width:{places}ch"))


def _fraction(number: str) -> str:
    """``.25 ± 3`` of ``1.25 ± 3``; nothing of a word."""
    match = re.match(r"[−-]?\d+", number.replace("\u202f", ""))
    if not match:
        return ""
    start = re.match(r"[−-]?[\d\u202f]+", number)
    assert start is not None
    return number[start.end() :]


def _kind(column: int, text: Sequence[int]) -> str | None:
    return None if column in text else "n"


def definition_list(entries: Sequence[tuple[object, object]], class_: str) -> Html:
    """Terms with what they are."""
    parts = [element("div", element("dt", term), element("dd", value)) for term, value in entries]
    return element("dl", *parts, class_=class_)


def paragraph(*content: object, class_: str | None = None) -> Html:
    """A <p> with an optional class."""
    return element("p", *content, class_=class_)


def code(text: str) -> Html:
    """A <code> element."""
    return element("code", text)
