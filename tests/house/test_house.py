"""The floor plan: imports between rooms. Data flows one way, and so do imports, lazy ones too.

Two files of one room may name each other's classes in annotations; nothing else may go in a circle.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from importlib.util import resolve_name
from pathlib import Path

import pytest

import stiffbeam
from stiffbeam.references import REFERENCES
from stiffbeam.references.registry import ADAPTIVE, EXACT, MULTIPRECISION

PACKAGE = Path(stiffbeam.__file__).parent
# A room imports from rooms to its left only; march and references do not know each other.
ROOMS = (
    "basics", "kernels", "model", "schemes", "trajectory", "march", "references",
    "integrators", "files", "measures", "figures", "testset", "studies", "cli",
)  # fmt: skip
STRANGERS = {("march", "references"), ("references", "march")}
ENTRANCES = {"", "__main__", "pytest_plugin", "testing"}  # what users import; nothing in a room does


def _name(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix("__init__").removesuffix(".")


MODULES = {_name(path): path for path in PACKAGE.rglob("*.py")}


def _module(dotted: str) -> str:
    """The longest beginning of a dotted name that is a module; its last part may be a name in it."""
    while dotted not in MODULES:
        dotted = dotted.rpartition(".")[0]
    return dotted


def _imports(name: str) -> set[str]:
    """Modules of the package that a module imports, in functions too, and for types from other rooms."""
    path, room = MODULES[name], name.partition(".")[0]
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    guards = [node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    for_types = {inner for guard in guards for inner in ast.walk(guard)}
    imported = set()
    for node in ast.walk(tree):
        absolute = node.module if isinstance(node, ast.ImportFrom) and not node.level else ""
        absolute = node.names[0].name if isinstance(node, ast.Import) else absolute
        assert not absolute.startswith("stiffbeam"), f"{name}: write relative imports, which this test reads"
        if isinstance(node, ast.ImportFrom) and node.level:
            base = resolve_name("." * node.level + (node.module or ""), f"stiffbeam.{package}".rstrip("."))
            others = {_module(f"{base}.{alias.name}".removeprefix("stiffbeam.")) for alias in node.names}
            imported |= {other for other in others if node not in for_types or other.partition(".")[0] != room}
    return imported - {name}


@cache
def arrows() -> dict[str, set[str]]:
    """Imports of every module of a room."""
    return {name: _imports(name) for name in MODULES if name not in ENTRANCES}


def test_every_module_is_in_a_room_that_contributing_lists_in_this_order():
    assert {name.split(".")[0] for name in MODULES} - ENTRANCES == set(ROOMS)
    section = (PACKAGE.parents[1] / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## The packages\n")[2]
    assert tuple(re.findall(r"^\| `(\w+)` \|", section.partition("\n## ")[0], re.MULTILINE)) == ROOMS


@pytest.mark.slow
def test_no_room_imports_from_one_to_its_right():
    back = [
        f"{name} -> {other}"
        for name, others in arrows().items()
        for other in others
        for here, there in [(name.split(".")[0], other.split(".")[0])]
        if other in ENTRANCES or ROOMS.index(there) > ROOMS.index(here) or (here, there) in STRANGERS
    ]
    assert not back


def test_no_measure_knows_a_solver():
    asked = {other for name, others in arrows().items() if name.startswith("measures") for other in others}
    assert {other for other in asked if other.startswith("references")} == {"references.registry"}


def test_no_modules_import_each_other_in_a_circle():
    remaining = {name: set(others) for name, others in arrows().items()}
    while free := [name for name, others in remaining.items() if not others & remaining.keys()]:
        for name in free:
            del remaining[name]
    assert not remaining, f"in a circle, or above one: {sorted(remaining)}"


@pytest.mark.slow
def test_campaigns_run_only_where_they_are_named():
    """A -m of the command line replaces that of pyproject.toml: "not slow" must not begin campaigns."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "--collect-only", "tests/campaigns/test_campaign.py"]
    done = subprocess.run([*command, "-m", "not slow"], cwd=PACKAGE.parents[1], capture_output=True, text=True)
    assert "any_method[12" not in done.stdout
    assert "test_an_ensemble_says" in done.stdout


# The registry of reference solvers.

KINDS = {"exact": EXACT, "multiprecision": MULTIPRECISION, "adaptive": ADAPTIVE}  # a room of references each


@pytest.mark.parametrize("method", REFERENCES.values(), ids=lambda method: method.name)
def test_every_method_stands_in_the_room_of_its_kind_and_says_how_it_solves(method):
    assert KINDS[method.module.partition(".")[0]] == method.kind
    assert callable(import_module(f"stiffbeam.references.{method.module}").solve)
    assert method.kind == EXACT or all(method.versions().values())
