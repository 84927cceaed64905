"""The commands of the study registry: one per study, and ``studies`` for all of them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from .application import app
from .lists import labels, names, numbers, values_of
from .options import Case, Jobs, Json, References
from .output import check_json, default_folder, make_folder, write_json
from .progress import progress

Schemes = Annotated[str | None, typer.Option(help="comma-separated, e.g. 'bdf2,hht(alpha=-0.2)'; default: all")]
Form = Annotated[str, typer.Option(help="displacement or velocity-curvature")]
Forms = Annotated[str | None, typer.Option(help="comma-separated; default: all the case can take")]
Dt = Annotated[float | None, typer.Option(help="time step to start from, instead of the case's")]
End = Annotated[float | None, typer.Option(help="end time instead of the case's")]
Halvings = Annotated[int | None, typer.Option(help="how many steps dt, dt/2, dt/4, ...")]
Impacts = Annotated[int | None, typer.Option(help="the window ends when so many impacts are over")]
Contact = Annotated[str, typer.Option(help="implicit, or extrapolated as in the paper")]
Out = Annotated[Path | None, typer.Option(help="folder for records, picture and journal")]
Smoke = Annotated[bool, typer.Option("--smoke", help="the small configuration: seconds instead of minutes")]
Scheduler = Annotated[str | None, typer.Option(help="of Dask, e.g. tcp://host:8786: its workers instead of processes")]


command = app.command(rich_help_panel="Studies")


def run(
    name: str, case: str, out: Path | None, json_file: Path | None, jobs: int | None, smoke: bool,
    scheduler: str | None = None, stem: str = "", **options: Any,
) -> None:  # fmt: skip
    """Ask the study ``name`` of a case; print and save what it finds, as ``stem`` if one is given."""
    from ..cases import find_case
    from ..studies import find_study

    check_json(json_file)
    chosen, study = find_case(case), find_study(name)
    given = {key: value for key, value in options.items() if value is not None}
    with progress() as show, _workers(scheduler) as workers:
        options = (dict(study.smoke) if smoke else {}) | given
        records, written = _run(study, chosen, out, jobs, options, show, workers, stem)
    if not write_json(json.dumps(records.to_dict(), indent=2, allow_nan=False), json_file):
        _print(records, written)
    if not written:
        raise typer.Exit(1)


@command
def amplification(
    schemes: Schemes = None,
    damping: Annotated[float | None, typer.Option(help="physical damping ratio of the oscillator")] = None,
    out: Out = None, json_file: Json = None, jobs: Jobs = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """One step on a free oscillation: radius, period elongation, damping."""
    run("amplification", "table10", out, json_file, jobs, smoke, schemes=labels(schemes), damping=damping)


@command
def modes(
    case: Case = "table10", schemes: Schemes = None, form: Form = "displacement", dt: Dt = None,
    steps: Annotated[int | None, typer.Option(help="length of the runs")] = None,
    out: Out = None, json_file: Json = None, jobs: Jobs = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """Phase lag and damping mode by mode on runs without contact, against theory."""
    run("modes", case, out, json_file, jobs, smoke, schemes=labels(schemes), form=form, dt=dt, steps=steps)


@command
def energy(
    case: Case = "table10", schemes: Schemes = None, forms: Forms = None, dt: Dt = None, t_end: End = None,
    contact: Contact = "implicit",
    out: Out = None, json_file: Json = None, jobs: Jobs = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """The energy ledger of every scheme and of the exact flow, in every form."""
    run("energy", case, out, json_file, jobs, smoke, schemes=labels(schemes), forms=names(forms), dt=dt,
        t_end=t_end, contact=contact)  # fmt: skip


@command
def converge(
    case: Case = "table10", schemes: Schemes = None,
    kinds: Annotated[str | None, typer.Option(help="smooth, contact, or both")] = None,
    form: Form = "displacement", dt: Dt = None, halvings: Halvings = None, impacts: Impacts = None,
    contact: Contact = "implicit",
    out: Out = None, json_file: Json = None, jobs: Jobs = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """Observed orders in time, smooth and through contact."""
    run("converge", case, out, json_file, jobs, smoke, schemes=labels(schemes), kinds=names(kinds), form=form,
        dt=dt, halvings=halvings, impacts=impacts, contact=contact)  # fmt: skip


@command
def space(
    case: Case = "table10",
    cells: Annotated[str | None, typer.Option(help="grids, comma-separated")] = None,
    forms: Forms = None,
    finest: Annotated[int | None, typer.Option(help="the grid that contact is compared with")] = None,
    impacts: Impacts = None,
    out: Out = None, json_file: Json = None, jobs: Jobs = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """Convergence of both discretisations to the beam, and of the contact."""
    run("space", case, out, json_file, jobs, smoke, cells=numbers(cells, int), forms=names(forms),
        finest=finest, impacts=impacts)  # fmt: skip


@command
def rigid(
    case: Case = "table10", form: Form = "displacement",
    factors: Annotated[str | None, typer.Option(help="of the stops' stiffness, comma-separated")] = None,
    impacts: Impacts = None,
    out: Out = None, json_file: Json = None, jobs: Jobs = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """Towards rigid stops: kappa to infinity."""
    run("rigid", case, out, json_file, jobs, smoke, form=form, factors=numbers(factors, float), impacts=impacts)


@command
def errata(
    case: Case = "table10", schemes: Schemes = None, form: Form = "displacement", dt: Dt = None,
    halvings: Halvings = None, impacts: Impacts = None,
    out: Out = None, json_file: Json = None, jobs: Jobs = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """What each misprint of the paper costs."""
    run("errata", case, out, json_file, jobs, smoke, schemes=labels(schemes), form=form, dt=dt,
        halvings=halvings, impacts=impacts)  # fmt: skip


@command
def impacts(
    case: Case = "table10", schemes: Schemes = None, form: Form = "displacement", dt: Dt = None,
    halvings: Halvings = None, t_end: End = None,
    members: Annotated[int | None, typer.Option(help="perturbed runs behind each mean")] = None,
    sensitivity: Annotated[bool, typer.Option(help="also over alpha, gamma and the contact treatment")] = True,
    references: References = None,
    out: Out = None, json_file: Json = None, jobs: Jobs = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """Impact counts against the step, with the true count."""
    run("impacts", case, out, json_file, jobs, smoke, schemes=labels(schemes), form=form, dt=dt, halvings=halvings,
        t_end=t_end, members=members, sensitivity=sensitivity and not smoke,
        references=_references(references))  # fmt: skip


@command
def precision(
    case: Case = "table10", schemes: Schemes = None,
    methods: Annotated[str | None, typer.Option(help="reference solvers, comma-separated")] = None,
    form: Form = "displacement", dt: Dt = None, halvings: Halvings = None,
    tolerances: Annotated[str | None, typer.Option(help="rtol of the solvers, comma-separated")] = None,
    impacts: Impacts = None,
    out: Out = None, json_file: Json = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """Work and precision: error against seconds and against work."""
    run("precision", case, out, json_file, 1, smoke, schemes=labels(schemes), methods=names(methods), form=form,
        dt=dt, halvings=halvings, tolerances=numbers(tolerances, float), impacts=impacts)  # fmt: skip


@command
def ensemble(
    case: Case = "table10", schemes: Schemes = None, form: Form = "displacement", dt: Dt = None, t_end: End = None,
    members: Annotated[int | None, typer.Option(help="perturbed runs of each method")] = None,
    size: Annotated[float | None, typer.Option(help="of the perturbation, relative to the motion")] = None,
    contact: Contact = "implicit",
    out: Out = None, json_file: Json = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """Past the horizon: distributions over perturbed runs."""
    run("ensemble", case, out, json_file, 1, smoke, schemes=labels(schemes), form=form, dt=dt, t_end=t_end,
        members=members, size=size, contact=contact)  # fmt: skip


@command
def chaos(
    case: Case = "table10", schemes: Schemes = None, form: Form = "displacement", dt: Dt = None,
    starts: Annotated[int | None, typer.Option(help="pairs of neighbouring motions")] = None,
    out: Out = None, json_file: Json = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """Lyapunov exponents of the exact flow and of the schemes; the delayed portrait."""
    run("chaos", case, out, json_file, 1, smoke, schemes=labels(schemes), form=form, dt=dt, starts=starts)


@command
def sweep(
    case: Case = "table10",
    parameter: Annotated[
        str, typer.Option(help="frequency, amplitude, clearance, stop-stiffness, stiffness, viscosity, dt, alpha")
    ] = "frequency",
    values: Annotated[
        str | None, typer.Option(help="start:stop:count, start:stop:count:log, or comma-separated")
    ] = None,
    second: Annotated[str | None, typer.Option(help="another parameter: impacts and forces on a grid")] = None,
    second_values: Annotated[str | None, typer.Option(help="as --values")] = None,
    method: Annotated[str | None, typer.Option(help="a scheme, or exact; default: the case's first scheme")] = None,
    form: Form = "displacement", contact: Contact = "implicit",
    dt: Annotated[float | None, typer.Option(help="the nearest step that divides the period is taken")] = None,
    periods: Annotated[int | None, typer.Option(help="of the drive, that are looked at")] = None,
    transient: Annotated[int | None, typer.Option(help="periods of the drive before them")] = None,
    out: Out = None, json_file: Json = None, jobs: Jobs = None, scheduler: Scheduler = None, smoke: Smoke = False,
) -> None:  # fmt: skip
    """Bifurcation diagrams, impacts and forces over one or two parameters; goes on after a kill."""
    stem = "-".join(["sweep", parameter, *([second] if second else [])])
    run("sweep", case, out, json_file, jobs, smoke, scheduler, stem, parameter=parameter, values=values_of(values),
        second=second, second_values=values_of(second_values), method=method, form=form, contact=contact, dt=dt,
        periods=periods, transient=transient)  # fmt: skip


@command
def studies(
    case: Case = "table10", out: Out = None, references: References = None, jobs: Jobs = None, smoke: Smoke = False
) -> None:
    """Every study on one case; a second run goes on where the first was stopped."""
    from ..cases import find_case
    from ..studies import STUDIES, find_study
    from ..validation import InputError

    chosen = find_case(case)
    frozen, empty = _references(references), False
    for name in STUDIES:
        study = find_study(name)
        options = dict(study.smoke) if smoke else {}
        if name == "impacts" and frozen is not None:
            options["references"] = frozen
        try:
            with progress() as show:
                records, written = _run(study, chosen, out, jobs, options, show)
        except InputError as error:  # a study that this case cannot be asked
            print(f"{name}: {error}", file=sys.stderr)
            empty = True
            continue
        _print(records, written)
        empty = empty or not written
    if empty:
        raise typer.Exit(1)


def _run(
    study, case, out: Path | None, jobs: int | None, options: dict, show, workers=None, stem: str = ""
) -> tuple[Any, list[Path]]:
    """The records, and the files they were written to: none where no point could be evaluated."""
    from ..march.ensemble import cores
    from ..studies.runner import run_study

    folder = make_folder(out if out is not None else default_folder(case.name))
    records = run_study(study, case, folder / "journal", cores() if jobs is None else jobs, workers, show, **options)
    if len(records.failures) == len(records.rows):
        return records, []  # what an earlier run has found stays
    show("drawing", 0, 0)
    return records, records.save(folder, stem)


def _workers(address: str | None):
    """The executor behind --scheduler, None without one."""
    from contextlib import nullcontext

    if address is None:
        return nullcontext()
    from ..studies.scheduler import scheduler

    return scheduler(address)


def _print(records, written: list[Path]) -> None:
    from rich.console import Console
    from rich.padding import Padding

    console = Console(highlight=False)
    console.print(f"[bold]{records.study.name}[/]  {records.study.question}")
    for i, part in enumerate(records.answer.split("; ")):
        console.print(Padding(part, (0, 0, 0, 2 if i else 0)))
    for message in dict.fromkeys(row["failed"] for row in records.failures):
        console.print(f"[bold red]failed[/]  {message}")
    files = ", ".join(str(path) for path in written) or "nothing"
    console.print(f"{records.seconds:.1f} s. Written: {files}\n", soft_wrap=True)


def _references(folder: Path | None) -> str | None:
    """The folder of frozen references: the one named, else ./reference where that holds some."""
    if folder is not None:
        return str(folder)
    return "reference" if Path("reference/MANIFEST.json").is_file() else None
