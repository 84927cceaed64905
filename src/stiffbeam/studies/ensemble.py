"""Past the horizon: what remains comparable there, the distributions over many perturbed runs."""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from ..cases import Case
from ..drive import Drive
from ..march.ensemble import integrate_ensemble, reference_ensemble
from ..march.members import perturbed
from ..measures.spectrum import amplitude_spectrum
from ..validation import InputError, integer
from .common import scheme_labels, scheme_of, system_of
from .study import Point, Row, Rows, Study

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
SAMPLES = 4000  # tip samples of a member, for the spectrum
LEDGERS = 24  # members of a scheme whose energy is followed: its spread is small, but for the trapezoidal rule
HARMONICS = 16  # the spectrum is kept up to this multiple of the drive


def points(
    case: Case,
    schemes: list[str] | None = None,
    form: str = "displacement",
    dt: float | None = None,
    t_end: float | None = None,
    members: int = 200,
    size: float = 1e-12,
    seed: int = 1,
    contact: str = "implicit",
) -> list[Point]:
    """The exact solution and every scheme at ``dt`` (the case's), each with the same ``members`` initial
    data, perturbed by ``size`` relative to the motion (see ``perturbed``)."""
    if case.problem.stops is None:
        raise InputError("case", case.name, "have stops")
    integer("members", members, 1)
    rest = {
        "form": form, "dt": case.dt if dt is None else dt, "t_end": case.t_end if t_end is None else t_end,
        "members": members, "size": size, "seed": seed, "contact": contact,
    }  # fmt: skip
    return [{"method": method} | rest for method in ["exact", *scheme_labels(case, schemes)]]


def evaluate(case: Case, point: Point) -> list[Row]:
    system = system_of(case, point["form"])
    dt, t_end = point["dt"], point["t_end"]
    members = perturbed(system, point["members"], point["size"], point["seed"])
    every = max(1, round(t_end / dt) // SAMPLES)
    t = np.arange(0, round(t_end / dt) + 1, every) * dt
    if point["method"] == "exact":
        many = reference_ensemble(system, t_end, members, t)
    else:
        scheme = scheme_of(point["method"])
        many = integrate_ensemble(system, scheme, dt, t_end, members, point["contact"], every)
    if np.all(np.isfinite(many.diverged)):
        raise InputError("dt", dt, "let one member at least reach the end", "use contact='implicit' or a smaller dt")
    whole = ~np.isfinite(many.diverged)
    drive = max(Drive.of(system).frequencies, default=0.0)
    response = _at_frequency(t, many.tip, drive)
    losses = np.full((len(many), 2), np.nan)
    for i in np.flatnonzero(whole)[: LEDGERS if point["method"] != "exact" else 0]:  # the exact flow loses nothing
        ledger = many.ledger(i)
        losses[i] = ledger.loss[-1], ledger.energy[0] + ledger.input[-1]
    rows: list[Row] = [
        {
            "kind": "member", "member": i, "count": int(many.impact_count[i]),
            "fraction": float(many.contact_fraction[i]), "peak_force": float(many.peak_force[i]),
            "impulse": float(many.impulse[i]), "diverged": not bool(whole[i]),
            "drive_amplitude": float(np.abs(response[i])), "drive_phase": float(np.angle(response[i])),
            "energy_lost": losses[i, 0], "energy_had": losses[i, 1],
        }
        for i in range(len(many))
    ]  # fmt: skip
    peaks = many.impacts.peaks[np.isfinite(many.impacts.peaks)]
    if len(peaks):
        rows += [{"kind": "peak", "quantile": q, "force": float(np.quantile(peaks, q))} for q in QUANTILES]
    return rows + _spectrum(t, many.tip[whole], drive)


def _at_frequency(t: Array, tips: Array, drive: float) -> Array:
    """The complex amplitude of every tip at the drive frequency, over whole periods counted from the end."""
    if not drive or t[-1] * drive < 2.0 * np.pi:
        return np.full(len(tips), np.nan + 0j)
    periods = np.floor(t[-1] * drive / (2.0 * np.pi) * (1.0 + 1e-12))
    here = t > t[-1] - 2.0 * np.pi * periods / drive * (1.0 + 1e-12)
    return 2.0 * np.mean(tips[:, here] * np.exp(-1j * drive * t[here]), axis=1)


def _spectrum(t: Array, tips: Array, drive: float) -> list[Row]:
    """Mean over the members and a band that holds 90 % of them."""
    omega, _ = amplitude_spectrum(t, tips[0], drive)
    amplitudes = np.array([amplitude_spectrum(t, tip, drive)[1] for tip in tips])
    last = np.searchsorted(omega, HARMONICS * drive) if drive else min(len(omega), 400)
    low, high = np.quantile(amplitudes, [0.05, 0.95], axis=0)
    return [
        {"kind": "spectrum", "omega": float(omega[k]), "amplitude": float(np.mean(amplitudes[:, k])),
         "low": float(low[k]), "high": float(high[k])}
        for k in range(1, last)
    ]  # fmt: skip


def distribution(rows: Rows, method: str, quantity: str) -> Array:
    """The values of ``quantity`` over the members that reached the end and have it."""
    own = [r for r in rows if r["kind"] == "member" and r["method"] == method and not r["diverged"]]
    values = np.array([r[quantity] for r in own], float)
    return values[np.isfinite(values)]


def difference(a: Array, b: Array) -> tuple[float, float]:
    """Mean of a minus mean of b, and the half-width of its 95 % interval (Welch, normal)."""
    spread = np.sqrt(np.var(a, ddof=1) / len(a) + np.var(b, ddof=1) / len(b)) if min(len(a), len(b)) > 1 else np.nan
    return float(np.mean(a) - np.mean(b)), float(1.96 * spread)


def answer(rows: Rows) -> str:
    exact = distribution(rows, "exact", "count")
    first = rows[0]
    parts = []
    for method in dict.fromkeys(r["method"] for r in rows if r["method"] != "exact"):
        count, share = distribution(rows, method, "count"), distribution(rows, method, "fraction")
        if not len(count) or not len(exact):
            continue
        off, interval = difference(count, exact)
        lost, had = (distribution(rows, method, f"energy_{name}") for name in ("lost", "had"))
        parts.append(
            f"{method} {np.mean(count):.4g} ± {np.std(count):.2g} ({off:+.3g} ± {interval:.2g}), "
            f"{100 * np.mean(share):.2g} % in contact"
            + (f", energy lost {np.mean(lost):.3g} ± {np.std(lost):.2g} of {np.mean(had):.3g}" if len(lost) else "")
        )
    if not len(exact):
        return "No member of the exact solution reached the end, and without it there is nothing to compare with."
    share = distribution(rows, "exact", "fraction")
    return (
        f"Over {len(exact)} members perturbed by {first['size']:g} the exact solution has {np.mean(exact):.4g} ± "
        f"{np.std(exact):.2g} impacts to t = {first['t_end']:g} (mean ± standard deviation) and is in contact "
        f"{100 * np.mean(share):.2g} % of the time; at dt = {first['dt']:g} (difference of means, 95 %): "
        f"{'; '.join(parts)}."
    )


STUDY = Study(
    name="ensemble",
    question="Past the horizon, do the schemes at least have the right distribution of impacts, forces and spectra?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"schemes": ["hht(alpha=-0.1)"], "members": 8, "t_end": 0.7},
)
