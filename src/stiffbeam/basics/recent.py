"""Recent results by the content of what they were computed from, so that equal input is not computed twice."""

from __future__ import annotations

import hashlib
import weakref
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar

import numpy as np

from .arrays import Array, is_read_only

MOST = 256  # rows of an array whose content is compared: larger ones take longer to read than they save
Result = TypeVar("Result")
_DIGESTS: dict[int, tuple[weakref.ref[Array], bytes]] = {}  # of arrays that cannot change, by id


class Recent(Generic[Result]):
    """The results of the last ``most`` different keys, for functions whose result depends on the key alone.

    Threads may share it. A result that two of them compute at the same time is computed twice.

    Examples
    --------
    >>> squares = Recent[int](2)
    >>> squares.get(3, lambda: 9), squares.get(3, lambda: 0)
    (9, 9)
    """

    def __init__(self, most: int) -> None:
        self.most, self._results, self._lock = most, {}, Lock()

    def get(self, key: Hashable, compute: Callable[[], Result]) -> Result:
        """Return the result of ``key``, by ``compute`` where it is not one of the last."""
        with self._lock:
            if key in self._results:
                self._results[key] = result = self._results.pop(key)  # the latest is the last to go
                return result
        result = compute()
        with self._lock:
            self._results[key] = result
            if len(self._results) > self.most:
                del self._results[next(iter(self._results))]
        return result


def content(array: Array | None) -> bytes:
    """Digest of shape and numbers of an array of floats, bit by bit; of read-only arrays it is computed once."""
    if array is None:
        return b""
    remembered = _DIGESTS.get(id(array))
    if remembered is not None and remembered[0]() is array and not array.flags.writeable:
        return remembered[1]
    whole = np.ascontiguousarray(array)
    digest = hashlib.blake2b(whole.data, digest_size=16, salt=str(whole.shape).encode()[:16]).digest()
    if is_read_only(array):
        number = id(array)
        _DIGESTS[number] = weakref.ref(array, lambda _: _DIGESTS.pop(number, None)), digest
    return digest
