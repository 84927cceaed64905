"""Progress of long calls on stderr: a bar on a terminal or in a notebook, else one line; and BLAS on one thread."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import current_process
from types import SimpleNamespace
from typing import Any

from .validation import InputError

Show = Callable[[str, int, int], None]
LOOK = 0.25  # s between two looks at the time
WAIT = 3.0  # s of work, after which a call from Python shows what is going on


# quiet: no output, as with ``--quiet``. kept: a part is finished and stored that the same command, run again, does not
# compute again.
TALK = SimpleNamespace(quiet=False, kept=False)


def silent(what: str, done: int, total: int) -> None:
    """Progress function that shows nothing."""


class Display:
    """Progress of one call: a bar on a terminal, at once where it was ``asked`` for; else a line after WAIT seconds
    and after each threefold of them."""

    def __init__(self, what: str, asked: bool) -> None:
        self.now, self.begun = (what, 0, 0), time.perf_counter()
        self.passed = WAIT  # s, after which it opens, or prints its next line
        self.bar = self.drawn() if asked else None

    def show(self, what: str, done: int, total: int) -> None:
        """State that ``done`` of ``total`` parts are done, total 0 where it is not known."""
        _, before, of = self.now
        self.now = (what, done, total)
        if self.bar is not None:
            # Where another total begins the time that is left is estimated anew.
            change = self.bar.reset if total != of or done < before else self.bar.update
            change(self.bar.task_ids[0], description=what, completed=done, total=total or None)

    def open(self) -> None:
        """Show the bar, or a line, if it is time."""
        if self.bar is not None or time.perf_counter() < self.begun + self.passed:
            return
        self.bar = self.drawn()
        if self.bar is None:
            what, done, total = self.now
            share = f", {100 * done // total} % done" if done and total else ""
            print(f"stiffbeam: {self.passed:g} s so far, now {what}{share}", file=sys.stderr, flush=True)
            self.passed *= 3.0

    def drawn(self) -> Any:
        """The bar, None where it cannot be drawn."""
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        console, (what, done, total) = Console(stderr=True), self.now
        if not (console.is_terminal or (console.is_jupyter and find_spec("ipywidgets"))):
            return None
        columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), "left:",
                   TimeRemainingColumn())  # fmt: skip
        bar = Progress(*columns, speed_estimate_period=600.0, console=console, transient=True)
        bar.add_task(what, completed=done, total=total or None)
        bar.start()
        return bar


_LOCK = threading.Lock()
_watched = threading.Event()  # set while a thread opens displays
# Limit on BLAS, progress function and display of the calls in progress; only the first has a limit and a display.
_calls: list[tuple[Any, Show, Display | None]] = []


def _watch() -> None:
    """Open the display of a long call. Short calls one after the other share this thread, which ends with them: a
    thread a call would double the time of a short one."""
    while True:
        time.sleep(LOOK)
        with _LOCK:
            if not _calls:
                _watched.clear()
                return
            if _calls[0][2] is not None:
                _calls[0][2].open()


def current() -> Show:
    """The progress function of the call in progress, for parts of it that nothing passes it to."""
    return _calls[0][1] if _calls else silent


@contextmanager
def working(what: str, asked: bool | Show | None = None) -> Generator[Show, None, None]:
    """Context of a call from Python, with BLAS on one thread, which is faster for products as small as these.

    Yields show(what, done, total): ``asked`` itself if it is a function, of a display at once for True, after WAIT
    seconds for None, one that shows nothing for False and inside another call.
    """
    if asked is not None and not isinstance(asked, bool) and not callable(asked):
        raise InputError("progress", asked, "be True, False or a function", "leave it out")
    display = None
    with _LOCK:
        limit = None if _calls else _blas().limit(limits=1, user_api="blas")
        shows = asked is True or (asked is None and current_process().name == "MainProcess")
        if limit is not None and shows and not TALK.quiet:
            display = Display(what, asked is True)
        show = display.show if display is not None else asked if callable(asked) else silent
        _calls.append((limit, show, display))
        if display is not None and not _watched.is_set():
            _watched.set()
            threading.Thread(target=_watch, daemon=True).start()
    try:
        yield show
    finally:
        with _LOCK:
            _calls.pop()
            if display is not None and display.bar is not None:
                display.bar.stop()
            if limit is not None:
                limit.restore_original_limits()


@cache
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController

    import_module("scipy.linalg")  # its BLAS is another one than NumPy's
    return ThreadpoolController()
