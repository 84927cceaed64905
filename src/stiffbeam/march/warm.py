"""Compiling the march: once for each version of the sources, in this process or beside it, then from disk."""

from __future__ import annotations

import numpy as np

from ..basics import compiling
from ..basics.arrays import LANES
from ..basics.compiled import is_compiled
from ..model.contact import linear as all_linear
from ..model.contact_law import LAW
from ..model.system import System
from ..trajectory.sampling import TALLY
from .kernels import blocks as kernel
from .kernels.blocks import Block, Forcing, Inflow, Kept, Marchers

COMPILING = "compiling the march, once for this version"  # said while it is waited for
_warm: set[bool] = set()  # the kernels that this process has, by whether they are for any law


def compiled() -> bool:
    """True where the kernel is compiled, in this process or on disk: then ``warm_up`` takes a fraction of a second."""
    return is_compiled(kernel.run)


def any_law(system: System, contact: str) -> bool:
    """Return True where runs of the system take the kernel for any law, and not that for linear stops."""
    return contact == "conserving" or not all_linear(system.contacts)


def warm_up(by_law: bool = False) -> None:
    """Compile the kernel, that for any law or that for linear stops, or load it, or wait for who is compiling it."""
    if by_law in _warm:
        return
    compiling.wait()
    # Arrays without members: the call compiles or loads the kernel and computes nothing.
    z, index = np.zeros((0, LANES)), np.zeros((1, 1), np.int64)
    row = np.zeros((1, LANES))
    none = np.zeros((0, 1, 1))
    kernel.run(
        Block(row, row, row, row, index[0], index[0], none, none, index[0], 0),
        np.zeros((0, 1, LAW)), Forcing(0.0, z, none, np.zeros((0, 1, 1, 1))), Inflow(z, none),
        Marchers(z, z, z, np.zeros((0, 1, TALLY)), index[0]), Kept(row[0], none, none, none, none, z, z),
        row, 0, 0, 1.0, 1, np.zeros(3, np.int64), *((None, 1) if by_law else ()),
    )  # fmt: skip
    _warm.add(by_law)


def compile_beside(rehearsal: str, by_law: bool = False, given: bytes = b"") -> None:
    """Begin to compile in a process beside this one where the march is not compiled; ``warm_up`` waits for it.

    rehearsal: a line of Python that runs once what will be asked, on a small scale; what it leaves of the march is
    compiled after it. given: what it can read from its standard input.
    """
    if not compiled():
        compiling.begin(
            f"from {__name__} import warm_up\ntry:\n    {rehearsal}\nfinally:\n    warm_up({by_law})", given
        )
