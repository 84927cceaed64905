"""Taylor series of a motion and of its derivatives: the functions of variation.c. Arrays are checked here once."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np

from ..basics.arrays import Array, IntArray
from .library import INTEGER, Address, Int, Structure, address, filled, library

_Regime = Structure(
    "n m h L P",
    "",
    "w2?: n; drag?: n; damping?: n n; rows?: m n; loads?: L n; kappa?: m; c?: m; stop?: m; inverse?: h h; "
    "mass_by?: P n n; stiffness_by?: P n n; damping_by?: P n n; rows_by?: P m n; loads_by?: P L n; kappa_by?: P m; "
    "c_by?: P m; stop_by?: P m; held int: h",
)


@cache
def _functions() -> Any:
    lib = library()
    lib.vary.argtypes = [ctypes.POINTER(_Regime.type), Int, Int, Int, *[Address] * 6]
    lib.vary_later.argtypes = lib.vary.argtypes
    return lib


class Regime:
    """A regime as variation.h has it; arrays that are None do not change, or are zero."""

    def __init__(self, held: IntArray, **arrays: Array | None) -> None:
        n, m, L = len(arrays["w2"]), len(arrays["rows"]), len(arrays["loads"])  # type: ignore[arg-type]
        P, h = len(arrays["stop_by"]), len(held)  # type: ignore[arg-type]
        self._kept: dict[str, Any] = {x: None if y is None else np.ascontiguousarray(y) for x, y in arrays.items()}
        self._kept["held"] = held
        self.sizes = (n, m, L, P)
        self._c = _Regime({"n": n, "m": m, "h": h, "L": L, "P": P}, self._kept)

    def series(self, K: int, drive: Array, shift: Array, start: Array) -> tuple[Array, ...]:
        """Coefficients eta (S, K + 1, 1 + D, n), u (S, K + 1, 1 + D, m), force (S, K - 1, 1 + D, m).

        drive (S, K + 1, 1 + P, L), shift (S, K + 1, 1 + D, m), start (S, 1 + D, 2n): see variation.h.
        """
        (n, m, _, _), (S, wide, _) = self.sizes, start.shape
        found = (np.empty((S, K + 1, wide, n)), np.empty((S, K + 1, wide, m)), np.empty((S, K - 1, wide, m)))
        filled(_functions().vary(*self._from(K, drive, shift, start), *(x.ctypes.data for x in found)))
        return found

    def later(self, K: int, drive: Array, shift: Array, start: Array, until: IntArray, late: Array) -> Array:
        """Sums of the series (E, 1 + D, 2n) at ``late`` (E,); until (S,): see variation.h."""
        S, wide, width = start.shape
        later = np.empty((len(late), wide, width))
        filled(_functions().vary_later(
            *self._from(K, drive, shift, start), address(until, (S,), INTEGER), address(late, (len(late),)),
            later.ctypes.data,
        ))  # fmt: skip
        return later

    def _from(self, K: int, drive: Array, shift: Array, start: Array) -> tuple[Any, ...]:
        (n, m, L, P), (S, wide, _) = self.sizes, start.shape
        return (
            ctypes.byref(self._c), S, wide - 1, K, address(drive, (S, K + 1, 1 + P, L)),
            address(shift, (S, K + 1, wide, m)), address(start, (S, wide, 2 * n)),
        )  # fmt: skip
