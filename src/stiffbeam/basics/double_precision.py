"""float64 in JAX, for a part of the program only."""

from __future__ import annotations

from contextlib import AbstractContextManager
from importlib import import_module
from typing import Any


def double_precision() -> AbstractContextManager[Any]:
    """A context in which JAX computes in float64; outside it stays as it was."""
    import jax

    # A switch of the whole process in older versions of JAX moved out of ``experimental``.
    home = jax if hasattr(jax, "enable_x64") else import_module("jax.experimental")
    return home.enable_x64(True)
