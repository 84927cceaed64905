"""doubt: contributions of rounding, of scheme and time step, of the mesh, and of the data to the uncertainty of
results, and of a rate also that of its finite time span.

    rounding    deviation(Q)/|mean(Q)| over exact motions whose starts differ by 1e-15; 0 up to the horizon
    scheme      |mean(Q_scheme - Q)|/|mean(Q)| over the drawn members, Q exact on the same mesh
    mesh        2^p/(2^p - 1) |mean(Q_fine - Q)|/|mean(Q)|, exact on twice as many cells, p the order of the form
    data        deviation(Q)/|mean(Q)| over the drawn members
    span        sqrt(mean(V))/|mean(Q)|, V the variance of a member's rate over its span (``measures/rates.py``)

Q: impacts, impacts per time, largest force, impulse and time in contact at each contact, and the energy (kinetic,
bending, stops) in the mean over time; all members have the same random parameters in every column. For the tip the
columns are rms distances over the largest |u|: from the exact tip of the same member, and for data from the median over
the members. Past the horizon the scatter of the data contains that of rounding. If both are large, the motion is
chaotic and only its statistics are meaningful.

The first four columns of the rate are those of the impacts, because all members have one span. Its column span is the
distance to the rate of a run without end: it counts the whole run as stationary. A motion without a load or base that
depends on time has no such rate.

Intervals hold with 95 %: bootstrap over the members (BCa). Mesh and span have a bracket besides. That of the mesh
reaches from 2/3 to 3/2 of the extrapolated value, because order p is that of smooth motions. Of the exact motions of 40
random beams on 8 cells of the displacement form this share has its error against 64 cells inside it:

    tip 100 %, largest force 93 %, energy 85 %, impacts 86 %, time in contact 81 %, impulse 79 %

and at least 96 % of 24 beams of the hermite form (``pytest -m campaign -s tests/studies/test_doubt.py -k bracket``;
impacts: of those whose number the mesh changes). The bracket of the span reaches from 1/2 to 2: of 100 records of an
oscillator under noise 87 hold the deviation of the rate over the records (``tests/studies/test_doubt.py``).

A source is named the largest if it is in 97.5 % of the resamples, in each of which all columns have the same members
and are at the unfavourable ends of their brackets. Rounding need not exceed data and span, which contain it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from html import escape
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.notebook import html_table
from ..basics.progress import Show, silent
from ..basics.progress import progress as shown
from ..basics.resources import cores, over_slices
from ..basics.text import plain, table
from ..basics.units import Units
from ..basics.validation import InputError, integer, number, positive
from ..files.cases import Case
from ..march.ensemble import integrate_ensemble
from ..measures.rates import Mean, stationary_mean, windows
from ..measures.report import percent
from ..model.members import perturbed_members
from ..model.system import System
from ..model.time_functions import Constant
from ..model.uncertain import uncertain_members
from ..references import best_reference
from ..references.ensemble import energies, reference_ensemble
from ..schemes import Scheme
from ..trajectory.ensemble import MEMBERS_PER_SLICE, Ensemble
from ..trajectory.trajectory import Diverged
from .engine.study import Answer

if TYPE_CHECKING:
    import pandas

RESAMPLES = 2000
SURE = 0.975  # of the resamples in which the source that is named is the largest
ROUNDING = 1e-15  # of the motion, between starts that float64 hardly tells apart
OUTPUTS = 400  # of the tip, at least where there are so many steps
QUANTITIES = {"impacts": "impact_count", "largest force": "peak_force", "impulse": "impulse",
              "time in contact": "fraction"}  # fmt: skip
RATE = "impact rate"
UNITS = {"tip": "length", RATE: "rate", "largest force": "force", "impulse": "impulse", "energy": "energy"}
ORDERS = {"displacement": 2, "velocity-curvature": 2, "hermite": 4}  # in h, of smooth motions
ENDS = {"": "value", "_low": "low", "_high": "high"}
BRACKET = (2 / 3, 3 / 2)  # of the extrapolated error of the mesh
SPAN_BRACKET = (0.5, 2.0)  # of a deviation over the span: all members share their loads, so their scatter lacks it
CURES = {
    "rounding": "past the horizon only statistics mean something",
    "scheme": "take a smaller step",
    "mesh": "take more cells",
    "data": "{parts} good enough",
    "span": "take a longer time span",
}


@dataclass(frozen=True)
class Share:
    """One column of a budget: a relative uncertainty with the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{percent(self.value)} ({percent(self.low)} to {percent(self.high)})" if self.high else "0"


NONE = Share(0.0, 0.0, 0.0)


def _contains(source: str, other: str) -> bool:
    return other == "rounding" and source in ("data", "span")


@dataclass(frozen=True)
class Budget:
    """Uncertainty of one quantity by its sources. mean: over the exact members; for the tip its largest |u|. dominant:
    the source that exceeds all others in 97.5 % of the resamples, "" if none does."""

    quantity: str
    mean: float
    shares: dict[str, Share]
    dominant: str

    @property
    def name(self) -> str:
        """The quantity without its contact."""
        return self.quantity.partition(" at contact")[0]

    @property
    def uncertain(self) -> bool:
        """True if any source is not 0."""
        return any(share.high for share in self.shares.values())

    @property
    def rankable(self) -> bool:
        """False if more members leave it open which source is the largest: two are nearer than the bracket of the
        mesh."""
        least, most = (
            {name: x.value * (end if name == "mesh" else 1.0) for name, x in self.shares.items()} for end in BRACKET
        )
        return any(
            all(least[name] >= most[other] for other in most if other != name and not _contains(other, name))
            for name in least
        )

    @property
    def verdict(self) -> str:
        """Sentence with the largest source and a remedy."""
        first, second, *_ = sorted(self.shares, key=lambda name: -self.shares[name].value)
        if not self.uncertain:
            return f"{self.quantity}: no uncertainty, {self.mean:g} in all members for {', '.join(self.shares)}."
        if not self.dominant:
            large = " and ".join(f"{name} ({percent(self.shares[name].value)})" for name in (first, second))
            return f"{self.quantity}: {large} are too close to rank."
        first = self.dominant
        rest = ", ".join(
            f"{name} {percent(x.value)}"
            for name, x in self.shares.items()
            if name != first and not _contains(name, first)
        )
        parts = "the step and the mesh are" if "mesh" in self.shares else "the step is"
        cure = CURES[first].format(parts=parts)
        return f"{self.quantity}: {first} ({percent(self.shares[first].value)}) exceeds {rest}: {cure}."


@dataclass(frozen=True)
class Doubt:
    """Budgets of uncertainty of all quantities, and the times to which the motion is known.

    Parameters
    ----------
    scheme : str
    dt, t_end : float
    members : int
    horizon : float
        The time to which rounding leaves the nominal motion certain, at most t_end.
    data_horizon : float
        The time to which 95 % of the members agree to ``tolerance`` of the largest |u|, at most t_end.
    tolerance : float
    units : Units
    budgets : sequence of Budget
        One per quantity.
    """

    scheme: str
    dt: float
    t_end: float
    members: int
    horizon: float
    data_horizon: float
    tolerance: float
    units: Units
    budgets: tuple[Budget, ...]

    def _lines(self) -> list[str]:
        """Run, times to which the motion is certain, and verdicts."""
        values = (self.dt, self.t_end, self.horizon, self.data_horizon)
        dt, end, rounding, data = (self.units.measure(x, "time", ".4g") for x in values)
        head = f"{self.scheme}, dt = {dt}, {self.members} members to t = {end}"
        known = (
            f"Rounding leaves the motion certain to t = {rounding}, data to t = {data} "
            f"(95 % of the members within {percent(self.tolerance)})."
        )
        return [head, known, *(budget.verdict for budget in self.budgets)]

    def _table(self) -> list[dict[str, str]]:
        """Means and columns with their intervals, as they are printed."""
        return [
            {"95 % intervals": x.quantity, "mean": self.units.measure(x.mean, UNITS.get(x.name, ""), ".4g")}
            | {name: str(part) for name, part in x.shares.items()}
            for x in self.budgets
        ]

    def __str__(self) -> str:
        """The verdicts, then the columns with their intervals."""
        return Answer("\n".join(self._lines()), self._table()).text()

    def _repr_html_(self) -> str:
        names = list(dict.fromkeys(name for line in self._table() for name in line))
        rows = [[line.get(name, "") for name in names] for line in self._table()]
        return "".join(f"<p>{escape(line)}</p>" for line in self._lines()) + html_table(names, rows)

    def to_dataframe(self) -> pandas.DataFrame:
        """One row for each quantity, the index: ``mean``, ``dominant``, and ``data``, ``data_low``, ``data_high`` for
        each source; NaN where a quantity lacks it."""
        rows = {
            x.quantity: {"mean": x.mean, "dominant": x.dominant}
            | {f"{name}{end}": getattr(part, field) for name, part in x.shares.items() for end, field in ENDS.items()}
            for x in self.budgets
        }
        names = list(dict.fromkeys(name for row in rows.values() for name in row))
        columns = {name: [row.get(name, np.nan) for row in rows.values()] for name in names}
        return table({"quantity": list(rows)} | columns).set_index("quantity")

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts."""
        budgets = [
            {"quantity": x.quantity, "mean": x.mean, "dominant": x.dominant, "verdict": x.verdict}
            | {name: asdict(share) for name, share in x.shares.items()}
            for x in self.budgets
        ]
        names = ("scheme", "dt", "t_end", "members", "horizon", "data_horizon", "tolerance")
        rest = {name: getattr(self, name) for name in names}
        return plain({"measured": []} | rest | {"units": str(self.units), "budgets": budgets})

    def __getitem__(self, quantity: str) -> Budget:
        """The budget of a quantity by its name."""
        for budget in self.budgets:
            if budget.quantity == quantity:
                return budget
        raise KeyError(quantity)


Statistic = Callable[[Array], Array]


def resampled(statistic: Statistic, sample: Array, seed: int = 1) -> Array:
    """A statistic of RESAMPLES bootstrap resamples of a sample (M, ...), which has the same rows for every sample of
    its size; the statistic works along the second axis."""
    return statistic(sample[np.random.default_rng(seed).integers(0, len(sample), (RESAMPLES, len(sample)))])


def bootstrap(statistic: Statistic, sample: Array, seed: int = 1) -> tuple[float, float]:
    """Ends of the 95 % BCa interval of a statistic over a sample (M, ...), see ``resampled``.

    Bias correction and acceleration as in Efron, Better Bootstrap Confidence Intervals (1987), section 2. A sample
    whose values are all equal has an interval without width.
    """
    estimate = float(statistic(sample[None])[0])
    drawn = np.sort(resampled(statistic, sample, seed))
    below = (np.sum(drawn < estimate) + 0.5 * np.sum(drawn == estimate)) / RESAMPLES
    # Without scatter, or with all resamples on one side of the estimate, the bias has no finite value.
    if drawn[0] == drawn[-1] or not 0.0 < below < 1.0:
        return float(drawn[0]), float(drawn[-1])
    # Acceleration by the jackknife: the statistic without each member in turn.
    keep = ~np.eye(len(sample), dtype=bool)
    left_out = statistic(np.array([sample[row] for row in keep]))
    off = np.mean(left_out) - left_out
    size = float(np.sum(off**2)) ** 1.5
    acceleration = float(np.sum(off**3)) / (6.0 * size) if size else 0.0
    normal = NormalDist()
    # The ends are quantiles of the resamples, shifted by bias and acceleration.
    bias = normal.inv_cdf(float(below))
    ends = []
    for z in (normal.inv_cdf(0.025), normal.inv_cdf(0.975)):
        share = normal.cdf(bias + (bias + z) / (1.0 - acceleration * (bias + z)))
        ends.append(float(np.quantile(drawn, share)))
    return ends[0], ends[1]


def _means(x: Array) -> Array:
    return np.mean(x, axis=1)


def _deviations(x: Array) -> Array:
    return np.std(x, axis=1, ddof=1)


def _roots(x: Array) -> Array:
    return np.sqrt(np.mean(x**2, axis=1))


@dataclass(frozen=True)
class Column:
    """A statistic and the members (M,) of which it is one; factors: of its size, and of the ends of its bracket."""

    statistic: Statistic
    sample: Array
    factors: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def size(self) -> float:
        """|statistic| of all members."""
        return self.factors[0] * abs(float(self.statistic(self.sample[None])[0]))

    def resampled(self, factor: float) -> Array:
        """|statistic| of every resample, times a factor."""
        return factor * np.abs(resampled(self.statistic, self.sample))

    def on_twice_the_cells(self, form: str) -> Column:
        """The column of a mesh's error from that of its change on twice as many cells."""
        power = 2.0 ** ORDERS[form]
        size = power / (power - 1.0)
        return replace(self, factors=(size, BRACKET[0] * size, BRACKET[1] * size))


def shift(values: Array, wanted: Array) -> Column:
    """The column of mean(values - wanted), member by member."""
    return Column(_means, np.asarray(values, float) - np.asarray(wanted, float))


def scatter(values: Array) -> Column:
    """The column of the deviation of values."""
    return Column(_deviations, np.asarray(values, float))


def share(column: Column, scale: float) -> Share:
    """|statistic|/scale with its interval."""
    low, high = bootstrap(column.statistic, column.sample)
    # The interval of |statistic|, which begins at 0 where that of the statistic contains 0.
    low, high = (low, high) if low > 0.0 else (-high, -low) if high < 0.0 else (0.0, abs(max(-low, high)))
    low, high = column.factors[1] * low, column.factors[2] * high
    if scale == 0.0:
        return NONE if high == 0.0 else Share(np.inf, np.inf if low else 0.0, np.inf)
    return Share(column.size / scale, low / scale, high / scale)


def dominant(columns: dict[str, Column]) -> str:
    """The source that is the largest in a share SURE of the resamples, see ``Budget``; data and span, which contain the
    scatter of rounding, do not count against it."""
    # The source at the low end of its bracket is held against all others at their high ends.
    most = {name: column.resampled(column.factors[2]) for name, column in columns.items()}
    for name in sorted(columns, key=lambda x: -columns[x].size):
        rivals = [x for other, x in most.items() if other != name and not _contains(other, name)]
        least = columns[name].resampled(columns[name].factors[1])
        if columns[name].size > 0.0 and np.mean(np.all(least >= np.array(rivals), axis=0)) >= SURE:
            return name
    return ""


def agreement_horizon(t: Array, tips: Array, tolerance: float, share: float = 0.95) -> float:
    """Time to which a ``share`` of the members, tips (M, k) at t (k,), agree to a tolerance of the largest |u|.

    A member agrees until its distance from the median over the members first exceeds ``tolerance`` max |median|. The
    horizon is the last output time before fewer than ``share`` of the members do.
    """
    middle = np.median(tips, axis=0)
    apart = np.abs(tips - middle) > tolerance * np.max(np.abs(middle))
    agree = np.mean(~np.logical_or.accumulate(apart, axis=1), axis=0) >= share
    return float(t[-1] if np.all(agree) else t[max(0, int(np.argmin(agree)) - 1)])


def doubt(
    case: Case,
    scheme: Scheme | None = None,
    dt: float | None = None,
    members: int = 48,
    seed: int = 1,
    tolerance: float = 0.05,
    progress: bool | Show = False,
    contact: str = "implicit",
) -> Doubt:
    """Budget of uncertainty of a run: rounding, scheme and step, mesh, data and time span, for every quantity at every
    contact.

    Parameters
    ----------
    case : Case
        With uncertain parameters, ``[case.uncertain]`` in its file or ``dataclasses.replace(case, uncertain=...)``. A
        case of matrices has no mesh to refine.
    scheme : Scheme, optional
        By default the case's first.
    dt : float, optional
        By default the case's.
    members : int
        Drawn systems, of which each is solved exactly on two meshes and run by the scheme.
    seed : int
    tolerance : float
        To which members agree within the data horizon, relative to the largest displacement of the tip.
    progress : bool or callable
        As in ``reference``.
    contact : str
        Treatment of contact as in ``integrate``.

    Returns
    -------
    Doubt
        ``print`` it for the verdicts; ``result["impacts"].shares["data"]``. With several contacts the quantities are
        "impacts at contact 1" and so on. The column of the mesh is extrapolated by the order of the form, with a
        bracket for motions that are not smooth.

    Raises
    ------
    InputError
        For a case without uncertain parameters, and what the exact solution or the scheme does not take.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import stiffbeam as sb
    >>> case = replace(sb.paper_case(10), t_end=0.1, uncertain={"stiffness": sb.Uncertain(tolerance=0.01)})
    >>> print(sb.doubt(case, sb.HHT(-0.1), members=8)["impacts"].quantity)
    impacts
    """
    if progress is True:
        with shown() as show:
            return doubt(case, scheme, dt, members, seed, tolerance, show, contact)
    schemes = [case.runs[0][0] if scheme is None else scheme]
    return doubts(case, schemes, dt, members, seed, tolerance, progress or silent, contact)[0]


def require_uncertain(case: Case) -> None:
    """Raise InputError for a case without uncertain parameters."""
    if not case.uncertain:
        remedy = (
            'state its tolerances: [case.uncertain] with stiffness = 0.01, or replace(case, uncertain={"...": ...})'
        )
        raise InputError("case", case.name, "have uncertain parameters", remedy)


def doubts(
    case: Case,
    schemes: Sequence[Scheme],
    dt: float | None = None,
    members: int = 48,
    seed: int = 1,
    tolerance: float = 0.05,
    show: Show = silent,
    contact: str = "implicit",
) -> list[Doubt]:
    """The budget of every scheme, see ``doubt``; they share the exact members."""
    require_uncertain(case)
    integer("members", members, 8)
    positive("tolerance", number("tolerance", tolerance))
    form, t_end, dt = case.forms[0], case.t_end, (case.dt if dt is None else positive("dt", dt))
    system = case.system(form)
    drawn = uncertain_members(system, case.uncertain, members, seed)
    every = max(1, round(t_end / dt) // OUTPUTS)
    runs = []
    for scheme in schemes:
        show(f"doubt: {scheme}, {members} members", 0, 0)
        runs.append(integrate_ensemble(system, scheme, dt, t_end, drawn, contact, every))
        if np.any(np.isfinite(runs[-1].diverged)):
            raise Diverged(str(scheme), float(np.nanmin(runs[-1].diverged)), "use a smaller dt")
    t = runs[0].t
    show("doubt: the exact members", 0, 0)
    exact = reference_ensemble(system, t_end, drawn, t)
    fine: dict[str, Ensemble] = {}
    if case.beam is not None:
        show("doubt: the exact members on twice the cells", 0, 0)
        # The same seed draws the same parameters on the finer mesh.
        finer = replace(case, cells=2 * case.cells).system(form)
        refined = uncertain_members(finer, case.uncertain, members, seed)
        fine["mesh"] = reference_ensemble(finer, t_end, refined, t)
    show("doubt: rounding", 0, 0)
    # Rounding matters past its horizon only: there starts that hardly differ scatter.
    horizon = min(best_reference(system, t_end).horizon, t_end)
    past: Ensemble | None = None
    if horizon < t_end:
        starts = perturbed_members(system, members, ROUNDING, seed, t_end=t_end)
        past = reference_ensemble(system, t_end, starts, t)
    known = agreement_horizon(exact.t, exact.tip, tolerance)
    found = []
    for scheme, many in zip(schemes, runs, strict=True):
        columns = {"scheme": many} | fine
        budgets = (_tip(exact, columns, past), *_contacts(exact, columns, past), *_energy(exact, columns, past))
        numbers = (float(dt), float(t_end), members, horizon, known, tolerance)
        found.append(Doubt(str(scheme), *numbers, case.units, budgets))
    return found


def _budget(quantity: str, mean: float, columns: dict[str, Column], scale: float, form: str) -> Budget:
    """The budget from the columns, of which that of the mesh is the change on twice the cells."""
    if "mesh" in columns:
        columns |= {"mesh": columns["mesh"].on_twice_the_cells(form)}
    return Budget(quantity, mean, {name: share(x, scale) for name, x in columns.items()}, dominant(columns))


def _form(exact: Ensemble) -> str:
    return exact.members.system.form


def _tip(exact: Ensemble, columns: dict[str, Ensemble], past: Ensemble | None) -> Budget:
    size = float(np.max(np.abs(exact.tip)))

    def distance(one: Array, other: Array) -> Column:
        return Column(_means, np.sqrt(np.mean((one - other) ** 2, axis=1)))

    sources = {"rounding": distance(*(2 * (exact.tip,) if past is None else (past.tip, np.median(past.tip, axis=0))))}
    sources |= {name: distance(many.tip, exact.tip) for name, many in columns.items()}
    sources |= {"data": distance(exact.tip, np.median(exact.tip, axis=0))}
    return _budget("tip", size, sources, size, _form(exact))


def _of_members(
    quantity: str,
    of: Callable[[Ensemble], Array],
    exact: Ensemble,
    columns: dict[str, Ensemble],
    past: Ensemble | None,
    more: dict[str, Column] | None = None,
) -> list[Budget]:
    """The budget of a number of every member; none where it is not finite, as the largest force of rigid stops."""
    wanted = np.asarray(of(exact), float)
    if not np.all(np.isfinite(wanted)):
        return []
    sources = {"rounding": scatter(np.zeros(len(wanted)) if past is None else of(past))}
    sources |= {name: shift(of(many), wanted) for name, many in columns.items()}
    sources |= {"data": scatter(wanted)} | (more or {})
    mean = float(np.mean(wanted))
    return [_budget(quantity, mean, sources, abs(mean), _form(exact))]


def _contacts(exact: Ensemble, columns: dict[str, Ensemble], past: Ensemble | None) -> list[Budget]:
    budgets = []
    for i in range(len(exact.contacts)):
        place = f" at contact {i + 1}" if len(exact.contacts) > 1 else ""
        for quantity, field in QUANTITIES.items():
            budgets += _of_members(quantity + place, partial(_at_contact, i, field), exact, columns, past)
            if quantity == "impacts" and _driven(exact.members.system):
                span = {"span": _span(exact, i)}
                budgets += _of_members(RATE + place, partial(_impact_rate, i), exact, columns, past, span)
    return budgets


def _at_contact(contact: int, field: str, many: Ensemble) -> Array:
    return getattr(many.contacts[contact], field)


def _impact_rate(contact: int, many: Ensemble) -> Array:
    return many.contacts[contact].impact_count / float(many.provenance["t_end"])


def _driven(system: System) -> bool:
    """Return True if a load or a stop depends on time."""
    return any(not isinstance(f, Constant) for _, f in system.loads) or any(c.offset for c in system.contacts)


def _span(exact: Ensemble, contact: int) -> Column:
    edges = windows(exact.members.system, 0.0, float(exact.provenance["t_end"]))
    width = float(edges[1] - edges[0])
    times = [exact.contacts[contact].impacts_of(k).times for k in range(len(exact))]
    return of_span([stationary_mean(np.histogram(x, edges)[0] / width) for x in times])


def of_span(rates: Sequence[Mean]) -> Column:
    """The column of the deviations of the members' rates over their span, see SPAN_BRACKET."""
    return Column(_roots, np.array([each.deviation for each in rates]), (1.0, *SPAN_BRACKET))


def _energy(exact: Ensemble, columns: dict[str, Ensemble], past: Ensemble | None) -> list[Budget]:
    def of(many: Ensemble) -> Array:
        def means(part: Sequence[int]) -> list[float]:
            return [float(np.mean(each)) for each in energies(many, part)]

        return np.concatenate(list(over_slices(means, range(len(many)), MEMBERS_PER_SLICE, cores(), None)))

    return _of_members("energy", of, exact, columns, past)
