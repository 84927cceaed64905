"""How much faster is a sweep in two processes, or with two workers of a Dask cluster, than in one process?

400 values on Table 10, HHT(-0.1), 100 000 steps each: of the clearance, whose values march as ensembles,
and of the drive frequency, where every value has a step and so a propagator of its own; and the clearance
with ten times the steps. One process marches on one thread and on all cores; two processes, and two
workers, on one thread each, so that all but the first use two cores. One of the workers gets SIGKILL
after the second batch. "All" counts everything; "sweep" leaves out what is paid once, the start of
processes or workers and their import of the package. Everything must find identical records. The BLAS
has one thread everywhere: on matrices this small more of them only wait. Run (90 s; two cores):

    OPENBLAS_NUM_THREADS=1 python studies/sweep_scaling.py

and look at stiffbeam-output/sweep_scaling.png.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from distributed import Client, LocalCluster

import stiffbeam as sb
from stiffbeam.studies import find_study
from stiffbeam.studies.runner import run_study, scheduler

PICTURE = Path("stiffbeam-output/sweep_scaling.png")
VALUES, STEPS_PER_PERIOD, TRANSIENT, REPETITIONS = 400, 6250, 6, 3
SWEEPS = {
    "clearance, 1e5 steps": ("clearance", np.linspace(0.05, 0.15, VALUES), 10),
    "frequency, 1e5 steps": ("frequency", np.linspace(8.0, 14.0, VALUES), 10),
    "clearance, 1e6 steps": ("clearance", np.linspace(0.05, 0.15, VALUES), 154),
}
Ways = Iterator[tuple[Executor | None, Callable[[str, int, int], None]]]


def quiet(_what: str, _done: int, _total: int) -> None:
    return


@contextmanager
def one_process(threads: int) -> Ways:
    os.environ["STIFFBEAM_THREADS"] = str(threads)
    yield None, quiet


def one_thread() -> None:
    os.environ["STIFFBEAM_THREADS"] = "1"


@contextmanager
def two_processes() -> Ways:
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn"), one_thread) as pool:
        list(pool.map(ready, range(2)))
        yield pool, quiet


@contextmanager
def two_workers_one_killed() -> Ways:
    """A worker is killed after the second batch; its nanny starts another."""
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        Client(cluster) as client,
        scheduler(cluster.scheduler_address) as executor,
    ):
        list(executor.map(ready, range(2)))
        victims = list(client.run(os.getpid).values())

        def kill_one(_what: str, done: int, total: int) -> None:
            if done == 2 and total > 2:
                os.kill(victims[0], signal.SIGKILL)

        yield executor, kill_one


def ready(_: int) -> float:
    """Import the package and its kernel, and wait, so that both workers do it."""
    import stiffbeam as sb

    sb.integrate(sb.paper_case(10).system(), sb.HHT(), 1e-4, 1e-3)
    time.sleep(1.0)
    return 0.0


WAYS = {
    "one process, one thread": lambda: one_process(1),
    "one process, two threads": lambda: one_process(2),
    "two processes": two_processes,
    "two Dask workers, one killed": two_workers_one_killed,
}


def draw(best: dict[tuple[str, str], tuple[float, float]], file: Path) -> None:
    """The seconds of every sweep in every way; what is paid once is hatched."""
    figure, panels = plt.subplots(1, len(SWEEPS), figsize=(11, 3.1), layout="constrained", sharey=True)
    for axes, name in zip(panels, SWEEPS, strict=True):
        everything, sweep = zip(*(best[name, way] for way in WAYS), strict=True)
        start = np.maximum(0.0, np.subtract(everything, sweep))
        axes.barh(list(WAYS), sweep, color="#0072B2", label="sweep, and times as fast as one thread")
        bars = axes.barh(
            list(WAYS), start, left=sweep, color="white", edgecolor="#888888", hatch="///", label="start, paid once"
        )
        axes.bar_label(bars, [f"{sweep[0] / each:.2f} ×" for each in sweep], padding=3)
        axes.set(title=f"{VALUES} values: {name}", xlabel="s", xlim=(0.0, 1.25 * max(everything)))
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main() -> None:
    case, study = sb.paper_case(10), find_study("sweep")
    period = 2.0 * np.pi / 10.0
    one_thread()
    run_study(study, case, **study.smoke)  # compile, or load what is compiled
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for name, (parameter, values, periods) in SWEEPS.items():
        options = {
            "parameter": parameter, "values": values.tolist(), "dt": period / STEPS_PER_PERIOD, "periods": periods,
            "transient": TRANSIENT, "method": "HHT(alpha=-0.1)",
        }  # fmt: skip
        expected = None
        for way in list(WAYS) * (REPETITIONS if periods < 100 else 1):
            begun = time.perf_counter()
            with WAYS[way]() as (executor, progress):
                records = run_study(study, case, executor=executor, progress=progress, **options)
            now = (time.perf_counter() - begun, records.seconds)
            best[name, way] = min(best.get((name, way), now), now, key=lambda pair: pair[1])
            expected = expected or records.rows
            assert not records.failures
            assert records.rows == expected, f"{way} found other records"
        one = best[name, "one process, one thread"][1]
        for way in WAYS:
            everything, sweep = best[name, way]
            print(f"{name}: {way:28} sweep {sweep:6.2f} s, all {everything:6.2f} s, {one / sweep:.2f} times as fast")
    parts = []
    for name in SWEEPS:
        one, threads, processes, workers = (best[name, way] for way in WAYS)
        parts.append(
            f"{name} {one[1]:.1f} s on one core, {threads[1]:.1f} s on two threads, {processes[1]:.1f} s on two "
            f"processes (after {processes[0] - processes[1]:.1f} s of start), {workers[1]:.1f} s on two Dask workers, "
            "one of them killed"
        )
    draw(best, PICTURE)
    print(f"{VALUES} values: {'; '.join(parts)}: identical records each time.")


if __name__ == "__main__":
    main()
