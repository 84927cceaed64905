"""The numbers of one table: impacts, contact, spectrum and errors of every run and of the exact motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffbeam.basics.arrays import Array
from stiffbeam.basics.text import plain
from stiffbeam.march.integrate import integrate
from stiffbeam.measures.comparison import compare
from stiffbeam.trajectory.trajectory import Diverged, Reference, Trajectory

from .ensembles import EXACT_MEMBERS, MEMBERS, Numbers, add_ensembles
from .motion import motion
from .reading import Reading
from .table import Made


def numbers_of(made: Made, members: int = MEMBERS, exact_members: int = EXACT_MEMBERS) -> Numbers:
    """{"runs": by equation, "exact": by form, "failures": by equation, ...}; plain numbers, None for NaN.

    members, exact_members: of each of the two ensembles of a run and of the exact motion, see
    ``add_ensembles``.
    """
    found: Numbers = {"runs": {}, "exact": {}, "failures": made.failures}
    for equation, run in made.runs.items():
        _, form = made.equations[equation]
        exact = replace(made.references[form], horizon=made.horizons[form])
        found["runs"][equation] = of_run(run, exact, made) | {"other contact": _other_contact(made, equation)}
    for form, exact in made.references.items():
        found["exact"][form] = of_exact(exact, made) | {"horizon": made.horizons[form]}
    add_ensembles(found, made, members, exact_members)
    return plain(found)


def of_run(run: Trajectory, exact: Reference, made: Made) -> Numbers:
    """Counts and measures of a run over its whole span, and its errors inside the horizon of ``exact``."""
    held = compare(run, exact)
    return {
        "scheme": run.provenance["method"],
        "form": run.provenance["form"],
        "impacts": run.impacts.count,
        "fraction": run.contacts[0].fraction,
        "peak_force": run.contacts[0].peak_force,
        "energy_lost": run.energy.lost_fraction(),
        "tip_error": held.tip_error_rms,
        "parted": held.contacts[0].matching.matched_until,
        "first_error": held.contacts[0].matching.first_error,
        "lag": held.phase.lag,
        "penetration": _penetration(run.tip[run.t <= exact.horizon], made),
        **motion(run.t, run.tip, run.tip_velocity, made),
    }


def of_exact(exact: Reference, made: Made) -> Numbers:
    """Counts and measures of the exact motion. impacts: by events; sampled: those that the table's step would see.

    digits: of the frozen multiprecision solution, whose row is the truth over the whole span; None in
    float64, whose row is one realisation past the horizon.
    """
    t = np.arange(round(made.case.t_end / made.case.dt) + 1) * made.case.dt
    u, v = exact.at(t)
    record = exact.contacts[0]
    return {
        "method": exact.provenance["method"],
        "digits": exact.provenance.get("digits"),
        "impacts": exact.impacts.count,
        "sampled": exact.impacts_sampled(made.case.dt).count,
        "fraction": record.fraction,
        "peak_force": record.peak_force,
        "penetration": _penetration(u[t <= made.horizons[exact.provenance["form"]]], made),
        **motion(t, u, v, made),
    }


def exact_name(form: str, row: Numbers) -> str:
    """Name of a row of ``of_exact``: true over the whole span, or exact to the horizon of float64."""
    if row["digits"]:
        return f"true, {form}"
    return f"exact, {form}; one realisation past {row['horizon']:.2g}"


def _penetration(u: Array, made: Made) -> float:
    """The farthest the tip gets into a stop."""
    return float(max(0.0, np.max(u) - made.stops.upper_bound, made.stops.lower_bound - np.min(u)))


def _other_contact(made: Made, equation: str) -> Numbers:
    """Impacts and share of contact with the contact read the other way; ``failed`` where that overflows."""
    other = Reading("extrapolated" if made.reading.contact == "implicit" else "implicit", made.reading.printed)
    scheme, form = made.equations[equation]
    case = made.case
    try:
        run = integrate(made.systems[form], other.scheme(scheme), case.dt, case.t_end, other.contact, every=1000)
    except Diverged as error:
        return {"contact": other.contact, "failed": str(error)}
    return {"contact": other.contact, "impacts": run.impacts.count, "fraction": run.contacts[0].fraction}
