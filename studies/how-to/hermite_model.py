"""A finite-element model in files: 20 Hermite elements, Rayleigh damping, two contacts.

    python studies/how-to/hermite_model.py --out FOLDER

The script assembles the matrices and writes them as Matrix Market files. A case file names them, and every command
accepts it: stiffbeam compare FOLDER/model.toml, sweep, chaos, ensemble, advise, animate.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse

import stiffbeam as sb

ELEMENTS, LENGTH = 20, 1.0  # m
BENDING, LINE_MASS = 180.0, 1.2  # N m^2, kg/m
OF_MASS, OF_STIFFNESS = 0.8, 2e-5  # 1/s, s: C = OF_MASS M + OF_STIFFNESS K
CASE = """
[[case]]
name = "model"
title = "20 Hermite elements, Rayleigh damping, two contacts"
dt = 2e-5
t_end = 0.6
runs = ["HHT(alpha=-0.1)", "bdf2", "trapezoidal"]
[case.system]
mass = "M.mtx"
stiffness = "K.mtx"
damping = "C.mtx"
loads = {{ row = {{ {middle} = 1.0 }}, amplitude = 25.0, frequency = "2*pi*9" }}
observe = {{ {tip} = 1.0 }}
[[case.system.contacts]]
row = {{ {middle} = 1.0 }}
upper = 8e-3
stiffness = 4e4
[[case.system.contacts]]
row = {{ {tip} = 1.0 }}
lower = -2e-2
upper = 3e-2
stiffness = 2e4
"""


def cantilever() -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """M and K of cubic Hermite elements clamped at x = 0: (deflection, slope) at every other node."""
    h, n = LENGTH / ELEMENTS, 2 * (ELEMENTS + 1)
    k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                  [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]])  # fmt: skip
    m = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                  [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])  # fmt: skip
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    for e in range(ELEMENTS):
        here = slice(2 * e, 2 * e + 4)
        stiffness[here, here] += BENDING / h**3 * k
        mass[here, here] += LINE_MASS * h / 420.0 * m
    return scipy.sparse.csr_array(mass[2:, 2:]), scipy.sparse.csr_array(stiffness[2:, 2:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("stiffbeam-output/hermite-model"))
    out: Path = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    mass, stiffness = cantilever()
    matrices = {"M": mass, "K": stiffness, "C": OF_MASS * mass + OF_STIFFNESS * stiffness}
    for name, matrix in matrices.items():
        scipy.io.mmwrite(out / f"{name}.mtx", scipy.sparse.coo_array(matrix), symmetry="symmetric", precision=17)
    middle, tip = ELEMENTS - 2, 2 * ELEMENTS - 2  # unknowns, counted from 0: deflections at L/2 and at L
    (out / "model.toml").write_text(CASE.format(middle=middle, tip=tip), encoding="utf-8")

    case = sb.load_cases(out / "model.toml")["model"]
    system = case.system()
    found = sb.modes(system)
    print(f"frequencies {', '.join(f'{w:.4f}' for w in found.omega[:3])} rad/s")
    print(f"damping ratios {', '.join(f'{z:.5f}' for z in found.damping_ratio[:3])}")
    exact = sb.reference(system, case.t_end)
    print(f"impacts {[c.impacts.count for c in exact.contacts]}, known to t = {exact.horizon:.3g} s")
    runs = [sb.integrate(system, scheme, case.dt, case.t_end) for scheme, _ in case.runs]
    comparisons = [sb.compare(run, exact) for run in runs]
    for comparison in comparisons:
        print(f"{comparison.label}: tip error {100 * comparison.tip_error_rms:.2g} % rms")
    comparisons[0].figure().savefig(out / "hermite_model.png", dpi=100)
    records = sb.study("energy", case, schemes=[scheme for scheme, _ in case.runs])
    print(records.answer)


if __name__ == "__main__":
    main()
