"""The numbers of one table: impacts, contact and errors of every run and of the exact motion, with their ensembles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats

import stiffbeam as sb
from stiffbeam.basics.arrays import Array
from stiffbeam.basics.text import plain
from stiffbeam.measures.report import DASH
from stiffbeam.model.members import SPREAD

from .table import Table, equations, roots

MEMBERS, EXACT_MEMBERS = 32, 12  # an exact member costs up to a hundred times a run
PERIODS = 10  # of the drive, at least, that every ensemble spans
CHANCE = 0.00135  # one-sided: three standard deviations of a normal distribution
Numbers = dict[str, Any]


def numbers_of(table: Table, members: int = MEMBERS, exact_members: int = EXACT_MEMBERS) -> Numbers:
    """{"runs": by equation, "exact": by form, "failures": by equation, "periods"}; plain numbers, None for NaN.

    The tip error and the impacts that match are those to the horizon, the rest to the table's T; "members" are those of
    an ensemble over ``PERIODS`` drive periods or more.
    """
    case, runs, exact = table.case, dict[str, Numbers](), dict[str, Numbers]()
    t = np.arange(table.steps + 1) * case.dt
    for form, true in table.references.items():
        row = _shared(table, true, t, true.at(t)[1]) | {"horizon": table.horizons[form]}
        exact[form] = row | {"members": _members(table, form, exact_members)}
    for equation, run in table.runs.items():
        form = equations(case)[equation][1]
        held = sb.compare(run, replace(table.references[form], horizon=table.horizons[form]))
        runs[equation] = _shared(table, run, run.t, run.tip_velocity) | {
            "scheme": run.provenance["method"], "form": form, "energy_lost": run.energy.lost_fraction(),
            "tip_error": held.tip_error_rms, "matched_until": held.contacts[0].matching.matched_until,
            "members": _members(table, equation, members),
        }  # fmt: skip
    periods = round(_steps(table) * case.dt * table.drive / (2.0 * np.pi))
    return plain({"runs": runs, "exact": exact, "failures": table.failures, "periods": periods})


def _shared(table: Table, motion: sb.Trajectory, t: Array, v: Array) -> Numbers:
    """Contact of a run or of a true motion, and its rms tip velocity from frequencies above the second natural one."""
    rates, speed = amplitude_spectrum(t, v, table.drive)
    fast = speed[rates > roots(2)[1] ** 2 * np.sqrt(table.case.beam.stiffness)]
    contact = motion.contacts[0]
    return {
        "impacts": contact.impacts.count, "fraction": contact.fraction, "peak_force": contact.peak_force,
        "fast": np.sqrt(np.sum(fast**2) / 2.0),
    }  # fmt: skip


def _steps(table: Table) -> int:
    """Steps of an ensemble: PERIODS drive periods, or as many as the table's span holds."""
    period = 2.0 * np.pi / table.drive
    return int(np.ceil(max(PERIODS, np.ceil(table.case.t_end / period - 1e-9)) * period / table.case.dt))


def _members(table: Table, motion: str, members: int) -> dict[str, list[float]]:
    """One value a member. impacts: to the table's T. depth: of the deepest visit, over the clearance."""
    case, steps, reading = table.case, _steps(table), table.reading
    scheme, form = equations(case).get(motion, (None, motion))
    system, end = table.systems[form], steps * case.dt
    starts = sb.perturbed_members(system, members, SPREAD)
    if scheme is None:
        many = sb.reference_ensemble(system, end, starts, np.array([0.0, end]))
    else:
        many = sb.integrate_ensemble(system, reading.scheme(scheme), case.dt, end, starts, reading.contact, steps)
    alive, contact = np.flatnonzero(np.isnan(many.diverged)), many.contacts[0]
    clearance = min(abs(stop) for stop in (table.stops.lower, table.stops.upper) if stop is not None)
    return {
        "impacts": [contact.impacts_of(int(i)).until(case.t_end).count for i in alive],
        "fraction": contact.fraction[alive].tolist(),
        "depth": (contact.peak_force[alive] / table.stops.stiffness / clearance).tolist(),
    }


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


# ---------------------------------------------------------------- one number for every member


def mean_and_deviation(values: Sequence[float]) -> tuple[float, float]:
    """Mean and standard deviation over the members; the latter is 0 for one member."""
    return float(np.mean(values)), float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def spread(row: Mapping[str, Any], measure: str, scale: float = 1.0, unit: str = "") -> str:
    """Mean ± standard deviation over the members of a row, to the digits that the deviation leaves; a dash for none."""
    if not row["members"][measure]:
        return DASH
    mean, sd = (scale * x for x in mean_and_deviation(row["members"][measure]))
    if not sd:
        return f"{mean:.4g}{unit}"
    places = max(0, -int(np.floor(np.log10(sd))) + (sd < 3.0 * 10.0 ** np.floor(np.log10(sd))))
    return f"{mean:.{places}f} ± {sd:.{places}f}{unit}"


def above(values: Sequence[float], other: Sequence[float]) -> bool | None:
    """Return True where the mean over members is above that of others, which for a limit is one number.

    None where the spread of the members explains the difference in more than CHANCE of the cases (Student's t).
    """
    (mean, sd), (limit, limit_sd) = mean_and_deviation(values), mean_and_deviation(other)
    error = np.hypot(sd / np.sqrt(len(values)), limit_sd / np.sqrt(len(other)))
    freedom = len(values) + len(other) - 2
    if error and (freedom < 1 or abs(mean - limit) <= stats.t.isf(CHANCE, freedom) * error):
        return None
    return mean > limit
