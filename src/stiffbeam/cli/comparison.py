"""``stiffbeam compare``: runs, tables, rates and pictures of schemes beside references."""

from __future__ import annotations

import shlex
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from ..basics.progress import progress
from ..basics.storage import make_folder, write_whole
from ..basics.validation import InputError, positive
from ..references.registry import BUDGET, REFERENCES
from .output import (
    CaseName,
    EndTime,
    Json,
    Step,
    check_json,
    console,
    default_folder,
    file_name,
    json_text,
    say,
    write_json,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..files.cases import Case as CaseFile
    from ..integrators import Integrator
    from ..measures.rates import ContactRates
    from ..measures.report import Report
    from ..schemes import Scheme
    from ..studies.comparison import CaseComparison
    from ..trajectory.trajectory import Trajectory


def compare(
    case: CaseName,
    *,
    schemes: str | None = None,
    references: str | None = None,
    contact: str = "implicit",
    dt: Step = None,
    t_end: EndTime = None,
    out: Path | None = None,
    json: Json = None,
    cache: bool = True,
    budget: float = BUDGET,
    rates: bool = False,
) -> int:
    """Run schemes beside SUNDIALS and the exact solution: table, picture, trajectories.

    Example: stiffbeam compare table10 --schemes 'BDF2,HHT(alpha=-0.2)' --json records.json

    Parameters
    ----------
    schemes
        Comma-separated schemes, solvers and functions module:function, such as 'BDF2,SDIRK.printed,mymodule:radau'.
    references
        Comma-separated; the first that supports the case is the main one. By default those that support it.
    contact
        implicit, conserving, or extrapolated as in the paper.
    out
        Folder for picture, trajectories and table; by default stiffbeam-output/CASE.
    cache
        Store references and use stored ones.
    budget
        Seconds for each reference; one that needs more ends earlier.
    rates
        Add rates of impacts, impulse and work at every stop, and all impacts as CSV.
    """
    json_file = json
    from ..files.cases import find_case
    from ..studies.comparison import compare_case

    chosen = find_case(case)
    for name, value in (("--dt", dt), ("--t-end", t_end), ("--budget", budget)):
        if value is not None:
            positive(name, value)
    runs, names = _asked(chosen, schemes, references)
    check_json(json_file)
    if dt is not None or t_end is not None:
        chosen = replace(chosen, dt=dt or chosen.dt, t_end=t_end or chosen.t_end)
    shown = _Shown(case, chosen, out if out is not None else default_folder(chosen.name), str(json_file) == "-")
    with progress() as show:
        try:
            result = compare_case(chosen, runs, names, contact, shown.keep, cache, budget, shown.measured)
        except KeyboardInterrupt:
            if shown.result is not None:  # what is printed is written too
                _write(shown.result, shown.folder, shown.written)
            raise
        # The answer comes first: to load matplotlib and to draw takes as long again.
        rated = shown.rest(result, rates)
        show("drawing", 0, 0)
        shown.written += _draw(result, shown.folder)
        shown.written += _rate_tables(rated, shown.folder)
        _write(result, shown.folder, shown.written)
    records = result.to_dict() | {"files": [path.name for path in shown.written]}
    if not write_json("compare", records, json_file):
        say("\n" + "\n".join(f"Picture: {path}" for path in shown.written if path.suffix == ".png"))
        say(f"Written: {len(shown.written)} files in {shown.folder}")
    failed_runs = [label for label, _ in result.failures if label.partition("@")[0] not in REFERENCES]
    return int(bool(failed_runs) or not result.references)


class _Shown:
    """What is printed and saved of a comparison while it runs.

    result: None until the table is printed. printed: failures that are. written: files.
    """

    def __init__(self, name: str, case: CaseFile, folder: Path, quiet: bool) -> None:
        from ..measures.report import WIDTH

        self.name, self.case, self.folder, self.terminal = name, case, folder, console(WIDTH, quiet=quiet)
        self.result: CaseComparison | None = None
        self.printed, self.written = 0, list[Path]()

    def keep(self, run: Trajectory) -> None:
        """Save a trajectory as soon as it is there: an interrupt loses only the one that is running."""
        from ..measures.report import largest, short

        if not self.written:
            make_folder(self.folder)
            title = "" if self.case.title == self.case.name else f"  {self.case.title}"
            self.terminal.print(Text.assemble((self.case.name, "bold"), title))
        self.written.append(run.save(self.folder / f"{file_name(run.label)}.nc"))
        if self.result is None and run.work.steps:  # of no reference
            name = short(run.label.partition("@")[0])
            self.terminal.print(f"{name}: {largest(run)} ({run.work.seconds:.2g} s)", soft_wrap=True)

    def measured(self, result: CaseComparison, solution: Trajectory | None) -> None:
        """Print the tables of the schemes and the main reference, or how far a further one agrees with the main one."""
        self.result, self.printed = result, len(result.failures) if solution is None else self.printed
        if solution is None:
            _print_result(self.terminal, result, self.name)
        else:
            _print_line(self.terminal, result, solution)

    def rest(self, result: CaseComparison, rates: bool) -> list[tuple[str, ContactRates]]:
        """Print the failures of further references and, where asked for, the rates, which are returned."""
        for line in _report(result).failed()[self.printed :]:
            self.terminal.print(line)
        rated = _rates(result) if rates else []
        for label, each in rated:
            self.terminal.print(f"\n{label}, rates with 95 % intervals\n{each}", soft_wrap=True)
        return rated


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


def _rate_tables(measured: Sequence[tuple[str, ContactRates]], folder: Path) -> list[Path]:
    """A table with a line for each run and stop, and one with a line for each impact."""
    import pandas

    if not measured:  # those of an earlier comparison would be taken for this one's
        for name in ("rates", "impacts"):
            (folder / f"comparison-{name}.csv").unlink(missing_ok=True)
        return []
    rates, impacts = [], []
    for label, each in measured:
        rates.append(each.to_dataframe().reset_index().assign(run=label))
        records = enumerate(each.run.contacts)
        impacts += [one.impacts.to_dataframe().assign(run=label, contact=i) for i, one in records]
    tables = {"comparison-rates.csv": rates, "comparison-impacts.csv": impacts}
    joined = {name: pandas.concat(x).set_index(["run", "contact"]) for name, x in tables.items()}
    return [write_whole(folder / name, table.to_csv()) for name, table in joined.items()]


def _asked(
    case: CaseFile, schemes: str | None, references: str | None
) -> tuple[list[tuple[Any, str]], list[str] | None]:
    """The integrators to run with their forms, by default those of the case, and the names of the references."""
    from ..files.cases import compared_runs
    from ..integrators import parse_integrator
    from ..schemes.labels import split_runs

    if schemes is None:
        runs: list[tuple[Any, str]] = list(compared_runs(case))
    else:
        runs = [_like_case(parse_integrator(text, case.forms[0]), text, case) for text in split_runs(schemes)]
    names = None if references is None else [name.strip() for name in references.split(",") if name.strip()]
    for flag, present in (("--schemes", schemes is None or runs), ("--references", names is None or names)):
        if not present:
            raise InputError(flag, "nothing", "name at least one", "or leave the option out for the default ones")
    return runs, names


def _like_case(run: tuple[Integrator, str], text: str, case: CaseFile) -> tuple[Integrator | Scheme, str]:
    """A bare ``hht`` or ``sdirk`` takes the parameters it has in the case."""
    scheme, form = run
    if scheme.kind == "scheme" and "(" not in text and ".printed" not in text:
        for case_scheme, case_form in case.runs:
            if case_scheme.name == scheme.source.name and ("@" not in text or case_form == form):
                return case_scheme, form if "@" in text else case_form
    return run


def _draw(result: CaseComparison, folder: Path) -> list[Path]:
    """The picture of each form."""
    from ..figures.chart import save_figure
    from ..figures.runs import comparison_panels
    from ..measures.report import verdict

    written = []
    forms = list(dict.fromkeys(r.provenance["form"] for r in result.references))
    for form in forms:
        runs = [run for run in result.runs if run.provenance["form"] == form]
        references = [one for one in result.references if one.provenance["form"] == form]
        details = ", ".join(filter(None, [form, f"dt = {result.case.dt:g}", result.case.grid]))
        name = "comparison.png" if form == forms[0] else f"comparison-{form}.png"
        comparisons = [c for c in result.comparisons if c.reference == references[0].label]
        own = [c for c in comparisons if c.label in {run.label for run in runs}]
        named = list(dict.fromkeys([result.case.name, result.case.title]))
        heads = [named[0], *([verdict(own)] if own else [])]
        title = "\n".join([": ".join(heads), ", ".join([*named[1:], details])])
        title = title.replace("$", r"\$")  # no formula of matplotlib's
        written.append(save_figure(comparison_panels(title, runs, references, comparisons), folder / name))
    return written


def _report(result: CaseComparison) -> Report:
    from ..measures.report import report

    return report(result.comparisons, result.references, result.failures, result.truths, result.refused)


def _print_result(terminal: Console, result: CaseComparison, case: str) -> None:
    """Print the tables of the schemes and the main reference."""
    terminal.print()
    terminal.print(_report(result).rich())
    if any(c.steps and c.window < c.t_end * (1 - 1e-9) for c in result.comparisons):
        command = f"stiffbeam ensemble {shlex.quote(case)}"
        terminal.print(f"\nStatistics past the horizon, over many runs: {command}", soft_wrap=True)


def _print_line(terminal: Console, result: CaseComparison, solution: Trajectory) -> None:
    """Print how far a further reference agrees with the main one."""
    from ..measures.report import short, verdict

    name, seconds = short(solution.provenance["method"]), f"({solution.work.seconds:.2g} s)"
    found = [c for c in result.comparisons if c.label == solution.label]
    line = f"{verdict(found)} {seconds}" if found else f"not compared {seconds}"
    terminal.print(f"{name}: {line}", soft_wrap=True)
