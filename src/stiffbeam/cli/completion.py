"""Completion of values on the command line: cases, schemes, methods, problems, and lists of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

Complete = Callable[[str], list[str]]


def one_of(names: Callable[[], Iterable[str]]) -> Complete:
    """Return the completion of one name."""
    return lambda incomplete: [name for name in names() if name.startswith(incomplete)]


def list_of(names: Callable[[], Iterable[str]]) -> Complete:
    """Return the completion of the last name of a list; a comma inside parentheses separates no names."""

    def complete(incomplete: str) -> list[str]:
        from ..schemes.labels import split_runs

        last = split_runs(incomplete)[-1] if incomplete else ""
        before = incomplete[: len(incomplete) - len(last)]
        return [before + name for name in one_of(names)(last)]

    return complete


def cases(incomplete: str) -> list[str]:
    """Return the paper's tables, case files, and the folders that lead to them."""
    from ..files.cases import paper_cases

    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    files = [path for path in (folder.iterdir() if folder.is_dir() else ()) if not path.name.startswith(".")]
    paths = [f"{path}/" if path.is_dir() else str(path) for path in files if path.is_dir() or path.suffix == ".toml"]
    return [name for name in [*paper_cases(), *sorted(paths)] if name.startswith(incomplete)]


def _schemes() -> list[str]:
    from ..schemes.registry import RIGID, SCHEMES

    return [kind.__name__ for kind in (*SCHEMES.values(), *RIGID.values())]


def _methods() -> list[str]:
    from ..references.registry import REFERENCES

    return list(REFERENCES)


def _problems() -> list[str]:
    from ..testset.problem import problems

    return list(problems())


schemes, methods, problems = list_of(_schemes), list_of(_methods), list_of(_problems)
integrators = list_of(lambda: [*_schemes(), *_methods()])
form = one_of(lambda: ("displacement", "velocity-curvature", "hermite"))
contact = one_of(lambda: ("implicit", "extrapolated", "conserving", "averaged"))
BY_OPTION: dict[str, Complete] = {
    "schemes": schemes,
    "scheme": schemes,
    "method": methods,
    "contact": contact,
    "form": form,
}
