"""Where a command's files go: folders, names, and records for programs."""

from __future__ import annotations

import os
from pathlib import Path

from ..basics.words import cut


def default_folder(case: str) -> Path:
    """stiffbeam-output/<case>."""
    return Path("stiffbeam-output") / file_name(case)


def file_name(label: str) -> str:
    """The label without the characters that shells and file systems dislike, never a folder's name for another."""
    plain = label.replace("(", "-").replace(")", "").replace(", ", "-").replace("@", "-")
    return cut("".join(c if c.isalnum() or c in "-._=" else "_" for c in plain).lstrip("."), 100) or "_"


def make_folder(folder: Path, option: str = "--out") -> Path:
    """``folder``, made where it is not there; InputError where that cannot be, or nothing can be written there."""
    from ..basics.validation import InputError, file_path

    file_path(option, folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError("no permission to write")
    except OSError as error:
        raise InputError(option, str(folder), "be a folder that can be written to", str(error)) from None
    return folder


def check_json(file: Path | None) -> None:
    """InputError for a --json that no file can be, before anything is computed."""
    if file is None or str(file) == "-":
        return
    from ..basics.validation import InputError, file_path

    file_path("--json", file)
    if file.is_dir():
        raise InputError("--json", str(file), "be a file, or - for the terminal")
    make_folder(file.parent, "--json")
    if not os.access(file if file.exists() else file.parent, os.W_OK):
        raise InputError("--json", str(file), "be a file that can be written to")


def write_json(text: str, file: Path | None) -> bool:
    """Write the records where --json says; whether that is the terminal, which then shows nothing else."""
    if file is None:
        return False
    if str(file) == "-":
        print(text)
        return True
    from ..basics.whole_file import write_whole

    write_whole(file, text + "\n")
    return False
