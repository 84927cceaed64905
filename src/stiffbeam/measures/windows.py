"""Spans of time that measures are taken over, and the frequency that drives a system."""

from __future__ import annotations

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, positive
from ..model.drive import Drive
from ..model.modes import undamped_modes
from ..model.system import System
from ..trajectory.trajectory import Reference, Trajectory


def drive_frequency(system: System) -> float:
    """The highest angular frequency that drives the system, 0 where none does."""
    return max(Drive.of(system).frequencies, default=0.0)


def slowest_period(system: System) -> float:
    """The longest of the periods of the drives and of the lowest natural one.

    Raises InputError where nothing oscillates.
    """
    basis = undamped_modes(system)
    frequencies = [*map(float, basis.omega[basis.omega > 0.0][:1]), *Drive.of(system).frequencies]
    if not frequencies:
        remedy = "give it stiffness or a Harmonic drive"
        raise InputError("system", "no stiffness and no drive", "have a frequency", remedy)
    return 2.0 * np.pi / min(frequencies)


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
