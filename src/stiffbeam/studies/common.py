"""What several studies need: schemes by label, a reference solved once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from ..basics.arrays import Array
from ..basics.validation import InputError, sequence
from ..figures import Curve, short
from ..files.cases import Case
from ..measures.errors import Order
from ..measures.impacts import first_impacts_end
from ..model.modes import modes
from ..model.system import System
from ..references import best_reference
from ..references import takes as method_takes
from ..schemes import RIGID, SCHEMES, RigidScheme, Scheme, make, takes_stops
from ..schemes.labels import parse_run, user_label
from ..trajectory.trajectory import Reference
from .engine.study import Study

# What the options of several studies are and mean; the commands read it here.
Schemes = Annotated[list[str] | None, "with commas between them, e.g. 'BDF2,HHT(alpha=-0.2)'; default: all"]
Form = Annotated[str, "displacement, velocity-curvature or hermite; default: the case's first"]
Forms = Annotated[list[str] | None, "with commas between them; default: all the case can take"]
Dt = Annotated[float, "time step to start from, instead of the case's"]
End = Annotated[float, "end time instead of the case's"]
Halvings = Annotated[int, "how many steps dt, dt/2, dt/4, ..."]
ImpactCount = Annotated[int, "the window ends when so many impacts are over"]
Members = Annotated[int, "perturbed runs of each method"]
Numbers = Annotated[list[float] | None, "with commas between them"]
Cells = Annotated[list[int] | None, "grids, with commas between them"]
Treatment = Annotated[str, "implicit, conserving, or extrapolated as in the paper"]

_REFERENCES: dict[tuple[str, float], Reference] = {}
_KEPT = 4


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
    own: dict[str, Scheme] = {}
    for scheme, _ in case.runs:
        own.setdefault(scheme.name, scheme)
    others = {name: make(name) for name in (*SCHEMES, *RIGID) if name != "theta" and name not in own}
    taken = {name: scheme for name, scheme in others.items() if takes(case, scheme)}
    known = own | taken
    return [label_of(known[name]) for name in dict.fromkeys((*SCHEMES, *RIGID, *own)) if name in known]


def takes(case: Case, scheme: Scheme) -> bool:
    """Return True where ``scheme`` has a law for the stops of the case and takes its damping."""
    system = case.system(case.forms[0])
    modal = isinstance(scheme, RigidScheme) and scheme.modal_only
    return takes_stops(scheme, (c.stops for c in system.contacts)) and not (modal and modes(system) is None)


def takes_extrapolation(case: Case) -> bool:
    """Return True where the stops' force is one of the position alone, which the paper's extrapolated contact needs."""
    return not any(c.stops.rigid or c.stops.dissipative for c in case.system(case.forms[0]).contacts)


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
    """The label that makes the scheme again: studies travel to other processes as text.

    A scheme of one's own goes by ``module:Class``. Raises InputError where no label can make it again.
    """
    if isinstance(scheme, str):
        return label_of(scheme_of(scheme))
    label = str(scheme)
    try:
        made = scheme_of(label)
    except InputError:
        made = None
    return label if type(made) is type(scheme) else user_label(scheme)


def scheme_of(label: str) -> Scheme:
    """The scheme with this label."""
    return parse_run(label)[0]


def system_of(case: Case, form: str) -> System:
    """The system of ``case`` in ``form``, made once per process."""
    return case.system(form)


def extremes(values: Mapping[str, float], written: Callable[[float], str]) -> str:
    """The least and the largest of the numbers that are known, each with the short name of its method."""
    known = sorted((value, short(name)) for name, value in values.items() if np.isfinite(value))
    if not known:
        return "not known"
    (low, first), (high, last) = known[0], known[-1]
    if written(low) == written(high):
        return f"{written(low)} ({first if len(known) == 1 else 'all'})"
    return f"{written(low)} ({first}) to {written(high)} ({last})"


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
    """Every how many steps to keep, for ``outputs`` or up to twice as many: of these with the last step among them,
    where the number of steps has such a divisor."""
    most = max(1, steps // outputs)
    return next((every for every in range(most, most // 2, -1) if steps % every == 0), most)


def solve_once(system: System, t_end: float) -> Reference:
    """``best_reference``, remembered for the next points of the same process."""
    key = (system.fingerprint, t_end)
    if key not in _REFERENCES:
        while len(_REFERENCES) >= _KEPT:
            del _REFERENCES[next(iter(_REFERENCES))]
        _REFERENCES[key] = best_reference(system, t_end)
    return _REFERENCES[key]


def first_impacts(case: Case, form: str, impacts: int) -> float:
    """The end of the case's first impacts, ``impacts`` of them, see ``first_impacts_end``."""
    return first_impacts_end(solve_once(system_of(case, form), case.t_end), impacts)
