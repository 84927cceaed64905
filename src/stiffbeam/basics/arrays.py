"""The array type, arrays laid out for vector registers, float64 in JAX."""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import contextmanager
from importlib import import_module
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

# What compiled kernels take and return, beside float and int; numba reads the arguments, not these annotations.
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
    start = (-buffer.__array_interface__["data"][0] // 8) % LANES
    return buffer[start : start + count].reshape(shape)


def read_only(values: ArrayLike) -> Array:
    """A read-only copy of ``values``, or ``values`` itself if ``read_only`` made it.

    Results computed from it hold as long as it lives, and two that are one object are equal for good.
    """
    if is_read_only(values):
        return values  # type: ignore[return-value]
    copy = np.array(values, float, order="C")
    copy.setflags(write=False)
    _READ_ONLY[id(copy)] = copy
    return copy


def is_read_only(values: Any) -> bool:
    """Return True if ``read_only`` made the array, so that no writable view of it exists."""
    return isinstance(values, np.ndarray) and _READ_ONLY.get(id(values)) is values and not values.flags.writeable


def same(a: Array | None, b: Array | None) -> bool:
    """Return True if a and b are equal number by number; None equals only itself."""
    if a is None or b is None:
        return a is b
    return a is b or np.array_equal(a, b)


def step_lengths(t: Array) -> Array:
    """Length of time (k,) that each of the times t (k,) represents: half of both intervals next to it, at the ends a
    whole interval. It is dt everywhere for equidistant times, and 1 for a single time."""
    return np.gradient(t) if len(t) > 1 else np.ones(len(t))


@contextmanager
def float64_on_the_processor() -> Generator[None]:
    """A context in which JAX computes in float64 on the processor; outside it stays as it was.

    A step of a small stiff system is a chain of hundreds of short operations. Each of them costs a launch on a
    graphics card, which JAX takes by default where there is one.
    """
    import jax

    # A switch of the whole process in older versions of JAX moved out of ``experimental``.
    home = jax if hasattr(jax, "enable_x64") else import_module("jax.experimental")
    try:
        processor = jax.local_devices(backend="cpu")[0]
    except RuntimeError:  # JAX_PLATFORMS leaves the processor out
        processor = None
    with home.enable_x64(True), jax.default_device(processor):
        yield
