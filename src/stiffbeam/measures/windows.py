"""Spans of time that measures are taken over, and the frequency that drives a system."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, positive
from ..model.drive import Drive
from ..model.modes import undamped_modes
from ..model.scales import oscillates
from ..model.system import System
from ..trajectory.trajectory import Reference, Trajectory


def drive_frequency(system: System) -> float:
    """The highest angular frequency that drives the system, 0 where none does."""
    return max(Drive.of(system).frequencies, default=0.0)


def slowest_period(system: System, t_end: float = np.inf) -> float:
    """The longest period of the drives and of the modes that oscillate in a run to t_end.

    Raises InputError where nothing does.
    """
    rates = [*undamped_modes(system).omega[oscillates(system, t_end)], *Drive.of(system).frequencies]
    if not rates:
        remedy = "give it stiffness or a Harmonic load, or a longer run"
        raise InputError("system", "no oscillation", "have a frequency without its stops", remedy)
    return 2.0 * np.pi / min(rates)


def impact_times(run: Trajectory) -> Array:
    """The times of the impacts at every contact of a run, in order."""
    return np.sort(np.concatenate([np.zeros(0), *(contact.impacts.times for contact in run.contacts)]))


def first_impacts_end(exact: Reference, impacts: int) -> float:
    """The end of a window that holds ``impacts`` impacts of ``exact`` and stays far from its horizon.

    It ends half-way to the next impact, so that whether a scheme counts the last one does not depend on
    rounding; a motion without so many ends at half the horizon.
    """
    positive("impacts", impacts)
    times = impact_times(exact)
    end = 0.5 * min(exact.horizon, float(exact.provenance["t_end"]))
    if len(times) > impacts:
        end = min(end, 0.5 * float(times[impacts - 1] + times[impacts]))
    return end
