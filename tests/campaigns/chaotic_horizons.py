"""Are float64 horizons ever too long? Random chaotic systems, each held against its solution in many digits.

    python tests/campaigns/chaotic_horizons.py --systems 1000 --jobs 2

Prints every horizon that is longer than float64 and the many digits agree, and how the horizons compare.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("", "oracles")]

import extremes
import numpy as np

import stiffbeam as sb
from stiffbeam.references.horizon import agreement, time_tolerance

BEYOND = 1.5  # how far past the certified horizon the truth is computed
DIGITS = 40


def measure(seed: int) -> tuple[int, str, float]:
    """(seed, outcome, certified / true horizon)."""
    system, t_end = extremes.chaotic(np.random.default_rng([seed, 7]))
    try:
        certified = sb.reference(system, t_end).horizon
        if certified == t_end:
            return seed, "whole", 1.0
        t_end = min(t_end, BEYOND * certified)
        if t_end == 0.0:
            return seed, "none", 0.0
        t = np.linspace(0.0, t_end, 401)
        exact = sb.reference(system, t_end, t_eval=t)
        many = sb.reference(system, t_end, "multiprecision", t, digits=DIGITS)
    except (sb.InputError, sb.SolverFailure) as error:
        return seed, f"refused: {error}", np.nan
    if many.horizon < t_end:
        return seed, f"the many digits hold to {many.horizon:.3g} of {t_end:.3g}", np.nan
    true = agreement(exact, many, time_tolerance(system))
    ratio = exact.horizon / true
    outcome = "short" if exact.horizon <= true else "whole" if true >= t_end else "LONG"
    return seed, outcome, ratio


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--systems", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    begun, ratios, outcomes = time.monotonic(), [], {}
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        for seed, outcome, ratio in pool.map(measure, range(options.first, options.first + options.systems)):
            name = outcome.split(":")[0]
            outcomes[name] = outcomes.get(name, 0) + 1
            if name in ("short", "LONG"):
                ratios.append(ratio)
            else:
                if name not in ("whole", "none"):
                    print(f"{seed}: {outcome}", flush=True)
            if name == "LONG":
                print(f"{seed}: LONG, {ratio:.4f} of the true horizon", flush=True)
    print(f"{options.systems} systems in {time.monotonic() - begun:.0f} s: {outcomes}")
    if ratios:
        print(f"certified / true: median {np.median(ratios):.3f}, largest {max(ratios):.4f}")
    return 1 if outcomes.get("LONG") else 0


if __name__ == "__main__":
    sys.exit(main())
