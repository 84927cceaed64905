"""References of anyone's system, computed once and kept in the cache directory."""

from __future__ import annotations

import hashlib
import json
import platform
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from . import cache, frozen, store
from .solvers import reference
from .system import System
from .time_functions import Constant, Harmonic
from .trajectory import Reference
from .validation import InputError, positive

_LIBRARIES = {
    "multiprecision": ("python-flint",),
    "cvode": ("scikit-sundae",),
    "cvode-adams": ("scikit-sundae",),
    "ida": ("scikit-sundae",),
    "kvaerno3": ("diffrax", "jax"),
    "kvaerno5": ("diffrax", "jax"),
}


def cached_reference(
    system: System,
    t_end: float,
    method: str = "multiprecision",
    t_eval: ArrayLike | None = None,
    rtol: float = 1e-10,
    atol: float | None = None,
    digits: int | str = "auto",
) -> Reference:
    """``reference`` with the same arguments, from the cache where it is there and whole.

    The key is the system's fingerprint, every argument and the versions of the libraries, so a changed
    parameter never finds an old file. A damaged file is named in a warning and remade. Writing is
    atomic: two processes that compute the same reference leave one good file. A multiprecision
    reference confirmed to t_end answers at any time; of the others comes back all but the states:
    outputs, impacts, energy, horizon, work and provenance of the run that was made. "exact" is solved
    anew, which takes no longer than reading a file. Raises InputError for a bare callable.
    """
    if method == "exact":
        return reference(system, t_end, method, t_eval)
    times = None if t_eval is None else np.asarray(t_eval, float)
    file = _file(system, t_end, method, times, rtol, atol, digits)
    if file.is_file():
        try:
            found = store.load(file, system, times)
            assert isinstance(found, Reference)
            return found
        except InputError as error:
            warnings.warn(f"remaking a cached reference: {error}", stacklevel=2)
    found = reference(system, t_end, method, times, rtol, atol, digits)
    if method == "multiprecision" and found.horizon >= t_end:
        frozen.freeze(found, "", file)
    else:
        store.save(found, file)
    return found


def _file(
    system: System,
    t_end: float,
    method: str,
    t_eval: np.ndarray | None,
    rtol: float,
    atol: float | None,
    digits: int | str,
) -> Path:
    if not isinstance(system, System):
        raise InputError("system", type(system).__name__, "be a System")
    positive("t_end", t_end)
    functions = [f for _, f in system.loads] + [c.offset for c in system.contacts if c.offset is not None]
    for function in functions:  # a bare callable has no content to make a key of
        if not isinstance(function, (Harmonic, Constant)):
            raise InputError("time function", function, "be Harmonic or Constant for a cached reference")
    packages = ("stiffbeam", "numpy", "scipy", "numba", *_LIBRARIES.get(method, ()))
    anytime = method == "multiprecision" and digits == "auto"  # frozen, it answers at any time
    key = {
        "fingerprint": system.fingerprint,
        "t_end": float(t_end),
        "method": method,
        "settings": [digits] if method == "multiprecision" else [float(rtol), atol],
        "t_eval": None if t_eval is None or anytime else t_eval.tolist(),
        "versions": [platform.python_version(), frozen.FORMAT, store.FORMAT, *map(_version, packages)],
    }
    name = hashlib.sha256(json.dumps(key).encode()).hexdigest()[:32]
    return cache.directory() / "references" / f"{name}.nc"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"  # the solver says so
