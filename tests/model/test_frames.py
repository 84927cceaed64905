"""Nothing depends on where zero is, in which units one counts, or in which order things are said."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.references import solve


def oscillator(k, damping, stops, q0, v0=0.0, loads=(), offset=None, mass=1.0) -> sb.System:
    return sb.System.from_matrices(
        [[mass]], [[k]], damping=[[damping]] if damping else None, loads=[([1.0], f) for f in loads],
        contacts=[sb.Contact([1.0], stops, offset)], initial_displacement=[q0], initial_velocity=[v0],
    )  # fmt: skip


@pytest.mark.parametrize("damping", [0.0, 0.1])
@pytest.mark.parametrize("lower", [None, -0.5])
@pytest.mark.fast(1)
def test_the_exact_motion_is_the_same_wherever_zero_is(damping, lower):
    """A stop at 0 and the whole problem moved by 1: u + 1 under the constant load k. The gap of a stop that
    is met is zero; nothing may be measured by the position of the stop itself."""
    rng = np.random.default_rng(7)
    for _ in range(25):
        k, kappa = 10.0 ** rng.uniform(-1.0, 2.0), 10.0 ** rng.uniform(1.0, 4.0)
        drive, q0 = sb.Harmonic(rng.uniform(0.5, 5.0), rng.uniform(0.5, 8.0)), rng.uniform(-0.45, 0.0)
        here = oscillator(k, damping, sb.Stops(lower, 0.0, stiffness=kappa), q0, loads=[drive])
        moved = sb.Stops(None if lower is None else lower + 1.0, 1.0, stiffness=kappa)
        there = oscillator(k, damping, moved, q0 + 1.0, loads=[drive, sb.Constant(k)])
        a, b = (solve(system, 5.0, "exact", np.linspace(0.0, 5.0, 11), 0.0, None) for system in (here, there))
        first = min(4, a.impacts.count, b.impacts.count)  # before rounding has grown
        assert np.max(np.abs(a.impacts.times[:first] - b.impacts.times[:first]), initial=0.0) < 1e-8
        had = np.max(np.abs(a.energy.input)) + np.max(a.energy.energy)
        assert abs(a.energy.loss[-1]) < 1e-10 * had  # 1e3 switches of rounding at most


@pytest.mark.slow
def test_impulses_and_ledger_know_a_drive_faster_than_every_mode():
    """Peaks and impulses are integrals over panels, which must resolve the drive: against 2e6 samples."""
    stops = sb.Stops(upper=1.0, stiffness=20.0)
    system = oscillator(4.0, 0.0, stops, 0.0, loads=[sb.Harmonic(40.0, 60.0), sb.Constant(8.0)])
    ref = solve(system, 5.0, "exact", np.linspace(0.0, 5.0, 11), 0.0, None)
    t = np.linspace(0.0, 5.0, 2_000_001)
    force = np.abs(stops.force(ref.at(t)[0]))
    assert ref.contacts[0].impulse == pytest.approx(np.trapezoid(force, t), rel=1e-9)
    assert ref.contacts[0].peak_force == pytest.approx(np.max(force), rel=1e-9)
    assert abs(ref.energy.loss[-1]) < 1e-11 * np.max(ref.energy.energy)


def test_members_may_have_different_numbers_of_frequencies(monkeypatch):
    """A load at 6 beside a base at 5, 6, 7: two, one and two frequencies, on one thread and on two."""
    beam = sb.BeamProblem(
        stiffness=300.0,
        stops=sb.Stops(-0.1, 0.1, stiffness=5e6),
        base=sb.Harmonic(0.2, 10.0),
        loads=(sb.PointLoad(0.5, sb.Harmonic(1.0, 6.0)),),
    )
    system = sb.semidiscretise(beam, 8)
    members = sb.varied_members(system, frequency=[5.0, 6.0, 7.0])
    for threads in ("1", "2"):
        monkeypatch.setenv("STIFFBEAM_THREADS", threads)
        many = sb.integrate_ensemble(system, sb.HHT(), 1e-4, 0.3, members, every=10)
        for i, member in enumerate(members):
            assert np.array_equal(many.tip[i], sb.integrate(member, sb.HHT(), 1e-4, 0.3, every=10).tip)


def test_equal_numbers_are_equal_systems_and_callables_only_themselves():
    def system(f):
        return sb.System.from_matrices([[1.0]], [[4.0]], loads=[([1.0], f)], observe=[1.0])

    kinds = [sb.Harmonic(1, 10), sb.Harmonic(1.0, 10.0), sb.Harmonic(np.float64(1.0), np.float64(10.0))]
    assert len({system(f).fingerprint for f in kinds}) == 1
    assert len({system(eval(f"lambda t: {k} * t")).fingerprint for k in range(6)}) == 6


def test_totals_end_where_the_reference_does(table10):
    system = sb.semidiscretise(table10, 8)
    ref = sb.reference(system, 0.25)
    long, short = (sb.compare(sb.integrate(system, sb.HHT(), 1e-4, end), ref) for end in (0.5, 0.25))
    assert long.contacts[0].run_totals == short.contacts[0].run_totals
    # The ledger passes over whole blocks: the last steps of the shorter run are added up one by one.
    assert long.totals_energy_lost == pytest.approx(short.totals_energy_lost, rel=1e-11)


def test_a_callable_offset_is_asked_for_times_inside_the_run_only():
    asked = []

    def offset(t):
        asked.extend(np.ravel(t))
        return 0.1 * np.sqrt(t)

    system = oscillator(4.0, 0.0, sb.Stops(upper=0.3, stiffness=1e3), 0.0, v0=1.0, offset=offset)
    run = sb.integrate(system, sb.HHT(), 1e-2, 1.0)
    assert min(asked) >= 0.0
    assert max(asked) <= 1.0 + 1e-12
    t = run.t[20:]
    mass_rate = run.tip_velocity[20:] - 0.05 / np.sqrt(t)
    assert np.max(np.abs(mass_rate - run.states[1][20:, 0])) < 1e-6  # the difference quotient's truncation and rounding


@pytest.mark.slow
def test_a_slow_first_mode_is_no_rigid_motion():
    """800 cells given as matrices: w_max/w_1 = 4e6, and the square of that is near 1/eps; 1.8751^2 sqrt(300)."""
    from stiffbeam.model.modes import modes

    beam = sb.semidiscretise(sb.BeamProblem(stiffness=300.0), 800)
    given = sb.System.from_matrices(beam.mass, beam.stiffness, observe=np.eye(800)[-1])
    basis, chain = modes(given), 100.0 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    free = modes(sb.System.from_matrices(np.eye(3), chain, observe=np.eye(3)[-1]))
    assert basis is not None
    assert basis.omega[0] == pytest.approx(1.8751041**2 * np.sqrt(300.0), rel=0.05)
    assert free is not None
    assert np.allclose(free.omega, [0.0, 10.0, np.sqrt(300.0)], rtol=1e-12)
    assert free.omega[0] == 0.0
