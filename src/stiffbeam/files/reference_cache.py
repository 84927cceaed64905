"""References of any system, computed once and stored in the cache directory."""

from __future__ import annotations

import hashlib
import json
import platform
import warnings
from importlib.metadata import version
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics import storage
from ..basics.progress import TALK, Show
from ..basics.validation import InputError, numbers, positive
from ..model.system import System, require_system
from ..model.time_functions import require_closed_form
from ..references import reference
from ..references.registry import method_of
from ..trajectory.trajectory import Reference
from . import store

MOST = 1 << 30  # bytes of references that are kept


def cached_reference(
    system: System,
    t_end: float,
    method: str = "exact",
    t_eval: ArrayLike | None = None,
    progress: bool | Show | None = None,
    **options: Any,
) -> Reference:
    """Return ``reference`` with the same arguments and defaults, from the cache where it holds the answer.

    The key is the system's fingerprint, every argument and the versions of the libraries, so a changed parameter never
    finds an old file. A damaged file is named in a warning and computed again. Writing is atomic: two processes that
    compute the same reference leave one good file. Files that have not been used for longest are deleted when the cache
    exceeds a gigabyte.

    A multiprecision reference that is confirmed to t_end can be evaluated at any time. The others are loaded without
    states: with outputs, impacts, energy, horizon, work and provenance, as ``provenance["kept"]`` states. "exact" is
    solved again, which takes no longer than reading a file.

    Parameters
    ----------
    system, t_end, method, t_eval, progress, **options
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
    times = None if t_eval is None else numbers("t_eval", t_eval)
    given = signature(reference).bind(system, t_end, method, times, progress=progress, **options)
    entry = method_of(method)
    if method == "exact":
        return reference(*given.args, **given.kwargs)
    require_system(system)
    positive("t_end", t_end)
    # A bare callable has no content to make a key of.
    require_closed_form(system.time_functions, "a cached reference", "sample it: Sampled(t, values, 'cubic')")
    given.apply_defaults()
    settings = {name: x for name, x in given.arguments.items() if name not in ("system", "progress", "seconds")}
    # Another version may round differently, or compute something else.
    versions = [platform.python_version(), storage.source_hash(), *map(version, ("stiffbeam", "numpy", "scipy"))]
    key = json.dumps([system.fingerprint, settings, versions, entry.versions()],
                     default=lambda x: np.asarray(x).tolist())  # fmt: skip
    file = storage.directory() / "references" / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.nc"
    if file.is_file():
        try:
            result = store.load(file, system, times)
            assert isinstance(result, Reference)
            file.touch()  # used last
            result.provenance["kept"] = True
            return result
        except InputError as error:
            warnings.warn(f"remaking a cached reference: {error}", stacklevel=2)
    result = reference(*given.args, **given.kwargs)
    if "budget" in result.provenance:
        return result  # more seconds reach further
    try:
        # Confirmed to the end: a file that gives the solution at any time. Others keep their outputs.
        if store.can_freeze(result):
            store.freeze(result, file)
        else:
            result.save(file)
        TALK.kept = True
        storage.forget(file.parent, "*.nc", MOST)
    except InputError as error:
        if error.field != "file":
            raise
        warnings.warn(f"a reference is not kept: {error}", stacklevel=2)  # the cache's disk may be full
    return result
