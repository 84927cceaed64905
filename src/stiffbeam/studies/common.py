"""Options and helpers of several studies: schemes by label, references solved once, orders, texts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter, Token

from ..basics.arrays import Recent
from ..basics.resources import afford
from ..basics.validation import InputError, exact_float, sequence
from ..figures.chart import short
from ..files.cases import Case
from ..integrators import RECORDED, SCHEME, Integrator, integrators
from ..measures.errors import Order, first_impacts_end, observed_order
from ..model.system import System
from ..references import best_reference
from ..schemes import RIGID, SCHEMES, Scheme, takes_stops
from ..schemes.labels import label_of_run, make, split_runs
from ..trajectory.trajectory import Reference
from .base import Table, option

_SOLVED = Recent[Reference](4)


# ---------------------------------------------------------------- lists on the command line: with commas between


def _labels(kind: Any, tokens: Sequence[Token]) -> list[str]:
    return [part.strip() for token in tokens for part in split_runs(token.value)]


def _integers(kind: Any, tokens: Sequence[Token]) -> list[int]:
    return [int(part) for token in tokens for part in token.value.split(",")]


def read_values(text: str) -> list[float]:
    """``start:stop:count``, evenly spaced, ``start:stop:count:log``, or numbers with commas between them, each as in a
    case file: "2*pi*50" too."""
    try:
        if ":" not in text:
            return [float(exact_float(part)) for part in text.split(",")]
        start, stop, count, *spacing = text.split(":")
        low, high, n = float(exact_float(start)), float(exact_float(stop)), int(count)
        if n < 1 or spacing not in ([], ["log"]) or (spacing and min(low, high) <= 0.0):
            raise ValueError
    except ValueError:
        rule = "read start:stop:count, start:stop:count:log with both ends > 0, or numbers with commas between them"
        raise InputError("values", text, rule, "for example 8:14:400") from None
    afford("values", text, "take fewer", floats=200.0 * n)  # each is a point with its rows
    return (np.geomspace if spacing else np.linspace)(low, high, n).tolist()


def _values(kind: Any, tokens: Sequence[Token]) -> list[float]:
    return [value for token in tokens for value in read_values(token.value)]


Labels = Annotated[Sequence[Any] | None, Parameter(converter=_labels, n_tokens=1, negative=())]
Integers = Annotated[Sequence[int] | None, Parameter(converter=_integers, n_tokens=1, negative=())]
Values = Annotated[Sequence[float] | None, Parameter(converter=_values, n_tokens=1, negative=())]


VALUES = "start:stop:count, start:stop:count:log, or comma-separated; in the case's units"


def schemes() -> Any:
    """The option ``schemes``."""
    return option(None, "comma-separated, e.g. 'BDF2,HHT(alpha=-0.2)'; default: all that support the case")


def form() -> Any:
    """The option ``form``."""
    return option(None, "displacement, velocity-curvature or hermite; default: the case's first")


def treatment() -> Any:
    """The option ``contact``."""
    return option("implicit", "implicit, conserving, or extrapolated as in the paper")


# ---------------------------------------------------------------- integrators and their runs


def chosen(case: Case, given: Sequence[Any] | None = None) -> dict[str, Integrator]:
    """Return integrators by label: the given ones, or the case's own schemes and every other registered one that
    supports its stops and its damping.

    A scheme that the case runs on several forms counts once; ``Theta`` with its default is the trapezoidal rule, which
    stands under that name.
    """
    if given is None:
        stated: dict[str, Scheme] = {}
        for scheme, _ in case.runs:
            stated.setdefault(scheme.name, scheme)
        rigid = RIGID if case.system().rigid else {}
        others = {name: make(name) for name in (*SCHEMES, *rigid) if name != "Theta" and name not in stated}
        every = stated | {name: scheme for name, scheme in others.items() if takes(case, scheme)}
        given = [every[name] for name in dict.fromkeys((*SCHEMES, *RIGID, *stated)) if name in every]
    each = integrators(sequence("schemes", given, "be integrators", "for example ['HHT(alpha=-0.1)']"))
    for x in each:
        if x.kind == RECORDED:
            raise InputError("integrators", x.label, "be able to run", "pass recorded runs to compare or score")
    named = [replace(x, label=label_of_run(x.source)) if x.kind == SCHEME else x for x in each]
    return {x.label: x for x in named}


def chosen_schemes(case: Case, given: Sequence[Any] | None = None) -> dict[str, Scheme]:
    """``chosen``, of schemes alone. Raises InputError for any other integrator."""
    for label, each in (picked := chosen(case, given)).items():
        if each.kind != SCHEME:
            raise InputError("schemes", label, "be schemes or their labels", "for example 'HHT(alpha=-0.1)'")
    return {label: each.source for label, each in picked.items()}


def takes(case: Case, scheme: Scheme) -> bool:
    """Return True if ``scheme`` supports the stops of the case."""
    return takes_stops(scheme, (c.stops for c in case.system().contacts))


def extremes(values: Mapping[str, float], written: Callable[[float], str]) -> str:
    """The least and the largest of the numbers that are known, each with the short name of its method."""
    known = sorted((value, short(name)) for name, value in values.items() if np.isfinite(value))
    if not known:
        return "not known"
    (low, first), (high, last) = known[0], known[-1]
    if written(low) == written(high):
        return f"{written(low)} ({first if len(known) == 1 else 'all'})"
    return f"{written(low)} ({first}) to {written(high)} ({last})"


def order_over(table: Table, step: Callable[[Table], Any], error: str) -> Order:
    """The observed order of column ``error`` in a step that is taken from the table, of errors above 0."""
    kept = table[table[error] > 0.0]
    return observed_order(step(kept), kept[error])


def solve_once(system: System, t_end: float) -> Reference:
    """``best_reference``, remembered for the next points of the same process."""
    return _SOLVED.get((system.fingerprint, t_end), lambda: best_reference(system, t_end))


def first_impacts(case: Case, form: str, impacts: int) -> float:
    """The end of the case's first impacts, ``impacts`` of them, see ``first_impacts_end``."""
    return first_impacts_end(solve_once(case.system(form), case.t_end), impacts)
