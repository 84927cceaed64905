"""Running a study: its points one by one or side by side, finished ones kept."""

from __future__ import annotations

import inspect
import multiprocessing
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..cases import Case, find_case
from ..trajectory import Diverged, SolverFailure
from ..validation import InputError, near
from .journal import Journal
from .study import Point, Records, Row, Study

Progress = Callable[[str, int, int], None]


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
    with ``failed``.
    """
    case = find_case(case) if isinstance(case, str) else case
    if jobs < 1:
        raise InputError("jobs", jobs, "be 1 or more")
    known = [name for name in inspect.signature(study.points).parameters if name != "case"]
    for name in options:
        if name not in known:
            raise InputError(f"option of {study.name}", name, "be one the study knows", near(name, known))
    begun = time.perf_counter()
    progress(f"{study.name}: planning", 0, 0)
    points = study.points(case, **{name: value for name, value in options.items() if value is not None})
    journal = Journal(None if folder is None else Path(folder), study.name, case)
    missing = [point for point in points if journal.rows(point) is None]
    finished = len(points) - len(missing)
    with _pool(study, len(missing), jobs, executor) as pool:
        for point, rows in _evaluate_all(study, case, missing, pool):
            journal.keep(point, rows)
            finished += 1
            progress(study.name, finished, len(points))
    rows = [row for point in points for row in journal.rows(point) or []]
    return Records(study, case, options, rows, time.perf_counter() - begun)


@contextmanager
def _pool(study: Study, points: int, jobs: int, executor: Executor | None) -> Iterator[Executor | None]:
    """The given executor, processes of our own, or None for this process.

    Never threads: SUNDIALS solvers do not share one. Spawned, since a forked jax or numba may hang.
    """
    if study.timed or points < 2 or (executor is None and jobs == 1):
        yield None
    elif executor is not None:
        yield executor
    else:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(jobs, points), mp_context=context) as own:
            try:
                yield own
            except BaseException:
                own.shutdown(cancel_futures=True)
                raise


def _evaluate_all(
    study: Study, case: Case, points: list[Point], pool: Executor | None
) -> Iterator[tuple[Point, list[Row]]]:
    if pool is None:
        for point in points:
            yield point, evaluate_point(study.evaluate, case, point)
        return
    futures = {pool.submit(evaluate_point, study.evaluate, case, point): point for point in points}
    for future in as_completed(futures):
        yield futures[future], future.result()


def evaluate_point(evaluate: Callable[[Case, Point], list[Row]], case: Case, point: Point) -> list[Row]:
    """The rows at one point, each with the point's own entries; a failure as a row."""
    try:
        found = evaluate(case, point)
    except (Diverged, SolverFailure, InputError) as error:
        found = [{"failed": str(error)}]
    return [point | row for row in found]
