"""The error of a motion against a reference, relative to the reference's largest displacement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array, step_lengths
from ..basics.validation import positive
from ..trajectory.trajectory import Reference, Trajectory
from .pair import run_of


@dataclass(frozen=True)
class TipError:
    """(u - u_ref)/max |u_ref| over the times both are given at; both 0 where run and reference are at rest."""

    rms: float
    max: float


def relative_error(u: Array, u_ref: Array) -> Array:
    """(u - u_ref)/max |u_ref|, (k,); u - u_ref itself for a reference at rest."""
    return (u - u_ref) / (float(np.max(np.abs(u_ref))) or 1.0)


def rms(error: Array, t: Array | None = None) -> float:
    """Root of the mean square of error (k,), at times t (k,) of the mean over time."""
    return float(np.sqrt(np.average(error**2, weights=None if t is None else step_lengths(t))))


def tip_error(u: Array, u_ref: Array) -> TipError:
    """rms and largest |error| of u (k,) against u_ref (k,) at the same times, k >= 1."""
    error = relative_error(u, u_ref)
    return TipError(rms(error), float(np.max(np.abs(error))))


def stays_within(run: Trajectory | Sequence[ArrayLike], reference: Reference, error: float) -> float:
    """The time to which |u_run - u_ref| <= error max |u_ref|, the largest over the whole window, at every output.

    ``run`` is a run or its arrays (t, tip) or (t, tip, tip velocity), as of ``compare``.
    The last output before the first that is further off, at most the window's end, the smaller of t_end and the
    horizon: past it the reference itself is not known. Raises InputError where the systems differ, where the
    reference has no horizon, and where it does not know the run's times.
    """
    positive("error", error)
    run = run_of(run, reference, "stays_within")
    end = min(float(run.t[-1]), float(reference.provenance["t_end"]), reference.horizon)
    t = run.t[run.t <= end * (1 + 1e-12)]
    off = np.abs(relative_error(run.tip[: len(t)], reference.at(t)[0])) > error
    return end if not np.any(off) else float(t[max(0, int(np.argmax(off)) - 1)])
