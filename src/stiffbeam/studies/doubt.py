"""doubt: contributions of rounding, of scheme and time step, of the mesh, and of the data to the uncertainty of
results, and of a rate also that of its finite time span.

    rounding    deviation(Q)/|mean(Q)| over exact motions whose starts differ by 1e-15; 0 up to the horizon
    scheme      |mean(Q_scheme - Q)|/|mean(Q)| over the drawn members, Q exact on the same mesh
    mesh        |mean(Q_fine - Q)|/|mean(Q)|, exact on cubic elements or by a finer model;
                2^p/(2^p - 1) of that on twice as many cells, p the order of the form
    data        deviation(Q)/|mean(Q)| over the drawn members
    span        sqrt(mean(V))/|mean(Q)|, V the variance of a member's rate over its span (``measures/rates.py``)

Q: impacts, impacts per time, largest force, impulse and time in contact at each contact, and the energy in the mean
over time; all members have the same parameters, a Latin hypercube sample, in every column. For the tip the columns are
rms distances over the largest |u|. The first four columns of the rate are those of the impacts; its column span is the
distance to the rate of a run without end, which a motion that nothing drives does not have.

Intervals hold with 95 %: bootstrap over the members (BCa). Mesh and span have a bracket besides:

    cubic elements on the cells of the case    0.9 to 1.1    compliant stops, forms of order 2; measured on random beams
    twice the cells                            2/3 to 3/2    rigid stops, hermite form; p is the order of smooth motions
    a finer model of matrices                  2/3 to 2      1 to 4/3 of the distance, with a margin of 3/2
    span                                       1/2 to 2      87 of 100 records of an oscillator under noise
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.progress import Show, working
from ..basics.resources import over_slices
from ..basics.text import plain, several
from ..basics.units import Units, with_unit
from ..basics.validation import InputError, integer, number, positive
from ..files.cases import Case, case_of
from ..measures.rates import stationary_mean, windows
from ..measures.report import percent
from ..model.members import EnsembleMembers, perturbed_members, varied_members
from ..model.system import System
from ..model.time_functions import Constant
from ..references import best_reference
from ..references.ensemble import energies, reference_ensemble
from ..schemes import Scheme
from ..trajectory.ensemble import MEMBERS_PER_SLICE, Ensemble
from .budget import FINER, MEASURED, Budget, Column, budget_of, mean_of, of_span, scatter, shift
from .common import run_members

if TYPE_CHECKING:
    import pandas

ROUNDING = 1e-15  # of the motion, between starts that float64 hardly tells apart
LEAST = 8  # elements of the finer mesh
OUTPUTS = 400  # of the tip, at least where there are so many steps
QUANTITIES = {"impacts": "impact_count", "largest force": "peak_force", "impulse": "impulse",
              "time in contact": "fraction"}  # fmt: skip
RATE = "impact rate"
UNITS = {"tip": "length", RATE: "rate", "largest force": "force", "impulse": "impulse", "energy": "energy"}
SOURCES = ("rounding", "scheme", "mesh", "data", "span")
ENDS = {"": "value", "_low": "low", "_high": "high"}


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
    units : tuple
    budgets : sequence of Budget
        One per quantity.
    remarks : sequence of str
        Notes on the column of the mesh, if it is incomplete.
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
    remarks: tuple[str, ...] = ()

    def _lines(self) -> list[str]:
        """Run, times to which the motion is certain, and verdicts."""
        head = f"{self.scheme}, dt = {self.dt:.4g}, {several(self.members, 'member')} to t = {self.t_end:.4g}"
        known = (
            f"Rounding leaves the motion certain to t = {self.horizon:.4g}, data to t = {self.data_horizon:.4g} "
            f"(95 % of the members within {percent(self.tolerance)})."
        )
        return [head, known, *(budget.verdict for budget in self.budgets), *self.remarks]

    def _table(self) -> pandas.DataFrame:
        """Means and columns with their intervals, as they are printed."""
        import pandas

        rows = [
            {"95 % intervals": with_unit(self.units, x.quantity, UNITS.get(x.name, "")), "mean": f"{x.mean:.4g}"}
            | {name: str(x.shares.get(name, "no finer model")) for name in SOURCES if name in {"mesh", *x.shares}}
            for x in self.budgets
        ]
        return pandas.DataFrame(rows).fillna("–")

    def __str__(self) -> str:
        """The verdicts, then the columns with their intervals."""
        return "\n".join([*self._lines(), self._table().to_string(index=False)])

    def _repr_html_(self) -> str:
        return f"<p>{'</p><p>'.join(map(escape, self._lines()))}</p>{self._table().to_html(index=False)}"

    def to_dataframe(self) -> pandas.DataFrame:
        """One row for each quantity, the index: ``mean``, ``largest``, and ``data``, ``data_low``,
        ``data_high`` for each source; NaN where a quantity lacks it."""
        import pandas

        rows = {
            x.quantity: {"mean": x.mean, "largest": ", ".join(x.largest)}
            | {f"{name}{end}": getattr(part, field) for name, part in x.shares.items() for end, field in ENDS.items()}
            for x in self.budgets
        }
        return pandas.DataFrame.from_dict(rows, orient="index").rename_axis("quantity")

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts."""
        budgets = [asdict(x) | {"dominant": x.dominant, "verdict": x.verdict} for x in self.budgets]
        return plain({"measured": [], **vars(self), "budgets": budgets})

    def __getitem__(self, quantity: str) -> Budget:
        """The budget of a quantity by its name."""
        return {budget.quantity: budget for budget in self.budgets}[quantity]


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
    case: Case | System,
    scheme: Scheme | None = None,
    dt: float | None = None,
    members: int = 48,
    seed: int = 1,
    tolerance: float = 0.05,
    progress: bool | Show | None = None,
    contact: str = "implicit",
    t_end: float | None = None,
    uncertain: Mapping[str, Any] | None = None,
    finer: System | None = None,
) -> Doubt:
    """Budget of uncertainty of a run: rounding, scheme and step, mesh, data and time span, for every quantity at every
    contact.

    Parameters
    ----------
    case : Case or System
        With uncertain parameters, ``[case.uncertain]`` in its file or ``uncertain=``.
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
    t_end : float, optional
        By default the case's; a System needs it, and ``dt``.
    uncertain : mapping of path to (low, high) or distribution, optional
        In the place of the case's: paths as in ``varied_members``, each with a range or a frozen distribution of
        ``scipy.stats``, such as ``norm(mean, deviation)``.
    finer : System, optional
        For matrices, the same structure on a finer mesh: the same loads, contacts and paths. The column of the mesh is
        the distance to it. In a file it is ``[case.finer]``. For a reduced model pass one with twice as many modes: the
        column then has the truncation error only.

    Returns
    -------
    Doubt
        ``print`` it for the verdicts; ``result["impacts"].shares["data"]``. With several contacts the quantities are
        "impacts at contact 1" and so on.

    Raises
    ------
    InputError
        For a case without uncertain parameters, and what the exact solution or the scheme does not take.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import stiffbeam as sb
    >>> case = replace(sb.paper_case(10), t_end=0.1, uncertain={"stiffness": (297.0, 303.0)})
    >>> print(sb.doubt(case, sb.HHT(-0.1), members=8)["impacts"].quantity)
    impacts
    """
    if not isinstance(case, Case):
        case, finer = case_of(case, dt, t_end, finer=finer), None
    changes: dict[str, Any] = {"t_end": t_end, "uncertain": uncertain, "finer": finer}
    if finer is not None and case.beam is not None:
        raise InputError("finer", repr(finer), "belong to a system of matrices", "leave it out: a beam has its cells")
    case = replace(case, **{name: value for name, value in changes.items() if value is not None})
    integer("members", members, 8)
    positive("tolerance", number("tolerance", tolerance))
    scheme = case.runs[0][0] if scheme is None else scheme
    with working("doubt", progress) as show:
        return _doubt(
            case, scheme, case.dt if dt is None else positive("dt", dt), members, seed, tolerance, show, contact
        )


def drawn_members(system: System, uncertain: Mapping[str, Any], members: int, seed: int = 1) -> EnsembleMembers:
    """Members whose parameters are a Latin hypercube sample, see ``doubt``; the same seed draws the same parameters."""
    from scipy.stats import qmc, uniform

    if not uncertain:
        remedy = 'pass uncertain={"stops.stiffness": (4.5e6, 5.5e6)}, or write [case.uncertain] in a case file'
        raise InputError("case", uncertain, "have uncertain parameters", remedy)
    columns = {}
    sample = qmc.LatinHypercube(len(uncertain), rng=seed).random(members)
    for (path, one), shares in zip(uncertain.items(), sample.T, strict=True):
        if not hasattr(one, "ppf"):
            low, high = (number(f"uncertain {path}", x) for x in one) if np.shape(one) == (2,) else (0.0, 0.0)
            if not low < high:
                rule = "be a range (low, high), or a distribution of scipy.stats"
                raise InputError(f"uncertain {path}", one, rule, "for example (4.5e6, 5.5e6)")
            one = uniform(low, high - low)
        columns[path] = one.ppf(shares)
    return varied_members(system, columns)


def _doubt(
    case: Case, scheme: Scheme, dt: float, members: int, seed: int, tolerance: float, show: Show, contact: str
) -> Doubt:
    """The budget of a scheme, see ``doubt``."""
    form, t_end = case.forms[0], case.t_end
    system = case.system(form)
    drawn = drawn_members(system, case.uncertain, members, seed)
    show(f"doubt: {scheme}, {members} members", 0, 0)
    many = run_members(scheme, drawn, dt, t_end, contact, max(1, round(t_end / dt) // OUTPUTS))
    t = many.t
    show("doubt: the exact members", 0, 0)
    exact = reference_ensemble(system, t_end, drawn, t)
    mesh, of_mesh, remarks = finer_mesh(case, form)
    finer: Ensemble | None = None
    if mesh is not None:
        show("doubt: the exact members on a finer mesh", 0, 0)
        finer = reference_ensemble(mesh, t_end, drawn_members(mesh, case.uncertain, members, seed), t)
    show("doubt: rounding", 0, 0)
    # Rounding matters past its horizon only: there starts that hardly differ scatter.
    horizon = min(best_reference(system, t_end).horizon, t_end)
    past: Ensemble | None = None
    if horizon < t_end:
        starts = perturbed_members(system, members, ROUNDING, seed, t_end=t_end)
        past = reference_ensemble(system, t_end, starts, t)
    known = agreement_horizon(exact.t, exact.tip, tolerance)
    quantities = _quantities(exact, past)
    errors = {} if finer is None else {x.name: of_mesh(x.error(finer)) for x in quantities}
    budgets = tuple(x.budget(many, errors.get(x.name)) for x in quantities)
    return Doubt(str(scheme), float(dt), float(t_end), members, horizon, known, tolerance, case.units, budgets, remarks)


def finer_mesh(case: Case, form: str) -> tuple[System | None, Callable[[Column], Column], tuple[str, ...]]:
    """The system on a finer mesh, the column of the mesh's error from that of the distance to it, and remarks.

    None for matrices without a finer model.
    """
    if case.beam is None:
        mesh = case.refined(form)
        remedy = "pass finer=, or write [case.finer] beside [case.system]"
        remark = f"The case has matrices and no finer model: for the error of the mesh {remedy}."
        return mesh, lambda distance: distance.between(FINER), () if mesh is not None else (remark,)
    if form == "hermite" or case.system(form).rigid:
        return case.refined(form), lambda distance: distance.on_twice_the_cells(form), ()
    elements = replace(case, cells=max(case.cells, LEAST)).system("hermite")
    return elements, lambda distance: distance.between(MEASURED), ()


@dataclass(frozen=True, eq=False)
class Quantity:
    """One quantity of the exact members. error: the column of the distance of other runs of the same members.

    mean: for the tip the largest |u|. scatters: the columns that need no other runs.
    """

    name: str
    mean: float
    error: Callable[[Ensemble], Column]
    scatters: dict[str, Column]

    def budget(self, scheme: Ensemble, mesh: Column | None) -> Budget:
        """The budget with the columns of a scheme and of the mesh."""
        columns = {"rounding": self.scatters["rounding"], "scheme": self.error(scheme)}
        columns |= {} if mesh is None else {"mesh": mesh}
        return budget_of(self.name, self.mean, columns | self.scatters)


def _quantities(exact: Ensemble, past: Ensemble | None) -> list[Quantity]:
    """The tip, the quantities at every contact, and the energy; none that is not finite, as the largest force of rigid
    stops."""

    def distance(one: Array, other: Array) -> Column:
        return mean_of(np.sqrt(np.mean((one - other) ** 2, axis=1)))

    def apart(many: Ensemble) -> Column:
        return distance(many.tip, np.median(many.tip, axis=0))

    scatters = {"rounding": mean_of(np.zeros(len(exact))) if past is None else apart(past), "data": apart(exact)}
    size, t_end = float(np.max(np.abs(exact.tip))), float(exact.provenance["t_end"])
    found = [Quantity("tip", size, lambda many: distance(many.tip, exact.tip), scatters)]
    functions: dict[str, Callable[[Ensemble], Array]] = {}
    spans: dict[str, Column] = {}
    for i in range(len(exact.contacts)):
        place = f" at contact {i}" if len(exact.contacts) > 1 else ""
        for quantity, field in QUANTITIES.items():
            functions[quantity + place] = lambda many, i=i, field=field: getattr(many.contacts[i], field)
            if quantity == "impacts" and _driven(exact.members.system):
                functions[RATE + place] = lambda many, i=i: many.contacts[i].impact_count / t_end
                spans[RATE + place] = _span(exact, i)
    functions["energy"] = cache(_mean_energies)
    for name, of in functions.items():
        wanted = np.asarray(of(exact), float)
        if np.all(np.isfinite(wanted)):
            rounding = scatter(np.zeros(len(wanted)) if past is None else of(past))
            columns = {"rounding": rounding, "data": scatter(wanted)}
            columns |= {"span": spans[name]} if name in spans else {}
            found.append(Quantity(name, float(np.mean(wanted)), partial(_error, of, wanted), columns))
    return found


def _error(of: Callable[[Ensemble], Array], wanted: Array, many: Ensemble) -> Column:
    return shift(of(many), wanted)


def _driven(system: System) -> bool:
    """Return True if a load or a stop depends on time."""
    return any(not isinstance(f, Constant) for _, f in system.loads) or any(c.offset for c in system.contacts)


def _span(exact: Ensemble, contact: int) -> Column:
    edges = windows(exact.members.system, 0.0, float(exact.provenance["t_end"]))
    width = float(edges[1] - edges[0])
    times = [exact.contacts[contact].impacts_of(k).times for k in range(len(exact))]
    return of_span([stationary_mean(np.histogram(x, edges)[0] / width) for x in times])


def _mean_energies(many: Ensemble) -> Array:
    """Energy (M,) in the mean over the output times."""

    def means(part: Sequence[int]) -> list[float]:
        return [float(np.mean(each)) for each in energies(many, part)]

    return np.concatenate(list(over_slices(means, range(len(many)), MEMBERS_PER_SLICE)))
