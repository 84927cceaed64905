"""Wild input to everything that users call: each ends in a result, or in a refusal with rule, value and remedy.

    python tests/campaigns/fuzz.py --seed 1 --inputs 10000 --jobs 2

Input i of a seed is the same everywhere: ``--only i`` repeats it here, with its traceback. Each is tried in a
process that may use ``--limit`` seconds of processor time and ``--memory`` GiB; what is no result, no InputError
and no Diverged or SolverFailure is a violation: an exception from inside, a hang, a crash, a number that is not
finite in what came back, a message of more than 300 characters or of more than one line, and a refusal that
does not say rule, value and remedy.
"""

from __future__ import annotations

import argparse
import collections
import os
import re
import signal
import time
import traceback
import warnings
from typing import Any

import numpy as np
from fuzz_surfaces import CONSTRUCTORS, FUNCTIONS, Surface, numbers_in
from fuzz_texts import case_file, command
from supervised import supervised

import stiffbeam as sb
from stiffbeam.basics.text import shown

LONGEST = 300
GOOD = ("result", "refused", "failed")
WHOLE = re.compile(r".+ must .+, got .*: .+")  # field, rule, value and remedy
GROUPS: dict[str, tuple[float, list[Any]]] = {
    "constructors": (0.35, CONSTRUCTORS), "functions": (0.4, FUNCTIONS), "case files": (0.15, [case_file]),
    "commands": (0.1, [command]),
}  # fmt: skip


def one(seed: int, index: int) -> tuple[str, str, str]:
    """(group and surface, outcome, what it says) of one input."""
    rng = np.random.default_rng([seed, index])
    group = str(rng.choice(list(GROUPS), p=[share for share, _ in GROUPS.values()]))
    choices = GROUPS[group][1]
    weights = np.array([getattr(x, "weight", 1) for x in choices], float)
    chosen = choices[int(rng.choice(len(choices), p=weights / weights.sum()))]
    where = f"{group}: {chosen.name}" if isinstance(chosen, Surface) else group
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = chosen.try_one(rng) if isinstance(chosen, Surface) else chosen(rng)
            bad = [name for name, values in numbers_in(found) if not np.all(np.isfinite(values))]
        except sb.InputError as error:
            return where, _message("refused", error), str(error)
        except (sb.Diverged, sb.SolverFailure) as error:
            return where, _message("failed", error), str(error)
        except BaseException:
            return where, "exception", traceback.format_exc(limit=-4)
    return (where, "not finite", ", ".join(bad)) if bad else (where, "result", type(found).__name__)


def _message(outcome: str, error: Exception) -> str:
    text = str(error)
    if len(text) > LONGEST or not text.isprintable():
        return "message"
    return outcome if outcome != "refused" or WHOLE.fullmatch(text) else "no remedy"


def work(task: tuple[int, int]) -> dict[str, Any]:
    """The outcome of an input and the processor time that it used."""
    os.environ["STIFFBEAM_THREADS"] = "1"
    used = time.process_time()
    where, outcome, said = one(*task)
    seconds = round(time.process_time() - used, 2)
    return {"index": task[1], "where": where, "outcome": outcome, "said": said[-1500:], "seconds": seconds}


def campaign(seed: int, inputs: range, jobs: int, limit: float, memory: float) -> list[dict[str, Any]]:
    """The outcome of every input, each tried in a process that others are not harmed by."""
    found = []
    for (_, index), answer in supervised(work, [(seed, i) for i in inputs], jobs, limit, memory):
        if not isinstance(answer, dict):
            kind = "hang" if answer == signal.SIGPROF else "crash"
            answer = {"index": index, "where": "?", "outcome": kind, "said": f"ended by {answer!r}"}
        found.append(answer)
    return sorted(found, key=lambda x: x["index"])


def table(found: list[dict[str, Any]]) -> str:
    """Outcomes by surface group."""
    counts: dict[str, collections.Counter] = collections.defaultdict(collections.Counter)
    for x in found:
        counts[x["where"].partition(":")[0]][x["outcome"]] += 1
    outcomes = sorted({outcome for counter in counts.values() for outcome in counter})
    lines = [f"{'':14}" + "".join(f"{x:>20}" for x in ("inputs", *outcomes))]
    for group, counter in sorted(counts.items()):
        row = (counter.total(), *(counter[x] for x in outcomes))
        lines.append(f"{group:14}" + "".join(f"{x:>20}" for x in row))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--inputs", type=int, default=10000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--limit", type=float, default=30.0, help="seconds of processor time for an input")
    parser.add_argument("--memory", type=float, default=12.0, help="GiB of addresses for a process")
    parser.add_argument("--only", type=int, help="this input alone, here")
    given = parser.parse_args()
    if given.only is not None:
        Surface.told = staticmethod(lambda name, value: print(f"{name} = {shown(value)}", flush=True))
        print(*one(given.seed, given.only), sep="\n")
        return
    found = campaign(given.seed, range(given.inputs), given.jobs, given.limit, given.memory)
    for x in found:
        if x["outcome"] not in GOOD:
            print(f"--seed {given.seed} --only {x['index']}  {x['where']}  {x['outcome']}: {x['said']}")
    print(table(found))
    raise SystemExit(any(x["outcome"] not in GOOD for x in found))


if __name__ == "__main__":
    main()
