"""The frozen references of the paper's tables, and how they are remade."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..basics.validation import InputError
from ..files.cases import case_text, paper_cases
from ..files.frozen import freeze
from ..references import reference
from ..studies.common import system_of
from ..studies.references import note, whole

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

    A file that is whole, of this version and what the manifest says is kept: interrupted work goes on where it
    stopped, and deleting a file remakes it. ``only``: names of tables. All of them take about a quarter of an hour.
    """
    jobs = [job for job in wanted() if only is None or set(only) & set(job[2])]
    if not jobs:
        raise InputError("only", only, "name tables of the paper", "for example table10")
    written, kept = [], whole(folder, progress)
    for done, (name, form, tables) in enumerate(jobs):
        progress(f"{name}@{form}", done, len(jobs))
        file = folder / f"{name}-{form}.nc"
        case = paper_cases()[name]
        if kept.get(file.name) == case.t_end:
            continue
        solution = reference(system_of(case, form), case.t_end, "multiprecision")
        entry = freeze(solution, case_text(name), file) | {"tables": tables}
        note(folder, entry)
        written.append(file.name)
    return written
