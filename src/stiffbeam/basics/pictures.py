"""Pictures by name: an object offers its own, what draws them is to the right of it in the flow.

Looked up when one is asked for, as a command looks up a study: no module of an object depends on matplotlib or on
the room of figures.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


def picture(name: str, *arguments: Any, **options: Any) -> Any:
    """``module:function`` of the room of figures, called."""
    module, _, function = name.partition(":")
    return getattr(import_module(f"stiffbeam.figures.{module}"), function)(*arguments, **options)
