"""Derivatives of exact motions: against closed forms, and against differences of exact flows on random systems."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.references.exact.piecewise import solve_exact
from stiffbeam.references.exact.rigid_reference import solve_rigid

KINDS = ("compliant", "damped", "kelvin-voigt", "rigid", "moving", "record")
WIDTHS = (3e-3, 3e-4, 3e-5)
ORDER_4 = ((1, 8.0 / 12.0), (-1, -8.0 / 12.0), (2, -1.0 / 12.0), (-2, 1.0 / 12.0))


def random_system(index: int, **values: float) -> tuple[sb.System, float, dict[str, float]]:
    """System ``index``, the end of its motion, and its parameters by path; values: other ones of these.

    A driven chain of one to four masses between stops on its last; every kind of contact in turn.
    """
    rng, kind = np.random.default_rng([39, index]), KINDS[index % len(KINDS)]
    n = int(rng.integers(1, 5))
    springs = 10.0 ** rng.uniform(0.5, 2.0, n)
    stiffness = np.diag(springs + np.append(springs[1:], 0.0)) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)
    mass = np.diag(rng.uniform(0.5, 2.0, n))
    first = float(np.sqrt(np.min(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)))
    damping = np.zeros((n, n)) if kind == "compliant" else rng.uniform(0.002, 0.1) * stiffness / first
    row = np.eye(n)[-1]
    parameters = {
        "contacts[0].stops.upper": rng.uniform(0.05, 0.3),
        "loads[0].time.amplitude": first**2 * rng.uniform(0.5, 1.5),
        "loads[0].time.frequency": first * rng.uniform(0.4, 2.5),
        "loads[0].time.phase": rng.uniform(0.0, 6.0),
        "v0[0]": first * rng.normal(),
    }
    if kind == "rigid":
        parameters["contacts[0].stops.restitution"] = rng.uniform(0.3, 0.95)
    else:
        parameters["contacts[0].stops.stiffness"] = first**2 * 10.0 ** rng.uniform(0.5, 3.5)
    if kind == "kelvin-voigt":
        kappa = parameters["contacts[0].stops.stiffness"]
        parameters["contacts[0].stops.damping"] = np.sqrt(kappa) * 10.0 ** rng.uniform(-1.5, 0.0)
    if kind == "moving":
        parameters |= {
            "contacts[0].offset.amplitude": 0.05,
            "contacts[0].offset.frequency": first * rng.uniform(0.5, 3),
        }
    t_end = float(2.0 * np.pi / first * rng.uniform(1.0, 2.0))
    samples = first**2 * rng.normal(size=9)
    if kind == "record":
        parameters["loads[1].time.values[3]"] = samples[3]
    assert values.keys() <= parameters.keys()
    at = parameters | values
    stops = {key.split(".")[-1]: x for key, x in at.items() if ".stops." in key}
    if kind == "rigid":
        stops["stiffness"] = np.inf
    offset = (
        sb.Harmonic(at["contacts[0].offset.amplitude"], at["contacts[0].offset.frequency"], 0.3)
        if kind == "moving"
        else None
    )
    wave = (at[f"loads[0].time.{name}"] for name in ("amplitude", "frequency", "phase"))
    loads = [(rng.normal(size=n), sb.Harmonic(*wave))]
    if kind == "record":
        samples[3] = at["loads[1].time.values[3]"]
        times = np.linspace(0.0, t_end, 9)
        loads.append((rng.normal(size=n), sb.Sampled(times, samples, str(rng.choice(["linear", "cubic"])))))
    v0 = first * rng.normal(size=n)
    v0[0] = at["v0[0]"]
    system = sb.System.from_matrices(
        mass, stiffness, damping, loads, [sb.Contact(row, sb.Stops(-0.4, **stops), offset)], initial_velocity=v0
    )
    return system, t_end, parameters


def exact(system: sb.System, t_end: float, t: np.ndarray) -> sb.Reference:
    """The exact solution without the copies that tell its horizon."""
    if any(contact.stops.rigid for contact in system.contacts):
        return solve_rigid(system, t_end, t, trusted=False)
    return solve_exact(system, t_end, t)


SEEN = {
    "tip": (lambda r: r.tip, lambda d: d.tip),
    "velocity": (lambda r: r.tip_velocity, lambda d: d.tip_velocity),
    "energy": (lambda r: r.energy.energy, lambda d: d.energy),
    "impact times": (lambda r: r.impacts.times, lambda d: d.impact_times),
    "impulses": (lambda r: r.impacts.impulses, lambda d: d.impulses),
    "peaks": (lambda r: r.impacts.peaks, lambda d: d.peaks),
}


def distances(index: int, count: int) -> tuple[float, float, int]:
    """Distance of derivatives to differences of order 4, how well two widths of these agree, and how many compared.

    In ``count`` of the system's parameters. Every distance is at the best of the widths, relative to the largest
    derivative of that quantity and to its size over the parameter's, and no smaller than a thousandth of that.
    """
    system, t_end, parameters = random_system(index)
    t = np.linspace(0.0, t_end, 6)[1:]
    reference = exact(system, t_end, t)
    paths = np.random.default_rng(index).permutation(list(parameters))[:count].tolist()
    change = reference.derivative(paths)
    worst, compared = 0.0, 0
    for p, path in enumerate(paths):
        value = parameters[path]
        scale = max(abs(value), 0.1)
        errors: dict[str, list[np.ndarray]] = {name: [] for name in SEEN}
        for width in WIDTHS:
            h = width * scale
            runs = {k: exact(random_system(index, **{path: value + k * h})[0], t_end, t) for k, _ in ORDER_4}
            for name, (read, ours) in SEEN.items():
                arrays = {k: np.asarray(read(run), float) for k, run in runs.items()}
                here, wanted = np.asarray(read(reference), float), ours(change)[:, p]
                if any(x.shape != here.shape for x in arrays.values()):
                    continue  # an impact more or less at this width
                difference = sum(weight * arrays[k] for k, weight in ORDER_4) / h
                known = np.isfinite(difference) & np.isfinite(wanted)
                size = (
                    np.max(np.abs(wanted[known]), initial=0.0) + 1e-3 * np.max(np.abs(here[known]), initial=0.0) / scale
                )
                errors[name].append(np.where(known, np.abs(difference - wanted) / max(size, 1e-300), np.inf))
        for found in errors.values():
            if found:
                best = np.min(found, axis=0)
                best = best[np.isfinite(best)]
                worst, compared = max(worst, float(np.max(best, initial=0.0))), compared + len(best)
    return worst, compared


@pytest.mark.parametrize(
    ("first", "count", "parameters"),
    [
        (0, 6, 1),
        pytest.param(0, 40, 1, marks=pytest.mark.slow),
        pytest.param(0, 2000, 2, marks=pytest.mark.campaign),
    ],
)
def test_derivatives_are_those_of_differences_of_exact_flows(first, count, parameters):
    """Differences of order 4 lose rounding times the growth of neighbours over the width: most agree to 1e-9."""
    found = [distances(index, parameters) for index in range(first, first + count)]
    errors = np.array([error for error, _ in found])
    assert np.all(errors < 1e-4), np.flatnonzero(errors >= 1e-4)
    assert np.mean(errors < 1e-8) > 0.9
    assert np.median(errors) < 1e-9
    assert sum(compared for _, compared in found) > 15 * count
