"""The systems of the problems, as the [system] of their files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mpmath as mp
import numpy as np

import stiffbeam as sb
from stiffbeam.model.time_functions import parts

INF = float("inf")  # the stiffness of a rigid stop


def mass(m: float, k: float, u: float, v: float, loads: Sequence[dict] = (), **stops: float) -> dict[str, Any]:
    """One mass on a spring with one stop."""
    return {"mass": [[m]], "stiffness": [[k]], "initial_displacement": [u], "initial_velocity": [v],
            "contacts": [{"row": [1.0], **stops}], **({"loads": list(loads)} if loads else {})}  # fmt: skip


def drive(amplitude: float, frequency: float, phase: float) -> list[dict[str, Any]]:
    """amplitude sin(frequency t + phase) on the one mass."""
    return [{"vector": [1.0], "amplitude": amplitude, "frequency": frequency, "phase": phase}]


def table_of(system: sb.System) -> dict[str, Any]:
    """A System as the [system] of a file, its matrices by bands."""

    def wave(function: Any) -> dict[str, float]:
        ((factor, f),) = parts(function)
        if isinstance(f, sb.Constant):
            return {"constant": factor * f.level}
        return {"amplitude": factor * f.amplitude, "frequency": float(f.frequency), "phase": float(f.phase)}

    def bands(A: np.ndarray) -> dict[str, Any]:
        width = max(abs(i - j) for i, j in zip(*np.nonzero(A), strict=True))
        return {"bands": [np.diag(A, k).tolist() for k in range(width + 1)]}

    contacts = []
    for c in system.contacts:
        sides = {side: float(x) for side in ("lower", "upper") if (x := getattr(c.stops, side)) is not None}
        offset = {} if c.offset is None else {"offset": wave(c.offset)}
        contacts.append({"row": c.row.tolist(), **sides, "stiffness": float(c.stops.stiffness), **offset})
    return {
        "mass": bands(system.mass), "stiffness": bands(system.stiffness),
        **({"damping": bands(system.damping)} if system.damped else {}),
        **({} if system.observe is None else {"observe": system.observe.tolist()}),
        "initial_displacement": system.q0.tolist(), "initial_velocity": system.v0.tolist(),
        "loads": [{"vector": p.tolist(), **wave(f)} for p, f in system.loads], "contacts": contacts,
    }  # fmt: skip


def bar(elements: int, gravity: float, speed: float) -> dict[str, Any]:
    """Linear elements, lumped; E A = 900, rho A = 1, length 10, the lower end 5 above the wall.

    The lower end carries no mass, its own is moved to the next node. Without mass it is where its element puts it,
    so that the element is a spring of stiffness E A/dx between the next node and the wall: the stop of the file.
    """
    dx = 10.0 / elements
    masses = np.full(elements, dx)
    masses[0], masses[-1] = 1.5 * dx, 0.5 * dx
    k = 900.0 / dx
    diagonal = np.full(elements, 2.0 * k)
    diagonal[0] = diagonal[-1] = k
    row = [1.0] + [0.0] * (elements - 1)
    loads = {"loads": [{"vector": (-gravity * masses).tolist(), "constant": 1.0}]} if gravity else {}
    return {"mass": {"bands": [masses.tolist()]}, "stiffness": {"bands": [diagonal.tolist(), [-k] * (elements - 1)]},
            "initial_displacement": [0.0] * elements, "initial_velocity": [-speed] * elements,
            "contacts": [{"row": row, "lower": -5.0, "stiffness": k}], **loads}  # fmt: skip


def paper(table: int) -> dict[str, Any]:
    case = sb.paper_case(table)
    return table_of(sb.semidiscretise(case.beam, case.cells))


def aster() -> dict[str, Any]:
    beam = sb.BeamProblem(
        length=1.0, stiffness=1e10 * np.pi * 0.1**4 / 4.0, mass_per_length=1e6 * np.pi * 0.1**2,
        stops=sb.Stops(lower=-1e-4, stiffness=1e8), loads=sb.PointLoad(position=1.0, time=sb.Constant(-1000.0)),
        units=("m", "s", "N"),
    )  # fmt: skip
    return table_of(sb.semidiscretise(beam, 8, "hermite"))


def along() -> dict[str, Any]:
    beam = sb.BeamProblem(
        stiffness=300.0, stops=sb.Stops(-0.04, 0.04, stiffness=1e5, position=0.5), base=sb.Harmonic(0.2, 10.0)
    )
    return table_of(sb.semidiscretise(beam, 6, "hermite"))


def nonsmooth_mode() -> dict[str, Any]:
    """u = -P sum phi_j phi_j2 cos(w_j (t - T/2))/(2 w_j sin(w_j T/2)): free but for one impulse P a period, e = 1."""
    T = mp.mpf(10)
    w = [(mp.sqrt(5) - 1) / 2, (mp.sqrt(5) + 1) / 2]
    phi = [[1 / mp.sqrt(1 + (2 - x * x) ** 2), (2 - x * x) / mp.sqrt(1 + (2 - x * x) ** 2)] for x in w]
    u = [-mp.fsum(p[i] * p[1] * mp.cot(x * T / 2) / (2 * x) for p, x in zip(phi, w, strict=True)) for i in (0, 1)]
    v = [-mp.fsum(p[i] * p[1] / 2 for p in phi) for i in (0, 1)]
    P = 1 / u[1]
    assert abs(v[0]) < 1e-50  # the sum of phi_j1 phi_j2 is zero
    return {"mass": [[1.0, 0.0], [0.0, 1.0]], "stiffness": [[2.0, -1.0], [-1.0, 1.0]],
            "initial_displacement": [float(P * u[0]), 1.0], "initial_velocity": [0.0, float(P * v[1])],
            "contacts": [{"row": [0.0, 1.0], "upper": 1.0, "stiffness": INF, "restitution": 1.0}]}  # fmt: skip


def nonsmooth_beam() -> dict[str, Any]:
    """The same sum over the modes of the paper's beam (8 cells, k^2 = 300), T = 0.95 T_1, stop at 0.1."""
    system = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=sb.Stops(upper=0.1, stiffness=1e6)), 8)
    modes = sb.modes(system)
    omega, phi = modes.omega, modes.shapes
    phi = phi / np.sqrt(np.einsum("ij,ik,kj->j", phi, system.mass, phi))
    T = 0.95 * 2.0 * np.pi / omega[0]
    q = -phi @ (phi[-1] / np.tan(omega * T / 2.0) / (2.0 * omega))
    v = -phi @ (phi[-1] / 2.0)
    P = 0.1 / q[-1]
    table = table_of(system)
    table |= {"initial_displacement": [*(P * q[:-1]).tolist(), 0.1], "initial_velocity": (P * v).tolist()}
    table["contacts"] = [{"row": table["contacts"][0]["row"], "upper": 0.1, "stiffness": INF, "restitution": 1.0}]
    del table["loads"]
    return table
