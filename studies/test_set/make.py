"""Make the test set anew: data, answers, pictures and page under reference/problems.

    python studies/test_set/make.py                  everything, some ten minutes
    python studies/test_set/make.py NAME ...         these problems and the page
    python studies/test_set/make.py --page           pictures and page from the files that are there
    python studies/test_set/make.py --check          nothing: an error where a file that takes a second is not as made

Answers are made here by closed forms in mpmath, which the package's references meet, or by the package's
multiprecision, which a witness in tests/testset/test_known_answers.py meets that shares no code with it.
"""

from __future__ import annotations

import sys
import time
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import mpmath as mp
import numpy as np
from definitions import DEFINITIONS, Definition
from derivatives import derivatives
from truth import Truth, text

from stiffbeam.testset.problem import Problem, problems

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


SLOW = ("hertz", "hunt-crossley", "nonsmooth-beam-mode", "table10", "table12", "table14")
DERIVED = ("bilinear-gap", "kelvin-voigt", "impact-oscillator")  # of those with derivatives


def check() -> None:
    """Raise AssertionError where a file differs from what is made: its data, all digits of the answers, the page.

    One problem starts in an eigenvector, which LAPACK rounds as the processor does, to eps (w_max/w_1)^2 < 1e-11 of it:
    its answers are those to the start in the file.
    """
    from page import page_text

    for number, d in enumerate(DEFINITIONS, start=1):
        if d.name in SLOW:
            continue
        there = (FOLDER / f"{d.name}.toml").read_text(encoding="utf-8")
        if d.name == "stop-along-the-beam":
            system = tomllib.loads(there)["system"]
            start = {name: system[name] for name in ("initial_displacement", "initial_velocity")}
            for name, known in start.items():
                assert np.max(np.abs(np.subtract(known, d.data[name]))) <= 1e-11 * np.max(np.abs(known)), name
            d = replace(d, data=d.data | start)
        made = file_text(number, d, d.truth(problem_of(d)))
        assert made == there.partition("\n[derivatives]")[0], d.name
        assert d.name not in DERIVED or there.endswith(derivatives_text(d)), d.name
    assert page_text(list(problems().values())) == (FOLDER / "README.md").read_text(encoding="utf-8")


def main(arguments: list[str]) -> None:
    if arguments == ["--check"]:
        return check()
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
