"""The progress display of every command."""

from __future__ import annotations

from contextlib import contextmanager


@contextmanager
def progress():
    """A progress display on stderr, silent when that is not a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(),
    )  # fmt: skip
    shown = {"console": console, "transient": True, "disable": not console.is_terminal}
    with Progress(*columns, speed_estimate_period=600.0, **shown) as display:
        task = display.add_task("starting", total=None)

        def show(what: str, done: int, total: int) -> None:
            display.update(task, description=what, completed=done, total=total or None)

        yield show
