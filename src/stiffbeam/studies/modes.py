"""Phase lag and dissipation mode by mode, measured on runs without contact and held against theory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cases import Case
from ..march.integrate import integrate
from ..measures.amplification import amplification
from ..measures.free_modes import free_mode_errors
from ..modal import modes
from ..validation import InputError
from .common import scheme_labels, scheme_of, system_of, without_contact
from .study import Point, Row, Rows, Study


def points(
    case: Case, schemes: list[str] | None = None, form: str = "displacement", dt: float | None = None, steps: int = 4000
) -> list[Point]:
    """One point a scheme: ``steps`` steps of ``dt`` (the case's) from initial data that ring every mode."""
    dt = case.dt if dt is None else dt
    return [{"scheme": label, "form": form, "dt": dt, "steps": steps} for label in scheme_labels(case, schemes)]


def evaluate(case: Case, point: Point) -> list[Row]:
    system = replace(without_contact(system_of(case, point["form"])), loads=())
    basis = modes(system)
    if basis is None:
        raise InputError("damping", "a matrix that couples the modes", "decouple for a study of modes")
    dt, scheme = point["dt"], scheme_of(point["scheme"])
    # Every mode starts with the same energy.
    amplitudes = np.where(basis.omega > 0.0, 1.0, 0.0) / np.where(basis.omega > 0.0, basis.omega, 1.0)
    system = replace(system, q0=basis.to_nodal(amplitudes), v0=np.zeros(system.size))
    found = free_mode_errors(integrate(system, scheme, dt, point["steps"] * dt))
    rows = []
    for j, omega in enumerate(basis.omega):
        if omega == 0.0:
            continue
        xi = float(0.5 * basis.damping[j] / omega)
        theory = amplification(scheme, omega * dt / (2.0 * np.pi), xi)
        rows.append(
            {
                "mode": j + 1,
                "omega": float(omega),
                "dt_over_period": float(omega * dt / (2.0 * np.pi)),
                "period_elongation": float(found.period_elongation[j]),
                "period_elongation_error": float(found.elongation_error[j]),
                "period_elongation_theory": float(theory.period_elongation[0]),
                "damping_ratio": float(found.damping_ratio[j]),
                "damping_ratio_error": float(found.damping_error[j]),
                "damping_ratio_theory": float(theory.damping_ratio[0]),
            }
        )
    return rows


def answer(rows: Rows) -> str:
    measured = [r for r in rows if np.isfinite(r["period_elongation"])]
    inside = [
        abs(r[name] - r[f"{name}_theory"]) <= r[f"{name}_error"] + 1e-10
        for r in measured
        for name in ("period_elongation", "damping_ratio")
    ]
    parts = []
    for scheme in dict.fromkeys(r["scheme"] for r in measured):
        own = [r for r in measured if r["scheme"] == scheme]
        late, damped = 100 * own[0]["period_elongation"], own[0]["damping_ratio"]
        parts.append(f"{scheme} {late:.2g} % late and damped by {damped:.1e} in mode 1")
    return (
        f"{sum(inside)} of {len(inside)} measured elongations and damping ratios lie within the fit's error of theory; "
        + "; ".join(parts)
        + "."
    )


STUDY = Study(
    name="modes",
    question="How late and how damped does each scheme make each mode of a beam without contact, and is that theory?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"schemes": ["bdf2", "hht(alpha=-0.1)"], "steps": 400},
)
