"""Past the horizon: what remains comparable there, the distributions over many perturbed runs.

Impacts and their rate, time in contact, largest forces, energy and spectra, with their spread over the members.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import integer
from ..figures import column, heading, look, new_figure, numeric, say_empty, shared_legend, short, tip_symbol
from ..files.cases import Case
from ..march.ensemble import integrate_ensemble
from ..measures.report import percent
from ..measures.smooth_motion import drive_frequency
from ..measures.spectrum import amplitude_spectrum, drive_amplitude
from ..model.members import SPREAD, perturbed
from ..references.ensemble import reference_ensemble
from ..trajectory.trajectory import Diverged
from .common import (
    Dt,
    End,
    Form,
    Schemes,
    Treatment,
    by_contact,
    joined,
    scheme_labels,
    scheme_of,
    system_of,
    to_the_end,
)
from .engine.study import Answer, Point, Records, Row, Rows, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
SAMPLES = 4000  # tip samples of a member, for the spectrum
LEDGERS = 24  # members of a scheme whose energy is followed: its spread is small, but for the trapezoidal rule
HARMONICS = 16  # the spectrum is kept up to this multiple of the drive


def points(
    case: Case,
    schemes: Schemes = None,
    form: Form = "displacement",
    dt: Dt = None,
    t_end: End = None,
    members: Annotated[int, "perturbed runs of each method"] = 200,
    size: Annotated[float, "of the perturbation, relative to the motion"] = SPREAD,
    seed: Annotated[int, "of the perturbations"] = 1,
    contact: Treatment = "implicit",
) -> list[Point]:
    """The exact solution and every scheme at ``dt`` (the case's), each with the same ``members`` initial
    data, perturbed by ``size`` relative to the motion."""
    integer("members", members, 1)
    rest = {
        "form": form, "dt": case.dt if dt is None else dt, "t_end": case.t_end if t_end is None else t_end,
        "members": members, "size": size, "seed": seed, "contact": contact,
    }  # fmt: skip
    return [{"method": method} | rest for method in ["exact", *scheme_labels(case, schemes)]]


def evaluate(case: Case, point: Point) -> list[Row]:
    """Rows of members, quantiles of peak forces and the spectrum, of one method."""
    system = system_of(case, point["form"])
    dt, t_end = point["dt"], point["t_end"]
    members = perturbed(system, point["members"], point["size"], point["seed"], t_end=t_end)
    every = to_the_end(round(t_end / dt), SAMPLES)
    t = np.arange(0, round(t_end / dt) + 1, every) * dt
    if point["method"] == "exact":
        many = reference_ensemble(system, t_end, members, t)
    else:
        scheme = scheme_of(point["method"])
        many = integrate_ensemble(system, scheme, dt, t_end, members, point["contact"], every)
    if np.all(np.isfinite(many.diverged)):
        raise Diverged(point["method"], float(np.max(many.diverged)), "use the implicit contact or a smaller dt")
    whole = ~np.isfinite(many.diverged)
    drive = drive_frequency(system)
    response = drive_amplitude(t, many.tip, drive)
    losses = np.full((len(many), 2), np.nan)
    for i in np.flatnonzero(whole)[: LEDGERS if point["method"] != "exact" else 0]:  # the exact flow loses nothing
        ledger = many.ledger(i)
        losses[i] = ledger.loss[-1] if ledger.sure() else np.nan, ledger.given[-1]
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
    """The values of ``quantity``, of one contact, over the members that reached the end and have it."""
    own = [r for r in rows if r["kind"] == "member" and r["method"] == method and not r["diverged"]]
    values = np.array([r[quantity] for r in own], float)
    return values[np.isfinite(values)]


def difference(a: Array, b: Array) -> tuple[float, float]:
    """Mean of a minus mean of b, and the half-width of its 95 % interval (Welch, normal)."""
    spread = np.sqrt(np.var(a, ddof=1) / len(a) + np.var(b, ddof=1) / len(b)) if min(len(a), len(b)) > 1 else np.nan
    return float(np.mean(a) - np.mean(b)), float(1.96 * spread)


def answer(rows: Rows, case: Case) -> str:
    """Mean counts of impacts against the exact ensemble, with their intervals, contact by contact."""
    return joined({place: _answer(own, case) for place, own in by_contact(rows).items()})


def _answer(rows: Rows, case: Case) -> str:
    """What is found at one contact."""
    units = case.units
    exact = distribution(rows, "exact", "count")
    if not len(exact):
        return "No member of the exact solution reached the end, and without it there is nothing to compare with."
    first = rows[0]
    end, dt = (units.measure(f"{first[name]:g}", "time") for name in ("t_end", "dt"))
    parts, table = [], []
    for method in dict.fromkeys(r["method"] for r in rows):
        count, share, force, lost, had = (
            distribution(rows, method, name)
            for name in ("count", "fraction", "peak_force", "energy_lost", "energy_had")
        )
        if not len(count):
            continue
        off, interval = difference(count, exact)
        line = {
            "method": short(method),
            "impacts": _spread(count),
            "off by": "–" if method == "exact" else f"{float(f'{off:.3g}'):+g} ± {interval:.2g}",
            "contact, %": _spread(100 * share, 2),
            units.label("largest force", "force"): _spread(force, 4) if len(force) else "–",
            "lost, %": _spread(100 * lost / np.mean(had)) if len(lost) and np.mean(had) > 0.0 else "–",
        }
        table.append(line)
        said = [f"{percent(float(np.mean(share)))} in contact"]
        if len(lost):
            energy = units.measure(f"{_spread(lost)} of {np.mean(had):.3g}", "energy")
            said.append(f"energy lost {energy}")
        if len(force):
            said.append(f"largest force {units.measure(_spread(force, 4), 'force')}")
        if method != "exact":
            parts.append(f"{method} {line['impacts']} ({line['off by']}), {', '.join(said)}")
    share, force = distribution(rows, "exact", "fraction"), distribution(rows, "exact", "peak_force")
    rate = f"{_spread(exact / first['t_end'])} per {units.time if units.known else 'unit of time'}"
    largest = f", largest force {units.measure(_spread(force, 4), 'force')}" if len(force) else ""
    head = (
        f"Over {len(exact)} members perturbed by {first['size']:g} the exact solution has {np.mean(exact):.4g} ± "
        f"{np.std(exact):.2g} impacts to t = {end} (mean ± standard deviation), {rate}, and is in contact "
        f"{percent(float(np.mean(share)))} of the time{largest}; at dt = {dt} (difference of means, 95 %)"
    )
    rest = (
        f"Over {len(exact)} members perturbed by {first['size']:g}, to t = {end} at dt = {dt}: mean ± standard "
        "deviation. Off by: difference of the means, ± holds with 95 %. Lost: of the most energy that start and loads "
        "have given. The largest force grows with the span. Where all members have the same, it is that of an impact "
        "before they part."
    )
    return Answer(f"{head}: {'; '.join(parts)}.", table, rest)


def _spread(values: Array, digits: int = 3) -> str:
    """Mean ± standard deviation."""
    mean, deviation = float(f"{np.mean(values):.{digits}g}"), float(f"{np.std(values):.2g}")
    return f"{mean:g} ± {deviation:g}" if deviation > 1e-6 * abs(mean) else f"all {mean:g}"


def draw(records: Records) -> Figure:
    """(a) impact counts, (b) contact share, (c) energy lost, (d) peak forces of the impacts, (e) spectra with
    90 % bands."""
    rows = numeric(records.found)
    methods = list(dict.fromkeys(row["method"] for row in rows))
    size = f"{rows[0]['members']} members each, perturbed by {rows[0]['size']:g}" if rows else "no members"
    units = records.case.units
    lines = [(method, place, own) for method in methods for place, own in by_contact(rows).items()]
    title = heading(records.case, f"distributions past the horizon ({size})")
    figure = new_figure(max(8.6, 3.9 + 0.3 * len(lines)), title)
    axes = figure.subplot_mosaic([["counts", "shares", "losses"], ["forces", "spectra", "spectra"]])
    counts, shares, losses, forces, spectra = axes.values()
    for axis in (shares, losses, forces):
        axis.sharey(counts)
    if not rows:
        for axis in axes.values():
            say_empty(axis)
        return figure
    _boxes(counts, lines, "count", 1.0)
    end = units.measure(f"{rows[0]['t_end']:g}", "time")
    counts.set(xlabel=f"impacts to t = {end}")
    counts.set_title("(a) impacts, member by member", loc="left")
    _boxes(shares, lines, "fraction", 100.0)
    shares.set(xlabel="share of the time in contact, %")
    shares.set_title("(b) time in contact", loc="left")
    _boxes(losses, lines, "energy_lost", 1.0)
    losses.axvline(0.0, color="black", lw=0.8, ls=":")
    losses.set(xlabel=units.label("energy", "energy"))
    losses.set_title("(c) energy lost; exact: none", loc="left")
    losses.locator_params(axis="x", nbins=5)
    losses.ticklabel_format(axis="x", scilimits=(-3, 4))
    for axis in (shares, losses):
        axis.tick_params(labelleft=False)
    _peaks(forces, lines)
    forces.set(xlabel=units.label(r"peak force of an impact $\max|\sigma|$", "force"))
    _spectra(spectra, rows, methods)
    spectra.set(
        xlabel=units.label(r"angular frequency $\omega$", "frequency"),
        ylabel=units.label(f"mean amplitude of {tip_symbol(records.case.beam)}", "length"),
    )
    counts.set_yticks(range(len(lines)), [short(method) + place for method, place, _ in lines])
    counts.set_ylim(len(lines) - 0.4, -0.6)  # the four panels share it, the first method on top
    shared_legend(figure, 5)
    return figure


def _boxes(axis: Axes, lines: list[tuple[str, str, list[Row]]], quantity: str, scale: float) -> None:
    """Every member as a dot in the line of its method and contact, the mean as a bar, the exact mean right through."""
    jitter = np.random.default_rng(0)
    for i, (method, _, rows) in enumerate(lines):
        values = scale * distribution(rows, method, quantity)
        if not len(values):
            continue
        style = look(method)
        heights = i + jitter.uniform(-0.28, 0.28, len(values))
        axis.plot(values, heights, ls="", marker=".", ms=3, color=style["color"], alpha=0.45)
        axis.plot([np.mean(values)] * 2, [i - 0.38, i + 0.38], color=style["color"], lw=2.2)
        if method == "exact":
            axis.axvline(float(np.mean(values)), color="black", lw=0.8, ls=":")
    axis.margins(x=0.04)


def _peaks(axis: Axes, lines: list[tuple[str, str, list[Row]]]) -> None:
    """Quantiles of the peak force of all impacts."""
    for i, (method, _, rows) in enumerate(lines):
        own = [row for row in rows if row["kind"] == "peak" and row["method"] == method]
        if not own:
            continue
        force, colour = column(own, "force"), look(method)["color"]
        axis.plot(force[[0, -1]], [i, i], color=colour, lw=1.2)
        axis.plot(force[[1, -2]], [i, i], color=colour, lw=5.0, solid_capstyle="butt")
        axis.plot(force[2], i, marker="o", ms=6, mfc="white", mec=colour, ls="")
    axis.set_xscale("log")
    axis.set_title("(d) forces: median, 50 %, 90 %", loc="left")


def _spectra(axis: Axes, rows: list[Row], methods: list[str]) -> None:
    top = 0.0
    for method in methods:
        own = [row for row in rows if row["kind"] == "spectrum" and row["method"] == method]
        if not own:
            continue
        style = look(method)
        omega = column(own, "omega")
        axis.plot(omega, column(own, "amplitude"), color=style["color"], ls=style["linestyle"],
                  lw=2.0 if method == "exact" else 1.0, label=short(method))  # fmt: skip
        if method == "exact":
            axis.fill_between(omega, column(own, "low"), column(own, "high"), color="0.75", lw=0, label="exact, 90 %")
        top = max(top, float(np.max(column(own, "amplitude"))))
    if top:
        axis.set_yscale("log")
        axis.set_ylim(1e-4 * top, 2.0 * top)
    axis.set_title("(e) spectra, mean over the members", loc="left")


STUDY = Study(
    name="ensemble",
    question="Past the horizon, do the schemes at least have the right distribution of impacts, forces and spectra?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    draw=draw,
    needs_motion=True,
    needs_stops=True,
    all_cores=True,
    smoke={"schemes": ["hht(alpha=-0.1)"], "members": 8, "t_end": 0.7},
)
