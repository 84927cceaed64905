"""Statistics past the horizon: distributions over many perturbed runs.

Impacts and their rate, time in contact, durations of contacts, largest forces and energy, with their spread over the
members. A duration lasts from the entry into a stop to the exit from it. Most contacts are short bounces, most
of the time in contact is spent in a few long ones: so the table has the median over the contacts and the duration
beyond which half of the time in contact is spent.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from scipy.stats import ttest_ind

from ..basics.arrays import Array
from ..basics.text import with_unit
from ..figures.chart import Figure, lines, log_scale, look, name_lines, say_empty, shared_legend, short
from ..files.cases import Case
from ..march.integrate import integrate_ensemble
from ..measures.comparison import lost_fractions
from ..measures.report import DASH, ROUNDING, extremes, percent
from ..model.members import SPREAD, perturbed_members
from ..references.ensemble import reference_ensemble
from ..trajectory.trajectory import Diverged
from . import base
from .base import Answer, Row, Study, Table, option

LEVELS = np.linspace(0.01, 0.99, 50)  # of the cumulative distributions of durations and forces
LEDGERS = 24  # members of a scheme whose energy is followed: its spread is small, but for the trapezoidal rule


@dataclass(frozen=True, kw_only=True)
class Ensemble(Study):
    """Past the horizon, do the schemes at least have the right distribution of impacts, durations and forces?

    The exact solution and every scheme start from the same ``members`` initial data, which differ by ``size`` relative
    to the motion.

    Example: stiffbeam ensemble table10 --schemes 'BDF2,HHT(alpha=-0.1)' --members 50
    """

    schemes: base.Labels = option(*base.SCHEME_LABELS)
    form: str | None = option(*base.FORM)
    members: int = option(200, "perturbed runs of each method", least=2)
    size: float = option(SPREAD, "of the perturbation, relative to the motion")
    rng: int = option(1, "seed of the perturbations", least=0)
    contact: str = option(*base.TREATMENT)

    needs_motion: ClassVar = True
    needs_stops: ClassVar = True
    all_cores: ClassVar = True
    height: ClassVar = 8.6
    labels: ClassVar = {
        "count": ("impacts", ""), "fraction": ("share of the time in contact, %", ""),
        "energy_lost": ("energy lost", "energy"), "force": (r"peak force of an impact $\max|\sigma|$", "force"),
        "duration": ("duration of a contact", "time"), "level": ("share of the contacts with less", ""),
    }  # fmt: skip

    def points(self, case: Case) -> list[Row]:
        """The exact solution and every scheme."""
        return [{"method": method} for method in ("exact", *base.chosen_schemes(case, self.schemes))]

    def run(self, case: Case, method: str) -> list[Row]:
        """Rows of members, and the distributions of durations and peak forces."""
        system, dt, t_end = case.system(self.form), case.dt, case.t_end
        members = perturbed_members(system, self.members, self.size, self.rng, t_end=t_end)
        if method == "exact":
            many = reference_ensemble(system, t_end, members)
        else:
            scheme = base.chosen_schemes(case, self.schemes)[method]
            many = integrate_ensemble(system, scheme, dt, t_end, members, self.contact)
        if np.all(np.isfinite(many.diverged)):
            raise Diverged(method, float(np.max(many.diverged)), "use the implicit contact or a smaller dt")
        whole = ~np.isfinite(many.diverged)
        losses = np.full((len(many), 2), np.nan)
        for i in np.flatnonzero(whole)[:LEDGERS] if method != "exact" else ():  # whose flow loses nothing
            ledger = many.ledger(i)
            known = np.isfinite(lost_fractions(ledger, system)[0])
            losses[i] = ledger.loss[-1] if known else np.nan, ledger.supplied[-1]
        rows: list[Row] = []
        for number, contact in enumerate(many.contacts):
            members = pd.DataFrame({
                "kind": "member", "contact_number": number, "member": range(len(many)), "count": contact.impact_count,
                "fraction": contact.fraction, "peak_force": contact.peak_force, "impulse": contact.impulse,
                "diverged": ~whole,
            })  # fmt: skip
            if not number:  # energies are of the run
                members[["energy_lost", "energy_had"]] = losses
            rows += members.to_dict("records") + _distributions(number, contact.impacts)
        return rows

    def answer(self, table: Table, case: Case) -> Answer:
        """Impacts, time in contact, forces and energy of every method at each contact, against the exact ensemble."""
        units, several, small, said = case.units, table.contact_number.nunique() > 1, list[Row](), list[str]()
        exact = np.zeros(0)
        for number, at in table.groupby("contact_number"):
            true, means, place = (
                at[at.method == "exact"],
                dict[str, float](),
                f" at contact {number:g}" if several else "",
            )
            exact = distribution(true, "count")
            if not len(exact):
                return Answer("No member of the exact solution reached the end: there is nothing to compare with.")
            for method, rows in at.groupby("method", sort=False):
                names = "count", "fraction", "peak_force", "energy_lost", "energy_had"
                count, share, force, lost, had = (distribution(rows, name) for name in names)
                if not len(count):
                    continue
                if len(lost) and np.max(np.abs(lost)) <= ROUNDING * np.mean(had):
                    lost = 0.0 * lost
                means |= {str(method): float(np.mean(count))} if method != "exact" else {}
                off, interval = difference(count, exact)
                line = {
                    "method": short(str(method)) + place, "impacts": _spread(count),
                    "off by": DASH if method == "exact" else f"{float(f'{off:.3g}'):+g} ± {interval:.2g}",
                    "contact, %": _spread(100 * share, 2),
                    with_unit(units, "largest force", "force"): _spread(force, 4),
                    with_unit(units, "energy lost", "energy"): _spread(lost),
                    "lost, %": _spread(100 * lost / np.mean(had)) if len(lost) else DASH,
                }  # fmt: skip
                for _, row in rows[rows.kind == "summary"].iterrows():
                    line[with_unit(units, "median duration", "time")] = f"{row['median']:.2g}"
                    line[with_unit(units, "half-time duration", "time")] = f"{row['half_time']:.2g}"
                small.append(line)
            share = percent(float(np.mean(distribution(true, "fraction"))))
            said.append(f"{np.mean(exact):.4g} ± {np.std(exact):.2g} impacts{place}, in contact {share} of the time")
            said[-1] += f", schemes count {extremes(means, '{:.4g}'.format)}" if means else ""
        over = f", of the first {LEDGERS} members" if len(exact) > LEDGERS else ""
        return Answer(
            f"Over {len(exact)} members to t = {case.t_end:g} the exact solution has {'; '.join(said)}.",
            pd.DataFrame(small).fillna(DASH),
            f"Members perturbed by {self.size:g}, dt = {case.dt:g}: mean ± standard deviation. Off by: difference of "
            "the means, ± with 95 %. Lost: numerical dissipation, as a share of the initial energy plus the work of "
            f"the loads{over}; – where dt does not resolve the dissipation of dampers, or where almost no energy is "
            "supplied. The largest force grows with the span. Half of the contacts last longer than the median "
            "duration. Contacts longer than the half-time duration make up half of the time in contact.",
        )

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """Every member a dot in the line of its method and contact, the mean as a bar; distributions."""
        labels, several = table.attrs["labels"], table.contact_number.nunique() > 1
        groups = list(table.groupby(["method", "contact_number"], sort=False))
        figure.set_figheight(max(8.6, 3.9 + 0.35 * len(groups)))
        grid, axis, jitter = figure.add_gridspec(2, 6), None, np.random.default_rng(0)
        panels = [("count", 1.0, f"impacts to t = {case.t_end:g}"), ("fraction", 100.0, "time in contact"),
                  ("energy_lost", 1.0, f"energy lost, {min(LEDGERS, self.members)} members")]  # fmt: skip
        for i, (name, scale, title) in enumerate(panels):
            axis = figure.add_subplot(grid[0, 2 * i : 2 * i + 2], sharey=axis)
            for k, ((method, _), rows) in enumerate(groups):
                values, colour = scale * distribution(rows, name), look(method)["color"]
                axis.plot(values, k + jitter.uniform(-0.28, 0.28, len(values)), ".", ms=3, color=colour, alpha=0.45)
                if len(values):
                    axis.plot([np.mean(values)] * 2, [k - 0.38, k + 0.38], color=colour, lw=2.2)
                if len(values) and method == "exact":
                    axis.axvline(float(np.mean(values)), color="black", lw=0.9, ls=":")
            name_lines(axis, [short(method) + (f" at contact {n:g}" if several else "") for (method, n), _ in groups])
            if name not in table or not table[name].notna().any():
                axis.text(0.5, 0.5, "not known", transform=axis.transAxes, ha="center")
            axis.set(title=title, xlabel=labels[name])
            axis.tick_params(labelleft=not i)
            axis.locator_params(axis="x", nbins=4)
        for i, (name, title) in enumerate((("force", "peak forces of impacts"), ("duration", "durations of contacts"))):
            axis = figure.add_subplot(grid[1, 3 * i : 3 * i + 3])
            drawn = table[table[name].notna()] if name in table else table[:0]
            if not len(drawn):
                say_empty(axis, f"no {title} are known")
            for k, (_, rows) in enumerate(drawn.groupby("contact_number")):
                lines(axis, rows, name, "level", "method", marker="", alpha=1.0 / (1.0 + k))
            log_scale(axis, y=False)
            title += ", further contacts fainter" if several else ""
            axis.set(title=title, xlabel=labels[name], ylabel="" if i else labels["level"], ylim=(0.0, 1.0))
        shared_legend(figure, 5)


def _distributions(number: int, impacts: Any) -> list[Row]:
    """The distributions of durations and peak forces over all contacts of all members."""
    closed, peaks = (np.sort(x[np.isfinite(x)]) for x in (impacts.durations, impacts.peaks))
    shared = {"contact_number": number}
    levels = {name: np.quantile(x, LEVELS) for name, x in (("duration", closed), ("force", peaks)) if len(x)}
    rows: list[Row] = pd.DataFrame(shared | {"kind": "quantile", "level": LEVELS} | levels).to_dict("records")
    if len(closed):
        spent = np.cumsum(closed)  # from the shortest contact on
        half_time = float(closed[np.searchsorted(spent, 0.5 * spent[-1])])
        rows.append(shared | {"kind": "summary", "median": float(np.median(closed)), "half_time": half_time})
    return rows


def distribution(rows: Table, quantity: str) -> Array:
    """The values of ``quantity`` over the members of one method, at one contact, that reached the end and have it. A
    rigid stop has a largest force, 0, only where nothing touches it, which is no distribution."""
    members = rows[(rows.kind == "member") & ~rows.diverged.fillna(True).astype(bool)]
    values = members[quantity].to_numpy(float) if quantity in rows else np.zeros(0)
    known = np.isfinite(values)
    return values[known & (np.all(known) | (quantity != "peak_force"))]


def difference(a: Array, b: Array) -> tuple[float, float]:
    """Mean of a minus mean of b, and the half-width of its 95 % interval: Welch's, by Student's t."""
    off = float(np.mean(a) - np.mean(b))
    if min(len(a), len(b)) > 1 and np.ptp(a) == np.ptp(b) == 0.0:
        return off, 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a sample without spread, or of one value
        ends = ttest_ind(a, b, equal_var=False).confidence_interval()
    return off, 0.5 * float(ends.high - ends.low)


def _spread(values: Array, digits: int = 3) -> str:
    """Mean ± standard deviation, a dash for no values."""
    if not len(values):
        return DASH
    mean, deviation = float(f"{np.mean(values):.{digits}g}"), float(f"{np.std(values):.2g}")
    return f"{mean:g} ± {deviation:g}" if deviation > 1e-6 * abs(mean) else f"all {mean:g}"
