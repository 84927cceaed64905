"""The ensembles of one table: measures past the horizon, from two sets of seeds that share no member.

Initial data differ by PERTURBATION of the motion's own scale. A number that differs between members is known to their
spread only, and a statement about the motion is one about their distribution.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from stiffbeam.basics.arrays import Array
from stiffbeam.march.ensemble import integrate_ensemble
from stiffbeam.measures.frequencies import whole_periods
from stiffbeam.model.members import SPREAD, perturbed_members
from stiffbeam.references.ensemble import reference_ensemble
from stiffbeam.schemes import Scheme
from stiffbeam.trajectory.ensemble import Ensemble

from .motion import motion
from .table import Made

SEEDS = (1, 2)
MEMBERS, EXACT_MEMBERS = 16, 6  # of each seed; an exact member costs up to a hundred times a run
# With 1e-12 the members of a scheme share the error that it makes before they diverge, and their spread is too small to
# be that of the motion: six of the 81 claims got another verdict with it.
PERTURBATION = SPREAD
PERIODS = 10  # of the drive, at least, that every ensemble spans
SAMPLES = 20_000  # of the tip, at most: above the fourth part of the grid's modes in every table
LINES = 15  # multiples of the drive whose complex amplitudes are kept

Numbers = dict[str, Any]


def add_ensembles(found: Numbers, made: Made, members: int, exact_members: int) -> None:
    """Puts ``ensemble`` = {seed: {measure: one value a member}} into every row of runs and exact motions.

    Beside them ``span`` (t_end, periods and members of a seed) and ``apart``: for two motions of the table
    the rms difference of their tips over their own rms, member by member; of a motion with itself between
    one member and the next. It is 0 for one curve and sqrt(2) for two that have nothing in common.
    A run all of whose members overflow has no ensemble.
    """
    steps, every = _steps(made)
    t = np.arange(0, steps + 1, every) * made.case.dt
    end = steps * made.case.dt
    tips: dict[tuple[str, str], Array] = {}
    for seed in SEEDS:
        for name, row in [*found["runs"].items(), *found["exact"].items()]:
            row.setdefault("ensemble", {})
            ensemble = _drawn(made, name, members if name in found["runs"] else exact_members, seed, end, every, t)
            alive = np.flatnonzero(np.isnan(ensemble.diverged))
            row["overflowed"] = row.get("overflowed", 0) + len(ensemble) - len(alive)
            if len(alive):
                row["ensemble"][str(seed)] = _measured(made, ensemble, alive, t)
                tips[name, str(seed)] = ensemble.tip[alive]
    periods = round(end * made.drive / (2.0 * np.pi))
    found["span"] = {"t_end": end, "periods": periods, "members": members, "exact_members": exact_members}
    found["apart"] = _apart(tips)


def _steps(made: Made) -> tuple[int, int]:
    """(steps, steps a sample): whole drive periods, PERIODS of them or as many as the table's span holds."""
    period, dt = 2.0 * np.pi / made.drive, made.case.dt
    wanted = max(PERIODS, int(np.ceil(made.case.t_end / period - 1e-9))) * period / dt
    every = int(np.ceil(wanted / SAMPLES))
    return every * int(np.ceil(wanted / every)), every


def _drawn(made: Made, name: str, members: int, seed: int, end: float, every: int, t: Array) -> Ensemble:
    if name in made.systems:
        system = made.systems[name]
        return reference_ensemble(system, end, perturbed_members(system, members, PERTURBATION, seed), t)
    scheme, form = made.equations[name]
    return _marched(made, scheme, form, members, seed, end, every)


def _marched(made: Made, scheme: Scheme, form: str, members: int, seed: int, end: float, every: int) -> Ensemble:
    system, chosen = made.systems[form], made.reading.scheme(scheme)
    copies = perturbed_members(system, members, PERTURBATION, seed)
    return integrate_ensemble(system, chosen, made.case.dt, end, copies, made.reading.contact, every)


def _measured(made: Made, ensemble: Ensemble, alive: Array, t: Array) -> dict[str, list[Any]]:
    """One value a member. impacts: to the table's T. depth: of the deepest visit, over the clearance."""
    stops = made.stops
    clearance = min(abs(stop) for stop in (stops.lower, stops.upper) if stop is not None)
    found: dict[str, list[Any]] = {
        "impacts": [int(np.sum(ensemble.contact.impacts_of(i).times <= made.case.t_end)) for i in alive],
        "fraction": ensemble.contact_fraction[alive].tolist(),
        "depth": (ensemble.peak_force[alive] / stops.stiffness / clearance).tolist(),
        "lines": [lines(t, ensemble.tip[i], made.drive) for i in alive],
    }
    for i in alive:
        for name, value in motion(t, ensemble.tip[i], ensemble.tip_velocity[i], made).items():
            if isinstance(value, float):
                found.setdefault(name, []).append(value)
    return found


def lines(t: Array, u: Array, drive: float) -> list[list[float]]:
    """[Re c_k, Im c_k] with u ~ sum Re(c_k exp(i k drive t)), k = 1 .. LINES, over whole periods to the end.

    The phase is relative to t = 0, so that in the mean over members only what the drive determines is left.
    """
    n = whole_periods(t, drive)
    order = np.arange(1, LINES + 1)
    waves = np.exp(-1j * drive * np.outer(order, t[-n:]))
    c = 2.0 / n * waves @ (u[-n:] - np.mean(u[-n:]))
    return np.stack([c.real, c.imag], axis=1).tolist()


def _apart(tips: dict[tuple[str, str], Array]) -> dict[str, dict[str, list[float]]]:
    names = list(dict.fromkeys(name for name, _ in tips))
    found: dict[str, dict[str, list[float]]] = {}
    for a, b in [*((name, name) for name in names), *combinations(names, 2)]:
        for seed in map(str, SEEDS):
            if (a, seed) not in tips or (b, seed) not in tips:
                continue
            u, w = tips[a, seed], tips[b, seed]
            if a == b:
                w = np.roll(w, 1, axis=0)
            if a == b and len(u) < 2:
                continue
            m = min(len(u), len(w))
            found.setdefault(f"{a} | {b}", {})[seed] = [_difference(u[i], w[i]) for i in range(m)]
    return found


def _difference(u: Array, w: Array) -> float:
    return float(np.sqrt(np.mean((u - w) ** 2) / (0.5 * np.mean(u**2 + w**2))))
