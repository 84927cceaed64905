"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Case = Annotated[str, typer.Argument(help="table1 .. table17, a case file, or file.toml:name")]
Jobs = Annotated[int | None, typer.Option(help="processes; default: one per core")]
Json = Annotated[Path | None, typer.Option("--json", help="write the records here, - for stdout")]
References = Annotated[
    Path | None, typer.Option(help="folder of frozen references; default: ./reference, else those of the package")
]
