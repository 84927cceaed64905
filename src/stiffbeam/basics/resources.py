"""Memory, time, threads and processes of long calls.

STIFFBEAM_MEMORY, in GiB, bounds what a call may hold at once, STIFFBEAM_THREADS sets the threads.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

from .validation import InputError

MEMORY = 4.0  # GiB


def afford(field: str, value: Any, remedy: str, floats: float) -> None:
    """Raise InputError where a call would hold more than the memory allowed: ``floats`` numbers of 8 bytes at once.

    field, value: of the argument that makes it so large.
    """
    text = os.environ.get("STIFFBEAM_MEMORY", "").strip()
    try:
        allowed = float(text) if text else MEMORY
    except ValueError:
        allowed = 0.0
    if not allowed > 0.0:
        raise InputError("STIFFBEAM_MEMORY", text, "be a number > 0", f"unset it for {MEMORY:g}")
    gib = 8.0 * floats / 2**30
    # Written so that a size of NaN is refused.
    if not gib <= allowed:
        rule = f"take no more than {allowed:g} GiB of memory (it would take some {gib:.2g})"
        raise InputError(field, value, rule, f"{remedy}, or set STIFFBEAM_MEMORY")


clock = time.process_time  # CPU seconds of this process, which other programs do not lengthen


class OutOfTime(Exception):
    """End of the time of ``deadline``; t: the time that the motion has reached."""

    def __init__(self, t: float) -> None:
        super().__init__(t)
        self.t = t


Reached = Callable[[float], None]
_DEADLINE: ContextVar[tuple[float, float, Reached]] = ContextVar(
    "deadline", default=(float("inf"), 1.0, lambda t: None)
)


@contextmanager
def deadline(seconds: float, passes: float, reached: Reached) -> Generator[None, None, None]:
    """Context of the first of several passes alike, in which ``in_time`` raises OutOfTime once this process has
    computed for its share of the CPU seconds of all. reached: called with the times t that solvers have reached."""
    token = _DEADLINE.set((clock() + seconds / passes, passes, reached))
    try:
        yield
    finally:
        _DEADLINE.reset(token)


@contextmanager
def once() -> Generator[None, None, None]:
    """Context of work that no later pass repeats, such as compiling: it takes its time from all of them."""
    begun = clock()
    yield
    end, passes, reached = _DEADLINE.get()
    _DEADLINE.set((end + (1.0 - 1.0 / passes) * (clock() - begun), passes, reached))


def late(t: float) -> bool:
    """Return True past the ``deadline``: solvers call it at the times t that they have reached."""
    end, _, reached = _DEADLINE.get()
    reached(t)
    return clock() > end


def in_time(t: float) -> None:
    """Raise OutOfTime past the ``deadline``, see ``late``."""
    if late(t):
        raise OutOfTime(t)


Result = TypeVar("Result")
BATCH = 64  # items that one thread takes in one go


def cores() -> int:
    """Number of threads of an ensemble: STIFFBEAM_THREADS, or the cores that this process may use."""
    wanted = os.environ.get("STIFFBEAM_THREADS", "").strip()
    if wanted:
        if not wanted.isdigit() or int(wanted) < 1:
            raise InputError("STIFFBEAM_THREADS", wanted, "be an integer >= 1", "unset it to use every core")
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over(
    work: Callable[[Any], Result],
    items: Sequence[Any],
    progress: Callable[[int], None] | None = None,
    threads: int | None = None,
) -> Iterator[Result]:
    """Results of ``work`` on every item, in order.

    joblib runs them: on threads, ``cores`` by default, or on the backend of ``joblib.parallel_config``, which may be
    processes on this machine or on others. progress: called with the number of items done.
    """
    from joblib import Parallel, delayed
    from joblib.parallel import get_active_backend

    jobs: Any = get_active_backend()[1] or threads or cores()
    # Four batches for a worker, so that they end together.
    batch: Any = min(BATCH, max(1, len(items) // (4 * abs(jobs))))
    run: Any = Parallel(min(jobs, len(items) or 1), prefer="threads", return_as="generator", batch_size=batch)
    for done, result in enumerate(run(delayed(work)(item) for item in items), 1):
        if progress is not None:
            progress(done)
        yield result
