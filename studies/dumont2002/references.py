"""Frozen multiprecision solutions of the paper's tables, in a folder with a manifest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import stiffbeam as sb
from stiffbeam.basics.storage import read_netcdf, write_whole
from stiffbeam.files.cases import Case, paper_cases
from stiffbeam.files.store import BOUND, keep

MANIFEST = "MANIFEST.json"
PARAMETERS = "decimals and multiples of pi exactly as written in the case, not the doubles nearest to them"
STORE = Path(__file__).parents[2] / "reference" / "tables"


def entries(folder: Path) -> list[dict[str, Any]]:
    """The manifest of a folder, an entry for each solution; none where the folder has no manifest."""
    file = folder / MANIFEST
    return json.loads(file.read_text(encoding="utf-8"))["references"] if file.is_file() else []


def frozen(folder: Path, case: Case, form: str) -> sb.Reference:
    """The frozen solution of a table over at least its time span. Raises InputError if there is none."""
    for entry in entries(folder):
        if case.name in entry["tables"] and entry["form"] == form and entry["t_end"] >= case.t_end:
            solution = sb.load(folder / entry["file"], case.system(form))
            assert isinstance(solution, sb.Reference)
            return solution
    rule = f"have a solution of {case.name}, {form} form, to t = {case.t_end:g}"
    raise sb.InputError("references", str(folder), rule, "compute it: dumont2002.references.remake(STORE)")


def wanted() -> list[tuple[str, str, list[str]]]:
    """(first table, form, all tables) of every distinct system among the paper's runs. Tables with the same physics,
    grid and time span share one solution."""
    systems: dict[tuple[str, float], tuple[str, str, list[str]]] = {}
    for case in paper_cases().values():
        for form in ["displacement", *sorted({form for _, form in case.runs} - {"displacement"})]:
            key = (case.system(form).fingerprint, case.t_end)
            systems.setdefault(key, (case.name, form, []))[2].append(case.name)
    return list(systems.values())


def remake(folder: Path) -> list[str]:
    """Compute the solutions that the manifest of ``folder`` lacks; returns the files written. All take about a quarter
    of an hour."""
    known, written = {entry["file"]: entry for entry in entries(folder)}, list[str]()
    for name, form, tables in wanted():
        file = folder / f"{name}-{form}.nc"
        if file.name in known and file.is_file():
            continue
        solution = sb.reference(paper_cases()[name].system(form), paper_cases()[name].t_end, "multiprecision")
        assert solution.horizon >= paper_cases()[name].t_end  # only what is confirmed to its end is frozen
        hash = read_netcdf(keep(solution, file)).attrs["hash"]
        known[file.name] = {"file": file.name} | facts(solution) | {
            "seconds": round(solution.work.seconds, 1), "hash": hash, "tables": tables
        }  # fmt: skip
        ordered = sorted(known.values(), key=lambda e: (int(e["tables"][0].removeprefix("table")), e["form"]))
        text = json.dumps({"parameters": PARAMETERS, "references": ordered}, indent=2)
        write_whole(folder / MANIFEST, text + "\n")
        written.append(file.name)
    return written


def facts(solution: sb.Reference) -> dict[str, Any]:
    """Form, end, digits and contact of a solution: impacts of all contacts, the largest share and force among them."""
    notes, contacts = solution.provenance, solution.contacts
    return {
        "form": notes["form"], "t_end": notes["t_end"], "digits": notes["digits"],
        "confirmed_with": notes["digits_confirmed_with"],
        "impacts": sum(contact.impacts.count for contact in contacts),
        "contact_fraction": max(contact.fraction for contact in contacts),
        "peak_force": max(contact.peak_force for contact in contacts), "bound": BOUND,
    }  # fmt: skip
