"""Reference solutions: those stored in a folder with a manifest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..basics.progress import TALK, Show, silent
from ..basics.storage import read_netcdf, write_whole
from ..basics.validation import InputError
from ..files.cases import Case, case_text, paper_cases
from ..files.store import freeze, load
from ..references import reference
from ..trajectory.trajectory import Reference

MANIFEST = "MANIFEST.json"
PARAMETERS = "decimals and multiples of pi exactly as written in the case, not the doubles nearest to them"
PACKAGED = Path(__file__).parents[1] / "frozen"  # where a wheel has the repository's folder
REPOSITORY = Path(__file__).parents[3] / "reference"


def shipped() -> Path | None:
    """Folder of stored references: ``./reference``, or that of the package."""
    return next((p for p in (Path("reference"), PACKAGED, REPOSITORY) if (p / MANIFEST).is_file()), None)


def check(folder: Path, progress: Show = silent) -> dict[str, str]:
    """Faults of each file that the manifest lists, "" where its hash, its system and its events are good."""
    entries = _entries(folder)
    problems = {}
    for done, entry in enumerate(entries):
        progress(entry["file"], done, len(entries))
        problems[entry["file"]] = _problem(folder / entry["file"], entry)
    return problems


def _problem(file: Path, entry: dict[str, Any]) -> str:
    try:
        solution = load(file)
    except InputError as error:
        return str(error)
    if read_netcdf(file).attrs.get("hash") != entry["hash"]:
        return "the manifest has the hash of another file"
    systems = {table: paper_cases()[table].system(entry["form"]) for table in entry["tables"]}
    wrong = [table for table, system in systems.items() if system.fingerprint != solution.fingerprint]
    return f"the system of {', '.join(wrong)} is another one" if wrong else ""


def frozen(folder: Path, case: Case, form: str, t_end: float) -> Reference | None:
    """The stored solution of ``case`` over at least [0, t_end] in ``folder``, None if there is none.

    A case with the name of a table but other physics has none.
    """
    for entry in _entries(folder):
        if case.name in entry["tables"] and entry["form"] == form and entry["t_end"] >= t_end:
            solution = load(folder / entry["file"])
            if isinstance(solution, Reference) and solution.fingerprint == case.system(form).fingerprint:
                return solution
    return None


def _entries(folder: Path) -> list[dict[str, Any]]:
    path = folder / MANIFEST
    if not path.is_file():
        raise InputError("folder", str(folder), f"hold a {MANIFEST}", "remake the references there")
    try:
        return json.loads(path.read_text(encoding="utf-8"))["references"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError("manifest", str(path), "be whole", f"remake the references there ({error})") from None


def wanted() -> list[tuple[str, str, list[str]]]:
    """Return (first table, form, all tables) of every distinct system among the paper's runs.

    Tables with the same physics, grid and time span share one reference.
    """
    systems: dict[tuple[str, float], tuple[str, str, list[str]]] = {}
    for case in paper_cases().values():
        for form in ["displacement", *sorted({form for _, form in case.runs} - {"displacement"})]:
            key = (case.system(form).fingerprint, case.t_end)
            systems.setdefault(key, (case.name, form, []))[2].append(case.name)
    return list(systems.values())


def remake(folder: Path, progress: Show = silent) -> list[str]:
    """Compute and store the references that ``folder`` lacks or that ``check`` finds wrong; returns the files written.

    Interrupted work continues where it stopped. All of them take about a quarter of an hour.
    """
    try:
        entries, problems = {entry["file"]: entry for entry in _entries(folder)}, check(folder, progress)
    except InputError:  # there is no manifest, or it cannot be read
        entries, problems = {}, {}
    jobs, written = wanted(), list[str]()
    for done, (name, form, tables) in enumerate(jobs):
        file = folder / f"{name}-{form}.nc"
        if problems.get(file.name) == "":
            continue
        progress(f"{name}@{form}", done, len(jobs))
        case = paper_cases()[name]
        solution = reference(case.system(form), case.t_end, "multiprecision")
        entries[file.name] = freeze(solution, case_text(name), file) | {"tables": tables}
        ordered = sorted(entries.values(), key=lambda e: (int(e["tables"][0].removeprefix("table")), e["form"]))
        text = json.dumps({"parameters": PARAMETERS, "references": ordered}, indent=2)
        write_whole(folder / MANIFEST, text + "\n")
        TALK.kept = True
        written.append(file.name)
    return written
