"""``stiffbeam score``: integrators on problems with known answers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..basics.progress import progress
from ..basics.validation import InputError
from .application import app
from .options import Json, completion, option
from .output import check_json, console, make_folder, say, write_json


@app.command()
def score(
    integrators: Annotated[
        str | None,
        typer.Argument(
            help="comma-separated: schemes, solvers, module:function; e.g. 'HHT(alpha=-0.1),cvode'",
            autocompletion=completion("integrators"),
        ),
    ] = None,
    problem: Annotated[str | None, option("comma-separated names; all by default", "problems")] = None,
    trajectory: Annotated[
        list[Path] | None,
        option("score this file instead: columns t, u and, if known, v; repeat for other time steps"),
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="list the problems, or print the file of one --problem")] = False,
    latex: Annotated[bool, option("one --problem as a LaTeX table")] = False,
    out: Annotated[Path | None, option("folder for the page index.html, pictures and records")] = None,
    json_file: Json = None,
) -> None:
    """Errors of integrators on problems whose answers are known to 30 digits.

    Exit status 0: nothing is flagged; 1: an error does not fall with the step, or too slowly, or a run failed.
    """
    from ..schemes.labels import split_runs
    from ..testset.measure import read_trajectory
    from ..testset.problem import folder, problems
    from ..testset.problem import problem as find
    from ..testset.score import score as score_all
    from ..testset.score import score_trajectories

    # What writes one thing takes no option that would be passed over.
    alone = "--list" if show else "--latex" if latex else "--trajectory" if trajectory else None
    others = {
        "INTEGRATORS": integrators, "--trajectory": trajectory and alone != "--trajectory",
        "--latex": latex and alone != "--latex",
        "--out": out if alone in ("--list", "--latex") else None,
        "--json": json_file if alone in ("--list", "--latex") else None,
    }  # fmt: skip
    for name, value in others.items():
        if alone is not None and value:
            raise InputError(name, str(value), f"be left out with {alone}", "give one command for each")
    check_json(json_file)
    if out is not None:
        make_folder(out)  # before the work begins
    names = None if problem is None else [name.strip() for name in problem.split(",")]
    if (trajectory or latex) and (names is None or len(names) != 1):
        option = "--latex" if latex else "--trajectory"
        raise InputError("--problem", problem, f"name one problem for {option}", ", ".join(problems()))
    if latex:
        from ..testset.scorecard import latex_table

        say(latex_table(find(names[0])))  # type: ignore[index]
        return
    if show:
        for name in names or []:
            say(folder().joinpath(f"{find(name).name}.toml").read_text(encoding="utf-8").rstrip("\n"))
        if names is None:
            _list()
        return
    if trajectory:
        label = trajectory[0].name if len(trajectory) == 1 else f"{len(trajectory)} files"
        assert names is not None
        card = score_trajectories(names[0], [read_trajectory(x) for x in trajectory], label)
    else:
        with progress() as bar:
            card = score_all(None if integrators is None else split_runs(integrators), names, progress=bar)
    written = [] if out is None else card.save(out)
    if not write_json("score", card.to_dict(), json_file):
        console(card.width).print(card.tables())
        if written:
            say(f"Written: {written[0]} and {len(written) - 1} files beside it")
    if card.flagged:
        raise typer.Exit(1)


def _list() -> None:
    from ..testset.problem import VERSION, problems

    say(f"Test set {VERSION}")
    for each in problems().values():
        say(f"  {each.name:<22}{each.title}")
