"""A problem of the test set from its TOML file, for programs that have NumPy and not stiffbeam, and the run of all.

    M q'' + C q' + K q = sum p f(t) + sum row F,    F = -sign (kappa d^p (1 + lambda d') + c d')_+ of depth d

in a stop with sign +1 above and -1 below, d = sign (row.q + offset(t) - stop). A stiffness of inf is a rigid stop
with restitution e. An adapter gives ``main`` a function solve(problem, level) -> (t, q, v), arrays (k,), (k, n),
(k, n), and raises ``Refused`` for what its engine has no words for.
"""

from __future__ import annotations

import json
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


class Refused(Exception):
    """What the engine cannot express."""


class Problem:
    """M, C, K (n, n); q, v (n,) at the start; contacts as in the file, each with its row (n,); loads(t) -> (n,)."""

    def __init__(self, text: str) -> None:
        table = tomllib.loads(text)
        data = table["system"]
        self.name, self.t_end, self.steps = table["name"], table["t_end"], tuple(table["steps"])
        self.q, self.v = (np.array(data[f"initial_{x}"], float) for x in ("displacement", "velocity"))
        self.n = len(self.q)
        self.M, self.K = _matrix(data["mass"]), _matrix(data["stiffness"])
        self.C = _matrix(data["damping"]) if "damping" in data else 0.0 * self.M
        self.load_tables = [(np.array(x["vector"], float), x) for x in data.get("loads", ())]
        self.contacts = data["contacts"]
        for contact in self.contacts:
            contact["row"] = np.array(contact["row"], float)
        self.rigid = any(c["stiffness"] == np.inf for c in self.contacts)

    def loads(self, t: float) -> np.ndarray:
        """Their sum at time t."""
        return sum((p * value(x, t) for p, x in self.load_tables), np.zeros(self.n))


def value(x: dict[str, Any], t: float) -> float:
    """A function of time of the file."""
    if "constant" in x:
        return x["constant"]
    if "times" in x:
        return float(np.interp(t, x["times"], x["values"]))
    return x["amplitude"] * np.sin(x["frequency"] * t + x.get("phase", 0.0))


def modes(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Phi with Phi' M Phi = 1 and the squares of the frequencies."""
    half = np.linalg.inv(np.linalg.cholesky(problem.M))
    squares, shapes = np.linalg.eigh(half @ problem.K @ half.T)
    return half.T @ shapes, np.maximum(squares, 0.0)


def _matrix(given: Any) -> np.ndarray:
    if not isinstance(given, dict):
        return np.array(given, float)
    full = np.diag(np.array(given["bands"][0], float))
    for k, band in enumerate(given["bands"][1:], start=1):
        full = full + np.diag(band, k) + np.diag(band, -k)
    return full


def main(
    engine: str, version: str, options: str, solve: Callable[[Problem, float], Any], limit: float = np.inf
) -> None:
    """Solve every problem of a folder and write the runs into another: FOLDER OUT [NAME ...].

    OUT/NAME-LEVEL.npz holds t, q, v, seconds, and OUT/engine.json what was refused or failed. limit: no more than
    so many numbers, steps times unknowns, in a run.
    """
    problems, out, names = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    out.mkdir(parents=True, exist_ok=True)
    refused: dict[str, str] = {}
    failed: dict[str, dict[str, str]] = {}
    for file in sorted(problems.glob("*.toml")):
        if names and file.stem not in names:
            continue
        problem = Problem(file.read_text(encoding="utf-8"))
        levels = [x for x in problem.steps if x * problem.n <= limit]
        if not levels:
            refused[problem.name] = "left out here: it takes long"
        for level in levels:
            begun = time.perf_counter()
            try:
                t, q, v = (np.array(x, float) for x in solve(problem, level))
            except Refused as error:
                refused[problem.name] = str(error)
                break
            except Exception as error:  # of an engine: what it breaks on is a result
                failed.setdefault(problem.name, {})[f"{level:g}"] = f"{type(error).__name__}: {error}".splitlines()[0]
                continue
            seconds = time.perf_counter() - begun
            np.savez(out / f"{problem.name}-{level:g}.npz", t=t, q=q, v=v, seconds=seconds)
            print(f"{engine}: {problem.name}, {level:g}: {seconds:.2f} s", flush=True)
    record = {"engine": engine, "version": version, "options": options}
    (out / "engine.json").write_text(json.dumps(record | {"refused": refused, "failed": failed}, indent=1), "utf-8")
