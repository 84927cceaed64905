"""The progress display of every command, and of references from Python."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager

Show = Callable[[str, int, int], None]


def silent(what: str, done: int, total: int) -> None:
    """Shows nothing."""


@contextmanager
def progress() -> Generator[Show, None, None]:
    """A progress display on stderr, or in a notebook; silent where there is neither.

    Yields show(what, done, total), total 0 where it is not known.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(),
    )  # fmt: skip
    hidden = not (console.is_terminal or console.is_jupyter)
    with Progress(*columns, speed_estimate_period=600.0, console=console, transient=True, disable=hidden) as display:
        task = display.add_task("starting", total=None)

        def show(what: str, done: int, total: int) -> None:
            display.update(task, description=what, completed=done, total=total or None)

        yield show
