"""advise: find the scheme, the contact treatment and the time step for given errors, by trial runs.

    error(tip)         rms of (u - u_exact)/max |u_exact| over the run's steps
    error(impacts)     |N - N_exact|/max(N_exact, 1), N the impacts to t_end, those of the exact motion by events
    error(peak_force)  |F - F_exact|/F_exact, F the largest contact force to t_end
    error(impulse)     likewise, of the integral of |sigma|

With several contacts the largest error counts. Every scheme runs with 2^k n steps, k = 0, 1, ... A time step counts if
it, its half and BETWEEN steps between the two all meet the requirements: errors through contact do not decrease
steadily, and a count or a peak may be right by chance. The result is the cheapest run in linear solves (steps times
stages), which are the cost of a step in any program. All schemes are refined together: a scheme is not run finely if a
coarse run of another is enough. If some requirements cannot be met, the others count only if every finer step meets
them too.

Past the horizon a single motion has no meaning, so the means over perturbed members are compared. A mean is right if it
and the 95 % interval of the difference lie within the admissible error; the tip has no such mean. The members differ by
a thousandth of the motion, so they diverge as soon as a scheme diverges from the exact motion. Closer members would all
follow one motion of that scheme first, and their mean would contain no information on the distribution.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.progress import Show, working
from ..basics.resources import clock
from ..basics.validation import InputError, instance, integer, one_of, positive, sequence
from ..files.cases import Case
from ..march.integrate import integrate
from ..march.treatment import TREATMENTS
from ..measures.comparison import remark
from ..measures.errors import stays_within, tip_error
from ..model.members import SPREAD, perturbed_members
from ..model.modes import modes
from ..model.scales import scales
from ..model.system import System
from ..model.time_functions import Drive
from ..references import best_reference
from ..references.ensemble import reference_ensemble
from ..schemes import RIGID, SCHEMES, Scheme
from ..schemes.labels import make
from ..trajectory.trajectory import Diverged, Reference, Trajectory
from .base import Store
from .common import run_members
from .ensemble import difference, too_uncertain

if TYPE_CHECKING:
    import pandas

Tell = Callable[[str], None]
BETWEEN = 5  # steps of one motion that are tried between a step and its half; means say themselves how sure they are
FEWEST = 8  # members of a mean
PER_PERIOD = 8  # steps of the coarsest run in the shorter of the longest time scale and the drive's period
COLUMNS = (("impacts", "impact_count"), ("peak_force", "peak_force"), ("impulse", "impulse"))  # of an ensemble
COST = ("scheme", "contact", "dt", "steps", "work", "seconds")
QUANTITIES = ("tip", *(name for name, _ in COLUMNS))


@dataclass(frozen=True)
class Probe:
    """A trial run: its errors by quantity, infinite if it broke off. work: linear solves."""

    scheme: Scheme
    contact: str
    dt: float
    steps: int
    work: int
    seconds: float
    errors: dict[str, float]

    @property
    def label(self) -> str:
        """The scheme, and the contact treatment where it is not the implicit one."""
        return f"{self.scheme}" + (f", {self.contact} contact" if self.contact != "implicit" else "")

    def meets(self, want: Mapping[str, float]) -> bool:
        """Return True where every error is at most the one wanted."""
        return all(self.errors[name] <= tolerance for name, tolerance in want.items())


@dataclass(eq=False)
class Search:
    """Trial runs of all candidates, refined together until ``until``, a time of ``clock``. tried: all runs so far."""

    system: System
    t_end: float
    criterion: Motion | Statistics
    until: float
    journal: Store
    show: Show
    tell: Tell
    tried: list[Probe] = field(default_factory=list)
    ended: str = ""  # number of steps at which the time was over

    def probe(self, scheme: Scheme, contact: str, steps: int) -> Probe | None:
        """The run with this number of steps, from the journal if it is there; None if the scheme refuses it."""
        dt = self.t_end / steps
        point = {"system": self.system.fingerprint, "t_end": self.t_end, "contact": contact, "steps": steps}
        point |= {"scheme": scheme, "members": self.criterion.members}

        def measured() -> list[dict[str, Any]]:
            try:
                errors, seconds = self.criterion.errors(self.system, scheme, contact, dt, self.t_end)
            except (Diverged, InputError) as error:
                if isinstance(error, InputError) and error.field != "dt":  # else a step at which it is refused
                    return [{"lost": str(error)}]
                errors, seconds = dict.fromkeys(QUANTITIES, np.inf), 0.0
            return [{"seconds": seconds, "errors": errors}]

        (row,) = self.journal.rows(point, measured)
        return None if "lost" in row else Probe(scheme, contact, dt, steps, steps * len(scheme.nodes), **row)

    def cheapest(
        self, candidates: list[tuple[Scheme, str]], want: dict[str, float], steps: int, most: int, between: int
    ) -> Probe | None:
        """The cheapest run that meets the want, None where there is none.

        A candidate is refined from ``steps`` to ``most`` until two numbers of steps in a row meet the want and so do
        ``between`` numbers between them, or until it costs more than the best that does.
        """
        best: Probe | None = None
        alive: list[tuple[Scheme, str, Probe | None]] = [(scheme, contact, None) for scheme, contact in candidates]
        while alive and steps <= most and not self.ended:
            refined, level = [], []
            for done, (scheme, contact, before) in enumerate(alive):
                self.show(f"advise: runs of {steps} steps", done, len(alive))
                # A run takes twice as long as the one of half the steps, which has as many members.
                last = 0.0 if before is None else 2.0 * before.seconds * max(1, self.criterion.members)
                if clock() + last > self.until and (level or self.tried):
                    self.ended = f"{steps} steps"
                    continue
                good = before if before is not None and before.meets(want) else None
                # What costs more than the best run that meets the requirements cannot be chosen.
                if best is not None and (good.work if good else steps * len(scheme.nodes)) >= best.work:
                    continue
                run = self.probe(scheme, contact, steps)
                if run is None:
                    continue  # what this scheme or these stops do not take
                level.append(run)
                # Runs between two that meet the requirements may show that this was chance.
                if good and run.meets(want):
                    self.tried += (others := self._between(good, want, between))
                    if all(p.meets(want) for p in others):
                        best = good
                        self.tell(f"cheapest so far: {best.label}, {best.steps} steps, {best.work} linear solves")
                        continue
                refined.append((scheme, contact, run))
            if level:
                least = {name: min(level, key=lambda p, name=name: p.errors[name]) for name in want}
                words = ", ".join(f"{name} {p.errors[name]:.2g} ({p.label})" for name, p in least.items())
                self.tell(f"{steps} steps: {words}")
            self.tried += level
            alive, steps = refined, 2 * steps
        return best

    def _between(self, coarse: Probe, want: Mapping[str, float], count: int) -> list[Probe]:
        """``count`` runs of steps between those of ``coarse`` and their half, as far as they meet the want."""
        runs: list[Probe] = []
        for k in range(1, count + 1):
            run = self.probe(coarse.scheme, coarse.contact, round(coarse.steps * 2.0 ** (k / (count + 1))))
            if run is not None:
                runs.append(run)
                if not run.meets(want):
                    break
        return runs


def _period(system: System, t_end: float) -> float:
    """The shorter of the longest time scale and the drives' periods."""
    return min(scales(system, t_end).period, *(2.0 * np.pi / rate for rate in Drive.of(system).frequencies), t_end)


def cheapest(tried: list[Probe], want: dict[str, float]) -> Probe | None:
    """The cheapest run that meets the requirements together with at least one finer run and all finer ones. Otherwise a
    coarse run meets them by chance."""
    good: list[Probe] = []
    for label in dict.fromkeys(probe.label for probe in tried):
        finest_first = sorted((p for p in tried if p.label == label), key=lambda p: -p.steps)
        good += list(takewhile(lambda p: p.meets(want), finest_first))[1:]
    return min(good, key=lambda p: p.work, default=None)


def unreached(tried: list[Probe], want: dict[str, float], most: int) -> dict[str, str]:
    """Requirements that no step meets; if there is none, the one that costs most."""
    # Every quantity alone: those that no run reaches, else the one whose cheapest run costs most.
    alone = {name: cheapest(tried, {name: x}) for name, x in want.items()}
    reasons = {}
    for name in [name for name, probe in alone.items() if probe is None]:
        best = min(tried, key=lambda p, name=name: p.errors[name])
        kept = "some, but of no scheme all finer ones," if best.meets({name: want[name]}) else "none"
        runs = f"{kept} of {len(tried)} runs of up to {most} steps reach it"
        reasons[name] = f"{runs}; the best has {best.errors[name]:.3g}, {best.label} at dt = {best.dt:.3g}"
    if reasons:
        return reasons
    name = max(alone, key=lambda n: alone[n].work)  # type: ignore[union-attr]
    probe = alone[name]
    assert probe is not None
    return {name: f"not together with the rest; alone with {probe.label} at dt = {probe.dt:.3g}"}


WANT = {"tip": 1e-3, "impacts": 0.05, "peak_force": 0.05}
MOST_STEPS, MOST_DIRECT, MOST_MEMBER = 2**20, 2**14, 2**11  # of a run; marched with matrices, a thousand times slower
PAST = "past the horizon t = {} no step gives one motion: motions 1e-16 apart have diverged there"


@dataclass(frozen=True)
class Advice:
    """Outcome of ``advise``: the recommended run, and the errors that no run reaches.

    Parameters
    ----------
    want : dict of str to float
        Admissible error per quantity.
    t_end, horizon : float
    members : int
        Number of members of the ensembles past the horizon, 0 without an ensemble.
    recommendation : Probe, optional
        The cheapest run; None where there is none.
    unattainable : dict of str to str
        Quantities that no run reaches, with the reason. The recommended run reaches the others.
    trusted_until : float
        The time to which the recommended run's tip stays within the wanted error (1e-3 without one), at most the
        horizon.
    candidates : sequence of Probe
        All runs that were tried.
    system : System
    scatter : dict of str to float
        Standard deviation of an exact member over the mean, by quantity.
    remark : str
        States that nothing moves or touches a stop, and what the time did not suffice for; else empty.
    """

    want: dict[str, float]
    t_end: float
    horizon: float
    members: int
    recommendation: Probe | None
    unattainable: dict[str, str]
    trusted_until: float
    candidates: tuple[Probe, ...] = field(repr=False)
    system: System = field(repr=False)
    scatter: dict[str, float] = field(default_factory=dict)
    remark: str = ""

    def run(self, every: int = 1) -> Trajectory:
        """The recommended run. Raises InputError if there is no recommendation."""
        if self.recommendation is None:
            raise InputError("advice", "none", "name a run", "; ".join(self.unattainable.values()))
        run = self.recommendation
        return integrate(self.system, run.scheme, run.dt, self.t_end, run.contact, every)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and texts."""
        run = self.recommendation and vars(self.recommendation) | {"scheme": str(self.recommendation.scheme)}
        rest = {name: value for name, value in vars(self).items() if name not in ("candidates", "system")}
        return {"measured": ["recommendation.seconds"], **rest, "recommendation": run, "units": list(self.system.units)}

    def _repr_html_(self) -> str:
        return f"<p>{'</p><p>'.join(map(escape, str(self).splitlines()))}</p>{self.to_dataframe().to_html(index=False)}"

    def to_dataframe(self) -> pandas.DataFrame:
        """One row for each trial run."""
        import pandas

        rows = [vars(p) | {"scheme": str(p.scheme)} | {f"error_{x}": p.errors.get(x, np.nan) for x in QUANTITIES}
                for p in self.candidates]  # fmt: skip
        return pandas.DataFrame(rows, columns=[*COST, *(f"error_{x}" for x in QUANTITIES)])

    def __str__(self) -> str:
        end = f"{self.t_end:g}"
        lines = [self.remark] if self.remark else []
        if self.recommendation is not None:
            p = self.recommendation
            met = ", ".join(f"{name} {p.errors[name]:.2g} (wanted {self.want[name]:g})" for name in self.attainable)
            over = f", means over {self.members} members whose starts differ by {SPREAD:g}" if self.members else ""
            dt = f"{p.dt:.6g}"
            cost = f"{p.steps} steps to t = {end}, {p.work} linear solves, {p.seconds:.2g} s here"
            lines.append(f"{p.label}, dt = {dt}: {cost}{over}")
            lines.append(f"relative errors, of the tip rms, without those of the mesh: {met}")
            if self.scatter:
                single = ", ".join(f"{name} {self.scatter[name]:.2g}" for name in self.attainable)
                lines.append(f"a single motion scatters about its mean by (relative) {single}: run an ensemble")
            until, least = f"{self.trusted_until:.4g}", self.want.get("tip", WANT["tip"])
            near = f"within {least:g} max|u| of the exact one"
            to = f"at every moment to t = {until} its tip is {near}"
            lines.append(to if self.trusted_until > 0.0 else f"already after one step its tip is not {near}")
        lines += [f"cannot be had: {name} to {self.want[name]:g}: {why}" for name, why in self.unattainable.items()]
        return "\n".join(lines)

    @property
    def attainable(self) -> list[str]:
        """The quantities whose admissible errors can be met."""
        return [name for name in self.want if name not in self.unattainable]

    def __repr__(self) -> str:
        run = self.recommendation
        advised = "nothing" if run is None else f"{run.label}, dt = {run.dt:.6g}"
        return f"<Advice to t = {self.t_end:g}: {advised}; cannot be had: {', '.join(self.unattainable) or 'none'}>"


def advise(
    system: System | Case,
    want: Mapping[str, float] | None = None,
    t_end: float | None = None,
    schemes: Sequence[Scheme] | None = None,
    contacts: Sequence[str] = ("implicit", "conserving"),
    most_steps: int | None = None,
    members: int = 48,
    seconds: float = 60.0,
    progress: bool | Show | None = None,
    tell: Tell = lambda line: None,
    journal: Store | None = None,
) -> Advice:
    """Return the cheapest run of ``schemes`` that reaches the admissible errors up to t_end, and the errors that no run
    reaches.

    An independent solver confirmed the errors of all recommended runs on 20 random systems that were not used in the
    development (``tests/studies/test_advice.py``).

    Parameters
    ----------
    system : System or Case
        As for the exact reference.
    want : mapping of str to float, optional
        Admissible relative errors: tip (rms, over max|u|), impacts, peak_force, impulse. By default 1e-3, 0.05 and 0.05
        of the first three; of rigid stops impulse in the place of peak_force.
    t_end : float
        By default that of the case.
    schemes : sequence of Scheme, optional
        By default every registered one.
    contacts : sequence of str
        Treatments of contact to try; "conserving" with the schemes that have it.
    most_steps : int, optional
        Where the search ends: by default 2^20 steps, 2^14 of a march with matrices, 2^11 for means.
    members : int
        Perturbed runs behind each mean past the horizon.
    seconds : float
        CPU seconds after which the search ends with what it knows by then, as ``remark`` says.
    progress : as for ``reference``
    tell : callable
        Called with one line of text after every refinement.
    journal : Store, optional
        Keeps finished runs, so that a search that was interrupted goes on.

    Returns
    -------
    Advice

    Raises
    ------
    InputError
        For bad arguments, and for a system without a reference.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> spring = sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=400.0))
    >>> system = sb.System.from_matrices([[1.0]], [[4.0]], contacts=[spring], initial_velocity=[1.0])
    >>> advice = sb.advise(system, {"tip": 0.01}, t_end=3.0, schemes=[sb.Trapezoidal()], most_steps=4096)
    >>> advice.recommendation is not None
    True
    """
    with working("advise", progress) as show:
        given = (schemes, contacts, most_steps, members, seconds, show, tell, journal or Store(None, ""))
        return _advise(system, want, t_end, *given)


def _advise(
    system: System | Case, want: Mapping[str, float] | None, t_end: float | None, schemes: Sequence[Scheme] | None,
    contacts: Sequence[str], most_steps: int | None, members: int, seconds: float, show: Show, tell: Tell,
    journal: Store,
) -> Advice:  # fmt: skip
    """``advise`` with a function that shows its progress."""
    begun = clock()
    if isinstance(system, Case):
        t_end, system = system.t_end if t_end is None else t_end, system.system()
    system = instance("system", system, System, "make it with semidiscretise or from_matrices")
    if t_end is None:
        remedy = "for example t_end=1.0"
        raise InputError("t_end", None, "be given: what is right depends on how long it is followed", remedy)
    wanted = _wanted(system, want)
    for name in sequence("contacts", contacts, "be names"):
        one_of("contacts", name, TREATMENTS)
    contacts = contacts if system.contacts else contacts[:1]
    integer("members", members, 2)
    share = 0.4 * positive("seconds", seconds)  # of the time for the exact motion, and for its ensemble
    exact = best_reference(system, positive("t_end", t_end), progress=show, seconds=share)
    remarks = [remark(system, exact)]
    if "budget" in exact.provenance:
        t_end = float(exact.t[-1])
        remarks.append(f"The advice is for the time that the exact motion reached, {exact.provenance['budget']}.")
    # One motion up to the horizon; past it means over perturbed members, as many as there is time for.
    past = exact.horizon < t_end
    affordable = int(share / max(exact.work.march_seconds, 1e-9))
    if past and affordable < members:
        remarks.append(f"{members} exact motions take some {members * exact.work.march_seconds:.0f} s: ")
        if past := affordable >= FEWEST:
            members = affordable
            remarks[-1] += f"there is time for {members}."
        else:
            t_end = exact.horizon
            remarks[-1] += f"the advice is for one motion to its horizon t = {t_end:.4g}."
            exact = best_reference(system, t_end, progress=show)
    criterion = Statistics(system, t_end, members, show) if past else Motion(exact)
    cannot = {"tip": PAST.format(f"{exact.horizon:.4g}")} if past and "tip" in wanted else {}
    cannot |= too_uncertain(criterion.scatter, members, wanted)
    open_wants = {name: x for name, x in wanted.items() if name not in cannot}
    direct = MOST_MEMBER if past else MOST_DIRECT
    most = integer("most_steps", most_steps or (direct if modes(system) is None else MOST_STEPS), 1)
    candidates = _candidates(schemes, contacts)
    coarsest = min(most, max(4, int(np.ceil(PER_PERIOD * t_end / _period(system, t_end) * (1 - 1e-12)))))
    search = Search(system, t_end, criterion, begun + seconds, journal, show, tell)
    chosen = None
    if open_wants:
        chosen = search.cheapest(candidates, open_wants, coarsest, most, 0 if past else BETWEEN)
        if not search.tried:
            remedy = "pass schemes that take its stops" if system.contacts else "pass other schemes"
            raise InputError(
                "schemes", ", ".join(dict.fromkeys(str(s) for s, _ in candidates)), "take the system", remedy
            )
    if search.ended:
        remarks.append(f"The search ended after {seconds:g} s at {search.ended}: more seconds may find more.")
    # Give up what no run reaches, and advise for the rest.
    while chosen is None and open_wants:
        worst = unreached(search.tried, open_wants, max(p.steps for p in search.tried))
        # Means carry the scatter of their members, which no step makes smaller.
        more = f"; a mean over more than {criterion.members} members is nearer" if criterion.members else ""
        cannot |= {name: why + more for name, why in worst.items()}
        open_wants = {name: x for name, x in open_wants.items() if name not in worst}
        chosen = cheapest(search.tried, open_wants) if open_wants else None
    until = 0.0
    if chosen is not None:
        run = integrate(system, chosen.scheme, chosen.dt, t_end, chosen.contact)
        until = stays_within(run, exact, wanted.get("tip", WANT["tip"]))
    return Advice(
        wanted, float(t_end), exact.horizon, criterion.members, chosen, cannot, until, tuple(search.tried), system,
        dict(criterion.scatter), " ".join(filter(None, remarks)),
    )  # fmt: skip


def _wanted(system: System, want: Mapping[str, float] | None) -> dict[str, float]:
    wanted = dict(instance("want", WANT if want is None else want, Mapping, 'for example {"tip": 0.01}'))
    if want is None and not system.contacts:
        wanted = {"tip": WANT["tip"]}
    elif want is None and system.rigid:
        wanted["impulse"] = wanted.pop("peak_force")
    if not wanted:
        raise InputError("want", want, "name at least one quantity", f"known: {', '.join(QUANTITIES)}")
    for name, tolerance in wanted.items():
        one_of("want", name, QUANTITIES, "name a quantity")
        wanted[name] = positive(f"want.{name}", tolerance)
        if name != "tip" and not system.contacts:
            remedy = "ask for tip only, or give the system contacts"
            raise InputError("want", name, "be asked of a system with contacts", remedy)
        if name == "peak_force" and system.rigid:
            raise InputError("want", name, "be asked of compliant stops", "ask for impulse: a blow has no force")
    return wanted


def _candidates(schemes: Sequence[Scheme] | None, contacts: Sequence[str]) -> list[tuple[Scheme, str]]:
    every = [make(name) for name in (*SCHEMES, *RIGID) if name != "theta"]
    chosen = every if schemes is None else sequence("schemes", schemes, "be Scheme objects")
    if not chosen or not contacts:
        remedy = "leave out what is empty, to try all"
        raise InputError("schemes", chosen and contacts, "be at least one, with one way to treat contact", remedy)
    for scheme in chosen:
        if not isinstance(scheme, Scheme):
            raise InputError("schemes", scheme, "be Scheme objects", "for example stiffbeam.HHT(alpha=-0.1)")
    return [(s, contact) for s in chosen for contact in contacts if TREATMENTS[contact].takes(s)]


class Motion:
    """Errors of one motion against the exact one."""

    members = 0
    scatter: Mapping[str, float] = {}

    def __init__(self, exact: Reference) -> None:
        self.exact = exact

    def errors(
        self, system: System, scheme: Scheme, contact: str, dt: float, t_end: float
    ) -> tuple[dict[str, Any], float]:
        """Errors of tip (rms), impact count, peak force and impulse, the worst over the contacts, and seconds."""
        run = integrate(system, scheme, dt, t_end, contact)
        pairs = list(zip(run.contacts, self.exact.contacts, strict=True))
        counts = (abs(a.impacts.count - b.impacts.count) / max(b.impacts.count, 1) for a, b in pairs)
        errors = {"tip": tip_error(run.tip, self.exact.at(run.t)[0]).rms, "impacts": max(counts, default=0.0)}
        for name in ("peak_force", "impulse"):
            errors[name] = max((_relative(getattr(a, name), getattr(b, name)) for a, b in pairs), default=0.0)
        return errors, run.work.march_seconds


class Statistics:
    """Errors of means over perturbed members against those of the exact ensemble."""

    def __init__(self, system: System, t_end: float, members: int, show: Show) -> None:
        self.members = members
        self.systems = perturbed_members(system, members, SPREAD, t_end=t_end)
        what = f"advise: {members} exact motions"
        self.exact = reference_ensemble(system, t_end, self.systems, progress=lambda done: show(what, done, members))
        self.scatter = {
            name: max((_deviation(getattr(contact, column)) for contact in self.exact.contacts), default=0.0)
            for name, column in COLUMNS
        }

    def errors(
        self, system: System, scheme: Scheme, contact: str, dt: float, t_end: float
    ) -> tuple[dict[str, Any], float]:
        """Errors of the means with the 95 % intervals of the differences, the worst over the contacts, and seconds of
        a member; Diverged where one overflows."""
        many = run_members(scheme, self.systems, dt, t_end, contact)
        pairs = list(zip(many.contacts, self.exact.contacts, strict=True))
        errors = {name: max(_mean_error(getattr(a, x), getattr(b, x)) for a, b in pairs) for name, x in COLUMNS}
        return errors, many.work.march_seconds / len(self.systems)


def _relative(value: float, exact: float) -> float:
    """|value - exact| over the exact value; where that is 0, infinite unless the value is 0 too."""
    if exact == 0.0:
        return 0.0 if value == 0.0 else np.inf
    return abs(value / exact - 1.0)


def _deviation(values: Array) -> float:
    mean = float(np.mean(values))
    return float(np.std(values, ddof=1)) / mean if mean else 0.0


def _mean_error(values: Array, exact: Array) -> float:
    """|difference of the means| with its 95 % interval, over the exact mean."""
    off, interval = difference(np.asarray(values, float), np.asarray(exact, float))
    mean = float(np.mean(exact))
    return _relative(off, mean) if mean == 0.0 else (abs(off) + interval) / mean
