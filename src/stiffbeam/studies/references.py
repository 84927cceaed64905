"""The frozen references of the paper's tables: remake them, check them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..cases import Case, case_text, paper_cases
from ..frozen import freeze
from ..solvers import reference
from ..store import load
from ..trajectory import Reference
from ..validation import InputError
from .common import system_of

MANIFEST = "MANIFEST.json"
Progress = Callable[[str, int, int], None]


def wanted() -> list[tuple[str, str, list[str]]]:
    """(first table, form, all tables) of every distinct system among the paper's runs; tables with the
    same physics, grid and time span share one reference."""
    found: dict[tuple[str, float], tuple[str, str, list[str]]] = {}
    for case in paper_cases().values():
        for form in ["displacement", *sorted({form for _, form in case.runs} - {"displacement"})]:
            key = (system_of(case, form).fingerprint, case.t_end)
            found.setdefault(key, (case.name, form, []))[2].append(case.name)
    return list(found.values())


def remake(
    folder: Path, only: list[str] | None = None, progress: Progress = lambda what, done, total: None
) -> list[str]:
    """Compute and freeze what is missing in ``folder``; returns the files written.

    A file that is whole and of this version is kept: interrupted work goes on where it stopped, and
    deleting a file remakes it. ``only``: names of tables. All of them take about a quarter of an hour.
    """
    jobs = [job for job in wanted() if only is None or set(only) & set(job[2])]
    if not jobs:
        raise InputError("only", only, "name tables of the paper")
    written = []
    for done, (name, form, tables) in enumerate(jobs):
        progress(f"{name}@{form}", done, len(jobs))
        file = folder / f"{name}-{form}.nc"
        if _whole(file):
            continue
        case = paper_cases()[name]
        solution = reference(system_of(case, form), case.t_end, "multiprecision")
        entry = freeze(solution, case_text(name), file) | {"tables": tables}
        _note(folder, entry)
        written.append(file.name)
    return written


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


def _whole(file: Path) -> bool:
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


def _note(folder: Path, entry: dict[str, Any]) -> None:
    """Put an entry into the manifest, in the order of the tables."""
    entries = {e["file"]: e for e in (_entries(folder) if (folder / MANIFEST).is_file() else [])}
    entries[entry["file"]] = entry
    ordered = sorted(entries.values(), key=lambda e: (int(e["tables"][0].removeprefix("table")), e["form"]))
    text = json.dumps({"references": ordered}, indent=2)
    partial = folder / f"{MANIFEST}.partial"
    partial.write_text(text + "\n", encoding="utf-8")
    partial.replace(folder / MANIFEST)
