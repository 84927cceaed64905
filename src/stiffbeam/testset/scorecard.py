"""The scorecard: all measurements of a score, as records, tables, pictures and a page; and a problem in LaTeX."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.storage import write_whole
from ..basics.text import DRAW, several
from ..figures.chart import log_scale, look, mark_order, new_figure, save_figure, say_empty, shared_legend, short
from .measure import FAILED, LOW_ORDER, NOT_FALLING, NOT_TAKEN, Entry, shown_error, summary
from .problem import VERSION, Answer, Problem

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import RenderableType
    from rich.table import Table


@dataclass(frozen=True, repr=False)
class Scorecard:
    """Entries of a score, integrator by integrator and problem by problem.

    Parameters
    ----------
    entries : sequence of Entry
    version : str
        Version of the test set.
    """

    entries: tuple[Entry, ...]
    version: str = VERSION

    @property
    def flagged(self) -> tuple[Entry, ...]:
        """The entries with wrong results, or that broke off."""
        return tuple(entry for entry in self.entries if entry.flagged)

    @property
    def integrators(self) -> list[str]:
        """The names of the integrators, in the order of the entries."""
        return list(dict.fromkeys(entry.integrator for entry in self.entries))

    @property
    def problems(self) -> list[Problem]:
        """The problems, in the order of the entries."""
        return list({entry.problem.name: entry.problem for entry in self.entries}.values())

    def entry(self, integrator: str, problem: str) -> Entry:
        """One entry by integrator and problem; KeyError if there is none."""
        for each in self.entries:
            if (each.integrator, each.problem.name) == (integrator, problem):
                return each
        raise KeyError((integrator, problem))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts, for JSON."""
        return {
            "measured": ["entries.runs.seconds"],
            "test_set": self.version,
            "entries": [entry.to_dict() for entry in self.entries],
        }

    def to_dataframe(self) -> Any:
        """One line per run."""
        from ..basics.text import table

        rows = [
            {"integrator": e.integrator, "problem": e.problem.name, "outcome": e.outcome, "level": r.level,
             "cost": r.cost, "seconds": r.seconds, **asdict(r.errors)}
            for e in self.entries for r in e.runs
        ]  # fmt: skip
        return table({key: [row[key] for row in rows] for key in rows[0]} if rows else {})

    def __repr__(self) -> str:
        counts = several(len(self.integrators), "integrator"), several(len(self.problems), "problem")
        return f"<Scorecard: {', '.join(counts)}, {len(self.flagged)} flagged>"

    def __str__(self) -> str:
        from rich.console import Console

        stream = StringIO()
        Console(file=stream, width=self.width).print(self.tables())
        return stream.getvalue().rstrip()

    @property
    def width(self) -> int:
        """Width of the printed table, in characters."""
        return max(150, 24 + 13 * len(self.integrators))

    def tables(self) -> RenderableType:
        """Tables to print: one integrator in detail, several beside each other."""
        from rich.console import Group

        if len(self.integrators) == 1:
            title = f"{self.integrators[0]}: {summary(self.entries)}"
            rows = list(map(_detail_row, self.entries))
            others = [row for row in rows if any(row[5:-1])]
            # Two tables, each of which fits a terminal; columns without an entry are left out.
            parts: list[RenderableType] = [_table(title, *_columns(rows, (0, 1, 2, 3, 4, 10))), ""]
            parts += [_table(OTHERS, *_columns(others, (0, 5, 6, 7, 8, 9))), ""] if others else []
            parts += [_table(PAST_TITLE, PAST, past), ""] if (past := past_rows(self)) else []
            return Group(*parts, *reasons(self))
        title = f"test set {self.version}: {summary(self.entries)}"
        return Group(_table(title, *overview_rows(self)), LEGEND, "", *reasons(self))

    def _repr_html_(self) -> str:
        return _filled(self)

    def plot(self, ax: Axes | None = None, **kwargs: Any) -> Axes | Figure:
        """Draw the smallest error of every integrator, problem by problem; return ``ax``, or the new Figure. kwargs: of
        ``Axes.plot``."""
        return DRAW["scorecard"](self, ax, **kwargs)

    def figure(self, problem: str) -> Figure:
        """Error against cost on one problem, with its motion."""
        return score_picture([e for e in self.entries if e.problem.name == problem])

    def save(self, folder: str | Path) -> list[Path]:
        """Write the page index.html, score.json and a picture of each problem that an integrator has taken."""
        folder, pictures, sections = Path(folder), list[Path](), list[dict[str, Any]]()
        for problem in self.problems:
            entries = [e for e in self.entries if e.problem is problem]
            rows = [
                [(short(e.integrator), row[0][1]), *row[1:]] for e, row in zip(entries, _rows(entries), strict=True)
            ]
            sections.append({"problem": problem, "rows": rows, "picture": None})
            if any(e.runs for e in entries):
                sections[-1]["picture"] = f"{problem.name}.png"
                pictures.append(save_figure(score_picture(entries), folder / f"{problem.name}.png"))
        records = json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"
        page = write_whole(folder / "index.html", _filled(self, sections))
        return [page, write_whole(folder / "score.json", records), *pictures]


def motion(axis: Axes, problem: Problem) -> None:
    """The known tip positions with the stops of the first contact, and the known impacts."""
    from scipy.interpolate import CubicHermiteSpline

    contact = problem.data["contacts"][0]
    t, u, v = problem.times, problem.answers["tip"].value, problem.answers["tip_velocity"].value
    # Impacts on rigid stops turn the velocity between samples, where a cubic would not.
    if "impacts" not in problem.answers or not problem.rigid:
        fine = np.linspace(t[0], t[-1], 1500)
        axis.plot(fine, CubicHermiteSpline(t, u, v)(fine), color="black", lw=1.0)
    axis.plot(t, u, "o", color="black", ms=2.5, label="known")
    if problem.data.get("observe", contact["row"]) == contact["row"] and "offset" not in contact:
        sides = [side for side in ("lower", "upper") if side in contact]
        for side in sides:
            axis.axhline(contact[side], color="#D55E00", lw=1.0, label="stop" if side == sides[0] else None)
    if "impacts" in problem.answers:
        when = problem.answers["impacts"].value
        axis.plot(when, np.full(len(when), 0.02), "|", color="#D55E00", ms=9, transform=axis.get_xaxis_transform(),
                  label="impacts")  # fmt: skip
    axis.set(xlabel="t", ylabel="u(t)")


def problem_picture(problem: Problem) -> Figure:
    """The motion of a problem."""
    figure = new_figure(2.6, width=8.0)
    axis = figure.subplots()
    motion(axis, problem)
    figure.legend(*axis.get_legend_handles_labels(), loc="outside upper right", fontsize=8, frameon=False, ncols=3)
    return figure


def score_picture(entries: Sequence[Entry]) -> Figure:
    """The motion of the entries' problem, the error of the tip against the cost, and that of the impact times."""
    problem = entries[0].problem
    figure = new_figure(3.6, problem.title)
    left, middle, right = figure.subplots(1, 3)
    motion(left, problem)
    for e in (e for e in entries if e.runs):
        cost = np.array([r.cost for r in e.runs], float)
        style = look(e.integrator) | {"ms": 4, "lw": 1.2}
        for axis, of in ((middle, "tip_rms"), (right, "impact_time")):
            errors = np.array([abs(getattr(r.errors, of)) for r in e.runs])
            axis.plot(cost, np.maximum(errors, 1e-16), **style, label=short(e.integrator))
    for axis, label in ((middle, "rms error of u over max |u|"), (right, "largest error of impact times")):
        axis.set(xlabel="stages, or right-hand sides", ylabel=label)
        if any(np.any(np.isfinite(np.asarray(line.get_ydata(), float))) for line in axis.lines):
            log_scale(axis)
        else:
            say_empty(axis, "no impact times are told")
    mark_order(middle, [-2.0], y=0.95)  # errors fall to the right: above them is room
    shared_legend(figure, 6)
    return figure


Row = list[tuple[str, str]]  # text and class of every cell


def _filled(card: Scorecard, sections: Sequence[dict[str, Any]] | None = None) -> str:
    """page.html with the numbers of the scorecard; its tables alone without ``sections``."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader(Path(__file__).parent)
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    if len(card.integrators) == 1:
        headings, rows, legend = list(COLUMNS), _rows(card.entries), ""
    else:
        headings, texts = overview_rows(card)
        rows, legend = [[(text, _kind(text)) for text in row] for row in texts], LEGEND
    return environment.get_template("page.html").render(
        card=card, headings=headings, rows=rows, legend=legend, sections=sections, summary=summary(card.entries),
        reasons=reasons(card), columns=["integrator", *COLUMNS[1:]], past_title=PAST_TITLE, past_columns=PAST,
        past=[[(text, "") for text in row] for row in past_rows(card)],
    ).lstrip()  # fmt: skip


def _rows(entries: Sequence[Entry]) -> list[Row]:
    """Rows of ``_detail_row`` with their classes."""
    kinds = ["flag" if e.flagged else "off" if e.outcome == NOT_TAKEN else "" for e in entries]
    rows = zip(map(_detail_row, entries), kinds, strict=True)
    return [[*((text, kind) for text in row[:-1]), (row[-1], "outcome")] for row, kind in rows]


def _kind(cell: str) -> str:
    return "flag" if cell.endswith((" !", " <", "failed")) else "off" if cell == "–" else ""


MARKS = {NOT_FALLING: " !", LOW_ORDER: " <", FAILED: "failed", NOT_TAKEN: "–"}
LEGEND = (
    "rms error of the tip at the finest step or tolerance, over the largest displacement. ! this or another error does "
    "not fall with the step, or misses the tolerance. < the order is too low. – not supported"
)
LONG = 12  # letters of a heading that stay on one line
PAST_TITLE = "Past the horizon: deviation of one run, in standard deviations of the exact motions"
ODD = 0.1  # of a velocity: what it is off by where more than the step is wrong with it
COLUMNS = (
    "problem",
    "error, coarsest",
    "finest",
    "order",
    "expected",
    "impacts",
    "impact times",
    "peak force",
    "energy",
    "gradient",
    "outcome",
)


OTHERS = "Errors besides the tip's, at the finest step or tolerance"


def _columns(rows: list[list[str]], wanted: Sequence[int]) -> tuple[list[str], list[list[str]]]:
    """Headings and cells of these ``COLUMNS``, without those that are empty in all rows."""
    kept = [i for i in wanted if i in (0, 10) or any(row[i] for row in rows)]
    return [COLUMNS[i] for i in kept], [[row[i] for i in kept] for row in rows]


def _detail_row(e: Entry) -> list[str]:
    """The row of an entry, as ``COLUMNS``."""
    if not e.runs:
        return [e.problem.name, *[""] * (len(COLUMNS) - 2), e.outcome]
    last = e.runs[-1].errors
    return [
        e.problem.name,
        shown_error(e.runs[0].errors.tip_rms) if len(e.runs) > 1 else "",
        shown_error(last.tip_rms),
        str(e.order) if np.isfinite(e.order.interval) else "",
        _expected(e),
        f"{last.impacts}{_known(e)}" if last.impacts >= 0 else "",
        *(shown_error(abs(x)) for x in (last.impact_time, last.peak_force)),
        f"{last.energy:+.1e}" if np.isfinite(last.energy) else "",
        shown_error(last.gradient),
        e.outcome,
    ]


def _expected(e: Entry) -> str:
    """The expected order; for an integrator of unknown order the largest that the problem allows."""
    if np.isfinite(e.expected) or e.adaptive or e.problem.order_limit <= 0.0:
        return f"{e.expected:.3g}" if np.isfinite(e.expected) else ""
    return f"≤ {e.problem.order_limit:.3g}"


def _known(e: Entry) -> str:
    """Number of impacts that the file lists, infinite where they are the first of infinitely many."""
    if "impacts" not in e.problem.answers:
        return ""
    return " of ∞" if "accumulation" in e.problem.answers else f" of {len(e.problem.answers['impacts'].digits)}"


PAST = ("integrator", "problem", "to t =", "steps", "impacts", "contact fraction", "median peak")


def past_rows(card: Scorecard) -> list[list[str]]:
    """Errors of each integrator's statistics, in standard deviations of the exact motions."""
    return [
        [short(e.integrator), e.problem.name, f"{e.problem.statistics.t_end:g}", f"{row['steps']:.0f}",
         *(f"{row[name]:+.1f}" for name in e.problem.statistics.values)]
        for e in card.entries for row in e.past if e.problem.statistics is not None
    ]  # fmt: skip


def overview_rows(card: Scorecard) -> tuple[list[str], list[list[str]]]:
    """Headings, and one row for each problem with every integrator's finest error."""
    rows = [[problem.name, *[""] * len(card.integrators)] for problem in card.problems]
    for e in card.entries:
        error = shown_error(e.best.tip_rms) if e.best and e.outcome not in (FAILED, NOT_TAKEN) else ""
        row = next(row for row in rows if row[0] == e.problem.name)
        row[1 + card.integrators.index(e.integrator)] = error + MARKS.get(e.outcome, "")
    return ["problem", *(short(name) for name in card.integrators)], rows


def reasons(card: Scorecard) -> list[str]:
    """Every flagged or refused entry as a sentence; equal reasons of several problems share one line."""
    lines = [_words(e) for e in card.flagged if not (e.outcome == LOW_ORDER and e.missed)]  # those have a reason
    told: dict[tuple[str, str], list[str]] = {}  # the problems by integrator and reason
    for e in card.entries:
        if e.runs and e.reason:
            told.setdefault((short(e.integrator), e.reason), []).append(e.problem.name)
    lines += [f"{who} on {', '.join(names)}: {reason}" for (who, reason), names in told.items()]
    lines += [_words(e) for e in card.entries if not e.flagged and _remark(e)]
    refused: dict[tuple[str, str], list[Entry]] = {}  # by integrator and the field that is refused
    for e in card.entries:
        if e.outcome == NOT_TAKEN:
            refused.setdefault((e.integrator, e.reason.partition(" must ")[0]), []).append(e)
    together: dict[tuple[str, tuple[str, ...]], list[Entry]] = {}  # by that field and the problems
    for (_, field), entries in refused.items():
        together.setdefault((field, tuple(e.problem.name for e in entries)), []).append(entries[0])
    for (_, names), first in together.items():
        who = ", ".join(short(e.integrator) for e in first)
        lines.append(f"not taken by {who}: {', '.join(names)}: {first[0].reason}")
    return lines


def _words(e: Entry) -> str:
    where = f"{short(e.integrator)} on {e.problem.name}"
    if e.outcome == FAILED:
        return f"{where} failed: {e.reason}"
    if e.outcome == LOW_ORDER:
        return f"{where}: order {e.order}, {e.expected:.3g} expected"
    if _remark(e):
        return f"{where}: {_remark(e)}"
    if e.missed:
        few = "" if len(e.runs) > 3 else f"; {len(e.runs)} time steps may mislead: score more of them"
        return f"{where}: the tip converges, but not {', '.join(e.missed)}{few}"
    first, last = (shown_error(run.errors.tip_rms) for run in (e.runs[0], e.runs[-1]))
    hint = "; a fixed tolerance, or another system?" if first == last and not e.adaptive else ""
    return f"{where}: the error does not fall, {first} to {last}{hint}"


def _remark(e: Entry) -> str:
    """Hint if the finest run is the right motion except for a factor, of it, its times or its velocity."""
    if not e.runs:
        return ""
    errors = e.runs[-1].errors
    if np.isfinite(errors.factor):
        sort = "units?" if errors.factor > 0.0 else "signs?"
        return f"the right motion times a constant factor of {errors.factor:.4g}: {sort}"
    if np.isfinite(errors.clock):
        return f"the right motion, but its times are {errors.clock:g} times as long: units?"
    if abs(errors.rate) > ODD and errors.velocity > ODD > errors.tip_rms:
        sort = "units?" if errors.rate > -1.0 else "signs?"
        return f"the velocity is the rate of the position over {1.0 + errors.rate:.4g}: {sort}"
    return ""


def _table(title: str, headings: Sequence[str], rows: list[list[str]]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for i, heading in enumerate(headings):
        # A long heading is broken between words.
        broken = heading.replace("(", "\n(").replace(", ", ",\n") if len(heading) > LONG else heading
        table.add_column(broken, justify="right" if 0 < i < len(headings) - (headings[-1] == "outcome") else "left",
                         no_wrap=heading == "problem", overflow="fold")  # fmt: skip
    for row in rows:
        table.add_row(*row)
    return table


_SPECIAL = str.maketrans({"_": r"\_", "&": r"\&", "%": r"\%", "#": r"\#", "^": r"\textasciicircum{}"})


def latex_table(problem: Problem, digits: int = 20) -> str:
    """Title, data and answers of ``problem`` as a LaTeX table (booktabs); matrices larger than 3 x 3 by their size.

    digits: significant ones of the answers. The many values of ``tip`` are given by the last.
    """
    rows = [("system", _system(problem)), ("time", f"$0 \\le t \\le {problem.t_end:g}$")]
    for i, contact in enumerate(problem.data.get("contacts", ())):
        law = ", ".join(
            f"{key.replace('_', ' ')} ${_number(x)}$" for key, x in contact.items() if key not in ("row", "offset")
        )
        rows.append(("contact" if len(problem.data["contacts"]) == 1 else f"contact {i + 1}", law))
    for name, answer in problem.answers.items():
        if name not in ("energy_scale", "tip_velocity"):
            rows.append((_label(name, problem), _value(answer, digits)))
    body = "\n".join(f"  {left.translate(_SPECIAL)} & {right} \\\\" for left, right in rows)
    source = problem.source.translate(_SPECIAL)
    return (
        "\\begin{table}\n  \\caption{"
        + f"{problem.title.translate(_SPECIAL)} (\\texttt{{{problem.name}}}, stiffbeam test "
        f"set {VERSION}). {source}.}}\n  \\begin{{tabular}}{{ll}}\n  \\toprule\n{body}\n  \\bottomrule\n"
        "  \\end{tabular}\n\\end{table}"
    )


def _label(name: str, problem: Problem) -> str:
    return f"u at t = {problem.t_end:g}" if name == "tip" else name.replace("_", " ")


def _value(answer: Answer, digits: int) -> str:
    values = [answer.digits] if isinstance(answer.digits, str) else list(answer.digits)
    shown = values[-1:] if len(values) > 12 else values
    return ", ".join(f"${_round(x, digits)}$" for x in shown)


def _round(x: str, digits: int) -> str:
    from decimal import Context, Decimal

    return _number(str(Context(prec=digits).plus(Decimal(x)).normalize()))


def _number(x: Any) -> str:
    text = f"{x}"
    head, e, tail = text.upper().partition("E")
    return "\\infty" if text == "inf" else f"{head} \\cdot 10^{{{int(tail)}}}" if e else text


def _system(problem: Problem) -> str:
    n = len(problem.data["initial_displacement"])
    parts = []
    for symbol, name in (("M", "mass"), ("C", "damping"), ("K", "stiffness")):
        given = problem.data.get(name)
        if isinstance(given, list) and n <= 3:
            inside = r" \\ ".join(" & ".join(f"{x:g}" for x in row) for row in given)
            parts.append(
                f"${symbol} = \\begin{{pmatrix}} {inside} \\end{{pmatrix}}$" if n > 1 else f"${symbol} = {inside}$"
            )
    start, speed = (
        ", ".join(_number(x) for x in problem.data[f"initial_{name}"]) for name in ("displacement", "velocity")
    )
    at_start = f"$q(0) = ({start})$, $q'(0) = ({speed})$"
    return ", ".join([*parts, at_start]) if n <= 3 else f"{n} unknowns, see the file of the problem"
