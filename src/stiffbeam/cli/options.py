"""Options of the commands: those that several share, the completion of their values, and the reading of lists."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from ..basics.progress import TALK
from ..basics.validation import InputError


def labels(text: str | None) -> list[str] | None:
    """Words or runs with commas between them; those inside parentheses belong to a run."""
    from ..schemes.labels import split_runs

    return None if text is None else [part.strip() for part in split_runs(text)]


def numbers(text: str | None, kind: Callable[[str], Any]) -> list[Any] | None:
    """Numbers with commas between them."""
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


Complete = Callable[[str], list[str]]
WORDS = {  # of options with few values
    "form": ("displacement", "velocity-curvature", "hermite"),
    "contact": ("implicit", "extrapolated", "conserving", "averaged"),
}


def names_of(kind: str) -> list[str]:
    """All values of an option: of "form", "contact", "schemes", "methods", "integrators" or "problems"."""
    if kind in WORDS:
        return list(WORDS[kind])
    if kind == "problems":
        from ..testset.problem import problems

        return list(problems())
    from ..references.registry import REFERENCES
    from ..schemes.registry import RIGID, SCHEMES

    schemes = [scheme.__name__ for scheme in (*SCHEMES.values(), *RIGID.values())]
    return {"schemes": schemes, "methods": list(REFERENCES)}.get(kind, [*schemes, *REFERENCES])


def completion(kind: str) -> Complete:
    """The completion of the values of a kind, see ``names_of``: of the last one of a list, but for ``WORDS``. A comma
    inside parentheses separates no names."""

    def complete(incomplete: str) -> list[str]:
        from ..schemes.labels import split_runs

        last = split_runs(incomplete)[-1] if incomplete and kind not in WORDS else incomplete
        before = incomplete[: len(incomplete) - len(last)]
        return [before + name for name in names_of(kind) if name.startswith(last)]

    return complete


def cases(incomplete: str) -> list[str]:
    """The paper's tables, case files, and the folders that lead to them."""
    from ..files.cases import paper_cases

    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    files = [path for path in (folder.iterdir() if folder.is_dir() else ()) if not path.name.startswith(".")]
    paths = [f"{path}/" if path.is_dir() else str(path) for path in files if path.is_dir() or path.suffix == ".toml"]
    return [name for name in [*paper_cases(), *sorted(paths)] if name.startswith(incomplete)]


KIND = {"schemes": "schemes", "scheme": "schemes", "method": "methods", "contact": "contact", "form": "form"}


def option(words: str, kind: str = "") -> Any:
    """An option with its help and, where its values are of a ``kind``, their completion."""
    return typer.Option(help=words, autocompletion=completion(kind) if kind else None)


CASE: dict[str, Any] = {"help": "table1 .. table17, a case file, or file.toml:name", "autocompletion": cases}
Case = Annotated[str, typer.Argument(**CASE)]
Dt = Annotated[float | None, option("time step instead of the case's")]
TEnd = Annotated[float | None, option("end time instead of the case's")]
Form = Annotated[str | None, option("displacement, velocity-curvature or hermite", "form")]
Jobs = Annotated[int | None, option("processes; default: one per core")]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the records to FILE, - for stdout")]
References = Annotated[
    Path | None, option("folder of stored references; default: ./reference, or those of the package")
]
HIDDEN: dict[str, Any] = {"expose_value": False}
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", callback=_quiet, help="print nothing but errors and --json", **HIDDEN)
]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", callback=_verbose, help="one line on stderr per phase", **HIDDEN)
]


def shared() -> list[Any]:
    """--quiet and --verbose, as the command line has them in every command."""
    alone = typer.Typer(add_completion=False)

    @alone.command()
    def nothing(quiet: Quiet = False, verbose: Verbose = False) -> None: ...

    return [option for option in typer.main.get_command(alone).params if option.name in ("quiet", "verbose")]
