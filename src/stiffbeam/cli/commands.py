"""Commands beside ``compare``: studies, reference, score, cases, doctor. Docstrings are their help."""

from __future__ import annotations

import platform
import shutil
import sys
from collections.abc import Callable
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from ..basics.progress import progress
from ..basics.resources import cores
from ..basics.storage import make_folder
from ..basics.validation import InputError, near
from ..references.registry import ADAPTIVE, BEST, MULTIPRECISION, REFERENCES
from .comparison import compare
from .output import (
    CaseName,
    EndTime,
    Form,
    Json,
    Step,
    asked_case,
    check_json,
    default_folder,
    say,
    write_json,
)

if TYPE_CHECKING:
    from ..studies.base import Study

HELP = """Fixed-step schemes beside adaptive and exact solutions of vibro-impact beams.

Every command takes --quiet (-q: print nothing but errors and --json) and --verbose (-v: one line on stderr per phase).
Exit status: 0 success; 1 a run or check failed; 2 invalid input; 130 or 143 interrupted (run again to resume).
"""
OWN = {  # studies with a command of their own; the others: stiffbeam study NAME
    "converge": "Orders, work, time, impacts and energy lost of every integrator over the time step.",
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
            from ..studies import find_study

            app.command(study_command(find_study(name)), name=name)
        else:
            app.command(_not_loaded, name=name, help=line)
    group = App(name="study", help="Run a study: stiffbeam study NAME CASE.")
    if first == "study":
        from ..studies import studies

        for name, kind in studies().items():
            if name not in OWN:
                group.command(study_command(kind), name=name)
    app.command(group)
    return app


def _not_loaded() -> None:
    raise AssertionError("application() loads the study that is asked for")


def study_command(kind: type[Study]) -> Callable[..., int]:
    """The command of a study; its options are the fields of the dataclass."""

    def run(
        case: CaseName = "table10", /, *, options: Any = None, dt: Step = None, t_end: EndTime = None,
        out: Path | None = None, jobs: int | None = None, json: Json = None,
    ) -> int:  # fmt: skip
        from ..studies.base import perform

        check_json(json)
        chosen, options = asked_case(case, dt, t_end), kind() if options is None else options
        folder = make_folder(out if out is not None else default_folder(chosen.name))
        if jobs is None:
            jobs = 1 if kind.all_cores else cores()
        with progress() as show:
            records = perform(options, chosen, jobs, folder / "points", show)
            written: list[Path] = []
            if len(records.found):
                show("drawing", 0, 0)
                written = records.save(folder)
        if not write_json(records.name, records.to_dict(), json):
            say(records.text(shutil.get_terminal_size().columns if sys.stdout.isatty() else 160))
            say(f"Written: {', '.join(map(str, written)) or 'nothing'}")
        return 0 if written else 1

    names = ", ".join(f.name for f in fields(kind))
    run.__doc__ = (kind.__doc__ or "") + _SHARED
    run.__annotations__["options"] = Annotated[kind | None, Parameter(name="*", help=names)]
    return run


_SHARED = """
    Parameters
    ----------
    out
        Folder for table, text, picture and finished points; by default stiffbeam-output/CASE.
    jobs
        Processes; by default one per core.
    """


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
    from ..files.store import can_freeze, freeze
    from ..measures.errors import impact_times
    from ..references import reference, substitute

    check_json(json)
    chosen = asked_case(case, None, t_end)
    system, end = chosen.system(form), chosen.t_end
    method = method or (BEST[1] if substitute(system, end) else BEST[0])
    kind = REFERENCES[method].kind if method in REFERENCES else ""
    for flag, fits in (("--digits", digits is None or kind == MULTIPRECISION),
                       ("--rtol", rtol is None or kind == ADAPTIVE)):  # fmt: skip
        if not fits and kind:
            raise InputError(flag, "with --method " + method, "be left out here", "this method has no use for it")
    many = "auto" if digits is None else digits
    with progress() as show:
        show(f"{method}@{system.form}", 0, 0)
        solution = reference(system, end, method, rtol=1e-10 if rtol is None else rtol, digits=many)
    record = {
        "measured": ["seconds"], "reference": solution.label, "t_end": end, "horizon": solution.horizon,
        "units": list(solution.units), "against": solution.provenance["horizon_against"],
        "impacts": len(impact_times(solution)), "seconds": round(solution.work.seconds, 3),
        "digits": solution.provenance.get("digits"), "parameters": solution.provenance.get("parameters"),
    }  # fmt: skip
    if out is not None:
        record["file"] = str(freeze(solution, out) if can_freeze(solution) else solution.save(out))
    if not write_json("reference", {"references": [record]}, json):
        shown = {key: value for key, value in record.items() if key != "measured" and value not in ("", None, [])}
        say("  ".join(f"{key}: {value}" for key, value in shown.items()))


def score(
    integrators: str | None = None, *, problem: str | None = None, trajectory: list[Path] | None = None,
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
        Score this file instead: columns t, u and, if known, v; repeat for other time steps.
    out
        Folder for table, records and pictures.
    """
    from ..schemes.labels import split_runs
    from ..testset.measure import read_trajectory
    from ..testset.problem import problems
    from ..testset.score import score as score_all
    from ..testset.score import score_trajectories

    if integrators is not None and trajectory:
        raise InputError("INTEGRATORS", integrators, "be left out with --trajectory", "give one command for each")
    check_json(json)
    if out is not None:
        make_folder(out)  # before the work begins
    names = None if problem is None else [name.strip() for name in problem.split(",")]
    if trajectory:
        if names is None or len(names) != 1:
            raise InputError("--problem", problem, "name one problem for --trajectory", ", ".join(problems()))
        label = trajectory[0].name if len(trajectory) == 1 else f"{len(trajectory)} files"
        card = score_trajectories(names[0], [read_trajectory(x) for x in trajectory], label)
    else:
        with progress() as bar:
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
    from ..files.paper import case_blocks, paper_entries, paper_text

    check_json(json)
    if show is not None:
        blocks = case_blocks(paper_text())
        if show not in blocks:
            raise InputError("--show", show, "be a table of the paper", near(show, blocks))
        say(blocks[show].rstrip())
        return
    rows = paper_entries()
    if write_json("cases", {"cases": rows}, json):
        return
    for row in rows:
        grid = f"{row['cells']} cells, dt = {row['dt']}, t_end = {row['t_end']}"
        say(f"{row['name']:<8} {row['title']}: {grid}, {', '.join(row['runs'])}")
    say("t_end and other inferred values carry their reason in `stiffbeam cases --show NAME`.")


def doctor(*, json: Json = None) -> int:
    """Print versions and the cache folder, and test every solver on a small problem."""
    from ..basics.storage import directory
    from ..testset.score import score

    check_json(json)
    versions = {"python": f"{platform.python_version()} on {platform.platform()}", "stiffbeam": version("stiffbeam")}
    versions |= {name: version(name) for name in ("numpy", "scipy", "pandas", "xarray", "matplotlib")}
    for method in REFERENCES.values():
        versions |= method.versions()
    solvers = list[dict[str, Any]]()
    with progress() as show:
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
