"""Old names: they still work, and warn with the new name."""

from __future__ import annotations

import warnings
from typing import Any


def warn_of(old: str, new: str, stacklevel: int = 3) -> None:
    """Warn that ``old`` is now called ``new``. The warning points to the caller."""
    warnings.warn(f"{old} is called {new} now", DeprecationWarning, stacklevel=stacklevel)


class Renamed:
    """An attribute under its old name. Reading it warns and returns the attribute under the new name.

    >>> class Ledger:
    ...     supplied = 3.0
    ...     given = Renamed("supplied")
    """

    def __init__(self, new: str) -> None:
        self.new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self.old = name
        self.__doc__ = f"Deprecated: use ``{self.new}``."

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        if instance is None:
            return self
        kind = type(instance).__name__
        warn_of(f"{kind}.{self.old}", f"{kind}.{self.new}")
        return getattr(instance, self.new)
