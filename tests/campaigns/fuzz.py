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
import json
import os
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_surfaces import CONSTRUCTORS, FUNCTIONS, Surface, exact, numbers_in, run
from fuzz_texts import case_file, command

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


def campaign(seed: int, inputs: range, jobs: int, limit: float, memory: float) -> list[dict[str, Any]]:
    """The outcome of every input, each tried in a process that others are not harmed by."""
    sb.integrate_ensemble(run().system, sb.HHT(), 1e-3, 0.01, [run().system])  # compiled before the processes part
    exact()
    with tempfile.TemporaryDirectory() as folder:
        notes = Path(folder) / "notes"
        os.environ["STIFFBEAM_THREADS"] = "1"
        supervisors = []
        for job in range(jobs):
            if not (pid := os.fork()):
                try:
                    _supervise(seed, list(inputs[job::jobs]), notes, limit, memory)
                finally:
                    os._exit(0)
            supervisors.append(pid)
        for pid in supervisors:
            os.waitpid(pid, 0)
        return sorted((json.loads(line) for line in notes.read_text().splitlines()), key=lambda x: x["index"])


def _supervise(seed: int, indices: list[int], notes: Path, limit: float, memory: float) -> None:
    """A child takes input after input; where one kills it, the next child goes on behind that."""
    while indices:
        reader, writer = os.pipe()
        if not (pid := os.fork()):
            os.close(reader)
            try:
                _try_all(seed, indices, notes, writer, limit, memory)
            finally:
                os._exit(sys.exc_info()[0] is not None)
        os.close(writer)
        begun = b""
        while part := os.read(reader, 65536):
            begun += part
        os.close(reader)
        _, status = os.waitpid(pid, 0)
        tried = begun.count(b"\n")
        if status:
            by = os.WTERMSIG(status)
            kind = "hang" if by in (signal.SIGXCPU, signal.SIGALRM) else "crash"
            said = f"ended by {signal.Signals(by).name if by else status}"
            _note(notes, {"index": indices[tried - 1], "where": "?", "outcome": kind, "said": said})
        indices = indices[tried:]


def _try_all(seed: int, indices: list[int], notes: Path, writer: int, limit: float, memory: float) -> None:
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    resource.setrlimit(resource.RLIMIT_AS, (int(memory * 2**30),) * 2)
    os.chdir(tempfile.mkdtemp(dir=notes.parent))
    for index in indices:
        os.write(writer, b"\n")
        used = time.process_time()
        resource.setrlimit(resource.RLIMIT_CPU, (int(used + limit) + 1, resource.RLIM_INFINITY))
        signal.alarm(int(10 * limit))
        where, outcome, said = one(seed, index)
        seconds = round(time.process_time() - used, 2)
        _note(notes, {"index": index, "where": where, "outcome": outcome, "said": said[-1500:], "seconds": seconds})


def _note(notes: Path, found: dict[str, Any]) -> None:
    with notes.open("ab", buffering=0) as stream:
        stream.write(json.dumps(found).encode() + b"\n")


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
    parser.add_argument("--out", type=Path, help="every outcome as a line of JSON")
    given = parser.parse_args()
    if given.only is not None:
        Surface.told = staticmethod(lambda name, value: print(f"{name} = {shown(value)}", flush=True))
        print(*one(given.seed, given.only), sep="\n")
        return
    found = campaign(given.seed, range(given.inputs), given.jobs, given.limit, given.memory)
    if given.out:
        given.out.write_text("".join(json.dumps(x) + "\n" for x in found))
    for x in found:
        if x["outcome"] not in GOOD:
            print(f"--seed {given.seed} --only {x['index']}  {x['where']}  {x['outcome']}: {x['said']}")
    print(table(found))
    raise SystemExit(any(x["outcome"] not in GOOD for x in found))


if __name__ == "__main__":
    main()
