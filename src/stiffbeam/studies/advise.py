"""The cheapest scheme, contact treatment and time step for given errors, by trial runs.

    error(tip)         rms of (u - u_exact)/max |u_exact| over the run's steps
    error(impacts)     |N - N_exact|/max(N_exact, 1), N the impacts to t_end, those of the exact motion by events
    error(peak_force)  |F - F_exact|/F_exact, F the largest contact force to t_end
    error(impulse)     likewise, of the integral of |sigma|

With several contacts the largest error counts. Every scheme runs with 2^k n steps, k = 0, 1, ... A time step is sure if
it, its half and BETWEEN steps between the two all meet the requirements: errors through contact do not decrease
steadily, and a count or a peak may be right by chance. The result is the cheapest sure run in linear solves (steps
times stages), which are the cost of a step in any program. If no run is sure, the one with the smallest worst error
over the wanted one is named.

The advice ends at the horizon of the exact motion. Past it the study ``ensemble`` compares distributions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np
from cyclopts import Parameter

from ..basics.resources import clock, current
from ..basics.validation import InputError, instance, one_of, positive
from ..figures.chart import Figure, log_scale, look, shared_legend
from ..files.cases import Case
from ..march.integrate import integrate
from ..march.treatment import TREATMENTS
from ..measures.comparison import remark
from ..measures.errors import tip_error
from ..model.modes import decoupled_modes
from ..model.scales import scales
from ..model.system import System
from ..references import best_reference
from ..schemes import Scheme
from ..schemes.labels import label_of_run
from ..trajectory.trajectory import Diverged, Reference, Trajectory
from . import base
from .base import Answer, Records, Row, Study, Table, option

BETWEEN = 5  # steps that are tried between a step and its half
FARTHEST = 1e4  # errors over the wanted ones that are shown: those of runs that blow up would hide the others
PER_PERIOD = 8  # steps of the coarsest run in the shorter of the longest time scale and the drive's period
QUANTITIES: tuple[str, ...] = ("tip", "impacts", "peak_force", "impulse")
WANT = {"tip": 1e-3, "impacts": 0.05, "peak_force": 0.05}  # of rigid stops impulse in the place of peak_force
MOST_STEPS, MOST_DIRECT = 2**20, 2**14  # of a run; marched with matrices, a thousand times slower


def _want(kind: Any, tokens: Sequence[Any]) -> dict[str, float]:
    text = tokens[0].value
    try:
        pairs = [(name.strip(), float(error)) for name, error in (item.split("=") for item in text.split(","))]
    except ValueError:
        raise InputError("--want", text, "read quantity=error,...", "for example tip=1e-3,impacts=0.05") from None
    return dict(pairs)


@dataclass(frozen=True, kw_only=True)
class Advise(Study):
    """Which scheme, contact treatment and time step are the cheapest for given errors?

    Errors are those against the exact solution. The search ends after ``seconds`` of CPU with what is known by then. In
    Python ``advise.advised(records)`` is the run that is advised.

    Example: stiffbeam advise table10 --want tip=1e-3,impacts=0.05
    """

    want: Annotated[
        Mapping[str, float] | None,
        Parameter(converter=_want, n_tokens=1, accepts_keys=False, negative=(), metavar="NAME=ERROR,..."),
    ] = option(
        None,
        "admissible relative errors: tip (rms), impacts, peak_force, impulse; default: tip=1e-3,impacts=0.05,"
        "peak_force=0.05, of rigid stops impulse in the place of peak_force",
    )
    schemes: base.Labels = option(*base.SCHEME_LABELS)
    contacts: base.Labels = option(
        ("implicit", "conserving"), "treatments of contact to try, comma-separated", known=TREATMENTS
    )
    form: str | None = option(*base.FORM)
    seconds: float = option(60.0, "CPU seconds after which the search ends")

    all_cores: ClassVar = True
    any_step: ClassVar = True

    def points(self, case: Case) -> list[Row]:
        """One search."""
        positive("seconds", self.seconds)
        system = case.system(self.form)
        _wanted(system, self.want)
        if not self._candidates(case, system):
            raise InputError("schemes", self.schemes, "be at least one, with one treatment of contact", "leave it out")
        return [{}]

    def _candidates(self, case: Case, system: System) -> list[tuple[Scheme, str]]:
        contacts = (self.contacts or ())[: None if system.contacts else 1]
        schemes = base.chosen_schemes(case, self.schemes).values()
        return [(s, contact) for s in schemes for contact in contacts if TREATMENTS[contact].form_of(s)]

    def run(self, case: Case) -> list[Row]:
        """A row of kind "run" for every trial, of kind "advised" for the one that is, and remarks."""
        begun, show, t_end = clock(), current(), case.t_end
        system = case.system(self.form)
        exact = best_reference(system, t_end, progress=show, seconds=0.4 * self.seconds)
        remarks = [remark(system, exact)]
        if "budget" in exact.provenance:
            t_end = float(exact.t[-1])
            remarks.append(f"The advice is for the time that the exact motion reached, {exact.provenance['budget']}.")
        if exact.horizon < t_end:
            t_end = exact.horizon
            remarks.append(f"The advice is for the time to the horizon t = {t_end:.4g} of the exact motion.")
            exact = best_reference(system, t_end, progress=show)
        most = MOST_STEPS if decoupled_modes(system) is not None else MOST_DIRECT
        search = Search(system, t_end, exact, begun + self.seconds, _wanted(system, self.want), most)
        chosen = search.cheapest(self._candidates(case, system))
        if not search.tried:
            raise InputError("schemes", self.schemes, "take the system", "pass schemes that support its stops")
        if search.unfinished:
            remarks.append(f"Some runs would need more seconds, or more steps than {most}: they may be cheaper.")
        if chosen is not None:
            chosen["kind"] = "advised"
        rows = [*search.tried, *({"kind": "remark", "reason": text} for text in remarks if text)]
        return [row | {"t_end": t_end, "horizon": exact.horizon} for row in rows]

    def answer(self, table: Table, case: Case) -> Answer:
        """The run that is advised with its errors, or the run that is nearest to what is wanted."""
        wanted, run = _wanted(case.system(self.form), self.want), advised_row(table)
        notes = [str(x) for x in table[table.kind == "remark"].reason] if "reason" in table else []
        verdict = ""
        if run is None:
            runs = table[table.kind == "run"]
            run = next(runs.loc[[runs.worst.idxmin()]].itertuples())
            verdict = f"No run of up to {runs.steps.max():g} steps is sure to meet the admissible errors; nearest: "
            notes.append("Ask for larger errors or a shorter t_end, or compare distributions by the study ensemble.")
        errors = ", ".join(f"{name} {getattr(run, f'error_{name}'):.2g} (wanted {wanted[name]:g})" for name in wanted)
        verdict += f"{_label(run)}, dt = {run.dt:.10g}: {run.steps:g} steps to t = {run.t_end:g}, {run.work:g} "
        notes.insert(0, f"A run is sure if dt/2 and {BETWEEN} steps between dt and dt/2 meet the errors too.")
        verdict += f"linear solves, relative errors against the exact solution {errors}."
        return Answer(verdict, notes=" ".join(notes))

    def draw(self, table: Table, figure: Figure, case: Case) -> None:
        """The worst error over the wanted one of every run against its cost; the run that is advised is black."""
        axis, runs = figure.subplots(), table[table.kind != "remark"].sort_values("work")
        for (scheme, contact), group in runs.groupby(["scheme", "contact"], sort=False):
            style: Any = look(str(scheme)) | {"ms": 4, "lw": 1.0, "alpha": 1.0 if contact == "implicit" else 0.5}
            axis.plot(group.work, group.worst, label=_label(group.iloc[0]), **style)
        best = runs[runs.kind == "advised"]
        axis.plot(best.work, best.worst, "o", ms=10, mfc="none", color="black", label="advised" if len(best) else None)
        axis.axhline(1.0, color="0.4", lw=0.9, ls="--")
        axis.set(xlabel="linear solves", ylabel="worst error / admissible error")
        log_scale(axis)
        axis.set_ylim(top=min(axis.get_ylim()[1], FARTHEST))
        shared_legend(figure)


def advised_row(table: Table) -> Any:
    """The row of the run that is advised, None where there is none."""
    return next(table[table.kind == "advised"].itertuples(), None)


def advised(records: Records) -> Trajectory:
    """The run that is advised. Raises InputError where there is none."""
    row, case = advised_row(records.table), records.case
    if row is None:
        raise InputError("records", records.answer.verdict, "advise a run", "ask for larger errors")
    study: Any = records.study
    scheme = base.chosen_schemes(case, study.schemes)[row.scheme]
    return integrate(case.system(study.form), scheme, row.dt, row.t_end, row.contact)


def _label(row: Any) -> str:
    """The scheme, and the contact treatment where it is not the implicit one."""
    return f"{row.scheme}" + (f", {row.contact} contact" if row.contact != "implicit" else "")


def _wanted(system: System, want: Mapping[str, float] | None) -> dict[str, float]:
    """The admissible errors, after their checks."""
    # A blow on a rigid stop has an impulse and no force.
    known = [x for x in QUANTITIES if not (system.rigid and x == "peak_force")] if system.contacts else ["tip"]
    default = {x: WANT.get(x, WANT["peak_force"]) for x in known if x in WANT or system.rigid}
    wanted = instance("want", default if want is None else want, Mapping, 'for example {"tip": 0.01}')
    if not wanted:
        raise InputError("want", want, "name at least one quantity", f"known: {', '.join(known)}")
    for name in wanted:
        one_of("want", name, known, "name a known quantity; all but tip need a system with contacts")
    return {name: positive(f"want.{name}", error) for name, error in wanted.items()}


@dataclass(eq=False)
class Search:
    """Trial runs of all candidates, of ``most`` steps each, until ``until``, a time of ``clock``. tried: a row for each
    run, whose work is in linear solves, with infinite errors if it broke off."""

    system: System
    t_end: float
    exact: Reference
    until: float
    want: Mapping[str, float]
    most: int
    tried: list[Row] = field(default_factory=list)
    unfinished: bool = False  # at ``most`` steps, or after its seconds

    def probe(self, scheme: Scheme, contact: str, steps: int) -> Row | None:
        """The run with this number of steps; None if the scheme refuses the system."""
        dt = self.t_end / steps
        try:
            errors = errors_of(integrate(self.system, scheme, dt, self.t_end, contact), self.exact)
        except (Diverged, InputError) as error:
            if isinstance(error, InputError) and error.field != "dt":  # else a step at which it is refused
                return None
            errors = dict.fromkeys(QUANTITIES, np.inf)
        row: Row = {"kind": "run", "scheme": label_of_run(scheme), "contact": contact, "dt": dt, "steps": steps,
                    "work": steps * len(scheme.nodes),
                    "worst": max(errors[name] / wanted for name, wanted in self.want.items())}  # fmt: skip
        self.tried.append(row | {f"error_{name}": x for name, x in errors.items()})
        return self.tried[-1]

    def meets(self, run: Row | None) -> bool:
        """Return True where every error is at most the one wanted, and for a refused run."""
        return run is None or run["worst"] <= 1.0

    def cheapest(self, candidates: list[tuple[Scheme, str]]) -> Row | None:
        """The cheapest run that meets the want, None where there is none.

        Each candidate, in its share of the time, is refined from PER_PERIOD steps a period to ``most`` until two runs
        in a row meet the want and so do those between them, or until it costs more than the best that does.
        """
        show, begun, best = current(), clock(), None
        drives = self.system.drive.frequencies
        period = min(scales(self.system, self.t_end).period, *(2.0 * np.pi / rate for rate in drives), self.t_end)
        coarsest = min(self.most, max(4, int(np.ceil(PER_PERIOD * self.t_end / period * (1 - 1e-12)))))
        for done, (scheme, contact) in enumerate(candidates, 1):
            show(f"advise: {label_of_run(scheme)}, {contact}", done - 1, len(candidates))
            until = begun + (self.until - begun) * done / len(candidates)
            good, steps = None, coarsest
            # What costs more than the best run that meets the requirements cannot be chosen.
            while best is None or (good["work"] if good else steps * len(scheme.nodes)) < best["work"]:
                if steps > self.most or (clock() > until and self.tried):
                    self.unfinished = True
                    break
                run = self.probe(scheme, contact, steps)
                if run is None:
                    break  # what this scheme or these stops do not take
                if good and self.meets(run):
                    # Runs between two that meet the requirements may show that this was chance.
                    between = (round(good["steps"] * 2.0 ** (k / (BETWEEN + 1))) for k in range(1, BETWEEN + 1))
                    if all(self.meets(self.probe(scheme, contact, n)) for n in between):
                        best = good
                        break
                good, steps = run if self.meets(run) else None, 2 * steps
        return best


def errors_of(run: Trajectory, exact: Reference) -> dict[str, float]:
    """Errors of tip (rms), impact count, peak force and impulse, the worst over the contacts."""
    pairs = list(zip(run.contacts, exact.contacts, strict=True))
    counts = (abs(a.impacts.count - b.impacts.count) / max(b.impacts.count, 1) for a, b in pairs)
    errors = {"tip": tip_error(run.tip, exact.at(run.t)[0])[0], "impacts": max(counts, default=0.0)}
    for name in ("peak_force", "impulse"):
        errors[name] = max((_relative(getattr(a, name), getattr(b, name)) for a, b in pairs), default=0.0)
    return errors


def _relative(value: float, exact: float) -> float:
    """|value - exact| over the exact value; where that is 0, infinite unless the value is 0 too."""
    return abs(value / exact - 1.0) if exact else np.inf if value else 0.0
