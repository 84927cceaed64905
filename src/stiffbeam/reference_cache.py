"""Multiprecision references of anyone's system, computed once and kept in the cache directory."""

from __future__ import annotations

import hashlib
import warnings
from importlib.metadata import version
from pathlib import Path

from . import cache
from .frozen import FORMAT, freeze
from .solvers import reference
from .store import load
from .system import System
from .time_functions import Constant, Harmonic
from .trajectory import Reference
from .validation import InputError


def cached_reference(system: System, t_end: float) -> Reference:
    """The multiprecision reference of ``system`` on [0, t_end], from the cache where it is there and whole.

    The key is the system's fingerprint, the time span and the versions, so a changed parameter never
    finds an old file. A damaged file is named in a warning and remade. Writing is atomic: two
    processes that compute the same reference leave one good file.
    """
    _refuse_callables(system)
    file = _file(system, t_end)
    if file.is_file():
        try:
            found = load(file, system)
            assert isinstance(found, Reference)
            return found
        except InputError as error:
            warnings.warn(f"remaking a cached reference: {error}", stacklevel=2)
    found = reference(system, t_end, "multiprecision")
    freeze(found, "", file)
    return found


def _file(system: System, t_end: float) -> Path:
    versions = f"{version('stiffbeam')} {version('python-flint')} {FORMAT}"
    key = hashlib.sha256(f"{system.fingerprint} {t_end!r} {versions}".encode()).hexdigest()
    return cache.directory() / "references" / f"{key[:32]}.nc"


def _refuse_callables(system: System) -> None:
    """A bare callable has no content to make a key of."""
    functions = [f for _, f in system.loads] + [c.offset for c in system.contacts if c.offset is not None]
    for function in functions:
        if not isinstance(function, (Harmonic, Constant)):
            raise InputError("time function", function, "be Harmonic or Constant for a cached reference")
