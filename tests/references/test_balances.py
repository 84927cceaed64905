"""What is said of contacts and energy, against the balances of momentum and of energy, which read no law of contact.

    M (q'(t) - q'(0)) + C (q(t) - q(0)) + integral (K q - f) = sum over contacts of row J_c(t)

gives the impulses J of independent contacts from the motion alone. A contact only pushes, so that the integral of
|sigma| is the variation of J. The integrands are continuous: the trapezoidal rule on steps h is off by less than
T h^2/12 times their largest second difference over h^2, kinks of the velocity included.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from law_systems import kelvin_voigt_system, random_system, rigid_system
from scipy.integrate import quad
from systems import one_mass

import stiffbeam as sb
from stiffbeam.references import solve

T, SAMPLES = 3.0, 6_001
ADAPTIVE = ("ida", "cvode", "dop853", "cvode-adams", "radau", "lsoda")


def integral(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """From 0 to each time, along the first axis."""
    areas = 0.5 * np.diff(t)[:, None] * (values[1:] + values[:-1]).reshape(len(t) - 1, -1)
    return np.concatenate([np.zeros((1, areas.shape[1])), np.cumsum(areas, axis=0)])


def sigma(contact: sb.Contact, u: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """|sigma| and the stored energy, as the law is printed."""
    force, energy, stops = np.zeros_like(u), np.zeros_like(u), contact.stops
    for side, stop in ((1.0, stops.upper), (-1.0, stops.lower)):
        if stop is not None:
            d, to = np.maximum(side * (u - stop), 0.0), side * rate
            pressed = stops.stiffness * d**stops.exponent * (1.0 + stops.dissipation * to) + stops.damping * to
            force += np.maximum(pressed, 0.0) * (d > 0.0)
            energy += stops.stiffness * d ** (stops.exponent + 1.0) / (stops.exponent + 1.0)
    return force, energy


def holds(system: sb.System, method: str, accuracy: float) -> None:
    """``accuracy``: of the motion, in units of the largest numbers compared."""
    t = np.linspace(0.0, T, SAMPLES)
    ref = solve(system, T, method, t, 1e-11, None)
    (q, v), ledger, rows = ref.states, ref.energy, np.array([c.row for c in system.contacts])
    f = sum(np.outer(load.value(t), p) for p, load in system.loads)
    bend = q @ system.stiffness - f
    area = integral(t, bend)
    gained = (v - system.v0) @ system.mass + (q - system.q0) @ system.damping + area
    J = np.linalg.lstsq(rows.T, gained.T, rcond=None)[0].T
    rule = T / 12.0 * np.max(np.abs(np.diff(bend, 2, axis=0))) + accuracy * (1.0 + np.max(np.abs(J)))
    assert np.max(np.abs(J @ rows - gained)) < rule  # nothing but the contacts pushes
    moved, stored = np.zeros(len(t)), np.zeros(len(t))
    for c, (contact, record) in enumerate(zip(system.contacts, ref.contacts, strict=True)):
        o, o_rate = (0.0, 0.0) if contact.offset is None else (contact.offset.value(t), contact.offset.rate(t))
        force, energy = sigma(contact, q @ contact.row + o, v @ contact.row + o_rate)
        stored += energy
        given = np.abs(np.diff(J[:, c]))
        moved[1:] -= np.cumsum(0.5 * np.diff(J[:, c]) * (o_rate[1:] + o_rate[:-1]) if contact.offset else 0.0 * given)
        impacts = record.impacts
        assert record.impulse == pytest.approx(np.sum(given), abs=len(t) ** 0.5 * rule)
        assert record.fraction == pytest.approx(np.mean(force > 0.0), abs=2.0 * (impacts.count + 1) / SAMPLES)
        peaks = [0.0]
        for begin, end, peak, impulse in zip(impacts.times, impacts.ends, impacts.peaks, impacts.impulses, strict=True):
            inside = np.flatnonzero((t > begin) & ~(t >= end))
            if len(inside) < 3:
                continue
            F = force[inside]
            top = int(np.argmax(F))
            peaks.append(float(F[top]))
            if np.isnan(end):
                assert np.isnan(peak)
                assert np.isnan(impulse)
                continue
            nearby = np.max(np.abs(np.diff(F[max(0, top - 2) : top + 3])))  # what lies between two samples
            assert -accuracy * F[top] < peak - F[top] < nearby + accuracy * F[top]
            cut = 2.0 * np.max(F) * t[1]  # the ends lie between two samples
            assert impulse == pytest.approx(np.sum(given[inside[:-1]]), abs=rule + cut)
        assert record.peak_force > max(peaks) * (1.0 - accuracy)
    kinetic, elastic = (0.5 * np.sum(x * (x @ y), axis=1) for x, y in ((v, system.mass), (q, system.stiffness)))
    powers = np.stack([np.sum(f * v, axis=1), np.sum(v * (v @ system.damping), axis=1)], axis=1)
    work = integral(t, powers)
    given, viscous, energy = work[:, 0] + moved, work[:, 1], kinetic + elastic + stored
    size = max(float(np.max(np.abs(x))) for x in (energy, given, viscous))
    slack = T / 12.0 * np.max(np.abs(np.diff(powers, 2, axis=0))) + 10.0 * rule + accuracy * size
    for own, true in (
        (ledger.kinetic, kinetic), (ledger.elastic, elastic), (ledger.stops, stored), (ledger.input, given),
        (ledger.viscous, viscous), (ledger.stop_dissipation, energy[0] + given - viscous - energy),
    ):  # fmt: skip
        assert np.max(np.abs(own - true)) < slack


def pressed_at_the_start(system: sb.System) -> sb.System:
    """The same from within the first contact's stop."""
    stops, n = system.contacts[0].stops, system.size
    inside = 1.2 * stops.upper if stops.upper is not None else 1.2 * stops.lower
    return replace(system, q0=inside * np.eye(n)[0])


@pytest.mark.parametrize("seed", [0, 4, 1, 2, 6, 3, 7, 5, 8, 11, 9])  # Radau's is slow
@pytest.mark.fast(2)
def test_adaptive_solvers_on_every_law(seed):
    system = random_system(seed)
    holds(pressed_at_the_start(system) if seed % 3 == 1 else system, ADAPTIVE[seed % 6], 1e-7)


@pytest.mark.parametrize("method", ["exact", "multiprecision"])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.fast(1)
def test_exact_solutions_on_damped_stops(method, seed):
    system = kelvin_voigt_system(seed)
    holds(pressed_at_the_start(system) if seed % 2 else system, method, 1e-10)


@pytest.mark.fast(1)
@pytest.mark.parametrize("method", ["cvode", "ida"])
def test_the_ledger_is_as_accurate_as_the_motion_where_a_stop_lets_go(method):
    """A stop that has let go holds energy until the gap opens, of which the motion, whose error steps them, knows
    nothing: what it takes in all is integrated, not what it dissipates."""
    stops = sb.Stops(lower=-0.07, stiffness=12.0, dissipation=1.3)
    system = one_mass(5.0, stops, load=sb.Harmonic(1.5, 3.0), q=-0.07, v=2.0)
    ledger = sb.reference(system, 4.0, method).energy
    assert np.max(np.abs(ledger.loss)) < 1e-6 * np.max(ledger.energy)
    assert np.min(np.diff(ledger.stop_dissipation)) > -1e-6 * np.max(ledger.energy)
    assert ledger.stop_dissipation[-1] > 0.1 * ledger.energy[0]


@pytest.mark.parametrize("seed", range(80))
@pytest.mark.fast(4, slow=8)
def test_impulses_of_rigid_stops_are_the_change_of_momentum(seed):
    """M (q'(T) - q'(0)) - sum p int f = sum row J of bodies that nothing else holds, J > 0 of lower stops: impacts,
    chatter and persistent contacts, to rounding."""
    system = rigid_system(seed)
    lower = [replace(contact, stops=replace(contact.stops, upper=None)) for contact in system.contacts]
    free = replace(system, stiffness=0.0 * system.stiffness, damping=0.0 * system.damping, contacts=lower)
    run = sb.reference(free, T)
    given = sum(p * quad(load.value, 0.0, T)[0] for p, load in free.loads)
    gained = free.mass @ (run.states[1][-1] - free.v0)
    pushed = sum(contact.row * record.impulse for contact, record in zip(free.contacts, run.contacts, strict=True))
    np.testing.assert_allclose(pushed, gained - given, atol=1e-10 * np.max(np.abs([gained, given])))
