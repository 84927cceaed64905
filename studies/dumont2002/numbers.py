"""The numbers of one table: impacts, contact and errors of every run and of the exact motion, with their ensembles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from stiffbeam.basics.arrays import Array
from stiffbeam.basics.text import plain
from stiffbeam.march.integrate import integrate_ensemble
from stiffbeam.measures.comparison import compare
from stiffbeam.model.beam import natural_frequencies
from stiffbeam.model.members import SPREAD, perturbed_members
from stiffbeam.references.ensemble import reference_ensemble

from .table import Made

MEMBERS, EXACT_MEMBERS = 32, 12  # an exact member costs up to a hundred times a run
PERIODS = 10  # of the drive, at least, that every ensemble spans
CHANCE = 0.00135  # one-sided: three standard deviations of a normal distribution
Numbers = dict[str, Any]


def numbers_of(made: Made, members: int = MEMBERS, exact_members: int = EXACT_MEMBERS) -> Numbers:
    """{"runs": by equation, "exact": by form, "failures": by equation, "periods"}; plain numbers, None for NaN.

    The tip error and the impacts that match are those to the horizon, the rest to the table's T; "members" are those of
    an ensemble over ``PERIODS`` drive periods or more.
    """
    found: Numbers = {"runs": {}, "exact": {}, "failures": made.failures}
    for form, exact in made.references.items():
        t = np.arange(round(made.case.t_end / made.case.dt) + 1) * made.case.dt
        found["exact"][form] = {
            "digits": exact.provenance.get("digits"), "horizon": made.horizons[form],
            "impacts": exact.impacts.count, "sampled": exact.impacts_sampled(made.case.dt).count,
            "fraction": exact.contacts[0].fraction, "peak_force": exact.contacts[0].peak_force,
            "fast": _fast(made, t, exact.at(t)[1]), "members": _members(made, form, exact_members),
        }  # fmt: skip
    for equation, run in made.runs.items():
        form = made.equations[equation][1]
        held = compare(run, replace(made.references[form], horizon=made.horizons[form]))
        found["runs"][equation] = {
            "scheme": run.provenance["method"], "form": form, "impacts": run.impacts.count,
            "fraction": run.contacts[0].fraction, "peak_force": run.contacts[0].peak_force,
            "energy_lost": run.energy.lost_fraction(), "tip_error": held.tip_error_rms,
            "matched_until": held.contacts[0].matching.matched_until,
            "fast": _fast(made, run.t, run.tip_velocity), "members": _members(made, equation, members),
        }  # fmt: skip
    found["periods"] = round(_steps(made) * made.case.dt * made.drive / (2.0 * np.pi))
    return plain(found)


def _fast(made: Made, t: Array, v: Array) -> float:
    """Rms tip velocity from frequencies above the second natural one."""
    rates, speed = amplitude_spectrum(t, v, made.drive)
    second = natural_frequencies(made.case.beam, 2)[1]
    return float(np.sqrt(np.sum(speed[rates > second] ** 2) / 2.0))


def _steps(made: Made) -> int:
    """Steps of an ensemble: PERIODS drive periods, or as many as the table's span holds."""
    period = 2.0 * np.pi / made.drive
    return int(np.ceil(max(PERIODS, np.ceil(made.case.t_end / period - 1e-9)) * period / made.case.dt))


def _members(made: Made, motion: str, members: int) -> dict[str, list[float]]:
    """One value a member. impacts: to the table's T. depth: of the deepest visit, over the clearance."""
    scheme, form = made.equations.get(motion, (None, motion))
    system, steps = made.systems[form], _steps(made)
    starts, end = perturbed_members(system, members, SPREAD), steps * made.case.dt
    if scheme is None:
        many = reference_ensemble(system, end, starts, np.array([0.0, end]))
    else:
        chosen = made.reading.scheme(scheme)
        many = integrate_ensemble(system, chosen, made.case.dt, end, starts, made.reading.contact, steps)
    alive = np.flatnonzero(np.isnan(many.diverged))
    clearance = min(abs(stop) for stop in (made.stops.lower, made.stops.upper) if stop is not None)
    return {
        "impacts": [int(np.sum(many.contacts[0].impacts_of(int(i)).times <= made.case.t_end)) for i in alive],
        "fraction": many.contacts[0].fraction[alive].tolist(),
        "depth": (many.contacts[0].peak_force[alive] / made.stops.stiffness / clearance).tolist(),
    }


def exact_name(form: str, row: Numbers) -> str:
    """Name of a row of the exact motion: true over the whole span, or exact to the horizon of float64."""
    return f"true, {form}" if row["digits"] else f"exact, {form}; one realisation past {row['horizon']:.2g}"


# ---------------------------------------------------------------- one number for every member


@dataclass(frozen=True, eq=False)
class Sample:
    """One number for every member of an ensemble.

    A statement on means is True, False, or None where the spread of the members explains the difference in more than
    CHANCE of the cases (Student's t).
    """

    values: Array

    @classmethod
    def of(cls, row: Mapping[str, Any], measure: str) -> Sample:
        """A measure of the members of a row."""
        return cls(np.array(row["members"][measure], float))

    @property
    def mean(self) -> float:
        """Mean over the members."""
        return float(np.mean(self.values))

    @property
    def sd(self) -> float:
        """Standard deviation over the members; 0 for one."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else 0.0

    def written(self, scale: float = 1.0, unit: str = "") -> str:
        """Mean ± standard deviation, to the digits that the deviation leaves; a dash for no members."""
        if not len(self.values):
            return "–"
        mean, sd = scale * self.mean, scale * self.sd
        if not sd:
            return f"{mean:.4g}{unit}"
        places = max(0, -int(np.floor(np.log10(sd))) + (sd < 3.0 * 10.0 ** np.floor(np.log10(sd))))
        return f"{mean:.{places}f} ± {sd:.{places}f}{unit}"

    def above(self, other: Sample | float) -> bool | None:
        """True where the mean is above the other, None where the spread decides nothing."""
        if isinstance(other, Sample):
            error = np.hypot(self.sd / np.sqrt(len(self.values)), other.sd / np.sqrt(len(other.values)))
            gap, freedom = self.mean - other.mean, len(self.values) + len(other.values) - 2
        else:
            error, gap, freedom = self.sd / np.sqrt(len(self.values)), self.mean - other, len(self.values) - 1
        if error and (freedom < 1 or abs(gap) <= stats.t.isf(CHANCE, freedom) * error):
            return None
        return gap > 0.0


def amplitude_spectrum(t: Array, u: Array, drive: float) -> tuple[Array, Array]:
    """Angular frequencies and amplitudes of u at equidistant times t (k,), over as many whole drive periods as fit,
    counted from the end.

    A sinusoid A sin(w t) on a bin shows the amplitude A.
    """
    n, dt, period = len(t) - 1, float(t[1] - t[0]), 2.0 * np.pi / drive
    # Whole periods up to rounding are whole; all intervals where not one period fits.
    n = round(np.floor((t[-1] - t[0]) / period * (1 + 1e-12)) * period / dt) or n
    amplitude = np.abs(np.fft.rfft(u[-n:])) * 2.0 / n
    # The mean appears once in the transform, every other frequency also with the opposite sign.
    amplitude[0] /= 2.0
    return 2.0 * np.pi * np.fft.rfftfreq(n, dt), amplitude
