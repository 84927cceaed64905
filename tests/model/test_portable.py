"""What is made here arrives in another process: profiles are data, runs and records pickle, the rest is refused."""

from __future__ import annotations

import pickle
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from systems import two_contacts

import stiffbeam as sb
from stiffbeam.files.cases import load_cases
from stiffbeam.studies import study

STEEL = """
[[case]]
name = "steel"
cells = 6
dt = 1e-4
t_end = 0.02
runs = ["hht"]
[case.problem]
length = 0.4
bending_stiffness = 4.2
mass_per_length = 0.16
stops = { lower = -2e-3, upper = 2e-3, stiffness = 1e5 }
loads = [{ shape = [0, 1.5], amplitude = 3.0, frequency = 60.0 }]
initial_displacement = [0, 0, 0.1]
initial_velocity = [0, 0.5]
"""


@pytest.fixture
def steel(tmp_path):
    file = tmp_path / "steel.toml"
    file.write_text(STEEL)
    return load_cases(str(file))["steel"]  # a name as a string is a name


def again(value):
    return pickle.loads(pickle.dumps(value))


def test_a_profile_of_a_case_file_is_data():
    one, same = sb.PolynomialProfile((0, 1.5)), sb.PolynomialProfile([0.0, 1.5])
    assert one == same == again(one)
    assert hash(one) == hash(same)
    assert repr(one) == "PolynomialProfile(coefficients=(0.0, 1.5))"
    assert np.array_equal(one(np.array([0.0, 2.0])), [0.0, 3.0])
    assert one != sb.PolynomialProfile((0.0, 1.6))
    for wrong in ((), ("a",), (np.nan,)):
        with pytest.raises(sb.InputError, match="coefficients"):
            sb.PolynomialProfile(wrong)


def test_a_physical_case_with_loads_and_initial_profiles_is_the_same_elsewhere(steel):
    copy = again(steel)
    assert copy.problem == steel.problem
    assert sb.semidiscretise(copy.problem, 6).fingerprint == sb.semidiscretise(steel.problem, 6).fingerprint


def same(a, b) -> None:
    """Equal contents, whatever they are made of."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    elif isinstance(a, (tuple, list)):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            same(x, y)
    elif is_dataclass(a):
        for field in fields(a):
            same(getattr(a, field.name), getattr(b, field.name))
    elif not (isinstance(a, float) and np.isnan(a)):
        assert a == b


OUTPUTS = ("t", "tip", "tip_velocity", "contacts", "work", "provenance", "fingerprint", "energy", "states")


@pytest.mark.slow
def test_a_run_arrives_whole(table10):
    """Past the horizon, where the states made there would not be those of the run if a bit were another."""
    run = sb.integrate(sb.semidiscretise(table10, 8), sb.BDF2(), 1e-4, 0.6, every=50)
    copy = again(run)
    for name in OUTPUTS:
        same(getattr(run, name), getattr(copy, name))
    assert np.array_equal(copy.displacement(1.0), run.displacement(1.0))


@pytest.mark.parametrize("method", ["exact", "cvode", "dop853", "multiprecision"])
def test_a_reference_arrives_with_its_horizon_and_can_be_compared_with(table10, method):
    system = sb.semidiscretise(table10, 6)
    t = np.arange(201) * 1e-4
    found = sb.reference(system, 0.02, method, t)
    copy = again(found)
    for name in (*OUTPUTS, "horizon"):
        same(getattr(found, name), getattr(copy, name))
    run = sb.integrate(system, sb.HHT(), 1e-4, 0.02)
    mine, theirs = sb.compare(run, found), sb.compare(again(run), copy)
    for other in (theirs, again(mine)):
        same(mine.to_dict(), other.to_dict())
        same(mine.error, other.error)
    for contact in (None, 0):
        same(found.at(t[5:9], contact), copy.at(t[5:9], contact))
    if method == "exact":
        same(found.at([1.234e-2]), copy.at([1.234e-2]))
        assert copy.impacts_sampled(1e-4).count == found.impacts_sampled(1e-4).count


@pytest.mark.parametrize("kind", ["schemes", "exact"])
def test_an_ensemble_arrives_with_its_members_and_ledgers(kind):
    system = two_contacts()
    members = sb.perturbed_members(system, 3, 1e-6)
    if kind == "exact":
        found = sb.reference_ensemble(system, 1.0, members, np.linspace(0.0, 1.0, 5))
    else:
        found = sb.integrate_ensemble(system, sb.HHT(), 2e-3, 1.0, members, every=100)
    copy = again(found)
    for name in ("t", "tip", "tip_velocity", "contacts", "diverged", "work", "provenance"):
        same(getattr(found, name), getattr(copy, name))
    same(found.ledger(1), copy.ledger(1))
    assert copy.members[2].fingerprint == found.members[2].fingerprint


def test_records_arrive_and_answer():
    records = study("modes", schemes=["bdf2"], steps=100)
    copy = again(records)
    assert copy.table.equals(records.table)
    assert copy.to_dict() == records.to_dict()


@pytest.mark.parametrize(
    "error",
    [
        sb.InputError("dt", 0.3, "divide t_end", "use 0.25"),
        sb.Diverged("hht", 1.5, "use a smaller dt"),
        sb.SolverFailure("exact", 0.0, "the balance is open", "shorten t_end"),
    ],
)
def test_an_error_arrives_whole_from_another_process(error):
    """One that does not breaks the whole pool of workers."""
    arrived = pickle.loads(pickle.dumps(error))
    assert type(arrived) is type(error)
    assert str(arrived) == str(error)
    assert vars(arrived) == vars(error)
