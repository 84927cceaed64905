"""The ``stiffbeam`` command."""

from __future__ import annotations

import json
import os
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from . import cli_reproduce, cli_studies

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Fixed-step schemes beside adaptive and exact solutions of vibro-impact beams.",
)

CaseArgument = Annotated[str, typer.Argument(help="table1 .. table17, a case file, or file.toml:name")]


@app.command()
def cases(
    show: Annotated[str | None, typer.Option(help="print one case as TOML, a start for your own file")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="for programs")] = False,
) -> None:
    """List the paper's cases."""
    from .cases import case_text, paper_cases

    if show is not None:
        print(case_text(show).rstrip())
        return
    listed = paper_cases().values()
    if as_json:
        rows = [
            {
                "name": c.name, "title": c.title, "cells": c.cells, "dt": c.dt, "t_end": c.t_end,
                "runs": [f"{scheme}@{form}" for scheme, form in c.runs],
                "published": c.published, "inferred": list(c.notes),
            }
            for c in listed
        ]  # fmt: skip
        print(json.dumps(rows, indent=2))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("case", "title", "cells", "dt", "t_end", "runs"):
        table.add_column(heading, no_wrap=heading == "case", overflow="fold")
    for c in listed:
        runs = "\n".join(f"{scheme}@{form}" for scheme, form in c.runs)
        table.add_row(c.name, c.title, str(c.cells), f"{c.dt:g}", f"{c.t_end:g}", runs)
    Console().print(table)
    print("t_end and other inferred values carry their reason in `stiffbeam cases --show NAME`.")


@app.command()
def compare(
    case: CaseArgument,
    schemes: Annotated[
        str | None, typer.Option(help="comma-separated, e.g. 'bdf2,hht(alpha=-0.2)@displacement,sdirk.printed'")
    ] = None,
    references: Annotated[
        str, typer.Option(help="comma-separated; the first that can take the case is the yardstick")
    ] = "exact,cvode,cvode-adams",
    contact: Annotated[str, typer.Option(help="implicit, or extrapolated as in the paper")] = "implicit",
    dt: Annotated[float | None, typer.Option(help="time step instead of the case's")] = None,
    t_end: Annotated[float | None, typer.Option(help="end time instead of the case's")] = None,
    out: Annotated[Path | None, typer.Option(help="folder for picture, trajectories and table")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="write the records here, - for stdout")] = None,
    cache: Annotated[bool, typer.Option("--cache", help="keep the references and use those that are kept")] = False,
) -> None:
    """Run schemes beside SUNDIALS and the exact solution: table, picture, trajectories."""
    from .cases import find_case, parse_run, split_runs
    from .reference_cache import cached_reference
    from .solvers import reference
    from .studies.comparison import compare_case
    from .validation import InputError, positive

    chosen = find_case(case)
    for name, value in (("--dt", dt), ("--t-end", t_end)):
        if value is not None:
            positive(name, value)
    runs = None if schemes is None else [_like_case(parse_run(text), text, chosen) for text in split_runs(schemes)]
    names = [name.strip() for name in references.split(",") if name.strip()]
    if json_file is not None and json_file.is_dir():
        raise InputError("--json", str(json_file), "be a file, or - for the terminal")
    for option, given in (("--schemes", runs is None or runs), ("--references", names)):
        if not given:
            raise InputError(option, "nothing", "name at least one")
    folder = out if out is not None else Path("stiffbeam-output") / _file_name(chosen.name)
    written: list[Path] = []

    def keep(run) -> None:
        if not written:
            _clear(folder)
        written.append(run.save(folder / f"{_file_name(run.label)}.nc"))

    with _progress() as progress:
        # Each trajectory is saved as soon as it is there: an interrupt loses only the one that is running.
        result = compare_case(
            chosen, runs, names, contact, dt, t_end, progress, keep, cached_reference if cache else reference
        )
        progress("drawing", 0, 0)
        written += _draw(result, folder)
        records = json.dumps(result.to_dict() | {"files": [path.name for path in written]}, indent=2)
        (folder / "comparison.json").write_text(records + "\n", encoding="utf-8")
        written.append(folder / "comparison.json")
    if json_file is not None and str(json_file) == "-":
        print(records)
    else:
        _print_result(result, written)
        if json_file is not None:
            json_file.parent.mkdir(parents=True, exist_ok=True)
            json_file.write_text(records + "\n", encoding="utf-8")
    failed_runs = [label for label, _ in result.failures if not label.startswith(tuple(f"{n}@" for n in names))]
    if failed_runs or not result.references:
        raise typer.Exit(1)


@app.command("reference")
def reference_command(
    case: Annotated[str | None, typer.Argument(help="table1 .. table17, a case file, or file.toml:name")] = None,
    method: Annotated[str, typer.Option(help="exact, multiprecision, cvode, ...; all: hold them together")] = "exact",
    form: Annotated[str, typer.Option(help="displacement or velocity-curvature")] = "displacement",
    digits: Annotated[str, typer.Option(help="of multiprecision: a number, or auto")] = "auto",
    rtol: Annotated[float, typer.Option(help="of the adaptive solvers")] = 1e-10,
    t_end: Annotated[float | None, typer.Option(help="end time instead of the case's")] = None,
    budget: Annotated[float, typer.Option(help="seconds for --method all; the rest is named as skipped")] = 60.0,
    out: Annotated[Path | None, typer.Option(help="netCDF file to write")] = None,
    check: Annotated[Path | None, typer.Option(help="verify a frozen file, or a folder with a manifest")] = None,
    remake: Annotated[Path | None, typer.Option(help="compute what is missing of the paper's references here")] = None,
    cache: Annotated[bool, typer.Option("--cache", help="keep the reference and use one that is kept")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="for programs")] = False,
) -> None:
    """Make, compare and check reference solutions."""
    from .validation import InputError

    if sum(x is not None for x in (case, check, remake)) != 1:
        raise InputError("reference", "its arguments", "be one of CASE, --check PATH and --remake DIR")
    with _progress() as progress:
        if check is not None:
            from .studies.references import check as check_files

            records = check_files(check, progress)
            failed = any(r["problem"] for r in records)
        elif remake is not None:
            from .studies.references import remake as remake_files

            records = [{"file": name, "written": True} for name in remake_files(remake, None, progress)]
            failed = False
        else:
            assert case is not None
            records = _references(case, method, form, digits, rtol, t_end, budget, out, cache, progress)
            failed = False
    if as_json:
        print(json.dumps(records, indent=2))
    elif method == "all" and case is not None:
        _print_agreement(records[0])
    else:
        for record in records:
            print("  ".join(f"{key}: {value}" for key, value in record.items() if value not in ("", None)))
        if not records:
            print("nothing to do: every reference is there and whole")
    if failed:
        raise typer.Exit(1)


def _references(name, method, form, digits, rtol, t_end, budget, out, cache, progress) -> list[dict]:
    """One reference, saved, or the agreement of all methods."""
    from .cases import case_text, find_case
    from .reference_cache import cached_reference
    from .semidiscretisation import semidiscretise
    from .solvers import reference
    from .validation import InputError

    case = find_case(name)
    end = case.t_end if t_end is None else t_end
    if method == "all":
        from .studies.agreement import agree

        return [agree(case, form, end, budget=budget, rtol=rtol, progress=progress).to_dict()]
    if digits != "auto" and not digits.isdigit():
        raise InputError("--digits", digits, "be a number or auto")
    progress(f"{method}@{form}", 0, 0)
    system = semidiscretise(case.problem, case.cells, form)
    if cache and out is not None and method == "multiprecision":
        raise InputError("--cache", "with --out", "be left out here", "the file written is itself one to keep")
    solve = cached_reference if cache else reference
    found = solve(system, end, method, rtol=rtol, digits="auto" if digits == "auto" else int(digits))
    record = {
        "reference": found.label,
        "t_end": end,
        "horizon": found.horizon,
        "against": found.provenance["horizon_against"],
        "impacts": found.impacts.count,
        "seconds": round(found.work.seconds, 3),
        "digits": found.provenance.get("digits"),
    }
    if out is not None:
        from .frozen import freeze

        frozen = method == "multiprecision" and found.horizon >= end
        record["file"] = freeze(found, case_text(name), out)["file"] if frozen else str(found.save(out))
    return [record]


def _print_agreement(record: dict) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    names = list(record["differences"])
    table = Table(box=box.SIMPLE_HEAD, title=f"Against {record['judge']}, each to its horizon", title_justify="left")
    table.add_column("reference", no_wrap=True)
    for heading in ("horizon", "tip difference", "impact times", "seconds", "claim"):
        table.add_column(heading, justify="right")
    for name in names:
        impacts = record["impact_differences"][name][record["judge"]]
        table.add_row(
            name,
            f"{record['horizons'][name]:.4g}",
            f"{record['differences'][name][record['judge']]:.1e}",
            "sampled" if impacts is None else f"{impacts:.1e}",
            f"{record['seconds'][name]:.3g}",
            record["refuted"].get(name, "holds"),
        )
    console = Console(width=None if sys.stdout.isatty() else 120)
    console.print(table)
    for name, reason in record["skipped"].items():
        console.print(f"skipped  {name}: {reason}", highlight=False)


def _like_case(run, text: str, case):
    """A bare ``hht`` or ``sdirk`` takes the parameters it has in the case."""
    scheme, form = run
    if "(" not in text and ".printed" not in text:
        for own, own_form in case.runs:
            if own.name == scheme.name and ("@" not in text or own_form == form):
                return own, form if "@" in text else own_form
    return run


def _clear(folder: Path) -> None:
    """Remove what an earlier comparison wrote here, so that old and new never stand side by side."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        earlier = folder / "comparison.json"
        if earlier.is_file():
            for name in json.loads(earlier.read_text(encoding="utf-8")).get("files", []):
                (folder / Path(name).name).unlink(missing_ok=True)
            earlier.unlink()
    except (OSError, ValueError) as error:
        from .validation import InputError

        raise InputError("--out", str(folder), "be a folder that can be written to", str(error)) from None


def _draw(result, folder: Path) -> list[Path]:
    """The picture and the table as files."""
    from rich.console import Console

    from .report import WIDTH, comparison_tables

    written = []
    units = result.case.problem.units
    length = f", in units of {units.length:g} m" if units else ""
    forms = list(dict.fromkeys(r.provenance["form"] for r in result.references))
    for form in forms:
        from .figures import save_figure
        from .figures.comparison import four_panels

        runs, references = ([x for x in xs if x.provenance["form"] == form] for xs in (result.runs, result.references))
        title = f"{result.case.name}: {result.case.title} ({form}, dt = {result.case.dt:g}, {result.case.cells} cells)"
        name = "comparison.png" if form == forms[0] else f"comparison-{form}.png"
        written.append(save_figure(four_panels(title, runs, references, length), folder / name))
    table = folder / "comparison.txt"
    table.parent.mkdir(parents=True, exist_ok=True)
    with table.open("w", encoding="utf-8") as stream:
        Console(file=stream, width=WIDTH).print(
            comparison_tables(result.comparisons, result.references, result.failures)
        )
    written.append(table)
    return written


def _file_name(label: str) -> str:
    """The label without the characters that shells and file systems dislike."""
    plain = label.replace("(", "-").replace(")", "").replace(", ", "-").replace("@", "-")
    return "".join(c if c.isalnum() or c in "-._=" else "_" for c in plain)


def _print_result(result, written: list[Path]) -> None:
    from rich.console import Console

    from .report import WIDTH, comparison_tables

    console = Console(width=None if sys.stdout.isatty() else WIDTH)
    console.print(f"[bold]{result.case.name}[/]  {result.case.title}")
    console.print(comparison_tables(result.comparisons, result.references, result.failures))
    units = result.case.problem.units
    if units:
        console.print(f"Units: displacements {units.length:g} m, times {units.time:g} s, forces {units.force:.6g} N.")
    console.print("\nWritten: " + ", ".join(str(path) for path in written), soft_wrap=True, highlight=False)


@contextmanager
def _progress():
    """A progress display on stderr, silent when that is not a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("left"),
        TimeRemainingColumn(),
    )  # fmt: skip
    shown = {"console": console, "transient": True, "disable": not console.is_terminal}
    with Progress(*columns, speed_estimate_period=600.0, **shown) as display:
        task = display.add_task("starting", total=None)

        def progress(what: str, done: int, total: int) -> None:
            display.update(task, description=what, completed=done, total=total or None)

        yield progress


cli_studies.register(app, _progress)
cli_reproduce.register(app, _progress)


def main() -> None:
    """Entry point: InputError exits with 2, a failure with 1, both with one clear line."""
    if "OMP_NUM_THREADS" not in os.environ:  # before NumPy is there: on small matrices BLAS threads only wait
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from .trajectory import Diverged, SolverFailure, Unfinished
    from .validation import InputError

    try:
        app()
    except InputError as error:
        print(f"stiffbeam: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except (Diverged, SolverFailure, Unfinished) as error:
        print(f"stiffbeam: {error}", file=sys.stderr)
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        print("stiffbeam: interrupted", file=sys.stderr)
        raise SystemExit(130) from None


if __name__ == "__main__":
    main()
