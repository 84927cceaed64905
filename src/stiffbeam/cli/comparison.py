"""``stiffbeam compare``: runs, tables, rates and pictures of schemes beside references."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

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
    default_folder,
    file_name,
    json_text,
    say,
    write_json,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..studies.comparison import CaseComparison


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
    from ..schemes.labels import split_runs
    from ..studies.comparison import CaseComparison

    chosen, options = asked_case(case, dt, t_end), options or Options()
    positive("--budget", options.budget)
    schemes = None if options.schemes is None else split_runs(options.schemes)
    names = None if options.references is None else [x.strip() for x in options.references.split(",") if x.strip()]
    check_json(json)
    for flag, listed in (("--schemes", schemes), ("--references", names)):
        if listed == []:
            raise InputError(flag, "nothing", "name at least one", "or leave the option out for the default ones")
    folder = out if out is not None else default_folder(chosen.name)
    result = CaseComparison(chosen, options.form, options.contact, options.budget, options.cache)
    tell, written = (say if str(json) != "-" else str), list[Path]()
    with progress() as show:
        try:
            _follow(result, schemes, names, tell, case, folder, written)
            if options.rates and chosen.has_stops and result.comparisons:
                written.append(_rates(result, tell, folder))
            # The answer comes first: to load matplotlib and to draw takes as long again.
            show("drawing", 0, 0)
            if result.comparisons:
                written.append(_draw(result, folder))
        finally:  # an interrupt loses only what is running
            if written:
                written.append(write_whole(folder / "comparison.txt", f"{result.report()}\n"))
                records = result.to_dict() | {"files": [path.name for path in written]}
                written.append(write_whole(folder / "comparison.json", json_text("compare", records) + "\n"))
    records = result.to_dict() | {"files": [path.name for path in written]}
    if not write_json("compare", records, json):
        say("\n" + "\n".join(f"Picture: {path}" for path in written if path.suffix == ".png"))
        say(f"Written: {len(written)} files in {folder}")
    failed_runs = [label for _, label, _ in result.failures if label.partition("@")[0] not in REFERENCES]
    return int(bool(failed_runs) or not result.references)


def _follow(
    result: CaseComparison, schemes: list[str] | None, names: list[str] | None, tell: Callable[[str], object],
    case: str, folder: Path, written: list[Path],
) -> None:  # fmt: skip
    """Print a line of each solution and save it as soon as it is there; the tables follow the main reference."""
    from ..measures.report import largest, percent, short, verdict

    told = 0  # failures
    for solution in result.run(schemes, names):
        if not written:
            make_folder(folder)
            name, title = result.case.name, result.case.title
            tell(name if title == name else f"{name}  {title}")
        written.append(solution.save(folder / f"{file_name(solution.label)}.nc"))
        said = largest(solution)
        for c in result.comparisons if solution in result.references[1:] else ():
            if c.label == solution.label:
                right = c.contacts and c.matched_until >= c.window
                said = f"all impacts right as far as it is known, to t = {c.window:.3g}, tip error " if right else ""
                said += f"{percent(c.tip_error_matched)} rms" if right else verdict([c])
        work = "; ".join([f"{solution.work.seconds:.2g} s", *filter(None, [solution.provenance.get("budget")])])
        tell(f"{short(solution.provenance['method'])}: {said} ({work})")
        if len(result.references) == 1 and solution is result.references[0]:
            told = len(result.failures)
            tell(f"\n{result.report()}")
            if any(c.steps and c.window < c.t_end * (1 - 1e-9) for c in result.comparisons):
                command = f"stiffbeam ensemble {shlex.quote(case)}"
                tell(f"\nStatistics past the horizon, over many runs: {command}")
    for kind, label, message in result.failures[told:]:
        tell(f"{kind}  {short(label)}  {message}")


def _rates(result: CaseComparison, tell: Callable[[str], object], folder: Path) -> Path:
    """Rates of the main reference and of every scheme; the file has a line for each run and stop."""
    import pandas

    from ..measures.rates import contact_rates

    tables = []
    for one in (*result.references[:1], *result.runs):
        rates = contact_rates(one)
        tell(f"\n{one.label}, rates with 95 % intervals\n{rates}")
        tables.append(rates.to_dataframe().reset_index().assign(run=one.label))
    table = pandas.concat(tables).set_index(["run", "contact"])
    return write_whole(folder / "comparison-rates.csv", table.to_csv())


def _draw(result: CaseComparison, folder: Path) -> Path:
    """The picture."""
    from ..figures.chart import heading, save_figure
    from ..figures.runs import comparison_figure
    from ..measures.report import verdict

    case, labels = result.case, {run.label for run in result.runs}
    own = [c for c in result.comparisons if c.label in labels]
    details = f"{result.references[0].provenance['form']}, dt = {case.dt:g}, {case.grid}"
    title = f"{heading(case, verdict(own) if own else case.title)}\n{details}"
    return save_figure(comparison_figure(result.comparisons, title), folder / "comparison.png")
