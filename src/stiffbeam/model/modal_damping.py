"""Damping given mode by mode, as a matrix."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError
from .modes import Modes, undamped_modes
from .sections import ratios_of
from .system import System


def modal_damping(mass: ArrayLike, stiffness: ArrayLike, ratio: float | Sequence[float]) -> Array:
    """C = M Phi diag(2 zeta_j omega_j) Phi^T M, Phi^T M Phi = I: damping that leaves the natural modes as they are.

    mass, stiffness: (n, n), dense or SciPy sparse. ratio: zeta of every mode, or of the first ones, 0 of the rest; a
    rigid motion has none. Returns (n, n), for ``System.from_matrices``. Raises InputError for a negative ratio, for
    more of them than modes, and for matrices that make no System.
    """
    system = System.from_matrices(mass, stiffness, observe=np.ones(np.shape(mass)[0]))
    return damping_of(undamped_modes(system), ratio)


def damping_of(basis: Modes, ratio: float | Sequence[float]) -> Array:
    """``modal_damping`` in known modes: in those of the system itself it couples none of them."""
    ratios, zeta = ratios_of(ratio), np.zeros(len(basis.omega))
    if isinstance(ratios, tuple):
        if len(ratios) > len(zeta):
            remedy = "leave the last ones out, or take more cells"
            raise InputError("modal_damping", len(ratios), f"be at most one for each of {len(zeta)} modes", remedy)
        zeta[: len(ratios)] = ratios
    else:
        zeta[:] = ratios
    weighted = basis.mass @ basis.shapes
    return (weighted * (2.0 * zeta * basis.omega)) @ weighted.T
