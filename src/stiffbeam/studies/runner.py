"""Running a study: its points one by one or side by side, finished ones kept."""

from __future__ import annotations

import inspect
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..cases import Case, find_case
from ..march.ensemble import cores
from ..trajectory import Diverged, SolverFailure, Unfinished
from ..validation import InputError, near, positive
from .journal import Journal
from .study import Point, Records, Row, Study

Progress = Callable[[str, int, int], None]
DEATHS = 3  # of processes without a point in between, until it is given up
GO_ON = "what is finished is kept, the same command goes on from there"
_ALONE = threading.Lock()  # a process evaluates one point at a time, whatever executor it belongs to


def run_study(
    study: Study,
    case: Case | str,
    folder: str | Path | None = None,
    jobs: int = 1,
    executor: Executor | None = None,
    progress: Progress = lambda what, done, total: None,
    **options: Any,
) -> Records:
    """Evaluate every point of ``study`` on ``case``.

    folder: where the journal of finished points is kept; a second run with the same folder computes the
    missing ones only. jobs: processes to use, unless an ``executor`` is given; a timed study runs point
    by point whatever they say. options: the study's own, see its ``points``. A point that fails is a row
    with ``failed``. Raises InputError, and Unfinished where processes keep dying.
    """
    case = find_case(case) if isinstance(case, str) else case
    if not isinstance(case, Case):
        remedy = "studies refine and vary the beam itself; for a System use integrate, reference and compare"
        raise InputError("case", type(case).__name__, "be a case, its name or a case file", remedy)
    if jobs < 1:
        raise InputError("jobs", jobs, "be 1 or more")
    known = [name for name in inspect.signature(study.points).parameters if name != "case"]
    for name in options:
        if name not in known:
            raise InputError(f"option of {study.name}", name, "be one the study knows", near(name, known))
    options = {name: value.tolist() if hasattr(value, "tolist") else value for name, value in options.items()}
    for name in ("dt", "t_end"):
        if options.get(name) is not None:
            positive(name, options[name])
    begun = time.perf_counter()
    progress(f"{study.name}: planning", 0, 0)
    points = study.points(case, **{name: value for name, value in options.items() if value is not None})
    journal = Journal(None if folder is None else Path(folder), study.name, case)
    missing = [point for point in points if journal.rows(point) is None]
    finished = len(points) - len(missing)
    progress(study.name, finished, len(points))
    for point, rows in _evaluate_all(study, case, missing, jobs, executor):
        journal.keep(point, rows)
        finished += 1
        progress(study.name, finished, len(points))
    rows = [row for point in points for row in journal.rows(point) or []]
    return Records(study, case, options, rows, time.perf_counter() - begun)


def _evaluate_all(
    study: Study, case: Case, points: list[Point], jobs: int, executor: Executor | None
) -> Iterator[tuple[Point, list[Row]]]:
    """Here, on the executor, or on processes of our own; points as they are finished."""
    if study.timed or len(points) < 2 or (executor is None and jobs == 1):
        for point in points:
            yield point, evaluate_point(study.evaluate, case, point)
    elif executor is not None:
        lost = yield from _gather(executor, study, case, points)
        if lost:
            raise Unfinished(f"the executor lost {len(lost)} points of {study.name}: {GO_ON}")
    else:
        yield from _on_processes(study, case, points, jobs)


def _on_processes(study: Study, case: Case, points: list[Point], jobs: int) -> Iterator[tuple[Point, list[Row]]]:
    """On processes that share the cores; where one is killed, new ones take what is missing.

    Never threads: SUNDIALS solvers do not share one. Spawned, since a forked jax or numba may hang.
    """
    context = multiprocessing.get_context("spawn")
    deaths = 0
    while points:
        workers = min(jobs, len(points))
        pool = ProcessPoolExecutor(workers, context, _follow)
        with _threads(max(1, cores() // workers)):
            try:
                lost = yield from _gather(pool, study, case, points)
            finally:
                pool.shutdown(cancel_futures=True)
        deaths = deaths + 1 if len(lost) == len(points) else 0
        if deaths == DEATHS:
            raise Unfinished(f"a process of {study.name} died {deaths} times in a row: is there enough memory? {GO_ON}")
        points = lost


def _gather(
    pool: Executor, study: Study, case: Case, points: list[Point]
) -> Generator[tuple[Point, list[Row]], None, list[Point]]:
    """Points as they are finished; returns those that were lost with their process."""
    lost = []
    futures: dict[Future, Point] = {}
    try:
        for point in points:
            futures[pool.submit(evaluate_point, study.evaluate, case, point)] = point
    except BrokenExecutor:
        lost = points[len(futures) :]
    for future in as_completed(futures):
        if isinstance(future.exception(), BrokenExecutor):
            lost.append(futures[future])
        else:
            yield futures[future], future.result()
    return lost


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Processes that are started meanwhile use so many threads, in ensembles and in the BLAS.

    The matrices are so small that threads of the BLAS mostly wait for each other.
    """
    names = ("STIFFBEAM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    before = {name: os.environ.pop(name) for name in names if name in os.environ}
    os.environ.update(dict.fromkeys(names, str(count)))
    try:
        yield
    finally:
        for name in names:
            del os.environ[name]
        os.environ.update(before)


def _follow() -> None:
    """A worker ends when the process that started it is gone."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def evaluate_point(evaluate: Callable[[Case, Point], list[Row]], case: Case, point: Point) -> list[Row]:
    """The rows at one point, each with the point's own entries but lists; a failure as a row."""
    with _ALONE:
        try:
            found = evaluate(case, point)
        except (Diverged, SolverFailure, InputError) as error:
            found = [{"failed": str(error)}]
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            found = [{"failed": f"{type(error).__name__}: {error}"}]
    own = {name: value for name, value in point.items() if not isinstance(value, list)}
    return [own | row for row in found]
