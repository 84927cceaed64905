"""The floor plan: who imports whom. Data flows one way, and so do imports, lazy ones and those in strings too.

Two files of one room may name each other's classes in annotations; nothing else may go in a circle.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import stiffbeam

PACKAGE = Path(stiffbeam.__file__).parent
# A room imports from rooms to its left only; march and references do not know each other.
ROOMS = (
    "basics", "kernels", "model", "schemes", "trajectory", "march", "references",
    "integrators", "files", "measures", "figures", "testset", "studies", "cli",
)  # fmt: skip
STRANGERS = {("march", "references"), ("references", "march")}
ENTRANCES = {"", "__main__", "pytest_plugin", "testing"}  # what users import; nothing in a room does


def _name(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {_name(path): path for path in PACKAGE.rglob("*.py")}


NAMED = re.compile(rf"\bstiffbeam((?:\.(?:{'|'.join(ROOMS)})\b)(?:\.\w+)*)")  # a module in a string


def _for_types(tree: ast.Module) -> set[ast.AST]:
    """What stands under ``if TYPE_CHECKING``."""
    guards = [node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    return {inner for guard in guards for inner in ast.walk(guard)}


def _module(parts: list[str]) -> str:
    """The longest beginning of a dotted name that is a module; the last part may be a name in it, or not known yet."""
    while ".".join(parts) not in MODULES:
        parts = parts[:-1]
    return ".".join(parts)


def _imports(name: str) -> set[str]:
    """The modules of the package that a module imports, inside functions too, and for types from other rooms; those
    that a string names, or begins to name for ``import_module``, are imported as well."""
    path = MODULES[name]
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    imported = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = _for_types(tree)
    for node in ast.walk(tree):
        others = []
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").split(".")[0] == "stiffbeam"):
            base = package[: len(package) - node.level + 1] if node.level else []
            base = base + (node.module or "").removeprefix("stiffbeam").strip(".").split(".")
            others = [_module([part for part in [*base, alias.name] if part]) for alias in node.names]
        elif isinstance(node, ast.Import):
            words = [alias.name.split(".") for alias in node.names]
            others = [_module(rest) for head, *rest in words if head == "stiffbeam"]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            others = [_module(found[1].strip(".").split(".")) for found in NAMED.finditer(node.value)]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            first = node.args[0].values[0] if isinstance(node.args[0], ast.JoinedStr) else node.args[0]
            text = str(first.value) if isinstance(first, ast.Constant) else ""
            if level := len(text) - len(text.lstrip(".")):
                others = [_module([*package[: len(package) - level + 1], *filter(None, text[level:].split("."))])]
        imported |= {x for x in others if node not in for_types or x.split(".")[0] != name.split(".")[0]}
    return imported - {name}


@cache
def arrows() -> dict[str, set[str]]:
    """What every module of a room imports."""
    return {name: _imports(name) for name in MODULES if name not in ENTRANCES}


def test_every_module_is_in_a_room():
    assert {name.split(".")[0] for name in MODULES} - ENTRANCES == set(ROOMS)


def test_contributing_has_a_line_for_every_room_in_this_order():
    text = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = text.partition("## The packages\n")[2].partition("\n## ")[0]
    assert tuple(re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)) == ROOMS


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


@pytest.mark.parametrize(
    "line",
    [
        "from ..figures import look",
        "def f():\n    from stiffbeam.figures import look",
        "import stiffbeam.figures.chart",
        'importlib.import_module(f"stiffbeam.figures.{x}")',
        'import_module("..figures", __name__)',
        'code = "from stiffbeam.figures.chart import look"',
    ],
)
def test_an_arrow_to_the_right_is_seen_in_every_spelling(line, tmp_path, monkeypatch):
    file = tmp_path / "module.py"
    file.write_text(line)
    monkeypatch.setitem(MODULES, "basics.module", file)
    assert {other.split(".")[0] for other in _imports("basics.module")} == {"figures"}


def test_no_modules_import_each_other_in_a_circle():
    remaining = {name: set(others) for name, others in arrows().items()}
    while free := [name for name, others in remaining.items() if not others & remaining.keys()]:
        for name in free:
            del remaining[name]
    assert not remaining, f"in a circle, or above one: {sorted(remaining)}"


@pytest.mark.slow
@pytest.mark.parametrize(("marks", "some"), [("not slow", False), ("campaign", True)])
def test_campaigns_run_only_where_they_are_named(marks, some):
    """A -m of the command line replaces that of pyproject.toml: "not slow" must not begin campaigns."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "--collect-only", "tests/campaigns/test_campaign.py"]
    done = subprocess.run([*command, "-m", marks], cwd=PACKAGE.parents[1], capture_output=True, text=True)
    assert ("any_method[120]" in done.stdout) == some
