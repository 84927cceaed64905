"""The Typer application: options and output that the commands share, and a command of every study."""

from __future__ import annotations

import inspect
import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from ..basics.resources import TALK, Show, progress
from ..basics.text import cut, plain
from ..basics.validation import InputError, file_path
from .tables import tables_of

if TYPE_CHECKING:
    from concurrent.futures import Executor
    from contextlib import AbstractContextManager

    from rich.console import Console

    from ..files.cases import Case as CaseFile
    from ..studies.interface import Records, Study


# ---------------------------------------------------------------- output: terminal, folders, names, records


def console(width: int | None = None) -> Console:
    """The terminal, silent with --quiet; ``width``: for piped output. Names and messages may contain [/]."""
    from rich.console import Console

    wide = None if sys.stdout.isatty() else width
    return Console(width=wide, quiet=TALK.quiet, highlight=False, markup=False, emoji=False)


def say(text: str) -> None:
    """Print a line unchanged, of any length; nothing with --quiet."""
    if not TALK.quiet:
        print(text)


def default_folder(case: str) -> Path:
    """stiffbeam-output/<case>."""
    return Path("stiffbeam-output") / file_name(case)


def file_name(label: str) -> str:
    """The label without the characters that shells and file systems dislike, never a folder's name for another."""
    plain = label.replace("(", "-").replace(")", "").replace(", ", "-").replace("@", "-")
    return cut("".join(c if c.isalnum() or c in "-._=" else "_" for c in plain).lstrip("."), 100) or "_"


def make_folder(folder: Path, option: str = "--out") -> Path:
    """``folder``, created if necessary; InputError if that is impossible or nothing can be written there."""
    file_path(option, folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError("no permission to write")
    except OSError as error:
        remedy = f"{error.strerror or error}: name another"
        raise InputError(option, str(folder), "be a folder that can be written to", remedy) from None
    return folder


def check_json(file: Path | None) -> None:
    """Raise InputError for a --json that cannot be a file, before anything is computed."""
    if file is None or str(file) == "-":
        return
    file_path("--json", file)
    if file.is_dir():
        raise InputError("--json", str(file), "be a file, or - for the terminal", "name a file in that folder")
    make_folder(file.parent, "--json")
    if not os.access(file if file.exists() else file.parent, os.W_OK):
        raise InputError("--json", str(file), "be a file that can be written to", "name another, or - for the terminal")


def json_text(command: str, records: Mapping[str, Any]) -> str:
    """The records of a command as JSON, which has no NaN: its name and the version of the package come first."""
    head = {"stiffbeam": version("stiffbeam"), "command": command}
    return json.dumps(plain(head | dict(records)), indent=2, ensure_ascii=False, allow_nan=False)


def write_json(command: str, records: Mapping[str, Any], file: Path | None) -> bool:
    """Write the records to the file of --json. Returns True if that is the standard output, which then has nothing
    else."""
    if file is None:
        return False
    text = json_text(command, records)
    if str(file) == "-":
        print(text)
        return True
    from ..basics.storage import write_whole

    write_whole(file, text + "\n")
    return False


# ---------------------------------------------------------------- options


def labels(text: str | None) -> list[str] | None:
    """Words or runs with commas between them; those inside parentheses belong to a run."""
    from ..schemes.labels import split_runs

    return None if text is None else [part.strip() for part in split_runs(text)]


def numbers(text: str | None, kind: Callable[[str], Any]) -> list[Any] | None:
    """Numbers with commas between them."""
    try:
        return None if text is None else [kind(part) for part in text.split(",")]
    except ValueError:
        raise InputError("list", text, "be numbers with commas between them", "for example 0.1,0.2") from None


def values_of(text: str | None) -> list[float] | None:
    """``start:stop:count``, evenly spaced, ``start:stop:count:log``, or numbers with commas between them.

    Each as in a case file, "2*pi*50" too.
    """
    if text is None or ":" not in text:
        return numbers(text, _number)
    import numpy as np

    from ..basics.resources import afford

    start, stop, count, *spacing = [*text.split(":"), "", ""][: max(3, text.count(":") + 1)]
    try:
        low, high, n = _number(start), _number(stop), int(count)
        if n < 1 or spacing not in ([], ["log"]) or (spacing and min(low, high) <= 0.0):
            raise ValueError
    except ValueError:
        rule = "read start:stop:count, start:stop:count:log with both ends > 0, or numbers with commas between them"
        raise InputError("values", text, rule, "for example 8:14:400") from None
    afford("values", text, "take fewer", floats=200.0 * n)  # each is a point with its rows
    return (np.geomspace if spacing else np.linspace)(low, high, n).tolist()


def _number(text: str) -> float:
    from ..basics.validation import exact_float

    return float(exact_float(text))


def _quiet(value: bool) -> None:
    TALK.quiet = value


def _verbose(value: bool) -> None:
    TALK.verbose = value


Complete = Callable[[str], list[str]]
WORDS = {  # of options with few values
    "form": ("displacement", "velocity-curvature", "hermite"),
    "contact": ("implicit", "extrapolated", "conserving"),
}


def names_of(kind: str) -> list[str]:
    """All values of an option: of "form", "contact", "schemes", "methods", "integrators" or "problems"."""
    if kind in WORDS:
        return list(WORDS[kind])
    if kind == "problems":
        from ..testset.problem import problems

        return list(problems())
    from ..references.registry import REFERENCES
    from ..schemes import RIGID, SCHEMES

    schemes = [scheme.__name__ for scheme in (*SCHEMES.values(), *RIGID.values())]
    return {"schemes": schemes, "methods": list(REFERENCES)}.get(kind, [*schemes, *REFERENCES])


def completion(kind: str) -> Complete:
    """The completion of the values of a kind, see ``names_of``: of the last one of a list, but for ``WORDS``. A comma
    inside parentheses separates no names."""

    def complete(incomplete: str) -> list[str]:
        from ..schemes.labels import split_runs

        last = split_runs(incomplete)[-1] if incomplete and kind not in WORDS else incomplete
        before = incomplete[: len(incomplete) - len(last)]
        return [before + name for name in names_of(kind) if name.startswith(last)]

    return complete


def cases(incomplete: str) -> list[str]:
    """The paper's tables, case files, and the folders that lead to them."""
    from ..files.cases import paper_cases

    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    files = [path for path in (folder.iterdir() if folder.is_dir() else ()) if not path.name.startswith(".")]
    paths = [f"{path}/" if path.is_dir() else str(path) for path in files if path.is_dir() or path.suffix == ".toml"]
    return [name for name in [*paper_cases(), *sorted(paths)] if name.startswith(incomplete)]


KIND = {"schemes": "schemes", "scheme": "schemes", "method": "methods", "contact": "contact", "form": "form"}


def option(words: str, kind: str = "") -> Any:
    """An option with its help and, where its values are of a ``kind``, their completion."""
    return typer.Option(help=words, autocompletion=completion(kind) if kind else None)


CASE: dict[str, Any] = {"help": "table1 .. table17, a case file, or file.toml:name", "autocompletion": cases}
Case = Annotated[str, typer.Argument(**CASE)]
Dt = Annotated[float | None, option("time step instead of the case's")]
TEnd = Annotated[float | None, option("end time instead of the case's")]
Form = Annotated[str | None, option("displacement, velocity-curvature or hermite", "form")]
Jobs = Annotated[int | None, option("processes; default: one per core")]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="write the records to FILE, - for stdout")]
References = Annotated[
    Path | None, option("folder of frozen references; default: ./reference, or those of the package")
]
HIDDEN: dict[str, Any] = {"expose_value": False}
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", callback=_quiet, help="print nothing but errors and --json", **HIDDEN)
]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", callback=_verbose, help="one line on stderr per phase", **HIDDEN)
]


def shared() -> list[Any]:
    """--quiet and --verbose, as the command line has them in every command."""
    alone = typer.Typer(add_completion=False)

    @alone.command()
    def nothing(quiet: Quiet = False, verbose: Verbose = False) -> None: ...

    return [option for option in typer.main.get_command(alone).params if option.name in ("quiet", "verbose")]


EXAMPLES: dict[str, tuple[str, ...]] = {
    "doubt": ("stiffbeam doubt my-beam.toml --scheme 'HHT(alpha=-0.1)'", "stiffbeam doubt my-beam.toml --members 200"),
    "advise": ("stiffbeam advise table10 --want tip=1e-3,impacts=0.05", "stiffbeam advise my-beam.toml --t-end 0.2"),
    "animate": (
        "stiffbeam animate table10 --t-end 0.3",
        "stiffbeam animate table10 --schemes BDF2,sdirk --out film.mp4",
    ),
    "cases": ("stiffbeam cases", "stiffbeam cases --show table10 > my-beam.toml", "stiffbeam cases --json -"),
    "compare": (
        "stiffbeam compare table10",
        "stiffbeam compare my-beam.toml --dt 1e-5 --references exact",
        "stiffbeam compare table10 --schemes 'BDF2,HHT(alpha=-0.2)' --json records.json",
    ),
    "doctor": ("stiffbeam doctor", "stiffbeam doctor --json -"),
    "reference": (
        "stiffbeam reference table10 --t-end 0.5",
        "stiffbeam reference table10 --method multiprecision --t-end 1 --out exact.nc",
        "stiffbeam reference --check reference",
    ),
    "reproduce": (
        "stiffbeam reproduce table 10",
        "stiffbeam reproduce figure 17 --out figures",
        "stiffbeam reproduce all",
    ),
    "score": (
        "stiffbeam score BDF2,cvode --problem bilinear-gap",
        "stiffbeam score --trajectory run.csv --problem bouncing-ball",
        "stiffbeam score --list",
    ),
    "studies": ("stiffbeam studies table10", "stiffbeam studies my-beam.toml --smoke"),
    "amplification": ("stiffbeam amplification", "stiffbeam amplification --schemes BDF2,bathe"),
    "modes": ("stiffbeam modes table10", "stiffbeam modes my-beam.toml --schemes BDF2"),
    "energy": ("stiffbeam energy table10", "stiffbeam energy my-beam.toml --t-end 0.1"),
    "converge": ("stiffbeam converge table10", "stiffbeam converge my-beam.toml --schemes 'HHT(alpha=-0.1),bathe'"),
    "space": ("stiffbeam space table10", "stiffbeam space my-beam.toml --cells 10,20,40"),
    "rigid": ("stiffbeam rigid table10", "stiffbeam rigid my-beam.toml --impacts 2"),
    "rigid-bar": ("stiffbeam rigid-bar --smoke",),
    "rigid-beam": ("stiffbeam rigid-beam table10", "stiffbeam rigid-beam my-beam.toml --kappas 1e6,1e8"),
    "first-impact": ("stiffbeam first-impact table10", "stiffbeam first-impact my-beam.toml --cells 10,20,40"),
    "restitution": ("stiffbeam restitution",),
    "errata": ("stiffbeam errata table10",),
    "impacts": ("stiffbeam impacts table10", "stiffbeam impacts my-beam.toml --schemes BDF2"),
    "contact-duration": ("stiffbeam contact-duration table10",),
    "precision": ("stiffbeam precision table10",),
    "ensemble": (
        "stiffbeam ensemble table10 --members 50",
        "stiffbeam ensemble table10 --schemes trapezoidal --contact conserving",
    ),
    "chaos": ("stiffbeam chaos table10",),
    "sweep": (
        "stiffbeam sweep table10 --parameter frequency --values 8:14:400",
        "stiffbeam sweep my-beam.toml --parameter amplitude --values 5e-4:2e-3:100",
    ),
    "orbits": ("stiffbeam orbits my-beam.toml --parameter frequency --values 30:36:60",),
}
STATUS = (
    "Exit status: 0 success; 1 a run or check failed; 2 invalid input; 130 or 143 interrupted (run again to resume)."
)


def epilog(name: str) -> str:
    """Examples and exit status, each a paragraph."""
    return "\n\n".join(["Examples:", *(f"  {line}" for line in EXAMPLES.get(name, ())), STATUS])


STUDY = "Studies: one question each"
GROUPS: dict[str, tuple[str, ...]] = {  # in the order of the help; a command without a group comes last
    "Compare and choose": ("compare", "advise", "doubt", "animate"),
    "Reference solutions": ("reference", "score"),
    STUDY: ("studies",),  # then every study
    "The paper": ("reproduce",),
    "Tools": ("cases", "doctor"),
}
Out = Annotated[Path | None, option("folder for records, picture and journal; default: stiffbeam-output/CASE")]
Smoke = Annotated[bool, typer.Option("--smoke", help="small configuration: seconds instead of minutes")]
Scheduler = Annotated[str | None, option("Dask scheduler, e.g. tcp://host:8786, instead of processes")]
LISTS: dict[type, Callable[[str | None], list[Any] | None]] = {
    str: labels,
    int: lambda text: numbers(text, int),
    float: values_of,
}


class Commands(TyperGroup):
    """All commands, and one for each study, whose module is imported when it is needed.

    Contexts and commands are click's, or those of the copy that a newer typer brings.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        """All commands, group by group."""
        from ..studies import STUDIES

        each = [name.replace("_", "-") for name in STUDIES]
        listed = [name for group, names in GROUPS.items() for name in (*names, *(each if group == STUDY else ()))]
        return [*listed, *(name for name in super().list_commands(ctx) if name not in listed)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command by name; that of a study is made when it is asked for."""
        from ..studies import STUDIES

        known, study = super().get_command(ctx, cmd_name), cmd_name.replace("-", "_")
        if known is None and study in STUDIES:
            return _Study(cmd_name, STUDIES[study])
        return known if known is None else _dressed(known, cmd_name)


class _Study(TyperCommand):
    """A study by its name and a line of help, until it is called."""

    def __init__(self, name: str, line: str) -> None:
        super().__init__(name, help=line, rich_help_panel=STUDY)

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        assert self.name is not None
        command = _dressed(command_of(self.name.replace("-", "_")), self.name)
        return command.make_context(info_name, args, parent, **extra)


def _dressed(command: Any, name: str) -> Any:
    """The command with the common parts: its group, --quiet, --verbose, examples and exit status in its help."""
    if command.epilog is None:
        command.rich_help_panel = next((group for group, names in GROUPS.items() if name in names), None)
        command.params = [*command.params, *shared()]
        command.help = _joined(command.help or "")  # typer breaks lines where the docstring does
        command.epilog = epilog(name)
    return command


def _joined(text: str) -> str:
    """The text with one line for each paragraph."""
    return re.sub(r"(?<!\n)\n(?!\n)", " ", text)


def command_of(name: str) -> Any:
    """The command of the study ``name``: its options, their defaults and help are those of ``points``."""
    from ..studies import STUDIES, find_study

    study = find_study(name)
    hints = get_type_hints(study.points, include_extras=True)
    options = [p for p in inspect.signature(study.points).parameters.values() if p.name != "case"]
    parse = {p.name: reader for p in options if (reader := _reader(hints[p.name])) is not None}

    def run(case: str, out: Path | None, json_file: Path | None, smoke: bool, **values: Any) -> None:
        jobs, scheduler = values.pop("jobs", None), values.pop("scheduler", None)
        options = {key: parse[key](value) if key in parse else value for key, value in values.items()}
        _ask(study, case, out, json_file, jobs, smoke, scheduler, options)

    around = {"out": (Out, None), "json_file": (Json, None), "smoke": (Smoke, False)}
    if not study.measured:
        around |= {"jobs": (Jobs, None), "scheduler": (Scheduler, None)}
    keyword = inspect.Parameter.KEYWORD_ONLY
    parameters = [inspect.Parameter("case", keyword, default="table10", annotation=Case)]
    parameters += [
        inspect.Parameter(p.name, keyword, default=None, annotation=_option(p, hints[p.name])) for p in options
    ]
    parameters += [inspect.Parameter(n, keyword, default=x, annotation=hint) for n, (hint, x) in around.items()]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    alone = typer.Typer(
        add_completion=False, pretty_exceptions_enable=False, context_settings={"help_option_names": ["-h", "--help"]}
    )
    names = {p.name for p in options}
    text = _joined(inspect.cleandoc(study.points.__doc__ or ""))
    # A parameter of the function is an option of the command.
    text = re.sub(r"``(\w+)``", lambda x: f"--{x[1].replace('_', '-')}" if x[1] in names else f"'{x[1]}'", text)
    text = text.replace("``", "'")
    alone.command(name, help=f"{STUDIES[name]}\n\n{study.question}\n\n{text}")(run)
    return typer.main.get_command(alone)


def _plain(hint: Any) -> tuple[Any, Any]:
    """(type, type of the items of a list or None) of an option, without its help and without None."""
    hint = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    if isinstance(hint, UnionType):
        *_, hint = (arg for arg in get_args(hint) if arg is not type(None))  # a list is last; a mapping is Python's
    return (str, get_args(hint)[0]) if get_args(hint) else (hint, None)


def _reader(hint: Any) -> Callable[[str | None], list[Any] | None] | None:
    """The reader of a list on the command line, None for an option that is not one."""
    item = _plain(hint)[1]
    return None if item is None else LISTS[item]


def _option(parameter: inspect.Parameter, hint: Any) -> Any:
    """An option of the same name, None if it is not given, so that only given options are passed on."""
    words = next((text for text in get_args(hint)[1:] if isinstance(text, str)), "")
    if parameter.default not in (None, parameter.empty) and not isinstance(parameter.default, bool):
        words += f"; default: {parameter.default}"
    return Annotated[_plain(hint)[0] | None, option(words, KIND.get(parameter.name, ""))]


def _ask(
    study: Study, case: str, out: Path | None, json_file: Path | None, jobs: int | None, smoke: bool,
    scheduler: str | None, values: dict[str, Any],
) -> None:  # fmt: skip
    """Run a study on a case; print and save its results."""
    from ..files.cases import find_case

    check_json(json_file)
    chosen = find_case(case)
    options = {key: value for key, value in values.items() if value is not None}
    with progress() as show, _workers(scheduler) as workers:
        records, written = run_one(study, chosen, out, jobs, options, smoke, show, workers)
    if not write_json(study.name, records.to_dict(), json_file):
        print_records(records, written)
    if not written:
        raise typer.Exit(1)


def run_one(
    study: Study, case: CaseFile, out: Path | None, jobs: int | None, values: dict[str, Any], smoke: bool, show: Show,
    workers: Executor | None = None,
) -> tuple[Records, list[Path]]:  # fmt: skip
    """The records of a study and the written files; no files if no point could be evaluated."""
    from ..basics.resources import cores
    from ..studies.common import smoke_options
    from ..studies.references import shipped
    from ..studies.runner import run_study

    options = (smoke_options(study, case) if smoke else {}) | values
    if takes(study, "references") and (frozen := shipped()) is not None:
        options.setdefault("references", str(frozen))
    folder = make_folder(out if out is not None else default_folder(case.name))
    most = 1 if study.all_cores else cores()
    records = run_study(study, case, folder / "journal", most if jobs is None else jobs, workers, show, **options)
    if not records.found:
        return records, []  # what an earlier run has found stays
    show("drawing", 0, 0)
    defaults = inspect.signature(study.points).parameters
    named = [options.get(name, defaults[name].default) for name in study.named_by]
    return records, records.save(folder, "-".join([study.name, *map(file_name, filter(None, named))]))


def takes(study: Study, option: str) -> bool:
    """Return True if ``points`` of the study has this option."""
    return option in inspect.signature(study.points).parameters


def _workers(address: str | None) -> AbstractContextManager[Executor | None]:
    """The executor behind --scheduler, None without one."""
    from contextlib import nullcontext

    if address is None:
        return nullcontext()
    from ..studies.runner import scheduler

    return scheduler(address)


def print_records(records: Records, written: list[Path]) -> None:
    """Print answer, table, failures and the files that were written."""
    from rich.text import Text

    terminal = console()
    note = records.case.units.note
    question = records.study.question + (f" (All {note}.)" if note else "")
    terminal.print(Text.assemble((records.study.command, "bold"), f"  {question}"))
    answer = records.answer
    terminal.print(answer.verdict)
    if answer.table:
        terminal.print(*tables_of(answer.table, terminal.width))
    if answer.notes:
        terminal.print(answer.notes)
    for word, reason in records.missing:
        terminal.print(Text.assemble((word, "bold red" if word == "failed" else "bold"), f"  {reason}"))
    files = ", ".join(str(path) for path in written) or "nothing"
    say(f"{records.seconds:.1f} s. Written: {files}\n")


app = typer.Typer(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Fixed-step schemes beside adaptive and exact solutions of vibro-impact beams.",
)


def _version(asked: bool) -> None:
    if asked:
        print(f"stiffbeam {version('stiffbeam')}")
        raise typer.Exit()


@app.callback()
def options(
    _: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version")] = False,
) -> None:
    """Fixed-step schemes beside adaptive and exact solutions of vibro-impact beams."""


@app.command()
def studies(
    case: Case = "table10",
    out: Out = None,
    references: References = None,
    jobs: Jobs = None,
    smoke: Smoke = False,
    json_file: Json = None,
) -> None:
    """Run every study on one case; a second run continues where the first was stopped."""
    from ..files.cases import find_case
    from ..studies import STUDIES, find_study

    check_json(json_file)
    chosen, empty = find_case(case), False
    asked: list[dict[str, Any]] = []
    for name in STUDIES:
        study = find_study(name)
        named = {"references": str(references)} if references is not None and takes(study, "references") else {}
        try:
            with progress() as show:
                records, written = run_one(study, chosen, out, jobs, named, smoke, show)
        except InputError as error:  # a study that this case cannot be asked, which is no failure
            print(f"{study.command}: left out, {error}", file=sys.stderr)
            continue
        asked.append(records.to_dict())
        if str(json_file) != "-":
            print_records(records, written)
        empty = empty or bool(records.failures and not written)
    write_json("studies", {"case": chosen.name, "studies": asked}, json_file)
    if empty:
        raise typer.Exit(1)
