"""Pictures that objects call by name. ``stiffbeam/__init__.py`` sets the functions that draw them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

DRAW: dict[str, Callable[..., Any]] = {}  # by name: "run", "comparison", "film"
