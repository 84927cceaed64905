"""``stiffbeam reference``: make, compare and check reference solutions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..basics.progress import Show, progress
from ..basics.validation import InputError
from ..references.registry import ADAPTIVE, BEST, METHODS, MULTIPRECISION, REFERENCES
from .application import app
from .options import CASE, Form, Json, TEnd, option
from .output import check_json, console, make_folder, say, table_of, write_json


@app.command("reference")
def reference_command(
    case: Annotated[str | None, typer.Argument(**CASE)] = None,
    method: Annotated[
        str | None, option(f"{', '.join(METHODS)}; all: compare them; default: the best for the case", "methods")
    ] = None,
    form: Form = None,
    digits: Annotated[str, option("digits of multiprecision: a number, or auto")] = "auto",
    rtol: Annotated[float | None, option("rtol of the adaptive solvers; default: 1e-10")] = None,
    t_end: TEnd = None,
    budget: Annotated[float | None, option("seconds for --method all; default: 60, others are skipped")] = None,
    out: Annotated[Path | None, option("netCDF file to write")] = None,
    check: Annotated[Path | None, option("verify a stored file, or a folder with a manifest")] = None,
    remake: Annotated[Path | None, option("compute missing references of the paper here")] = None,
    cache: Annotated[bool, typer.Option("--cache", help="store the reference, and use a stored one")] = False,
    doubles: Annotated[bool, typer.Option("--doubles", help="read decimals as the nearest doubles")] = False,
    json_file: Json = None,
) -> None:
    """Make, compare and check reference solutions."""
    if sum(x is not None for x in (case, check, remake)) != 1:
        remedy = "give exactly one of them"
        raise InputError("reference", "its arguments", "be one of CASE, --check PATH and --remake DIR", remedy)
    if case is None:
        options = {
            "--method": method, "--form": form, "--digits": digits != "auto", "--rtol": rtol, "--out": out,
            "--t-end": t_end, "--budget": budget, "--cache": cache, "--doubles": doubles,
        }  # fmt: skip
        for flag, value in options.items():
            if value:
                alone = "--check" if remake is None else "--remake"
                raise InputError(flag, str(value), f"be left out with {alone}", "it is an option of CASE")
    check_json(json_file)
    with progress() as show:
        if check is not None:
            from ..studies.references import check as check_files

            records = check_files(check, show)
            failed = any(r["problem"] for r in records)
        elif remake is not None:
            from ..studies.references import remake as remake_files

            make_folder(remake, "--remake")
            records = [{"file": name, "written": True} for name in remake_files(remake, None, show)]
            failed = False
        else:
            assert case is not None
            records = _references(case, method, form, digits, rtol, t_end, budget, out, cache, doubles, show)
            failed = False
    if not write_json("reference", {"references": records}, json_file):
        _print(records, together=method == "all" and case is not None)
    if failed:
        raise typer.Exit(1)


def _references(
    name: str, asked: str | None, form: str | None, digits: str, rtol: float | None, t_end: float | None,
    budget: float | None,
    out: Path | None, cache: bool, doubles: bool, show: Show,
) -> list[dict[str, Any]]:  # fmt: skip
    """Records of one reference, saved, or of the agreement of all methods."""
    from dataclasses import replace

    from ..basics.exact_float import as_doubles
    from ..files.cases import case_text, find_case
    from ..files.reference_cache import cached_reference
    from ..measures.impacts import impact_times
    from ..references import reference, substitute

    case = find_case(name)
    end = case.t_end if t_end is None else t_end
    method = asked or (BEST[1] if substitute(case.system(form), end) else BEST[0])
    kind = REFERENCES[method].kind if method in REFERENCES else ""
    used = {
        "--digits": digits == "auto" or kind == MULTIPRECISION,
        "--rtol": rtol is None or kind == ADAPTIVE or method == "all",
        "--budget": budget is None or method == "all",
    }
    for flag, fits in used.items():
        if not fits and (kind or method == "all"):
            raise InputError(flag, "with --method " + method, "be left out here", "this method has no use for it")
    rtol = 1e-10 if rtol is None else rtol
    if doubles:
        if out is not None:
            raise InputError("--doubles", "with --out", "be left out here", "a frozen case is read as decimals")
        case = replace(case, problem=as_doubles(case.problem))
    if method == "all":
        if out is not None:
            remedy = "name the one method whose file you want"
            raise InputError("--out", str(out), "be left out with --method all", remedy)
        from ..studies.references import agree

        return [agree(case, form, end, budget=60.0 if budget is None else budget, rtol=rtol, progress=show).to_dict()]
    if digits != "auto" and not (digits.isascii() and digits.isdigit() and len(digits) < 10):
        raise InputError("--digits", digits, "be a number of digits or auto", "for example 100")
    system = case.system(form)
    show(f"{method}@{system.form}", 0, 0)
    if cache and out is not None and method == "multiprecision":
        raise InputError("--cache", "with --out", "be left out here", "the file written is itself one to keep")
    solve = cached_reference if cache else reference
    solution = solve(system, end, method, rtol=rtol, digits="auto" if digits == "auto" else int(digits))
    record = {
        "measured": ["seconds"],
        "reference": solution.label,
        "t_end": end,
        "horizon": solution.horizon,
        "units": str(solution.units),
        "against": solution.provenance["horizon_against"],
        "impacts": len(impact_times(solution)),
        "seconds": round(solution.work.seconds, 3),
        "digits": solution.provenance.get("digits"),
        "parameters": solution.provenance.get("parameters"),
    }
    if out is not None:
        from ..files.store import can_freeze, freeze

        frozen = can_freeze(solution) and case.beam is not None
        record["file"] = freeze(solution, case_text(name), out)["file"] if frozen else str(solution.save(out))
    return [record]


def _print(records: list[dict[str, Any]], together: bool) -> None:
    if together:
        _print_agreement(records[0])
        return
    for record in records:
        say("  ".join(f"{key}: {value}" for key, value in record.items() if value not in ("", None)))
    if not records:
        say("nothing to do: every reference is there and whole")


def _print_agreement(record: dict[str, Any]) -> None:
    lines = []
    for name, differences in record["differences"].items():
        impacts = record["impact_differences"][name][record["baseline"]]
        lines.append({
            "reference": name, "horizon": f"{record['horizons'][name]:.4g}",
            "tip difference": f"{differences[record['baseline']]:.1e}",
            "impact times": "sampled" if impacts is None else f"{impacts:.1e}",
            "run time (s)": f"{record['seconds'][name]:.3g}", "claim": record["inconsistent"].get(name, "holds"),
        })  # fmt: skip
    say(f"Against {record['baseline']}, each to its horizon; units: {record['units']}")
    console(120).print(table_of(lines))
    for name, reason in record["skipped"].items():
        say(f"skipped  {name}: {reason}")
