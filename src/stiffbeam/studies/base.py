"""A study: a dataclass of options with points, run, answer and draw. Its records are a pandas DataFrame.

A new study is one module with one subclass of ``Study``; the command line and ``stiffbeam.study`` find it by its name.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import accumulate
from multiprocessing import current_process
from pathlib import Path
from threading import current_thread, main_thread
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from cyclopts import Parameter, Token

from ..basics.arrays import Recent
from ..basics.resources import Show, afford, cores, working
from ..basics.storage import make_folder, source_hash, write_whole
from ..basics.text import plain, with_unit
from ..basics.validation import InputError, exact_float, integer, one_of, sequence
from ..figures.chart import Figure
from ..files.cases import Case
from ..integrators import RECORDED, SCHEME, Integrator, integrators
from ..measures.errors import Order, first_impacts_end, observed_order
from ..measures.report import Report, Reported, extremes
from ..model.scales import scales
from ..model.system import System
from ..references import best_reference, substitute
from ..schemes import RIGID, SCHEMES, Scheme, takes_stops
from ..schemes.labels import label_of_run, make, split_runs, user_source
from ..trajectory.trajectory import Diverged, Reference, SolverFailure

Row = dict[str, Any]
Table = Any  # a pandas.DataFrame, whose columns have no types of their own
STUDIES: dict[str, type[Study]] = {}  # by name, as far as their modules are imported
NOTHING = "No point could be evaluated."


class Answer(NamedTuple):
    """A sentence that answers the question with numbers, the numbers behind it, and remarks on them."""

    verdict: str
    table: Table = pd.DataFrame()
    notes: str = ""


def option(default: Any, help: str, least: int | None = None, known: Iterable[str] = ()) -> Any:
    """A field of a study with its help; ``least``: of an integer option; ``known``: all names that it may hold."""
    return field(default=default, metadata={"help": help, "least": least, "known": tuple(known)})


@dataclass(frozen=True, kw_only=True)
class Study:
    """Base of all studies: fields are options, the first line of the docstring is the question.

    Class variables: ``all_cores``, True where a point uses every core; ``needs_stops`` and ``needs_motion``;
    ``any_step``, True where the study chooses the time steps itself; ``free``, True where the motion touches no stop;
    ``height`` of the picture in inches; ``labels``, the text and the quantity of columns, for axes.
    """

    all_cores: ClassVar[bool] = False
    needs_stops: ClassVar[bool] = False
    needs_motion: ClassVar[bool] = False
    any_step: ClassVar[bool] = False
    free: ClassVar[bool] = False
    height: ClassVar[float] = 6.0
    labels: ClassVar[Mapping[str, tuple[str, str]]] = {}

    def __init_subclass__(cls) -> None:
        STUDIES[cls.name()] = cls

    def __post_init__(self) -> None:
        for each in fields(self):
            value, least, known = getattr(self, each.name), each.metadata.get("least"), each.metadata.get("known")
            if isinstance(value, np.ndarray):
                value = value.tolist()
            if isinstance(value, str) and str(each.type).endswith("Labels"):
                value = names_in(value)  # as on the command line
            if isinstance(value, (list, tuple)):
                object.__setattr__(self, each.name, value := tuple(value))
            for one in value if isinstance(value, tuple) else () if value is None else (value,):
                if least is not None:
                    integer(each.name, one, least)
                if known:
                    one_of(each.name, one, known)

    def points(self, case: Case) -> Iterable[Row]:
        """Arguments of ``run``, by name."""
        raise NotImplementedError

    def run(self, *case: Any, **point: Any) -> Row | list[Row]:
        """Called as run(case, **point). One row or several; the numbers and texts of the point are added to each.

        A row ``{"lost": sentence}`` has the reason why there is no result.
        """
        raise NotImplementedError

    def answer(self, table: Table, case: Case) -> Answer:
        """The answer from the rows that have results."""
        raise NotImplementedError

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """Draw the rows that have results; ``table.attrs["labels"]`` has the labels of columns with their units."""
        raise NotImplementedError

    @property
    def measured(self) -> tuple[str, ...]:
        """Columns that are seconds of this machine, so that points run one by one."""
        return ()

    @classmethod
    def name(cls) -> str:
        """Name of the study: that of the class in small letters."""
        return cls.__name__.lower()

    @classmethod
    def question(cls) -> str:
        """First line of the docstring."""
        return (cls.__doc__ or "").splitlines()[0]

    def require(self, case: Case) -> None:
        """Raise InputError for a case without the stops or the motion that the study needs."""
        if self.needs_stops and not case.has_stops:
            raise InputError("case", case.name, "have stops", f"{self.name()} is about contact")
        if self.needs_motion and scales(case.system(), case.t_end).speed == 0.0:
            remedy = "give it a base motion, a load or initial data"
            raise InputError("case", f"{case.name}, which starts at rest and which nothing drives", "move", remedy)
        if self.needs_motion or self.needs_stops:
            case.system().drive.require_samples(case.t_end)


@dataclass(frozen=True, repr=False)
class Records(Reported):
    """A study of a case with its table.

    Parameters
    ----------
    study : Study
    case : Case
    table : pandas.DataFrame
        One row a result, labels and units of the columns in ``attrs``. A row with a text in the column "lost" has the
        reason why its point has no result.
    """

    study: Study
    case: Case
    table: Table

    @property
    def name(self) -> str:
        """Name of the study."""
        return self.study.name()

    @property
    def found(self) -> Table:
        """The rows with results."""
        if "lost" not in self.table:
            return self.table
        return self.table[self.table["lost"].isna()].drop(columns="lost").dropna(axis="columns", how="all")

    @property
    def lost(self) -> dict[str, int]:
        """Reasons of the points without a result, each with the number of its rows; those that differ in numbers alone
        are one."""
        reasons = self.table["lost"].dropna() if "lost" in self.table else pd.Series(dtype=str)
        alike = reasons.str.replace(r"[\d.]+(e[+-]?\d+)?", "", regex=True)
        return {each.iloc[0]: len(each) for _, each in reasons.groupby(alike, sort=False)}

    @property
    def answer(self) -> Answer:
        """Verdict, table and notes."""
        if not len(self.found):
            return Answer(NOTHING)
        answer = self.study.answer(self.found, self.case)
        other = substitute(self.case.system(), self.case.t_end) if not self.study.free else ""
        return answer._replace(notes=f"{answer.notes} {other}".strip())

    def report(self) -> Report:
        """Question, answer, table and lost points."""
        answer, lost = self.answer, [f"lost ({count}): {reason}" for reason, count in self.lost.items()]
        return Report([self.study.question(), answer.verdict], [("", answer.table)], [answer.notes, *lost])

    def __repr__(self) -> str:
        lost = sum(self.lost.values())
        return f"<Records {self.name} of {self.case.name}: {len(self.table)} rows, {lost} lost>"

    def figure(self) -> Figure:
        """The picture under the answer."""
        from ..figures.chart import finish, heading, new_figure

        figure, table = new_figure(self.study.height), self.found
        if len(table):
            self.study.draw(table, figure, self.case)
        else:
            figure.add_subplot()
        finish(figure, heading(self.case, self.answer.verdict))
        return figure

    def to_dict(self) -> dict[str, Any]:
        """Study, options, answer and rows as plain numbers and texts, for JSON; "measured" names what is timed."""
        options = {f.name: _described(getattr(self.study, f.name)) for f in fields(self.study)}
        answer = self.answer
        return plain({
            "measured": [f"rows.{column}" for column in self.study.measured],
            "study": self.name, "question": self.study.question(), "case": self.case.name,
            "units": list(self.case.units), "options": options,
            "answer": answer.verdict, "notes": answer.notes, "table": answer.table.to_dict("records"),
            "rows": self.table.to_dict("records"),
        })  # fmt: skip

    def save(self, folder: str | Path) -> list[Path]:
        """Write the table as CSV, the answer as text and the picture as PNG into ``folder``."""
        from ..figures.chart import save_figure

        parameter = getattr(self.study, "parameter", "")  # of a sweep or a branch
        stem = f"{self.name}-{parameter}".replace("/", "_") if parameter else self.name
        csv = write_whole(Path(folder) / f"{stem}.csv", self.table.to_csv(index=False))
        text = write_whole(Path(folder) / f"{stem}.txt", f"{self}\n")
        return [csv, text, save_figure(self.figure(), Path(folder) / f"{stem}.png")]


def perform(
    study: Study,
    case: Case,
    jobs: int | None = None,
    folder: str | Path | None = None,
    progress: bool | Show | None = None,
) -> Records:
    """Run every point that ``folder`` does not hold and return the records, see ``study``."""
    from joblib import Parallel, delayed

    study.require(case)
    if jobs is not None:
        integer("jobs", jobs, 1)
    name = study.name()
    with working(name, progress) as show:
        show(f"{name}: planning", 0, 0)
        store, points = Store(folder, _key(study, case)), list(study.points(case))
        threads = max(1, cores() // (jobs or 1))
        work = (delayed(_point)(study, case, point, store, threads) for point in points)
        # A point counts as many times as it has steps, so that the share that is done is one of the time.
        costs = [point.get("steps", 1) for point in points]
        show(name, 0, sum(costs))
        rows = list[Row]()
        finished: Any = Parallel(1 if study.measured else jobs, return_as="generator")(work)
        for part, done in zip(finished, accumulate(costs), strict=True):
            rows += part
            show(name, done, sum(costs))
    table = pd.DataFrame(rows)
    labels = {column: with_unit(case.units, *label) for column, label in study.labels.items()}
    table.attrs = {"study": name, "case": case.name, "units": list(case.units), "labels": labels}
    return Records(study, case, table)


def _point(study: Study, case: Case, point: Row, store: Store, threads: int) -> list[Row]:
    """The rows of a point, from the store if it has them. threads: of an ensemble in a process beside others."""
    if current_process().name != "MainProcess" and current_thread() is main_thread():
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends a worker without a traceback
        os.environ.setdefault("STIFFBEAM_THREADS", str(threads))
    return store.rows(point, lambda: _evaluate(study, case, point))


def _evaluate(study: Study, case: Case, point: Row) -> list[Row]:
    """The rows of a point; a refusal, a run that overflowed and a solver that failed are a row with ``lost``."""
    who = "".join(f"{point[x]}: " for x in ("integrator", "scheme", "method") if x in point)
    try:
        rows = study.run(case, **point)
    except (Diverged, SolverFailure) as error:  # which name the method
        rows = {"lost": str(error)}
    except InputError as error:
        rows = {"lost": f"{who}{error}"}
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        rows = {"lost": f"{who}{type(error).__name__}: {error}"}
    entries = {name: value for name, value in point.items() if not isinstance(value, (list, tuple, dict))}
    return [entries | row for row in ([rows] if isinstance(rows, dict) else rows)]


class Store:
    """Finished points in a folder: one JSON file each, written in one step. A link is never read or followed.

    Its files hold numbers and texts. Their names are hashes of the key and of the point, so that nothing in a file
    selects what is run.
    """

    def __init__(self, folder: str | Path | None, key: Any) -> None:
        self.folder, self.key = None if folder is None else make_folder(folder, "folder"), key

    def rows(self, point: Row, compute: Any) -> list[Row]:
        """Rows of a point: those of its file, else those that ``compute()`` returns. Rows that lost something are not
        kept."""
        file = None
        if self.folder is not None:
            key = json.dumps([self.key, point], sort_keys=True, default=partial(_described, source=True))
            file = self.folder / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.json"
        if file is not None and file.is_file() and not file.is_symlink():
            with suppress(ValueError):  # of a damaged file: its point is evaluated again
                return json.loads(file.read_text(encoding="utf-8"))
        text = json.dumps(compute(), default=_described)  # floats keep every bit
        rows = json.loads(text)  # as a later run reads them
        if file is not None and not any("lost" in row for row in rows):
            write_whole(file, text)
        return rows


def _key(study: Study, case: Case) -> list[Any]:
    """All that the rows of a study depend on."""
    systems = [case.system(form).fingerprint for form in case.forms]
    runs = [f"{scheme}@{form}" for scheme, form in case.runs]
    options = {f.name: _described(getattr(study, f.name), source=True) for f in fields(study)}
    uncertain = {path: repr(one) for path, one in case.uncertain.items()}
    kind = f"{type(study).__module__}:{type(study).__qualname__}"
    return [kind, options, systems, case.grid, case.dt, case.t_end, runs, uncertain, source_hash()]


def _described(value: Any, source: bool = False) -> Any:
    """Text of an option: the label of an integrator, with its ``source`` a hash of a user's module."""
    if isinstance(value, Mapping):
        return {str(name): _described(x, source) for name, x in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_described(x, source) for x in value]
    if isinstance(value, np.generic):
        return value.item()
    if (ppf := getattr(value, "ppf", None)) is not None:  # a distribution, whose repr is an address
        return np.asarray(ppf(np.linspace(0.05, 0.95, 7))).tolist()
    if isinstance(value, Scheme) or callable(value):
        kind = type(value) if isinstance(value, Scheme) else value
        name = f"{kind.__module__}:{getattr(kind, '__qualname__', kind)}"
        label = str(value) if isinstance(value, Scheme) else name
        return f"{label} {name} {user_source(name)}" if source else label
    if isinstance(value, str) and source and ":" in value:
        return f"{value} {user_source(value)}".strip()
    return value if value is None or isinstance(value, (str, int, float)) else repr(value)


# ---------------------------------------------------------------- lists on the command line: with commas between

_SOLVED = Recent[Reference](4)


def _listed(metavar: str, read: Callable[[str], list[Any]]) -> Parameter:
    """Parameter whose texts are each read as a list, and whose help shows its default as such a text."""

    def written(default: Sequence[Any] | None) -> str | None:
        return None if default is None else ",".join(f"{x:g}" if isinstance(x, float) else str(x) for x in default)

    def convert(kind: Any, tokens: Sequence[Token]) -> list[Any]:
        return [value for token in tokens for value in read(token.value)]

    return Parameter(converter=convert, n_tokens=1, negative=(), metavar=metavar, show_default=written)


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
    except (ValueError, ArithmeticError):
        rule = "read start:stop:count, start:stop:count:log with both ends > 0, or numbers with commas between them"
        raise InputError("values", text, rule, "for example 8:14:400") from None
    afford("values", text, "take fewer", floats=200.0 * n)  # each is a point with its rows
    return (np.geomspace if spacing else np.linspace)(low, high, n).tolist()


def names_in(text: str) -> list[str]:
    """The names in a comma-separated text."""
    return [part.strip() for part in split_runs(text)]


Labels = Annotated[Sequence[Any] | None, _listed("NAME,...", names_in)]
Integers = Annotated[Sequence[int] | None, _listed("INT,...", lambda text: list(map(int, text.split(","))))]
Values = Annotated[Sequence[float] | None, _listed("FLOAT,...", read_values)]


VALUES = "start:stop:count, start:stop:count:log, or comma-separated; in the case's units"


# Defaults and helps of options that several studies have.
SCHEME_LABELS = None, "comma-separated, e.g. 'BDF2,HHT(alpha=-0.2)'; default: all that support the case"
FORM = None, "displacement, velocity-curvature or hermite; default: the case's first"
TREATMENT = "implicit", "implicit, conserving, or extrapolated as in the paper"


# ---------------------------------------------------------------- integrators and their runs


def chosen(case: Case, given: Sequence[Any] | None = None) -> dict[str, Integrator]:
    """Return integrators by label: the given ones, or the case's own schemes and every other registered one whose law
    of impact fits its stops. Damped stops it may still refuse.

    A scheme that the case runs on several forms counts once; ``Theta`` with its default is the trapezoidal rule, which
    stands under that name.
    """
    if given is None:
        stated = {type(scheme).__name__: scheme for scheme, _ in reversed(case.runs)}
        known = dict.fromkeys((*SCHEMES, *(RIGID if case.system().rigid else ()), *stated))
        every = {name: stated.get(name) or make(name) for name in known if name != "Theta" or name in stated}
        given = [scheme for name, scheme in every.items() if name in stated or takes(case, scheme)]
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


def clear_orders(orders: Mapping[str, Order]) -> str:
    """The least and the largest order with a narrow interval, which two points do not have, see ``extremes``."""
    slopes = {name: order.slope for name, order in orders.items() if not order.unclear and np.isfinite(order.interval)}
    if not any(map(np.isfinite, slopes.values())):
        return "no clear rate"
    counted = "(all)" if len(slopes) == len(orders) else f"({len(slopes)} of {len(orders)})"
    return extremes(slopes, "{:.2f}".format).replace("(all)", counted)


def order_over(steps: Any, errors: Any) -> Order:
    """The observed order of two columns, where the errors are above 0."""
    return observed_order(steps[errors > 0.0], errors[errors > 0.0])


def solve_once(system: System, t_end: float) -> Reference:
    """``best_reference``, remembered for the next points of the same process."""
    return _SOLVED.get((system.fingerprint, t_end), lambda: best_reference(system, t_end))


def first_impacts(case: Case, form: str, impacts: int) -> float:
    """The end of the case's first impacts, ``impacts`` of them, see ``first_impacts_end``."""
    return first_impacts_end(solve_once(case.system(form), case.t_end), impacts)
