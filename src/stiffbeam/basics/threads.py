"""Work on slices of a sequence, one thread per core: compiled code releases Python's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence, Sized
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from .validation import InputError

Part = TypeVar("Part", bound=Sized)


def cores() -> int:
    """The threads an ensemble marches on: STIFFBEAM_THREADS, else the cores this process may use."""
    wanted = os.environ.get("STIFFBEAM_THREADS", "").strip()
    if wanted:
        if not wanted.isdigit() or int(wanted) < 1:
            raise InputError("STIFFBEAM_THREADS", wanted, "be an integer >= 1", "unset it to use every core")
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over_slices(
    work: Callable[[Any], Part],
    items: Sequence[Any],
    most: int,
    threads: int,
    progress: Callable[[int], None] | None,
) -> Iterator[Part]:
    """``work`` on slices of at most ``most`` items, what it makes of each, as long as the slice, in order.

    progress: called with the number of items done. Where a slice fails, those not begun are left out.
    """
    size = min(most, max(1, len(items) // (4 * threads))) if threads > 1 else most
    with ThreadPoolExecutor(threads) as pool:
        parts: list[Future[Any]] = [pool.submit(work, items[i : i + size]) for i in range(0, len(items), size)]
        try:
            done = 0
            for part in parts:
                found = part.result()
                done += len(found)
                if progress is not None:
                    progress(done)
                yield found
        finally:
            for part in parts:
                part.cancel()
