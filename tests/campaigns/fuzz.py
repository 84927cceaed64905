"""Wild input to everything that users call: a result, or a refusal with rule, value and remedy; nothing else.

A violation is an exception from inside, a number that is not finite in what came back, and a message that is longer
than LONGEST characters, more than one line, or without rule, value and remedy.
"""

from __future__ import annotations

import contextlib
import re
import tempfile
import traceback
from pathlib import Path
from typing import Any

import numpy as np
from commands import invoke
from fuzz_surfaces import CONSTRUCTORS, FUNCTIONS, Surface, beam, marched, numbers_in
from judge import Verdict
from wild_values import NUMBERS, TEXTS

import stiffbeam as sb
from stiffbeam.cli import OWN
from stiffbeam.files import case_blocks, paper_text
from stiffbeam.files.cases import find_case
from stiffbeam.studies import studies

LONGEST = 1000  # letters of a message
WHOLE = re.compile(r".+ must .+, got .*: .+")  # field, rule, value and remedy


def one_case(text: str) -> Any:
    """Read, and marched for a few steps where it can be read."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "case.toml"
        file.write_bytes(text.encode("utf-8", "surrogatepass"))
        case = find_case(str(file))
        if case.cells > 100:
            return case
        return [case, *marched(sb.semidiscretise(case.problem, case.cells, case.runs[0][1]) if case.runs else beam())]


STEEL = """[[case]]
name = "steel"
title = "a steel strip"
cells = 6
dt = 1e-4
t_end = 0.01
runs = ["HHT(alpha=-0.1)", "BDF2@velocity-curvature"]
inferred = ["cells: as many as suffice"]
[case.published.impacts]
bdf2 = 10
[case.problem]
length = 0.4
stiffness = 4.2
mass_per_length = 0.16
supports = "clamped-free"
units = { length = "mm", time = "s", force = "N" }
initial_velocity = [0.0, 0.0, 1.0]
stops = { lower = -2e-3, upper = 2e-3, stiffness = 1e5, exponent = 1.5, damping = 1.0 }
base = { sum = [{ amplitude = 1e-3, frequency = 150.0 }, { constant = 0.0 }] }
loads = [{ position = 0.1, amplitude = 3.0, frequency = 60.0, phase = "pi/2" }, { shape = [0, 1], constant = 2.0 }]
"""
LITERALS = [
    "0", "-1", "true", "nan", "inf", "-inf", "1e400", "1e-400", "1e999999999", "9" * 400, "[]", "{}", "[1, 2]", '""',
    '"abc"', '"1/0"', '"pi*pi"', '"[/]"', '"\\u001b[31m"', '".."', '"../x"', "2002-01-01", "[[[[]]]]", "1_000",
    '"HHT(alpha=' + "-" * 1000 + '1)"', '["HHT(alpha=' + "-" * 1000 + '1)"]', "0x10", "1e30", "1e-300", '"' + "x" * 999
    + '"', "[" * 300 + "]" * 300, '{ amplitude = 1, frequency = 2 }', '{ sampled = "/etc/passwd" }', "[true]",
]  # fmt: skip


def case_file(rng: np.random.Generator) -> Any:
    """A field with another value, a line less, letters left out, doubled or exchanged with others of the file."""
    text = str(rng.choice([STEEL, *(case_blocks(paper_text())[x] for x in ("table10", "table3"))]))
    kind = rng.integers(5)
    if kind == 0:
        lines = text.splitlines()
        del lines[rng.integers(len(lines))]
        return one_case("\n".join(lines))
    if kind == 1:
        letters = list(text)
        for at in rng.integers(0, len(letters), rng.integers(1, 4)):
            other = letters[rng.integers(len(letters))]
            letters[at] = rng.choice(["", 2 * letters[at], other, "\x00", '"', "[", "=", "-", "\n", "e9", "\x1b"])
        return one_case("".join(letters))
    values = list(re.finditer(r'(?<== )("[^"]*"|[-\d.e]+|\[[^\]]*\]|\{[^{}]*\})', text))
    for match in sorted(rng.choice(len(values), 1 + (kind == 2), replace=False), reverse=True):
        place = values[match]
        text = text[: place.start()] + LITERALS[rng.integers(len(LITERALS))] + text[place.end() :]
    return one_case(text)


STUDIES = [[name] if name in OWN else ["study", name] for name in studies()]
OPTIONS = {
    "cases": {"--show": "table10", "--json": "-"},
    "compare": {"--schemes": "hht", "--references": "exact", "--contact": "implicit", "--dt": "1e-3", "--t-end": "0.02",
                "--json": "-", "--out": "out"},
    "reference": {"--method": "exact", "--form": "displacement", "--digits": "30", "--rtol": "1e-6", "--t-end": "0.02",
                  "--out": "r.nc", "--json": "-"},
    **{" ".join(words): {"--schemes": "hht", "--integrators": "hht", "--t-end": "0.02", "--dt": "1e-3",
                         "--halvings": "2", "--jobs": "1", "--values": "9:10:2", "--members": "2",
                         "--form": "displacement", "--json": "-"}
       for words in STUDIES},
}  # fmt: skip


def command(rng: np.random.Generator) -> Any:
    """The status of the command as it is typed, in a folder with a case file."""
    name = str(rng.choice([*OPTIONS, "compare", "reference"]))
    case = str(rng.choice(["table10", "table3", "steel.toml", "table"]))
    words = [
        *name.split(),
        *([] if name == "cases" else [case]),
        *(["--t-end", "0.02"] if name.split() in STUDIES else []),
    ]
    for option in rng.choice(list(OPTIONS[name]), min(2, len(OPTIONS[name])), replace=False):
        value = OPTIONS[name][option] if rng.random() < 0.3 else str(_of(rng, NUMBERS if rng.random() < 0.6 else TEXTS))
        words += [option, value]
    if rng.random() < 0.15:
        words[int(rng.integers(len(words)))] = str(_of(rng, TEXTS))
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("steel.toml").write_text(STEEL, encoding="utf-8")
        done = invoke([word.replace("\x00", "") for word in words])
    if isinstance(done.exception, sb.InputError):  # words that are no command or option have the help alone
        raise done.exception
    return done.exit_code


def _of(rng: np.random.Generator, values: list[Any]) -> str:
    try:
        return str(values[rng.integers(len(values))])
    except ValueError:  # of 5000 digits
        return "9" * 5000


GROUPS: dict[str, tuple[float, list[Any]]] = {
    "constructors": (0.35, CONSTRUCTORS), "functions": (0.4, FUNCTIONS), "case files": (0.15, [case_file]),
    "commands": (0.1, [command]),
}  # fmt: skip


def tried(seed: int, index: int) -> tuple[str, list[Verdict]]:
    """The group of an input, and the verdict on it: "result", "refused", "failed" or a violation."""
    rng = np.random.default_rng([seed, index])
    group = str(rng.choice(list(GROUPS), p=[share for share, _ in GROUPS.values()]))
    choices = GROUPS[group][1]
    weights = np.array([getattr(x, "weight", 1) for x in choices], float)
    chosen = choices[int(rng.choice(len(choices), p=weights / weights.sum()))]
    try:
        found = chosen.try_one(rng) if isinstance(chosen, Surface) else chosen(rng)
        bad = [name for name, values in numbers_in(found) if not np.all(np.isfinite(values))]
        outcome, reason = ("not finite" if bad else "result"), ", ".join(bad)
    except (sb.InputError, sb.Diverged, sb.SolverFailure) as error:
        outcome, reason = ("refused" if isinstance(error, sb.InputError) else "failed"), str(error)
        whole = outcome == "failed" or WHOLE.fullmatch(reason)
        if len(reason) > LONGEST or not reason.isprintable() or not whole:
            outcome = "message"
    except BaseException:
        outcome, reason = "exception", traceback.format_exc(limit=-4)
    return group, [Verdict(outcome, getattr(chosen, "name", group).replace(" ", "-"), reason)]
