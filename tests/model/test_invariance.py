"""One steel beam in metres, in millimetres and tonnes, and without dimension: one motion, in every program."""

from __future__ import annotations

import dataclasses
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
    viscosity = ETA if damped else 0.0
    bending, viscous, mass = (
        EI / (force * length**2), viscosity / (force * length**2 * time), M / (force * time**2 / length**2)
    )  # fmt: skip
    if name == "none":
        assert abs(mass - 1.0) < 1e-15
        return sb.BeamProblem(stiffness=bending, viscosity=viscous, **own)
    return sb.BeamProblem.from_physical(
        length=L / length, bending_stiffness=bending, bending_viscosity=viscous, mass_per_length=mass,
        units=NAMES[name], **own,
    )  # fmt: skip


@cache
def system(name: str, form: str) -> sb.System:
    return sb.semidiscretise(beam(name, damped=form == "displacement"), CELLS, form)


def in_si(run: sb.Trajectory, name: str) -> dict[str, np.ndarray]:
    """Everything a run says, in metres, seconds, newtons and joules."""
    length, time, force = SCALES[name]
    contact = run.contacts[0]
    return {
        "t": run.t * time,
        "tip": run.tip * length,
        "velocity": run.tip_velocity * length / time,
        "force": contact.force * force,
        "impacts": contact.impacts.times * time,
        "peak": np.array([contact.peak_force * force]),
        "impulse": np.array([contact.impulse * force * time]),
        "fraction": np.array([contact.fraction]),
        "beam": run.displacement(np.linspace(0.0, L, 5) / length) * length,
    }


def energies(run: sb.Trajectory, name: str) -> dict[str, np.ndarray]:
    length, _, force = SCALES[name]
    names = (f.name for f in dataclasses.fields(run.energy) if f.name != "t")
    return {field: getattr(run.energy, field) * force * length for field in names}


def same(found: dict[str, dict[str, np.ndarray]], within: float) -> None:
    """All that was found agrees, relative to the largest value of each kind."""
    for key, expected in found["metres"].items():
        for name in ("millimetres", "none"):
            assert found[name][key].shape == expected.shape, (key, name)
            scale = np.max(np.abs(expected), initial=1e-300)
            assert np.max(np.abs(found[name][key] - expected), initial=0.0) <= within * scale, (key, name)


FORMS = ("displacement", "velocity-curvature")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.SDIRK(), sb.BDF2(), sb.Bathe()], ids=str)
def test_a_scheme_gives_the_same_motion_and_the_same_ledger(scheme, form):
    runs = {
        name: sb.integrate(system(name, form), scheme, DT / time, STEPS * DT / time)
        for name, (_, time, _) in SCALES.items()
    }
    assert runs["metres"].impacts.count >= 2
    # Rounding of eps w_max/w_1 = 1e-13, which a few impacts amplify.
    same({name: in_si(run, name) for name, run in runs.items()}, 1e-8)
    ledgers = {name: energies(run, name) for name, run in runs.items()}
    scale = np.max(ledgers["metres"]["input"] + ledgers["metres"]["kinetic"])
    for name in ("millimetres", "none"):
        for key, values in ledgers["metres"].items():
            assert np.max(np.abs(ledgers[name][key] - values)) < 1e-8 * scale, (key, name)


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("method", ["exact", "cvode", "multiprecision"])
def test_a_reference_gives_the_same_motion_and_the_same_horizon(method, form):
    end = STEPS * DT
    t = np.linspace(0.0, end, 401)
    runs = {
        name: sb.reference(system(name, form), end / time, method, t_eval=t / time)
        for name, (_, time, _) in SCALES.items()
    }
    assert runs["metres"].impacts.count >= 2
    # CVODE's error test is relative to |y|, with an absolute part that does not scale with the units.
    same({name: in_si(run, name) for name, run in runs.items()}, 1e-5 if method == "cvode" else 1e-9)
    horizons = [runs[name].horizon * time for name, (_, time, _) in SCALES.items()]
    assert np.ptp(horizons) < 1e-9
    if method != "cvode":
        ledgers = {name: energies(run, name)["stops"] for name, run in runs.items()}
        same({name: {"stops": values} for name, values in ledgers.items()}, 1e-7)


@cache
def chaotic(name: str, damped: bool) -> sb.System:
    """A beam that is driven hard, of eight cells: it loses the sixteenth digit within the span."""
    problem = beam(name, damped)
    assert isinstance(problem.base, sb.Harmonic)
    strong = dataclasses.replace(problem.base, amplitude=5.0 * problem.base.amplitude)
    problem = dataclasses.replace(
        problem, base=strong, viscosity=1e-3 * problem.viscosity, initial_displacement=None
    )  # fmt: skip
    return sb.semidiscretise(problem, 8)


@pytest.mark.parametrize("damped", [False, True], ids=["undamped", "damped"])
@pytest.mark.slow
def test_a_horizon_inside_the_span_is_the_same_in_all_units(damped):
    runs = {name: sb.reference(chaotic(name, damped), 0.6 / time) for name, (_, time, _) in SCALES.items()}
    times = {
        name: np.array([run.horizon, run.provenance["horizon_predicted"]]) * SCALES[name][1]
        for name, run in runs.items()
    }
    assert 0.15 < times["metres"][0] < 0.5
    for name in ("millimetres", "none"):
        # The rounding of each system of units is its own, worth a few digits' time of the 13 there are.
        assert abs(times[name][0] / times["metres"][0] - 1.0) < 0.07
        assert abs(times[name][1] / times["metres"][1] - 1.0) < 1e-5


def test_impact_times_of_a_free_mass_may_differ_by_the_same_share_in_all_units():
    """It has no natural period but that of its stop."""
    from stiffbeam.references.horizon import time_tolerance

    def free_mass(time: float) -> sb.System:
        contact = sb.Contact([1.0], sb.Stops(upper=1.0, stiffness=1e4 * time**2))
        return sb.System.from_matrices([[1.0]], [[0.0]], contacts=[contact], initial_velocity=[time])

    assert abs(time_tolerance(free_mass(1.0)) - 1e-3 * 2.0 * np.pi / 100.0) < 1e-15
    assert abs(1e-6 * time_tolerance(free_mass(1e-6)) / time_tolerance(free_mass(1.0)) - 1.0) < 1e-12


@pytest.mark.slow
def test_ensembles_have_the_same_members():
    found = {}
    for name, (length, time, force) in SCALES.items():
        own = system(name, "displacement")
        members = sb.perturbed_members(own, members=5, size=1e-3, seed=3)
        for kind, many in (
            ("hht", sb.integrate_ensemble(own, sb.HHT(-0.1), DT / time, STEPS * DT / time, members)),
            ("exact", sb.reference_ensemble(own, STEPS * DT / time, members)),
        ):
            ledger = many.ledger(4)
            found.setdefault(kind, {})[name] = {
                "count": many.impact_count.astype(float),
                "fraction": many.contact_fraction,
                "peak": many.peak_force * force,
                "impulse": many.impulse * force * time,
                "times": many.impacts.times * time,
                "energy": ledger.energy * force * length,
            }
    for kind in found:
        assert np.min(found[kind]["metres"]["count"]) >= 2
        same(found[kind], 1e-8)


def test_a_comparison_has_the_same_shares_and_the_same_seconds_and_newtons():
    found = {}
    for name, (_, time, force) in SCALES.items():
        own = system(name, "displacement")
        result = sb.compare(
            sb.integrate(own, sb.HHT(-0.1), DT / time, STEPS * DT / time), sb.reference(own, STEPS * DT / time)
        )
        found[name] = {
            key: np.array([value])
            for key, value in {
                "error": result.tip_error_rms,
                "lost": result.energy_lost,
                "lag": result.contacts[0].matching.median_delay * time,
                "first": result.contacts[0].matching.first_error * time,
                "peak": result.contacts[0].run_totals.peak_force * force,
                "impulse": result.contacts[0].reference_totals.impulse * force * time,
                "impacts": float(result.contacts[0].run.impacts),
            }.items()
        }
    same(found, 1e-5)  # errors are differences: what is left of eight digits of the motion


QUANTITY = {"frequency": (-1, 0, 0), "amplitude": (0, 1, 0), "stop-stiffness": (0, -1, 1), "stiffness": (0, 2, 1)}


@pytest.mark.parametrize("parameter", QUANTITY)
def test_a_sweep_is_asked_and_answered_in_the_cases_own_units(parameter):
    from stiffbeam.files.cases import Case

    powers = QUANTITY[parameter]
    middle = {"frequency": 150.0, "amplitude": 1e-3, "stop-stiffness": KAPPA, "stiffness": EI}[parameter]
    found = {}
    for name, (length, time, force) in SCALES.items():
        problem = dataclasses.replace(beam(name, loads=False), initial_displacement=None)
        case = Case(name, name, problem, 8, DT / time, 0.1 / time, ((sb.HHT(-0.1), "displacement"),))
        unit = time ** powers[0] * length ** powers[1] * force ** powers[2]
        values = [x * middle / unit for x in (0.9, 1.1)]
        records = sb.study("sweep", case, parameter=parameter, values=values, periods=2, transient=1)
        tips = np.array([row["tip"] for row in records.table.to_dict("records") if row["kind"] == "section"])
        contacts = [row for row in records.table.to_dict("records") if row["kind"] == "contact"]
        found[name] = {
            "tip": tips * length,
            "peak": np.array([row["peak_force"] for row in contacts]) * force,
            "count": np.array([float(row["count"]) for row in contacts]),
        }
        assert records.to_dict()["units"] == list(NAMES.get(name, ()))
    assert np.max(found["metres"]["count"]) >= 1
    same(found, 1e-7)
