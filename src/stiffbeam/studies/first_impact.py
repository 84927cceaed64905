"""The first impact on finer and finer grids: the contact of one point, and the speed at which it meets its stop.

A free end with speed V has the impedance Z(s) = A sqrt(s), A = (EI m^3)^(1/4)/sqrt(2), of a beam so long that no wave
returns. On compliance kappa the penetration and the force are

    d = V t E(3/2, 2; -(t/tau)^(3/2)),   tau = (A/kappa)^(2/3),   F_max = 0.858 V (A^2 kappa)^(1/3) at 1.65 tau

E the Mittag-Leffler function. The force comes from waves of length l = (EI/kappa)^(1/3): cells of h << l are needed. A
rigid stop, kappa = inf, has F = A V/sqrt(pi t), without bound: no peak to converge to, but an impulse.

The speed V has its own mesh error. A base that starts with a jump of its velocity excites mode n like 1/n. The tip's
speed is then a sum of terms 4/(beta_n) cos(omega_n t). A grid lacks those beyond the beta* whose frequency error has
reached a radian by then, k beta*^2 t (beta* h)^p = 1. The missing part has the size beta*^(-1/2), h^(1/4) for p = 2 and
h^(1/3) for p = 4, and either sign. A beam that starts with the speed of its base has no such jump.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import rgamma

from ..basics.arrays import Array
from ..basics.validation import InputError, one_of
from ..figures.chart import Axis, Curve, Level, Mark, Panel, Picture, column, dashed, groups, numeric, style_of
from ..files.cases import Case
from ..measures.errors import Order, observed_order
from ..measures.frequencies import without_contact
from ..measures.report import percent
from ..model.beam import natural_frequencies, roots
from ..model.contact import Stops
from ..model.problem import BeamProblem
from ..model.semidiscretisation import semidiscretise
from ..model.system import System
from ..model.time_functions import Harmonic
from ..references import solve
from ..trajectory.trajectory import Reference
from .common import Cells, tip_stops
from .interface import Answer, Point, Records, Row, Rows, declared

OWN, SMOOTH = "at rest", "with its base"
CELLS = (10, 20, 40, 80, 160, 320, 640)
HERMITE = 320  # the finest of them by default: two unknowns a node
WINDOW = 5.0  # tau, of the contact that is looked at
MODES, ROOTS = 200_000, 12  # of the beam itself: its speed to 1e-3; roots that are not (n - 1/2) pi to rounding
LOOK = 1600  # times in two first periods, between which the tip crosses a stop once


def points(
    case: Case,
    cells: Cells = None,
    forms: Annotated[list[str] | None, "comma-separated; default: all three"] = None,
    starts: Annotated[
        list[str] | None, "initial velocity of the beam: 'at rest', 'with its base'; default: both"
    ] = None,
) -> list[Point]:
    """Grids of 10 to 640 cells in all forms. The beam starts at rest, or with the velocity of its base."""
    _plain(case)
    for start in starts or ():
        one_of("starts", start, (OWN, SMOOTH))
    kinds = forms or ["displacement", "velocity-curvature", "hermite"]
    return [
        {"start": start, "form": form, "cells": int(n)}
        for start in starts or (OWN, SMOOTH)
        for form in kinds
        for n in cells or [n for n in CELLS if form != "hermite" or n <= HERMITE]
    ]


def _plain(case: Case) -> None:
    """Raise InputError unless the beam is that of the theory."""
    problem = case.problem
    tip_stops(case).require_linear("the first impact's force")
    if problem.viscosity or problem.loads or not isinstance(problem.base, Harmonic):
        remedy = "set viscosity to 0 and take the loads away"
        raise InputError("case", "damped or loaded", "be moved by a harmonic base only, without viscosity", remedy)
    if problem.initial_displacement is not None or problem.initial_velocity is not None:
        remedy = "leave initial_displacement and initial_velocity out"
        raise InputError("case", "a start of its own", "start at rest", remedy)


def evaluate(case: Case, point: Point) -> list[Row]:
    """One row: time, speed, peak force and impulse of the first impact on one grid."""
    problem, form, cells = started(case.problem, point["start"]), point["form"], point["cells"]
    stops, system = problem.all_stops[0], semidiscretise(problem, cells, form=form)
    when, free = flight(system)
    speed = abs(float(free.at(np.array([when]))[1][0]))
    end = when + WINDOW * tau(problem)
    contact = solve(system, end, "exact", np.array([0.0, end]), 0.0, None).contacts[0]
    scale = speed * (admittance(problem) ** 2 * float(stops.stiffness)) ** (1.0 / 3.0)
    return [
        {
            "h_over_l": problem.length / cells / wave_length(problem), "time": when, "speed": speed,
            "beam_speed": beam_speed(problem, point["start"]), "peak_force": contact.peak_force,
            "share": contact.peak_force / scale, "impulse": contact.impulse,
            "impulse_share": contact.impulse / (speed * admittance(problem) * np.sqrt(tau(problem))),
        }
    ]  # fmt: skip


def started(problem: BeamProblem, start: str) -> BeamProblem:
    """The beam at rest, or moving with its base."""
    if start == OWN:
        return problem
    assert isinstance(problem.base, Harmonic)
    speed = float(problem.base.rate(0.0))
    return replace(problem, initial_velocity=lambda x: np.full(np.shape(x), speed))


def admittance(problem: BeamProblem) -> float:
    """A of Z(s) = A sqrt(s): (EI m^3)^(1/4)/sqrt(2)."""
    return float((problem.stiffness * problem.mass_per_length**3) ** 0.25 / np.sqrt(2.0))


def tau(problem: BeamProblem) -> float:
    """(A/kappa)^(2/3)."""
    return (admittance(problem) / float(problem.all_stops[0].stiffness)) ** (2.0 / 3.0)


def wave_length(problem: BeamProblem) -> float:
    """l = (EI/kappa)^(1/3)."""
    return float((problem.stiffness / problem.all_stops[0].stiffness) ** (1.0 / 3.0))


def penetration(t: float, order: float = 2.0) -> float:
    """t^(order - 1) E(3/2, order; -t^(3/2)), t <= WINDOW: d/(V tau) at order 2, the impulse at order 3."""
    # To WINDOW the last of these terms is far below rounding, and none exceeds e^WINDOW.
    k = np.arange(120)
    return float(np.sum((-1.0) ** k * t ** (1.5 * k + order - 1.0) * rgamma(1.5 * k + order)))


def largest_penetration() -> float:
    """0.858, where d' = E(3/2, 1; -t^(3/2)) = 0 first."""
    at: Any = brentq(lambda t: penetration(t, 1.0), 1.0, 2.5, xtol=1e-14)
    return penetration(float(at))


def look_times(problem: BeamProblem) -> Array:
    """LOOK + 1 times in two first natural periods."""
    return np.linspace(0.0, float(4.0 * np.pi / natural_frequencies(problem, 1)[0]), LOOK + 1)


def flight(system: System) -> tuple[float, Reference]:
    """The time when the tip of a beam first reaches a stop, and its motion without stops."""
    assert system.problem is not None
    t = look_times(system.problem)
    free = solve(without_contact(system), float(t[-1]), "exact", t, 0.0, None)
    return first_crossing(lambda t: free.at(np.array([t]))[0][0], t, free.tip, system.problem.all_stops[0]), free


def first_crossing(tip: Callable[[float], float], t: Array, u: Array, stops: Stops) -> float:
    """Return the time when the tip first leaves its stops.

    Raises InputError where it does not on the grid t (k,) of u (k,).
    """
    g1, g2 = stops.lower_bound, stops.upper_bound
    out = np.flatnonzero((u > g2) | (u < g1))
    if not len(out):
        rule = "be reached within two of the beam's first periods"
        raise InputError("stops", (g1, g2), rule, "move the stops nearer, or drive the beam harder")
    k = int(out[0])
    stop = g2 if u[k] > g2 else g1
    at: Any = brentq(lambda s: tip(s) - stop, t[k - 1], t[k], xtol=1e-16)
    return float(at)


def beam_tip(problem: BeamProblem, start: str, t: float, count: int = MODES) -> tuple[float, float]:
    """Position and speed of the beam's own tip without stops, by its modes.

    u(L, t) = phi + sum_n c_n eta_n, c_n = X_n(1) int X_n = 4 (-1)^(n+1) sigma_n/l_n, eta'' + omega^2 eta = -phi''.
    """
    base = problem.base
    assert isinstance(base, Harmonic)
    root = (np.arange(1, count + 1) - 0.5) * np.pi
    root[:ROOTS] = roots(ROOTS)
    sigma = np.ones(count)
    low = root[:ROOTS]
    sigma[:ROOTS] = (np.cosh(low) + np.cos(low)) / (np.sinh(low) + np.sin(low))
    weight = 4.0 * (-1.0) ** np.arange(count) * sigma / root
    omega = root**2 * np.sqrt(problem.stiffness / problem.mass_per_length) / problem.length**2
    a, phase = float(base.frequency), float(base.phase)
    D = a * a * float(base.amplitude) / (omega**2 - a * a)
    rate = -float(base.rate(0.0)) if start == OWN else 0.0
    B, C = -D * np.sin(phase), (rate - D * a * np.cos(phase)) / omega
    c, s = np.cos(omega * t), np.sin(omega * t)
    eta = B * c + C * s + D * np.sin(a * t + phase)
    eta_rate = omega * (C * c - B * s) + D * a * np.cos(a * t + phase)
    return float(base.value(t) + weight @ eta), float(base.rate(t) + weight @ eta_rate)


def beam_speed(problem: BeamProblem, start: str) -> float:
    """Return the speed with which the beam itself meets its stop, to 1e-3."""
    times = look_times(problem)
    u = np.array([beam_tip(problem, start, t, 400)[0] for t in times])
    when = first_crossing(lambda t: beam_tip(problem, start, t)[0], times, u, problem.all_stops[0])
    return abs(beam_tip(problem, start, when)[1])


def orders(rows: Rows) -> dict[str, Order]:
    """Return the orders of the peak force in h, by form, with the base moving, against the finest grid of all."""
    smooth = [row for row in numeric(rows) if row["start"] == SMOOTH]
    finest = min(smooth, key=lambda row: (row["form"] != "hermite", -row["cells"]), default=None)
    by_form = {}
    for form in dict.fromkeys(row["form"] for row in smooth):
        group = [row for row in smooth if row["form"] == form and row is not finest and row["h_over_l"] < 1.0]
        errors = [abs(row["peak_force"] / finest["peak_force"] - 1.0) for row in group]  # type: ignore[index]
        by_form[form] = observed_order([1.0 / row["cells"] for row in group], errors)
    return by_form


def answer(rows: Rows, case: Case) -> Answer:
    """Peak force with the base moving, its order in h, and how far off the speed is from rest on every grid."""
    smooth = [row for row in rows if row["start"] == SMOOTH]
    off = {(row["cells"], row["form"]): percent(abs(row["speed"] / row["beam_speed"] - 1.0))
           for row in rows if row["start"] == OWN}  # fmt: skip
    table = [
        {"from rest, V off on": f"{cells} cells"} | {form: share for (n, form), share in off.items() if n == cells}
        for cells in sorted({cells for cells, _ in off})
    ]
    finest = max((cells for cells, _ in off), default=0)
    still = ", ".join(f"{share} ({form})" for (cells, form), share in off.items() if cells == finest)
    at_rest = f"From rest the speed V at the impact is off by {still} on {finest} cells." if off else ""
    if not smooth:
        return Answer(at_rest, table)
    best = min(smooth, key=lambda row: row["h_over_l"])
    rates = ", ".join(f"{order} ({form})" for form, order in orders(rows).items() if np.isfinite(order.slope))
    return Answer(
        f"With its base moving, the first impact has a peak force of {best['share']:.4f} V (A^2 kappa)^(1/3) on "
        f"{best['cells']} cells; theory gives {largest_penetration():.4f}.",
        table,
        (f"Orders in h of this force where h < l = (EI/kappa)^(1/3): {rates}. " if rates else "") + at_rest,
    )


def picture(records: Records) -> Picture:
    """Filled: from rest, the case's own start; hollow: with its base. Lines: the beam itself."""
    rows, problem = records.numbers, records.case.problem
    forms, starts = (list(groups(rows, name)) for name in ("form", "start"))
    speeds: list[Mark] = [Level(1.0, look=BEAM)]
    forces: list[Mark] = [
        Level(largest_penetration(), "the beam itself, by theory", look=BEAM),
        Level(problem.length / wave_length(problem), "cells as wide as the wave l", "x"),
    ]
    errors: list[Mark] = []
    for (form, start), group in groups(rows, "form", "start").items():
        style = style_of(forms.index(form)) | {"linestyle": dashed(starts.index(start))}
        style |= {} if start == OWN else {"mfc": "white"}
        group.sort(key=lambda row: row["cells"])
        cells, ratio = column(group, "cells"), column(group, "speed") / column(group, "beam_speed")
        share, label = column(group, "share"), f"{form}, {start}"
        speeds.append(Curve(cells, ratio, label, style))
        forces.append(Curve(cells, share * ratio, label, style))
        errors += [Curve(cells, np.abs(share / largest_penetration() - 1.0), label, style)] * (start == SMOOTH)
    grids = np.array(sorted({row["cells"] for row in rows}), float)
    errors.append(Curve(grids, (grids / 8.0) ** -2, "slope of $h^2$", {"color": "0.5", "linestyle": "-."}))
    across = Axis("cells", scale="log", ticks={n: f"{n:g}" for n in grids})
    return Picture([[
        Panel("speed at the first impact", across, Axis("V on the grid/V of the beam"), speeds),
        Panel("peak force", across, Axis(r"$F_{max}/(V_{beam}(A^2\kappa)^{1/3})$"), forces),
        Panel("error of the force, with its base", across, Axis("error relative to theory", scale="log"), errors),
    ]], 4.8)  # fmt: skip


BEAM = {"color": "black", "ls": "-"}
STUDY = declared(
    __name__,
    "How hard is the first impact, and how fine must the mesh be?",
    marches=False,
    needs_stops=True,
    smoke={"cells": [8, 16, 32], "forms": ["displacement", "hermite"]},
)
