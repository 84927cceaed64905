"""Frozen references in a folder with a manifest: find, check and list them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..basics.validation import InputError
from ..basics.whole_file import write_whole
from ..files.cases import Case
from ..files.store import load
from ..trajectory.trajectory import Reference
from .common import system_of

MANIFEST = "MANIFEST.json"
PARAMETERS = "decimals and multiples of pi exactly as written in the case, not the doubles nearest to them"
Progress = Callable[[str, int, int], None]
PACKAGED = Path(__file__).parents[1] / "frozen"  # where a wheel has the repository's folder
REPOSITORY = Path(__file__).parents[3] / "reference"


def shipped() -> Path | None:
    """The folder of frozen references: ``./reference``, else what came with the package."""
    return next((p for p in (Path("reference"), PACKAGED, REPOSITORY) if (p / MANIFEST).is_file()), None)


def check(target: Path, progress: Progress = lambda what, done, total: None) -> list[dict[str, Any]]:
    """Read a frozen file, or every file of a folder's manifest, and hold it against hash, system and
    switches. Returns one record a file; ``problem`` is empty for a good one."""
    files = [target]
    known: dict[str, Any] = {}
    if target.is_dir():
        known = {entry["file"]: entry for entry in _entries(target)}
        files = [target / name for name in known]
    records = []
    for done, file in enumerate(files):
        progress(file.name, done, len(files))
        record: dict[str, Any] = {"file": file.name, "problem": ""}
        try:
            found = load(file)
            record |= {"impacts": found.impacts.count, "t_end": found.provenance["t_end"]}
            entry = known.get(file.name)
            if entry is not None and entry["impacts"] != found.impacts.count:
                record["problem"] = f"the manifest says {entry['impacts']} impacts"
        except InputError as error:
            record["problem"] = str(error)
        records.append(record)
    return records


def frozen(folder: Path, case: Case, form: str, t_end: float) -> Reference | None:
    """The frozen solution of ``case`` over at least [0, t_end] in ``folder``, None where there is none.

    A case that has a table's name but not its physics finds nothing.
    """
    for entry in _entries(folder):
        if case.name in entry["tables"] and entry["form"] == form and entry["t_end"] >= t_end:
            found = load(folder / entry["file"])
            if isinstance(found, Reference) and found.fingerprint == system_of(case, form).fingerprint:
                return found
    return None


def is_whole(file: Path) -> bool:
    """Whether a frozen file can be read and is of this version."""
    try:
        load(file)
    except InputError:
        return False
    return True


def _entries(folder: Path) -> list[dict[str, Any]]:
    path = folder / MANIFEST
    if not path.is_file():
        raise InputError("folder", str(folder), f"hold a {MANIFEST}", "remake the references there")
    try:
        return json.loads(path.read_text(encoding="utf-8"))["references"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError("manifest", str(path), "be whole", f"remake the references there ({error})") from None


def note(folder: Path, entry: dict[str, Any]) -> None:
    """Put an entry into the manifest, in the order of the tables."""
    entries = {e["file"]: e for e in (_entries(folder) if (folder / MANIFEST).is_file() else [])}
    entries[entry["file"]] = entry
    ordered = sorted(entries.values(), key=lambda e: (int(e["tables"][0].removeprefix("table")), e["form"]))
    text = json.dumps({"parameters": PARAMETERS, "references": ordered}, indent=2)
    write_whole(folder / MANIFEST, text + "\n")
