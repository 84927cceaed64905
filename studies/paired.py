"""Is this state as fast as another commit? Both run in turns, each in a process of its own.

    python studies/paired.py COMMIT [--turns N] [--t-end T] [--dt DT]

Table 10 by HHT, the trapezoidal rule and SDIRK: processor seconds of ``integrate``, set-up included, old and new by
turns; the ratio of the least and the median of the ratios turn by turn. Below 1 this state is the
faster. What came later than COMMIT must not be needed: only ``paper_case``, ``semidiscretise`` and ``integrate`` are.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tarfile
import tempfile
from io import BytesIO
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
RUNS = {"HHT": "sb.HHT(-0.1)", "trapezoidal": "sb.Trapezoidal()", "SDIRK": "sb.SDIRK()"}
WORKER = """
import sys, time
import stiffbeam as sb
case = sb.paper_case(10)
system = sb.semidiscretise(case.problem, 25, "displacement")
dt, t_end = float(sys.argv[1]), float(sys.argv[2])
for line in sys.stdin:
    scheme = eval(line)
    begun = time.process_time()
    run = sb.integrate(system, scheme, dt, t_end, engine="numba", every=max(1, round(t_end / dt / 1000)))
    print(time.process_time() - begun, run.impacts.count, flush=True)
"""


def worker(source: Path, cache: str, dt: float, t_end: float) -> subprocess.Popen[str]:
    """A process that runs the package in ``source`` for every line it is sent."""
    environment = os.environ | {"PYTHONPATH": str(source), "STIFFBEAM_CACHE_DIR": cache, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", WORKER, str(dt), str(t_end)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment, cwd=source)


def asked(process: subprocess.Popen[str], scheme: str) -> list[float]:
    """(processor seconds, impacts) of one run."""
    assert process.stdin
    assert process.stdout
    process.stdin.write(scheme + "\n")
    process.stdin.flush()
    return [float(x) for x in process.stdout.readline().split()]


def main() -> None:
    """The whole of it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("commit")
    parser.add_argument("--turns", type=int, default=15)
    parser.add_argument("--t-end", type=float, default=10.0)
    parser.add_argument("--dt", type=float, default=1e-4)
    given = parser.parse_args()
    archive = subprocess.run(["git", "archive", given.commit, "src"], cwd=ROOT, check=True, capture_output=True).stdout
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=BytesIO(archive)) as tar:
            tar.extractall(folder, filter="data")
        sources = {"old": Path(folder) / "src", "new": ROOT / "src"}
        workers = {
            name: worker(source, str(Path(folder) / name), given.dt, given.t_end) for name, source in sources.items()
        }
        for label, scheme in RUNS.items():
            for process in workers.values():
                for _ in range(2):
                    asked(process, scheme)  # compiles
            pairs = np.array([[asked(process, scheme) for process in workers.values()] for _ in range(given.turns)])
            old, new = pairs[..., 0].min(axis=0)
            print(
                f"{label:12s} {new / old:.2f} of the least ({old:.3f} s before, {new:.3f} s now), "
                f"{np.median(pairs[:, 1, 0] / pairs[:, 0, 0]):.2f} in the median of {given.turns}; "
                f"impacts {pairs[0, 0, 1]:.0f} and {pairs[0, 1, 1]:.0f}",
                flush=True,
            )
        for process in workers.values():
            assert process.stdin
            process.stdin.close()
            process.wait()


if __name__ == "__main__":
    main()
