"""Processor time of programs that take turns, and of the least that memory allows."""

from __future__ import annotations

import time
from collections.abc import Callable

import numba

from stiffbeam.basics.arrays import aligned
from stiffbeam.basics.compiled import FASTMATH
from stiffbeam.march.kernels import blocks as kernel

Timed = Callable[[], float]  # runs once, returns seconds


def timed(work: Callable[[], object], threads: int = 1) -> Timed:
    """``work`` in processor time over threads."""

    def run() -> float:
        begun = time.process_time()
        work()
        return (time.process_time() - begun) / threads

    return run


def least(runs: dict[str, Timed], repetitions: int) -> dict[str, float]:
    """The least seconds of each, taken in turns; one run of each beforehand."""
    for run in runs.values():
        run()
    times = {name: [] for name in runs}
    for _ in range(repetitions):
        for name, run in runs.items():
            times[name].append(run())
    return {name: min(values) for name, values in times.items()}


@numba.njit(fastmath=FASTMATH, error_model="numpy")
def _stream(reading, z, w, times):
    for _ in range(times):
        kernel.read(reading, z, w)
        z[0] = 1e-9 * w[0]


def stream(R: int, D: int) -> float:
    """Seconds per multiply-add of a matrix-vector product (R, D) that stays in the first-level cache."""
    reading, z, w = aligned((R, D)), aligned((D,)), aligned((R,))
    return least({"": timed(lambda: _stream(reading, z, w, 2000))}, 9)[""] / (2000 * R * D)
