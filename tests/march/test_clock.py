"""Seconds of a run are those of its second time: the clock does not count the compilation of kernels."""

from __future__ import annotations

import time

from stiffbeam.basics.resources import clock, stopped_clock


def test_the_clock_counts_neither_waiting_nor_compiling():
    begun = clock()
    time.sleep(0.1)
    with stopped_clock():
        sum(range(10**6))
        with stopped_clock():
            sum(range(10**6))
    assert 0.0 <= clock() - begun < 0.03
