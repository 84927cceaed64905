"""Making tables: each in a process of its own, with pictures, trajectories and one JSON file of numbers."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

import stiffbeam
from stiffbeam.basics.text import plain
from stiffbeam.figures.chart import save_figure
from stiffbeam.files.cases import paper_cases
from stiffbeam.march.integrate import integrate

from .ensembles import EXACT_MEMBERS, MEMBERS, Numbers
from .figures import close_up, film, panels, picture, save_small, together
from .numbers import numbers_of
from .reading import Reading
from .table import Made, make_table

TABLES = tuple(range(1, 18))
FILM = "film.gif"
HERE, PACKAGE = Path(__file__).parent, Path(stiffbeam.__file__).parent
CODE = [
    *sorted(HERE.glob("*.py")),
    *(file for end in ("py", "c", "toml") for file in sorted(PACKAGE.rglob(f"*.{end}"))),
]
SOURCE = hashlib.sha256(b"".join(file.read_bytes() for file in CODE)).hexdigest()[:12]  # other code makes all again
STORED_STEPS = 20_000  # at most, of a trajectory in the store
# The longest first, so that no process is left alone with one of them.
LONGEST_FIRST = (1, 3, 4, 11, 8, 12, 7, 9, 5, 13, 16, 15, 6, 2, 10, 14, 17)


@dataclass(frozen=True)
class Finished:
    """A table that is done: its numbers, its pictures as (letter, title, file), and its film where there is one."""

    number: int
    numbers: Numbers
    pictures: list[tuple[str, str, Path]]
    film: Path | None = None


@dataclass(frozen=True)
class Job:
    """Instructions for the process that makes one table."""

    number: int
    reading: Reading
    folder: Path
    members: int
    exact_members: int

    @property
    def point(self) -> dict[str, Any]:
        """Options that tell this job from others of its table."""
        return self.reading.to_dict() | {"members": self.members, "exact_members": self.exact_members}


def stored(file: Path, point: dict[str, Any]) -> Any:
    """Return what ``store`` wrote for this point and this code, None if there is none."""
    found = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    return found["rows"] if found.get("point") == json.loads(json.dumps(point | {"source": SOURCE})) else None


def store(file: Path, point: dict[str, Any], rows: Any) -> Any:
    """Write rows of a point as one file, whole or not at all, and return them as they are read."""
    file.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"point": point | {"source": SOURCE}, "rows": plain(rows)})
    (part := file.with_suffix(".part")).write_text(text, encoding="utf-8")
    os.replace(part, file)
    return json.loads(text)["rows"]


def make_tables(
    tables: Sequence[int],
    reading: Reading,
    out: Path,
    jobs: int = 2,
    members: int = MEMBERS,
    exact_members: int = EXACT_MEMBERS,
) -> dict[int, Finished]:
    """Make ``tables`` in ``jobs`` processes, except those that ``out`` already holds.

    The numbers of a table are stored when all its files are there: an interruption loses unfinished tables only.
    """
    found: dict[int, Finished] = {}
    missing: list[Job] = []
    for number in sorted(tables, key=LONGEST_FIRST.index):
        job = Job(number, reading, out / reading.name / f"table{number}", members, exact_members)
        row = stored(job.folder / "numbers.json", job.point)
        if row is not None and all((job.folder / name).is_file() for name in row["files"]):
            found[number] = _finished(job, row)
        else:
            missing.append(job)
    rows = Parallel(n_jobs=min(jobs, max(1, len(missing))), return_as="generator")(
        delayed(make)(job) for job in missing
    )
    for job, row in zip(missing, rows, strict=True):
        found[job.number] = _finished(job, store(job.folder / "numbers.json", job.point, row))
        print(f"table {job.number} done, {len(found)} of {len(tables)}", file=sys.stderr)
    return {number: found[number] for number in sorted(found)}


def make(job: Job) -> dict[str, Any]:
    """Everything of one table: pictures and trajectories into its folder, the rest as one row."""
    made = make_table(paper_cases()[f"table{job.number}"], job.reading)
    numbers = numbers_of(made, job.members, job.exact_members)
    pictures = []
    for panel in panels(made):
        file = f"panel-{panel.letter.replace('′', '-delayed')}.png"
        save_small(picture(panel), job.folder / file)
        pictures.append([panel.letter, panel.title, file])
    whole = save_figure(together(made), job.folder / f"figure{job.number}.png")
    files = [file for _, _, file in pictures] + [whole.name]
    if job.number == 10:
        files.append(save_figure(close_up(made), job.folder / "close-up.svg").name)
        files.append(film(made, job.folder / FILM).name)
    files += _store(made, job)
    return {"numbers": numbers, "pictures": pictures, "files": files}


def _store(made: Made, job: Job) -> list[str]:
    """The trajectories as netCDF, thinned to STORED_STEPS; impacts and energy have seen every step."""
    case, names = made.case, []
    every = -(-round(case.t_end / case.dt) // STORED_STEPS)
    for equation in made.runs:
        scheme, form = made.equations[equation]
        chosen = job.reading.scheme(scheme)
        thin = integrate(made.systems[form], chosen, case.dt, case.t_end, job.reading.contact, every)
        names.append(thin.save(job.folder / f"run-{equation.strip('()')}.nc").name)
    return names


def _finished(job: Job, row: dict[str, Any]) -> Finished:
    pictures = [(letter, title, job.folder / file) for letter, title, file in row["pictures"]]
    return Finished(job.number, row["numbers"], pictures, job.folder / FILM if FILM in row["files"] else None)
