"""How closely do the references agree inside the horizon, and what does each cost?

Three tables of differences from the exact solution. The first has the references of ``compare``, multiprecision and
DOP853 on Tables 1 to 17, each up to its horizon: what a user of ``sb.reference`` gets. The second has one solution of
every solver, at a tolerance that it reaches in seconds: on four tables, a viscous beam and a chain with two contacts
and a moving stop. The third has Table 10 in both forms over a range of tolerances. Run (twenty minutes):

    python studies/reference_agreement.py [--record]

``--record`` writes the page reference/agreement.md.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

import stiffbeam as sb
from stiffbeam.references import expected_seconds, solve
from stiffbeam.references.registry import ADAPTIVE, COMPARED, EXACT, MULTIPRECISION, REFERENCES, RTOL, Steps

PAGE = Path(__file__).parents[1] / "reference" / "agreement.md"
SECONDS = 60.0  # for one reference with its horizon
SPAN = 0.25  # of the exact horizon, to which the methods are asked: they reach most of that at their tolerances
AFFORDABLE = {"radau": 1e-7, "kvaerno5": 1e-8, "kvaerno3": 1e-6}  # in seconds; the others reach 1e-10
EVERYONE = {
    m.name: AFFORDABLE.get(m.name, 1e-10) if m.kind == ADAPTIVE else 0.0 for m in REFERENCES.values() if m.kind != EXACT
}
FAST = [m.name for m in REFERENCES.values() if m.kind == ADAPTIVE and m.seconds < 1.0]
COLUMNS = "solver | rtol | tip displacement | over rtol | impact times | work | seconds |\n" + "|---" * 8 + "|"
INTRODUCTION = """# Agreement of the references

`python studies/reference_agreement.py --record` writes this page. Rows change by a factor of three between versions of
the libraries. All differences are from the exact solution, which shares only the matrices with the other methods. They
are the largest difference in tip displacement over the largest displacement, and the largest one in impact times.
"""
CERTIFIED = f"""## Tables 1 to 17 within the horizon

Each row is `sb.reference` with its default tolerance, to {SPAN:g} of the exact horizon. Inside its own horizon a
solution is accurate to a thousandth of the largest displacement. A method that would take more than {SECONDS:g} s is
not run.

| problem | method | horizon | tip displacement | impact times | seconds |
|---|---|---|---|---|---|"""
ALONE = f"""
## One solution of every solver

Errors grow with every impact. Each solver stays within 10⁴ times its tolerance.

| problem | {COLUMNS}"""
TOLERANCES = f"""
## Table 10 over tolerances

Table 10 to T = 0.1 has ten impacts and more. Without damping the eigenvalues of the system lie on the imaginary axis,
where BDF needs several times the work of Adams.

| form | {COLUMNS}"""


def differences(run: sb.Reference, exact: sb.Reference) -> tuple[float, str]:
    """Largest difference from the exact solution within the horizon of the run: in tip displacement, over the largest;
    in impact times, "count differs" where those differ in number."""
    inside = exact.t <= run.horizon
    tip = float(np.max(np.abs(run.tip - exact.tip)[inside]) / np.max(np.abs(exact.tip)))
    times = [
        [contact.impacts.times[contact.impacts.times <= run.horizon] for contact in solution.contacts]
        for solution in (run, exact)
    ]
    if any(len(a) != len(b) for a, b in zip(*times, strict=True)):
        return tip, "count differs"
    return tip, f"{max(np.max(np.abs(a - b), initial=0.0) for a, b in zip(*times, strict=True)):.1e}"


def certified() -> Iterator[str]:
    """Rows of Tables 1 to 17: every method with its horizon, the time span a part of the exact one."""
    for number in range(1, 18):
        case = sb.paper_case(number)
        system = case.system()
        whole = sb.reference(system, case.t_end)
        t = np.linspace(0.0, SPAN * whole.horizon, 401)
        exact = sb.reference(system, float(t[-1]), "exact", t)
        name = f"Table {number}, T = {t[-1]:.2g}, {exact.impacts.count} impacts"
        for method in (MULTIPRECISION, *(m for m in COMPARED if m != EXACT), "dop853"):
            seconds = expected_seconds(system, float(t[-1]), method, RTOL, None, Steps(), SECONDS)
            if seconds > SECONDS:
                yield f"| {name} | {method} | | | | {seconds:.0f}, by an estimate |"
                continue
            run = sb.reference(system, float(t[-1]), method, t)
            tip, times = differences(run, exact)
            yield f"| {name} | {method} | {run.horizon:.2g} | {tip:.1e} | {times} | {run.work.seconds:.2g} |"


def row(system: sb.System, method: str, rtol: float, exact: sb.Reference) -> str:
    """One solution without a second one to judge it: differences, work, seconds."""
    run = solve(system, float(exact.t[-1]), method, exact.t, rtol, None)
    tip, times = differences(dataclasses.replace(run, horizon=float(exact.t[-1])), exact)
    multiple = f"{tip / rtol:.2g}" if rtol else ""
    work = ", ".join(f"{value} {name}" for name, value in run.work.counters.items() if name in ("rhs", "steps"))
    tolerance = f"{rtol:.0e}" if rtol else ""
    return f"{method} | {tolerance} | {tip:.1e} | {multiple} | {times} | {work} | {run.work.march_seconds:.2g} |"


def two_contacts() -> sb.System:
    """Four masses in a chain, stops at two of them, one of which moves."""
    unit = np.eye(4)
    return sb.System.from_matrices(
        np.diag([1.0, 1.2, 0.8, 1.0]) + 0.1 * (np.eye(4, k=1) + np.eye(4, k=-1)),
        40.0 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)),
        loads=[(unit[1], sb.Harmonic(15.0, 4.0)), (unit[3], sb.Harmonic(9.0, 2.5, 1.0))],
        contacts=[
            sb.Contact(unit[3], sb.Stops(-0.25, 0.2, stiffness=3e3)),
            sb.Contact(unit[2], sb.Stops(None, 0.15, stiffness=2e3), sb.Harmonic(0.05, 3.0)),
        ],
        initial_velocity=[0.0, 1.0, 0.0, 0.5],
    )


def every_solver() -> Iterator[str]:
    """Rows of six problems: every solver at a tolerance that it reaches in seconds."""
    case = sb.paper_case(10)
    problems = [
        (f"Table {n}", sb.semidiscretise(sb.paper_case(n).problem, sb.paper_case(n).cells), t_end)
        for n, t_end in ((2, 0.06), (5, 0.01), (14, 0.02), (15, 0.03))
    ]
    viscous = dataclasses.replace(case.problem, viscosity=0.05)
    problems += [
        ("Table 10, d = 0.05", sb.semidiscretise(viscous, case.cells), 0.1),
        ("two contacts", two_contacts(), 3.0),
    ]
    for name, system, t_end in problems:
        exact = solve(system, t_end, "exact", np.linspace(0.0, t_end, 101), 0.0, None)
        count = sum(contact.impacts.count for contact in exact.contacts)
        for method, rtol in EVERYONE.items():
            yield f"| {name}, T = {t_end:g}, {count} impacts | {row(system, method, rtol, exact)}"


def tolerances() -> Iterator[str]:
    """Rows of Table 10 to T = 0.1 in both forms, ten impacts and more."""
    case = sb.paper_case(10)
    for form in ("displacement", "velocity-curvature"):
        system = sb.semidiscretise(case.problem, case.cells, form)
        exact = solve(system, 0.1, "exact", np.linspace(0.0, 0.1, 401), 0.0, None)
        for method in FAST:
            for rtol in (1e-6, 1e-8, 1e-10, 1e-12):
                yield f"| {form} | {row(system, method, rtol, exact)}"


def page() -> Iterator[str]:
    """Lines of the page."""
    yield INTRODUCTION
    yield CERTIFIED
    yield from certified()
    yield ALONE
    yield from every_solver()
    yield TOLERANCES
    yield from tolerances()


def main() -> None:
    """Print the page, and write it where asked."""
    lines = []
    show = partial(print, flush=True)
    for line in page():
        show(line)
        lines.append(line)
    if "--record" in sys.argv[1:]:
        PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
