"""An overhung rotor in a ring of stops: gyroscopic forces are a damping matrix that is not symmetric.

    python studies/how-to/rotor.py

A disc turns with the speed SPIN at the end of a shaft that is clamped at its other end. Unknowns are the displacements
x, y and the slopes a, b of the disc. With z = x + i y and s = a + i b

    m z'' + k11 z + k12 s = m e SPIN^2 exp(i SPIN t),    Jt s'' - i SPIN Jp s' + k12 z + k22 s = 0,

e the eccentricity of the disc. The ring is a regular polygon of stops (``round_hole.py``). The script prints the four
whirl frequencies beside the roots of the characteristic equation, and compares two schemes with the exact motion. It
asserts that the frequencies agree.
"""

import numpy as np

import stiffbeam as sb

MASS, TRANSVERSE, POLAR, SPIN = 2.0, 4e-3, 7e-3, 300.0  # kg, kg m^2, kg m^2, rad/s
LENGTH, BENDING = 0.3, 1.2e3  # of the shaft, m and N m^2
ECCENTRICITY, CLEARANCE, SIDES = 1e-4, 3e-4, 12  # m, m
SHAFT = BENDING / LENGTH**3 * np.array([[12.0, -6.0 * LENGTH], [-6.0 * LENGTH, 4.0 * LENGTH**2]])


def rotor() -> sb.System:
    """Unknowns x, y, a, b."""
    gyroscopic = np.zeros((4, 4))
    gyroscopic[2, 3], gyroscopic[3, 2] = SPIN * POLAR, -SPIN * POLAR
    pull = MASS * ECCENTRICITY * SPIN**2
    turns = 2.0 * np.pi / SIDES * np.arange(SIDES // 2)
    ring = sb.Stops(lower=-CLEARANCE, upper=CLEARANCE, stiffness=2e7, damping=500.0)
    return sb.System.from_matrices(
        np.diag([MASS, MASS, TRANSVERSE, TRANSVERSE]),
        np.kron(SHAFT, np.eye(2)),
        gyroscopic + 20.0 * np.diag([1.0, 1.0, 0.0, 0.0]),
        loads=[([1.0, 0.0, 0.0, 0.0], sb.Harmonic(pull, SPIN, phase=0.5 * np.pi)),
               ([0.0, 1.0, 0.0, 0.0], sb.Harmonic(pull, SPIN))],
        contacts=[sb.Contact([np.cos(x), np.sin(x), 0.0, 0.0], ring) for x in turns],
    )  # fmt: skip


def whirl() -> np.ndarray:
    """|w| of the damped rotor: with exp(i w t) the determinant of both equations is a polynomial of degree 4 in w."""
    plane, slope = [-MASS, 20.0j, SHAFT[0, 0]], [-TRANSVERSE, SPIN * POLAR, SHAFT[1, 1]]
    return np.sort(np.abs(np.roots(np.polysub(np.polymul(plane, slope), [SHAFT[0, 1] ** 2]))))


if __name__ == "__main__":
    system = rotor()
    found = sb.modes(system).omega
    print("whirl frequencies, rad/s:", *(f"{x:.6g} ({y:.6g})" for x, y in zip(found, whirl(), strict=True)))
    runs = [sb.integrate(system, scheme, 1e-5, 0.2) for scheme in (sb.HHT(alpha=-0.1), sb.BDF2())]
    print(sb.compare(runs, sb.reference(system, 0.2)))
    np.testing.assert_allclose(found, whirl(), rtol=1e-9)
