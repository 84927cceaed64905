"""Picture of the study ``ensemble``: distributions of counts, contact and forces, and the spectra."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..studies.ensemble import distribution
from ..studies.study import Records
from . import column, found_rows, look, say_empty, shared_legend, short


def draw(records: Records) -> Figure:
    """(a) impact counts, (b) contact share, (c) energy lost, (d) peak forces of the impacts, (e) spectra with
    90 % bands."""
    rows = found_rows(records)
    methods = list(dict.fromkeys(row["method"] for row in rows))
    figure = Figure(figsize=(11.0, 8.6), layout="constrained")
    size = f"{rows[0]['members']} members each, perturbed by {rows[0]['size']:g}" if rows else "no members"
    figure.suptitle(f"{records.case.name}: distributions past the horizon ({size})")
    axes = figure.subplot_mosaic([["counts", "shares", "losses"], ["forces", "spectra", "spectra"]])
    counts, shares, losses, forces, spectra = axes.values()
    for axis in (shares, losses, forces):
        axis.sharey(counts)
    if not rows:
        for axis in axes.values():
            say_empty(axis)
        return figure
    _boxes(counts, rows, methods, "count", 1.0)
    counts.set(xlabel=f"impacts to t = {rows[0]['t_end']:g}")
    counts.set_title("(a) impacts, member by member", loc="left")
    _boxes(shares, rows, methods, "fraction", 100.0)
    shares.set(xlabel="share of the time in contact, %")
    shares.set_title("(b) time in contact", loc="left")
    _boxes(losses, rows, methods, "energy_lost", 1.0)
    losses.axvline(0.0, color="black", lw=0.8, ls=":")
    losses.set(xlabel="energy; the exact motion loses none")
    losses.set_title("(c) energy lost by the scheme", loc="left")
    for axis in (shares, losses):
        axis.tick_params(labelleft=False)
    _peaks(forces, rows, methods)
    _spectra(spectra, rows, methods)
    counts.set_yticks(range(len(methods)), [short(method) for method in methods])
    counts.set_ylim(len(methods) - 0.4, -0.6)  # the four panels share it, the first method on top
    shared_legend(figure)
    return figure


def _boxes(axis, rows, methods, quantity: str, scale: float) -> None:
    """Every member as a dot in the method's line, the mean as a bar, the exact mean right through."""
    jitter = np.random.default_rng(0)
    for i, method in enumerate(methods):
        values = scale * distribution(rows, method, quantity)
        if not len(values):
            continue
        style = look(method)
        heights = i + jitter.uniform(-0.28, 0.28, len(values))
        axis.plot(values, heights, ls="", marker=".", ms=3, color=style["color"], alpha=0.45)
        axis.plot([np.mean(values)] * 2, [i - 0.38, i + 0.38], color=style["color"], lw=2.2)
        if method == "exact":
            axis.axvline(np.mean(values), color="black", lw=0.8, ls=":")
    axis.margins(x=0.04)


def _peaks(axis, rows, methods) -> None:
    """Quantiles of the peak force of all impacts."""
    for i, method in enumerate(methods):
        own = [row for row in rows if row["kind"] == "peak" and row["method"] == method]
        if not own:
            continue
        force, colour = column(own, "force"), look(method)["color"]
        axis.plot(force[[0, -1]], [i, i], color=colour, lw=1.2)
        axis.plot(force[[1, -2]], [i, i], color=colour, lw=5.0, solid_capstyle="butt")
        axis.plot(force[2], i, marker="o", ms=6, mfc="white", mec=colour, ls="")
    axis.set_xscale("log")
    axis.set(xlabel=r"peak force of an impact $\max|\sigma|$")
    axis.set_title("(d) forces: median, 50 %, 90 %", loc="left")


def _spectra(axis, rows, methods) -> None:
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
    axis.set(xlabel=r"angular frequency $\omega$", ylabel="mean amplitude of $u(1, t)$")
    axis.set_title("(e) spectra, mean over the members", loc="left")
