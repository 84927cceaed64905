"""Make the test set anew: data, answers, pictures and page under reference/problems.

    python studies/test_set/make.py                  everything, some ten minutes
    python studies/test_set/make.py NAME ...         these problems and the page
    python studies/test_set/make.py --page           pictures and page from the files that are there

Answers are made here by closed forms in mpmath, or by the package's multiprecision; their second witness is in
tests/testset/test_known_answers.py and shares no code with either.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import mpmath as mp
from definitions import DEFINITIONS, Definition
from derivatives import derivatives
from truth import Truth, text

from stiffbeam.testset.problem import Problem

FOLDER = Path(__file__).parents[2] / "reference" / "problems"
DERIVATIVE_DIGITS = 22
HOW = (
    "at t_end, by paths of parameters; differences of order 8 of the answers in 60 digits, and Taylor series with "
    "variational equations in MPFR (heyoka): they agree to 22 digits"
)


def problem_of(definition: Definition, number: int = 0) -> Problem:
    """The problem without its answers."""
    d = definition
    return Problem(number, d.name, d.title, d.source, d.catches, d.t_end, d.samples, d.steps, d.order_limit, {}, d.data)


def answers_of(definition: Definition, truth: Truth) -> dict[str, tuple[Any, str]]:
    """(value or values, how) by name."""
    found: dict[str, tuple[Any, str]] = {}
    for name, values in (("impacts", truth.impacts), ("releases", truth.releases)):
        if values or (name == "impacts" and values is not None):
            found[name] = (values, f"{truth.how}; by events")
    if truth.peak:
        found["peak_force"] = (truth.peak, truth.how)
    if truth.energy is not None:
        energy, scale, how = truth.energy
        found |= {"energy": (energy, how), "energy_scale": (scale, how)}
    found |= truth.more | definition.more(truth)
    return found | {"tip": (truth.tip, truth.how), "tip_velocity": (truth.velocity, truth.how)}


def toml(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value)


def file_text(number: int, definition: Definition, truth: Truth) -> str:
    """The file of a problem."""
    d = definition
    lines = [f"# Problem {number} of the stiffbeam test set. Made by studies/test_set/make.py; see README.md."]
    for name in ("name", "title", "source", "catches", "t_end", "samples", "steps", "order_limit"):
        lines.append(f"{name} = {toml(getattr(d, name))}")
    lines.insert(1, f"number = {number}")
    lines += ["", "[system]"]
    lists = {key: value for key, value in d.data.items() if key in ("loads", "contacts")}
    lines += [f"{key} = {toml(value)}" for key, value in d.data.items() if key not in lists]
    for key, tables in lists.items():
        for table in tables:
            lines += ["", f"[[system.{key}]]", *(f"{k} = {toml(v)}" for k, v in table.items())]
    for name, (value, how) in answers_of(d, truth).items():
        lines += ["", f"[answers.{name}]"]
        if isinstance(value, list):
            lines += ["value = [", *(f'  "{text(x)}",' for x in value), "]"]
        else:
            lines.append(f'value = "{text(value)}"')
        lines.append(f"how = {toml(how)}")
    return "\n".join(lines) + "\n"


def derivatives_text(definition: Definition) -> str:
    """The derivatives of a problem, as the last section of its file; empty where it has no parameters."""
    if not definition.parameters:
        return ""
    problem = problem_of(definition)
    known = derivatives(
        problem.data, definition.parameters,
        lambda data: definition.truth(replace(problem, data=data, samples=1)),
    )  # fmt: skip
    lines = ["", "[derivatives]", f"how = {toml(HOW)}"]
    for i, what in enumerate(("tip", "tip_velocity")):
        lines += ["", f"[derivatives.{what}]"]
        for path, values in known.items():
            scale = max(map(abs, values))
            digits = mp.nstr(values[i], DERIVATIVE_DIGITS) if abs(values[i]) > mp.mpf(10) ** -30 * scale else "0.0"
            lines.append(f'"{path}" = "{digits}"')
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> None:
    FOLDER.mkdir(exist_ok=True)
    for number, definition in enumerate(DEFINITIONS, start=1):
        if "--page" in arguments or (arguments and definition.name not in arguments):
            continue
        begun = time.perf_counter()
        made = file_text(number, definition, definition.truth(problem_of(definition))) + derivatives_text(definition)
        (FOLDER / f"{definition.name}.toml").write_text(made, encoding="utf-8")
        print(f"{definition.name}: {time.perf_counter() - begun:.1f} s", flush=True)
    from page import write_page

    write_page(FOLDER)


if __name__ == "__main__":
    main(sys.argv[1:])
