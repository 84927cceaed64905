"""Tasks in processes that may use so much processor time and memory, and that others are not harmed by."""

from __future__ import annotations

import math
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from multiprocessing.connection import wait
from typing import Any


def supervised(
    work: Callable[[Any], Any],
    tasks: Iterable[Any],
    jobs: int,
    limit: float,
    memory: float,
    seconds: float = math.inf,
) -> Iterator[tuple[Any, Any]]:
    """(task, work(task)) as they end; where a task ends its process, its signal or status takes the answer's place.

    limit: seconds of processor time of a task, after which SIGPROF ends it, compiled loops included; memory: GiB.
    seconds: no task begins after that.
    """
    todo, end = list(tasks)[::-1], time.monotonic() + seconds
    start = partial(_Child, work, limit, memory)
    children = [start() for _ in range(min(jobs, len(todo)))]
    while children:
        for child in [child for child in children if child.task is None]:
            if todo and time.monotonic() < end:
                child.give(todo.pop())
            else:
                child.process.kill()
                children.remove(child)
        for pipe in wait([child.pipe for child in children], timeout=1.0):
            child = next(child for child in children if child.pipe is pipe)
            task, answer = child.answer()
            if child.process.exitcode is not None:
                children[children.index(child)] = start()
            yield task, answer
    if todo:
        print(f"# {len(todo)} tasks are left, the next is {todo[-1]}", file=sys.stderr, flush=True)


class _Child:
    def __init__(self, *arguments: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, *arguments), daemon=True)
        self.process.start()
        theirs.close()
        self.task: Any = None

    def give(self, task: Any) -> None:
        self.task = task
        self.pipe.send(task)

    def answer(self) -> tuple[Any, Any]:
        task, self.task = self.task, None
        try:
            return task, self.pipe.recv()
        except EOFError:
            self.process.join()
            died = self.process.exitcode or 0
            return task, signal.Signals(-died) if died < 0 else died


def _serve(pipe: Any, work: Callable[[Any], Any], limit: float, memory: float) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (int(memory * 2**30),) * 2)
    for stream in (1, 2):  # SUNDIALS writes its warnings there
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        while True:
            task = pipe.recv()
            signal.setitimer(signal.ITIMER_PROF, limit)
            pipe.send(work(task))
            signal.setitimer(signal.ITIMER_PROF, 0.0)
