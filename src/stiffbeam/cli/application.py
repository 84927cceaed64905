"""The Typer application that the commands' modules add themselves to."""

from __future__ import annotations

import typer

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Fixed-step schemes beside adaptive and exact solutions of vibro-impact beams.",
)
