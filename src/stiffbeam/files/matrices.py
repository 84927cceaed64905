"""Matrices and vectors of a case file that stand in files beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..basics.validation import InputError

SUFFIXES = (".mtx", ".npz", ".npy")


def read_matrix(file: Path) -> Any:
    """The array, dense or SciPy sparse, of a file: Matrix Market .mtx (a symmetric half stands for the whole),
    SciPy's or NumPy's .npz with one array, NumPy's .npy.

    Nothing is unpickled. Raises InputError for another suffix, a file that cannot be read, and several arrays.
    """
    if file.suffix not in SUFFIXES:
        raise InputError("array", str(file), f"be a file of {', '.join(SUFFIXES)}", "or write its numbers here")
    if not file.is_file():
        raise InputError("array", str(file), "be a file beside the case", "give its path relative to the case file")
    try:
        return {".mtx": _market, ".npz": _npz, ".npy": np.load}[file.suffix](file)
    except InputError:
        raise
    except Exception as error:  # whatever the readers of three formats raise for a damaged file
        raise InputError("array", str(file), "be readable", repr(error)) from None


def _market(file: Path) -> Any:
    from scipy.io import mmread

    return mmread(file)


def _npz(file: Path) -> Any:
    from scipy.sparse import load_npz

    with np.load(file) as found:
        names = list(found)
        if "format" in names:
            return load_npz(file)
        if len(names) != 1:
            raise InputError("array", f"{file} with {', '.join(names)}", "hold one array", "save each by itself")
        return found[names[0]]
