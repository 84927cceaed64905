"""The campaign: random systems until the package certifies something false.

    python tests/campaigns/campaign.py --systems 2000 --seed 1 --jobs 2

Prints the outcomes by family and by subject, and every violation with the numbers that repeat it:

    python tests/campaigns/campaign.py --seed 1 --only 1234 --methods exact

``--references`` computes every reference of every system, and holds them against one another as well.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from functools import lru_cache
from pathlib import Path

sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("", "oracles")]

OUTCOMES = ("right", "refused", "short", "open", "wrong", "hang", "exception", "not finite")
VIOLATIONS = ("wrong", "hang", "exception", "not finite")
MEMORY = 12 << 30
START = (-1, "start")  # what a worker does until it says that it is ready


REFERENCES = ("every reference",)  # in place of the methods that are asked


def work(pipe, seed: int, only: tuple[str, ...], limit: float) -> None:
    """A worker: system numbers in, verdicts out. The kernel ends it with SIGPROF after ``limit`` seconds of its
    own processor time on one task, compiled loops included."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    import warnings

    for stream in (1, 2):  # SUNDIALS writes its warnings there
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    from judge import ADAPTIVE, Verdict, every_reference, judge, methods_for, warm_up
    from random_systems import case

    random_case = lru_cache(maxsize=1)(case)  # what is known of a system is kept from method to method
    warnings.simplefilter("ignore")
    warm_up(tuple(method for method in only if method in ("exact", *ADAPTIVE)))
    pipe.send("ready")
    while True:
        index, method = pipe.recv()
        signal.setitimer(signal.ITIMER_PROF, limit)
        try:
            case = random_case(seed, index)
            if method is None:
                methods = every_reference(case) if only == REFERENCES else only or methods_for(case, index)
                pipe.send((case.notes, tuple(methods)))
            else:
                pipe.send(list(judge(case, method)))
        except Exception:
            pipe.send([Verdict("exception", method or "the campaign itself", traceback.format_exc()[-600:])])


class Worker:
    """A process that is killed and made again where a task takes too long."""

    def __init__(self, seed: int, only: tuple[str, ...], limit: float) -> None:
        self.arguments = (seed, only, limit)
        self.start()

    def start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=work, args=(theirs, *self.arguments), daemon=True)
        self.process.start()
        theirs.close()
        self.task, self.own = START, getattr(self, "own", [])

    def give(self, task: tuple) -> None:
        self.pipe.send(task)
        self.task = task

    def answer(self):
        """The answer if it is there, else None."""
        from judge import Verdict

        try:
            if not self.pipe.poll(0):
                return None
            answer = self.pipe.recv()
            self.task = None
            return None if answer == "ready" else answer
        except EOFError:
            task, self.task = self.task, None
            self.process.join()
            died = self.process.exitcode
            if task == START:
                raise RuntimeError("a worker dies before its first system: call judge.warm_up() to see why") from None
            self.start()
            if died == -signal.SIGPROF:
                return [Verdict("hang", str(task[1]), f"over {self.arguments[2]:g} s of processor time")]
            return [Verdict("exception", str(task[1]), f"the process died with {died}")]
        return None


def campaign(indices: list[int], seed: int, jobs: int, limit: float, only: tuple[str, ...] = (), quiet: bool = False,
             seconds: float = float("inf")):  # fmt: skip
    """(outcomes by family, outcomes by subject, violations, figures by subject) of systems ``indices``.

    Figures are the (difference, horizon) of every verdict that has them.
    """
    by_family: Counter = Counter()
    by_subject: Counter = Counter()
    violations: list[tuple[int, str, str, str, str]] = []
    families: dict[int, str] = {}
    figures: dict[str, list[tuple[float, float]]] = {}
    todo = [(i, None) for i in reversed(indices)]
    end = time.monotonic() + seconds
    workers = [Worker(seed, only, limit) for _ in range(min(jobs, max(1, len(indices))))]
    finished = 0
    from multiprocessing.connection import wait

    while todo or any(w.task or w.own for w in workers):
        if time.monotonic() > end and todo:
            print(f"# {len(todo)} systems are left, the next is {todo[-1][0]}", file=sys.stderr, flush=True)
            todo.clear()
        for worker in workers:
            if worker.task is None and (worker.own or todo):
                worker.give((worker.own or todo).pop())
        wait([w.pipe for w in workers if w.task], timeout=1.0)
        for worker in workers:
            if worker.task is None:
                continue
            index, method = worker.task
            answer = worker.answer()
            if answer is None:
                continue
            if method is None and isinstance(answer, tuple):
                families[index] = answer[0]
                worker.own = [(index, m) for m in reversed(answer[1])]
                finished += 1
                if not quiet and finished % 10 == 0:
                    print(f"# {finished} systems, {len(violations)} violations", file=sys.stderr, flush=True)
                continue
            for verdict in answer:
                outcome, subject, reason = verdict.outcome, verdict.subject, verdict.reason
                if verdict.difference == verdict.difference:
                    figures.setdefault(subject, []).append((verdict.difference, verdict.horizon))
                by_family[families.get(index, ""), outcome] += 1
                by_subject[subject.split()[0], outcome] += 1
                if outcome in VIOLATIONS:
                    violations.append((index, families.get(index, ""), outcome, subject, reason))
                    if not quiet:
                        where = f"--seed {seed} --only {index} --methods {method}  [{families.get(index)}]"
                        print(f"{outcome}: {where} {subject}: {reason}", flush=True)
                elif not quiet and only and len(indices) < 50:
                    print(f"{outcome}: {index} [{families.get(index)}] {subject}: {reason}", flush=True)
    for worker in workers:
        worker.process.kill()
    return by_family, by_subject, violations, figures


def table(counts: Counter) -> str:
    """Rows by name, columns by outcome."""
    names = sorted({name for name, _ in counts})
    width = max((len(n) for n in names), default=8) + 2
    lines = ["".ljust(width) + "".join(o.rjust(11) for o in OUTCOMES)]
    lines += [n.ljust(width) + "".join(str(counts[n, o]).rjust(11) for o in OUTCOMES) for n in names]
    total = {o: sum(v for (_, x), v in counts.items() if x == o) for o in OUTCOMES}
    return "\n".join([*lines, "all".ljust(width) + "".join(str(total[o]).rjust(11) for o in OUTCOMES)])


def differences(figures: dict[str, list[tuple[float, float]]]) -> str:
    """Differences inside the horizon and horizons, by subject."""
    lines = [f"{'':17}{'systems':>9}{'median |du|':>13}{'99 %':>10}{'largest':>10}{'median horizon / span':>23}"]
    for name, pairs in figures.items():
        offs, horizons = sorted(x for x, _ in pairs), sorted(x for _, x in pairs)
        middle, high = len(pairs) // 2, min(len(pairs) - 1, int(0.99 * len(pairs)))
        lines.append(
            f"{name:17}{len(pairs):9}{offs[middle]:13.1e}{offs[high]:10.1e}{offs[-1]:10.1e}{horizons[middle]:23.3g}"
        )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--systems", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--limit", type=float, default=30.0, help="seconds of processor time for a system and a method")
    parser.add_argument("--first", type=int, default=0, help="go on from this system")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no system after that")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of systems")
    parser.add_argument("--methods", nargs="*", default=[])
    parser.add_argument("--references", action="store_true", help="every reference method, and their agreement")
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    indices = options.only or list(range(options.first, options.first + options.systems))
    methods = REFERENCES if options.references else tuple(options.methods)
    begun = time.monotonic()
    families, subjects, violations, figures = campaign(
        indices, options.seed, options.jobs, options.limit, methods, seconds=options.seconds
    )
    print(f"\nSystems of seed {options.seed}, {len(indices)} asked, in {time.monotonic() - begun:.0f} s\n")
    print(table(families), "\n")
    print(table(subjects), "\n")
    if figures:
        print(differences(figures), "\n")
    print(f"{len(violations)} violations")
    return 1 if violations else 0


if __name__ == "__main__":
    sys.exit(main())
