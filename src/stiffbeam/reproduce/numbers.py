"""The numbers of one made table: impacts, contact, spectrum and errors of every run and of the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..arrays import Array
from ..closed_form import natural_frequencies
from ..march.ensemble import Ensemble, integrate_ensemble, reference_ensemble
from ..march.integrate import integrate
from ..march.members import perturbed
from ..measures.comparison import compare
from ..measures.peaks import band, even_over_odd, find_peaks, multiple_amplitudes, share_off_multiples
from ..measures.spectrum import amplitude_spectrum
from ..plain import plain
from ..trajectory import Diverged, Reference, Trajectory
from .reading import Reading
from .table import Made, equation_of

MEMBERS, EXACT_MEMBERS = 64, 8
PERTURBATION = 1e-12  # of the motion's own scale: no measurement could tell the members apart

Numbers = dict[str, Any]


def numbers_of(made: Made, members: int = MEMBERS, exact_members: int = EXACT_MEMBERS) -> Numbers:
    """{"runs": by equation, "true": by form, "failures": by equation}; plain numbers, None for NaN.

    members: of the ensembles whose initial data differ by PERTURBATION, which show what an impact count
    or a share of contact past the horizon is worth; 0 makes none.
    """
    found: Numbers = {"runs": {}, "true": {}, "failures": made.failures}
    for scheme, form in made.case.runs:
        equation = equation_of(scheme, form)
        if equation not in made.runs:
            continue
        run, truth = made.runs[equation], made.references[form]
        row = of_run(run, replace(truth, horizon=made.horizons[form]), made)
        row["other contact"] = _other_contact(made, equation)
        if members:
            copies = perturbed(made.systems[form], members, PERTURBATION)
            chosen = made.reading.scheme(scheme)
            row["ensemble"] = _spread(
                integrate_ensemble(
                    made.systems[form], chosen, made.case.dt, made.case.t_end, copies, made.reading.contact
                )
            )
        found["runs"][equation] = row
    for form, truth in made.references.items():
        row = of_truth(truth, made) | {"horizon": made.horizons[form]}
        if exact_members:
            copies = perturbed(made.systems[form], exact_members, PERTURBATION)
            row["ensemble"] = _spread(reference_ensemble(made.systems[form], made.case.t_end, copies))
        found["true"][form] = row
    return plain(found)


def of_run(run: Trajectory, truth: Reference, made: Made) -> Numbers:
    """What a run counts over its whole span, and its errors inside the horizon of ``truth``."""
    held = compare(run, truth)
    return {
        "scheme": run.provenance["method"],
        "form": run.provenance["form"],
        "impacts": run.impacts.count,
        "fraction": run.contacts[0].fraction,
        "peak_force": run.contacts[0].peak_force,
        "energy_lost": run.energy.lost_fraction(),
        "tip_error": held.tip_error_rms,
        "parted": held.matching.matched_until,
        "first_error": held.matching.first_error,
        "lag": held.phase.lag,
        "penetration": _penetration(run.tip[run.t <= truth.horizon], made),
        **motion(run.t, run.tip, run.tip_velocity, made),
    }


def of_truth(truth: Reference, made: Made) -> Numbers:
    """The same of the true motion, sampled at the table's step; impacts also by events."""
    t = np.arange(round(made.case.t_end / made.case.dt) + 1) * made.case.dt
    u, v = truth.at(t)
    record = truth.contacts[0]
    return {
        "method": truth.provenance["method"],
        "digits": truth.provenance.get("digits"),
        "impacts": truth.impacts_sampled(made.case.dt).count,
        "events": truth.impacts.count,
        "fraction": record.fraction,
        "peak_force": record.peak_force,
        "penetration": _penetration(u[t <= made.horizons[truth.provenance["form"]]], made),
        **motion(t, u, v, made),
    }


def truth_name(form: str, row: Numbers) -> str:
    """What the row of ``of_truth`` is called: float64 alone knows the motion to its horizon only."""
    return f"true, {form}" if row["digits"] else f"exact in float64, {form}"


def motion(t: Array, u: Array, v: Array, made: Made) -> Numbers:
    """Spectrum, regularity and fast motion of a tip, over whole drive periods.

    aperiodicity: rms of u(t + T) - u(t) over sqrt(2) times the rms of u about its mean, over the second
    half, T the drive's period: 0 for a periodic motion, about 1 where nothing is left of it. fast: the
    rms tip velocity from frequencies above the second natural one. fast_share: its share of the whole.
    """
    drive = made.drive
    omega, amplitude = amplitude_spectrum(t, u, drive)
    multiples = multiple_amplitudes(omega, amplitude, drive)
    rates, speed = amplitude_spectrum(t, v, drive)
    second = float(natural_frequencies(made.case.problem, 2)[1])
    fast = float(np.sqrt(np.sum(speed[rates > second] ** 2) / 2.0))
    whole = float(np.sqrt(np.sum(speed[1:] ** 2) / 2.0))
    shift = round(2.0 * np.pi / drive / float(t[1] - t[0]))
    late = u[len(u) // 2 :]
    change = late[shift:] - late[:-shift] if len(late) > 1.5 * shift else np.full(1, np.nan)
    return {
        "peaks": [
            {"name": p.name, "multiple": p.multiple, "amplitude": p.amplitude, "above": p.above}
            for p in find_peaks(omega, amplitude, drive)
        ],
        "multiples": multiples.tolist(),
        "even_over_odd": even_over_odd(multiples),
        "band": band(omega, amplitude, drive),
        "off_multiples": share_off_multiples(omega, amplitude, drive),
        "aperiodicity": float(np.sqrt(np.mean(change**2)) / (np.sqrt(2.0) * np.std(late))),
        "fast": fast,
        "fast_share": fast / whole,
    }


def _penetration(u: Array, made: Made) -> float:
    """The farthest the tip gets into a stop."""
    stops = made.case.problem.stops
    assert stops is not None
    return float(max(0.0, np.max(u) - stops.g2, stops.g1 - np.min(u)))


def _other_contact(made: Made, equation: str) -> Numbers:
    """Impacts and share of contact with the contact read the other way; ``failed`` where that overflows."""
    other = Reading("extrapolated" if made.reading.contact == "implicit" else "implicit", made.reading.printed)
    for scheme, form in made.case.runs:
        if equation_of(scheme, form) == equation:
            try:
                run = integrate(
                    made.systems[form], other.scheme(scheme), made.case.dt, made.case.t_end, other.contact, every=1000
                )
            except Diverged as error:
                return {"contact": other.contact, "failed": str(error)}
            return {"contact": other.contact, "impacts": run.impacts.count, "fraction": run.contacts[0].fraction}
    raise AssertionError(equation)


def _spread(ensemble: Ensemble) -> Numbers:
    """Mean and standard deviation over the members that went through."""
    whole = np.isnan(ensemble.diverged)
    counts, shares = ensemble.impact_count[whole], ensemble.contact_fraction[whole]
    return {
        "members": int(np.sum(whole)),
        "impacts": float(np.mean(counts)) if len(counts) else float("nan"),
        "impacts_sd": float(np.std(counts, ddof=1)) if len(counts) > 1 else float("nan"),
        "fraction": float(np.mean(shares)) if len(shares) else float("nan"),
        "fraction_sd": float(np.std(shares, ddof=1)) if len(shares) > 1 else float("nan"),
    }
