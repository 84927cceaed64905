"""``stiffbeam compare``: runs, tables, rates and pictures of schemes beside references."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from rich.console import Console
from rich.text import Text

from ..basics.progress import progress
from ..basics.storage import make_folder, write_whole
from ..basics.validation import InputError, positive
from ..references.registry import BUDGET, REFERENCES
from .output import (
    CaseName,
    EndTime,
    Form,
    Json,
    Step,
    asked_case,
    check_json,
    console,
    default_folder,
    file_name,
    json_text,
    say,
    write_json,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..files.cases import Case as CaseFile
    from ..measures.rates import ContactRates
    from ..measures.report import Report
    from ..studies.comparison import CaseComparison
    from ..trajectory.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a comparison."""

    schemes: Annotated[
        str | None,
        Parameter(help="Comma-separated schemes, solvers, functions module:function: 'BDF2,SDIRK.printed,mymodule:f'."),
    ] = None
    references: Annotated[
        str | None,
        Parameter(help="Comma-separated; the first that supports the case is the main one. Default: all that do."),
    ] = None
    form: Form = None
    contact: Annotated[str, Parameter(help="implicit, conserving, or extrapolated as in the paper.")] = "implicit"
    cache: Annotated[bool, Parameter(help="Store references and use stored ones.")] = True
    budget: Annotated[float, Parameter(help="Seconds for each reference; one that needs more ends earlier.")] = BUDGET
    rates: Annotated[bool, Parameter(help="Add rates of impacts, impulse and work at every stop.")] = False


def compare(
    case: CaseName, *, options: Annotated[Options | None, Parameter(name="*")] = None, dt: Step = None,
    t_end: EndTime = None, out: Path | None = None, json: Json = None,
) -> int:  # fmt: skip
    """Run schemes beside SUNDIALS and the exact solution: table, picture, trajectories.

    Example: stiffbeam compare table10 --schemes 'BDF2,HHT(alpha=-0.2)' --json records.json

    Parameters
    ----------
    out
        Folder for picture, trajectories and table; by default stiffbeam-output/CASE.
    """
    from ..measures.report import WIDTH
    from ..studies.comparison import CaseComparison

    chosen, options = asked_case(case, dt, t_end), options or Options()
    positive("--budget", options.budget)
    schemes = _schemes(chosen, options.schemes)
    names = None if options.references is None else [x.strip() for x in options.references.split(",") if x.strip()]
    check_json(json)
    for flag, listed in (("--schemes", schemes), ("--references", names)):
        if listed == []:
            raise InputError(flag, "nothing", "name at least one", "or leave the option out for the default ones")
    folder = out if out is not None else default_folder(chosen.name)
    result = CaseComparison(chosen, options.form, options.contact, options.budget, options.cache)
    terminal, written = console(WIDTH, quiet=str(json) == "-"), list[Path]()
    with progress() as show:
        try:
            told = _follow(result, result.run(schemes, names), terminal, case, folder, written)
        except KeyboardInterrupt:
            if result.comparisons:  # what is printed is written too
                _write(result, folder, written)
            raise
        for line in _report(result).failed()[told:]:
            terminal.print(line)
        rated = _rates(result) if options.rates else []
        for label, each in rated:
            terminal.print(f"\n{label}, rates with 95 % intervals\n{each}", soft_wrap=True)
        # The answer comes first: to load matplotlib and to draw takes as long again.
        show("drawing", 0, 0)
        written += _draw(result, folder)
        written += _rate_table(rated, folder)
        _write(result, folder, written)
    records = result.to_dict() | {"files": [path.name for path in written]}
    if not write_json("compare", records, json):
        say("\n" + "\n".join(f"Picture: {path}" for path in written if path.suffix == ".png"))
        say(f"Written: {len(written)} files in {folder}")
    failed_runs = [label for label, _ in result.failures if label.partition("@")[0] not in REFERENCES]
    return int(bool(failed_runs) or not result.references)


def _schemes(case: CaseFile, schemes: str | None) -> list[Any] | None:
    """The integrators that are asked for, None for those of the case. A bare ``hht`` has the parameters that it has in
    the case."""
    from ..integrators import integrator
    from ..schemes.labels import split_runs

    if schemes is None:
        return None
    own = {scheme.name: scheme for scheme, _ in reversed(case.runs)}
    asked = [(text, integrator(text)) for text in split_runs(schemes)]
    bare = [x.kind == "scheme" and "(" not in text and ".printed" not in text for text, x in asked]
    return [own.get(x.source.name, x) if plain else x for (_, x), plain in zip(asked, bare, strict=True)]


def _follow(
    result: CaseComparison, solutions: Iterator[Trajectory], terminal: Console, case: str, folder: Path,
    written: list[Path],
) -> int:  # fmt: skip
    """Print and save each run and reference as soon as it is there: an interrupt loses only the one that is running.

    The tables are printed when all schemes are compared. Returns the number of failures that they have.
    """
    from ..measures.report import largest, short

    mains, told = list[str](), 0
    for solution in solutions:
        if not written:
            make_folder(folder)
            name, title = result.case.name, result.case.title
            terminal.print(Text.assemble((name, "bold"), "" if title == name else f"  {title}"))
        if result.references and not mains:
            mains, told = [one.label for one in result.references], len(result.failures)
            _print_result(terminal, result, case)
        written.append(solution.save(folder / f"{file_name(solution.label)}.nc"))
        if not mains and solution.work.steps:
            name = short(solution.label.partition("@")[0])
            terminal.print(f"{name}: {largest(solution)} ({solution.work.seconds:.2g} s)", soft_wrap=True)
        elif mains and solution.label not in mains:
            _print_line(terminal, result, solution)
    if not mains:
        told = len(result.failures)
        _print_result(terminal, result, case)
    return told


def _write(result: CaseComparison, folder: Path, written: list[Path]) -> None:
    """Tables and records as files, after those that are ``written``."""
    from ..measures.report import WIDTH

    text = StringIO()
    Console(file=text, width=WIDTH, markup=False, emoji=False).print(_report(result).rich())
    written.append(write_whole(folder / "comparison.txt", text.getvalue()))
    records = result.to_dict() | {"files": [path.name for path in written]}
    written.append(write_whole(folder / "comparison.json", json_text("compare", records) + "\n"))


def _rates(result: CaseComparison) -> list[tuple[str, ContactRates]]:
    """Label and rates of the main reference and of every scheme."""
    from ..measures.rates import contact_rates

    solutions = [*result.references[:1], *result.runs] if result.case.has_stops else []
    return [(one.label, contact_rates(one)) for one in solutions]


def _rate_table(rated: list[tuple[str, ContactRates]], folder: Path) -> list[Path]:
    """A table with a line for each run and stop."""
    import pandas

    if not rated:
        return []
    rates = [each.to_dataframe().reset_index().assign(run=label) for label, each in rated]
    table = pandas.concat(rates).set_index(["run", "contact"])
    return [write_whole(folder / "comparison-rates.csv", table.to_csv())]


def _draw(result: CaseComparison, folder: Path) -> list[Path]:
    """The picture."""
    from ..figures.chart import save_figure
    from ..figures.runs import comparison_panels
    from ..measures.report import verdict

    if not result.references:
        return []
    labels = {run.label for run in result.runs}
    own = [c for c in result.comparisons if c.label in labels]
    form, case = result.references[0].provenance["form"], result.case
    details = ", ".join(filter(None, [form, f"dt = {case.dt:g}", case.grid]))
    named = list(dict.fromkeys([case.name, case.title]))
    heads = [named[0], *([verdict(own)] if own else [])]
    title = "\n".join([": ".join(heads), ", ".join([*named[1:], details])])
    figure = comparison_panels(title.replace("$", r"\$"), result.runs, result.references, result.comparisons)
    return [save_figure(figure, folder / "comparison.png")]


def _report(result: CaseComparison) -> Report:
    from ..measures.report import report

    return report(result.comparisons, result.references, result.failures, result.refused)


def _print_result(terminal: Console, result: CaseComparison, case: str) -> None:
    """Print the tables of the schemes and the main reference."""
    terminal.print()
    terminal.print(_report(result).rich())
    if any(c.steps and c.window < c.t_end * (1 - 1e-9) for c in result.comparisons):
        command = f"stiffbeam ensemble {shlex.quote(case)}"
        terminal.print(f"\nStatistics past the horizon, over many runs: {command}", soft_wrap=True)


def _print_line(terminal: Console, result: CaseComparison, solution: Trajectory) -> None:
    """Print how far a further reference agrees with the main one."""
    from ..measures.report import percent, short, verdict

    line = "not compared"
    for found in (c for c in result.comparisons if c.label == solution.label):
        line = verdict([found])
        if found.matched_until >= found.window and found.contacts:
            line = f"all impacts right as far as it is known, to t = {found.window:.3g}, tip error "
            line += f"{percent(found.tip_error_matched)} rms"
    work = "; ".join([f"{solution.work.seconds:.2g} s", *filter(None, [solution.provenance.get("budget")])])
    terminal.print(f"{short(solution.provenance['method'])}: {line} ({work})", soft_wrap=True)
