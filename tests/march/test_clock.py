"""Seconds of a run are those of its second time: the clock stands still while kernels are compiled."""

from __future__ import annotations

import time

from stiffbeam.basics.resources import clock, stopped_clock, wall_clock


def test_clocks_stand_still_while_kernels_are_compiled_and_count_no_waiting():
    begun, worked = wall_clock(), clock()
    with stopped_clock():
        stood = wall_clock()
        with stopped_clock():
            time.sleep(0.02)
        assert wall_clock() == stood
    assert begun <= stood <= wall_clock()
    time.sleep(0.02)
    assert wall_clock() >= stood + 0.015
    assert clock() - worked < 0.05
