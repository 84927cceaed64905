"""One step on a free oscillation: spectral radius, period elongation, damping, for every scheme and parameter."""

from __future__ import annotations

import numpy as np

from ..cases import Case
from ..measures.amplification import amplification
from ..schemes import HHT, SDIRK, GeneralisedAlpha, registered
from ..schemes.sdirk import GAMMA_MIN
from ..validation import InputError
from .common import scheme_labels, scheme_of
from .study import Point, Row, Rows, Study

TENTH = 0.1  # of a period: where the literature compares


def families() -> list[str]:
    """HHT over alpha, SDIRK-OS over gamma (its poles left out), generalised-alpha over rho."""
    gammas = [g for g in np.round(np.arange(0.19, 1.01, 0.03), 2) if g > GAMMA_MIN and not 0.24 < g < 0.31]
    schemes = [
        *(HHT(round(a, 4)) for a in np.linspace(-0.33, 0.0, 12)),
        *(SDIRK(float(g)) for g in gammas),
        *(GeneralisedAlpha(round(r, 2)) for r in np.linspace(0.0, 1.0, 11)),
    ]
    return [str(scheme) for scheme in schemes]


def points(case: Case, schemes: list[str] | None = None, damping: float = 0.0, per_decade: int = 40) -> list[Point]:
    """One point a scheme, at dt/T from 1e-3 to 1e3 and at 0.1; by default every registered scheme and the families."""
    labels = families() + [str(s) for s in registered()] if schemes is None else scheme_labels(case, schemes)
    return [{"scheme": label, "damping": damping, "per_decade": per_decade} for label in dict.fromkeys(labels)]


def evaluate(case: Case, point: Point) -> list[Row]:
    scheme, xi = scheme_of(point["scheme"]), point["damping"]
    x = np.union1d(np.logspace(-3, 3, 6 * point["per_decade"] + 1), [TENTH])
    found = amplification(scheme, x, xi)
    try:
        theory = amplification(scheme, x, xi, source="closed form")
    except InputError:
        theory = None  # the scheme states no polynomial
    rows = []
    for i, value in enumerate(x):
        row = {"name": scheme.name, **scheme.parameters, "dt_over_period": float(value), "stable_to": found.stable_to}
        for name in ("spectral_radius", "period_elongation", "damping_ratio"):
            row[name] = float(getattr(found, name)[i])
            row[f"{name}_theory"] = float(getattr(theory, name)[i]) if theory else float("nan")
        rows.append(row)
    return rows


def answer(rows: Rows) -> str:
    at = [r for r in rows if r["dt_over_period"] == TENTH]
    base = [r for r in at if r["scheme"] in {str(s) for s in registered()}] or at
    parts = [
        f"{r['scheme']} {100 * r['period_elongation']:.3g} % and {r['damping_ratio']:.2g}"
        for r in sorted(base, key=lambda r: abs(r["period_elongation"]))
    ]
    unstable = sorted({r["scheme"] for r in rows if r["stable_to"] is not None and np.isfinite(r["stable_to"])})
    gap = max(
        (abs(r["spectral_radius"] - r["spectral_radius_theory"]) for r in rows if _known(r["spectral_radius_theory"])),
        default=float("nan"),
    )
    stable = f"unstable somewhere: {', '.join(unstable)}" if unstable else "all are stable at every step"
    return (
        "Period elongation and damping ratio at dt/T = 0.1: "
        + "; ".join(parts)
        + f". Of these and their families {stable}; "
        f"the kernel's spectral radius and the closed form differ by at most {gap:.1e}."
    )


def _known(value: float | None) -> bool:
    return value is not None and np.isfinite(value)


STUDY = Study(
    name="amplification",
    question="What does one step of each scheme make of a free oscillation: how late, how much weaker, how stable?",
    points=points,
    evaluate=evaluate,
    answer=answer,
    smoke={"schemes": ["bdf2", "hht(alpha=-0.1)", "sdirk(gamma=0.4359)"], "per_decade": 10},
)
