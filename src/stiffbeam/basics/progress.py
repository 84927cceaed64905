"""Progress of long calls on stderr: a bar on a terminal or in a notebook, else one line; and BLAS on one thread."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import current_process
from typing import Any

from .validation import InputError

Show = Callable[[str, int, int], None]
WAIT = 3.0  # s of work, after which a call from Python shows what is going on
LOOK = 0.05  # s between two looks at the displays that wait


@dataclass
class Talk:
    """Amount of progress output: nothing with ``--quiet``, one line for each phase with ``--verbose``.

    kept: True once a part is finished and stored that the same command, run again, does not compute again.
    """

    quiet: bool = False
    verbose: bool = False
    kept: bool = False


TALK = Talk()


def silent(what: str, done: int, total: int) -> None:
    """Progress function that shows nothing."""


class Display:
    """Progress of one call: a bar on a terminal, a line at the start of each phase with ``--verbose``.

    A phase begins where the total is another, where less is done than before, and with every new name without a total.
    Elsewhere than on a terminal there is one line, after WAIT seconds.
    """

    def __init__(self, what: str, wait: float) -> None:
        self.now, self.bar, self.begun = (what, 0, -1), None, time.perf_counter()
        self.opens = self.begun + wait
        if TALK.verbose or not wait:
            self.open()
        else:
            _WATCH.add(self)

    def show(self, what: str, done: int, total: int) -> None:
        """State that ``done`` of ``total`` parts are done, total 0 where it is not known."""
        name, before, of = self.now
        begins = total != of or done < before or (total == 0 and what != name)
        self.now = (what, done, total)
        if begins and TALK.verbose:
            seconds = time.perf_counter() - self.begun
            print(f"{seconds:8.2f} s  {what}{f' ({total})' if total else ''}", file=sys.stderr, flush=True)
        elif self.bar is not None:
            task = self.bar.task_ids[0]
            if begins:
                self.bar.reset(task, description=what, completed=done, total=total or None)
            else:
                self.bar.update(task, description=what, completed=done)

    def close(self) -> None:
        """End the display."""
        _WATCH.remove(self)
        if self.bar is not None:
            self.bar.stop()

    def open(self) -> None:
        """Show the bar, or the line."""
        if TALK.verbose or TALK.quiet:
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        console = Console(stderr=True)
        if console.is_terminal or (console.is_jupyter and find_spec("ipywidgets")):
            columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), "left:",
                       TimeRemainingColumn())  # fmt: skip
            bar = Progress(*columns, speed_estimate_period=600.0, console=console, transient=True)
            bar.add_task(self.now[0], completed=self.now[1], total=max(self.now[2], 0) or None)
            bar.start()
            self.bar = bar
        elif time.perf_counter() < self.begun + WAIT:
            self.opens = self.begun + WAIT
            _WATCH.add(self)
        else:
            print(f"stiffbeam: {self.now[0]}, for {WAIT:g} s so far", file=sys.stderr, flush=True)


class Watch:
    """Displays that wait for their time. Short calls one after the other share one thread, which ends with them."""

    def __init__(self) -> None:
        self._waiting: list[Display] = []
        self._lock, self._runs = threading.Lock(), False

    def add(self, display: Display) -> None:
        """Open the display at its time, unless it is removed before."""
        with self._lock:
            self._waiting.append(display)
            starts, self._runs = not self._runs, True
        if starts:
            threading.Thread(target=self._look, daemon=True).start()

    def remove(self, display: Display) -> None:
        """Forget a display whose call has ended."""
        with self._lock:
            if display in self._waiting:
                self._waiting.remove(display)

    def _look(self) -> None:
        while True:
            time.sleep(LOOK)
            with self._lock:
                self._runs = bool(self._waiting)
                if not self._runs:
                    return
                due = [display for display in self._waiting if time.perf_counter() >= display.opens]
                self._waiting = [display for display in self._waiting if display not in due]
            for display in due:
                display.open()


_WATCH = Watch()
_LOCK = threading.Lock()
_calls: list[tuple[Any, Show]] = []  # calls in progress; the first has the display and the limit on BLAS


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
        if asked is True or (asked is None and limit is not None and current_process().name == "MainProcess"):
            display = Display(what, 0.0 if asked else WAIT)
        show = display.show if display is not None else asked if callable(asked) else silent
        _calls.append((limit, show))
    try:
        yield show
    finally:
        if display is not None:
            display.close()
        with _LOCK:
            _calls.pop()
            if limit is not None:
                limit.restore_original_limits()


@contextmanager
def progress() -> Generator[Show, None, None]:
    """Display of a command: ``working`` that shows its progress at once."""
    with working("starting", not TALK.quiet) as show:
        yield show


@cache
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController

    import_module("scipy.linalg")  # its BLAS is another one than NumPy's
    return ThreadpoolController()
