"""One steel beam in metres, in millimetres and tonnes, and without dimension: one motion, in every program."""

from __future__ import annotations

from dataclasses import fields
from functools import cache

import numpy as np
import pytest

import stiffbeam as sb

L, EI, M, KAPPA, ETA = 0.4, 4.2, 0.16, 1e5, 2e-3
# Each system's unit of length, time and force, in metres, seconds and newtons. The one without dimension
# counts lengths in L, times in t0 and forces in m L^2/t0^2, so that L = m = 1.
T0 = 0.05
SCALES = {"metres": (1.0, 1.0, 1.0), "millimetres": (1e-3, 1.0, 1.0), "none": (L, T0, M * L**2 / T0**2)}
NAMES = {"metres": ("m", "s", "N"), "millimetres": ("mm", "s", "N")}
CELLS, STEPS, DT = 12, 2000, 1e-5  # s
END = STEPS * DT
FORMS = ("displacement", "velocity-curvature")


def beam(name: str, damped: bool = True, loads: bool = True) -> sb.BeamProblem:
    """The steel strip between two stops, every number divided by its unit by hand."""
    length, time, force = SCALES[name]
    own = {
        "stops": sb.Stops(-2e-3 / length, 2e-3 / length, stiffness=KAPPA / (force / length)),
        "base": sb.Harmonic(1e-3 / length, 150.0 * time, 0.3),
        "initial_displacement": lambda x: (1e-3 * np.sin(0.3) - 2e-3 * (x * length) ** 2) / length,
        "initial_velocity": lambda x: 0.1 * (x * length) ** 2 / (length / time),
    }
    if loads:
        own["loads"] = (
            sb.PointLoad(0.25 / length, sb.Harmonic(3.0 / force, 90.0 * time)),
            sb.DistributedLoad(lambda x: (1.0 + x * length) / (force / length), sb.Constant(0.5)),
        )
    bending, viscous = EI / (force * length**2), damped * ETA / (force * length**2 * time)
    mass = M / (force * time**2 / length**2)
    if name == "none":
        assert abs(mass - 1.0) < 1e-15
        return sb.BeamProblem(stiffness=bending, viscosity=viscous, **own)
    return sb.BeamProblem(
        length=L / length, stiffness=bending, viscosity=viscous, mass_per_length=mass,
        units=NAMES[name], **own,
    )  # fmt: skip


@cache
def system(name: str, form: str) -> sb.System:
    return sb.semidiscretise(beam(name, damped=form == "displacement"), CELLS, form)


def motion(run: sb.Trajectory, name: str) -> dict[str, np.ndarray]:
    """Everything a run says, in metres, seconds and newtons; its energies over the largest of them."""
    length, time, force = SCALES[name]
    contact, energy = run.contacts[0], run.energy
    assert run.impacts.count >= 2
    scale = np.max(energy.input + energy.kinetic)
    return {
        "t": run.t * time, "tip": run.tip * length, "velocity": run.tip_velocity * length / time,
        "force": contact.force * force, "impacts": contact.impacts.times * time, "peak": contact.peak_force * force,
        "impulse": contact.impulse * force * time, "fraction": contact.fraction, "work": scale * force * length,
        "beam": run.displacement(np.linspace(0.0, L, 5) / length) * length,
        "energies": np.array([getattr(energy, x.name) / scale for x in fields(energy)[1:]]),
    }  # fmt: skip


def of_run(scheme: sb.Scheme, form: str):
    run = lambda name, time: sb.integrate(system(name, form), scheme, DT / time, END / time)  # noqa: E731
    return lambda name: motion(run(name, SCALES[name][1]), name)


def of_reference(method: str, form: str):
    def observed(name: str) -> dict[str, np.ndarray]:
        time, t = SCALES[name][1], np.linspace(0.0, END, 401)
        found = sb.reference(system(name, form), END / time, method, t_eval=t / time)
        return motion(found, name) | {"horizon": found.horizon * time}

    return observed


KINDS = [  # what is observed, and how well three systems of units agree: a few impacts amplify rounding of 1e-13
    *((f"{scheme} {form}", of_run(scheme, form), 1e-8)
      for scheme in (sb.HHT(-0.1), sb.SDIRK(), sb.BDF2(), sb.Bathe()) for form in FORMS),
    # CVODE's error test is relative to |y|, with an absolute part that does not scale with the units.
    *(pytest.param(f"{method} {form}", of_reference(method, form), 2e-5 if method == "cvode" else 1e-7,
                   marks=pytest.mark.slow)
      for method in ("exact", "cvode", "multiprecision") for form in FORMS),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "observed", "within"), KINDS, ids=lambda x: x if isinstance(x, str) else "")
def test_one_motion_in_all_units(kind, observed, within):
    """All that was found agrees, relative to the largest value of each kind."""
    expected, *others = ({key: np.asarray(x, float) for key, x in observed(name).items()} for name in SCALES)
    for other in others:
        for key, values in expected.items():
            assert other[key].shape == values.shape, key
            scale = np.max(np.abs(values), initial=1e-300)
            assert np.max(np.abs(other[key] - values), initial=0.0) <= within * scale, key
