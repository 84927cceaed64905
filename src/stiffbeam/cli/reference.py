"""``stiffbeam reference``: make, compare and check solutions; ``stiffbeam score``: integrators on known answers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..basics.resources import Show, progress
from ..basics.validation import InputError
from ..references.registry import ADAPTIVE, BEST, METHODS, MULTIPRECISION, REFERENCES
from .application import (
    CASE,
    Form,
    Json,
    TEnd,
    app,
    check_json,
    completion,
    console,
    make_folder,
    option,
    say,
    write_json,
)
from .tables import table_of


@app.command("reference")
def reference_command(
    case: Annotated[str | None, typer.Argument(**CASE)] = None,
    method: Annotated[
        str | None, option(f"{', '.join(METHODS)}; all: compare them; default: the best for the case", "methods")
    ] = None,
    form: Form = None,
    digits: Annotated[str, option("digits of multiprecision: a number, or auto")] = "auto",
    rtol: Annotated[float | None, option("relative tolerance of the adaptive solvers; default: 1e-10")] = None,
    t_end: TEnd = None,
    budget: Annotated[
        float | None, option("seconds for all solvers of --method all; those that take longer are skipped; default: 60")
    ] = None,
    out: Annotated[Path | None, option("netCDF file to write")] = None,
    check: Annotated[Path | None, option("verify a frozen reference, or a folder with a manifest")] = None,
    remake: Annotated[Path | None, option("compute the missing frozen references of the paper in this folder")] = None,
    cache: Annotated[bool, typer.Option("--cache", help="store the reference, and use a stored one")] = False,
    doubles: Annotated[bool, typer.Option("--doubles", help="read decimals as the nearest doubles")] = False,
    json_file: Json = None,
) -> None:
    """Compute, compare and verify reference solutions."""
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
            records = [{"file": name, "written": True} for name in remake_files(remake, show)]
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

    from ..basics.validation import as_doubles
    from ..files.cases import case_text, find_case
    from ..files.reference_cache import cached_reference
    from ..measures.errors import impact_times
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


@app.command()
def score(
    integrators: Annotated[
        str | None,
        typer.Argument(
            help="comma-separated: schemes, solvers, module:function; e.g. 'HHT(alpha=-0.1),cvode'",
            autocompletion=completion("integrators"),
        ),
    ] = None,
    problem: Annotated[
        str | None, option("comma-separated names; default: all, in minutes for a function in Python", "problems")
    ] = None,
    trajectory: Annotated[
        list[Path] | None, option("score this file instead: columns t, u and, if known, v; repeat for other time steps")
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="list the problems, or print the file of one --problem")] = False,
    latex: Annotated[bool, option("one --problem as a LaTeX table")] = False,
    out: Annotated[Path | None, option("folder for the page index.html, pictures and records")] = None,
    json_file: Json = None,
) -> None:
    """Errors of integrators on problems with known answers.

    Exit status 0: no result is flagged; 1: an error does not fall with the step, or too slowly, or a run failed.
    """
    from ..schemes.labels import split_runs
    from ..testset.measure import read_trajectory
    from ..testset.problem import folder, problems
    from ..testset.problem import problem as find
    from ..testset.score import score as score_all
    from ..testset.score import score_trajectories

    # What writes one thing takes no option that would be passed over.
    alone = "--list" if show else "--latex" if latex else "--trajectory" if trajectory else None
    others = {
        "INTEGRATORS": integrators, "--trajectory": trajectory and alone != "--trajectory",
        "--latex": latex and alone != "--latex",
        "--out": out if alone in ("--list", "--latex") else None,
        "--json": json_file if alone in ("--list", "--latex") else None,
    }  # fmt: skip
    for name, value in others.items():
        if alone is not None and value:
            raise InputError(name, str(value), f"be left out with {alone}", "give one command for each")
    check_json(json_file)
    if out is not None:
        make_folder(out)  # before the work begins
    names = None if problem is None else [name.strip() for name in problem.split(",")]
    if (trajectory or latex) and (names is None or len(names) != 1):
        option = "--latex" if latex else "--trajectory"
        raise InputError("--problem", problem, f"name one problem for {option}", ", ".join(problems()))
    if latex:
        from ..testset.scorecard import latex_table

        say(latex_table(find(names[0])))  # type: ignore[index]
        return
    if show:
        for name in names or []:
            say(folder().joinpath(f"{find(name).name}.toml").read_text(encoding="utf-8").rstrip("\n"))
        if names is None:
            _list()
        return
    if trajectory:
        label = trajectory[0].name if len(trajectory) == 1 else f"{len(trajectory)} files"
        assert names is not None
        card = score_trajectories(names[0], [read_trajectory(x) for x in trajectory], label)
    else:
        with progress() as bar:
            card = score_all(None if integrators is None else split_runs(integrators), names, progress=bar)
    written = [] if out is None else card.save(out)
    if not write_json("score", card.to_dict(), json_file):
        console(card.width).print(card.tables())
        if written:
            say(f"Written: {written[0]} and {len(written) - 1} files beside it")
    if card.flagged:
        raise typer.Exit(1)


def _list() -> None:
    from ..testset.problem import VERSION, problems

    say(f"Test set {VERSION}")
    for each in problems().values():
        say(f"  {each.name:<22}{each.title}")
