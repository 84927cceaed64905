"""Commands that run schemes beside references: ``stiffbeam compare``, the main one, and ``animate``, their film;
``advise``, the scheme and time step for a given error; ``doubt``, how sure results are."""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..basics.resources import TALK, progress
from ..basics.storage import write_whole
from ..basics.validation import InputError, positive
from ..references.registry import BUDGET, COMPARED, REFERENCES
from .application import (
    Case,
    Dt,
    Form,
    Json,
    TEnd,
    app,
    check_json,
    console,
    default_folder,
    file_name,
    json_text,
    make_folder,
    option,
    say,
    write_json,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import RenderableType

    from ..files.cases import Case as CaseFile
    from ..measures.rates import ContactRates
    from ..schemes import Scheme
    from ..studies.comparison import CaseComparison
    from ..testset.integrators import Integrator
    from ..trajectory.trajectory import Reference, Trajectory


SCHEMES = (
    "comma-separated schemes, solvers and functions module:function, e.g. "
    "'BDF2,HHT(alpha=-0.2)@displacement,SDIRK.printed,mymodule:radau'"
)
MAIN = (
    "comma-separated; the first that supports the case is the main one; default: "
    f"those of {','.join(COMPARED)} that support it"
)


@app.command()
def compare(
    case: Case,
    schemes: Annotated[str | None, option(SCHEMES, "integrators")] = None,
    references: Annotated[str | None, option(MAIN, "methods")] = None,
    contact: Annotated[str, option("implicit, conserving, or extrapolated as in the paper", "contact")] = ("implicit"),
    dt: Dt = None,
    t_end: TEnd = None,
    out: Annotated[
        Path | None, option("folder for picture, trajectories and table; default: stiffbeam-output/CASE")
    ] = None,
    json_file: Json = None,
    cache: Annotated[bool, option("store references and use stored ones, or compute all anew")] = True,
    budget: Annotated[float, option("seconds for each reference; one that needs more ends earlier")] = BUDGET,
    rates: Annotated[
        bool,
        typer.Option("--rates", help="add rates of impacts, impulse and work at every stop, and all impacts as CSV"),
    ] = False,
) -> None:
    """Run schemes beside SUNDIALS and the exact solution: table, picture, trajectories."""
    from ..files.cases import compared_runs, find_case
    from ..schemes.labels import split_runs
    from ..studies.comparison import compare_case
    from ..testset.integrators import parse_integrator

    chosen = find_case(case)
    for name, value in (("--dt", dt), ("--t-end", t_end), ("--budget", budget)):
        if value is not None:
            positive(name, value)
    if schemes is None:
        runs = compared_runs(chosen)
    else:
        runs = [_like_case(parse_integrator(text, chosen.forms[0]), text, chosen) for text in split_runs(schemes)]
    names = None if references is None else [name.strip() for name in references.split(",") if name.strip()]
    check_json(json_file)
    for flag, present in (("--schemes", schemes is None or runs), ("--references", names is None or names)):
        if not present:
            raise InputError(flag, "nothing", "name at least one", "or leave the option out for the default ones")
    folder = out if out is not None else default_folder(chosen.name)
    written: list[Path] = []
    earlier: list[str] = []

    def keep(run: Trajectory) -> None:
        if not written:
            earlier.extend(_clear(folder))
        written.append(run.save(folder / f"{file_name(run.label)}.nc"))

    with progress() as show:
        # Each trajectory is saved as soon as it is there: an interrupt loses only the one that is running.
        result = compare_case(chosen, runs, names, contact, dt, t_end, show, keep, cache, budget, _truth)
        measured = _rates(result) if rates else []
    # The answer comes first: to load matplotlib and to draw takes as long again.
    if str(json_file) != "-":
        _print_result(result, measured, case)
    with progress() as show:
        show("drawing", 0, 0)
        written += _draw(result, folder)
        written += _rate_tables(measured, folder)
        records = result.to_dict() | {"files": [path.name for path in written]}
        written.append(write_whole(folder / "comparison.json", json_text("compare", records) + "\n"))
    if not write_json("compare", records, json_file):
        _print_files(written, earlier)
    failed_runs = [label for label, _ in result.failures if label.partition("@")[0] not in REFERENCES]
    if failed_runs or not result.references:
        raise typer.Exit(1)


def _rates(result: CaseComparison) -> list[tuple[str, ContactRates]]:
    """Label and rates of the main reference and of every scheme."""
    from ..measures.rates import contact_rates

    solutions = [*result.references[:1], *result.runs] if result.case.has_stops else []
    return [(one.label, contact_rates(one)) for one in solutions]


def _rate_tables(measured: Sequence[tuple[str, ContactRates]], folder: Path) -> list[Path]:
    """A table with a line for each run and stop, and one with a line for each impact."""
    if not measured:
        return []
    import pandas

    rates, impacts = [], []
    for label, each in measured:
        rates.append(each.to_dataframe().reset_index().assign(run=label))
        impacts += [each.impacts_to_dataframe(i).assign(run=label, contact=i) for i in range(len(each.rates))]
    tables = {"comparison-rates.csv": rates, "comparison-impacts.csv": impacts}
    joined = {name: pandas.concat(x).set_index(["run", "contact"]) for name, x in tables.items()}
    return [write_whole(folder / name, table.to_csv()) for name, table in joined.items()]


def _like_case(run: tuple[Integrator, str], text: str, case: CaseFile) -> tuple[Integrator | Scheme, str]:
    """A bare ``hht`` or ``sdirk`` takes the parameters it has in the case."""
    scheme, form = run
    if scheme.kind == "scheme" and "(" not in text and ".printed" not in text:
        for case_scheme, case_form in case.runs:
            if case_scheme.name == scheme.source.name and ("@" not in text or case_form == form):
                return case_scheme, form if "@" in text else case_form
    return run


def _truth(case: CaseFile, form: str, t_end: float) -> Reference | None:
    """The stored solution of a table of the paper, None if its physics or span differs."""
    from ..studies.references import frozen, shipped

    folder = shipped()
    reference = None if folder is None else frozen(folder, case, form, t_end)
    return reference if reference is not None and reference.provenance["t_end"] == t_end else None


def _clear(folder: Path) -> list[str]:
    """Remove the files of an earlier comparison in this folder, so that old and new ones do not mix; return their
    names.

    Only files that a comparison writes: its list may have been made by anyone. One that is cut or no list is
    passed over, and written anew.
    """
    earlier = make_folder(folder) / "comparison.json"
    removed = []
    try:
        if earlier.is_file():
            try:
                names = list(json.loads(earlier.read_text(encoding="utf-8"))["files"])
            except (ValueError, KeyError, TypeError):
                names = []
            for name in names:
                inside = isinstance(name, str) and Path(name).name == name
                if inside and (name.startswith("comparison") or name.endswith(".nc")) and (folder / name).is_file():
                    (folder / name).unlink()
                    removed.append(name)
            earlier.unlink()
    except OSError as error:
        remedy = f"{error.strerror}: name another"
        raise InputError("--out", str(folder), "be a folder that can be written to", remedy) from None
    return removed


def _draw(result: CaseComparison, folder: Path) -> list[Path]:
    """The picture and the table as files."""
    from rich.console import Console

    from ..measures.report import WIDTH

    written = []
    units = result.case.units
    forms = list(dict.fromkeys(r.provenance["form"] for r in result.references))
    for form in forms:
        from ..figures.chart import save_figure
        from ..figures.runs import four_panels, verdict

        runs = [run for run in result.runs if run.provenance["form"] == form]
        references = [one for one in result.references if one.provenance["form"] == form]
        dt = units.measure(f"{result.case.dt:g}", "time")
        details = ", ".join(filter(None, [form, f"dt = {dt}", result.case.grid, units.note]))
        name = "comparison.png" if form == forms[0] else f"comparison-{form}.png"
        comparisons = [c for c in result.comparisons if c.reference == references[0].label] if references else []
        own = [c for c in comparisons if c.label in {run.label for run in runs}]
        named = list(dict.fromkeys([result.case.name, result.case.title]))
        heads = [named[0], *([verdict(own)] if own else [])]
        title = "\n".join([": ".join(heads), ", ".join([*named[1:], details])])
        title = title.replace("$", r"\$")  # no formula of matplotlib's
        written.append(save_figure(four_panels(title, runs, references, comparisons), folder / name))
    text = StringIO()
    Console(file=text, width=WIDTH, markup=False, emoji=False).print(_tables(result, verbose=True))
    written.append(write_whole(folder / "comparison.txt", text.getvalue()))
    return written


def _tables(result: CaseComparison, verbose: bool) -> RenderableType:
    from ..measures.report import comparison_tables

    parts = (result.comparisons, result.references, result.failures, result.truths, result.refused)
    return comparison_tables(*parts, verbose=verbose)


def _print_result(result: CaseComparison, measured: Sequence[tuple[str, ContactRates]], case: str) -> None:
    """Print the tables, and rates that were asked for."""
    from rich.text import Text

    from ..measures.report import WIDTH

    terminal = console(WIDTH)
    title = "" if result.case.title == result.case.name else f"  {result.case.title}"
    terminal.print(Text.assemble((result.case.name, "bold"), title))
    terminal.print(_tables(result, TALK.verbose))
    if any(c.steps and c.window < c.t_end * (1 - 1e-9) for c in result.comparisons):
        say(f"\nStatistics past the horizon, over many runs: stiffbeam ensemble {shlex.quote(case)}")
    for label, each in measured:
        say(f"\n{label}, rates with 95 % intervals\n{each}")
    sys.stdout.flush()


def _print_files(written: list[Path], earlier: list[str]) -> None:
    """Print the names of the pictures, and how many files were written and removed."""
    replaced = f", in place of {len(earlier)} of an earlier comparison" if earlier else ""
    files = f"{len(written)} files in {written[-1].parent}" if written else "nothing"
    say("\n" + "\n".join(f"Picture: {path}" for path in written if path.suffix == ".png"))
    say(f"Written: {files}{replaced}")


@app.command()
def animate(
    case: Case,
    schemes: Annotated[str | None, option("comma-separated; default: the case's first run", "schemes")] = None,
    dt: Dt = None,
    t_end: TEnd = None,
    seconds: Annotated[float, option("length of the film")] = 8.0,
    out: Annotated[Path | None, option(".gif or .mp4; default: stiffbeam-output/CASE/animation.gif")] = None,
    json_file: Json = None,
) -> None:
    """Film of the beam between its stops: schemes beside the exact motion, with a flash at each impact."""
    from ..figures.animation import animate as film
    from ..files.cases import find_case
    from ..march.integrate import integrate
    from ..references import best_reference
    from ..schemes.labels import parse_run, split_runs

    check_json(json_file)
    chosen = find_case(case)
    form = chosen.forms[0]
    runs = [chosen.runs[0]] if schemes is None else [parse_run(text, form) for text in split_runs(schemes)]
    if len({form for _, form in runs}) != 1:
        remedy = "name the form behind each scheme, as in hht@displacement"
        raise InputError("--schemes", schemes, "be of one form: the film shows one system", remedy)
    system, end = chosen.system(runs[0][1]), chosen.t_end if t_end is None else t_end
    file = out if out is not None else default_folder(chosen.name) / "animation.gif"
    with progress() as show:
        show("reference", 0, 0)
        motions: list[Trajectory] = [best_reference(system, end, progress=show)]
        for scheme, _ in runs:
            show(str(scheme), 0, 0)
            motions.append(integrate(system, scheme, chosen.dt if dt is None else dt, end))
        film(motions, file, seconds, show=show)
    records = {"case": chosen.name, "motions": [motion.label for motion in motions], "t_end": end, "file": str(file)}
    if not write_json("animate", records, json_file):
        say(f"Written: {file}")


@app.command()
def advise(
    case: Case,
    want: Annotated[
        str | None,
        option(
            "admissible relative errors: tip (rms), impacts, peak_force, impulse, normal_work, force_rms; "
            "default: tip=1e-3,impacts=0.05,peak_force=0.05"
        ),
    ] = None,
    schemes: Annotated[str | None, option("comma-separated; default: all", "schemes")] = None,
    form: Form = None,
    t_end: TEnd = None,
    most_steps: Annotated[int | None, option("largest number of steps of a run; the search ends there")] = None,
    members: Annotated[int, option("perturbed runs per mean, past the horizon")] = 48,
    out: Annotated[Path | None, option("folder for the journal; default: stiffbeam-output/CASE")] = None,
    json_file: Json = None,
) -> None:
    """Find the cheapest scheme, contact treatment and time step for given errors, and the errors that no step reaches.

    After every refinement a line on stderr states the smallest errors so far. An interrupted search continues when the
    command runs again.
    """
    from ..files.cases import find_case
    from ..schemes.labels import parse_run, split_runs
    from ..studies.advice import advise as find
    from ..studies.runner import Journal

    chosen = find_case(case)
    wanted = None if want is None else _read("--want", want, float, "quantity=error", "tip=1e-3")
    parsed = None if schemes is None else [parse_run(text)[0] for text in split_runs(schemes)]
    check_json(json_file)
    end = chosen.t_end if t_end is None else t_end
    folder = make_folder(out if out is not None else default_folder(chosen.name))

    def tell(line: str) -> None:
        if not TALK.quiet:
            print(line, file=sys.stderr, flush=True)

    with progress() as show, Journal(folder / "journal", "advise", chosen) as journal:
        advice = find(
            chosen.system(form), wanted, end, parsed, most_steps=most_steps, members=members, progress=show, tell=tell,
            journal=journal,
        )  # fmt: skip
    if not write_json("advise", {"case": chosen.name} | advice.to_dict(), json_file):
        say(str(advice))
    if advice.recommendation is None:
        raise typer.Exit(1)


@app.command()
def doubt(
    case: Case,
    uncertain: Annotated[str | None, option("path=low:high,...; default: the ranges of the case file")] = None,
    scheme: Annotated[str | None, option("scheme to examine; default: the case's first", "schemes")] = None,
    dt: Dt = None,
    t_end: TEnd = None,
    members: Annotated[int, option("number of systems with random parameters, at least 8")] = 48,
    seed: Annotated[int, option("seed of the random systems")] = 1,
    tolerance: Annotated[float, option("tolerance of the data horizon, relative to the largest |u|")] = 0.05,
    json_file: Json = None,
) -> None:
    """Uncertainty of every quantity by source: rounding, scheme, mesh, data and time span.

    The ranges of the data are those of the case file, in its table case.uncertain. For matrices the table
    case.finer holds a finer model. The result names the largest source of each quantity.
    """
    from ..files.cases import find_case
    from ..schemes.labels import parse_run
    from ..studies.doubt import doubt as find

    chosen = find_case(case)
    if uncertain is not None:
        chosen = replace(
            chosen, uncertain=_read("--uncertain", uncertain, _range, "path=low:high", "stiffness=270:330")
        )
    check_json(json_file)
    parsed = None if scheme is None else parse_run(scheme)[0]
    with progress() as show:
        result = find(chosen, parsed, dt, members, seed, tolerance, show, t_end=t_end)
    if not write_json("doubt", {"case": chosen.name} | result.to_dict(), json_file):
        say(str(result))


def _range(text: str) -> tuple[float, float]:
    """Two numbers of "low:high". Raises ValueError."""
    low, high = map(float, text.split(":"))
    return low, high


def _read(flag: str, text: str, value_of: Callable[[str], Any], form: str, example: str) -> dict[str, Any]:
    """The values of "name=value,..." by name; ``value_of`` raises ValueError."""
    read: dict[str, Any] = {}
    for item in filter(None, text.split(",")):
        name, _, value = (part.strip() for part in item.rpartition("="))
        if name in read:
            raise InputError(flag, text, f"name {name} once", "leave one of its values out")
        try:
            read[name] = value_of(value)
        except ValueError:
            raise InputError(flag, item, f"read {form}", f"for example {example}") from None
    return read
