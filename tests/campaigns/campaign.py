"""Random systems against independent solvers, or wild input to everything that users call, until something is wrong.

    python tests/campaigns/campaign.py systems --count 2000 --seed 1 --jobs 2
    python tests/campaigns/campaign.py inputs --count 10000 --seed 1 --jobs 2

Prints the outcomes by family and by subject, and every violation with the numbers that repeat it:

    python tests/campaigns/campaign.py systems --seed 1 --only 1234 --methods exact
    python tests/campaigns/campaign.py inputs --seed 1 --only 612
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("", "oracles")]

import pandas
from judge import Verdict, judged

VIOLATIONS = ("wrong", "hang", "exception", "not finite", "message")
MEMORY = 12.0  # GiB of addresses for a process
Task = tuple[str, int, int, tuple[str, ...]]  # kind, seed, number, methods


def work(task: Task) -> tuple[str, list[Verdict]]:
    """The family of a system or an input, and the verdicts on it."""
    import warnings

    kind, seed, index, methods = task
    warnings.simplefilter("ignore")
    if kind == "systems":
        return judged(seed, index, methods)
    from fuzz import tried  # which imports all that users call

    os.environ["STIFFBEAM_THREADS"] = "1"
    return tried(seed, index)


def apart(tasks: list[Task], jobs: int, limit: float) -> Iterator[tuple[str, list[Verdict]]]:
    """``work`` on the tasks, in order, in ``jobs`` processes that may use so many seconds of processor time a task, and
    MEMORY; a task that ends its process is a violation."""
    own, started = threading.local(), []

    def start() -> tuple[Any, Any]:
        context = multiprocessing.get_context("spawn")
        pipe, theirs = context.Pipe()
        started.append(process := context.Process(target=_serve, args=(theirs, limit), daemon=True))
        process.start()
        theirs.close()
        return process, pipe

    def answer(task: Task) -> tuple[str, list[Verdict]]:
        own.child = getattr(own, "child", None) or start()
        process, pipe = own.child
        pipe.send(task)
        try:
            return pipe.recv()
        except EOFError:
            own.child = None
            process.join()
            kind = "hang" if process.exitcode == -signal.SIGPROF else "exception"
            return "?", [Verdict(kind, " ".join(task[3]) or "?", f"the process ended with {process.exitcode}")]

    try:
        with ThreadPoolExecutor(jobs) as pool:
            yield from pool.map(answer, tasks)
    finally:
        for process in started:
            process.kill()


def _serve(pipe: Any, limit: float) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (int(MEMORY * 2**30),) * 2)
    for stream in (1, 2):  # SUNDIALS writes its warnings there
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        while True:
            task = pipe.recv()
            signal.setitimer(signal.ITIMER_PROF, limit)  # SIGPROF ends compiled loops too
            pipe.send(work(task))
            signal.setitimer(signal.ITIMER_PROF, 0.0)


def campaign(
    kind: str, numbers: list[int], seed: int, jobs: int, limit: float, methods: tuple[str, ...] = ()
) -> tuple[pandas.DataFrame, list[str]]:
    """Family, subject and outcome of every verdict, and the violations, of systems or inputs; limit: of each."""
    rows, violations = list[tuple[str, str, str]](), list[str]()
    tasks = [(kind, seed, i, methods) for i in numbers]
    for number, (family, verdicts) in zip(numbers, apart(tasks, jobs, limit), strict=True):
        for x in verdicts:
            rows.append((family, x.subject.split()[0], x.outcome))
            if x.outcome in VIOLATIONS:
                violations.append(
                    f"{kind} --seed {seed} --only {number}  {x.subject} [{family}]  {x.outcome}: {x.reason}"
                )
    return pandas.DataFrame(rows, columns=["family", "subject", "outcome"]), violations


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=["systems", "inputs"])
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="go on from this one")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--limit", type=float, default=90.0, help="seconds of processor time for each")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of systems or inputs, tried in this process")
    parser.add_argument("--methods", nargs="*", default=[])
    given = parser.parse_args()
    if given.only:
        for number in given.only:
            print(*work((given.kind, given.seed, number, tuple(given.methods))), sep="\n")
        return 0
    begun, numbers = time.monotonic(), list(range(given.first, given.first + given.count))
    found, violations = campaign(given.kind, numbers, given.seed, given.jobs, given.limit, tuple(given.methods))
    tables = (pandas.crosstab(found[by], found.outcome, margins=True) for by in ("family", "subject"))
    print(*tables, *violations, sep="\n\n")
    print(f"\n{len(violations)} violations of {given.count} {given.kind} in {time.monotonic() - begun:.0f} s")
    return bool(violations)


if __name__ == "__main__":
    sys.exit(main())
