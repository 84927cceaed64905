"""The errors of a run against the answers of a problem, and the columns of a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError
from ..files.columns import TIMES, bare, read_columns, time_of
from ..model.contact import channel_motion
from ..trajectory.records import ContactRecord
from ..trajectory.trajectory import Reference, Trajectory
from .problem import Problem

PAIRED = 8  # impacts that are compared with the known ones
NAN = float("nan")


def errors_of(problem: Problem, run: Trajectory) -> dict[str, float]:
    """Errors of a run against the answers of a problem, NaN where run or problem lack the quantity.

    tip_error, tip_error_max: rms and largest |u - u_known| at the sample times, over max |u_known|. velocity_error:
    median of |v - v_known| there, over max |v_known|, which a jump at a sample does not spoil. impacts: number of
    impacts, -1 if unknown. impact_time_error: largest error of the first ``PAIRED`` impact times. peak_force_error:
    relative. energy_error: at t_end, over the energy that the system has had; > 0 is a gain.
    """
    known = problem.answers["tip"].value
    off = np.abs(_at(problem.times, run.t, run.tip, _rate(run)) - known) / np.max(np.abs(known))
    velocity = NAN
    if "tip_velocity" in problem.answers and "tip_velocity" not in run.provenance:
        rates = problem.answers["tip_velocity"].value
        velocity = float(np.median(np.abs(_at(problem.times, run.t, run.tip_velocity) - rates)))
        velocity /= float(np.max(np.abs(rates)))
    impacts, late = run.impacts.until(problem.t_end * (1 + 1e-9)), NAN
    times = known_impacts(problem)
    if 0 < len(times) <= impacts.count:
        late = float(np.max(np.abs(impacts.times[: len(times)] - times)))
    return {
        "tip_error": float(np.sqrt(np.mean(off**2))), "tip_error_max": float(np.max(off)), "velocity_error": velocity,
        "impacts": -1 if impacts.kind == "unknown" else impacts.count, "impact_time_error": late,
        "peak_force_error": _peak(problem, run), "energy_error": _energy(problem, run),
    }  # fmt: skip


def known_impacts(problem: Problem) -> Array:
    """The first known impact times, at most PAIRED."""
    return problem.answers["impacts"].value[:PAIRED] if "impacts" in problem.answers else np.zeros(0)


def _rate(run: Trajectory) -> Array | None:
    """Velocity of the tip, None where a spline has made it."""
    return None if "tip_velocity" in run.provenance else run.tip_velocity


def _at(times: Array, t: Array, u: Array, v: Array | None = None) -> Array:
    """u at the sample times: the run's own values where it has these times, else by cubics."""
    from scipy.interpolate import CubicHermiteSpline, CubicSpline

    nearest = np.clip(np.searchsorted(t, times), 1, len(t) - 1)
    nearest -= np.abs(t[nearest - 1] - times) < np.abs(t[nearest] - times)
    if np.all(np.abs(t[nearest] - times) <= 1e-9 * times[-1]):
        return u[nearest]
    spline = CubicSpline(t, u) if v is None else CubicHermiteSpline(t, u, v)
    return spline(np.minimum(times, t[-1]))


def _peak(problem: Problem, run: Trajectory) -> float:
    """Relative error of the largest force on the first contact."""
    record = run.contacts[0]
    if "peak_force" not in problem.answers or record.impacts.kind == "unknown" or record.stops.rigid:
        return NAN
    if isinstance(run, Reference):
        peak = record.peak_force
    elif record.stops.dissipative and "tip_velocity" in run.provenance:
        return NAN  # the force needs the velocity
    else:
        peak = _peak_between(run, record)
    return peak / problem.answers["peak_force"].value - 1.0


def _peak_between(run: Trajectory, record: ContactRecord) -> float:
    """Largest force at the steps and, by cubics, between them: where the contact turns and beside the largest forces.

    The largest at the steps alone is less by up to (w dt)^2/8.
    """
    from scipy.interpolate import CubicHermiteSpline, CubicSpline, PchipInterpolator

    t, u, v = run.t, record.position, record.velocity if _rate(run) is not None else None
    spline = CubicSpline(t, u) if v is None else CubicHermiteSpline(t, u, v)
    force = np.abs(record.stops.force(u, record.velocity))
    high = np.flatnonzero(force >= 0.9 * np.max(force))  # a damped stop may have its peak where nothing turns
    ends = np.unique(np.clip(np.concatenate([high - 1, high]), 0, len(t) - 2))
    fine = (t[ends, None] + np.diff(t)[ends, None] * np.linspace(0.0, 1.0, 33)[1:-1]).ravel()
    turns = spline.derivative().roots(extrapolate=False)
    fine = np.concatenate([t, fine, turns[np.isfinite(turns)]])
    rate = spline.derivative() if v is None else PchipInterpolator(t, v)  # the cubic's has the rounding of u over dt
    return float(np.max(np.abs(record.stops.force(spline(fine), rate(fine)))))


def _energy(problem: Problem, run: Trajectory) -> float:
    """Energy at t_end less the known one, over the energy that the system has had."""
    system = problem.system
    unknown = run.pieces is None and not isinstance(run, Reference)
    if "energy" not in problem.answers or unknown or any(c.offset is not None for c in system.contacts):
        return NAN
    last = int(np.argmin(np.abs(run.t - problem.t_end)))
    q, v = (x[last] for x in run.states)
    energy = float(sum(system.free_energies(q, v)))
    for contact in () if problem.rigid else system.contacts:
        stops, (u, rate) = contact.stops, channel_motion(contact.row, None, 0.0, q, v)
        if stops.state(u, rate):  # the energy of a damped stop that has let go is dissipated
            energy += float(stops.energy(u))
    return (energy - problem.answers["energy"].value) / problem.answers["energy_scale"].value


NAMES = {"u": ("u", "tip", "displacement"), "v": ("v", "velocity", "tip_velocity")}
COLUMNS = (["t", "u"], ["t", "u", "v"])


def read_trajectory(file: Path) -> tuple[Array, ...]:
    """(t, u), or (t, u, v) where there is a third column, see ``read_columns``.

    A first line may name them in any order: t or time; u, tip or displacement; v, velocity or tip_velocity. Without
    names that is the order. Raises InputError for other names, and for less than four rows.
    """
    table = read_columns(file, "--trajectory")
    names = ["tuv"[x] if isinstance(x, int) and x < 3 else _known(x) for x in table.columns]
    if sorted(names) not in COLUMNS:
        written = f"{file}: {' '.join(map(str, table.columns))!r}"
        raise InputError("--trajectory", written, "name t, u and perhaps v, each once", "write for example t,u,v")
    if len(table) < 4:
        found, remedy = f"{file}: {len(table)} lines of numbers", "write the run out at more times"
        raise InputError("--trajectory", found, "hold at least 4 of them", remedy)
    time_of(file, "--trajectory", table)
    return tuple(table.iloc[:, names.index(name)].to_numpy(float) for name in "tuv" if name in names)


def _known(name: object) -> str:
    """t, u or v for one of its names, else the name itself."""
    return "t" if bare(name) in TIMES else next((x for x, names in NAMES.items() if bare(name) in names), str(name))
