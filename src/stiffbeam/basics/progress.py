"""The progress display of every command, and of references from Python."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass

Show = Callable[[str, int, int], None]


@dataclass
class Talk:
    """Amount of progress output: nothing with ``--quiet``, one line for each phase with ``--verbose``."""

    quiet: bool = False
    verbose: bool = False


TALK = Talk()


def silent(what: str, done: int, total: int) -> None:
    """Progress function that shows nothing."""


@contextmanager
def progress() -> Generator[Show, None, None]:
    """A progress display on stderr, or in a notebook; silent where there is neither.

    Yields show(what, done, total), total 0 where it is not known. Bar and time left are those of the phase:
    one begins where the total is another, where less is done than before, and with every new name without a total.
    """
    if TALK.quiet or TALK.verbose:
        yield silent if TALK.quiet else _lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, Task, TextColumn
    from rich.text import Text

    class Clock(ProgressColumn):
        """Elapsed seconds of the phase, and the estimated rest if the length of the phase is known."""

        def render(self, task: Task) -> Text:
            left = "" if task.time_remaining is None else f", about {task.time_remaining:.0f} s left"
            return Text(f"{task.elapsed or 0.0:.0f} s{left}")

    console = Console(stderr=True)
    if not (console.is_terminal or console.is_jupyter):  # a hidden display of rich 13 ends with an empty line
        yield silent
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), Clock())
    with Progress(*columns, speed_estimate_period=600.0, console=console, transient=True) as display:
        task, phases = display.add_task("starting", total=None), _Phases()

        def show(what: str, done: int, total: int) -> None:
            if phases.begins(what, done, total):
                display.reset(task, description=what, completed=done, total=total or None)
            else:
                display.update(task, description=what, completed=done)

        yield show


class _Phases:
    """Detector of the calls of show(what, done, total) that begin a phase."""

    def __init__(self) -> None:
        self.last = ("", 0, -1)

    def begins(self, what: str, done: int, total: int) -> bool:
        name, before, of = self.last
        self.last = (what, done, total)
        # Without a total only a new name shows a new phase.
        return total != of or done < before or (total == 0 and what != name)


def _lines() -> Show:
    """Progress as lines on stderr: one at the start of each phase, with the elapsed time."""
    begun, phases = time.perf_counter(), _Phases()

    def show(what: str, done: int, total: int) -> None:
        if phases.begins(what, done, total):
            of = f" ({total})" if total else ""
            print(f"{time.perf_counter() - begun:8.2f} s  {what}{of}", file=sys.stderr, flush=True)

    return show
