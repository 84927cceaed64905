"""Statistics past the horizon: distributions over many perturbed runs.

Impacts and their rate, time in contact, largest forces, energy and spectra, with their spread over the members.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.stats import t as student

from ..basics.arrays import Array
from ..basics.validation import integer
from ..figures.chart import (
    Axis,
    Band,
    Curve,
    Level,
    Mark,
    Panel,
    Picture,
    Ranges,
    column,
    curves,
    groups,
    look,
    short,
    tip_symbol,
)
from ..files.cases import Case
from ..march.ensemble import integrate_ensemble
from ..measures.frequencies import amplitude_spectrum, drive_amplitude, drive_frequency
from ..measures.report import DASH, percent
from ..model.members import SPREAD, perturbed_members
from ..references.ensemble import reference_ensemble
from ..schemes.labels import scheme_of as known_scheme
from ..testset.integrators import RECORDED
from ..trajectory.ensemble import Ensemble, Runs
from ..trajectory.trajectory import Diverged, Trajectory
from . import common
from .interface import Answer, Point, Records, Row, Rows, by_contact, declared

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
SAMPLES = 4000  # tip samples of a member, for the spectrum
LEDGERS = 24  # members of a scheme whose energy is followed: its spread is small, but for the trapezoidal rule
HARMONICS = 16  # the spectrum is kept up to this multiple of the drive


def points(
    case: Case,
    *,
    schemes: common.Integrators = None,
    form: common.Form,
    dt: common.Dt,
    t_end: common.End,
    members: common.Members = 200,
    size: Annotated[float, "of the perturbation, relative to the motion"] = SPREAD,
    seed: Annotated[int, "seed of the perturbations"] = 1,
    contact: common.Treatment = "implicit",
) -> list[Point]:
    """The exact solution and every scheme at ``dt`` (the case's), from the same ``members`` initial data, which differ
    by ``size`` relative to the motion. A solver runs at its default tolerance. Recorded runs of one name count as the
    members: perturb them by ``perturbed_members``."""
    integer("members", members, 2)  # one has no spread
    shared: Point = {
        "form": form, "dt": dt, "t_end": t_end,
        "members": members, "size": size, "seed": seed, "contact": contact,
    }  # fmt: skip
    plan: list[Point] = [{"method": "exact"} | shared]
    for one in common.integrators_of(case, schemes):
        if one.kind == RECORDED:
            runs = [run["recorded"] for run in common.recorded_points(one, case.system(form))]
            integer(f"members of {one.label}", len(runs), 2)
            plan.append(shared | {"method": one.label, "members": len(runs), "recorded": runs})
        elif one.label != "exact":
            plan.append({"method": one.label} | shared)
    return plan


def evaluate(case: Case, point: Point) -> list[Row]:
    """Rows of members, quantiles of peak forces and the spectrum, of one method."""
    system = case.system(point["form"])
    dt, t_end = point["dt"], point["t_end"]
    members = perturbed_members(system, point["members"], point["size"], point["seed"], t_end=t_end)
    recorded, scheme = point.get("recorded"), None if point["method"] == "exact" else known_scheme(point["method"])
    many: Ensemble | Runs
    every = common.to_the_end(round(t_end / dt), SAMPLES)
    t = np.arange(0, round(t_end / dt) + 1, every) * dt
    if point["method"] == "exact":
        many = reference_ensemble(system, t_end, members, t)
    elif scheme is None or recorded:
        each = recorded or [None] * len(members)
        many = Runs.of([
            _sampled(common.run_of(point["method"], one, member, dt, t_end), t)
            for one, member in zip(each, members, strict=True)
        ])  # fmt: skip
    else:
        many = integrate_ensemble(system, scheme, dt, t_end, members, point["contact"], every)
    if np.all(np.isfinite(many.diverged)):
        raise Diverged(point["method"], float(np.max(many.diverged)), "use the implicit contact or a smaller dt")
    whole = ~np.isfinite(many.diverged)
    drive = drive_frequency(system)
    response = drive_amplitude(t, many.tip, drive)
    losses = np.full((len(many), 2), np.nan)
    # The exact flow loses nothing; the runs of a function may hold no states.
    if isinstance(many, Ensemble) and point["method"] != "exact":
        for i in np.flatnonzero(whole)[:LEDGERS]:
            ledger = many.ledger(i)
            losses[i] = ledger.loss[-1] if ledger.is_resolved() else np.nan, ledger.supplied[-1]
    rows: list[Row] = []
    for number, seen in enumerate(many.contacts, 1):
        response, losses = (x if number == 1 else np.full_like(x, np.nan) for x in (response, losses))  # of the run
        rows += [
            {
                "kind": "member", "member": i, "contact_number": number, "count": int(seen.impact_count[i]),
                "fraction": float(seen.fraction[i]), "peak_force": float(seen.peak_force[i]),
                "impulse": float(seen.impulse[i]), "diverged": not bool(whole[i]),
                "drive_amplitude": float(np.abs(response[i])), "drive_phase": float(np.angle(response[i])),
                "energy_lost": losses[i, 0], "energy_had": losses[i, 1],
            }
            for i in range(len(many))
        ]  # fmt: skip
        peaks = seen.impacts.peaks[np.isfinite(seen.impacts.peaks)]
        peak = {"kind": "peak", "contact_number": number}
        rows += [peak | {"quantile": q, "force": float(np.quantile(peaks, q))} for q in QUANTILES if len(peaks)]
    return rows + _spectrum(t, many.tip[whole], drive)


def _sampled(run: Trajectory, t: Array) -> Trajectory:
    """Return the run with its tip at the times t (k,)."""
    spline = CubicHermiteSpline(run.t, run.tip, run.tip_velocity)
    return replace(run, t=t, tip=spline(t), tip_velocity=spline(t, 1))


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
    """The values of ``quantity``, of one contact, over the members that reached the end and have it. A rigid stop has
    a largest force, 0, only where nothing touches it, which is no distribution."""
    group = [r for r in rows if r["kind"] == "member" and r["method"] == method and not r["diverged"]]
    values = np.array([r[quantity] for r in group], float)
    known = np.isfinite(values)
    return values[known & (np.all(known) | (quantity != "peak_force"))]


def difference(a: Array, b: Array) -> tuple[float, float]:
    """Mean of a minus mean of b, and the half-width of its 95 % interval: Welch's, by Student's t."""
    off = float(np.mean(a) - np.mean(b))
    if min(len(a), len(b)) < 2:
        return off, float("nan")
    of_means = [np.var(x, ddof=1) / len(x) for x in (a, b)]
    variance = sum(of_means)
    if not variance:
        return off, 0.0
    freedom = 1.0 / sum((v / variance) ** 2 / (len(x) - 1) for v, x in zip(of_means, (a, b), strict=True))
    return off, float(student.ppf(0.975, freedom) * np.sqrt(variance))


def too_uncertain(scatter: Mapping[str, float], n: int, want: Mapping[str, float]) -> dict[str, str]:
    """Quantities whose mean over n exact motions has a wider interval than the wanted error, and why.

    scatter: relative standard deviation of an exact motion. No scheme meets such a want: the interval of ``difference``
    is at least that of the exact mean, with the 2 (n - 1) degrees of freedom that it has at most.
    """
    reasons = {}
    for name in [x for x in want if x in scatter]:
        width = float(student.ppf(0.975, 2 * (n - 1))) * scatter[name]
        if width / n**0.5 > want[name]:
            needed = 2.0 * (width / want[name]) ** 2  # of the scheme and of the exact motion
            interval = f"the mean of {n} exact motions has a 95 % interval of ±{width / n**0.5:.2g}"
            reasons[name] = f"{interval}; about {float(f'{needed:.1g}'):.0f} members are needed"
    return reasons


def answer(rows: Rows, case: Case) -> Answer:
    """Impacts, time in contact, forces and energy of every method at one contact, against the exact ensemble."""
    exact, units, first = distribution(rows, "exact", "count"), case.units, rows[0]
    if not len(exact):
        return Answer("No member of the exact solution reached the end: there is nothing to compare with.")
    end, dt = (units.measure(first[name], "time", "g") for name in ("t_end", "dt"))
    table, means = [], {}
    for method in dict.fromkeys(r["method"] for r in rows):
        count, share, force, lost, had = (
            distribution(rows, method, name)
            for name in ("count", "fraction", "peak_force", "energy_lost", "energy_had")
        )
        if not len(count):
            continue
        off, interval = difference(count, exact)
        if method != "exact":
            means[method] = float(np.mean(count))
        table.append({
            "method": short(method),
            "impacts": _spread(count),
            "off by": DASH if method == "exact" else f"{float(f'{off:.3g}'):+g} ± {interval:.2g}",
            f"impacts per {units.time if units.known else 'unit of time'}": _spread(count / first["t_end"]),
            "contact, %": _spread(100 * share, 2),
            units.label("largest force", "force"): _spread(force, 4),
            units.label("energy lost", "energy"): f"{_spread(lost)} of {_mean(had):.3g}" if len(lost) else DASH,
            "lost, %": _spread(100 * lost / _mean(had)) if _mean(had) > 0.0 else DASH,
        })  # fmt: skip
    counted = f"; schemes count {common.extremes(means, '{:.4g}'.format)} at dt = {dt}" if means else ""
    over = f", of the first {LEDGERS} members" if len(exact) > LEDGERS else ""
    share = percent(_mean(distribution(rows, "exact", "fraction")))
    return Answer(
        f"Over {len(exact)} members the exact solution has {np.mean(exact):.4g} ± {np.std(exact):.2g} impacts to "
        f"t = {end} and is in contact {share} of the time{counted}.",
        table,
        f"Members perturbed by {first['size']:g}, dt = {dt}: mean ± standard deviation. Off by: difference of the "
        "means, ± with 95 %. Lost: numerical dissipation, as a share of the initial energy plus the work of the loads"
        f"{over}. The largest force grows with the span.",
    )


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def _spread(values: Array, digits: int = 3) -> str:
    """Mean ± standard deviation, a dash for no values."""
    if not len(values):
        return DASH
    mean, deviation = float(f"{np.mean(values):.{digits}g}"), float(f"{np.std(values):.2g}")
    return f"{mean:g} ± {deviation:g}" if deviation > 1e-6 * abs(mean) else f"all {mean:g}"


def picture(records: Records) -> Picture:
    """Every member a dot in the line of its method and contact, the mean as a bar; forces as quantiles; spectra."""
    rows, beam = records.numbers, records.case.beam
    lines = [
        (method, place, group)
        for method, mine in groups(rows, "method").items()
        for place, group in by_contact(mine).items()
    ]
    names = Axis(names=[short(method) + place for method, place, _ in lines])
    end = records.case.units.measure(rows[0]["t_end"], "time", "g")
    force = Axis(r"peak force of an impact $\max|\sigma|$", "force", "log")
    units = records.case.units
    _, label, quantity = units.cycles(0.0)
    spectra = [row | {"across": float(units.cycles(row["omega"])[0])} for row in rows if row["kind"] == "spectrum"]
    exact = [row for row in spectra if row["method"] == "exact"]
    top = max((row["amplitude"] for row in spectra if row["amplitude"] > 0.0), default=np.nan)
    amplitudes = curves(spectra, "across", "amplitude", "method", exact=2.0, marker="")
    if exact:
        at, low, high = (column(exact, name) for name in ("across", "low", "high"))
        amplitudes.append(Band(low, high, at, "exact, 90 %"))
    across = Axis(label, quantity)
    limits = (1e-4 * top, 2.0 * top) if np.isfinite(top) else (None, None)
    up = Axis(f"mean amplitude of {tip_symbol(beam)}", "length", "log", limits)
    return Picture([
        [
            Panel("impacts, member by member", Axis(f"impacts to t = {end}"), names, _dots(lines, "count")),
            Panel("time in contact", Axis("share of the time in contact, %"), names, _dots(lines, "fraction", 100.0)),
            Panel(f"energy lost, {LEDGERS} members", Axis(f"energy lost to t = {end}", "energy"), names,
                  [*_dots(lines, "energy_lost"), Level(0.0, of="x", look={"color": "black"})]),
        ],
        [
            Panel("forces: median, 50 %, 90 %", force, names, _peaks(lines)),
            Panel("spectra, mean over the members", across, up, amplitudes),
        ],
    ], max(8.6, 3.9 + 0.3 * len(lines)), 5)  # fmt: skip


def _dots(lines: list[tuple[str, str, list[Row]]], quantity: str, scale: float = 1.0) -> list[Mark]:
    """Every member as a dot in its line, the mean as a bar, the exact mean right through."""
    jitter, marks = np.random.default_rng(0), list[Mark]()
    for i, (method, _, rows) in enumerate(lines):
        values, colour = scale * distribution(rows, method, quantity), look(method)["color"]
        if len(values):
            heights, mean = i + jitter.uniform(-0.28, 0.28, len(values)), float(np.mean(values))
            dots = {"linestyle": "", "marker": ".", "ms": 3, "color": colour, "alpha": 0.45}
            bar = Curve([mean, mean], [i - 0.38, i + 0.38], look={"color": colour, "lw": 2.2})
            marks += [Curve(values, heights, look=dots), bar]
            marks += [Level(mean, of="x", look={"color": "black"})] if method == "exact" else []
    return marks


def _peaks(lines: list[tuple[str, str, list[Row]]]) -> list[Mark]:
    """Quantiles of the peak force of all impacts."""
    marks = list[Mark]()
    for i, (method, _, rows) in enumerate(lines):
        if group := [row for row in rows if row["kind"] == "peak"]:
            force, colour = column(group, "force"), look(method)["color"]
            marks += [Ranges(i, force[k], force[-1 - k], look={"color": colour, "lw": width})
                      for k, width in ((0, 1.2), (1, 5.0))]  # fmt: skip
            marks.append(Curve(force[2], i, look={"marker": "o", "mfc": "white", "color": colour, "linestyle": ""}))
    return marks


STUDY = declared(
    __name__,
    "Past the horizon, do the schemes at least have the right distribution of impacts, forces and spectra?",
    needs_motion=True,
    needs_stops=True,
    all_cores=True,
    each_contact=True,
    smoke={"schemes": ["HHT(alpha=-0.1)"], "members": 8, "t_end": 0.7},
)
