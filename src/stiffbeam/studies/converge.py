"""Convergence in time: at which rate each scheme approaches the exact solution, smooth and through contact.

A point enters the slope only where it means something: the motion is resolved, the error is above
rounding, and (in contact) every impact inside the window still has its partner.
"""

from __future__ import annotations

import numpy as np

from ..cases import Case
from ..drive import Drive
from ..march.integrate import integrate
from ..measures.impacts import match
from ..measures.regression import Order, observed_order
from ..modal import modes
from ..validation import InputError, integer
from .common import first_impacts, scheme_labels, scheme_of, smooth, solve_once, system_of
from .study import Point, Row, Rows, Study

KINDS = ("smooth", "contact")
PER_OCTAVE = 4  # steps per halving through contact, where the error jumps about: the worst of an octave counts
SAMPLES = 1000  # outputs on which the error is measured
RESOLVED = 0.5  # largest (omega dt)
ASYMPTOTIC = 0.1  # largest relative error
ROUNDING = 10.0 * np.finfo(float).eps  # times the number of steps: what rounding may have added


def points(
    case: Case,
    schemes: list[str] | None = None,
    kinds: list[str] | None = None,
    form: str = "displacement",
    dt: float | None = None,
    halvings: int = 10,
    impacts: int = 4,
    contact: str = "implicit",
) -> list[Point]:
    """Steps from ``dt`` (the case's) downwards, ``halvings`` times.

    smooth: the case without stops on its slow motion, over one period of the drive or of the lowest
    mode, whichever is longer. contact: the case itself until its first ``impacts`` impacts are over.
    """
    integer("halvings", halvings, 1)
    start = case.dt if dt is None else dt
    system = system_of(case, form)
    found: list[Point] = []
    for kind in KINDS if kinds is None else kinds:
        if kind == "smooth":
            end, per_octave = _period(case, form), 1
        elif kind == "contact":
            if not system.contacts:
                continue
            end, per_octave = first_impacts(case, form, impacts), PER_OCTAVE
        else:
            raise InputError("kinds", kind, f"be among {KINDS}")
        for label in scheme_labels(case, schemes):
            for k in range(halvings * per_octave):
                steps = max(4, round(end / start * 2.0 ** (k / per_octave)))
                octave = k // per_octave
                found.append({"kind": kind, "scheme": label, "form": form, "contact": contact, "t_end": end,
                              "steps": steps, "octave": octave})  # fmt: skip
    return list({tuple(p.items()): p for p in found}.values())


def _period(case: Case, form: str) -> float:
    basis = modes(system_of(case, form))
    if basis is None:
        raise InputError("damping", "a matrix that couples the modes", "decouple for the smooth motion")
    slowest = [float(w) for w in basis.omega[basis.omega > 0.0][:1]] + list(Drive.of(system_of(case, form)).frequencies)
    return 2.0 * np.pi / min(slowest)


def evaluate(case: Case, point: Point) -> list[Row]:
    system = system_of(case, point["form"])
    if point["kind"] == "smooth":
        system = smooth(system)
    steps, t_end = point["steps"], point["t_end"]
    exact = solve_once(system, t_end)
    dt = t_end / steps
    run = integrate(system, scheme_of(point["scheme"]), dt, t_end, point["contact"], every=max(1, steps // SAMPLES))
    u, _ = exact.at(run.t)
    scale = float(np.max(np.abs(u)))
    error = np.abs(run.tip - u) / scale
    rms = float(np.sqrt(np.mean(error**2)))
    basis = modes(system)
    fastest = max([*Drive.of(system).frequencies, float(basis.omega[basis.omega > 0.0][0]) if basis else 0.0])
    left_out = ""
    if point["kind"] == "contact" and match(run.impacts, exact.impacts, t_end).matched_until < t_end:
        left_out = "impacts part"
    if rms > ASYMPTOTIC:
        left_out = left_out or "error above 10 %"
    elif fastest * dt > RESOLVED:
        left_out = "motion not resolved"
    elif rms < ROUNDING * steps:
        left_out = "rounding"
    elif t_end > exact.horizon:
        left_out = "past the horizon"
    return [{"dt": dt, "error_rms": rms, "error_max": float(np.max(error)), "left_out": left_out}]


def envelope(rows: Rows) -> tuple[list[float], list[float]]:
    """(dt, error) of the worst point of every octave whose points all count."""
    steps, errors = [], []
    for octave in sorted({r["octave"] for r in rows}):
        own = [r for r in rows if r["octave"] == octave]
        if all(not r["left_out"] for r in own):
            steps.append(max(r["dt"] for r in own))
            errors.append(max(r["error_rms"] for r in own))
    return steps, errors


def orders(rows: Rows) -> dict[tuple[str, str], Order]:
    """The observed order by (kind, scheme)."""
    keys = dict.fromkeys((r["kind"], r["scheme"]) for r in rows)
    return {key: observed_order(*envelope([r for r in rows if (r["kind"], r["scheme"]) == key])) for key in keys}


def answer(rows: Rows) -> str:
    parts = {
        "smooth": "Observed orders without contact: ",
        "contact": "Through the first impacts (worst of each octave): ",
    }
    found = orders(rows)
    sentences = []
    for kind, head in parts.items():
        own = [f"{scheme} {order}" for (k, scheme), order in found.items() if k == kind and np.isfinite(order.slope)]
        few = [scheme for (k, scheme), order in found.items() if k == kind and not np.isfinite(order.slope)]
        missing = [f"too few points count for {', '.join(few)}"] if few else []
        if own or few:
            sentences.append(head + "; ".join([", ".join(own)] * bool(own) + missing) + ".")
    return " ".join(sentences)


STUDY = Study(
    name="converge",
    question="At which rate does each scheme approach the exact solution, smooth and through contact?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"schemes": ["bdf2", "sdirk(gamma=0.4359, nystrom=true)"], "halvings": 4, "impacts": 2},
)
