"""A system and what is made of it: replaced, pickled, moved; nothing derived outlives its data."""

from __future__ import annotations

import pickle
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from fuzz import STEEL
from systems import one_mass

import stiffbeam as sb
from stiffbeam.model.modes import modes
from stiffbeam.references import solve
from stiffbeam.studies import study

PROBLEM = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e6), base=sb.Harmonic(0.2, 10.0))
SYSTEMS = {form: sb.semidiscretise(PROBLEM, 8, form) for form in ("displacement", "velocity-curvature")}
BEAM = SYSTEMS["displacement"]
CHANGES = {
    "stiffness": lambda s: 4.0 * s.stiffness, "mass": lambda s: 2.0 * s.mass, "damping": lambda s: 1e-5 * s.stiffness,
}  # fmt: skip


def again(value):
    return pickle.loads(pickle.dumps(value))


# ------------------------------------------------------------------ replaced


@pytest.mark.parametrize("form", SYSTEMS)
@pytest.mark.parametrize("field", CHANGES)
@pytest.mark.fast(3)
def test_every_solver_sees_a_replaced_matrix(form, field):
    """Exact, DOP853 and a scheme, each beside the same equations that never had a factor or a beam."""
    changed = replace(SYSTEMS[form], **{field: CHANGES[field](SYSTEMS[form])})
    fresh = sb.System.from_matrices(
        np.array(changed.mass), np.array(changed.stiffness), np.array(changed.damping), changed.loads,
        changed.contacts,
        observe=changed.observe, initial_displacement=changed.q0, initial_velocity=changed.v0,
    )  # fmt: skip
    assert np.allclose(modes(changed).omega, modes(fresh).omega, rtol=1e-6)
    t = np.linspace(0.0, 0.02, 21)
    for method in ("exact", "dop853"):
        own, wanted, before = (sb.reference(s, 0.02, method, t).tip for s in (changed, fresh, SYSTEMS[form]))
        assert np.max(np.abs(own - wanted)) < 1e-6 * np.max(np.abs(wanted))
        assert np.max(np.abs(wanted - before)) > 1e-3 * np.max(np.abs(wanted))
    own, wanted = (sb.integrate(s, sb.BDF2(), 1e-4, 0.02).tip for s in (changed, fresh))
    assert np.max(np.abs(own - wanted)) < 1e-6 * np.max(np.abs(wanted))
    assert (changed.problem, changed.form) == (None, "matrices")
    with pytest.raises(sb.InputError, match="beam"):
        changed.displacement([0.0], changed.q0[None], 1.0)


def test_the_beam_follows_its_stops_and_leaves_with_its_loads():
    stops = sb.Stops(upper=0.2, stiffness=1e5)
    assert BEAM.problem is BEAM.origin.problem
    assert replace(BEAM, contacts=[sb.Contact(BEAM.contacts[0].row, stops)]).problem.stops == stops
    assert replace(BEAM, contacts=(), observe=BEAM.contacts[0].row).problem.stops is None
    for elsewhere in (sb.Contact(np.eye(8)[3], stops), replace(BEAM.contacts[0], offset=sb.Constant(0.1))):
        assert replace(BEAM, contacts=[elsewhere]).problem is None
    assert replace(BEAM, loads=()).problem is None
    assert replace(BEAM, loads=()).stiffness_factor is BEAM.stiffness_factor
    later = [(vector, replace(f, phase=f.phase + 0.3)) for vector, f in BEAM.loads]
    with pytest.raises(sb.InputError, match="beam"):  # its base is elsewhere by now
        sb.integrate(replace(BEAM, loads=later), sb.BDF2(), 1e-3, 0.01).displacement(0.5)
    varied = sb.varied_members(BEAM, {"frequency": [11.0]})[0]
    assert varied.problem.base.frequency == 11.0
    assert varied.fingerprint == sb.semidiscretise(varied.problem, 8).fingerprint
    with pytest.raises(sb.InputError, match="initial data"):
        sb.varied_members(replace(BEAM, q0=BEAM.q0 + 1e-3), {"frequency": [11.0]})


def test_arrays_cannot_be_changed_in_place():
    """Nor through a view made before: an array that says it is read-only may still be written to through it."""
    mass, row, load = np.eye(2), np.ones(2), np.ones(2)
    view = mass[:]
    mass.setflags(write=False)
    contact = sb.Contact(row, sb.Stops(upper=1.0, stiffness=1.0))
    system = sb.System.from_matrices(mass, np.diag([1.0, 4.0]), loads=[(load, sb.Constant(1.0))], contacts=[contact])
    before = system.fingerprint
    view[0, 0], row[:], load[:] = 9.0, 9.0, 9.0
    assert replace(system).fingerprint == before
    for copy in (system, replace(system), again(system), BEAM):
        arrays = [copy.mass, copy.damping, copy.stiffness, copy.q0, copy.v0, copy.loads[0][0], copy.contacts[0].row]
        for array in arrays + ([copy.stiffness_factor] if copy.origin else []):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0


def test_equal_numbers_are_equal_systems_and_callables_only_themselves():
    kinds = [sb.Harmonic(1, 10), sb.Harmonic(1.0, 10.0), sb.Harmonic(np.float64(1.0), np.float64(10.0))]
    assert len({one_mass(4.0, load=f).fingerprint for f in kinds}) == 1
    assert len({one_mass(4.0, load=eval(f"lambda t: {k} * t")).fingerprint for k in range(6)}) == 6


# ------------------------------------------------------------------ in another process


def same(a, b, rel: float = 0.0) -> None:
    """Equal contents, whatever they are made of, numbers to ``rel``."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray) and a.dtype.kind == "f":
        np.testing.assert_allclose(a, b, rtol=rel, atol=rel * np.max(np.abs(a), initial=0.0), equal_nan=True)
    elif isinstance(a, np.ndarray):
        assert np.array_equal(a, b)
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for name in a:
            same(a[name], b[name], rel)
    elif isinstance(a, (tuple, list)):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            same(x, y, rel)
    elif is_dataclass(a):
        for field in fields(a):
            same(getattr(a, field.name), getattr(b, field.name), rel)
    elif isinstance(a, float):
        assert a == pytest.approx(b, rel=rel, abs=rel, nan_ok=True)
    else:
        assert a == b


OUTPUTS = ("t", "tip", "tip_velocity", "contacts", "work", "provenance", "fingerprint", "energy", "states")


def test_systems_cases_and_profiles_arrive(tmp_path):
    for system in (*SYSTEMS.values(), replace(BEAM, stiffness=2.0 * BEAM.stiffness)):
        copy = again(system)
        assert (copy.fingerprint, copy.form, copy.problem) == (system.fingerprint, system.form, system.problem)
        runs = [sb.integrate(x, sb.HHT(), 1e-4, 0.01).tip for x in (copy, system)]
        assert np.array_equal(*runs)
    pushed = replace(BEAM, loads=[(np.ones(8), np.sin)])  # a callable has no content to hash
    assert again(pushed).fingerprint == pushed.fingerprint
    (tmp_path / "steel.toml").write_text(STEEL)
    (steel,) = sb.load_cases(tmp_path / "steel.toml").values()
    assert again(steel).problem == steel.problem
    assert len({sb.semidiscretise(x.problem, 6).fingerprint for x in (steel, again(steel))}) == 1
    one, other = sb.PolynomialProfile((0, 1.5)), sb.PolynomialProfile([0.0, 1.5])
    assert one == other == again(one) != sb.PolynomialProfile((0.0, 1.6))
    assert hash(one) == hash(other)
    assert repr(one) == "PolynomialProfile(coefficients=(0.0, 1.5))"
    assert np.array_equal(one(np.array([0.0, 2.0])), [0.0, 3.0])
    for wrong in ((), ("a",), (np.nan,)):
        with pytest.raises(sb.InputError, match="coefficients"):
            sb.PolynomialProfile(wrong)


@pytest.mark.parametrize("method", ["exact", "cvode", "dop853", "multiprecision"])
def test_a_reference_arrives_with_its_horizon_and_can_be_compared_with(method):
    system, t = sb.semidiscretise(PROBLEM, 6), np.arange(201) * 1e-4
    found = sb.reference(system, 0.02, method, t)
    copy, run = again(found), sb.integrate(system, sb.HHT(), 1e-4, 0.02)
    rounding = 1e-12 if method == "multiprecision" else 0.0  # in another process a motion in float64
    for name in (*OUTPUTS, "horizon"):
        if not (rounding and name == "energy"):  # whose loss is rounding alone
            same(getattr(found, name), getattr(copy, name), rounding)
    same(found.energy.energy, copy.energy.energy, rounding)
    mine, theirs = sb.compare(run, found), sb.compare(again(run), copy)
    for other in (theirs, again(mine)):
        same(mine.to_dict(), other.to_dict(), 1e-8)  # a motion that is read at other times has other roundings
        same(mine.error, other.error, 1e-8)
    for contact in (None, 0):
        same(found.at(t[95:99], contact), copy.at(t[95:99], contact), rounding)
    if method in ("exact", "multiprecision"):
        same(found.at([1.234e-2]), copy.at([1.234e-2]), 1e-12)
        assert copy.impacts_sampled(1e-4).count == found.impacts_sampled(1e-4).count


ERRORS = [
    sb.InputError("dt", 0.3, "divide t_end", "use 0.25"), sb.Diverged("hht", 1.5, "use a smaller dt"),
    sb.SolverFailure("exact", 0.0, "the balance is open", "shorten t_end"),
]  # fmt: skip


def test_records_and_errors_arrive_whole():
    """An error that does not breaks the whole pool of workers."""
    records = study("modes", schemes=["bdf2"], steps=100)
    assert again(records).table.equals(records.table)
    assert again(records).to_dict() == records.to_dict()
    for error in ERRORS:
        arrived = again(error)
        assert (type(arrived), str(arrived), vars(arrived)) == (type(error), str(error), vars(error))


# ------------------------------------------------------------------ moved


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
        runs = []
        for shift, load in ((0.0, drive), (1.0, sb.Superposition(drive, sb.Constant(k)))):
            stops = sb.Stops(None if lower is None else lower + shift, shift, stiffness=kappa)
            system = one_mass(k, stops, damping=damping, load=load, q=q0 + shift)
            runs.append(solve(system, 5.0, "exact", np.linspace(0.0, 5.0, 11), 0.0, None))
        a, b = runs
        first = min(4, a.impacts.count, b.impacts.count)  # before rounding has grown
        assert np.max(np.abs(a.impacts.times[:first] - b.impacts.times[:first]), initial=0.0) < 1e-8
        had = np.max(np.abs(a.energy.input)) + np.max(a.energy.energy)
        assert abs(a.energy.loss[-1]) < 1e-10 * had  # 1e3 switches of rounding at most
