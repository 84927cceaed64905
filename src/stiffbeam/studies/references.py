"""Reference solutions: those stored in a folder with a manifest."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from ..basics.progress import TALK, Show, silent
from ..basics.storage import read_netcdf, write_whole
from ..basics.validation import InputError
from ..files.cases import Case, case_text, paper_cases
from ..files.store import contact_facts, freeze, load
from ..references import reference
from ..trajectory.trajectory import Reference, Trajectory

MANIFEST = "MANIFEST.json"
PARAMETERS = "decimals and multiples of pi exactly as written in the case, not the doubles nearest to them"
PACKAGED = Path(__file__).parents[1] / "frozen"  # where a wheel has the repository's folder
REPOSITORY = Path(__file__).parents[3] / "reference"


def shipped() -> Path | None:
    """Folder of stored references: ``./reference``, or that of the package."""
    return next((p for p in (Path("reference"), PACKAGED, REPOSITORY) if (p / MANIFEST).is_file()), None)


def check(target: Path, progress: Show = silent) -> list[dict[str, Any]]:
    """Check a stored file, or every file of a folder and of its manifest: hash, system, events and entry in the
    manifest. Returns one record a file; ``problem`` is empty for a good one.
    """
    if not target.is_dir():
        return [_checked(target, None)]
    known = {entry["file"]: entry for entry in _entries(target)}
    files = sorted({target / name for name in known} | {*target.glob("*.nc")})
    records = []
    for done, file in enumerate(files):
        progress(file.name, done, len(files))
        record = _checked(file, known.get(file.name))
        if file.name not in known and not record["problem"]:
            record["problem"] = "the manifest does not list it"
        records.append(record)
    return records or [{"file": MANIFEST, "problem": "it lists no references"}]


def _checked(file: Path, entry: dict[str, Any] | None) -> dict[str, Any]:
    record: dict[str, Any] = {"file": file.name, "problem": ""}
    try:
        solution = load(file)
        record |= {"impacts": solution.impacts.count, "t_end": solution.provenance["t_end"]}
        if entry is not None:
            record["problem"] = _contradicted(file, solution, entry)
    except InputError as error:
        record["problem"] = str(error)
    return record


def _contradicted(file: Path, solution: Trajectory, entry: dict[str, Any]) -> str:
    """Return the first difference between a file and its entry in the manifest, "" if there is none."""
    written = read_netcdf(file).attrs
    notes = solution.provenance
    facts: dict[str, Any] = contact_facts(solution) | {
        "t_end": notes["t_end"], "form": notes["form"], "digits": notes.get("digits"),
        "confirmed_with": notes.get("digits_confirmed_with"),
    } | {name: written.get(name) for name in ("hash", "bound")}  # fmt: skip
    for name, fact in facts.items():
        said = entry.get(name)
        same = math.isclose(said, fact, rel_tol=1e-6) if isinstance(said, float) and fact is not None else said == fact
        if not same:
            return f"the manifest says {said} {name.replace('_', ' ')}, and not {fact}"
    for table in entry.get("tables", ()):
        case = paper_cases().get(table)
        if case is None or case.system(entry["form"]).fingerprint != solution.fingerprint:
            return f"the manifest says it is of {table}, which is another system"
    return ""


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


def whole(folder: Path, progress: Show = silent) -> dict[str, float]:
    """Names and t_end of the frozen files that can be read, are of this version, and what the manifest says."""
    try:
        _entries(folder)
    except InputError:
        return {}
    return {record["file"]: record["t_end"] for record in check(folder, progress) if not record["problem"]}


def _entries(folder: Path) -> list[dict[str, Any]]:
    path = folder / MANIFEST
    if not path.is_file():
        raise InputError("folder", str(folder), f"hold a {MANIFEST}", "remake the references there")
    try:
        return json.loads(path.read_text(encoding="utf-8"))["references"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError("manifest", str(path), "be whole", f"remake the references there ({error})") from None


def note(folder: Path, entry: dict[str, Any]) -> None:
    """Add an entry to the manifest, in the order of the tables."""
    try:
        entries = {e["file"]: e for e in _entries(folder)}
    except InputError:  # there is none, or it cannot be read
        entries = {}
    entries[entry["file"]] = entry
    ordered = sorted(entries.values(), key=lambda e: (int(e["tables"][0].removeprefix("table")), e["form"]))
    text = json.dumps({"parameters": PARAMETERS, "references": ordered}, indent=2)
    write_whole(folder / MANIFEST, text + "\n")


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
    """Compute and store the missing references in ``folder``; returns the files written.

    A file that is complete, of this version and as the manifest states is kept. Interrupted work continues where it
    stopped, and a deleted file is computed again. All of them take about a quarter of an hour.
    """
    jobs, kept = wanted(), whole(folder, progress)
    written: list[str] = []
    for done, (name, form, tables) in enumerate(jobs):
        progress(f"{name}@{form}", done, len(jobs))
        file = folder / f"{name}-{form}.nc"
        case = paper_cases()[name]
        if kept.get(file.name) == case.t_end:
            continue
        solution = reference(case.system(form), case.t_end, "multiprecision")
        entry = freeze(solution, case_text(name), file) | {"tables": tables}
        note(folder, entry)
        TALK.kept = True
        written.append(file.name)
    return written


# Which method is the baseline: the most precise first.
