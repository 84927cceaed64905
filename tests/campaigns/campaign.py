"""The campaign: random systems until the package certifies something false.

    python tests/campaigns/campaign.py --systems 2000 --seed 1 --jobs 2

Prints the outcomes by family and by subject, and every violation with the numbers that repeat it:

    python tests/campaigns/campaign.py --seed 1 --only 1234 --methods exact
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections import Counter
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("", "oracles")]

from judge import Verdict, judged, methods_for
from random_systems import case as random_case
from supervised import supervised

OUTCOMES = ("right", "refused", "short", "open", "wrong", "hang", "exception", "not finite")
VIOLATIONS = ("wrong", "hang", "exception", "not finite")
MEMORY = 12.0  # GiB


def work(task: tuple[int, int, tuple[str, ...]]) -> list[Verdict]:
    """The verdicts on a system by its methods."""
    import warnings

    warnings.simplefilter("ignore")
    return judged(*task)


def campaign(indices: list[int], seed: int, jobs: int, limit: float, only: tuple[str, ...] = (), quiet: bool = False,
             seconds: float = float("inf")):  # fmt: skip
    """(outcomes by family, outcomes by subject, violations) of systems ``indices``; limit: of a system and a method."""
    by_family, by_subject, violations = Counter(), Counter(), []
    cases = {index: random_case(seed, index) for index in indices}
    tasks = [(seed, i, tuple(only or methods_for(cases[i], i))) for i in indices]
    most = limit * max(len(methods) for *_, methods in tasks)
    for (_, index, methods), answer in supervised(work, tasks, jobs, most, MEMORY, seconds):
        family = cases[index].notes
        if not isinstance(answer, list):
            hang = answer == signal.SIGPROF
            answer = [Verdict("hang" if hang else "exception", " ".join(methods), f"the process ended with {answer!r}")]
        for verdict in answer:
            by_family[family, verdict.outcome] += 1
            by_subject[verdict.subject.split()[0], verdict.outcome] += 1
            if verdict.outcome in VIOLATIONS:
                violations.append((index, family, verdict.outcome, verdict.subject, verdict.reason))
                if not quiet:
                    where = f"--seed {seed} --only {index} --methods {verdict.subject}  [{family}]"
                    print(f"{verdict.outcome}: {where}: {verdict.reason}", flush=True)
    return by_family, by_subject, violations


def table(counts: Counter) -> str:
    """Rows by name, columns by outcome."""
    names = sorted({name for name, _ in counts})
    width = max((len(n) for n in names), default=8) + 2
    lines = ["".ljust(width) + "".join(o.rjust(11) for o in OUTCOMES)]
    lines += [n.ljust(width) + "".join(str(counts[n, o]).rjust(11) for o in OUTCOMES) for n in names]
    total = {o: sum(v for (_, x), v in counts.items() if x == o) for o in OUTCOMES}
    return "\n".join([*lines, "all".ljust(width) + "".join(str(total[o]).rjust(11) for o in OUTCOMES)])


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
    options = parser.parse_args()
    indices = options.only or list(range(options.first, options.first + options.systems))
    begun = time.monotonic()
    families, subjects, violations = campaign(
        indices, options.seed, options.jobs, options.limit, tuple(options.methods), seconds=options.seconds
    )
    print(f"\nSystems of seed {options.seed}, {len(indices)} asked, in {time.monotonic() - begun:.0f} s\n")
    print(f"{table(families)}\n\n{table(subjects)}")
    print(f"\n{len(violations)} violations")
    return 1 if violations else 0


if __name__ == "__main__":
    sys.exit(main())
