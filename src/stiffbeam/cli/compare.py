"""``stiffbeam compare``: the main job."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from .application import app
from .options import Case
from .output import check_json, default_folder, file_name, make_folder, write_json
from .progress import progress


@app.command()
def compare(
    case: Case,
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
    from ..cases import find_case, parse_run, split_runs
    from ..reference_cache import cached_reference
    from ..solvers import reference
    from ..studies.comparison import compare_case
    from ..validation import InputError, positive

    chosen = find_case(case)
    for name, value in (("--dt", dt), ("--t-end", t_end)):
        if value is not None:
            positive(name, value)
    runs = None if schemes is None else [_like_case(parse_run(text), text, chosen) for text in split_runs(schemes)]
    names = [name.strip() for name in references.split(",") if name.strip()]
    check_json(json_file)
    for option, given in (("--schemes", runs is None or runs), ("--references", names)):
        if not given:
            raise InputError(option, "nothing", "name at least one")
    folder = out if out is not None else default_folder(chosen.name)
    written: list[Path] = []

    def keep(run) -> None:
        if not written:
            _clear(folder)
        written.append(run.save(folder / f"{file_name(run.label)}.nc"))

    with progress() as show:
        # Each trajectory is saved as soon as it is there: an interrupt loses only the one that is running.
        result = compare_case(
            chosen, runs, names, contact, dt, t_end, show, keep, cached_reference if cache else reference
        )
        show("drawing", 0, 0)
        written += _draw(result, folder)
        records = json.dumps(result.to_dict() | {"files": [path.name for path in written]}, indent=2)
        (folder / "comparison.json").write_text(records + "\n", encoding="utf-8")
        written.append(folder / "comparison.json")
    if not write_json(records, json_file):
        _print_result(result, written)
    failed_runs = [label for label, _ in result.failures if not label.startswith(tuple(f"{n}@" for n in names))]
    if failed_runs or not result.references:
        raise typer.Exit(1)


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
    earlier = make_folder(folder) / "comparison.json"
    try:
        if earlier.is_file():
            for name in json.loads(earlier.read_text(encoding="utf-8")).get("files", []):
                (folder / Path(name).name).unlink(missing_ok=True)
            earlier.unlink()
    except (OSError, ValueError) as error:
        from ..validation import InputError

        raise InputError("--out", str(folder), "be a folder that can be written to", str(error)) from None


def _draw(result, folder: Path) -> list[Path]:
    """The picture and the table as files."""
    from rich.console import Console

    from ..report import WIDTH, comparison_tables

    written = []
    units = result.case.problem.units
    length = f", in units of {units.length:g} m" if units else ""
    forms = list(dict.fromkeys(r.provenance["form"] for r in result.references))
    for form in forms:
        from ..figures import save_figure
        from ..figures.comparison import four_panels

        runs, references = ([x for x in xs if x.provenance["form"] == form] for xs in (result.runs, result.references))
        named = ": ".join(dict.fromkeys([result.case.name, result.case.title]))
        title = f"{named} ({form}, dt = {result.case.dt:g}, {result.case.cells} cells)"
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


def _print_result(result, written: list[Path]) -> None:
    from rich.console import Console

    from ..report import WIDTH, comparison_tables

    console = Console(width=None if sys.stdout.isatty() else WIDTH)
    console.print(f"[bold]{result.case.name}[/]  {result.case.title}")
    console.print(comparison_tables(result.comparisons, result.references, result.failures))
    units = result.case.problem.units
    if units:
        console.print(f"Units: displacements {units.length:g} m, times {units.time:g} s, forces {units.force:.6g} N.")
    console.print("\nWritten: " + ", ".join(str(path) for path in written), soft_wrap=True, highlight=False)
