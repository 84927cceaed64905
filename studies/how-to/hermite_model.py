"""A finite-element model in files: 20 Hermite elements, Rayleigh damping, a contact in the middle.

    python studies/how-to/hermite_model.py FOLDER

The script assembles the matrices and writes them as Matrix Market files. A case file names them, and every command
accepts it, for example stiffbeam compare FOLDER/model.toml.
"""

import sys
from pathlib import Path

import numpy as np
import scipy.io

import stiffbeam as sb

ELEMENTS, LENGTH = 20, 1.0  # m
BENDING, LINE_MASS = 180.0, 1.2  # N m^2, kg/m
CASE = f"""
[[case]]
name = "model"
dt = 2e-5
t_end = 0.3
runs = ["HHT(alpha=-0.1)", "bdf2", "trapezoidal"]
[case.system]
mass = "M.mtx"
stiffness = "K.mtx"
damping = "C.mtx"
loads = {{ row = {{ {ELEMENTS - 2} = 1.0 }}, amplitude = 25.0, frequency = "2*pi*9" }}
observe = {{ {2 * ELEMENTS - 2} = 1.0 }}
contacts = {{ row = {{ {ELEMENTS - 2} = 1.0 }}, upper = 8e-3, stiffness = 4e4 }}
"""

if __name__ == "__main__":
    h, n = LENGTH / ELEMENTS, 2 * (ELEMENTS + 1)
    k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                  [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]])  # fmt: skip
    m = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                  [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])  # fmt: skip
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    for element in range(ELEMENTS):
        here = slice(2 * element, 2 * element + 4)  # deflection and slope at both nodes
        stiffness[here, here] += BENDING / h**3 * k
        mass[here, here] += LINE_MASS * h / 420.0 * m
    mass, stiffness = mass[2:, 2:], stiffness[2:, 2:]  # clamped at x = 0
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "stiffbeam-output/hermite-model")
    folder.mkdir(parents=True, exist_ok=True)
    for name, matrix in (("M", mass), ("K", stiffness), ("C", 0.8 * mass + 2e-5 * stiffness)):
        scipy.io.mmwrite(folder / f"{name}.mtx", matrix, symmetry="symmetric", precision=17)
    (folder / "model.toml").write_text(CASE, encoding="utf-8")

    case = sb.load_cases(folder / "model.toml")["model"]
    omega = sb.modes(case.system()).omega[0]
    assert abs(omega / (1.8751040687**2 * np.sqrt(BENDING / LINE_MASS)) - 1.0) < 1e-6  # cos x cosh x = -1
    exact = sb.reference(case.system(), case.t_end)
    print(f"{exact.impacts.count} impacts, known to t = {exact.horizon:.3g} s")
    runs = [sb.integrate(case.system(), scheme, case.dt, case.t_end) for scheme, _ in case.runs]
    print(sb.compare(runs, exact))
