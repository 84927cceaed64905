"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..basics.progress import TALK


def _quiet(given: bool) -> None:
    TALK.quiet = given


def _verbose(given: bool) -> None:
    TALK.verbose = given


Case = Annotated[str, typer.Argument(help="table1 .. table17, a case file, or file.toml:name")]
Jobs = Annotated[int | None, typer.Option(help="processes; default: one per core")]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the records here, - for stdout")]
References = Annotated[
    Path | None, typer.Option(help="folder of frozen references; default: ./reference, else those of the package")
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", callback=_quiet, expose_value=False, help="say nothing; errors and --json stay")
]
Verbose = Annotated[
    bool,
    typer.Option("--verbose", "-v", callback=_verbose, expose_value=False, help="a line on stderr for every phase"),
]


def shared() -> list[Any]:
    """--quiet and --verbose, as the command line has them in every command."""
    alone = typer.Typer(add_completion=False)

    @alone.command()
    def nothing(quiet: Quiet = False, verbose: Verbose = False) -> None: ...

    return [option for option in typer.main.get_command(alone).params if option.name in ("quiet", "verbose")]
