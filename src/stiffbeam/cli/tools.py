"""``stiffbeam cases``, the list of cases; ``doctor``, a test of every solver; ``reproduce``, the paper's page."""

from __future__ import annotations

import importlib
import platform
import re
import shlex
import shutil
import sys
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..basics.resources import progress
from ..basics.validation import InputError, integer
from .application import Jobs, Json, References, app, check_json, console, make_folder, option, say, write_json
from .tables import table_of

if TYPE_CHECKING:
    from ..basics.resources import Show


@app.command()
def cases(
    show: Annotated[str | None, option("print one case as TOML, as a start for your own file")] = None,
    json_file: Json = None,
) -> None:
    """List the paper's cases."""
    from ..files.paper import case_blocks, paper_entries, paper_text

    check_json(json_file)
    if show is not None:
        text = case_blocks(paper_text()).get(show)
        if text is None:
            from ..files.cases import case_text  # loads SciPy and numba

            text = case_text(show)
        say(text.rstrip())
        return
    fields = ("name", "title", "cells", "dt", "t_end", "runs")
    rows: list[dict[str, Any]] = [
        {x: entry[x] for x in fields} | {"published": entry.get("published", {}), "inferred": entry.get("inferred", [])}
        for entry in paper_entries()
    ]
    if write_json("cases", {"cases": rows}, json_file):
        return
    columns = ("title", "cells", "dt", "t_end")
    lines = [{"case": row["name"], **{x: str(row[x]) for x in columns}, "runs": "\n".join(row["runs"])} for row in rows]
    console().print(table_of(lines))
    say("All are non-dimensional.")
    say("t_end and other inferred values carry their reason in `stiffbeam cases --show NAME`.")


@app.command()
def doctor(json_file: Json = None) -> None:
    """Print versions and cache folders, and test every solver on a small problem."""
    from rich.table import Table

    check_json(json_file)
    with progress() as show:
        installed, places, solvers = _installed(), _places(), _solvers(show)
    report = {"installed": installed, "places": places, "solvers": solvers}
    good = all(solver["agrees"] for solver in solvers)
    if not write_json("doctor", report, json_file):
        table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
        for name, value in [*installed.items(), *places.items()]:
            table.add_row(name, str(value))
        for solver in solvers:
            table.add_row(solver["name"], f"{'works' if solver['agrees'] else 'fails'}, {solver['said']}")
        console().print(table)
    raise typer.Exit(0 if good else 1)


def _installed() -> dict[str, str]:
    """Versions of Python, of this package and of what it depends on."""
    import sksundae

    versions = {"python": f"{platform.python_version()} on {platform.platform()}"}
    needed = [
        re.split(r"[^\w.-]", text, maxsplit=1)[0] for text in requires("stiffbeam") or [] if "extra ==" not in text
    ]
    for name in ["stiffbeam", *needed]:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "missing"
    return versions | {"SUNDIALS": str(sksundae.SUNDIALS_VERSION)}


def _places() -> dict[str, Any]:
    """Caches, frozen references, threads, devices."""
    from ..basics.resources import cores
    from ..basics.storage import directory
    from ..references.adaptive.diffrax import jax_devices
    from ..studies.references import shipped

    cache, frozen = directory(), shipped()
    size = sum(file.stat().st_size for file in cache.rglob("*") if file.is_file())
    try:
        devices = ", ".join(str(device) for device in jax_devices())
    except InputError as error:
        devices = str(error)
    return {
        "cache": f"{cache}, {size / 1e6:.0f} MB",
        "frozen references": "none" if frozen is None else f"{frozen}, {len(list(frozen.glob('*.nc')))} files",
        "threads": cores(),
        "JAX devices": devices,
    }


def _solvers(show: Show) -> list[dict[str, Any]]:
    """Results of every reference and a scheme on a mass that meets a stop once, compared with the exact solution."""
    import numpy as np

    from ..march.integrate import integrate
    from ..measures.errors import tip_error
    from ..model.contact import Contact, Stops
    from ..model.system import System
    from ..references import reference
    from ..references.registry import METHODS
    from ..schemes import SDIRK

    system = System.from_matrices(
        [[1.0]], [[10.0]], contacts=[Contact(np.ones(1), Stops(upper=0.1, stiffness=1e3))], initial_velocity=[1.0]
    )
    end, rows = 0.5, []
    times = np.arange(5001) * 1e-4
    exact = reference(system, end, t_eval=times)
    for i, name in enumerate(["SDIRK", *METHODS]):
        show(name, i, 1 + len(METHODS))
        begun, solver = time.perf_counter(), {"name": name, "agrees": False}
        try:
            scheme = SDIRK() if name == "SDIRK" else None
            run = integrate(system, scheme, 1e-4, end) if scheme else reference(system, end, name, t_eval=times)
            error = tip_error(run.tip, exact.tip).max
            solver |= {"agrees": bool(error < 1e-3), "error": error}
            solver["said"] = f"within {error:.1e} of the exact solution in {time.perf_counter() - begun:.2g} s"
        except Exception as failure:  # whatever is broken here is what the command is asked to say
            solver["said"] = f"{type(failure).__name__}: {failure}"
        rows.append(solver)
    return rows


What = Annotated[str, typer.Argument(help="all, table N or figure N")]
Number = Annotated[int | None, typer.Argument(help="1 .. 17", show_default=False)]
Out = Annotated[Path, option("folder for the page, the pictures and the store")]
Contact = Annotated[str, option("implicit, or extrapolated as the paper describes it")]
Printed = Annotated[bool, typer.Option("--printed", help="HHT and SDIRK with the paper's misprints")]


@app.command()
def reproduce(
    what: What = "all",
    number: Number = None,
    out: Out = Path("stiffbeam-output/reproduction"),
    contact: Contact = "implicit",
    printed: Printed = False,
    references: References = None,
    jobs: Jobs = None,
    json_file: Json = None,
) -> None:
    """Reproduce Dumont (2002) in a checkout: tables, figures, claims and misprints on one page."""
    from ..basics.resources import cores

    tables = _tables(what, number)
    paper = _paper()
    if jobs is not None:
        integer("--jobs", jobs, 1)
    check_json(json_file)
    make_folder(out)
    chosen = paper.reading(contact, printed, references)
    with progress() as show:
        typed = shlex.join(["stiffbeam", *sys.argv[1:]])  # without the folder of the program
        page, results = paper.reproduce(tables, chosen, out, jobs or cores(), progress=show, command=typed)
    written = [page]
    if what == "figure":
        drawn = out / chosen.name / f"table{number}" / f"figure{number}.png"
        written.insert(0, Path(shutil.copy2(drawn, out)))
    records = {f"table{n}": finished.numbers for n, finished in results.items()}
    if not write_json("reproduce", {"tables": records}, json_file):
        _print(records, paper.exact_name)
        say("Written: " + ", ".join(str(file) for file in written))
    if any(record["failures"] for record in records.values()):
        raise typer.Exit(1)


def _paper() -> Any:
    """The package ``studies/dumont2002`` of the checkout that this package runs from.

    Its processes find it by the path as well. InputError where an installed package has no checkout around it.
    """
    package = Path(__file__).parents[1]
    studies = package.parents[1] / "studies"
    if not (studies / "dumont2002" / "__init__.py").is_file():
        rule = "run from a checkout, whose studies/dumont2002 makes the paper's page"
        raise InputError("reproduce", str(package), rule, "in a checkout, pip install -e . and repeat it")
    if str(studies) not in sys.path:
        sys.path.append(str(studies))  # at the end: site.py there is not Python's
    return importlib.import_module("dumont2002.reproduce")


def _tables(what: str, number: int | None) -> list[int] | None:
    if what == "all" and number is None:
        return None
    if what not in ("table", "figure") or number is None:
        words = what if number is None else f"{what} {number}"
        raise InputError("reproduce", words, "be all, table N or figure N", "for example: stiffbeam reproduce table 10")
    return [number]


def _print(records: dict[str, Any], exact_name: Callable[[str, dict[str, Any]], str]) -> None:
    from ..files.cases import paper_case
    from ..measures.report import WIDTH, percent, short

    lines: list[dict[str, str]] = []
    for name, record in records.items():
        counts = paper_case(int(name.removeprefix("table"))).published.get("impacts", {})
        # By the scheme's label; the paper has one form in each of these tables.
        counts = {label.partition("@")[0]: f"{count:g}" for label, count in counts.items()}
        motions = {f"{equation} {short(row['scheme'])}": row for equation, row in record["runs"].items()}
        motions |= {exact_name(form, row): row for form, row in record["exact"].items()}
        for motion, row in motions.items():
            line = {
                "table": name,
                "motion": motion,
                "impacts": str(row["impacts"]),
                "contact": percent(row["fraction"]),
            } | ({"paper's impacts": counts[row["scheme"]]} if row.get("scheme") in counts else {})
            lines.append(line | ({"horizon": f"{row['horizon']:.3g}"} if "horizon" in row else {}))
        lines += [{"table": name, "motion": f"{eq} failed: {why}"} for eq, why in record["failures"].items()]
    console(WIDTH).print(table_of(lines))
    say("One run each; impacts of the exact motion are counted by events.")
    if any("paper's impacts" in line for line in lines):
        say("The paper's counts fit none of the end times that its CPU times allow.")
