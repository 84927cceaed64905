"""Ratios of running times on Table 10: this package beside HHT-alpha written by hand in C.

    python studies/benchmarks/run.py            # a minute
    python studies/benchmarks/run.py --quick    # fewer steps and repetitions, seconds

All programs take turns in one process. Each time is the least of several, in processor time. The ratios therefore hold
on a busy machine; the times in brackets depend on it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processor time of idle threads would count too

import argparse
import ctypes
import math
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg

import stiffbeam as sb

ALPHA = -0.1
BETA, GAMMA = (1 - ALPHA) ** 2 / 4, 0.5 - ALPHA
SCHEME = sb.HHT(ALPHA)
SOURCE = Path(__file__).with_name("hand_written.c")
TURN = 0.02  # s: a short program is repeated within its turn


def least(programs: Mapping[str, Callable[[], object]], repetitions: int) -> dict[str, float]:
    """Return the least seconds of processor time of each program; they take turns."""
    times: dict[str, list[float]] = {name: [] for name in programs}
    for program in programs.values():
        program()
    for _ in range(repetitions):
        for name, program in programs.items():
            inside = 1 + int(TURN / min(times[name])) if times[name] else 1
            for _ in range(min(20, inside)):
                begun = time.process_time()
                program()
                times[name].append(max(time.process_time() - begun, 1e-9))
    return {name: min(values) for name, values in times.items()}


def table10(cells: int = 25) -> tuple[sb.System, float, float]:
    """Return the system of Table 10, the paper's time step and the frequency of the drive."""
    case = sb.paper_case(10)
    return sb.semidiscretise(case.problem, cells), case.dt, case.problem.base.frequency


def by_hand(writes: str, steps: int, cells: int = 25) -> tuple[Callable[[], object], np.ndarray]:
    """Compile hand_written.c; return the march and the array of tip positions that it fills.

    The march is that of the modes, where a step without contact is one linear map. writes: "tip" alone; "outputs", also
    velocity, force and time; "ledger", also the energy balance of every step. Raises OSError without a C compiler.
    """
    system, dt, w = table10(cells)
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise OSError("no C compiler")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "hand_written.so"
        flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
        flags += [] if writes == "tip" else [f"-D{writes.upper()}"]
        subprocess.run([compiler, *flags, str(SOURCE), "-o", str(library), "-lm"], check=True)
        march = ctypes.CDLL(str(library)).march

    stops, contact_row = system.contacts[0].stops, system.contacts[0].row
    squares, shapes = scipy.linalg.eigh(system.stiffness, system.mass)
    row, cosine, sine = shapes.T @ contact_row, shapes.T @ system.load(0.0), shapes.T @ system.load(0.5 * math.pi / w)
    inverse = dt**2 / (1 + (1 + ALPHA) * BETA * dt**2 * squares)
    of_v, push = -(1 + ALPHA) * inverse * squares, (1 + ALPHA) * inverse * row
    S, C = math.sin(w * dt), math.cos(w * dt)
    tables = np.array([
        -inverse * squares, of_v, (0.5 - BETA) * of_v,
        inverse * ((1 + ALPHA) * sine - ALPHA * (sine * C + cosine * S)),
        inverse * ((1 + ALPHA) * cosine - ALPHA * (cosine * C - sine * S)),
        -ALPHA * inverse * row, push, row,
    ])  # fmt: skip
    q, v = (shapes.T @ (system.mass @ x) for x in (system.q0, system.v0))
    start = np.array([q, dt * v, dt**2 * (cosine - squares * q)])
    compliance = BETA * float(push @ row)
    stiff = stops.stiffness / (1 + stops.stiffness * compliance)
    numbers = [ctypes.c_double(x) for x in (w, dt, BETA, GAMMA, stiff, compliance, stops.law.g1, stops.law.g2)]
    pointer, tip = np.ctypeslib.as_ctypes, np.empty(steps + 1)
    tip[0] = row @ q
    modal = np.array([squares, sine, cosine])

    def run() -> None:
        more: list[Any] = []
        if writes == "outputs":
            more = [ctypes.c_double(GAMMA * float(push @ row)), *(pointer(np.empty(steps + 1)) for _ in range(3))]
        if writes == "ledger":
            balance = np.zeros((steps + 1, 7))
            more = [pointer(modal.ravel()), ctypes.c_double(stops.stiffness), pointer(balance.ravel())]
        state = start.copy()
        march(
            ctypes.c_long(len(squares)), ctypes.c_long(steps), pointer(tables.ravel()), pointer(state.ravel()),
            *numbers, pointer(tip), *more,
        )  # fmt: skip

    return run, tip


def check(tip: np.ndarray, cells: int) -> None:
    """Raise AssertionError unless program and package march the same scheme."""
    system, dt, _ = table10(cells)
    steps = min(500, len(tip) - 1)
    run = sb.integrate(system, SCHEME, dt, steps * dt)
    assert np.max(np.abs(run.tip - tip[: steps + 1])) < 1e-9


def measure(steps: int, repetitions: int, values: int) -> dict[str, dict[str, float]]:
    """Return ratio and seconds of every line: march, whole run, exact solution, energy balance, value of a sweep."""
    hand = {writes: by_hand(writes, steps) for writes in ("tip", "outputs", "ledger")}
    for run, tip in hand.values():
        run()
        check(tip, 25)
    system, dt, _ = table10()
    fine = table10(200)[0]
    whole = sb.integrate(system, SCHEME, dt, steps * dt)
    case = sb.paper_case(10)
    grid = np.linspace(4e6, 6e6, values).tolist()
    sweep: dict[str, Any] = {"parameter": "stops.stiffness", "values": grid, "periods": 1, "transient": 1}
    end = 0.02 if repetitions < 5 else 0.1
    seconds = least(
        {f"C, {writes}": run for writes, (run, _) in hand.items()}
        | {
            "set-up": lambda: sb.integrate(system, SCHEME, dt, dt),
            "march": lambda: sb.integrate(system, SCHEME, dt, steps * dt, every=steps),
            "integrate": lambda: sb.integrate(system, SCHEME, dt, steps * dt),
            "energy balance": lambda: replace(whole).energy,
            "exact, 25 cells": lambda: sb.reference(system, end),
        },
        repetitions,
    )
    seconds |= least(
        {
            "exact, 200 cells": lambda: sb.reference(fine, end),
            "sweep": lambda: sb.study("sweep", case, method=SCHEME, **sweep),
        },
        1,
    )
    seconds["sweep"] /= values
    seconds["march"] -= seconds["set-up"]
    hht = seconds["C, tip"]
    lines = {
        "march, over C": ("march", hht),
        "integrate with every step kept, over C with the same outputs": ("integrate", seconds["C, outputs"]),
        "energy balance, over march and balance in C": ("energy balance", seconds["C, ledger"]),
        f"exact solution to {end:g} with horizon, 25 cells, over C": ("exact, 25 cells", hht),
        f"exact solution to {end:g} with horizon, 200 cells, over C": ("exact, 200 cells", hht),
        "value of a sweep of the stop's stiffness, over C": ("sweep", hht),
    }
    return {line: {"ratio": seconds[name] / unit, "seconds": seconds[name]} for line, (name, unit) in lines.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer steps and repetitions")
    steps, repetitions, values = (2000, 2, 4) if parser.parse_args().quick else (20_000, 7, 50)
    print(f"HHT(alpha=-0.1) on Table 10, {steps} steps; times in brackets.")
    for line, row in measure(steps, repetitions, values).items():
        print(f"{row['ratio']:10.3g}  ({row['seconds'] * 1e3:.3g} ms)  {line}")


if __name__ == "__main__":
    main()
