"""Output of commands: the terminal, folders, JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from ..basics.progress import TALK
from ..basics.storage import make_folder
from ..basics.text import cut, plain
from ..basics.validation import InputError, file_path, positive

if TYPE_CHECKING:
    from ..files.cases import Case

# Options that several commands have.
CaseName = Annotated[str, Parameter(help="table1 .. table17, a case file, or file.toml:name.")]
Step = Annotated[float | None, Parameter(help="Time step in place of the case's.")]
EndTime = Annotated[float | None, Parameter(help="End time in place of the case's.")]
Form = Annotated[str | None, Parameter(help="displacement, velocity-curvature or hermite.")]
Json = Annotated[
    Path | None, Parameter(allow_leading_hyphen=True, help="Write the records to this file, - for stdout.")
]


def asked_case(case: str, dt: float | None, t_end: float | None) -> Case:
    """The case, with the time step and the end time that are given."""
    from ..files.cases import find_case

    given = {"dt": dt, "t_end": t_end}
    asked = {name: positive(f"--{name.replace('_', '-')}", x) for name, x in given.items() if x is not None}
    return replace(find_case(case), **asked)


def say(text: str) -> None:
    """Print a line unchanged, of any length; nothing with --quiet."""
    if not TALK.quiet:
        print(text)


def default_folder(case: str) -> Path:
    """stiffbeam-output/<case>."""
    return Path("stiffbeam-output") / file_name(case)


def file_name(label: str) -> str:
    """The label without the characters that shells and file systems dislike, never a folder's name for another."""
    plain = label.replace("(", "-").replace(")", "").replace(", ", "-").replace("@", "-")
    return cut("".join(c if c.isalnum() or c in "-._=" else "_" for c in plain).lstrip("."), 100) or "_"


def check_json(file: Path | None) -> None:
    """Raise InputError for a --json that cannot be a file, before anything is computed."""
    if file is None or str(file) == "-":
        return
    file_path("--json", file)
    if file.is_dir():
        raise InputError("--json", str(file), "be a file, or - for the terminal", "name a file in that folder")
    make_folder(file.parent, "--json")
    if not os.access(file if file.exists() else file.parent, os.W_OK):
        raise InputError("--json", str(file), "be a file that can be written to", "name another, or - for the terminal")


def json_text(command: str, records: Mapping[str, Any]) -> str:
    """The records of a command as JSON, which has no NaN: its name and the version of the package come first."""
    head = {"stiffbeam": version("stiffbeam"), "command": command}
    return json.dumps(plain(head | dict(records)), indent=2, ensure_ascii=False, allow_nan=False)


def write_json(command: str, records: Mapping[str, Any], file: Path | None) -> bool:
    """Write the records to the file of --json. Returns True if that is the standard output, which then has nothing
    else."""
    if file is None:
        return False
    text = json_text(command, records)
    if str(file) == "-":
        print(text)
        return True
    from ..basics.storage import write_whole

    write_whole(file, text + "\n")
    return False
