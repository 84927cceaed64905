"""Arguments and options that several commands share, and the reading of lists."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..basics.progress import TALK
from . import completion


def labels(text: str | None) -> list[str] | None:
    """Words or runs with commas between them; those inside parentheses belong to a run."""
    from ..schemes.labels import split_runs

    return None if text is None else [part.strip() for part in split_runs(text)]


def numbers(text: str | None, kind: Callable[[str], Any]) -> list[Any] | None:
    """Numbers with commas between them."""
    from ..basics.validation import InputError

    try:
        return None if text is None else [kind(part) for part in text.split(",")]
    except ValueError:
        raise InputError("list", text, "be numbers with commas between them", "for example 0.1,0.2") from None


def values_of(text: str | None) -> list[float] | None:
    """``start:stop:count``, evenly spaced, ``start:stop:count:log``, or numbers with commas between them.

    Each as in a case file, "2*pi*50" too.
    """
    if text is None or ":" not in text:
        return numbers(text, _number)
    import numpy as np

    from ..basics.resources import afford
    from ..basics.validation import InputError

    start, stop, count, *spacing = [*text.split(":"), "", ""][: max(3, text.count(":") + 1)]
    try:
        low, high, n = _number(start), _number(stop), int(count)
        if n < 1 or spacing not in ([], ["log"]) or (spacing and min(low, high) <= 0.0):
            raise ValueError
    except ValueError:
        rule = "read start:stop:count, start:stop:count:log with both ends > 0, or numbers with commas between them"
        raise InputError("values", text, rule, "for example 8:14:400") from None
    afford("values", text, "take fewer", floats=200.0 * n)  # each is a point with its rows
    return (np.geomspace if spacing else np.linspace)(low, high, n).tolist()


def _number(text: str) -> float:
    from ..basics.exact_float import exact_float

    return float(exact_float(text))


def _quiet(value: bool) -> None:
    TALK.quiet = value


def _verbose(value: bool) -> None:
    TALK.verbose = value


CASE: dict[str, Any] = {"help": "table1 .. table17, a case file, or file.toml:name", "autocompletion": completion.cases}
Case = Annotated[str, typer.Argument(**CASE)]
Dt = Annotated[float | None, typer.Option(help="time step instead of the case's")]
TEnd = Annotated[float | None, typer.Option(help="end time instead of the case's")]
Form = Annotated[
    str | None, typer.Option(help="displacement, velocity-curvature or hermite", autocompletion=completion.form)
]
Jobs = Annotated[int | None, typer.Option(help="processes; default: one per core")]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the records to FILE, - for stdout")]
References = Annotated[
    Path | None, typer.Option(help="folder of stored references; default: ./reference, or those of the package")
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", callback=_quiet, expose_value=False, help="print nothing but errors and --json")
]
Verbose = Annotated[
    bool,
    typer.Option("--verbose", "-v", callback=_verbose, expose_value=False, help="one line on stderr per phase"),
]


def shared() -> list[Any]:
    """--quiet and --verbose, as the command line has them in every command."""
    alone = typer.Typer(add_completion=False)

    @alone.command()
    def nothing(quiet: Quiet = False, verbose: Verbose = False) -> None: ...

    return [option for option in typer.main.get_command(alone).params if option.name in ("quiet", "verbose")]
