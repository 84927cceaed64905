"""stiffbeam: fixed-step schemes beside adaptive and exact solutions of vibro-impact systems.

    problem -> semidiscretise -> System -> integrate (scheme) or reference (solver) -> Trajectory -> compare
    study: one question about a case, answered by rows, a table and a picture

Names are loaded on first use; SUNDIALS, jax and matplotlib only by the functions that need them.
"""

from __future__ import annotations

import importlib as _importlib
from importlib import metadata as _metadata
from typing import Any as _Any

import lazy_loader as _lazy

from .basics.text import DRAW as _DRAW

_load, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> _Any:
    return _metadata.version("stiffbeam") if name == "__version__" else _load(name)


def _draw(module: str, function: str) -> _Any:
    return lambda *objects, **options: getattr(_importlib.import_module(module, __name__), function)(
        *objects, **options
    )


# Objects offer their pictures; figures, and with it matplotlib, is loaded when the first one is asked for.
_DRAW |= {
    "run": _draw(".figures.runs", "run_figure"),
    "comparison": _draw(".figures.runs", "comparison_figure"),
    "film": _draw(".figures.animation", "animate"),
}
