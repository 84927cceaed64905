"""Cases: the paper's 17 tables and a user's own files, one form for both."""

from __future__ import annotations

import ast
import re
import tomllib
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from .contact import Stops
from .problem import BeamProblem, DistributedLoad, Load, PointLoad
from .schemes import Scheme, make
from .semidiscretisation import FORMS
from .time_functions import Constant, Harmonic
from .validation import InputError, near, positive, step_count


@dataclass(frozen=True)
class Case:
    """A problem with the grid, step, time span and runs to make of it.

    runs: (scheme, form) pairs. published: what the source reports, by kind and run. notes: what is
    inferred rather than stated, each with its reason.
    """

    name: str
    title: str
    problem: BeamProblem
    cells: int
    dt: float
    t_end: float
    runs: tuple[tuple[Scheme, str], ...]
    published: dict[str, dict[str, float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def paper_case(table: int) -> Case:
    """Table 1..17 of Dumont (2002)."""
    return find_case(f"table{table}")


def find_case(name: str) -> Case:
    """A case by name: ``table1`` .. ``table17``, a TOML file with one case, or ``file.toml:case``."""
    known = paper_cases()
    if name in known:
        return known[name]
    file = case_file(name)
    wanted = name[len(file) + 1 :]
    if file.endswith(".toml") or Path(file).is_file():
        cases = load_cases(Path(file))
        if wanted:
            if wanted not in cases:
                raise InputError("case", wanted, f"be one of the cases in {file}", near(wanted, cases))
            return cases[wanted]
        if len(cases) > 1:
            raise InputError("case", name, "name one case of the file", f"{name}:" + f" or {name}:".join(cases))
        return next(iter(cases.values()))
    raise InputError("case", name, "be a table of the paper or a TOML file", near(name, known))


def case_file(name: str) -> str:
    """The file in ``file.toml`` or ``file.toml:case``."""
    head, separator, _ = name.partition(".toml:")
    return head + ".toml" if separator else name


@cache
def paper_cases() -> dict[str, Case]:
    """The paper's tables by name, in order."""
    return _parse(tomllib.loads(paper_text()), "paper.toml")


def paper_text() -> str:
    """The data file of the paper's tables, for a start of one's own."""
    return files("stiffbeam").joinpath("paper.toml").read_text(encoding="utf-8")


def case_text(name: str) -> str:
    """The case as the TOML of a file of its own; ``name`` as in ``find_case``."""
    case = find_case(name)
    text = paper_text() if name in paper_cases() else Path(case_file(name)).read_text(encoding="utf-8")
    blocks = ["[[case]]" + block.rstrip() + "\n" for block in re.split(r"(?m)^\[\[case\]\]", text)[1:]]
    return next(block for block in blocks if tomllib.loads(block)["case"][0].get("name") == case.name)


def parse_case(text: str, source: str) -> Case:
    """The one case in a TOML text."""
    return next(iter(_parse(tomllib.loads(text), source).values()))


def load_cases(file: Path) -> dict[str, Case]:
    """The cases of a TOML file by name. Raises InputError naming file, field, value and rule."""
    try:
        data = tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError("case file", str(file), "exist") from None
    except OSError as error:
        raise InputError("case file", str(file), "be a readable file", str(error)) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError("case file", str(file), "be valid TOML", str(error)) from None
    return _parse(data, str(file))


def parse_run(text: str, default_form: str = "displacement") -> tuple[Scheme, str]:
    """``name(parameter=value, ...)[.printed[(erratum)]][@form]`` as (scheme, form).

    For example ``bdf2``, ``hht(alpha=-0.1)@displacement``, ``sdirk(gamma=0.4359, nystrom=true)``,
    ``sdirk.printed(sigma)@velocity-curvature``.
    """
    pattern = (
        r"\s*(?P<name>[\w-]+)\s*(\((?P<args>[^()]*)\))?"
        r"\s*(?P<printed>\.printed(\((?P<errata>[^()]*)\))?)?"
        r"\s*(@\s*(?P<form>[\w-]+))?\s*"
    )
    match = re.fullmatch(pattern, text)
    if not match:
        raise InputError("scheme", text, "read name(parameter=value, ...)@form", "e.g. hht(alpha=-0.1)@displacement")
    parameters: dict[str, Any] = {}
    for item in filter(None, (match["args"] or "").split(",")):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals:
            raise InputError("scheme", text, "name every parameter", "for example hht(alpha=-0.1)")
        if key in parameters:
            raise InputError("scheme", text, f"give {key} once")
        try:
            truth = {"true": True, "false": False}
            parameters[key] = truth[value.lower()] if value.lower() in truth else ast.literal_eval(value)
        except (ValueError, SyntaxError):
            raise InputError("scheme", text, f"give {key} a number, true or false") from None
    scheme = make(match["name"], **parameters)
    if match["printed"]:
        scheme = scheme.printed(*filter(None, (e.strip() for e in (match["errata"] or "").split(","))))
    form = match["form"] or default_form
    if form not in FORMS:
        raise InputError("form", form, "be one of the paper's forms", near(form, FORMS))
    return scheme, form


def split_runs(text: str) -> list[str]:
    """A comma-separated list of runs; commas inside parentheses belong to the run."""
    return [part for part in re.split(r",(?![^(]*\))", text) if part.strip()]


# ---------------------------------------------------------------- the file's form


def _parse(data: dict[str, Any], source: str) -> dict[str, Case]:
    cases: dict[str, Case] = {}
    entries = data.get("case")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{source}: case", entries, "be one or more [[case]] tables")
    unknown = set(data) - {"case"}
    if unknown:
        raise InputError(f"{source}: {min(unknown)}", data[min(unknown)], "stand inside a [[case]] table")
    for entry in entries:
        if not isinstance(entry, dict):
            raise InputError(f"{source}: case", entry, "be a table", "write [[case]]")
        case = _Reader(entry, f"{source}: {entry.get('name', 'case')}").case()
        if case.name in cases:
            raise InputError(f"{source}: name", case.name, "be given once")
        cases[case.name] = case
    return cases


@dataclass
class _Reader:
    """Reads one table field by field; every complaint names file, field, value and rule."""

    table: dict[str, Any]
    where: str

    def error(self, field: str, value: Any, rule: str, remedy: str = "") -> InputError:
        return InputError(f"{self.where}: {field}", value, rule, remedy)

    def only(self, known: set[str]) -> None:
        for key in self.table:
            if key not in known:
                raise self.error(key, self.table[key], "be a known field", near(key, sorted(known)))

    def get(self, field: str, kind: type | tuple[type, ...], rule: str, default: Any = ...) -> Any:
        if field not in self.table:
            if default is ...:
                raise self.error(field, None, f"be given and {rule}")
            return default
        value = self.table[field]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.error(field, value, rule)
        return value

    def number(self, field: str, default: Any = ...) -> Any:
        return self.get(field, (int, float), "be a number", default)

    def sub(self, field: str) -> _Reader | None:
        table = self.get(field, dict, "be a table", None)
        return None if table is None else _Reader(table, f"{self.where}.{field}")

    def polynomial(self, field: str) -> Any:
        coefficients = self.get(field, list, "be a list of polynomial coefficients, constant first", None)
        if coefficients is None:
            return None
        if not coefficients or not all(isinstance(c, (int, float)) and not isinstance(c, bool) for c in coefficients):
            raise self.error(field, coefficients, "be a list of polynomial coefficients, constant first")
        return Polynomial(np.array(coefficients, float))

    def build(self, make_it: Any, *args: Any, **kwargs: Any) -> Any:
        """``make_it`` with its complaints placed in this file."""
        try:
            return make_it(*args, **kwargs)
        except InputError as error:
            raise InputError(f"{self.where}: {error.field}", error.value, error.rule, error.remedy) from None

    def case(self) -> Case:
        self.only({"name", "title", "cells", "dt", "t_end", "runs", "inferred", "problem", "published"})
        name = self.get("name", str, "be a string")
        problem = self.sub("problem")
        if problem is None:
            raise self.error("problem", None, "be given and be a table")
        runs = self.get("runs", list, "be a list of runs", ["bdf2", "sdirk(nystrom=true)", "hht"])
        cells = self.get("cells", int, "be an integer >= 4")
        if cells < 4:
            raise self.error("cells", cells, "be an integer >= 4")
        dt, t_end = self.number("dt"), self.number("t_end")
        for key, value in (("dt", dt), ("t_end", t_end)):
            self.build(positive, key, value)
        self.build(step_count, dt, t_end)
        parsed = []
        for run in runs:
            if not isinstance(run, str):
                raise self.error("runs", run, "be strings like 'hht(alpha=-0.1)@displacement'")
            parsed.append(self.build(parse_run, run))
        published = self.get("published", dict, "be a table", {})
        for kind, values in published.items():
            if not isinstance(values, dict) or not all(isinstance(v, (int, float)) for v in values.values()):
                raise self.error(f"published.{kind}", values, "be a table of numbers by run")
        notes = self.get("inferred", list, "be a list of strings", [])
        if not all(isinstance(note, str) for note in notes):
            raise self.error("inferred", notes, "be a list of strings")
        return Case(
            name=name,
            title=self.get("title", str, "be a string", name),
            problem=problem.problem(),
            cells=cells,
            dt=float(dt),
            t_end=float(t_end),
            runs=tuple(parsed),
            published=published,
            notes=tuple(notes),
        )

    def problem(self) -> BeamProblem:
        shared = {"stops", "base", "loads", "initial_displacement", "initial_velocity"}
        physical = any(name in self.table for name in ("length", "bending_stiffness", "mass_per_length"))
        own = (
            ("length", "bending_stiffness", "mass_per_length", "bending_viscosity", "time_unit")
            if physical
            else ("stiffness", "viscosity")
        )
        self.only(shared | set(own))
        numbers = {key: self.number(key) for key in own if key in self.table}
        for key in own[:3] if physical else own[:1]:
            self.number(key)
        stops, base = self.sub("stops"), self.sub("base")
        loads = self.get("loads", list, "be a list of tables", [])
        for i, load in enumerate(loads):
            if not isinstance(load, dict):
                raise self.error(f"loads[{i}]", load, "be a table", "write { position = ..., amplitude = ..., ... }")
        return self.build(
            BeamProblem.from_physical if physical else BeamProblem,
            **numbers,
            stops=None if stops is None else stops.stops(),
            base=None if base is None else base.time_function(set()),
            loads=tuple(_Reader(load, f"{self.where}.loads[{i}]").load() for i, load in enumerate(loads)),
            initial_displacement=self.polynomial("initial_displacement"),
            initial_velocity=self.polynomial("initial_velocity"),
        )

    def stops(self) -> Stops:
        self.only({"lower", "upper", "stiffness"})
        stiffness = self.number("stiffness")
        return self.build(Stops, self.number("lower", None), self.number("upper", None), stiffness=stiffness)

    def time_function(self, besides: set[str]) -> Harmonic | Constant:
        if "constant" in self.table:
            self.only({"constant"} | besides)
            return self.build(Constant, self.number("constant"))
        self.only({"amplitude", "frequency", "phase"} | besides)
        return self.build(Harmonic, self.number("amplitude"), self.number("frequency"), self.number("phase", 0.0))

    def load(self) -> Load:
        if "shape" in self.table:
            return DistributedLoad(self.polynomial("shape"), self.time_function({"shape"}))
        return self.build(PointLoad, self.number("position"), self.time_function({"position"}))
