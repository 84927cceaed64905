"""The march in blocks is the plain loop: every scheme, treatment and law, in modes and in matrices, with its records.

The loop is ``oracles/plain_march.py``: the scheme's own step in long double, forces by bisection. The definitions of
records are written out here: impacts, peaks, impulses and the energy balance of all steps.
"""

from __future__ import annotations

import pickle
from dataclasses import fields, replace

import numpy as np
import plain_march
import pytest
from scipy.interpolate import CubicHermiteSpline
from systems import MOVING, chain, one_mass, random_chain, rotor, stop, with_stops

import stiffbeam as sb
from stiffbeam.march import block_march
from stiffbeam.march.propagator import Coordinates
from stiffbeam.march.treatment import TREATMENTS
from stiffbeam.model.modes import modes
from stiffbeam.model.time_functions import evaluate
from stiffbeam.schemes import PrintedSigma, UnweightedHHT, registered
from stiffbeam.trajectory.recorder import sampled_record
from stiffbeam.trajectory.records import Ledger, step_ledger

SCHEMES = [*registered(), UnweightedHHT(-0.1), PrintedSigma()]
PAIRS = [(scheme, name) for scheme in SCHEMES for name in TREATMENTS if TREATMENTS[name].form_of(scheme)]
SMOOTH = [{}, {}, {"exponent": 1.5}]
EPS = np.finfo(float).eps


def impacts_of(t, u, v, stops, forces, means, end_forces):
    """(times, ends, sides, peaks, impulses) of the definition: chi_n != 0 and chi_n != chi_{n-1}; the contact at t = 0
    first, with time 0. A damped stop presses where its node finds a force. Times by SciPy's Hermite cubics.

    forces: at the steps; means: over the steps, or None; end_forces: what nodes found at the ends, or None.
    """
    chi = stops.state(u, v).astype(int)
    if end_forces is not None and stops.law.jumps:
        chi[1:] = -np.sign(end_forces)
    if not chi[0]:  # a start on a stop that does not leave it is contact from t = 0
        chi[0] = int(u[0] == stops.law.g2 and v[0] >= 0.0) - int(u[0] == stops.law.g1 and v[0] <= 0.0)
    curve, rows, begun = CubicHermiteSpline(t, u, v), [], 0 if chi[0] else None

    def crossing(k, side):
        inside = [s for s in curve.solve(stops.sides[side], extrapolate=False) if t[k - 1] < s <= t[k]]
        return min(inside, default=np.nan)

    for k in range(1, len(t) + 1):
        if begun is not None and (k == len(t) or chi[k] != chi[begun]):
            size, weights = np.abs(forces[begun:k]), np.diff(t, prepend=t[0])[begun:k].copy()
            if begun == 0:
                weights[0] = 0.5 * (t[1] - t[0])
            impulse = np.sum(size * weights)
            if means is not None:  # of the step that enters to that which leaves
                until = k + (k < len(t) and chi[k] == 0)
                impulse = np.sum(np.abs(means[max(begun, 1) - 1 : until - 1])) * (t[1] - t[0])
            ended = k < len(t)
            rows.append((crossing(begun, chi[begun]) if begun else 0.0, crossing(k, chi[begun]) if ended else np.nan,
                         chi[begun], np.max(size), impulse, ended))  # fmt: skip
            begun = None
        if k < len(t) and chi[k] and chi[k] != chi[k - 1]:
            begun = k
    return rows, chi


def assert_records(run, t, tips, end_forces, treatment, rtol):
    """Every contact's record is that of positions and velocities ``tips`` [(u, v)] at all steps."""
    for c, (record, (u, v)) in enumerate(zip(run.contacts, tips, strict=True)):
        stops, means = record.stops, end_forces[:, c] if treatment == "conserving" else None
        at_nodes = None if means is not None or end_forces is None else end_forces[:, c]
        forces = stops.force(u, v)
        if at_nodes is not None and stops.law.jumps:
            forces[1:] = at_nodes
        rows, chi = impacts_of(t, u, v, stops, forces, means, at_nodes)
        listed, _ = record.impacts.listed()
        rows = [row for row in rows if row[4] > 0.0 or row[0] > 0.0]
        assert [row[2] for row in rows] == listed.stops.tolist()
        for row, found in zip(
            rows, zip(listed.times, listed.ends, listed.peaks, listed.impulses, strict=True), strict=True
        ):
            time, end, _, peak, impulse, ended = row
            if not stops.law.damps:
                assert found[0] == pytest.approx(time, abs=1e-6 * t[1] + 1e-12)
                assert found[1] == pytest.approx(end, abs=1e-6 * t[1] + 1e-12, nan_ok=True)
            if ended:
                assert found[2:] == pytest.approx((peak, impulse), rel=rtol)
        dt, size = t[1] - t[0], np.abs(forces)
        assert record.fraction == np.mean(chi[1:] != 0)
        assert record.peak_force == pytest.approx(np.max(size), rel=rtol)
        total = np.sum(np.abs(means)) * dt if means is not None else np.trapezoid(size, dx=dt)
        assert record.impulse == pytest.approx(total, rel=rtol)


def assert_is_loop(run, system, scheme, dt, steps, contact, tolerance, every=1):
    """A run is the plain loop: positions, velocities, states, records and energy."""
    q, v, F = plain_march.states(system, scheme, dt, steps, contact)
    q, v, F = (np.asarray(x, float) for x in (q, v, F))
    t, rows = np.arange(steps + 1) * dt, [(row, offset) for row, offset in system.channels]
    tips = [(q @ row + evaluate(o, t), v @ row + evaluate(o, t, 1)) for row, o in rows]
    scale, speed = np.max(np.abs(q)), np.max(np.abs(v))
    assert np.max(np.abs(run.states[0] - q[::every])) < tolerance * scale
    assert np.max(np.abs(run.states[1] - v[::every])) < 1e3 * tolerance * speed
    for seen, (u, rate), (row, _) in zip([*run.contacts, run][: len(tips)], tips, rows, strict=True):
        position, velocity = (seen.tip, seen.tip_velocity) if seen is run else (seen.position, seen.velocity)
        reach = scale * np.sum(np.abs(row)) + np.max(np.abs(u))
        assert np.max(np.abs(position - u[::every])) < tolerance * reach
        assert np.max(np.abs(velocity - rate[::every])) < 1e3 * tolerance * np.max(np.abs(rate)) + 1e-9
    ends = F if system.contacts and scheme.nodes[-1] == 1.0 and contact != "extrapolated" else None
    assert_records(run, t, tips[: len(system.contacts)], ends, contact, 1e5 * tolerance)


@pytest.mark.parametrize(("scheme", "contact"), PAIRS, ids=str)
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.fast(44, slow=40)
def test_a_random_chain(scheme, contact, seed):
    """Any number of contacts and loads, damped or not; contact that dissipates is for the implicit treatment."""
    seed = 8 * PAIRS.index((scheme, contact)) + seed
    system, slow = random_chain(seed) if contact == "implicit" else random_chain(seed, SMOOTH, 0.1)
    dt, steps, every = (0.005 if contact == "extrapolated" else 0.02) / slow, 70, (1, 7)[seed % 2]
    try:
        run = sb.integrate(system, scheme, dt, steps * dt, contact, every=every)
    except (sb.InputError, sb.Diverged, sb.SolverFailure) as refused:
        # A law that jumps at a node that no force moves; extrapolated forces that grow without end.
        assert contact == "extrapolated" or "stops" in str(refused)  # noqa: PT017
        return
    assert run.provenance["march"] == ("dense blocks" if modes(system).coupled else "modal blocks")
    if np.max(np.abs(run.tip)) < 1e3:
        assert_is_loop(run, system, scheme, dt, steps, contact, 1e-7 if contact == "extrapolated" else 1e-10, every)


def test_a_stop_that_moves_by_a_multiple_of_a_record():
    system, scheme = chain(3, stop(offset=sb.Superposition(terms=[(-2.0, MOVING)]))), sb.HHT(-0.1)
    assert_is_loop(sb.integrate(system, scheme, 1e-3, 0.5), system, scheme, 1e-3, 500, "implicit", 1e-10)


BEAM = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.002, 0.002, stiffness=1e5), base=sb.Harmonic(0.2, 10.0))
LAWS = [{"damping": 300.0}, {"dissipation": 1.0}, {"exponent": 1.5}]


def systems():
    """A beam's factor of the stiffness, laws under every treatment, damping that is not symmetric, nodes that go on."""
    yield "velocity-curvature", sb.semidiscretise(BEAM, 8, "velocity-curvature"), 1e-3
    for law in LAWS:
        stops = sb.Stops(-0.002, 0.002, stiffness=1e5, **law)
        yield str(law), sb.semidiscretise(replace(BEAM, stops=stops), 6), 1e-3
    ends = [sb.Contact(row, sb.Stops(upper=0.05, stiffness=1e5)) for row in ([1.0, -1.0], [1.0, 1.0])]
    bar, start = (np.diag([1.0, 0.05]), np.diag([50.0, 5.0])), {"initial_displacement": [0.0, -0.001]}
    bar = sb.System.from_matrices(*bar, contacts=ends, initial_velocity=[1.0, 0.0], **start)
    yield "one end of a bar closes the other", bar, 2e-3
    pressed = {"loads": (([3.0, 1.0, 0.0, 0.0], sb.Constant(40.0)),), "v0": np.zeros(4)}  # against three of its stops
    yield "rotor on its stops", replace(rotor(), **pressed), 0.05


@pytest.mark.parametrize(("scheme", "contact"), PAIRS, ids=str)
@pytest.mark.parametrize(("name", "system", "dt"), list(systems()), ids=lambda x: x if isinstance(x, str) else "")
@pytest.mark.fast(30, slow=30)
def test_a_system(name, system, dt, scheme, contact):
    steps = {1e-3: 150, 2e-3: 250}.get(dt, 20)
    try:
        run = sb.integrate(system, scheme, dt, steps * dt, contact)
    except (sb.InputError, sb.Diverged):
        assert contact != "implicit"
        return
    assert run.provenance["march"] == ("dense blocks" if "rotor" in name else "modal blocks")
    if np.max(np.abs(run.tip)) < 1e3:
        assert any(c.impulse for c in run.contacts)
        assert_is_loop(run, system, scheme, dt, steps, contact, 1e-6 if contact == "extrapolated" else 2e-9)


@pytest.mark.parametrize("scheme", SCHEMES, ids=str)
@pytest.mark.fast(2, slow=6)
def test_blocks_round_table_10_by_a_bit_a_step(scheme):
    """Through five impacts or more, as if every step rounded the same way; four times that for what they magnify."""
    case = sb.paper_case(10)
    system = sb.semidiscretise(case.problem, case.cells)
    dt, steps = 4e-5, 1800
    run = sb.integrate(system, scheme, dt, steps * dt)
    assert run.impacts.count >= 5
    basis = modes(system)  # the loop in the same modes, whose rounding is not the march's
    rows = [sb.Contact(basis.force(c.row), c.stops) for c in system.contacts]
    modal = sb.System.from_matrices(
        np.eye(25), np.diag(basis.omega**2), None, [(basis.force(p), f) for p, f in system.loads], rows,
        initial_displacement=basis.to_modal(system.q0), initial_velocity=basis.to_modal(system.v0),
    )  # fmt: skip
    exact = plain_march.states(modal, scheme, dt, steps)[0] @ rows[0].row
    assert np.max(np.abs(run.tip - exact)) < 4 * steps * EPS * np.max(np.abs(run.tip))


@pytest.mark.parametrize("scheme", [sb.Trapezoidal(), sb.BDF2(), sb.SDIRK()], ids=str)
@pytest.mark.parametrize(
    "given",
    [{"k": 1.0, "damping": 2.0}, {"k": 1.0, "load": sb.Harmonic(0.1, 1.0)}, {"k": 0.0, "load": sb.Constant(0.4)},
     {"k": 1e-11, "load": sb.Harmonic(1.0, 20.0)}],
    ids=["critically damped", "resonance", "free", "nearly free"],
)  # fmt: skip
@pytest.mark.fast(3)
def test_modes_that_drift_meet_or_resonate(scheme, given):
    given = {"load": sb.Harmonic(0.5, 0.3)} | given
    system = one_mass(given.pop("k"), sb.Stops(upper=1.0, stiffness=100.0), v=1.5, **given)
    run = sb.integrate(system, scheme, 2e-2, 20.0)
    exact = plain_march.states(system, scheme, 2e-2, 1000)[0][:, 0]
    assert run.impacts.count > 0 or system.damped
    assert np.max(np.abs(run.tip - exact)) < 1e-11 * np.max(np.abs(exact))


# ------------------------------------------------------------------ blocks, outputs, stretches


def same_runs(a, b, rtol=1e-11):
    """Equal to rounding: outputs, records, energy."""
    for x, y in ((a.tip, b.tip), (a.tip_velocity, b.tip_velocity), *zip(a.states, b.states, strict=True)):
        assert np.max(np.abs(x - y)) <= 100 * rtol * np.max(np.abs(y))
    for one, other in zip(a.contacts, b.contacts, strict=True):
        for name in ("times", "ends", "peaks", "impulses"):
            left, right = (getattr(x.impacts, name) for x in (one, other))
            assert np.allclose(left, right, rtol=1e3 * rtol, atol=1e3 * rtol, equal_nan=True)
        for name in ("fraction", "peak_force", "impulse"):
            assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e3 * rtol)
    for field in fields(Ledger)[1:]:
        left, right = getattr(a.energy, field.name), getattr(b.energy, field.name)
        assert np.max(np.abs(left - right)) <= 1e3 * rtol * np.max(np.abs(b.energy.energy) + np.abs(b.energy.input))


@pytest.mark.parametrize("law", [{}, *LAWS], ids=str)
@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK()], ids=str)
@pytest.mark.fast(6)
def test_blocks_and_stretches_of_any_length_leave_no_trace(scheme, law, monkeypatch):
    """A contact may begin in one and end in another; the list of impacts may be full in between."""
    stops = sb.Stops(-0.002, 0.002, stiffness=1e5, **law)
    system = sb.semidiscretise(replace(BEAM, stops=stops), 6)
    whole = sb.integrate(system, scheme, 1e-3, 0.33)
    for length in (1, 2, 8):
        with monkeypatch.context() as patch:
            patch.setattr("stiffbeam.march.integrate.block_length", lambda *_, length=length: length)
            same_runs(sb.integrate(system, scheme, 1e-3, 0.33), whole)
    monkeypatch.setattr(block_march, "STEPS_PER_CALL", 1)
    monkeypatch.setattr(block_march, "STEPS_REPLAYED", 32)
    same_runs(sb.integrate(system, scheme, 1e-3, 0.33), whole)


def test_a_short_run_is_not_worth_long_blocks():
    """Ten steps of 25 unknowns are done before the powers of one are made, a million are not."""
    system = sb.semidiscretise(BEAM, 25)
    coordinates = Coordinates(replace(system, damping=np.diag(np.arange(25.0))), None)
    assert [block_march.block_length(coordinates, sb.HHT(-0.1), steps) for steps in (10, 1_000_000)] == [1, 32]


def test_every_thins_the_output_and_nothing_else(table10):
    system = sb.semidiscretise(table10, 25)
    full, again = (sb.integrate(system, sb.SDIRK(), 1e-4, 0.5) for _ in range(2))
    assert np.array_equal(full.tip, again.tip)
    # The states are made by a second march: they must be those of the first, through the chaos.
    assert np.max(np.abs(full.states[0][:, -1] - full.tip)) < 1e-12
    for every in (7, 50):
        thin = sb.integrate(system, sb.SDIRK(), 1e-4, 0.5, every=every)
        for name in ("t", "tip"):
            assert np.array_equal(getattr(thin, name), getattr(full, name)[::every])
        assert np.allclose(thin.tip_velocity, full.tip_velocity[::every], rtol=0, atol=1e-12)
        assert np.array_equal(thin.impacts.times, full.impacts.times)
        assert thin.contacts[0].peak_force == full.contacts[0].peak_force
        assert np.array_equal(thin.energy.loss, full.energy.loss[::every])
        assert np.array_equal(thin.states[0], full.states[0][::every])
    assert pickle.loads(pickle.dumps(full)).pieces is not None  # as a call, not as all states
    u = full.displacement([0.0, 1.0])
    assert np.allclose(u, np.stack([0.2 * np.sin(10 * full.t), full.tip], axis=1), atol=1e-12)


@pytest.mark.parametrize("damping", [None, [[0.3, 0.1], [0.1, 0.0445]]], ids=["modal", "dense"])
def test_a_node_beyond_the_step_sees_the_load_there_in_the_last_step_too(damping):
    """SDIRK(0.3) asks for loads at 2.67 dt: a run that ends at t = 2 is the start of one that goes on."""
    times, K = np.arange(0.0, 3.5, 0.5), [[4.0, -1.0], [-1.0, 3.0]]
    made = lambda load: sb.System.from_matrices(np.eye(2), K, damping, [([1.0, 0.0], load)], observe=[1.0, 0.0])  # noqa: E731
    with pytest.warns(UserWarning, match="beyond the step"):
        scheme = sb.SDIRK(0.3)
    for load in (sb.Sampled(times, [0.0, 1.0, -1.0, 2.0, 5.0, -20.0, 7.0]), lambda t: np.asarray(t) ** 2):
        short, long = (sb.integrate(made(load), scheme, 0.1, t_end) for t_end in (2.0, 2.5))
        assert np.allclose(short.tip, long.tip[:21], rtol=0.0, atol=1e-13)
    with pytest.raises(sb.InputError, match="t"):
        sb.integrate(made(sb.Sampled(times[:5], [0.0, 1.0, -1.0, 2.0, 5.0])), scheme, 0.1, 2.0)


def test_memory_does_not_grow_with_the_steps():
    import tracemalloc

    system, peaks = one_mass(1.0, sb.Stops(upper=1.0, stiffness=100.0), damping=0.1, v=1.5), []
    for t_end in (100.0, 100.0, 1000.0, 1000.0):
        tracemalloc.start()
        assert len(sb.integrate(system, sb.HHT(-0.1), 1e-3, t_end, every=round(100 * t_end)).t) == 11
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[3] < 1.5 * peaks[1]  # of a plan that was made before


def test_a_flight_over_the_whole_gap_inside_one_step_counts_the_second_stop():
    """u jumps from the upper to the lower stop: chi changes sign and the crossing of the lower is timed."""
    t = np.arange(5) * 0.5
    u, v = 1.2 * np.cos(2 * np.pi * t), -2.4 * np.pi * np.sin(2 * np.pi * t)
    impacts = sampled_record(t, u, v, sb.Stops(-1.0, 1.0, stiffness=1.0)).impacts
    assert list(impacts.stops) == [-1, 1, -1, 1]
    assert np.all((impacts.times > t[:-1]) & (impacts.times < t[1:]))


# ------------------------------------------------------------------ overflow, arguments


@pytest.mark.parametrize("scheme", [sb.BDF2(), sb.HHT(-0.1), sb.SDIRK(nystrom=True)], ids=str)
def test_an_overflow_names_scheme_time_and_remedy(scheme):
    """Extrapolated contact overflows on Table 11 with dt = 2.5e-4, implicit contact does not."""
    case = sb.paper_case(11)
    system = sb.semidiscretise(case.problem, case.cells)
    with pytest.raises(sb.Diverged, match="implicit") as caught:
        sb.integrate(system, scheme, 2.5e-4, case.t_end, "extrapolated")
    assert 0.0 < caught.value.t < case.t_end
    assert str(scheme) in str(caught.value)
    assert np.all(np.isfinite(sb.integrate(system, scheme, 2.5e-4, case.t_end).tip))


@pytest.mark.filterwarnings("ignore:invalid value")
def test_extrapolated_forces_of_several_stops_overflow_as_those_of_one():
    """The sum of squared forces overflows long before a position does: that is no failure of a search."""
    contacts = [sb.Contact(np.ones(1), sb.Stops(lower=-0.1, stiffness=1e4, exponent=p)) for p in (1.5, 3.0)]
    system = sb.System.from_matrices([[1.0]], [[1.0]], contacts=contacts, initial_velocity=[-9.0])
    with pytest.raises(sb.Diverged, match="implicit contact"):
        sb.integrate(system, sb.Trapezoidal(), 0.1, 20.0, contact="extrapolated")


@pytest.mark.parametrize(
    ("given", "words"),
    [({"dt": -1.0}, "dt"), ({"t_end": 0.0}, "t_end"), ({"every": 0}, "every"), ({"contact": "penalty"}, "contact"),
     ({"dt": 1.0001e-4, "t_end": 0.1}, r"0\.0001$")],
)  # fmt: skip
def test_bad_arguments_are_named(given, words):
    with pytest.raises(sb.InputError, match=words):
        sb.integrate(sb.semidiscretise(BEAM, 8), sb.HHT(), **({"dt": 1e-4, "t_end": 0.01} | given))


# ------------------------------------------------------------------ energy


def assert_balance(run):
    """The run's own ledger, compiled and in modes, is that of its states, written out and by ``step_ledger``.

    Each entry is a sum over at most ``steps`` terms of the size of the energy, each with a few roundings for each
    coordinate; those of a scheme that goes round in the same rounding errors add up linearly.
    """
    system, own = run.system, run.energy
    t, q, v = (np.concatenate(x) for x in zip(*((p[0], p[1], p[2]) for p in run.pieces()), strict=True))
    t, first = np.unique(t, return_index=True)
    q, v = q[first], v[first]
    energy = 0.5 * np.sum(v * (v @ system.mass) + q * (q @ system.stiffness), axis=1)
    f, dq, dt = system.load(t), np.diff(q, axis=0), t[1] - t[0]
    work = np.sum(0.5 * (f[1:] + f[:-1]) * dq, axis=1)
    dashpots = np.sum(dq * (dq @ system.damping), axis=1) / dt
    for c in system.contacts:
        o = evaluate(c.offset, t)
        u, rate = q @ c.row + o, v @ c.row + evaluate(c.offset, t, 1)
        energy = energy + c.stops.energy(u)
        if c.offset is not None and not c.stops.law.jumps:
            force = c.stops.force(u, rate)
            work = work - 0.5 * (force[1:] + force[:-1]) * np.diff(o)
    at = np.searchsorted(t, own.t - 0.5 * dt)
    total = lambda x: np.concatenate([[0.0], np.cumsum(x)])[at]  # noqa: E731
    size = np.max(np.abs(energy)) + np.max(np.abs(total(work)))
    rounding = EPS * 10 * system.size * run.work.steps * size
    assert np.max(np.abs(own.energy - energy[at])) <= rounding
    assert np.max(np.abs(own.viscous - total(dashpots))) <= rounding
    if not any(c.stops.law.jumps and c.offset is not None for c in system.contacts):
        assert np.max(np.abs(own.input - total(work))) <= rounding
    assert np.max(np.abs(own.kinetic + own.elastic + own.stops - own.energy)) <= rounding
    balance = own.energy - own.energy[0] - own.input + own.viscous + own.stop_dissipation + own.loss
    assert np.max(np.abs(balance)) <= rounding
    assert np.max(np.abs(own.loss - own.loss_in_contact - own.loss_without_contact)) <= rounding
    other = step_ledger(system, run.pieces(), run.t)
    for field in fields(Ledger)[1:]:
        assert np.max(np.abs(getattr(own, field.name) - getattr(other, field.name))) <= rounding, field.name


@pytest.mark.parametrize("seed", range(120))
@pytest.mark.fast(40, slow=80)
def test_the_energy_balance_is_that_of_the_states(seed):
    """Any scheme on any chain; outputs thinned."""
    scheme, contact = PAIRS[seed % len(PAIRS)]
    system, slow = random_chain(seed) if contact == "implicit" else random_chain(seed, SMOOTH, 0.1)
    rng = np.random.default_rng(seed)
    dt, steps = rng.uniform(0.002, 0.05) / slow, int(rng.integers(33, 400))
    try:
        run = sb.integrate(system, scheme, dt, steps * dt, contact, every=(1, 7, 32, 33)[seed % 4])
    except (sb.InputError, sb.Diverged, sb.SolverFailure):
        return
    if np.max(np.abs(run.tip)) < 1e3:
        assert_balance(run)


def test_in_free_flight_the_trapezoidal_rule_loses_no_energy(table10):
    run = sb.integrate(sb.semidiscretise(table10, 12), sb.HHT(0.0), 1e-4, 0.3)
    assert run.impacts.count > 3
    assert np.max(np.abs(run.energy.loss_without_contact)) < 1e-9 * np.max(run.energy.energy)
    assert np.max(np.abs(run.energy.loss_in_contact)) > 1e-3 * np.max(run.energy.energy)
    damped = one_mass(9.0, damping=0.4, q=1.0)  # what the dashpots take is what is lost
    energy = sb.integrate(damped, sb.HHT(0.0), 0.01, 5.0).energy
    assert np.allclose(energy.viscous, energy.energy[0] - energy.energy, rtol=0, atol=1e-12)
    assert energy.viscous[-1] > 3.0


def test_an_energy_beyond_float64_is_said_and_not_returned():
    """The motion is held still by a viscosity whose dissipation overflows."""
    beam = sb.BeamProblem(stiffness=300.0, viscosity=1.3e115, base=sb.Harmonic(0.2, 10.0))
    run = sb.integrate(sb.semidiscretise(beam, 4), sb.HHT(alpha=-0.1), 1e-3, 1e-2)
    assert np.all(np.isfinite(run.tip))
    with pytest.raises(sb.Diverged, match="energy is beyond float64"):
        _ = run.energy


@pytest.mark.parametrize("scheme", [sb.HHT(-0.1), sb.ExponentialFlow(), sb.BDF2()], ids=str)
def test_a_loss_that_unresolved_dashpots_leave_open_is_not_told(scheme):
    """A mass on a dashpot, c dt/m = 100 and 0.01: what the dashpot takes within a step is not loss of the scheme."""
    for c, known in ((1e4, False), (1.0, True)):
        system = one_mass(1.0, sb.Stops(upper=9.0, stiffness=10.0), damping=c, v=1.0)
        ledger, exact = sb.integrate(system, scheme, 1e-2, 1.0).energy, sb.reference(system, 1.0).energy
        assert ledger.is_resolved() == np.isfinite(ledger.lost_fraction()) == known
        assert exact.is_resolved()
        assert not known or abs(ledger.viscous[-1] - exact.viscous[-1]) < 1e-3


@pytest.mark.parametrize("law", [{"damping": 30.0}, {"dissipation": 1.0}], ids=str)
def test_a_loss_that_unresolved_damped_stops_leave_open_is_not_told(law):
    """The trapezoidal rule at 28 and 2800 steps a contact: what is said to be lost is what the stop takes."""
    system = one_mass(25.0, sb.Stops(upper=0.1, stiffness=1e4, **law), v=2.0)
    coarse, fine = (sb.integrate(system, sb.Trapezoidal(), dt, 3.0).energy for dt in (1e-3, 1e-5))
    assert fine.is_resolved()
    assert not coarse.is_resolved()
    assert abs(fine.lost_fraction()) < 1e-4 < coarse.loss[-1] / coarse.supplied[-1]
    assert abs(coarse.stop_dissipation[-1] - fine.stop_dissipation[-1]) < coarse.spread[-1]


# ------------------------------------------------------------------ the last block, and overflow


def wild(rows, damping, stiffness, v0) -> sb.System:
    """Two free masses of 1 on springs of 1 that reach more stops than they have unknowns."""
    laws = zip(rows, damping, stiffness, strict=True)
    contacts = [sb.Contact(row, sb.Stops(-0.2, 0.15, stiffness=k, damping=c)) for row, c, k in laws]
    return sb.System.from_matrices(np.eye(2), np.eye(2), contacts=contacts, initial_velocity=v0)


@pytest.mark.parametrize(
    ("system", "dt", "steps", "contact"),
    [
        # A later step, which the block holds too, has no forces; Newton's method finds none of these; overflow later.
        (wild([[1, -1], [2, 0.5], [-1, -1]], [50, 10, 50], [10, 10, 1e3], [-1.0, 3.0]), 0.5, 1, "implicit"),
        (wild([[2, 2], [1, 1], [1, 2]], [50, 50, 10], [100, 1e4, 1e3], [-1.0, 1.0]), 0.5, 1, "implicit"),
        (one_mass(1.0, sb.Stops(-0.1, 0.1, stiffness=1e4, exponent=1.5), v=1.0), 0.1, 2, "extrapolated"),
    ],
)
def test_steps_beyond_the_end_of_a_run_take_no_part_in_it(system, dt, steps, contact):
    run = sb.integrate(system, sb.Trapezoidal(), dt, steps * dt, contact)
    q = plain_march.states(system, sb.Trapezoidal(), dt, steps, contact)[0]
    np.testing.assert_allclose(run.states[0], np.asarray(q, float), rtol=0.0, atol=1e-12 * float(np.max(np.abs(q))))


@pytest.mark.parametrize("steps", [1, 4096])
def test_a_member_that_overflows_has_its_outputs_to_there_and_leaves_the_others_alone(steps, monkeypatch):
    """In many calls of the kernel, in which it stays where it is, and in one; a single run ends there."""
    monkeypatch.setattr(block_march, "STEPS_PER_CALL", steps)
    system, dt = one_mass(1.0, sb.Stops(-0.1, 0.1, stiffness=1e4, exponent=1.5), v=1.0), 0.1
    calm = with_stops(system, sb.Stops(-10.0, 10.0, stiffness=1e4, exponent=1.5))
    with pytest.raises(sb.Diverged) as ended:
        sb.integrate(system, sb.Trapezoidal(), dt, 30.0, "extrapolated")
    many = sb.integrate_ensemble(system, sb.Trapezoidal(), dt, 30.0, [system, calm], contact="extrapolated", every=1)
    whole = np.asarray(plain_march.states(system, sb.Trapezoidal(), dt, 12, "extrapolated")[0], float)[:, 0]
    last = int(np.argmax(np.abs(whole) > 1e100))
    assert many.diverged[0] == ended.value.t == last * dt
    np.testing.assert_allclose(many.tip[0, :last], whole[:last], rtol=1e-9)
    assert np.all(np.isnan(many.tip[0, last:]))
    assert np.isnan(many.diverged[1])
    assert np.array_equal(many.tip[1], sb.integrate(calm, sb.Trapezoidal(), dt, 30.0, "extrapolated").tip)
