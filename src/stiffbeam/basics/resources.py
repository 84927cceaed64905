"""Long calls: their memory, time, threads and processes; and their progress on stderr, a bar on a terminal, else
lines.

STIFFBEAM_MEMORY, in GiB, bounds what a call may hold at once, STIFFBEAM_THREADS sets the threads.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache
from importlib import import_module
from multiprocessing import current_process
from types import SimpleNamespace
from typing import Any, TypeVar

from .validation import InputError

MEMORY = 4.0  # GiB


def setting(name: str, default: float) -> float:
    """The positive number in an environment variable."""
    text = os.environ.get(name, "").strip()
    try:
        value = float(text) if text else default
    except ValueError:
        value = 0.0
    if not value > 0.0:
        raise InputError(name, text, "be a number > 0", f"unset it for {default:g}")
    return value


def afford(field: str, value: Any, remedy: str, floats: float) -> None:
    """Raise InputError where a call would hold more than the memory allowed: ``floats`` numbers of 8 bytes at once.

    field, value: of the argument that makes it so large.
    """
    allowed, gib = setting("STIFFBEAM_MEMORY", MEMORY), 8.0 * floats / 2**30
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
    from joblib import cpu_count

    return math.ceil(setting("STIFFBEAM_THREADS", cpu_count()))


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


Show = Callable[[str, int, int], None]
LOOK = 0.25  # s between two looks at the time
WAIT = 3.0  # s of work, after which a call from Python shows its progress
TALK = SimpleNamespace(quiet=False)  # quiet: no output, as with ``--quiet``


def silent(what: str, done: int, total: int) -> None:
    """Progress function that shows nothing."""


class Call:
    """Progress of a call, shown after ``wait`` seconds: by a bar on a terminal, else by lines, the first after WAIT
    seconds and each after three times as long as the one before."""

    def __init__(self, what: str, wait: float, show: Show | None) -> None:
        self.now, self.begun, self.wait, self.show = (what, 0, 0), time.perf_counter(), wait, show or self.update
        self.bar: Any = None

    def update(self, what: str, done: int, total: int) -> None:
        """State that ``done`` of ``total`` parts are done, total 0 where it is not known."""
        self.now = (what, done, total)
        if self.bar is not None:  # which with another total estimates anew the time that is left
            self.bar.update(self.bar.task_ids[0], description=what, completed=done, total=total or None)

    def look(self) -> None:
        """Open the bar, or print a line, if it is time."""
        if self.bar is not None or time.perf_counter() < self.begun + self.wait:
            return
        from rich.console import Console
        from rich.progress import Progress

        console, (what, done, total) = Console(stderr=True), self.now
        if console.is_terminal:
            bar = Progress(speed_estimate_period=600.0, console=console, transient=True)
            bar.add_task(what, completed=done, total=total or None)
            bar.start()
            self.bar = bar
        elif self.wait:
            share = f", {100 * done // total} % done" if done and total else ""
            print(f"stiffbeam: {self.wait:g} s so far, now {what}{share}", file=sys.stderr, flush=True)
        self.wait = 3.0 * self.wait or WAIT


def _watch() -> None:
    """Look at the first call in progress now and then."""
    while True:
        time.sleep(LOOK)
        with _LOCK:
            if _calls:
                _calls[0].look()


_LOCK = threading.Lock()
_WATCHER = threading.Thread(target=_watch, daemon=True)  # one for all calls: its start takes as long as a short one
_calls: list[Call] = []  # in progress


def current() -> Show:
    """The progress function of the call in progress, for parts of it that nothing passes it to."""
    return _calls[0].show if _calls else silent


@contextmanager
def working(what: str, asked: bool | Show | None = None) -> Generator[Show, None, None]:
    """Context of a call from Python, with BLAS on one thread, which is faster for products as small as these.

    Yields show(what, done, total): ``asked`` itself if it is a function, of a display at once for True, after WAIT
    seconds for None, one that shows nothing for False and inside another call.
    """
    with _LOCK:
        first = not _calls
        wanted = asked is True or (asked is None and current_process().name == "MainProcess")
        wait = (0.0 if asked else WAIT) if first and wanted and not TALK.quiet else float("inf")
        _calls.append(call := Call(what, wait, asked if callable(asked) else None))
        if _WATCHER.ident is None:
            _WATCHER.start()
        limit = _blas().limit(limits=1, user_api="blas") if first else nullcontext()
    try:
        with limit:
            yield call.show
    finally:
        with _LOCK:
            _calls.remove(call)
            if call.bar is not None:
                call.bar.stop()


@cache
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController

    import_module("scipy.linalg")  # its BLAS is another one than NumPy's
    return ThreadpoolController()
