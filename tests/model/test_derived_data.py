"""What follows from a field of a system never outlives it: replaced, changed in place, pickled, built directly."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.model.modes import modes

FORMS = ["displacement", "velocity-curvature"]


@pytest.fixture(scope="module")
def systems(request):
    beam = sb.BeamProblem(stiffness=300.0, stops=sb.Stops(-0.1, 0.1, stiffness=5e6), base=sb.Harmonic(0.2, 10.0))
    return {form: sb.semidiscretise(beam, 8, form) for form in FORMS}


def bare(system: sb.System) -> sb.System:
    """The same equations as anyone's matrices: the witness, which never had a beam."""
    return sb.System.from_matrices(
        np.array(system.mass), np.array(system.stiffness), np.array(system.damping), system.loads, system.contacts,
        system.observe, system.q0, system.v0,
    )  # fmt: skip


CHANGES = {
    "stiffness": lambda s: 4.0 * s.stiffness,
    "mass": lambda s: 2.0 * s.mass,
    "damping": lambda s: 1e-5 * s.stiffness,
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("field", CHANGES)
@pytest.mark.fast(3)
def test_every_solver_sees_a_replaced_matrix(systems, form, field):
    """Exact, DOP853 and a scheme, each beside the same equations that never had a factor or a beam."""
    system = systems[form]
    changed = replace(system, **{field: CHANGES[field](system)})
    fresh = bare(changed)
    assert np.allclose(modes(changed).omega, modes(fresh).omega, rtol=1e-6)
    t = np.linspace(0.0, 0.02, 21)
    for method in ("exact", "dop853"):
        own, wanted = (sb.reference(s, 0.02, method, t).tip for s in (changed, fresh))
        assert np.max(np.abs(own - wanted)) < 1e-6 * np.max(np.abs(wanted))
        assert np.max(np.abs(wanted - sb.reference(system, 0.02, method, t).tip)) > 1e-3 * np.max(np.abs(wanted))
    own, wanted = (sb.integrate(s, sb.BDF2(), 1e-4, 0.02).tip for s in (changed, fresh))
    assert np.max(np.abs(own - wanted)) < 1e-6 * np.max(np.abs(wanted))
    assert changed.problem is None
    assert changed.form == "matrices"
    with pytest.raises(sb.InputError, match="beam"):
        changed.displacement([0.0], changed.q0[None], 1.0)


def test_the_beam_follows_its_stops_and_leaves_with_its_loads(systems):
    system = systems["displacement"]
    assert system.problem is system.origin.problem
    stops = sb.Stops(upper=0.2, stiffness=1e5)
    assert replace(system, contacts=[sb.Contact(system.contacts[0].row, stops)]).problem.stops == stops
    assert replace(system, contacts=(), observe=system.contacts[0].row).problem.stops is None
    assert replace(system, contacts=[sb.Contact(np.eye(8)[3], stops)]).problem is None
    assert replace(system, contacts=[replace(system.contacts[0], offset=sb.Constant(0.1))]).problem is None
    assert replace(system, loads=()).problem is None
    assert replace(system, loads=()).stiffness_factor is system.stiffness_factor
    later = [(vector, replace(f, phase=f.phase + 0.3)) for vector, f in system.loads]
    with pytest.raises(sb.InputError, match="beam"):  # its base is elsewhere by now
        sb.integrate(replace(system, loads=later), sb.BDF2(), 1e-3, 0.01).displacement(0.5)


def test_a_drive_is_varied_with_the_problems_initial_data_or_not_at_all(systems):
    system = systems["displacement"]
    varied = sb.varied_members(system, frequency=[11.0])[0]
    assert varied.problem.base.frequency == 11.0
    assert varied.fingerprint == sb.semidiscretise(varied.problem, 8).fingerprint
    with pytest.raises(sb.InputError, match="initial data"):
        sb.varied_members(replace(system, q0=system.q0 + 1e-3), frequency=[11.0])


def test_arrays_cannot_be_changed_in_place(systems):
    mass, row, load = np.eye(2), np.ones(2), np.ones(2)
    system = sb.System.from_matrices(
        mass, np.diag([1.0, 4.0]), loads=[(load, sb.Constant(1.0))],
        contacts=[sb.Contact(row, sb.Stops(upper=1.0, stiffness=1.0))],
    )  # fmt: skip
    before = system.fingerprint
    mass[0, 0], row[:], load[:] = 9.0, 9.0, 9.0
    assert replace(system).fingerprint == before
    for copy in (system, replace(system), pickle.loads(pickle.dumps(system)), systems["displacement"]):
        arrays = [copy.mass, copy.damping, copy.stiffness, copy.q0, copy.v0, copy.loads[0][0], copy.contacts[0].row]
        arrays += [copy.stiffness_factor] if copy.origin else []
        for array in arrays:
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0


def test_a_view_made_before_cannot_change_a_system():
    """An array that says it is read-only may still be written to through an older view."""
    mass = np.eye(2)
    view = mass[:]
    mass.setflags(write=False)
    system = sb.System.from_matrices(mass, np.eye(2), observe=[1.0, 0.0])
    view[0, 0] = 5.0
    assert system.mass[0, 0] == 1.0


def test_a_pickled_system_is_the_same_system(systems):
    for system in (
        *systems.values(),
        replace(systems["displacement"], stiffness=2.0 * systems["displacement"].stiffness),
    ):
        copy = pickle.loads(pickle.dumps(system))
        assert copy.fingerprint == system.fingerprint
        assert (copy.form, copy.problem) == (system.form, system.problem)
        assert np.array_equal(
            sb.integrate(copy, sb.HHT(), 1e-4, 0.01).tip, sb.integrate(system, sb.HHT(), 1e-4, 0.01).tip
        )
    pushed = replace(systems["displacement"], loads=[(np.ones(8), np.sin)])  # a callable has no content to hash
    assert pickle.loads(pickle.dumps(pushed)).fingerprint == pushed.fingerprint
