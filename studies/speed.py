"""How fast are a step, a run, an ensemble and a reference, beside programs written by hand and solvers of others?

    python studies/speed.py [steps whole sizes members references waits compare] [--quick] [--record]

Table 10, M = 25, in one process. All programs of a table take turns. Each number is the least of several in processor
time, without compilation, so that ratios within a table hold on a busy machine. The programs of a step agree to 1e-9
before chaos, and every reference states its distance from the exact one. Programs that are not installed are named and
left out. The table of waits measures what a user waits for beside the time steps: set-up, records, references. Last,
`stiffbeam compare table10` runs in three fresh processes: with an empty cache, again, and without stored references.

It prints the tables and ends with status 1 if a ratio is worse than the one recorded in speed.json by more than a
third. ``--record`` writes the measurements to speed.json and, from it, the page speed.md.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # idle threads of a library would count as ours

import numpy as np
from hand_written import ALPHA, Timed, in_c, jax_scan, numba_loop, numpy_loop, timed
from noise import noise

import stiffbeam as sb
from stiffbeam.basics.resources import cores
from stiffbeam.files.cases import case_of
from stiffbeam.march.block_march import March
from stiffbeam.march.integrate import Plan
from stiffbeam.references import solve
from stiffbeam.references.adaptive import sundials

RECORD, PAGE = (Path(__file__).with_suffix(suffix) for suffix in (".json", ".md"))
SCHEMES = {"HHT": sb.HHT(ALPHA), "BDF2": sb.BDF2(), "SDIRK-OS": sb.SDIRK(nystrom=True)}
SAME_OUTPUTS = "C, the same outputs"
BY_HAND: dict[str, Callable[..., tuple[Timed, np.ndarray]]] = {
    "C, number of modes fixed": partial(in_c, fixed=True),
    "C": in_c,
    SAME_OUTPUTS: partial(in_c, writes="outputs"),
    "numba": numba_loop,
    "JAX scan": jax_scan,
    "NumPy loop": numpy_loop,
}
ANCHOR = "HHT by hand: C"
WHOLE = "`integrate` with every step kept"
RTOL, T_END = 1e-9, 0.1  # of the references
SUNDIALS = ("cvode", "cvode-adams", "ida")
TURN, LONG = 0.02, 2.0  # seconds: a turn of a short program; a run that is not repeated
TOLERATED = 4 / 3  # how much worse than recorded a ratio may be
Rows = dict[str, dict[str, Any]]


def least(runs: dict[str, Timed], repetitions: int) -> dict[str, float]:
    """The least seconds of each, taken in turns; one run of each beforehand.

    A short run is repeated within its turn, where the processor's clock and caches have settled; one of seconds is not
    repeated at all.
    """
    times = {name: [run(), run()] for name, run in runs.items()}
    for _ in range(repetitions):
        for name, run in runs.items():
            shortest = min(times[name])
            times[name] += [run() for _ in range(0 if shortest > LONG else min(20, 1 + int(TURN / shortest)))]
    return {name: min(values[1:]) for name, values in times.items()}


def table10(cells: int = 25) -> tuple[sb.System, float]:
    """The system of Table 10 and the paper's time step."""
    case = sb.paper_case(10)
    return sb.semidiscretise(case.problem, cells), case.dt


def steps(
    cells: int, count: int, repetitions: int, missing: list[str], wanted: Callable[[str], bool] = lambda name: True
) -> dict[str, float]:
    """Nanoseconds per step of the programs by hand, of the march alone and of whole runs."""
    system, dt = table10(cells)
    runs: dict[str, Timed] = {}
    counts: dict[str, int] = {}
    tip = sb.integrate(system, SCHEMES["HHT"], dt, 500 * dt).tip
    for name, make in BY_HAND.items():
        label = f"HHT by hand: {name}"
        counts[label] = min(count, 1000) if make is numpy_loop else count
        try:
            runs[label], result = make(system, dt, counts[label])
        except (ImportError, OSError) as error:
            missing.append(f"{label} ({error})")
            continue
        runs[label]()
        assert np.max(np.abs(result[: len(tip)] - tip)) < 1e-9, f"{label} marches another scheme"
    for name, scheme in SCHEMES.items():
        stepper = Plan.of(system, scheme, dt, count * dt, "implicit", 1).stepper
        assert stepper is not None

        def march(stepper=stepper) -> float:
            stepping = March(stepper, (system,), count, None)
            for _ in stepping.advance():
                pass
            return stepping.seconds

        def whole(scheme=scheme) -> sb.Trajectory:
            return sb.integrate(system, scheme, dt, count * dt)

        runs[f"{name}, march with impacts and peaks"] = march
        runs[f"{name}, {WHOLE}"] = timed(whole)
        runs[f"{name}, {WHOLE}, and energy balance"] = timed(lambda whole=whole: whole().energy)
    runs = {name: run for name, run in runs.items() if wanted(name)}
    return {name: 1e9 * x / counts.get(name, count) for name, x in least(runs, repetitions).items()}


def sizes(count: int, repetitions: int, cells: tuple[int, ...]) -> Rows:
    """Nanoseconds per step by the number of cells."""
    rows: Rows = {}
    for M in cells:
        found = steps(M, count, repetitions, [], lambda name: "march" in name or name.endswith((": C", "NumPy loop")))
        rows[str(M)] = {name.partition(",")[0]: ns for name, ns in found.items()}
    return rows


def members(size: int, count: int, repetitions: int) -> dict[str, float]:
    """Nanoseconds per member and step of ensembles on all threads, in processor time over threads."""
    system, dt = table10()
    starts, frequencies = (
        sb.perturbed_members(system, size),
        sb.varied_members(system, frequency=np.linspace(9.0, 11.0, size)),
    )

    def run(scheme: sb.Scheme, ensemble: Any = starts) -> Timed:
        return timed(lambda: sb.integrate_ensemble(system, scheme, dt, count * dt, ensemble), cores())

    runs = {f"{name}, member of {size}": run(scheme) for name, scheme in SCHEMES.items()}
    runs[f"HHT, member of {size}, each with its own drive frequency"] = run(SCHEMES["HHT"], frequencies)
    return {name: 1e9 * x / (size * count) for name, x in least(runs, repetitions).items()}


@contextlib.contextmanager
def python_callbacks() -> Generator[None, None, None]:
    """Let CVODE and IDA call Python functions, through scikit-sundae."""
    with patch.object(sundials, "available", lambda: False):
        yield


def references(t_end: float, repetitions: int, missing: list[str]) -> Rows:
    """Milliseconds of every solver to t_end, its distance from the exact solution and its counters."""
    system, _ = table10()
    t = np.linspace(0.0, t_end, 101)
    exact = sb.reference(system, t_end, t_eval=t).tip
    found: dict[str, sb.Reference] = {}
    tips: dict[str, Callable[[], np.ndarray]] = {}

    def ours(method: str, name: str, python: bool = False) -> Callable[[], np.ndarray]:
        def run() -> np.ndarray:
            with python_callbacks() if python else contextlib.nullcontext():
                found[name] = solve(system, t_end, method, t, RTOL, 1e-12)
            assert (found[name].provenance.get("callbacks") == "Python") == python or method not in SUNDIALS
            return found[name].tip

        return run

    for method in ("exact", *SUNDIALS, "dop853", "kvaerno5"):
        tips[method] = ours(method, method)
        if method in SUNDIALS:
            tips[f"{method}, Python callbacks"] = ours(method, f"{method}, Python callbacks", True)
    for name, make in {
        "SciPy's DOP853 on `system.ode()`": _scipy,
        "diffrax' Dopri8 on `system.ode()`": _diffrax,
    }.items():
        try:
            tips[name] = make(system, t)
        except ImportError as error:
            missing.append(f"{name} ({error})")
    errors = {name: float(np.max(np.abs(solver() - exact)) / np.max(np.abs(exact))) for name, solver in tips.items()}
    seconds = least({name: timed(solver) for name, solver in tips.items()}, repetitions)
    counters = {name: dict(reference.work.counters) for name, reference in found.items()}
    return {name: {"ms": 1e3 * seconds[name], "error": errors[name], "work": counters.get(name, {})} for name in tips}


def _scipy(system: sb.System, t: np.ndarray) -> Callable[[], np.ndarray]:
    from scipy.integrate import solve_ivp

    ode = system.ode()
    return lambda: ode.tip(t, solve_ivp(ode.rhs, (0.0, t[-1]), ode.y0, "DOP853", t, rtol=RTOL, atol=1e-12).y.T)


def _diffrax(system: sb.System, t: np.ndarray) -> Callable[[], np.ndarray]:
    import diffrax
    import jax

    jax.config.update("jax_enable_x64", True)
    ode = system.ode()

    @jax.jit
    def run(y0):
        control = diffrax.PIDController(rtol=RTOL, atol=1e-12)
        return diffrax.diffeqsolve(
            diffrax.ODETerm(ode.jax), diffrax.Dopri8(), 0.0, t[-1], None, y0,
            saveat=diffrax.SaveAt(ts=jax.numpy.asarray(t)), stepsize_controller=control, max_steps=2_000_000,
        ).ys  # fmt: skip

    return lambda: ode.tip(t, np.asarray(run(ode.y0)))


YARDSTICK = "HHT by hand: NumPy loop, 1000 steps"  # whose time tells how fast the machine is at the moment
BALANCE = "energy balance, per step"


def waits(quick: bool, repetitions: int) -> Rows:
    """Set-up, records and references: the amount of each, its unit, and the goal where there is one.

    Times are processor time.
    """
    system, dt = table10()
    case = sb.paper_case(10)
    scheme, t_end, values = SCHEMES["HHT"], 0.02 if quick else T_END, 16 if quick else 200
    whole = sb.integrate(system, scheme, dt, (100 if quick else 20_000) * dt)

    run = sb.reference(system, t_end)
    parameters = ["stops.stiffness", "stops[0].upper", "base.amplitude", "base.frequency"]

    def fresh() -> sb.System:
        return sb.semidiscretise(case.problem, case.cells)

    def sweep(parameter: str, low: float, high: float) -> Callable[[], object]:
        grid = np.linspace(low, high, values).tolist()
        options = {"method": f"{scheme}@displacement", "periods": 1, "transient": 1}
        return lambda: sb.study("sweep", case, parameter=parameter, values=grid, **options)

    def semidiscretised(cells: int) -> Callable[[], object]:
        return lambda: sb.semidiscretise(case.problem, cells)

    def modes_of(cells: int) -> Callable[[], object]:
        return lambda: sb.modes(sb.semidiscretise(case.problem, cells))

    samples = 1000 if quick else 10_000
    tube, tube_end = tube_under_a_record(samples), 5e-5 * samples
    tube_run, tube_exact = sb.integrate(tube, scheme, 5e-5, tube_end), sb.reference(tube, tube_end)

    cells = 100 if quick else 1600
    bar: dict[str, Any] = {"schemes": ["trapezoidal"], "cells": [25], "starts": 2 if quick else 8}
    works: dict[str, tuple[str, float, Callable[[], object], float | None]] = {
        "`integrate`, 100 steps": ("ms", 1e3, lambda: sb.integrate(system, scheme, dt, 100 * dt), 0.2),
        "`integrate`, 100 steps, with `semidiscretise`": (
            "ms", 1e3, lambda: sb.integrate(fresh(), scheme, dt, 100 * dt), None,
        ),
        BALANCE: ("ns", 1e9 / whole.work.steps, lambda: replace(whole).energy, None),
        f"exact reference to {t_end}": ("ms", 1e3, lambda: solve(system, t_end, "exact", None, RTOL, None), 0.4),
        f"exact reference to {t_end}, with horizon": ("ms", 1e3, lambda: sb.reference(system, t_end).horizon, 1.2),
        "sweep of the stiffness of the stops, a value": ("ms", 1e3 / values, sweep("stop-stiffness", 4e6, 6e6), 1.0),
        "sweep of the scheme's alpha, a value": ("ms", 1e3 / values, sweep("alpha", -0.3, -0.05), 1.0),
        "sweep of the beam's stiffness, a value": ("ms", 1e3 / values, sweep("stiffness", 290.0, 310.0), 1.0),
        "sweep of the drive frequency, a value": ("ms", 1e3 / values, sweep("frequency", 8.0, 12.0), 1.0),
        f"`semidiscretise`, {cells} cells": ("s", 1.0, semidiscretised(cells), None),
        f"`semidiscretise` and `modes`, {cells} cells": ("s", 1.0, modes_of(cells), None),
        f"derivative of that reference by {len(parameters)} parameters": (
            "ms", 1e3, lambda: run.derivative(parameters), None,
        ),
        "multiprecision to 2": (
            "s", 1.0, lambda: sb.reference(system, 0.1 if quick else 2.0, method="multiprecision"), None,
        ),
        "tube under a record: HHT": ("ms", 1e3, lambda: sb.integrate(tube, scheme, 5e-5, tube_end), None),
        "tube under a record: energy balance of HHT": ("ms", 1e3, lambda: replace(tube_run).energy, None),
        "tube under a record: exact reference, with horizon": ("s", 1.0, lambda: sb.reference(tube, tube_end), None),
        "tube under a record: energy balance of the reference": ("s", 1.0, lambda: replace(tube_exact).energy, None),
        "tube under a record: `compare` of both": ("s", 1.0, lambda: sb.compare(tube_run, tube_exact), None),
        "study rigid-bar, trapezoidal, 25 cells": ("s", 1.0, lambda: sb.study("rigid-bar", case, **bar), None),
    }  # fmt: skip
    runs = {YARDSTICK: numpy_loop(system, dt, 1000)[0]}
    with contextlib.suppress(OSError):  # no compiler
        runs[ANCHOR] = in_c(system, dt, whole.work.steps, writes="ledger")[0]
    seconds = least(runs | {name: timed(work) for name, (_, _, work, _) in works.items()}, repetitions)
    rows: Rows = {YARDSTICK: {"unit": "ms", "amount": 1e3 * seconds[YARDSTICK], "goal": None}}
    if ANCHOR in seconds:
        rows["energy balance, over march and balance by hand in C"] = {
            "unit": "ratio", "amount": seconds[BALANCE] / seconds[ANCHOR], "goal": 2.0,
        }  # fmt: skip
    for name, (unit, scale, _, goal) in works.items():
        rows[name] = {"unit": unit, "amount": scale * seconds[name], "goal": goal}
    return rows | _records_of_a_sweep(16 if quick else 200)


def tube_under_a_record(samples: int) -> sb.System:
    """A damped steel tube in two loose supports, of 20 cells, under a force with samples 50 microseconds apart."""
    stops = [sb.Stops(-3e-4, 3e-4, position=x, stiffness=1e6) for x in (0.6, 1.2)]
    t = np.linspace(0.0, 5e-5 * samples, samples)
    rough = noise(float(t[-1]), rms=3.0, band=(5.0, 1200.0), seed=19)
    force = 12.0 * np.sin(44.0 * np.pi * t) + 6.0 * np.sin(122.0 * np.pi * t + 1.0) + rough.value(t)
    load = sb.PointLoad(0.9, sb.Sampled(t, force, kind="cubic"))
    problem = sb.BeamProblem(
        length=1.2, stiffness=668.0, mass_per_length=0.647, viscosity=0.15, stops=stops, loads=(load,)
    )  # fmt: skip
    return sb.semidiscretise(problem, 20)


def _records_of_a_sweep(values: int) -> Rows:
    """Bytes that a value of a sweep with 60 recorded periods takes in memory and in the journal."""
    system, dt = table10()
    with tempfile.TemporaryDirectory() as folder:
        tracemalloc.start()
        records = sb.study("sweep", case_of(system, dt, 1.0), count=values, periods=60, transient=1, folder=folder)
        memory, _ = tracemalloc.get_traced_memory()
        assert records.rows
        del records
        memory -= tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        journal = sum(file.stat().st_size for file in Path(folder).iterdir())
    return {
        f"sweep of 60 periods, {what} a value": {"unit": "kB", "amount": 1e-3 * size / values, "goal": 1.5}
        for what, size in (("memory", memory), ("journal", journal))
    }


def compare_table10() -> Rows:
    """Seconds of the command in a fresh process: until the table and until the end, and of the processor."""
    rows: Rows = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"STIFFBEAM_CACHE_DIR": f"{folder}/cache", "MPLBACKEND": "agg"}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # the second process of a user imports what the first compiled
        for name, options in (
            ("compiled", ()),
            ("from the cache", ()),
            ("from the cache, references anew", ("--no-cache",)),
        ):
            begun, before = time.perf_counter(), os.times()
            command = [sys.executable, "-c", "from stiffbeam.cli import main; main()", "compare", "table10", *options]
            with subprocess.Popen(
                command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
            ) as process:
                assert process.stdout is not None
                process.stdout.readline()
                table = time.perf_counter() - begun
                process.communicate()
            if process.returncode:
                raise subprocess.CalledProcessError(process.returncode, command)
            seconds, after = time.perf_counter() - begun, os.times()
            busy = after.children_user + after.children_system - before.children_user - before.children_system
            rows[name] = {"table": table, "seconds": seconds, "processor": busy}
    return rows


def measure(parts: list[str], quick: bool) -> dict[str, Any]:
    """Return the tables that are asked for, and the ratios that are watched."""
    missing: list[str] = []
    count, repetitions = (2000, 1) if quick else (20_000, 9)
    tables: dict[str, Callable[[], Any]] = {
        "steps": lambda: steps(25, count, repetitions, missing),
        "whole": lambda: {str(k): _whole(k, repetitions) for k in ((2000,) if quick else (20_000, 50_000))},
        "sizes": lambda: sizes(count // 4, repetitions, (10, 25) if quick else (10, 25, 50, 100, 200, 400)),
        "members": lambda: members(8 if quick else 200, count, 1 if quick else 5),
        "references": lambda: references(0.02 if quick else T_END, 1 if quick else 3, missing),
        "waits": lambda: waits(quick, 1 if quick else 5),
        "compare": lambda: {} if quick else compare_table10(),
    }
    machine = f"{_processor()}, {cores()} threads, Python {platform.python_version()}"
    record: dict[str, Any] = {"machine": machine} | {name: tables[name]() for name in tables if name in parts}
    return record | {"missing": missing, "ratios": ratios_of(record)}


def ratios_of(record: dict[str, Any]) -> dict[str, float]:
    """The ratios that are watched; smaller is better."""
    ratios: dict[str, float] = {}
    if ns := record.get("steps"):
        unit = _unit(ns)
        ratios |= {f"{name} / {unit}": x / ns[unit] for name, x in ns.items() if "by hand" not in name}
    if rows := record.get("references"):
        cost = {name: row["ms"] for name, row in rows.items()}
        ratios |= {f"{name} / exact": x / cost["exact"] for name, x in cost.items() if name != "exact"}
        ratios |= {f"{m} / {m}, Python callbacks": cost[m] / cost[f"{m}, Python callbacks"] for m in SUNDIALS}
    if rows := record.get("waits"):
        derivative, exact = (next(x for x in rows if x.startswith(name)) for name in ("derivative", "exact"))
        ratios[f"{derivative} / exact"] = rows[derivative]["amount"] / rows[exact]["amount"]
    return ratios


def _unit(ns: dict[str, float]) -> str:
    """The program that the others are multiples of."""
    return next(name for name in (ANCHOR, "HHT by hand: numba") if name in ns)


def _whole(count: int, repetitions: int) -> dict[str, float]:
    """Ratio of `integrate`, set-up and every step kept, and of C with the same outputs, to as many steps in C."""
    found = steps(25, count, repetitions, [], lambda name: name == ANCHOR or name.endswith((SAME_OUTPUTS, WHOLE)))
    unit = found.pop(ANCHOR, float("nan"))
    return {
        (SAME_OUTPUTS if name.endswith(SAME_OUTPUTS) else name.partition(",")[0]): ns / unit
        for name, ns in found.items()
    }


def _processor() -> str:
    """Model of the processor where Linux names it."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()


def page(record: dict[str, Any]) -> str:
    """The record in Markdown: the tables of speed.md."""
    lines = [
        "# Speed", "",
        "`python studies/speed.py --record` writes this page. All times are for Table 10 with 25 cells. Each is the",
        "least processor time of several runs, without compilation; the programs of a table take turns. Ratios hold",
        f"within a table. Times depend on the machine, here {record['machine']}.",
    ]  # fmt: skip
    for name, rows in TABLES.items():
        if record.get(name):
            lines += ["", *rows(record[name])]
    return "\n".join(lines + [f"\nNot measured: {name}." for name in record["missing"]]) + "\n"


def _page_of_steps(ns: dict[str, float]) -> list[str]:
    unit = ns[_unit(ns)]
    return [
        "## A time step", "",
        "[`hand_written.py`](hand_written.py) and [`hand_written.c`](hand_written.c) are HHT-alpha written by hand:",
        "in C with `restrict` and `-O3 -march=native`, in numba and in JAX. Each step is one linear map of the modes,",
        "and only the tip is stored. The march (time loop) of stiffbeam also finds each impact with its time, peak",
        "and impulse. Ratios are to C with any number of modes.", "",
        "| program | ns per step | ratio |", "|---|---|---|",
        *(f"| {name} | {x:.3g} | {x / unit:.3g} |" for name, x in ns.items()),
    ]  # fmt: skip


def _page_of_runs(runs: dict[str, dict[str, float]]) -> list[str]:
    lines = [
        "Time of whole runs by `integrate`, with set-up and every step kept, over that of as many steps in C. The C of",
        "the table above keeps the tip's position. `integrate` also computes and keeps velocity, force and time: 32",
        "bytes of new memory per step. The second C does so too.", "",
        "| steps | over | " + " | ".join(SCHEMES) + " |", "|---" * (2 + len(SCHEMES)) + "|",
    ]  # fmt: skip
    for count, row in runs.items():
        for over, unit in (("C, the tip's position", 1.0), (SAME_OUTPUTS, row.get(SAME_OUTPUTS))):
            if unit is not None:
                ratios = " | ".join(f"{row[name] / unit:.3g}" for name in SCHEMES)
                lines.append(f"| {count} | {over} | {ratios} |")
    return lines


def _page_of_sizes(rows: Rows) -> list[str]:
    names = next(iter(rows.values()))
    return [
        "## By the number of cells", "", "Nanoseconds per step of the march.", "",
        "| cells | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|",
        *(f"| {M} | " + " | ".join(f"{x:.3g}" for x in row.values()) + " |" for M, row in rows.items()),
    ]  # fmt: skip


def _page_of_members(ns: dict[str, float]) -> list[str]:
    return [
        "## An ensemble", "", "Processor time over the number of threads, all threads at work.", "",
        "| program | ns per member and step |", "|---|---|", *(f"| {name} | {x:.3g} |" for name, x in ns.items()),
    ]  # fmt: skip


def _page_of_references(rows: Rows) -> list[str]:
    lines = [
        "## A reference", "",
        f"To t = {T_END} at rtol {RTOL:g}. The error is the largest difference of the tip's displacement from the",
        "exact one, over its largest. Solvers on `system.ode()` are called as a user calls them and step across",
        "events.", "", "| solver | ms | over exact | error | work |", "|---|---|---|---|---|",
    ]  # fmt: skip
    for name, row in rows.items():
        work = ", ".join(f"{count} {what}" for what, count in row["work"].items() if what in ("steps", "rhs", "stages"))
        ratio = row["ms"] / rows["exact"]["ms"]
        lines.append(f"| {name} | {row['ms']:.3g} | {ratio:.3g} | {row['error']:.1e} | {work} |")
    lines += [
        "", "CVODE and IDA run without Python in their steps. The same functions as Python callbacks of scikit-sundae",
        "take the same steps:", "", "| method | time compiled / Python | counters |", "|---|---|---|",
    ]  # fmt: skip
    for m in SUNDIALS:
        other = rows[f"{m}, Python callbacks"]
        both = [rows[m]["work"][name] == count for name, count in other["work"].items()]  # Python's are fewer
        equal = "equal" if all(both) else "differ"
        lines.append(f"| {m} | {rows[m]['ms'] / other['ms']:.2f} | {equal} |")
    return lines


def _page_of_waits(rows: Rows) -> list[str]:
    lines = [
        "## Waits", "", "Work beside the time steps. The ratio divides the first record by today's, both in multiples",
        "of the first line of their own run, because the speed of the machine changes.", "",
        "| work | unit | first record | today | ratio | goal |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    speed = rows[YARDSTICK]["amount"] / rows[YARDSTICK].get("first", rows[YARDSTICK]["amount"])
    for name, row in rows.items():
        first = row.get("first", row["amount"])
        pace = 1.0 if row["unit"] in ("kB", "ratio") else speed
        goal = "" if row["goal"] is None else f"{row['goal']:g}"
        ratio = first * pace / row["amount"]
        lines.append(f"| {name} | {row['unit']} | {first:.3g} | {row['amount']:.3g} | {ratio:.3g} | {goal} |")
    return lines


def _page_of_compare(rows: Rows) -> list[str]:
    return [
        "## The first minute", "",
        "`stiffbeam compare table10`, each time in a fresh process. Seconds until the table is printed, until picture",
        "and files are written, and of the processor:", "",
        "| kernels and programs | table | end | processor |", "|---|---|---|---|",
        *(f"| {name} | {x['table']:.1f} | {x['seconds']:.1f} | {x['processor']:.1f} |" for name, x in rows.items()),
    ]  # fmt: skip


TABLES: dict[str, Callable[[Any], list[str]]] = {
    "steps": _page_of_steps,
    "whole": _page_of_runs,
    "sizes": _page_of_sizes,
    "members": _page_of_members,
    "references": _page_of_references,
    "waits": _page_of_waits,
    "compare": _page_of_compare,
}


def missed(ratios: dict[str, float], recorded: dict[str, float]) -> list[str]:
    """Ratios that are worse than recorded by more than a third; smaller is better."""
    return [
        f"{name}: {ratios[name]:.3g}, recorded {value:.3g}"
        for name, value in recorded.items()
        if name in ratios and ratios[name] > TOLERATED * value
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", default=list(TABLES), help=f"tables to measure: {', '.join(TABLES)}")
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no ratio is judged")
    parser.add_argument("--record", action="store_true", help="write speed.json and speed.md")
    options = parser.parse_args()
    if unknown := set(options.parts) - set(TABLES):
        parser.error(f"no tables: {', '.join(sorted(unknown))}; choose from {', '.join(TABLES)}")
    record = measure(options.parts, options.quick)
    recorded = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else {"ratios": {}}
    for name, row in record.get("waits", {}).items():
        before = recorded.get("waits", {}).get(name, row)
        row["first"] = before.get("first", before["amount"])
    print(page(record))
    failures = [] if options.quick else missed(record["ratios"], recorded["ratios"])
    for line in failures:
        print(f"worse by more than a third: {line}", file=sys.stderr)
    if options.record:
        recorded |= record | {"ratios": recorded["ratios"] | record["ratios"]}
        RECORD.write_text(json.dumps(recorded, indent=2) + "\n", encoding="utf-8")
        PAGE.write_text(page(recorded), encoding="utf-8")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
