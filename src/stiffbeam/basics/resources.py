"""Long calls: memory, time, threads, processes and progress. One that would take too much raises an error first.

STIFFBEAM_MEMORY, in GiB, and STIFFBEAM_SECONDS raise or lower what is allowed, STIFFBEAM_THREADS sets the threads.
"""

from __future__ import annotations

import os
import pickle
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence, Sized
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from .validation import InputError

MEMORY = 4.0  # GiB
SECONDS = 86400.0  # a day
LONG = 1.0  # s of compiling, from which on a display tells of it


def afford(field: str, value: Any, remedy: str, *, floats: float = 0.0, seconds: float = 0.0) -> None:
    """Raise InputError where a call would take more: ``floats`` numbers of 8 bytes at once, or ``seconds``.

    field, value: of the argument that makes it so large. Estimates are rough: they are there to tell what
    ends from what does not.
    """
    gib = 8.0 * floats / 2**30
    for cost, name, most, unit in (
        (gib, "STIFFBEAM_MEMORY", MEMORY, "GiB of memory"),
        (seconds, "STIFFBEAM_SECONDS", SECONDS, "seconds"),
    ):
        allowed = _allowed(name, most)
        # Written so that a cost of NaN is refused.
        if not cost <= allowed:
            rule = f"take no more than {allowed:g} {unit} (it would take some {cost:.2g})"
            raise InputError(field, value, rule, f"{remedy}, or set {name}")


class Clock:
    """Seconds by ``now`` without compiling and loading of kernels: the time that a second, equal run takes."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now, self._still, self._stopping, self._since = now, 0.0, 0, 0.0

    def __call__(self) -> float:
        """Return the time in seconds."""
        return (self._since if self._stopping else self._now()) - self._still

    def stop(self) -> None:
        """Stop the clock until ``go`` has been called as often as ``stop``."""
        if not self._stopping:
            self._since = self._now()
        # Calls nest: a kernel that is compiled may have others compiled.
        self._stopping += 1

    def stands(self) -> float:
        """Return the seconds since the clock stopped, 0.0 while it runs."""
        return self._now() - self._since if self._stopping else 0.0

    def go(self) -> None:
        """Start the clock again, see ``stop``."""
        self._stopping -= 1
        if not self._stopping:
            self._still += self._now() - self._since


clock = Clock(time.process_time)  # of the processor, which other programs on the machine do not lengthen
wall_clock = Clock(time.perf_counter)  # for work on several threads, which processor time would add up


@contextmanager
def stopped_clock() -> Generator[None, None, None]:
    """Context in which all Clocks are stopped."""
    for each in (clock, wall_clock):
        each.stop()
    try:
        yield
    finally:
        for each in (clock, wall_clock):
            each.go()


class Forecast:
    """Estimate of the cost of work over [0, t_end], extrapolated from its first part."""

    def __init__(self, t_end: float) -> None:
        self.t_end, self._clock, self.begun = t_end, clock, clock()
        # Below these amounts no forecast: a small first part is no basis for the whole. 2^27 numbers are 1 GiB.
        self._many = 0.02 * _allowed("STIFFBEAM_MEMORY", MEMORY) * 2**27
        self._early = min(60.0, 0.05 * _allowed("STIFFBEAM_SECONDS", SECONDS))

    def check(self, t: float, floats: float = 0.0) -> None:
        """Raise InputError at time t if the whole would be too much, given the amount of numbers so far; see
        ``afford``."""
        share = max(t / self.t_end, 1e-12)
        if floats > self._many:
            afford("t_end", self.t_end, "shorten t_end", floats=floats / share)
        elapsed = self._clock() - self.begun
        if elapsed > self._early:
            afford("t_end", self.t_end, "shorten t_end, or loosen rtol", seconds=elapsed / share)


def _allowed(name: str, most: float) -> float:
    text = os.environ.get(name, "").strip()
    try:
        allowed = float(text) if text else most
    except ValueError:
        allowed = 0.0
    if not allowed > 0.0:
        raise InputError(name, text, "be a number > 0", f"unset it for {most:g}")
    return allowed


Part = TypeVar("Part", bound=Sized)


def cores() -> int:
    """Number of threads of an ensemble: STIFFBEAM_THREADS, or the cores that this process may use."""
    wanted = os.environ.get("STIFFBEAM_THREADS", "").strip()
    if wanted:
        if not wanted.isdigit() or int(wanted) < 1:
            raise InputError("STIFFBEAM_THREADS", wanted, "be an integer >= 1", "unset it to use every core")
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over_slices(
    work: Callable[[Any], Part],
    items: Sequence[Any],
    most: int,
    threads: int,
    progress: Callable[[int], None] | None,
    least: int = 1,
) -> Iterator[Part]:
    """Results of ``work`` on slices of ``least`` to ``most`` items, in order; each result is as long as its slice.

    progress: called with the number of items done. Where a slice fails, those not begun are left out. A single slice
    starts no thread, which would take as long as hundreds of time steps.
    """
    # Four slices for a thread, so that the threads end together.
    size = min(most, max(least, 1, len(items) // (4 * threads))) if threads > 1 else most
    slices = [items[i : i + size] for i in range(0, len(items), size)]
    done = 0

    def reported(part: Part) -> Part:
        nonlocal done
        done += len(part)
        if progress is not None:
            progress(done)
        return part

    if len(slices) < 2 or threads == 1:
        yield from (reported(work(each)) for each in slices)
        return
    with ThreadPoolExecutor(threads) as pool:
        parts: list[Future[Any]] = [pool.submit(work, each) for each in slices]
        try:
            for part in parts:
                yield reported(part.result())
        finally:
            for part in parts:
                part.cancel()


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
    # Small enough for a lost process to cost little, and for many parts.
    size = max(1, min(int(PART_SECONDS / max(seconds, 1e-9)), -(-len(items) // PARTS)))
    slices = [items[i : i + size] for i in range(0, len(items), size)]
    # Tried here, so that the error names the members and not a queue of the executor.
    try:
        pickle.dumps((work, slices[0]))
    except Exception as error:  # whatever the objects of others raise when they are pickled
        remedy = "leave executor out, or use functions at the top of a module of their own in place of a lambda"
        raise InputError("members", str(error), "travel to other processes", remedy) from None
    futures: list[Future[Part] | None] = []
    try:
        # All are sent before the first result is waited for.
        for each in slices:
            futures.append(_submitted(executor, work, each))
        done, lost = 0, 0
        for future, each in zip(futures, slices, strict=True):
            # A broken executor returns nothing: this process computes what was lost.
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
            # An error, or a caller that stops early, leaves no slice that has not begun.
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


Show = Callable[[str, int, int], None]


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
        """Elapsed seconds of the phase, and the estimated rest if the length of the phase is known, or that kernels are
        being compiled."""

        def render(self, task: Task) -> Text:
            left = "" if task.time_remaining is None else f", about {task.time_remaining:.0f} s left"
            left = ", compiling once for this version" if wall_clock.stands() > LONG else left
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


@contextmanager
def displayed(asked: bool | Show) -> Generator[Show, None, None]:
    """The function show(what, done, total) that a ``progress`` argument asks for: of a display for True, one that shows
    nothing for False, else the function itself."""
    if not isinstance(asked, bool) and not callable(asked):
        raise InputError("progress", asked, "be True, False or a function", "leave it out")
    if asked is True:
        with progress() as show:
            yield show
    else:
        yield asked or silent


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
