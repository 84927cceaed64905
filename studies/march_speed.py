"""How fast are march, ensembles and references against what one would write by hand, and what bounds them?

    python studies/march_speed.py [--quick] [--out DIR] [--record FILE]

Everything is timed in one process, in turns, the least of several repetitions counting, so that the
ratios hold where the machine drifts; whatever takes longer than a few milliseconds in processor time,
which other people's work does not change. Ensembles are given as processor time over threads: what a
member-step takes on that many cores of their own. Writes march_speed.json and march_speed.png to DIR, prints the
ratios, and ends with status 1 when one recorded in studies/march_speed.json is missed by more than a
third. ``--record`` writes the ratios found. Written by hand, Table 10 (M = 25, implicit contact):

* NumPy loop: HHT-alpha with a prefactored LU, one solve and two matrix-vector products a step.
* by hand: HHT-alpha in modal coordinates, step by step, compiled by numba; it evaluates its drive at
  every step, as ours does once a block, and keeps the tip but no velocity and no impacts.

What bounds the block march. A step of HHT takes R D/K multiply-adds for the entries of a block, a^2 n/K
for the state and, in contact, R + D more; ``stream`` times such a matrix-vector product alone on data
of that size, and bound = multiply-adds x stream. What comes on top are loops of a few dozen numbers,
the search for impacts with their velocities, and sine and cosine once a block.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # idle threads of a library would count as ours

import numpy as np
from hand_written import by_hand, numpy_loop
from march_speed_page import draw
from timing import Timed, least, stream, timed

import stiffbeam as sb
from stiffbeam.basics.resources import cores
from stiffbeam.march.block_march import Stepper
from stiffbeam.march.probe import InModes
from stiffbeam.model.modes import modes

RECORDED = Path(__file__).with_suffix(".json")
SCHEMES = {"HHT": sb.HHT(-0.1), "BDF2": sb.BDF2(), "SDIRK-OS": sb.SDIRK(nystrom=True)}


def march_of(system: sb.System, scheme: sb.Scheme, dt: float, steps: int) -> Timed:
    """The stepping of the block march, impacts and peaks included, propagator excluded as the LU is above."""
    basis = modes(system)
    assert basis is not None
    stepper = Stepper.of(InModes(system, basis), scheme, dt, "implicit")

    def run() -> float:
        march = stepper.start([system], steps, None)
        for _ in march.advance():
            pass
        return march.seconds

    return run


def singles(cells: int, steps: int, repetitions: int) -> dict[str, float]:
    """ns per step of every way to march Table 10 with M = cells."""
    case = sb.paper_case(10)
    system = sb.semidiscretise(case.problem, cells)
    slow = min(steps, 2000)
    loop, loop_tip = numpy_loop(system, case.dt, slow)
    hand, hand_tip = by_hand(system, case.dt, steps)
    runs = {name: march_of(system, scheme, case.dt, steps) for name, scheme in SCHEMES.items()}
    seconds = least({"by hand": hand, **runs}, repetitions)
    ns = {name: 1e9 * x / steps for name, x in seconds.items()}
    ns["NumPy loop"] = 1e9 * least({"": loop}, max(2, repetitions // 5))[""] / slow
    # One scheme, three programs: equal before chaos has made rounding visible.
    run = sb.integrate(system, SCHEMES["HHT"], case.dt, 0.05)
    for tip in (loop_tip, hand_tip):
        assert np.max(np.abs(run.tip[:500] - tip[:500])) < 1e-9, "the programs march different schemes"
    return ns


def whole_runs(steps: int, repetitions: int) -> dict[str, float]:
    """ns per step of ``integrate`` with every step kept, and of the energy ledger's second pass."""
    case = sb.paper_case(10)
    system = sb.semidiscretise(case.problem, case.cells)
    found = {}
    for name, scheme in SCHEMES.items():

        def whole(scheme=scheme):
            return sb.integrate(system, scheme, case.dt, steps * case.dt)

        found[f"{name}, whole run"] = 1e9 * least({"": timed(whole)}, repetitions)[""] / steps
        runs = [whole() for _ in range(max(2, repetitions // 3))]
        found[f"{name}, ledger"] = 1e9 * min(timed(lambda run=run: run.energy)() for run in runs) / steps
    return found


def ensembles(members: int, steps: int, repetitions: int) -> dict[str, float]:
    """ns per member-step of ensembles of Table 10 on all threads, and seconds per exact member."""
    case = sb.paper_case(10)
    system = sb.semidiscretise(case.problem, case.cells)
    many = sb.perturbed(system, members)
    drives = sb.varied(system, frequency=np.linspace(9.0, 11.0, members))
    t_end, count = steps * case.dt, cores()

    def run(scheme: sb.Scheme, which=many) -> Timed:
        return timed(lambda: sb.integrate_ensemble(system, scheme, case.dt, t_end, which), count)

    runs = {name: run(scheme) for name, scheme in SCHEMES.items()}
    runs["HHT, frequencies"] = run(SCHEMES["HHT"], drives)
    found = {name: 1e9 * x / (members * steps) for name, x in least(runs, repetitions).items()}
    few = max(4, members // 10)
    exact = least({"": timed(lambda: sb.reference_ensemble(system, t_end, many[:few]), count)}, 2)[""]
    return found | {"exact, seconds for 1000 members": 1000 * exact / few}


def threads(members: int, steps: int, repetitions: int) -> dict[str, dict[str, float]]:
    """Wall seconds of ensembles on 1, 2, 4, .. threads and on all cores: they mean something on a quiet
    machine only."""
    case, all_cores = sb.paper_case(10), cores()
    system = sb.semidiscretise(case.problem, case.cells)
    many, t_end, found = sb.perturbed(system, members), steps * case.dt, {}
    runs = {
        name: lambda scheme=scheme: sb.integrate_ensemble(system, scheme, case.dt, t_end, many)
        for name, scheme in SCHEMES.items()
    } | {"exact": lambda: sb.reference_ensemble(system, 0.2 * t_end, many[: members // 4])}
    counts = sorted({all_cores, *(2**k for k in range(all_cores.bit_length()))})
    before = os.environ.get("STIFFBEAM_THREADS")
    for name, run in runs.items():
        times: dict[str, list[float]] = {str(count): [] for count in counts}
        for _ in range(repetitions):
            for count in counts:
                os.environ["STIFFBEAM_THREADS"] = str(count)
                times[str(count)].append(run().work.seconds)
        found[name] = {count: min(each) for count, each in times.items()}
    os.environ.pop("STIFFBEAM_THREADS")
    if before is not None:
        os.environ["STIFFBEAM_THREADS"] = before
    return found


def references(t_end: float) -> dict[str, float]:
    """Seconds of the references over [0, t_end] at rtol 1e-10, each alone, the least of three."""
    from stiffbeam.references import solve

    case = sb.paper_case(10)
    system, t = sb.semidiscretise(case.problem, case.cells), np.linspace(0.0, t_end, 11)
    methods = ("exact", "cvode", "cvode-adams", "dop853")
    return least({m: timed(lambda m=m: solve(system, t_end, m, t, 1e-10, 1e-12)) for m in methods}, 3)


def startup() -> dict[str, float]:
    """Seconds from the command to the first step of a reference and of a scheme; kernels on disk."""
    code = """
import os, sys, time
from stiffbeam import cli
from stiffbeam.piecewise import tracer
from stiffbeam.march import block_march
def mark(owner, name, label, last):
    original = getattr(owner, name)
    def marked(*arguments, **keywords):
        print(label, time.process_time(), time.time(), flush=True)
        setattr(owner, name, original)
        if last:
            os._exit(0)
        return original(*arguments, **keywords)
    setattr(owner, name, marked)
mark(tracer.Tracer, "solve", "reference", False)
mark(block_march.March, "advance", "scheme", True)
sys.argv = ["stiffbeam", "compare", "table10"]
cli.main()
"""
    found: dict[str, float] = {}
    for _ in range(4):
        begun = time.time()
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        for line in done.stdout.splitlines():
            what, busy, now = line.rsplit(" ", 2)
            for label, seconds in ((what, float(now) - begun), (f"{what}, processor time", float(busy))):
                found[label] = min(found.get(label, np.inf), seconds)
    return found


def bound_of(cells: int) -> dict[str, float]:
    """Multiply-adds of a step and the ns they take when streamed, per scheme."""
    case = sb.paper_case(10)
    system = sb.semidiscretise(case.problem, cells)
    basis, found = modes(system), {}
    assert basis is not None
    for name, scheme in SCHEMES.items():
        propagator = Stepper.of(InModes(system, basis), scheme, case.dt, "implicit").block
        (R, D), N = propagator.block.reading.shape, len(propagator.block.push)
        share = sb.integrate(system, scheme, case.dt, 0.5, every=100).contacts[0].fraction
        work = (R * D + len(propagator.block.transition) * D + share * N * (R + D)) / propagator.steps
        found[f"{name}, multiply-adds"] = work
        found[f"{name}, bound ns"] = 1e9 * work * stream(R, D)
    return found


def ratios_of(record: dict) -> dict[str, float]:
    """The ratios that are watched: smaller is better, but for those that say ``times``."""
    one, many, whole = record["single"]["25"], record["ensemble"], record["whole"]
    ratios = {f"{name} / by hand": one[name] / one["by hand"] for name in SCHEMES}
    ratios |= {f"{name} / bound": one[name] / record["bound"][f"{name}, bound ns"] for name in SCHEMES}
    ratios |= {f"NumPy loop / {name}, times": one["NumPy loop"] / one[name] for name in SCHEMES}
    ratios |= {
        f"NumPy loop / {name} whole run, times": one["NumPy loop"] / whole[f"{name}, whole run"] for name in SCHEMES
    }
    ratios |= {f"{name} member-step / by hand": many[name] / one["by hand"] for name in SCHEMES}
    ratios["HHT member-step with own frequency / by hand"] = many["HHT, frequencies"] / one["by hand"]
    ratios["HHT ledger / by hand"] = whole["HHT, ledger"] / one["by hand"]
    seconds = record["reference"]
    ratios["CVODE BDF / exact, times"] = seconds["cvode"] / seconds["exact"]
    ratios["DOP853 / exact, times"] = seconds["dop853"] / seconds["exact"]
    return ratios


def missed(ratios: dict[str, float], recorded: dict[str, float]) -> list[str]:
    """What is worse than recorded by more than a third."""
    return [
        f"{name}: {ratios[name]:.3g}, recorded {value:.3g}"
        for name, value in recorded.items()
        if (ratios[name] < value / (4 / 3) if name.endswith("times") else ratios[name] > value * 4 / 3)
    ]


def measure(quick: bool) -> dict:
    cells = [25, 50] if quick else [10, 25, 50, 100, 200, 400]
    repetitions = 2 if quick else 15
    steps = 2000 if quick else 20_000
    case = sb.paper_case(10)
    system = sb.semidiscretise(case.problem, case.cells)
    record: dict = {"cores": cores()}
    record["single"] = {str(M): singles(M, steps if M <= 50 else steps // 4, repetitions) for M in cells}
    record["bound"] = bound_of(25)
    record["whole"] = whole_runs(steps, 2 if quick else 5)
    record["steps"] = {name: {} for name in SCHEMES}
    for name, scheme in SCHEMES.items():
        for k in (500, 1000) if quick else (1000, 10_000, 100_000, 1_000_000):
            work = timed(lambda s=scheme, k=k: sb.integrate(system, s, case.dt, k * case.dt, every=100))
            record["steps"][name][str(k)] = least({"": work}, 3)[""]
    record["ensemble"] = ensembles(8 if quick else 200, steps, 1 if quick else 5)
    record["threads"] = threads(8 if quick else 200, steps if quick else 5 * steps, 1 if quick else 5)
    sizes = (1, 4) if quick else (1, 10, 100, 1000)
    record["members"] = {}
    for size in sizes:
        many = sb.perturbed(system, size)
        work = timed(lambda many=many: sb.integrate_ensemble(system, SCHEMES["HHT"], case.dt, 0.2, many), cores())
        record["members"][str(size)] = 1e9 * least({"": work}, 2)[""] / (size * round(0.2 / case.dt))
    record["reference"] = references(0.01 if quick else 0.1)
    record["startup"] = startup() if not quick else {}
    record["ratios"] = ratios_of(record)
    return record


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a smoke run: small sizes, no ratio is judged")
    parser.add_argument("--out", type=Path, default=Path("stiffbeam-output/march_speed"))
    parser.add_argument("--record", type=Path, help="write the ratios found to this file")
    options = parser.parse_args()
    record = measure(options.quick)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "march_speed.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    draw(record, options.out / "march_speed.png")
    for name, value in record["ratios"].items():
        print(f"{name:50} {value:8.3g}")
    for name, value in record["startup"].items():
        print(f"second `stiffbeam compare table10`, first step of the {name}: {value:.2f} s")
    for name, times in record["threads"].items():
        gains = ", ".join(f"{count}: {times['1'] / seconds:.2f}" for count, seconds in times.items())
        print(f"times as fast on so many threads, ensemble of {name}: {gains}")
    if options.record:
        options.record.write_text(json.dumps(record["ratios"], indent=2) + "\n", encoding="utf-8")
    if options.quick:
        return 0
    failures = missed(record["ratios"], json.loads(RECORDED.read_text(encoding="utf-8")))
    for line in failures:
        print(f"missed by more than a third: {line}", file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
