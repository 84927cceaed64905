"""References of any system, computed once and stored in the cache directory."""

from __future__ import annotations

import hashlib
import json
import platform
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics import storage
from ..basics.progress import TALK, Show
from ..basics.validation import InputError, numbers, positive
from ..model.system import System, require_system
from ..model.time_functions import require_closed_form, times_of
from ..references import reference
from ..references.registry import REFERENCES, RTOL, method_of
from ..trajectory.trajectory import Reference
from . import store

MOST = 1 << 30  # bytes of references that are kept


def cached_reference(
    system: System,
    t_end: float,
    method: str = "exact",
    t_eval: ArrayLike | None = None,
    rtol: float = RTOL,
    atol: float | None = None,
    digits: int | str = "auto",
    breakpoints: ArrayLike = (),
    max_step: float | None = None,
    progress: bool | Show | None = None,
    seconds: float | None = None,
) -> Reference:
    """Return ``reference`` with the same arguments and defaults, from the cache where it holds the answer.

    The key is the system's fingerprint, every argument and the versions of the libraries, so a changed parameter never
    finds an old file. A damaged file is named in a warning and computed again. Writing is atomic: two processes that
    compute the same reference leave one good file. Files that have not been used for longest are deleted when the cache
    exceeds a gigabyte.

    A multiprecision reference that is confirmed to t_end can be evaluated at any time. The
    others are loaded without states: with outputs, impacts, energy, horizon, work and provenance, as
    ``provenance["kept"]`` states. "exact" is solved again, which takes no longer than reading a file.

    Parameters
    ----------
    system, t_end, method, t_eval, rtol, atol, digits, breakpoints, max_step, progress, seconds
        As in ``reference``.

    Returns
    -------
    Reference

    Raises
    ------
    InputError
        As ``reference`` does, and for a bare callable, which has no fingerprint.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> sb.cached_reference(sb.paper_case(10).system(), 0.1).horizon
    0.1
    """
    method_of(method)
    if method == "exact":
        return reference(
            system, t_end, method, t_eval, breakpoints=breakpoints, max_step=max_step,
            progress=progress, seconds=seconds,
        )  # fmt: skip
    times = None if t_eval is None else numbers("t_eval", t_eval)
    steps = [times_of("breakpoints", breakpoints).tolist(), max_step]
    # A file is found by everything that determines its content.
    file = _file(system, t_end, method, times, rtol, atol, digits, steps)
    if file.is_file():
        try:
            result = store.load(file, system, times)
            assert isinstance(result, Reference)
            file.touch()  # used last
            result.provenance["kept"] = True
            return result
        except InputError as error:
            warnings.warn(f"remaking a cached reference: {error}", stacklevel=2)
    result = reference(system, t_end, method, times, rtol, atol, digits, breakpoints, max_step, progress, seconds)
    if "budget" in result.provenance:
        return result  # more seconds reach further
    try:
        # Confirmed to the end: a file that gives the solution at any time. Others keep their outputs.
        if store.can_freeze(result):
            store.freeze(result, "", file)
        else:
            result.save(file)
        TALK.kept = True
        storage.forget(file.parent, "*.nc", MOST)
    except InputError as error:
        if error.field != "file":
            raise
        warnings.warn(f"a reference is not kept: {error}", stacklevel=2)  # the cache's disk may be full
    return result


def _file(
    system: System,
    t_end: float,
    method: str,
    t_eval: np.ndarray | None,
    rtol: float,
    atol: float | None,
    digits: int | str,
    steps: list[Any],
) -> Path:
    # The arguments are checked before they become a part of the key.
    require_system(system)
    method_of(method)
    positive("t_end", t_end)
    positive("rtol", rtol)
    for name, value in (("atol", atol), ("max_step", steps[1])):
        if value is not None:
            positive(name, value)
    # A bare callable has no content to make a key of.
    require_closed_form(system.time_functions, "a cached reference", "sample it: Sampled(t, values, 'cubic')")
    anytime = method == "multiprecision" and digits == "auto"  # frozen, it answers at any time
    key = {
        "fingerprint": system.fingerprint,
        "t_end": float(t_end),
        "method": method,
        "settings": [digits] if method == "multiprecision" else [float(rtol), atol, *steps],
        "t_eval": None if t_eval is None or anytime else t_eval.tolist(),
        # Another version may round differently, or compute something else.
        "versions": [
            platform.python_version(),
            storage.source_hash(),
            *map(version, ("stiffbeam", "numpy", "scipy", "numba")),
            REFERENCES[method].versions(),
        ],
    }
    name = hashlib.sha256(json.dumps(key).encode()).hexdigest()[:32]
    return storage.directory() / "references" / f"{name}.nc"
