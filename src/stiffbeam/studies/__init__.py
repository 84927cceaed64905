"""Studies: each answers a question about a case with a table, a sentence and a picture, see ``base.Study``."""

from __future__ import annotations

from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from ..basics.resources import Show
from ..basics.validation import instance, one_of
from ..files.cases import Case, case_of, find_case
from ..model.system import System
from .base import STUDIES, Answer, Records, Study, option, perform


def studies() -> dict[str, type[Study]]:
    """Every study of the package and every other subclass of ``Study`` that is imported, by name."""
    for module in iter_modules([str(Path(__file__).parent)]):
        import_module(f".{module.name}", __name__)
    return dict(sorted(STUDIES.items()))


def find_study(name: str) -> type[Study]:
    """The study with this name. Raises InputError for any other name."""
    there = isinstance(name, str)
    if there and name not in STUDIES and (Path(__file__).parent / f"{name}.py").is_file():
        import_module(f".{name}", __name__)
    known = STUDIES if there and name in STUDIES else studies()
    return known[one_of("study", name, known, "be a study")]


def study(
    name: str,
    case: Case | System | str = "table10",
    *,
    dt: float | None = None,
    t_end: float | None = None,
    jobs: int | None = None,
    folder: str | Path | None = None,
    progress: bool | Show | None = None,
    **options: Any,
) -> Records:
    """Return the records of a study on a case or system.

    Parameters
    ----------
    name : str
        Such as "converge", "energy" or "sweep"; ``stiffbeam study --help`` lists all.
    case : str, Case or System
        The label of a case, a case, or a system (with dt= and t_end=; "advise" needs no dt).
    dt, t_end : float, optional
        In place of the case's.
    jobs : int, optional
        Processes, by joblib: with ``joblib.parallel_config`` its backend runs the points, that of Dask too.
    folder : path, optional
        Folder of finished points: a second call with the same folder computes the missing ones only.
    progress : bool or callable
        True shows a bar on stderr.
    **options
        Options of the study, as its command lists them.

    Returns
    -------
    Records
        With ``answer``, ``table`` (a pandas DataFrame), ``figure()`` and ``save(folder)``.

    Raises
    ------
    InputError
        For an unknown study or option, and for a case that the study does not support.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> records = sb.study("modes", "table10", schemes=["BDF2", "HHT(alpha=-0.1)"], steps=400)
    >>> "period_elongation" in records.table
    True
    """
    kind = find_study(name)
    for given in options:
        one_of(f"option of {name}", given, [f.name for f in fields(kind)], "be one the study has")
    if isinstance(case, System):
        case = case_of(case, t_end if dt is None and kind.any_step else dt, t_end)
    case = find_case(case) if isinstance(case, str) else case
    instance("case", case, Case, "for example 'table10'", "be a case, its name, a case file, or a System")
    case = replace(case, **{name: x for name, x in (("dt", dt), ("t_end", t_end)) if x is not None})
    return perform(kind(**options), case, jobs, folder, progress)


__all__ = ["STUDIES", "Answer", "Records", "Study", "find_study", "option", "studies", "study"]
