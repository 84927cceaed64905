"""The ``stiffbeam`` command. Docstrings of the commands are their help."""

from __future__ import annotations

import atexit
import gc
import io
import json as json_module
import os
import platform
import re
import shutil
import signal
import sys
import tomllib
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

from cyclopts import App, CycloptsError, Parameter

from .basics.resources import TALK, cores, working
from .basics.storage import make_folder, write_whole
from .basics.text import plain
from .basics.validation import InputError, one_of, positive
from .references.registry import ADAPTIVE, BEST, BUDGET, MULTIPRECISION, REFERENCES

if TYPE_CHECKING:
    from .files.cases import Case
    from .studies.base import Study
    from .studies.comparison import CaseComparison

HELP = """Fixed-step schemes beside adaptive and exact solutions of vibro-impact beams.

Every command takes --quiet (-q: print nothing but errors and --json).
Exit status: 0 success; 1 a run or check failed; 2 invalid input; 130 or 143 interrupted (run again to resume).
"""
OWN = {  # studies with a command of their own; the others: stiffbeam study NAME
    "converge": "Orders, work, time and impacts of every integrator over the time step.",
    "ensemble": "Statistics past the horizon: impacts, durations, forces and energy of perturbed runs.",
    "advise": "Cheapest scheme, contact treatment and time step for given errors.",
    "doubt": "Uncertainty of every quantity by source: rounding, scheme, mesh and data.",
    "sweep": "Bifurcation diagram, impacts and forces over a parameter.",
}


def application(first: str = "") -> App:
    """The application. ``first``: the command that is asked for; studies are imported only where their help is."""
    app = App(
        name="stiffbeam", help=HELP, version=f"stiffbeam {version('stiffbeam')}",
        default_parameter=Parameter(negative_iterable=(), negative_none=()), result_action="return_value",
        suppress_keyboard_interrupt=False,
    )  # fmt: skip
    for command in (compare, reference, score, cases, doctor):
        app.command(command)
    for name, line in OWN.items():
        if first == name:
            from .studies import find_study

            app.command(study_command(find_study(name)), name=name)
        else:
            app.command(_not_loaded, name=name, help=line)
    group = App(name="study", help="Run a study: stiffbeam study NAME CASE.")
    if first == "study":
        from .studies import studies

        for name, kind in studies().items():
            group.command(study_command(kind), name=name)
    app.command(group)
    return app


def _not_loaded() -> None:
    raise AssertionError("application() loads the study that is asked for")


def study_command(kind: type[Study]) -> Callable[..., int]:
    """The command of a study; its options are the fields of the dataclass."""

    def run(
        case: CaseName = "table10", /, *, options: Any = None, dt: Step = None, t_end: EndTime = None,
        out: Out = None, jobs: Jobs = None, json: Json = None,
    ) -> int:  # fmt: skip
        from .studies.base import perform

        chosen, options = asked_case(case, dt, t_end), options or kind()
        folder = make_folder(out if out is not None else default_folder(chosen.name))
        if jobs is None:
            jobs = 1 if kind.all_cores else cores()
        with working("starting", True) as show:
            records = perform(options, chosen, jobs, folder / "points", show)
            written: list[Path] = []
            if len(records.found):
                show("drawing", 0, 0)
                written = records.save(folder)
        if not write_json(records.name, records.to_dict(), json):
            say(records.report().text(shutil.get_terminal_size((160, 24)).columns))  # without a terminal 160
            say(f"Written: {', '.join(map(str, written)) or 'nothing'}")
        return 0 if written else 1

    run.__doc__ = re.sub(r"``(\w+)``", r"--\1", kind.__doc__ or "")  # a field is an option here
    run.__annotations__["options"] = Annotated[kind | None, Parameter(name="*")]
    return run


# ---------------------------------------------------------------- options and output


def _json_file(_: Any, file: Path | None) -> None:
    """Raise InputError for a --json that cannot be a file, before anything is computed."""
    if file is None or str(file) == "-":
        return
    make_folder(file.parent, "--json")
    if file.is_dir() or (file.exists() and not os.access(file, os.W_OK)):
        raise InputError("--json", str(file), "be a file that can be written to", "name another, or - for the terminal")


# Options that several commands have.
CaseName = Annotated[str, Parameter(help="table1 .. table17, a case file, or file.toml:name.")]
Step = Annotated[float | None, Parameter(help="Time step in place of the case's.")]
EndTime = Annotated[float | None, Parameter(help="End time in place of the case's.")]
Out = Annotated[
    Path | None, Parameter(help="Folder of what is written and of finished points; by default stiffbeam-output/CASE.")
]
Jobs = Annotated[int | None, Parameter(help="Processes; by default one per core.")]
Form = Annotated[str | None, Parameter(help="displacement, velocity-curvature or hermite.")]
Json = Annotated[
    Path | None,
    Parameter(allow_leading_hyphen=True, validator=_json_file, help="Write the records to this file, - for stdout."),
]


def asked_case(case: str, dt: float | None, t_end: float | None) -> Case:
    """The case, with the time step and the end time that are given."""
    from .files.cases import find_case

    given = {"dt": dt, "t_end": t_end}
    asked = {name: positive(f"--{name.replace('_', '-')}", x) for name, x in given.items() if x is not None}
    return replace(find_case(case), **asked)


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
    return "".join(c if c.isalnum() or c in "-._=" else "_" for c in plain).lstrip(".")[:100] or "_"


def json_text(command: str, records: Mapping[str, Any]) -> str:
    """The records of a command as JSON, which has no NaN: its name and the version of the package come first."""
    head = {"stiffbeam": version("stiffbeam"), "command": command}
    return json_module.dumps(plain(head | dict(records)), indent=2, ensure_ascii=False, allow_nan=False)


def write_json(command: str, records: Mapping[str, Any], file: Path | None) -> bool:
    """Write the records to the file of --json. Returns True if that is the standard output, which then has nothing
    else."""
    if file is None:
        return False
    text = json_text(command, records)
    if str(file) == "-":
        print(text)
        return True
    write_whole(file, text + "\n")
    return False


# ---------------------------------------------------------------- compare


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a comparison."""

    schemes: Annotated[
        str | None,
        Parameter(help="Comma-separated schemes, solvers, functions module:function: 'BDF2,PrintedSigma,mymodule:f'."),
    ] = None
    references: Annotated[
        str | None,
        Parameter(help="Comma-separated; the first that supports the case is the main one. Default: all that do."),
    ] = None
    form: Form = None
    contact: Annotated[str, Parameter(help="implicit, conserving, or extrapolated as in the paper.")] = "implicit"
    rates: Annotated[bool, Parameter(help="Add rates of impacts, impulse and work at every stop.")] = False
    budget: Annotated[float, Parameter(help="CPU seconds of each reference; one that needs more ends earlier.")] = (
        BUDGET
    )


def compare(
    case: CaseName, *, options: Annotated[Options | None, Parameter(name="*")] = None, dt: Step = None,
    t_end: EndTime = None, out: Out = None, json: Json = None,
) -> int:  # fmt: skip
    """Run schemes beside SUNDIALS and the exact solution: table, picture, trajectories.

    Example: stiffbeam compare table10 --schemes 'BDF2,HHT(alpha=-0.2)' --json records.json
    """
    from .figures.chart import heading, save_figure
    from .figures.runs import comparison_figure
    from .measures.report import largest, short, verdict
    from .schemes.labels import split_runs
    from .studies.comparison import CaseComparison

    chosen, options = asked_case(case, dt, t_end), options or Options()
    positive("--budget", options.budget)
    schemes, names = (
        None if text is None else [x.strip() for x in split_runs(text)] or [text]
        for text in (options.schemes, options.references)
    )
    folder = out if out is not None else default_folder(chosen.name)
    result = CaseComparison(chosen, options.form, options.contact, options.budget)
    tell, written = (say if str(json) != "-" else str), list[Path]()
    early, told = not set(schemes or ()) & set(REFERENCES), -1  # solvers among the schemes have rows in the tables
    with working("starting", True) as show:
        try:
            for solution in result.run(schemes, names):
                if not written:
                    make_folder(folder)
                    tell("  ".join(dict.fromkeys([chosen.name, chosen.title])))
                written.append(solution.save(folder / f"{file_name(solution.label)}.nc"))
                compared = [c for c in result.comparisons if c.pair[0] is solution]
                cost = [f"{solution.work.seconds:.2g} s", *filter(None, [solution.provenance.get("budget")])]
                facts = f"{verdict(compared) if compared else largest(solution)} ({'; '.join(cost)})"
                tell(f"{short(solution.provenance['method'])}: {facts}")
                if early and told < 0 and result.references:
                    tell(f"\n{result.report().text()}\n")
                    told = len(result.failures)
            if options.rates and chosen.has_stops and result.comparisons:
                written.append(_rates(result, tell, folder))
            if result.comparisons:
                show("drawing", 0, 0)
                own = [c for c in result.comparisons if c.pair[0] in result.runs]
                details = f"{result.references[0].provenance['form']}, dt = {chosen.dt:g}, {chosen.grid}"
                title = f"{heading(chosen, verdict(own) if own else chosen.title)}; {details}"
                written.append(save_figure(comparison_figure(result.comparisons, title), folder / "comparison.png"))
        finally:  # an interrupt loses only what is running
            if told < 0 and (written or result.failures):
                tell(f"\n{result.report().text()}")
            for failure in result.failures[told:] if told >= 0 else ():
                tell("  ".join(failure))
            if written:
                written.append(write_whole(folder / "comparison.txt", f"{result.report().text()}\n"))
            records = result.to_dict() | {"files": [path.name for path in written]}
            if written:
                written.append(write_whole(folder / "comparison.json", json_text("compare", records) + "\n"))
    if not write_json("compare", records, json):
        say(f"\nWritten: {len(written)} files in {folder}")
    failed_runs = [label for _, label, _ in result.failures if label.partition("@")[0] not in REFERENCES]
    return int(bool(failed_runs) or not result.references)


def _rates(result: CaseComparison, tell: Callable[[str], object], folder: Path) -> Path:
    """Rates of the main reference and of every scheme; the file has a line for each run and stop."""
    import pandas

    from .measures.rates import contact_rates

    tables = []
    for one in (*result.references[:1], *result.runs):
        rates = contact_rates(one)
        tell(f"\n{one.label}, rates with 95 % intervals\n{rates}")
        tables.append(rates.to_dataframe().reset_index().assign(run=one.label))
    return write_whole(folder / "comparison-rates.csv", pandas.concat(tables).set_index(["run", "contact"]).to_csv())


# ---------------------------------------------------------------- the others


def reference(
    case: CaseName, *, method: str | None = None, form: Form = None, digits: int | None = None,
    rtol: float | None = None, t_end: EndTime = None, out: Path | None = None, json: Json = None,
) -> None:  # fmt: skip
    """Compute a reference solution, and write it to a file.

    Example: stiffbeam reference table10 --method multiprecision --t-end 1 --out exact.nc

    Parameters
    ----------
    method
        exact, multiprecision or an adaptive solver; by default the best for the case.
    digits
        Digits of multiprecision; by default as many as the case needs.
    rtol
        Relative tolerance of the adaptive solvers; by default 1e-10.
    out
        File to write: .nc with everything, .json or .csv.
    """
    from .files.store import keep
    from .measures.errors import impact_times
    from .references import reference, substitute

    chosen = asked_case(case, None, t_end)
    system, end = chosen.system(form), chosen.t_end
    method = method or (BEST[1] if substitute(system, end) else BEST[0])
    kind = REFERENCES[method].kind if method in REFERENCES else ""
    for flag, fits in (("--digits", digits is None or kind == MULTIPRECISION),
                       ("--rtol", rtol is None or kind == ADAPTIVE)):  # fmt: skip
        if not fits and kind:
            raise InputError(flag, "with --method " + method, "be left out here", "this method has no use for it")
    many = "auto" if digits is None else digits
    with working("starting", True) as show:
        show(f"{method}@{system.form}", 0, 0)
        solution = reference(system, end, method, rtol=1e-10 if rtol is None else rtol, digits=many)
    record = {
        "measured": ["seconds"], "reference": solution.label, "t_end": end, "horizon": solution.horizon,
        "units": list(solution.units), "against": solution.provenance["horizon_against"],
        "impacts": len(impact_times(solution)), "seconds": round(solution.work.seconds, 3),
        "digits": solution.provenance.get("digits"), "parameters": solution.provenance.get("parameters"),
    }  # fmt: skip
    if out is not None:
        record["file"] = str(keep(solution, out))
    if not write_json("reference", {"references": [record]}, json):
        shown = {key: value for key, value in record.items() if key != "measured" and value not in ("", None, [])}
        say("  ".join(f"{key}: {value}" for key, value in shown.items()))


def score(
    integrators: str | None = None, *, problem: str | None = None,
    trajectory: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    out: Path | None = None, json: Json = None,
) -> int:  # fmt: skip
    """Errors and orders of integrators on problems with known answers.

    Exit status 0: no result is flagged; 1: an error does not fall with the step, or too slowly, an impact is missing,
    or a run failed.

    Example: stiffbeam score BDF2,cvode --problem bilinear-gap

    Parameters
    ----------
    integrators
        Comma-separated schemes, solvers, functions module:function, such as 'HHT(alpha=-0.1),cvode'.
    problem
        Comma-separated names; by default all, in minutes for a function in Python.
    trajectory
        Score these files instead, one for each time step: columns t, u and, if known, v.
    out
        Folder for table, records and pictures.
    """
    from .schemes.labels import split_runs
    from .testset.problem import problems
    from .testset.score import read_trajectory, score_trajectories
    from .testset.score import score as score_all

    if integrators is not None and trajectory:
        raise InputError("INTEGRATORS", integrators, "be left out with --trajectory", "give one command for each")
    if out is not None:
        make_folder(out)  # before the work begins
    names = None if problem is None else [name.strip() for name in problem.split(",")]
    if trajectory:
        if names is None or len(names) != 1:
            raise InputError("--problem", problem, "name one problem for --trajectory", ", ".join(problems()))
        label = trajectory[0].name if len(trajectory) == 1 else f"{len(trajectory)} files"
        card = score_trajectories(names[0], [read_trajectory(x) for x in trajectory], label)
    else:
        with working("starting", True) as bar:
            card = score_all(None if integrators is None else split_runs(integrators), names, progress=bar)
    written = [] if out is None else card.save(out)
    if not write_json("score", card.to_dict(), json):
        say(str(card))
        if written:
            say(f"Written: {written[0]} and {len(written) - 1} files beside it")
    return int(bool(card.flagged))


def cases(*, show: str | None = None, json: Json = None) -> None:
    """List the paper's cases.

    Example: stiffbeam cases --show table10 > my-beam.toml

    Parameters
    ----------
    show
        Print one of them as TOML, as a start for your own file.
    """
    from .files import case_blocks, paper_text

    if show is not None:
        blocks = case_blocks(paper_text())
        say(blocks[one_of("--show", show, blocks, "be a table of the paper")].rstrip())
        return
    rows = tomllib.loads(paper_text())["case"]
    if write_json("cases", {"cases": rows}, json):
        return
    for row in rows:
        grid = f"{row['cells']} cells, dt = {row['dt']}, t_end = {row['t_end']}"
        say(f"{row['name']:<8} {row['title']}: {grid}, {', '.join(row['runs'])}")
    say("t_end and other inferred values carry their reason in `stiffbeam cases --show NAME`.")


def doctor(*, json: Json = None) -> int:
    """Print versions and the cache folder, and test every solver on a small problem."""
    from .basics.storage import directory
    from .testset.score import score

    versions = {"python": f"{platform.python_version()} on {platform.platform()}", "stiffbeam": version("stiffbeam")}
    versions |= {name: version(name) for name in ("numpy", "scipy", "pandas", "xarray", "matplotlib")}
    for method in REFERENCES.values():
        versions |= method.versions()
    solvers = list[dict[str, Any]]()
    with working("starting", True) as show:
        for i, name in enumerate(["SDIRK", *REFERENCES]):
            show(name, i, 1 + len(REFERENCES))
            try:
                (entry,) = score(name, "bilinear-oscillator").entries
                found = entry.reason or f"tip error {entry.best['tip_error']:.1e}"
                solvers.append({"name": name, "agrees": bool(entry.runs and not entry.flagged), "found": found})
            except Exception as failure:  # whatever is broken here is what the command reports
                solvers.append({"name": name, "agrees": False, "found": f"{type(failure).__name__}: {failure}"})
    report = {"installed": versions, "cache": str(directory()), "threads": cores(), "solvers": solvers}
    if not write_json("doctor", report, json):
        lines = versions | {"cache": report["cache"], "threads": report["threads"]}
        lines |= {x["name"]: f"{'works' if x['agrees'] else 'fails'}, {x['found']}" for x in solvers}
        for name, value in lines.items():
            say(f"{name:<{max(map(len, lines))}}  {value}")
    return 0 if all(solver["agrees"] for solver in solvers) else 1


# ---------------------------------------------------------------- the program

INTERRUPTED = 130  # the exit status of a program that Ctrl-C has stopped
QUIET = ("-q", "--quiet")


def main() -> None:
    """Entry point: InputError exits with 2, a failure with 1, SIGINT with 130, SIGTERM with 143, each with one line."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # letters that an ASCII or Latin-1 terminal does not have
    os.environ.setdefault("PJRT_NPROC", "1")  # threads of JAX, which on small systems do nothing but seek work
    # Of an interrupted study joblib's clean-up would tell what it cleans.
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")
    stopped: list[int] = []

    def end(number: int, _: FrameType | None) -> None:
        stopped.append(number)
        for name in (signal.SIGINT, signal.SIGTERM):  # a second one does not wait
            signal.signal(name, signal.SIG_DFL)
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)  # as Ctrl-C: what is finished is kept
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where a shell has it ignored
        signal.signal(signal.SIGINT, end)
    atexit.register(gc.freeze)  # at the end a search through all modules for garbage would only take time
    given = sys.argv[1:]
    words = [word for word in given if word not in QUIET]
    TALK.quiet = words != given
    warnings.showwarning = lambda message, *_, **__: print(f"stiffbeam: warning: {message}", file=sys.stderr)
    try:
        app = application(next((word for word in words if not word.startswith("-")), ""))
        status = app(words or ["--help"], exit_on_error=False, print_error=False)
        sys.stdout.flush()  # a full disk is an error of the command
    except InputError as error:
        _fail(error, 2)
    except CycloptsError as error:
        cause = error.__cause__
        _fail(cause if isinstance(cause, InputError) else f"{' '.join(str(error).split())} See stiffbeam --help", 2)
    except OSError as error:
        with suppress(OSError):
            sys.stdout.flush()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the interpreter does not try a full disk again
        _fail(error, 1)
    except RuntimeError as error:
        # Imported here: they load SciPy, which help does without.
        from .trajectory.trajectory import Diverged, SolverFailure

        if not isinstance(error, (Diverged, SolverFailure, BrokenExecutor)):  # a process that the system has ended
            raise
        _fail(error, 1)
    except KeyboardInterrupt:
        print("stiffbeam: interrupted; run the same command again", file=sys.stderr)
        if stopped:  # at once: worker processes end with this one
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(128 + stopped[0])
        raise SystemExit(INTERRUPTED) from None
    raise SystemExit(status if isinstance(status, int) else 0)


def _fail(error: Exception | str, status: int) -> NoReturn:
    print(f"stiffbeam: {error}", file=sys.stderr)
    raise SystemExit(status) from None
