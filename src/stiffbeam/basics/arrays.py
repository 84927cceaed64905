"""The array type, arrays aligned for vector registers, and a store of recent results by the content of their input."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, Generic, TypeVar
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]  # float64 unless a docstring says otherwise
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
LANES = 8  # doubles in the widest vector register
_READ_ONLY: WeakValueDictionary[int, Array] = WeakValueDictionary()  # what ``read_only`` has made, by id


def padded(size: int, least: int = LANES) -> int:
    """``size`` rounded up to a multiple of LANES, not below ``least``."""
    return max(least, -(-size // LANES) * LANES)


def aligned(shape: tuple[int, ...]) -> Array:
    """Zeros at a 64-byte boundary."""
    count = math.prod(shape)
    buffer = np.zeros(count + LANES)
    # Up to the next boundary: 8 doubles are 64 bytes.
    start = (-buffer.__array_interface__["data"][0] // 8) % LANES
    return buffer[start : start + count].reshape(shape)


def copied(values: Array) -> Array:
    """A copy at a 64-byte boundary."""
    copy = aligned(values.shape)
    copy[:] = values
    return copy


def read_only(values: ArrayLike) -> Array:
    """A read-only copy of ``values``, or ``values`` itself if ``read_only`` made it.

    Results computed from it hold as long as it lives, and two that are one object are equal for good.
    """
    if is_read_only(values):
        return values  # type: ignore[return-value]
    copy = np.array(values, float, order="C")
    copy.setflags(write=False)
    # By id, held weakly: the entry goes with the array.
    _READ_ONLY[id(copy)] = copy
    return copy


def is_read_only(values: Any) -> bool:
    """Return True if ``read_only`` made the array, so that no writable view of it exists."""
    # The id of a dead array may be used again, and a caller may make an array writeable: test for both.
    return isinstance(values, np.ndarray) and _READ_ONLY.get(id(values)) is values and not values.flags.writeable


def same(a: Array | None, b: Array | None) -> bool:
    """Return True if a and b are equal number by number; None equals only itself."""
    return a is b or (a is not None and b is not None and np.array_equal(a, b))


def step_lengths(t: Array) -> Array:
    """Length of time (k,) that each of the times t (k,) represents: half of both intervals next to it, at the ends a
    whole interval. It is dt everywhere for equidistant times, and 1 for a single time."""
    return np.gradient(t) if len(t) > 1 else np.ones(len(t))


Result = TypeVar("Result")


class Recent(Generic[Result]):
    """The results of the last ``most`` different keys, for functions whose result depends on the key alone.

    Threads may share it. A result that two of them compute at the same time is computed twice.
    """

    def __init__(self, most: int) -> None:
        self.most, self._results, self._lock = most, {}, Lock()

    def get(self, key: Hashable, compute: Callable[[], Result]) -> Result:
        """Return the result of ``key``, by ``compute`` where it is not one of the last."""
        with self._lock:
            if key in self._results:
                self._results[key] = result = self._results.pop(key)  # the latest is the last to go
                return result
        # Outside the lock, so that no thread waits for the result of another key.
        result = compute()
        with self._lock:
            self._results[key] = result
            if len(self._results) > self.most:
                del self._results[next(iter(self._results))]
        return result


def content(array: Array | None) -> bytes:
    """Digest of shape and numbers of an array of floats, bit by bit."""
    if array is None:
        return b""
    whole = np.ascontiguousarray(array)
    # The shape is part of the content: equal bytes in another shape are another array.
    return hashlib.blake2b(whole.data, digest_size=16, salt=str(whole.shape).encode()[:16]).digest()
