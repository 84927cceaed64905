"""The equations of an adaptive solver, E y' = f(t, y): the functions of rhs.h."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse

from ..basics.arrays import Array
from .library import FLOAT, Real, Structure, address, library
from .march import LAW

THROUGH = 2  # regime of a contact that follows its law on both sides of its events

_Equations = Structure(
    "n m size d F R P edges damped viscous inertia first stride",
    "",
    "A_starts int: A_rows; A_columns? int: A; A_entries?: A; D_starts int: D_rows; D_columns? int: D; D_entries?: D; "
    "E_starts int: E_rows; E_columns? int: E; E_entries?: E; frequencies: F; edge: edges; records: edges R P; "
    "loads: d n; power: d n; offsets: d m; pushes: m n; positions: m n; velocities: m n; accelerations: m n; "
    f"law: m {LAW}; lengths: m; levels: roots; regime int: m; window: 2; given: 3 called",
)


def function_address(name: str) -> int:
    """Address of a function of the library, for other C code."""
    return ctypes.cast(getattr(library(), name), ctypes.c_void_p).value or 0


class Equations(SimpleNamespace):
    """Numbers of E y' = A y + loads + contact forces, for C, and with them for Python: arrays as rhs.h states them.

    z (size,) is y with the integrals of the energy balance, see ``model.right_hand_side``. called: number of functions
    of time that Python evaluates. matrix: A. damping: D, whose quadratic form is the viscous power, or no rows.
    inertia: E, None for the identity. bandwidths: of a Jacobian of SUNDIALS, None for a full one. A solver writes to
    ``lengths``, ``levels``, ``regime`` and ``window``.
    """

    def __init__(
        self, size: int, damped: bool, called: int, bandwidths: tuple[int, int] | None, inertia: Array | None,
        **arrays: Array,
    ) -> None:  # fmt: skip
        super().__init__(size=size, damped=damped, called=called, bandwidths=bandwidths, inertia=inertia)
        vars(self).update((name, np.ascontiguousarray(x, float)) for name, x in arrays.items())
        m = len(self.law)
        self.lengths, self.levels = np.ones(m), np.zeros(self.roots)
        self.regime, self.window = np.full(m, THROUGH, np.int64), np.array([-np.inf, np.inf])
        self.given = np.zeros((3, called))
        self._structure = self._for_c()
        # Address of the description for C, which holds as long as this object does.
        self.c = ctypes.addressof(self._structure)
        n = self.pushes.shape[1]
        # f(t, y), (n,); f(t, z), (size,); the event functions less their levels, (roots,).
        self.state_rate = self._function("state_rate", n, n)
        self.right_hand_side = self._function("right_hand_side", size, size)
        self.event_functions = self._function("event_functions", size, len(self.levels))

    def _for_c(self) -> Any:
        # Entry (i, j) of a Jacobian at first + i + j stride: the storage of SUNDIALS.
        first, stride = 0, self.size
        if self.bandwidths is not None:
            lower, upper = self.bandwidths
            first = min(self.size - 1, lower + upper)  # upper bandwidth of the factors
            stride = first + lower
        self.edge = self.edges
        inertia = np.zeros((0, 0)) if self.inertia is None else self.inertia
        for name, matrix in (("A", self.matrix), ("D", self.damping), ("E", inertia)):
            sparse = scipy.sparse.csr_array(matrix)
            rows = {"starts": sparse.indptr, "columns": sparse.indices}
            vars(self).update((f"{name}_{x}", array.astype(np.int64)) for x, array in rows.items())
            vars(self)[f"{name}_entries"] = sparse.data.astype(float)
        return _Equations(
            vars(self), size=self.size, damped=self.damped, viscous=len(self.D_entries) > 0,
            inertia=len(self.E_entries) > 0, first=first, stride=stride,
            d=1 + 2 * len(self.frequencies) + self.records.shape[1] + self.called,
        )  # fmt: skip

    @property
    def roots(self) -> int:
        """Number of event functions."""
        return (3 if self.damped else 2) * int(np.sum(np.isfinite(self.law[:, 1:3])))

    def _function(self, name: str, size: int, results: int) -> Callable[[float, Array], Array]:
        """A function of a time and a state of this size. Solvers call it for each evaluation, so that it hands over
        bytes, which ctypes takes in a tenth of the time of an array's address."""
        function, whole, kept, c = getattr(library(), name), (size,), Real * results, self.c

        def call(t: float, z: Array) -> Array:
            if z.dtype != FLOAT or z.shape != whole:
                raise TypeError(f"{name} takes a float64 array of shape {whole}, not {z.dtype} {z.shape}")
            out = kept()
            function(t, z.tobytes(), out, c)
            return np.frombuffer(out)  # type: ignore[call-overload]

        return call

    def jacobian(self, t: float, z: Array, cj: float = 0.0, sign: float = 1.0) -> Array:
        """cj E + sign df/dz, (size, size), the rows of the integrals zero in df/dz."""
        N = self.size
        J = np.empty((N, N))
        if z.dtype != FLOAT or z.shape != (N,):
            raise TypeError(f"jacobian takes a float64 array of shape {(N,)}, not {z.dtype} {z.shape}")
        library().jacobian(t, z.tobytes(), cj, sign, address(J, (N, N)), N * N, 0, N, self.c)
        return J.T
