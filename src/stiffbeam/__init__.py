"""stiffbeam: fixed-step schemes beside adaptive and exact solutions of vibro-impact systems.

    problem -> semidiscretise -> System -> integrate (scheme) or reference (solver) -> Trajectory -> compare
    study: one question about a case, answered by rows, a table and a picture

Names are loaded on first use; SUNDIALS, jax and matplotlib only by the functions that need them.
"""

from __future__ import annotations

import ast as _ast
import importlib as _importlib
from importlib import metadata as _metadata
from pathlib import Path as _Path
from typing import Any as _Any

from .basics.text import DRAW as _DRAW
from .basics.validation import warn_of as _warn_of

_SCHEMES = "schemes"  # every class in it is public
_STUB = _ast.parse(_Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_MODULE = {
    alias.name: node.module
    for node in _STUB.body
    if isinstance(node, _ast.ImportFrom) and node.module != _SCHEMES
    for alias in node.names
}
_RENAMED = {
    "Growth": "PerturbationGrowth",
    "Members": "EnsembleMembers",
    "Section": "BeamSection",
    "Sum": "Superposition",
    "perturbed": "perturbed_members",
    "reduced": "reduce_model",
    "varied": "varied_members",
}  # old names, which warn


def _draw(module: str, function: str) -> _Any:
    return lambda *objects, **options: getattr(_importlib.import_module(module, __name__), function)(
        *objects, **options
    )


# Objects offer their pictures; figures, and with it matplotlib, is loaded when the first one is asked for.
_DRAW |= {
    name: _draw(".figures.runs", f"plot_{name}")
    for name in ("run", "system", "impacts", "ensemble", "comparison", "advice", "scorecard")
} | {"film": _draw(".figures.animation", "animate")}


def _schemes() -> dict[str, type]:
    registry = _importlib.import_module(f".{_SCHEMES}", __name__)
    return {name: value for name, value in vars(registry).items() if isinstance(value, type)}


def __getattr__(name: str) -> _Any:
    if name == "__version__":
        return _metadata.version("stiffbeam")
    if name == "__all__":
        return sorted({*_MODULE, *_schemes()})
    if name in _RENAMED:
        _warn_of(f"stiffbeam.{name}", f"stiffbeam.{_RENAMED[name]}")
        return getattr(_importlib.import_module(__name__), _RENAMED[name])
    if name in _MODULE:
        value = getattr(_importlib.import_module(f".{_MODULE[name]}", __name__), name)
    elif not name.startswith("_") and name in _schemes():
        value = _schemes()[name]
    else:
        raise AttributeError(f"module 'stiffbeam' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__getattr__("__all__"), "__version__"]
