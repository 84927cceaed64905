"""How closely do the references agree inside the horizon, and what does each cost?

First Table 10 on both forms to T = 0.1, ten impacts, over a range of tolerances; then every solver, at a
tolerance that it reaches in seconds, on Tables 2, 5, 14 and 15, on a viscous beam and on a chain with two
contacts and a moving stop. Differences are from the exact solution, in tip displacement over the largest
displacement and in impact times. Run (six minutes):

    python studies/reference_agreement.py
"""

from __future__ import annotations

import dataclasses

import numpy as np

import stiffbeam as sb
from stiffbeam.references import solve
from stiffbeam.references.registry import ADAPTIVE, EXACT, REFERENCES

AFFORDABLE = {"radau": 1e-7, "kvaerno5": 1e-8, "kvaerno3": 1e-6}  # in seconds; the others reach 1e-10
EVERYONE = {
    m.name: AFFORDABLE.get(m.name, 1e-10) if m.kind == ADAPTIVE else 0.0 for m in REFERENCES.values() if m.kind != EXACT
}
FAST = [m.name for m in REFERENCES.values() if m.kind == ADAPTIVE and m.seconds < 1.0]


def compare(system: sb.System, method: str, rtol: float, exact: sb.Reference) -> str:
    """One row: differences, work, seconds."""
    ref = solve(system, float(exact.t[-1]), method, exact.t, rtol, None)
    tip = np.max(np.abs(ref.tip - exact.tip)) / np.max(np.abs(exact.tip))
    pairs = [(a.impacts, b.impacts) for a, b in zip(ref.contacts, exact.contacts, strict=True)]
    impacts = "count differs"
    if all(a.count == b.count for a, b in pairs):
        impacts = f"{max(np.max(np.abs(a.times - b.times), initial=0.0) for a, b in pairs):.1e}"
    impacts = "sampled" if any(a.kind == "sampled" for a, _ in pairs) else impacts
    multiple = f"{tip / rtol:.2g}" if rtol else ""
    work = ", ".join(f"{value} {name}" for name, value in ref.work.counters.items() if name in ("rhs", "steps"))
    tolerance = f"{rtol:.0e}" if rtol else ""
    return f"{method} | {tolerance} | {tip:.1e} | {multiple} | {impacts} | {work} | {ref.work.march_seconds:.2g} |"


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


def main() -> None:
    head = " | solver | rtol | tip displacement | over rtol | impact times | work | seconds |\n" + "|---" * 8 + "|"
    print("| form" + head)
    case = sb.paper_case(10)
    for form in ("displacement", "velocity-curvature"):
        system = sb.semidiscretise(case.problem, case.cells, form)
        exact = solve(system, 0.1, "exact", np.linspace(0.0, 0.1, 401), 0.0, None)
        for method in FAST:
            for rtol in (1e-6, 1e-8, 1e-10, 1e-12):
                print(f"| {form} | {compare(system, method, rtol, exact)}", flush=True)
    print("\n| problem" + head)
    viscous = dataclasses.replace(case.problem, viscosity=0.05)
    problems = [
        (f"Table {n}", sb.semidiscretise(sb.paper_case(n).problem, sb.paper_case(n).cells), t_end)
        for n, t_end in ((2, 0.06), (5, 0.01), (14, 0.02), (15, 0.03))
    ]
    problems += [("Table 10, d = 0.05", sb.semidiscretise(viscous, 25), 0.1), ("two contacts", two_contacts(), 3.0)]
    for name, system, t_end in problems:
        exact = solve(system, t_end, "exact", np.linspace(0.0, t_end, 101), 0.0, None)
        count = sum(contact.impacts.count for contact in exact.contacts)
        for method, rtol in EVERYONE.items():
            row = compare(system, method, rtol, exact)
            print(f"| {name}, T = {t_end:g}, {count} impacts | {row}", flush=True)


if __name__ == "__main__":
    main()
