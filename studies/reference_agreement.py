"""How closely do the references agree inside the horizon, and what does each cost?

Table 10 on both forms to T = 0.1, ten impacts: the largest difference in tip displacement from the exact
solution over the largest displacement, and the largest difference in impact times. Run (4 minutes):

    python studies/reference_agreement.py
"""

from __future__ import annotations

import numpy as np

import stiffbeam as sb
from stiffbeam.solvers import solve

T_END = 0.1


def main() -> None:
    case = sb.paper_case(10)
    times = np.linspace(0.0, T_END, 401)
    print("| form | solver | rtol | tip displacement | impact times | right-hand sides | seconds |")
    print("|---|---|---|---|---|---|---|")
    for form in ("displacement", "velocity-curvature"):
        system = sb.semidiscretise(case.problem, case.cells, form)
        exact = solve(system, T_END, "exact", times, 0.0, None)
        evaluations = exact.work.counters["evaluations"]
        print(f"| {form} | exact | | | {exact.impacts.count} impacts | {evaluations} | {exact.work.seconds:.2g} |")
        for method in ("cvode", "cvode-adams", "dop853", "radau"):
            for rtol in (1e-6, 1e-8, 1e-10, 1e-12):
                if method == "radau" and rtol < 1e-8:
                    continue  # order 5 with a new Jacobian at every switch: minutes
                ref = solve(system, T_END, method, times, rtol, None)
                tip = np.max(np.abs(ref.tip - exact.tip)) / np.max(np.abs(exact.tip))
                same = ref.impacts.count == exact.impacts.count
                impacts = f"{np.max(np.abs(ref.impacts.times - exact.impacts.times)):.1e}" if same else "count differs"
                print(
                    f"| {form} | {method} | {rtol:.0e} | {tip:.1e} | {impacts} | {ref.work.counters['rhs']} "
                    f"| {ref.work.march_seconds:.2g} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
