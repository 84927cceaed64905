"""The floor plan: who imports whom. Data flows one way, so imports do too, wherever in a file they stand.

Two files of one room may name each other's classes in annotations; nothing else may go in a circle.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

import stiffbeam

PACKAGE = Path(stiffbeam.__file__).parent
# A room imports from rooms to its left only; march and references do not know each other.
ROOMS = (
    "basics", "model", "schemes", "trajectory", "march", "references", "files", "measures", "figures", "testset",
    "studies", "cli",
)  # fmt: skip
STRANGERS = {("march", "references"), ("references", "march")}
ENTRANCES = {"", "__main__", "pytest_plugin"}  # what users import; nothing in a room does


def _name(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {_name(path): path for path in PACKAGE.rglob("*.py")}


def _for_types(tree: ast.Module) -> set[ast.AST]:
    """What stands under ``if TYPE_CHECKING``."""
    guards = [node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    return {inner for guard in guards for inner in ast.walk(guard)}


def _imports(name: str) -> set[str]:
    """The modules of the package that a module imports, inside functions too, and for types from other rooms."""
    path = MODULES[name]
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = _for_types(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1] + (node.module.split(".") if node.module else [])
            for alias in node.names:
                whole = ".".join([*base, alias.name])
                other = whole if whole in MODULES else ".".join(base)
                if node not in for_types or other.split(".")[0] != name.split(".")[0]:
                    found.add(other)
    return found - {name}


@cache
def arrows() -> dict[str, set[str]]:
    """What every module of a room imports."""
    return {name: _imports(name) for name in MODULES if name not in ENTRANCES}


def test_every_module_is_in_a_room():
    assert {name.split(".")[0] for name in MODULES} - ENTRANCES == set(ROOMS)


def test_no_room_imports_from_one_to_its_right():
    back = [
        f"{name} -> {other}"
        for name, others in arrows().items()
        for other in others
        for here, there in [(name.split(".")[0], other.split(".")[0])]
        if other in ENTRANCES or ROOMS.index(there) > ROOMS.index(here) or (here, there) in STRANGERS
    ]
    assert not back


def test_no_modules_import_each_other_in_a_circle():
    remaining = {name: set(others) for name, others in arrows().items()}
    while free := [name for name, others in remaining.items() if not others & remaining.keys()]:
        for name in free:
            del remaining[name]
    assert not remaining, f"in a circle, or above one: {sorted(remaining)}"


@pytest.mark.parametrize("name", sorted(MODULES))
def test_a_file_is_one_sitting_of_reading(name):
    assert len(MODULES[name].read_text(encoding="utf-8").splitlines()) <= 600
