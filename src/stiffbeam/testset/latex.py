"""A problem as a table for a paper."""

from __future__ import annotations

from typing import Any

from .problem import VERSION, Answer, Problem

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
