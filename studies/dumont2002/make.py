"""Making tables: each in a process of its own, its pictures and trajectories written, its numbers journalled."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stiffbeam.basics.resources import cores
from stiffbeam.basics.storage import source_hash
from stiffbeam.figures.chart import save_figure
from stiffbeam.files.cases import paper_cases
from stiffbeam.march.integrate import integrate
from stiffbeam.studies.runner import Journal, processes, undisturbed

from .ensembles import EXACT_MEMBERS, MEMBERS, Numbers
from .figures import close_up, film, panels, picture, save_small, together
from .numbers import numbers_of
from .reading import Reading
from .table import Made, make_table

TABLES = tuple(range(1, 18))
FILM = "film.gif"
SOURCE = source_hash(Path(__file__).parent)[:12]  # a table of other code is made again
STORED_STEPS = 20_000  # at most, of a trajectory in the store
# The longest first, so that no process is left alone with one of them.
LONGEST_FIRST = (1, 3, 4, 11, 8, 12, 7, 9, 5, 13, 16, 15, 6, 2, 10, 14, 17)
Progress = Callable[[str, int, int], None]


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
        """The point that the journal knows this job by."""
        return self.reading.to_dict() | {"members": self.members, "exact_members": self.exact_members}


def make_tables(
    tables: Sequence[int],
    reading: Reading,
    out: Path,
    jobs: int = 2,
    members: int = MEMBERS,
    exact_members: int = EXACT_MEMBERS,
    progress: Progress = lambda what, done, total: None,
) -> dict[int, Finished]:
    """Make ``tables`` in ``jobs`` processes, those that ``out`` holds already left alone.

    A table is journalled when all its files are there, so that a kill loses the ones that are running only.
    """
    store = out / reading.name
    found: dict[int, Finished] = {}
    missing: dict[int, tuple[Job, Journal]] = {}
    for number in sorted(tables, key=LONGEST_FIRST.index):
        job = Job(number, reading, store / f"table{number}", members, exact_members)
        journal = Journal(store / "journal", f"reproduce-{SOURCE}", paper_cases()[f"table{number}"])
        rows = journal.rows(job.point)
        if rows is not None and all((job.folder / name).is_file() for name in rows[0]["files"]):
            found[number] = _finished(job, rows[0])
        else:
            missing[number] = (job, journal)
    waiting = {number: job for number, (job, _) in missing.items()}
    with closing(_run(waiting, jobs, len(found), progress)) as made:  # ends the processes too
        for number, row in made:
            job, journal = missing[number]
            found[number] = _finished(job, *journal.keep(job.point, [row]))
    return {number: found[number] for number in sorted(found)}


def _run(
    waiting: dict[int, Job], jobs: int, done: int, progress: Progress
) -> Generator[tuple[int, dict[str, Any]], None, None]:
    """(table, row) of every job as it is finished."""
    total = done + len(waiting)
    if jobs == 1 or len(waiting) == 1:
        for number, job in waiting.items():
            progress(f"table {number}", done, total)
            yield number, make(job)
            done += 1
        return
    queue = list(waiting.items())
    with processes(jobs, max(1, cores() // jobs)) as pool:
        running: dict[Future[Any], int] = {}
        while queue or running:
            while queue and len(running) < jobs:
                number, job = queue.pop(0)
                with undisturbed():
                    running[pool.submit(make, job)] = number
            progress("tables " + ", ".join(map(str, sorted(running.values()))), done, total)
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                done += 1
                yield running.pop(future), future.result()


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
