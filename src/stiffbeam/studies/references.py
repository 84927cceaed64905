"""Reference solutions: those stored in a folder with a manifest, and how long all methods agree, at what cost."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import TALK, Show, silent
from ..basics.storage import read_netcdf, write_whole
from ..basics.text import plain
from ..basics.validation import InputError, positive
from ..files.cases import Case, case_text, paper_cases
from ..files.store import contact_facts, freeze, load
from ..measures.errors import impact_times
from ..references import expected_seconds, reference, solve
from ..references.horizon import agreement, time_tolerance
from ..references.registry import BUDGET, EXACT, METHODS, MULTIPRECISION, REFERENCES, RTOL, Steps
from ..trajectory.trajectory import Reference, SolverFailure, Trajectory

MANIFEST = "MANIFEST.json"
PARAMETERS = "decimals and multiples of pi exactly as written in the case, not the doubles nearest to them"
PACKAGED = Path(__file__).parents[1] / "frozen"  # where a wheel has the repository's folder
REPOSITORY = Path(__file__).parents[3] / "reference"


def shipped() -> Path | None:
    """Folder of stored references: ``./reference``, or that of the package."""
    return next((p for p in (Path("reference"), PACKAGED, REPOSITORY) if (p / MANIFEST).is_file()), None)


def check(target: Path, progress: Show = silent) -> list[dict[str, Any]]:
    """Check a stored file, or every file of a folder and of its manifest: hash, system, events and entry in the
    manifest. Returns one record a file; ``problem`` is empty for a good one.
    """
    if not target.is_dir():
        return [_checked(target, None)]
    known = {entry["file"]: entry for entry in _entries(target)}
    files = sorted({target / name for name in known} | {*target.glob("*.nc")})
    records = []
    for done, file in enumerate(files):
        progress(file.name, done, len(files))
        record = _checked(file, known.get(file.name))
        if file.name not in known and not record["problem"]:
            record["problem"] = "the manifest does not list it"
        records.append(record)
    return records or [{"file": MANIFEST, "problem": "it lists no references"}]


def _checked(file: Path, entry: dict[str, Any] | None) -> dict[str, Any]:
    record: dict[str, Any] = {"file": file.name, "problem": ""}
    try:
        solution = load(file)
        record |= {"impacts": solution.impacts.count, "t_end": solution.provenance["t_end"]}
        if entry is not None:
            record["problem"] = _contradicted(file, solution, entry)
    except InputError as error:
        record["problem"] = str(error)
    return record


def _contradicted(file: Path, solution: Trajectory, entry: dict[str, Any]) -> str:
    """Return the first difference between a file and its entry in the manifest, "" if there is none."""
    written = read_netcdf(file).attrs
    notes = solution.provenance
    facts: dict[str, Any] = contact_facts(solution) | {
        "t_end": notes["t_end"], "form": notes["form"], "digits": notes.get("digits"),
        "confirmed_with": notes.get("digits_confirmed_with"),
    } | {name: written.get(name) for name in ("hash", "bound")}  # fmt: skip
    for name, fact in facts.items():
        said = entry.get(name)
        same = math.isclose(said, fact, rel_tol=1e-6) if isinstance(said, float) and fact is not None else said == fact
        if not same:
            return f"the manifest says {said} {name.replace('_', ' ')}, and not {fact}"
    for table in entry.get("tables", ()):
        case = paper_cases().get(table)
        if case is None or case.system(entry["form"]).fingerprint != solution.fingerprint:
            return f"the manifest says it is of {table}, which is another system"
    return ""


def frozen(folder: Path, case: Case, form: str, t_end: float) -> Reference | None:
    """The stored solution of ``case`` over at least [0, t_end] in ``folder``, None if there is none.

    A case with the name of a table but other physics has none.
    """
    for entry in _entries(folder):
        if case.name in entry["tables"] and entry["form"] == form and entry["t_end"] >= t_end:
            solution = load(folder / entry["file"])
            if isinstance(solution, Reference) and solution.fingerprint == case.system(form).fingerprint:
                return solution
    return None


def whole(folder: Path, progress: Show = silent) -> dict[str, float]:
    """Names and t_end of the frozen files that can be read, are of this version, and what the manifest says."""
    try:
        _entries(folder)
    except InputError:
        return {}
    return {record["file"]: record["t_end"] for record in check(folder, progress) if not record["problem"]}


def _entries(folder: Path) -> list[dict[str, Any]]:
    path = folder / MANIFEST
    if not path.is_file():
        raise InputError("folder", str(folder), f"hold a {MANIFEST}", "remake the references there")
    try:
        return json.loads(path.read_text(encoding="utf-8"))["references"]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError("manifest", str(path), "be whole", f"remake the references there ({error})") from None


def note(folder: Path, entry: dict[str, Any]) -> None:
    """Add an entry to the manifest, in the order of the tables."""
    try:
        entries = {e["file"]: e for e in _entries(folder)}
    except InputError:  # there is none, or it cannot be read
        entries = {}
    entries[entry["file"]] = entry
    ordered = sorted(entries.values(), key=lambda e: (int(e["tables"][0].removeprefix("table")), e["form"]))
    text = json.dumps({"parameters": PARAMETERS, "references": ordered}, indent=2)
    write_whole(folder / MANIFEST, text + "\n")


def wanted() -> list[tuple[str, str, list[str]]]:
    """Return (first table, form, all tables) of every distinct system among the paper's runs.

    Tables with the same physics, grid and time span share one reference.
    """
    systems: dict[tuple[str, float], tuple[str, str, list[str]]] = {}
    for case in paper_cases().values():
        for form in ["displacement", *sorted({form for _, form in case.runs} - {"displacement"})]:
            key = (case.system(form).fingerprint, case.t_end)
            systems.setdefault(key, (case.name, form, []))[2].append(case.name)
    return list(systems.values())


def remake(folder: Path, progress: Show = silent) -> list[str]:
    """Compute and store the missing references in ``folder``; returns the files written.

    A file that is complete, of this version and as the manifest states is kept. Interrupted work continues where it
    stopped, and a deleted file is computed again. All of them take about a quarter of an hour.
    """
    jobs, kept = wanted(), whole(folder, progress)
    written: list[str] = []
    for done, (name, form, tables) in enumerate(jobs):
        progress(f"{name}@{form}", done, len(jobs))
        file = folder / f"{name}-{form}.nc"
        case = paper_cases()[name]
        if kept.get(file.name) == case.t_end:
            continue
        solution = reference(case.system(form), case.t_end, "multiprecision")
        entry = freeze(solution, case_text(name), file) | {"tables": tables}
        note(folder, entry)
        TALK.kept = True
        written.append(file.name)
    return written


# Which method is the baseline: the most precise first.
PRECISION = [m.name for kind in (MULTIPRECISION, EXACT) for m in REFERENCES.values() if m.kind == kind]
INCONSISTENT = 1e3  # times rtol before the first impact: more than that is not what the tolerance claims


@dataclass(frozen=True)
class Agreement:
    """References by method; differences[i][j]: largest |du| over max |u| of methods i and j before
    either's horizon; impact_differences likewise in time; horizons against the most precise; inconsistent:
    methods that are further off than the tolerance they claim; skipped: method and reason."""

    baseline: str
    references: dict[str, Reference]
    differences: Array
    impact_differences: Array
    horizons: dict[str, float]
    inconsistent: dict[str, str]
    skipped: dict[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """All results as plain numbers and texts, for JSON."""
        names = list(self.references)
        return {
            "measured": ["seconds"],
            "baseline": self.baseline,
            "units": str(self.references[self.baseline].units),
            "horizons": self.horizons,
            "inconsistent": self.inconsistent,
            "skipped": self.skipped,
            "seconds": {name: r.work.march_seconds for name, r in self.references.items()},
            "work": {name: r.work.counters for name, r in self.references.items()},
            **{
                name: plain({a: dict(zip(names, row, strict=True)) for a, row in zip(names, matrix, strict=True)})
                for name, matrix in (("differences", self.differences), ("impact_differences", self.impact_differences))
            },
        }


def agree(
    case: Case,
    form: str | None = None,
    t_end: float | None = None,
    methods: Sequence[str] = METHODS,
    budget: float = 4.0 * BUDGET,
    rtol: float = RTOL,
    progress: Show = silent,
) -> Agreement:
    """Run every method that fits into ``budget`` seconds and compare all with the most precise.

    Methods that would not finish within the seconds that are left are named as skipped, with the estimate.
    """
    t_end = positive("t_end", case.t_end if t_end is None else t_end)
    budget = positive("budget", budget)
    system = case.system(form)
    times = np.linspace(0.0, t_end, 401)
    references: dict[str, Reference] = {}
    skipped: dict[str, str] = {}
    left = budget
    # The cheap methods first, so that the budget is enough for many.
    cheap_first = sorted(methods, key=lambda method: REFERENCES[method].seconds if method in REFERENCES else math.inf)
    for done, method in enumerate(cheap_first):
        progress(method, done, len(methods))
        begun = time.perf_counter()
        try:
            # The most precise methods run whatever they take: one of them is the baseline.
            if method not in PRECISION:
                if left <= 0.0:
                    skipped[method] = "nothing left of the budget"
                    continue
                estimate = expected_seconds(system, t_end, method, rtol, None, Steps(), left, solutions=1.0)
                if estimate > left:
                    skipped[method] = f"about {estimate:.0f} s, {left:.0f} s left of the budget"
                    continue
            references[method] = solve(system, t_end, method, times, rtol, None)
        except (InputError, SolverFailure) as error:
            skipped[method] = str(error)
        finally:
            left -= time.perf_counter() - begun
    if not references:
        raise InputError("budget", budget, "let at least one method run", "give more seconds")
    baseline = next((name for name in PRECISION if name in references), next(iter(references)))
    tolerance = time_tolerance(system, t_end)
    horizons = {name: agreement(references[baseline], r, tolerance) for name, r in references.items()}
    names = list(references)
    differences = np.zeros((len(names), len(names)))
    impacts = np.zeros_like(differences)
    scale = float(np.max(np.abs(references[baseline].tip))) or 1.0
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            # Two solutions can only agree to the earlier of their horizons.
            end = min(horizons[a], horizons[b])
            inside = times <= end
            differences[i, j] = np.max(np.abs(references[a].tip - references[b].tip)[inside]) / scale
            impacts[i, j] = _impact_difference(references[a], references[b], end - tolerance)
    return Agreement(
        baseline, references, differences, impacts, horizons, _inconsistent(references, baseline, rtol), skipped
    )


def _impact_difference(a: Reference, b: Reference, end: float) -> float:
    """Largest difference of paired impact times to ``end``; NaN where one of them does not find impacts as events."""
    largest = 0.0
    for x, y in zip(a.contacts, b.contacts, strict=True):
        if "sampled" in (x.impacts.kind, y.impacts.kind):
            return float("nan")
        one, other = x.impacts.until(end).times, y.impacts.until(end).times
        n = min(len(one), len(other))
        largest = max(largest, float(np.max(np.abs(one[:n] - other[:n]), initial=0.0)))
    return largest


def _inconsistent(references: dict[str, Reference], baseline: str, rtol: float) -> dict[str, str]:
    """The methods whose error before the first impact exceeds their tolerance."""
    inconsistent = {}
    best = references[baseline]
    first = float(min([*impact_times(best)[:1], best.t[-1]]))
    inside = best.t <= first
    scale = float(np.max(np.abs(best.tip[inside]))) or 1.0
    for name, r in references.items():
        error = float(np.max(np.abs(r.tip - best.tip)[inside])) / scale
        claim = 1e-11 if name in PRECISION else INCONSISTENT * rtol
        if not error <= claim:
            inconsistent[name] = f"{error:.1e} off before the first impact, claimed {claim:.0e}"
    return inconsistent
