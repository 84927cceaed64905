"""Pictures that objects offer by name. The entrance of the package sets what draws them, which lies to their right."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

DRAW: dict[str, Callable[..., Any]] = {}  # by name: "run", "comparison", "film"
