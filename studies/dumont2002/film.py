"""The film of a table: the beam between its stops, the paper's schemes beside the exact motion."""

from __future__ import annotations

from pathlib import Path

from stiffbeam.figures.animation import animate
from stiffbeam.references import reference

from .table import Made

FORM = "displacement"
PAST = 1.25  # horizons: long enough to see where the exact motion is one among many
SECONDS, FRAMES_PER_SECOND, DPI = 8.0, 10, 60  # about a megabyte


def film(made: Made, file: Path) -> Path:
    """Write it: the runs on the displacement form, from the start to a quarter past the horizon."""
    system = made.systems[FORM]
    end = min(made.case.t_end, PAST * made.horizons[FORM])
    runs = [run for run in made.runs.values() if run.fingerprint == system.fingerprint]
    return animate([reference(system, end), *runs], file, SECONDS, FRAMES_PER_SECOND, end, dpi=DPI)
