"""Contributions of rounding, of scheme and time step, of the mesh, and of the data to the uncertainty of results.

    rounding    deviation(Q)/|mean(Q)| over exact motions whose starts differ by 1e-15; 0 up to the horizon
    scheme      |mean(Q_scheme - Q)|/|mean(Q)| over the drawn members, Q exact on the same mesh
    mesh        |mean(Q_fine - Q)|/|mean(Q)|, exact on cubic elements; matrices have no mesh;
                2^p/(2^p - 1) of that on twice as many cells, p the order of the form
    data        deviation(Q)/|mean(Q)| over the drawn members

Q: impacts, largest force, impulse and time in contact at each contact, and the energy in the mean over time; all
members have the same parameters, a Latin hypercube sample, in every column. For the tip the columns are rms distances
over the largest |u|. The rate over a longer run has an interval of its own, see ``measures/rates.py``.

Intervals hold with 95 %: bootstrap over the members (BCa). The mesh has a bracket besides:

    cubic elements on the cells of the case    0.9 to 1.1    compliant stops, forms of order 2; measured on random beams
    twice the cells                            2/3 to 3/2    rigid stops, hermite form; p is the order of smooth motions

The largest sources are those whose intervals reach the largest low end of all. Data contain rounding: they count only
if they exceed it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, ClassVar

import numpy as np
import pandas as pd
import scipy.stats
from cyclopts import Parameter

from ..basics.arrays import Array, Recent
from ..basics.resources import current, over
from ..basics.text import with_unit
from ..basics.validation import InputError, Rng, number
from ..figures.chart import Figure, style_of
from ..files.cases import Case
from ..march.integrate import integrate_ensemble
from ..measures.report import percent
from ..model.members import EnsembleMembers, perturbed_members, varied_members
from ..model.system import System
from ..references.ensemble import energy_of, reference_ensemble
from ..trajectory.ensemble import Ensemble
from ..trajectory.trajectory import Diverged
from . import base
from .base import Answer, Row, Study, Table, option

ROUNDING = 1e-15  # of the motion, between starts that float64 hardly tells apart
LEAST = 8  # elements of the finer mesh
OUTPUTS = 400  # of the tip, at least where there are so many steps
QUANTITIES = {"impacts": "impact_count", "largest force": "peak_force", "impulse": "impulse",
              "time in contact": "fraction"}  # fmt: skip
UNITS = {"tip": "length", "largest force": "force", "impulse": "impulse", "energy": "energy"}
SOURCES = ("rounding", "scheme", "mesh", "data")
RESAMPLES = 2000
ORDERS = {"displacement": 2, "velocity-curvature": 2, "hermite": 4}  # in h, of smooth motions
TWICE_THE_CELLS = (2 / 3, 3 / 2)  # bracket of the extrapolated error of the mesh
CUBIC_ELEMENTS = (0.9, 1.1)  # of the distance to them


@dataclass(frozen=True, kw_only=True)
class Doubt(Study):
    """How uncertain is each result of a run, and is it by rounding, scheme, mesh or data?

    Exact motions of ``members`` systems with random parameters on two meshes are compared with runs of the scheme. The
    ranges of the parameters are those of the case file, in its table case.uncertain.

    Example: stiffbeam doubt my-beam.toml --scheme 'HHT(alpha=-0.1)'
    """

    scheme: Annotated[Any, Parameter(metavar="NAME")] = option(None, "scheme to examine; default: the case's first")
    uncertain: Annotated[Mapping[str, Any] | None, Parameter(parse=False)] = option(
        None, "(low, high) or a scipy.stats distribution by path; default: the ranges of the case file"
    )
    members: int = option(48, "number of systems with random parameters", least=8)
    rng: int = option(1, "seed of the random systems", least=0)
    form: str | None = option(*base.FORM)
    contact: str = option(*base.TREATMENT)

    all_cores: ClassVar = True

    def require(self, case: Case) -> None:
        """Raise InputError for a case without uncertain parameters."""
        form = self.form or case.forms[0]
        drawn_members(case.system(form), self.uncertain or case.uncertain, self.members, self.rng)

    def points(self, case: Case) -> list[Row]:
        """A point for each source. Matrices have no mesh."""
        return [{"source": source} for source in reversed(SOURCES) if source != "mesh" or case.problem is not None]

    def run(self, case: Case, source: str) -> list[Row]:
        """A row for each quantity: the mean, the relative uncertainty by this source and its interval."""
        form, t_end, uncertain = self.form or case.forms[0], case.t_end, self.uncertain or case.uncertain
        system, steps = case.system(form), round(t_end / case.dt)
        t = np.arange(0, steps + 1, every := max(1, steps // OUTPUTS)) * case.dt
        scheme = case.runs[0][0]
        if self.scheme is not None:
            (scheme,) = base.chosen_schemes(case, [self.scheme]).values()
        drawn = drawn_members(system, uncertain, self.members, self.rng)
        current()(f"doubt: the exact members, for {source}", 0, 0)
        key = t_end, case.dt, *(member.fingerprint for member in drawn)
        exact, wanted = _EXACT.get(key, lambda: _measured(reference_ensemble(system, t_end, drawn, t)))
        # Rounding matters past its horizon only: there starts that hardly differ scatter.
        horizon = min(base.solve_once(system, t_end).horizon, t_end)
        other, factors = exact, (1.0, 1.0, 1.0)
        if source == "scheme":
            other = integrate_ensemble(system, scheme, case.dt, t_end, drawn, self.contact, every)
            if np.any(np.isfinite(other.diverged)):
                remedy = "use the implicit contact or a smaller dt"
                raise Diverged(str(scheme), float(np.nanmin(other.diverged)), remedy)
        elif source == "mesh":
            mesh, factors = finer_mesh(case, form)
            members = drawn_members(mesh, uncertain, self.members, self.rng)
            other = reference_ensemble(mesh, t_end, members, t)
        elif source == "rounding" and horizon < t_end:
            starts = perturbed_members(system, self.members, ROUNDING, self.rng, t_end=t_end)
            other = reference_ensemble(system, t_end, starts, t)
        values = wanted if other is exact else _measured(other)[1]
        # Of rounding and data the scatter of the members counts, of scheme and mesh their distance from the exact ones.
        scatters, none = source in ("rounding", "data"), source == "rounding" and other is exact
        off = other.tip - (np.median(other.tip, axis=0) if scatters else exact.tip)
        distances = np.sqrt(np.mean(off**2, axis=1))
        samples: dict[str, Any] = {"tip": (float(np.max(np.abs(exact.tip))), distances, np.mean)}
        for name, known in wanted.items():
            if np.all(np.isfinite(known)):
                sample = values[name] if scatters else values[name] - known
                samples[name] = float(np.mean(known)), sample, deviation if scatters else np.mean
        rows = list[Row]()
        for quantity, (mean, sample, statistic) in samples.items():
            value, low, high = share(0.0 * sample if none else sample, abs(mean), statistic, factors)
            rows.append({"quantity": quantity, "mean": mean, "value": value, "low": low, "high": high,
                         "scheme": str(scheme), "horizon": horizon})  # fmt: skip
        return rows

    def answer(self, table: Table, case: Case) -> Answer:
        """The largest source of every quantity, and all of them with their intervals."""
        named: dict[str, list[str]] = {}
        small = list[Row]()
        for quantity, rows in table.groupby("quantity", sort=False):
            shares = {x.source: (x.value, x.low, x.high) for x in rows.itertuples()}
            largest = " or ".join(largest_of(shares)) or "none"
            named.setdefault(largest, []).append(str(quantity))
            kind = str(quantity).partition(" at contact")[0]
            row = {"95 % intervals": with_unit(case.units, str(quantity), UNITS.get(kind, "")),
                   "mean": f"{rows['mean'].iloc[0]:.4g}", "largest": largest}  # fmt: skip
            texts = {source: tuple(map(percent, one)) for source, one in shares.items()}
            small.append(
                row | {x: f"{y} ({low} to {high})" if shares[x][2] else "0" for x, (y, low, high) in texts.items()}
            )
        there, first = [x for x in SOURCES if x in set(table.source)], table.iloc[0]
        missing = " and ".join(x for x in SOURCES if x not in there)  # of matrices the mesh, which nothing refines
        notes = f"{first.scheme}, dt = {case.dt:.4g}, {self.members} members to t = {case.t_end:.4g}. Rounding leaves "
        notes += f"the motion certain to t = {first.horizon:.4g}."
        sources = "; ".join(f"{source} for {', '.join(quantities)}" for source, quantities in named.items())
        table = pd.DataFrame(small)[["95 % intervals", "mean", "largest", *there]]
        known = f"known source of uncertainty ({missing} not known)" if missing else "source of uncertainty"
        return Answer(f"Largest {known}: {sources}.", table, notes)

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """A line for each quantity, a marker with its interval for each source."""
        axis, quantities = figure.subplots(), list(table.quantity.unique())
        sources = [x for x in SOURCES if x in set(table.source)]
        for k, source in enumerate(sources):
            rows = table[(table.source == source) & (table.high > 0.0) & np.isfinite(table.high)]
            y = [quantities.index(x) + 0.7 * ((k + 0.5) / len(sources) - 0.5) for x in rows.quantity]
            off = [rows.value - rows.low, rows.high - rows.value]
            style: Any = style_of(k) | {"linestyle": "", "ms": 5}
            axis.errorbar(rows.value, y, xerr=np.maximum(off, 0.0), label=source, **style)
        axis.set_yticks(range(len(quantities)), quantities)
        axis.set(xscale="log", xlabel="relative uncertainty, 95 % intervals", ylim=(len(quantities) - 0.5, -0.5))
        axis.grid(axis="x", alpha=0.3)
        axis.legend(frameon=False, ncols=len(sources), loc="lower center", bbox_to_anchor=(0.5, 1.0))


# ---------------------------------------------------------------- members


def drawn_members(system: System, uncertain: Mapping[str, Any], members: int, rng: Rng = 1) -> EnsembleMembers:
    """Members whose parameters are a Latin hypercube sample; the same rng draws the same parameters."""
    if not uncertain:
        remedy = (
            'end a case file, such as that of "stiffbeam cases --show table10 > my.toml", with [case.uncertain] and '
            '"stops.stiffness" = [4.5e6, 5.5e6] on two lines; in Python pass {"stops.stiffness": (4.5e6, 5.5e6)}'
        )
        raise InputError("case", uncertain, "have uncertain parameters", remedy)
    columns = {}
    sample = scipy.stats.qmc.LatinHypercube(len(uncertain), rng=np.random.default_rng(rng)).random(members)
    for (path, one), shares in zip(uncertain.items(), sample.T, strict=True):
        if not hasattr(one, "ppf"):
            low, high = (number(f"uncertain {path}", x) for x in one) if np.shape(one) == (2,) else (0.0, 0.0)
            if not low < high:
                rule = "be a range (low, high), or a distribution of scipy.stats"
                raise InputError(f"uncertain {path}", one, rule, "for example (4.5e6, 5.5e6)")
            one = scipy.stats.uniform(low, high - low)
        columns[path] = one.ppf(shares)
    return varied_members(system, columns)


def finer_mesh(case: Case, form: str) -> tuple[System, tuple[float, float, float]]:
    """The system on a finer mesh, and what times the distance to it is the error of the mesh: the value and the ends of
    its bracket."""
    if form == "hermite" or case.system(form).rigid:
        power = 2.0 ** ORDERS[form]
        factor = power / (power - 1.0)
        finer = replace(case, cells=2 * case.cells).system(form)
        return finer, (factor, factor * TWICE_THE_CELLS[0], factor * TWICE_THE_CELLS[1])
    return replace(case, cells=max(case.cells, LEAST)).system("hermite"), (1.0, *CUBIC_ELEMENTS)


# ---------------------------------------------------------------- quantities of members


def _measured(many: Ensemble) -> tuple[Ensemble, dict[str, Array]]:
    """An ensemble with one value a member (M,) of every quantity at every contact, and of the energy in the mean over
    the output times."""
    found: dict[str, Array] = {}
    for i, contact in enumerate(many.contacts):
        place = f" at contact {i}" if len(many.contacts) > 1 else ""
        found |= {name + place: np.asarray(getattr(contact, field), float) for name, field in QUANTITIES.items()}
    means = over(lambda i: float(np.mean(energy_of(many, i))), range(len(many)))
    return many, found | {"energy": np.array(list(means))}


_EXACT = Recent[tuple[Ensemble, dict[str, Array]]](1)  # the exact members, which every source is compared with


# ---------------------------------------------------------------- intervals and the largest source


deviation = partial(np.std, ddof=1)  # standard deviation of a sample


def interval(sample: Array, statistic: Callable[..., Array] = np.mean) -> tuple[float, float]:
    """Ends of the 95 % BCa interval of a statistic of the members (M,)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a sample with all resamples on one side of the estimate
        found = scipy.stats.bootstrap((sample,), statistic, n_resamples=RESAMPLES, rng=1)
    low, high = map(float, found.confidence_interval)
    # All resamples on one side of the estimate have no BCa interval: all of them then.
    ends = found.bootstrap_distribution
    return (low, high) if np.isfinite(low) and np.isfinite(high) else (float(np.min(ends)), float(np.max(ends)))


def share(
    sample: Array,
    scale: float,
    statistic: Callable[..., Array] = np.mean,
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> tuple[float, float, float]:
    """|statistic|/scale, and the ends of its interval; factors: of the value, and of the ends of its bracket."""
    low, high = interval(sample, statistic)
    # The interval of |statistic|, which begins at 0 where that of the statistic contains 0.
    low, high = (low, high) if low > 0.0 else (-high, -low) if high < 0.0 else (0.0, abs(max(-low, high)))
    low, high = factors[1] * low, factors[2] * high
    if scale == 0.0:
        return (np.inf, np.inf if low else 0.0, np.inf) if high else (0.0, 0.0, 0.0)
    return factors[0] * abs(float(statistic(sample))) / scale, low / scale, high / scale


def largest_of(shares: Mapping[str, tuple[float, float, float]]) -> tuple[str, ...]:
    """The sources that may be the largest, by value: those whose intervals reach the largest low end. Data, which
    contain the scatter of rounding, stand aside where they may be that alone."""
    known = {name: one for name, one in shares.items() if one[2] > 0.0}
    if {"rounding", "data"} <= set(known) and known["rounding"][2] >= known["data"][1]:
        del known["data"]
    least = max((low for _, low, _ in known.values()), default=0.0)
    return tuple(sorted((x for x in known if known[x][2] >= least), key=lambda x: -known[x][0]))
