"""Comparison: every measure of a run against a reference of the same system."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize_scalar

from ..basics.arrays import Array, step_lengths
from ..basics.resources import working
from ..basics.text import DRAW, Units, plain
from ..basics.validation import InputError
from ..model.scales import scales
from ..model.system import System
from ..trajectory.recorder import sampled_record, totals
from ..trajectory.records import Impacts, Ledger
from ..trajectory.trajectory import Reference, Trajectory
from .errors import ContactMeasures, Matching, after_rest, longest_delay, match, relative_error, rms, run_of
from .report import ROUNDING, Report, Reported, error_name, report_of

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


GRID = 401


@dataclass(frozen=True)
class PhaseLag:
    """tau minimising J(tau) = sum_j dt_j (u_run(t_j + tau) - u_ref(t_j))^2, dt_j of t_j as in ``step_lengths``;
    > 0: the run is late.

    residual: sqrt(J(tau)/sum_j dt_j u_ref(t_j)^2), what is left after the shift.
    lag and residual are NaN where the lag is undefined, and ``undefined`` says why.
    """

    lag: float = float("nan")
    residual: float = float("nan")
    undefined: str = ""


def phase_lag(t: Array, u: Array, v: Array, u_ref: Array, end: float, drive: float, first: float) -> PhaseLag:
    """The lag of a run (t, u, u') behind u_ref (k,) at its times, over t_j in [tau_m, end - tau_m], |tau| <= tau_m.

    tau_m = pi/(2 max(a, w1)) with the drive frequency a = ``drive`` and the lowest natural frequency
    w1 = ``first``. u_run between its steps is the cubic Hermite interpolant. A grid of 401 shifts, then
    Brent's method. Undefined if ``end`` < 4 tau_m or the minimum lies at an end of the range.
    """
    if max(drive, first) <= 0.0:
        return PhaseLag(undefined="nothing here has a frequency")
    tau_m = np.pi / (2.0 * max(drive, first))
    if end < 4.0 * tau_m * (1 - 1e-12):  # a drift is as long as the run, whose end has a rounding
        return PhaseLag(undefined=f"the window {end:.3g} is shorter than 4 tau_m = {4 * tau_m:.3g}")
    # The ends are left out, so that every shifted time lies in the window.
    counted = (t >= tau_m) & (t <= end - tau_m)
    inside, weights, target = t[counted], step_lengths(t)[counted], u_ref[counted]
    scale = float(np.sum(weights * target**2))
    if scale == 0.0:
        return PhaseLag(undefined="the reference is at rest")
    run = CubicHermiteSpline(t, u, v)

    # By tau/tau_m: Brent's method has an absolute tolerance, which a small unit of time would exceed.
    def J(share: float) -> float:
        return float(np.sum(weights * (run(inside + share * tau_m) - target) ** 2))

    # J of an oscillation has several minima: the grid picks one, Brent's method refines it.
    shifts = np.linspace(-1.0, 1.0, GRID)
    values = [J(share) for share in shifts]
    best = int(np.argmin(values))
    if best in (0, GRID - 1):
        return PhaseLag(undefined=f"no best shift within {tau_m:.3g}")
    # Bounded, since a bracket needs a minimum that rises above rounding on both sides.
    bounds = float(shifts[best - 1]), float(shifts[best + 1])
    result: Any = minimize_scalar(J, bounds=bounds, method="bounded", options={"xatol": 1e-10})
    return PhaseLag(float(result.x) * tau_m, float(np.sqrt(max(0.0, result.fun) / scale)))


def lost_fractions(ledger: Ledger, system: System, outputs: Iterable[int] = (-1,)) -> list[float]:
    """``Ledger.lost_fraction`` at some outputs; NaN also where the energy supplied is rounding beside V^2/2, V of
    ``scales``, as to a body that loads press on its stop."""
    least = 0.5 * ROUNDING * scales(system, float(ledger.t[-1])).speed ** 2
    supplied = ledger.supplied
    return [ledger.lost_fraction(k) if supplied[k] > least else np.nan for k in map(int, outputs)]


AT_REST = (
    "Nothing moves: the system starts at rest and nothing drives it. Give it a base motion, a load or initial data."
)


def remark(system: System, reference: Reference) -> str:
    """Sentence for a ``system`` that stays at rest or touches no stop, or the reason for the horizon, else ""."""
    if scales(system, float(reference.provenance["t_end"])).speed == 0.0:
        return AT_REST
    if "horizon_ends" in reference.provenance:
        return str(reference.provenance["horizon_ends"])
    if not reference.contacts or any(c.impacts.count or c.fraction for c in reference.contacts):
        return ""
    return f"No impacts: the motion reaches no stop to t = {reference.t[-1]:g}."


SEEN = 0.9  # share of the exact impacts that the times of arrays must show, or these count as thinned
UNKNOWN = ContactMeasures(-1, -1, np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class ContactComparison:
    """Comparison of one contact of the run with the same contact of the reference.

    name: see ``contact_name``. run, reference: on [0, window]; the reference's impacts are sampled at the run's steps,
    and so are its share, peak and impulse if it ends later. run_totals, reference_totals: the same to t_end, single
    runs that are comparable only statistically.
    """

    name: str
    run: ContactMeasures
    reference: ContactMeasures
    matching: Matching
    run_totals: ContactMeasures
    reference_totals: ContactMeasures


class Tables(Reported):
    """Views of one comparison or of several: tables and a picture."""

    @property
    def _all(self: Any) -> tuple[Comparison, ...]:
        """The comparisons in the tables."""
        return self if isinstance(self, tuple) else (self,)

    def to_dataframe(self) -> pandas.DataFrame:
        """One line a run, the entries of ``Comparison.to_dict`` flat: phase_lag, contact0_run_peak_force and so on;
        units in attrs."""
        import pandas

        rows = [c.records() for c in self._all]
        for row in rows:
            row |= {name: "; ".join(row[name]) for name in ("units", "missing")}
            row |= {f"contact{i}": contact for i, contact in enumerate(row.pop("contacts"))}
        frame = pandas.json_normalize(rows, sep="_")
        frame.attrs["units"] = list(self._all[0].units)
        return frame

    def figure(self) -> Figure:
        """The runs beside the reference, a matplotlib Figure."""
        return DRAW["comparison"](self._all)

    def report(self) -> Report:
        """The tables with remarks and notes."""
        return report_of(self._all)


@dataclass(frozen=True, repr=False)
class Comparison(Tables):
    """A run against a reference on [0, window], window = min(t_end, horizon), and totals to t_end beside it.

    Parameters
    ----------
    label, reference : str
    units : tuple
        Units of times, forces and impulses.
    dt : float
        The median time step.
    steps, seconds, ns_per_step
        Cost of the run.
    window, t_end : float
    tip_error_rms, tip_error_max : float
        Errors u_run - u_ref at the run's steps, over max |u_ref|.
    matched_until : float
        The time to which the impacts match at all contacts, at most the window. NaN where the run lacks impacts.
    phase : PhaseLag
    energy_lost : float
        Numerical dissipation over the largest energy supplied, see ``Ledger.supplied``.
    contacts : sequence of ContactComparison
        In the system's order.
    totals_energy_lost : float
        ``energy_lost`` to t_end.
    missing : sequence of str
        Quantities that the run does not hold, with the reason; their numbers are NaN, and counts of impacts -1.
    remark : str
        States that nothing moves or that nothing touches a stop, else empty.
    error, times : array (k,)
        u_run - u_ref over max |u_ref| at the steps of the window, which ``to_dict`` leaves out.
    pair : (Trajectory, Reference)
    """

    label: str
    reference: str
    units: Units
    dt: float
    steps: int
    seconds: float
    ns_per_step: float
    window: float
    t_end: float
    tip_error_rms: float
    tip_error_max: float
    matched_until: float
    phase: PhaseLag
    energy_lost: float
    contacts: tuple[ContactComparison, ...]
    totals_energy_lost: float
    missing: tuple[str, ...]
    remark: str
    error: Array = field(compare=False)
    times: Array = field(compare=False)
    pair: tuple[Trajectory, Reference] = field(compare=False)

    def tip_error_to(self, time: float) -> float:
        """The rms of ``error`` on [0, time], 0 < time <= window. Raises InputError for any other time."""
        if not 0.0 < time <= self.window * (1 + 1e-12):
            raise InputError("time", time, f"lie in (0, {self.window:g}], the window", "use .window or .matched_until")
        inside = steps_to(self.times, time)
        return rms(self.error[:inside], self.times[:inside])

    def records(self) -> dict[str, Any]:
        """All fields but ``error``, ``times`` and ``pair``, as dictionaries."""
        held = {each.name: getattr(self, each.name) for each in fields(self) if each.compare}
        return held | {"phase": asdict(self.phase), "contacts": [asdict(contact) for contact in self.contacts]}

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and strings; NaN becomes None, as JSON has none."""
        return plain(self.records())

    def __repr__(self) -> str:
        error = f"{100 * self.tip_error_rms:.3g} %"
        name = error_name(self.pair[1])
        return f"<Comparison {self.label} with {self.reference}: {name} {error} rms to t = {self.window:g}>"


class Comparisons(Tables, tuple["Comparison", ...]):
    """Several runs against one reference, as one table: a tuple of Comparison."""

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts, for JSON."""
        return {"comparisons": [c.to_dict() for c in self]}

    def __repr__(self) -> str:
        return f"<Comparisons of {', '.join(c.label for c in self)}>"


@overload
def compare(run: Sequence[Trajectory], reference: Reference) -> Comparisons: ...
@overload
def compare(run: Trajectory | Sequence[ArrayLike], reference: Reference) -> Comparison: ...
@working("comparing")
def compare(
    run: Trajectory | Sequence[ArrayLike] | Sequence[Trajectory], reference: Reference
) -> Comparison | Comparisons:
    """Return all measures of a run, or of several, against a reference of the same system.

    Parameters
    ----------
    run : Trajectory, sequence of Trajectory or sequence of arrays
        A scheme's run with every step on output, another reference, or arrays (t, tip) or (t, tip, tip velocity), (k,)
        each, or (t, q, v), q and v (k, n) of all unknowns. Tables and pictures call arrays "own";
        ``Trajectory.from_arrays(..., name="mine")`` makes a run with another name. Times need not be equidistant: means
        are means over time. Quantities that arrays do not hold are NaN, and ``missing`` gives the reason.
    reference : Reference
        With a horizon. Every measure is taken to the smaller of the horizon and the end of the run.

    Returns
    -------
    Comparison or Comparisons
        Tip error, phase lag, impacts, forces and energy; of several runs one table.

    Raises
    ------
    InputError
        If the systems differ, if a scheme's outputs are thinned, or if the reference has no horizon or no values at the
        run's times.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> runs = [sb.integrate(system, scheme, dt=1e-5, t_end=0.1) for scheme in (sb.HHT(alpha=-0.1), sb.BDF2())]
    >>> both = sb.compare(runs, sb.reference(system, t_end=0.1))
    >>> both[0].tip_error_rms < both[1].tip_error_rms
    True
    """
    if isinstance(run, (list, tuple)) and run and all(isinstance(each, Trajectory) for each in run):
        return Comparisons(_compared(each, reference) for each in run)
    return _compared(run, reference)


def _compared(run: Any, reference: Reference) -> Comparison:
    """All measures of one run."""
    run = run_of(run, reference, "compare")
    system = run.system or reference.system
    if system is None:
        raise InputError(
            "run", "two loaded files", "leave one trajectory with its system", "read one with it: sb.load(file, system)"
        )
    if run.provenance.get("every", 1) != 1:
        raise InputError("every", run.provenance["every"], "be 1 for a comparison", "integrate with every=1")
    t = run.t
    if t[0] != 0.0:
        raise InputError("run.t", float(t[0]), "begin at 0", "put 0 before the times in t_eval")
    # Totals go to the end of the shorter solution, errors at most to the horizon.
    t_end = min(float(t[-1]), float(reference.provenance["t_end"]))
    window = min(t_end, reference.horizon)
    # A median of differences has roundings that the step of a scheme does not have.
    dt, inside = float(run.provenance.get("dt", np.median(np.diff(t)))), steps_to(t, window)
    if inside < 3:
        remedy = "use a smaller dt, and give times in the unit of the reference"
        raise InputError("dt", dt, f"leave two steps before the horizon {window:.3g}", remedy)
    u_ref, _ = reference.at(t[: (steps := steps_to(t, t_end))])
    error = relative_error(run.tip[:inside], u_ref[:inside])
    # The match of the run ends with that of the contact that parts first.
    contacts = tuple(_contact(run, reference, system, i, t[:steps], window) for i in range(len(system.contacts)))
    together = min((c.matching.matched_until for c in contacts), default=window)
    unknown = any(contact.impacts.kind == "unknown" for contact in run.contacts)
    energy = run.energy if run.has_energy else None
    lost = [np.nan] * 2 if energy is None else lost_fractions(energy, system, (inside - 1, steps - 1))
    # The lag is measured while the impacts match; past that, no shift makes the two motions alike.
    period = scales(system, float(reference.provenance["t_end"])).period
    lag = phase_lag(
        t[:steps], run.tip[:steps], run.tip_velocity[:steps], u_ref, together,
        max(system.drive.frequencies, default=0.0), 2.0 * np.pi / period,
    )  # fmt: skip
    return Comparison(
        label=run.label, reference=reference.label, units=system.units, dt=dt, steps=run.work.steps,
        seconds=run.work.seconds, ns_per_step=run.work.ns_per_step,
        window=window, t_end=t_end, tip_error_rms=rms(error, t[:inside]), tip_error_max=float(np.max(np.abs(error))),
        matched_until=float("nan") if unknown else together, phase=lag, energy_lost=lost[0], contacts=contacts,
        totals_energy_lost=lost[1], missing=tuple(_missing(run, system, contacts)), remark=remark(system, reference),
        pair=(run, reference), error=error, times=t[:inside],
    )  # fmt: skip


def _missing(run: Trajectory, system: System, contacts: Sequence[ContactComparison]) -> Iterator[str]:
    """Measures that the run does not allow, with the reason; the result has NaN for them."""
    arrays = run.provenance.get("source") == "arrays"
    for c, record, contact in zip(contacts, run.contacts, system.contacts, strict=True):
        if record.impacts.kind == "unknown":
            yield f"{c.name}: the run came without states, or velocities at a rigid stop: pass [t, q, v]"
        if arrays and c.reference.impacts < SEEN * c.reference.event_impacts:
            yield (
                f"{c.name}: at the run's times the exact motion itself shows {c.reference.impacts} of its "
                f"{c.reference.event_impacts} impacts; pass every step if these are thinned"
            )
        if arrays and contact.stops.rigid:
            yield f"{c.name}: positions tell neither share, peak nor impulse of a rigid stop"
    if not run.has_energy:
        without = "states (q, v)" if run.pieces is None else "the reactions of its rigid stops"
        yield f"energy: the run came without {without}"
    if "tip_velocity" in run.provenance:
        yield f"tip velocity: {run.provenance['tip_velocity']}; impact times and lag are as good as that"


def steps_to(t: Array, end: float) -> int:
    """Number of the times t (k,) in [0, end]."""
    return int(np.searchsorted(t, end * (1 + 1e-12), side="right"))


def _contact(
    run: Trajectory, reference: Reference, system: System, i: int, t: Array, window: float
) -> ContactComparison:
    """Contact i at the steps t, of which the first are those to the window."""
    record, known, stops = run.contacts[i], reference.contacts[i], system.contacts[i].stops
    impacts, true, forces = record.impacts, known.impacts, (None, None)
    # Impacts of the reference are sampled where those of the run are: at compliant stops, and of arrays at rigid ones.
    if not stops.rigid or run.provenance.get("source") == "arrays":
        exact = sampled_record(t, *reference.at(t, contact=i), stops)
        true = exact.impacts
        if not stops.rigid:
            forces = record.force, exact.force
            # Those of a solver, which has events, too.
            if "dt" not in run.provenance:
                impacts = sampled_record(run.t, record.position, record.velocity, stops).impacts
            if impacts.kind != "unknown":
                impacts, true = after_rest((impacts, true), (run.t, record.position), (t, exact.position))
    known_to = float(reference.provenance["t_end"])
    (of_run, run_totals), (of_reference, reference_totals) = (
        [_measures(one, i, rows, force, t, end) for end in (window, min(float(run.t[-1]), known_to))]
        for one, rows, force in ((run, impacts, forces[0]), (reference, true, forces[1]))
    )
    # Where no impact of the run is known, nothing parts and nothing is paired.
    matching = Matching(0, window, np.nan)
    if record.impacts.kind != "unknown":
        matching = match(impacts, true, window, longest_delay(system, known_to))
    return ContactComparison(contact_name(system, i), of_run, of_reference, matching, run_totals, reference_totals)


def _measures(run: Trajectory, i: int, impacts: Impacts, force: Array | None, t: Array, end: float) -> ContactMeasures:
    """Contact i on [0, end] from its impacts, and from its record to the end of the run. Before that share, peak and
    impulse follow from the ``force`` at the steps t; of rigid stops, which have no peak, they are not known there."""
    record = run.contacts[i]
    if impacts.kind == "unknown":
        return UNKNOWN
    sums = record.fraction, np.nan if force is None else record.peak_force, record.impulse
    if end < float(run.provenance["t_end"]) * (1 - 1e-12):
        inside = steps_to(t, end)
        sums = 3 * (np.nan,) if force is None else totals(t[:inside], force[:inside])
    return ContactMeasures(impacts.until(end).count, record.impacts.until(end).count, *sums)


def contact_name(system: System, i: int) -> str:
    """Number of contact i with its place along a beam or, if it acts on one unknown, the row of that; "the contact"
    where there is no other."""
    number = f"contact {i}" if len(system.contacts) > 1 else "the contact"
    if system.problem is not None:
        return f"{number}, x = {float(system.problem.place(system.problem.all_stops[i])):g}"
    rows = np.flatnonzero(system.contacts[i].row)
    return f"{number}, row {rows[0]}" if len(rows) == 1 and system.size > 1 else number
