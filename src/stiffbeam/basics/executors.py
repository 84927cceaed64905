"""Parts of an ensemble on the processes or machines of an Executor, of concurrent.futures, Dask or MPI."""

from __future__ import annotations

import pickle
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any

from .resources import Part
from .validation import InputError

_ALONE = threading.Lock()  # a process computes one part at a time, on however many threads its executor calls it
PART_SECONDS = 1.0  # of work of a part: so much is lost with a process
PARTS = 64  # at least, so that the processes end together


def require_executor(executor: Any) -> None:
    """Raise InputError for what is no Executor."""
    if not callable(getattr(executor, "submit", None)):
        remedy = "for example concurrent.futures.ProcessPoolExecutor(4)"
        raise InputError("executor", type(executor).__name__, "be an Executor, with a method submit", remedy)


def on_executor(
    executor: Executor,
    work: Callable[[Any], Part],
    items: Sequence[Any],
    seconds: float,
    progress: Callable[[int], None] | None,
) -> Iterator[Part]:
    """Results of ``work`` on slices of ``items``, in order; each result is as long as its slice.

    work: a function that can be pickled. seconds: rough time of an item. progress: called with the number of items
    done. Slices that are lost with a process are computed here, with a warning. Raises InputError for what cannot be
    sent to another process.
    """
    if not len(items):
        return
    size = max(1, min(int(PART_SECONDS / max(seconds, 1e-9)), -(-len(items) // PARTS)))
    slices = [items[i : i + size] for i in range(0, len(items), size)]
    try:
        pickle.dumps((work, slices[0]))
    except Exception as error:  # whatever the objects of others raise when they are pickled
        remedy = "leave executor out, or use functions at the top of a module of their own in place of a lambda"
        raise InputError("members", str(error), "travel to other processes", remedy) from None
    futures: list[Future[Part] | None] = []
    try:
        for each in slices:
            futures.append(_submitted(executor, work, each))
        done, lost = 0, 0
        for future, each in zip(futures, slices, strict=True):
            part = None if future is None else _result(future)
            if part is None:
                lost += len(each)
                part = work(each)
            done += len(part)
            if progress is not None:
                progress(done)
            yield part
        if lost:
            message = f"the executor lost {lost} of {len(items)} members with a process: this process computed them"
            warnings.warn(message, RuntimeWarning, stacklevel=4)
    finally:
        for future in futures:
            if future is not None:
                future.cancel()


def _submitted(executor: Executor, work: Callable[[Any], Part], items: Any) -> Future[Part] | None:
    """The future of a slice, None from an executor that has broken."""
    try:
        return executor.submit(_alone, work, items)
    except BrokenExecutor:
        return None


def _result(future: Future[Part]) -> Part | None:
    try:
        return future.result()
    except BrokenExecutor:
        return None


def _alone(work: Callable[[Any], Part], items: Any) -> Part:
    with _ALONE:
        return work(items)
