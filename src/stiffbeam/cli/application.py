"""The Typer application that the commands' modules add themselves to."""

from __future__ import annotations

from importlib.metadata import version
from typing import Annotated

import typer

from .study_commands import Commands

app = typer.Typer(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Fixed-step schemes beside adaptive and exact solutions of vibro-impact beams.",
)


def _version(asked: bool) -> None:
    if asked:
        print(f"stiffbeam {version('stiffbeam')}")
        raise typer.Exit()


@app.callback()
def options(
    _: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="say the version")] = False,
) -> None:
    """Fixed-step schemes beside adaptive and exact solutions of vibro-impact beams."""
