"""Options and helpers of several studies: schemes by label, references solved once, orders, axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from ..basics.arrays import Array, Recent
from ..basics.validation import InputError, sequence
from ..figures.chart import Axis, Curve, short
from ..files.cases import Case
from ..march.ensemble import integrate_ensemble
from ..measures.errors import Order, first_impacts_end, observed_order
from ..model.beam import natural_frequencies
from ..model.contact import Stops
from ..model.members import EnsembleMembers
from ..model.modes import modes
from ..model.system import System
from ..references import best_reference
from ..references import takes as method_takes
from ..references.ensemble import reference_ensemble
from ..references.registry import REFERENCES
from ..schemes import RIGID, SCHEMES, RigidScheme, Scheme, takes_stops
from ..schemes.labels import make, parse_run, user_label
from ..schemes.labels import scheme_of as known_scheme
from ..testset.integrators import FUNCTION, SCHEME, Integrator, integrator, integrators
from ..trajectory.ensemble import Ensemble
from ..trajectory.trajectory import Diverged, Reference, Trajectory, Work
from .interface import Rows, Study

# What the options of several studies are and mean; the commands read it here.
Schemes = Annotated[list[str] | None, "comma-separated, e.g. 'BDF2,HHT(alpha=-0.2)'; default: all"]
Integrators = Annotated[
    list[str] | None, "comma-separated schemes, reference solvers and functions module:function; default: all schemes"
]
Form = Annotated[str, "displacement, velocity-curvature or hermite; default: the case's first"]
Forms = Annotated[list[str] | None, "comma-separated; default: all that the case supports"]
Dt = Annotated[float, "time step instead of the case's, the largest if there are several"]
End = Annotated[float, "end time instead of the case's"]
Halvings = Annotated[int, "number of time steps dt, dt/2, dt/4, ..."]
ImpactCount = Annotated[int, "number of impacts in the time window"]
Members = Annotated[int, "perturbed runs of each method"]
Cells = Annotated[list[int] | None, "numbers of cells, comma-separated"]
Treatment = Annotated[str, "implicit, conserving, or extrapolated as in the paper"]

STEP = Axis(r"time step $\Delta t$", "time", "log")  # the horizontal axis of what is measured over dt
_SOLVED = Recent[Reference](4)


def scheme_labels(case: Case, schemes: Sequence[str | Scheme] | None = None) -> list[str]:
    """The given labels and schemes as labels in one spelling, or the case's own schemes and every other registered one
    that has a law for its stops and takes its damping.

    A scheme that the case runs on several forms counts once; ``theta`` with its default is the trapezoidal rule, which
    stands under that name.
    """
    if schemes is not None:
        schemes = sequence("schemes", schemes, "be schemes or their labels", "for example ['HHT(alpha=-0.1)']")
        for label in schemes:
            if not isinstance(label, (str, Scheme)):
                raise InputError("schemes", label, "be schemes or their labels", "for example 'HHT(alpha=-0.1)'")
        return [label_of(label) for label in schemes]
    stated: dict[str, Scheme] = {}
    for scheme, _ in case.runs:
        stated.setdefault(scheme.name, scheme)
    rigid = RIGID if case.system().rigid else {}
    others = {name: make(name) for name in (*SCHEMES, *rigid) if name != "theta" and name not in stated}
    chosen = stated | {name: scheme for name, scheme in others.items() if takes(case, scheme)}
    return [label_of(chosen[name]) for name in dict.fromkeys((*SCHEMES, *RIGID, *stated)) if name in chosen]


def integrators_of(case: Case, given: Sequence[Any] | None = None) -> list[Integrator]:
    """Return the integrators of a study: the given ones, or the schemes of ``scheme_labels``.

    Each but recorded runs can be made again by its label, since points travel to other processes as text.
    Raises InputError for one that cannot.
    """
    if given is None:
        return [integrator(label) for label in scheme_labels(case)]
    chosen: dict[str, Integrator] = {}
    for one in integrators(sequence("schemes", given, "be integrators", "for example ['HHT(alpha=-0.1)']")):
        label = label_of(one.source) if one.kind == SCHEME else one.label
        if one.kind == FUNCTION:
            label = label.partition(" (")[0]
            if ":" not in label or integrator(label).source is not one.source:
                remedy = "move it to the top of a module, a script or a notebook"
                raise InputError("schemes", one.label, "be found under its name, for a study", remedy)
        chosen[label] = replace(one, label=label)
    return list(chosen.values())


def recorded_points(one: Integrator, system: System) -> list[dict[str, Any]]:
    """Return the entries that hold each recorded run, the longest step first: ``dt`` and a list, which rows leave out.

    Raises InputError for a run of another system.
    """
    points = []
    for run in sorted(one.source, key=lambda run: -float(run.provenance["dt"])):
        if run.fingerprint not in ("", system.fingerprint):
            rule = f"be recorded on the system of the case, form {system.form}"
            raise InputError("schemes", one.label, rule, "pass system=case.system(form) to from_arrays")
        cost = [run.work.seconds, max(run.work.counters.values(), default=run.work.steps)]
        lists = [run.t.tolist(), run.tip.tolist(), run.tip_velocity.tolist(), cost]
        points.append({"dt": float(run.provenance["dt"]), "recorded": lists})
    return points


def run_of(
    label: str, recorded: list[Any] | None, system: System, dt: float, t_end: float, contact: str = "implicit",
    every: int = 1,
) -> Trajectory:  # fmt: skip
    """Return the run of an integrator by its label, or the part of a recorded one to t_end.

    Raises InputError for a recorded run that ends earlier.
    """
    if recorded is None:
        return integrator(label).run(system, dt, t_end, contact, every)
    t, tip, velocity = (np.asarray(values) for values in recorded[:3])
    if t[-1] < t_end * (1.0 - 1e-9):
        raise InputError("the recorded run", t[-1], f"reach t = {t_end:g}", "record it further, or ask for less")
    inside = t <= t_end * (1.0 + 1e-9)
    run = Trajectory.from_arrays(t[inside], tip[inside], velocity[inside], system, name=label)
    # The cost of a part is its share of the time.
    share = t_end / float(t[-1])
    seconds, evaluations = share * recorded[3][0], round(share * recorded[3][1])
    return replace(run, work=Work(len(run.t) - 1, seconds, seconds, {"evaluations": evaluations}))


def evaluations_of(label: str, run: Trajectory) -> int:
    """Return the work of a run: linear solves of a scheme, what a solver or a run counts, else steps."""
    scheme = None if label in REFERENCES else known_scheme(label)
    if scheme is not None:
        return run.work.steps * len(scheme.nodes)
    return max(run.work.counters.values(), default=run.work.steps)


def takes(case: Case, scheme: Scheme) -> bool:
    """Return True if ``scheme`` supports the stops of the case and its damping."""
    system = case.system()
    modal = isinstance(scheme, RigidScheme) and scheme.modal_only
    return takes_stops(scheme, (c.stops for c in system.contacts)) and not (modal and modes(system) is None)


def takes_extrapolation(case: Case) -> bool:
    """Return True if the force of the stops depends on the position alone, as the paper's extrapolated contact
    requires."""
    return not any(c.stops.rigid or c.stops.dissipative for c in case.system().contacts)


def tip_stops(case: Case) -> Stops:
    """Return the stops of a beam that has its only ones at the tip, at rest. Raises InputError for any other case."""
    if case.beam is None or len(case.problem.all_stops) != 1:
        raise InputError("case", case.name, "be a beam with stops at one place", "for example table10")
    stops = case.problem.all_stops[0]
    if stops.motion is not None or stops.position not in (None, case.problem.length):
        remedy = "move them to the tip and leave their motion out"
        raise InputError("case", case.name, "have stops at rest at the tip", remedy)
    natural_frequencies(case.problem, 1)
    return stops


def smoke_options(study: Study, case: Case) -> dict[str, Any]:
    """The study's options for a run of seconds on ``case``: a system of matrices keeps its own time span, and in place
    of schemes without a law for its stops runs the first of its own, and leaves out solvers that do not take it."""
    options = dict(study.smoke)
    if case.beam is None:
        options.pop("t_end", None)
    meets_stops = study.needs_motion or study.name == "converge"
    if meets_stops and not all(takes(case, scheme_of(label)) for label in options.get("schemes", ())):
        options["schemes"] = [str(case.runs[0][0])]
    if "methods" in options:
        options["methods"] = [x for x in options["methods"] if method_takes(x, case.system(), case.t_end)]
    return options


def label_of(scheme: str | Scheme) -> str:
    """The label that defines the scheme, for other processes.

    A user's scheme is named ``module:Class``. Raises InputError if no label can define it.
    """
    if isinstance(scheme, str):
        return label_of(scheme_of(scheme))
    label = str(scheme)
    try:
        made = scheme_of(label)
    except InputError:
        made = None
    # A label that makes another class does not define the scheme.
    return label if type(made) is type(scheme) else user_label(scheme)


def scheme_of(label: str) -> Scheme:
    """The scheme with this label."""
    return parse_run(label)[0]


def significant(value: float, form: str, least: float = 1e-12) -> str:
    """A number as text, "0" where its size is below ``least``: rounding."""
    return "0" if abs(value) < least else f"{value:{form}}"


def extremes(values: Mapping[str, float], written: Callable[[float], str]) -> str:
    """The least and the largest of the numbers that are known, each with the short name of its method."""
    known = sorted((value, short(name)) for name, value in values.items() if np.isfinite(value))
    if not known:
        return "not known"
    (low, first), (high, last) = known[0], known[-1]
    if written(low) == written(high):
        return f"{written(low)} ({first if len(known) == 1 else 'all'})"
    return f"{written(low)} ({first}) to {written(high)} ({last})"


def order_over(rows: Rows, step: Callable[[Any], float], error: str) -> Order:
    """The observed order of column ``error`` in a step that is taken from each row, of errors above 0."""
    kept = [row for row in rows if row[error] > 0.0]
    return observed_order([step(row) for row in kept], [row[error] for row in kept])


def fit(x: Array, order: Order, look: Mapping[str, Any]) -> list[Curve]:
    """The line of an observed order over the range of ``x``; none where there is no order."""
    if not np.isfinite(order.slope) or not len(x):
        return []
    ends = np.array([np.min(x), np.max(x)])
    return [Curve(ends, order.constant * ends**order.slope, look={**look, "marker": "", "lw": 1.4})]


def halved(end: float, dt: float, halvings: int, per_octave: int = 1) -> list[int]:
    """Number of steps in [0, end] at dt, dt/2, dt/4, ..."""
    return [max(4, round(end / dt * 2.0 ** (k / per_octave))) for k in range(halvings * per_octave)]


def to_the_end(steps: int, outputs: int) -> int:
    """Return the spacing of the steps that are kept, for ``outputs`` to twice as many of them.

    The last step is among them where the number of steps has such a divisor.
    """
    most = max(1, steps // outputs)
    return next((every for every in range(most, most // 2, -1) if steps % every == 0), most)


def run_members(
    method: str | Scheme,
    members: EnsembleMembers,
    dt: float,
    t_end: float,
    contact: str = "implicit",
    every: int | None = None,
) -> Ensemble:
    """The ensemble of a scheme or its label, or of the exact solution. Raises Diverged where a member overflows."""
    if method == "exact":
        return reference_ensemble(members.system, t_end, members)
    scheme = scheme_of(method) if isinstance(method, str) else method
    many = integrate_ensemble(members.system, scheme, dt, t_end, members, contact, every)
    if np.any(np.isfinite(many.diverged)):
        remedy = "use a smaller dt" if contact == "implicit" else "use the implicit contact or a smaller dt"
        raise Diverged(str(method), float(np.nanmin(many.diverged)), remedy)
    return many


def solve_once(system: System, t_end: float) -> Reference:
    """``best_reference``, remembered for the next points of the same process."""
    return _SOLVED.get((system.fingerprint, t_end), lambda: best_reference(system, t_end))


def first_impacts(case: Case, form: str, impacts: int) -> float:
    """The end of the case's first impacts, ``impacts`` of them, see ``first_impacts_end``."""
    return first_impacts_end(solve_once(case.system(form), case.t_end), impacts)
