"""Numbers as written: the same doubles for float64, another problem for multiprecision, and never one for the other."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.basics.validation import ExactFloat, exact_float, exact_value


def as_doubles(value):
    """A dataclass or tuple with every ExactFloat in it replaced by the double that it computes as."""
    if isinstance(value, tuple):
        return tuple(map(as_doubles, value))
    if dataclasses.is_dataclass(value):
        arguments = {x.name: as_doubles(getattr(value, x.name)) for x in dataclasses.fields(value) if x.init}
        return dataclasses.replace(value, **arguments)
    return float(value) if isinstance(value, ExactFloat) else value


def system_of(case, doubles=False):
    return sb.semidiscretise(as_doubles(case.problem) if doubles else case.problem, case.cells)


@pytest.mark.parametrize(
    ("given", "ratio", "pi", "text"),
    [
        ("0.001", Fraction(1, 1000), False, "0.001"),
        ("1.0e-3", Fraction(1, 1000), False, "0.001"),
        (Decimal("0.0010"), Fraction(1, 1000), False, "0.001"),
        (Fraction(1, 3), Fraction(1, 3), False, "1/3"),
        ("2/6", Fraction(1, 3), False, "1/3"),
        (2**53 + 1, Fraction(2**53 + 1), False, str(2**53 + 1)),
        ("pi/2", Fraction(1, 2), True, "pi/2"),
        ("-0.75 * pi", Fraction(-3, 4), True, "-3*pi/4"),
        ("2*pi*50", Fraction(100), True, "100*pi"),
        ("0.1234567890123456789", Fraction("0.1234567890123456789"), False, "1234567890123456789/10000000000000000000"),
    ],
)
def test_a_number_is_the_nearest_double_and_knows_its_exact_value(given, ratio, pi, text):
    x = exact_float(given)
    assert (exact_value(x), repr(x)) == ((ratio, pi), repr(text))
    assert float(x) == (float(ratio) if not pi else pytest.approx(float(ratio) * np.pi, rel=3e-16))
    for again in (exact_float(text), pickle.loads(pickle.dumps(x)), copy.deepcopy(x)):
        assert (exact_value(again), repr(again), float(again)) == (exact_value(x), repr(x), float(x))


def test_a_position_on_a_node_loads_that_node_alone():
    """0.28 * 25 is 7.000000000000001 in float64, and 0.29 * 100 is 28.999999999999996."""
    flint, exact = pytest.importorskip("flint"), pytest.importorskip("stiffbeam.references.multiprecision")
    for position, cells, node in (("0.28", 25, 7), ("0.29", 100, 29), ("1", 8, 8)):
        problem = sb.BeamProblem(stiffness=1.0, loads=(sb.PointLoad(position, sb.Constant(1.0)),))
        system = sb.semidiscretise(problem, cells)
        with flint.ctx.workprec(200):
            basis = exact.exact_problem(system, system.drive)[3].tolist()[0]
        assert [i for i, x in enumerate(basis, start=1) if x != 0] == [node]
        assert basis[node - 1] == 1


def test_two_frequencies_that_float64_cannot_tell_apart_stay_two():
    flint, exact = pytest.importorskip("flint"), pytest.importorskip("stiffbeam.references.multiprecision")
    loads = [([1.0], sb.Harmonic(1.0, "10.1")), ([1.0], sb.Harmonic(3.0, 10.1))]
    system = sb.System.from_matrices([[1.0]], [[1.0]], loads=loads, observe=[1.0])
    assert [float(w) for w in system.drive.frequencies] == [10.1, 10.1]
    with flint.ctx.workprec(200):
        basis = [float(line[0]) for line in exact.exact_problem(system, system.drive)[3].tolist()]
    sizes = {exact_value(w)[0]: basis[1 + 2 * k] for k, w in enumerate(system.drive.frequencies)}
    assert sizes == {Fraction("10.1"): 1.0, Fraction(10.1): 3.0}
    # M q'' + K q = sin + 3 sin of what are two frequencies: q = sum F/(1 - w^2) (sin w t - w sin t)
    many = sb.reference(system, 2.0, "multiprecision")
    expected = 4.0 / (1.0 - 10.1**2) * (np.sin(10.1 * many.t) - 10.1 * np.sin(many.t))
    assert np.max(np.abs(many.tip - expected)) < 1e-13
    assert np.max(np.abs(sb.reference(system, 2.0, t_eval=many.t).tip - expected)) < 1e-13


@pytest.mark.parametrize("method", ["exact", "cvode-adams", "hht"])
def test_float64_sees_the_same_doubles_bit_for_bit(method):
    def solved(doubles):
        system = system_of(dataclasses.replace(sb.paper_case(12), cells=8), doubles)
        if method == "hht":
            return sb.integrate(system, sb.HHT(-0.1), 1e-4, 0.05)
        return sb.reference(system, 0.02, method, rtol=1e-5)

    decimals, doubles = solved(False), solved(True)
    assert np.array_equal(decimals.tip, doubles.tip)
    assert np.array_equal(decimals.impacts.times, doubles.impacts.times)
    assert decimals.contacts[0].peak_force == doubles.contacts[0].peak_force > 0.0


def test_equal_numbers_make_equal_systems_however_they_are_written():
    def fingerprint(gap, phase):
        problem = sb.BeamProblem(
            stiffness=300.0, stops=sb.Stops(None, gap, stiffness=1e4), base=sb.Harmonic(1.0, 2.0, phase)
        )
        return sb.semidiscretise(problem, 6).fingerprint

    written = {fingerprint(gap, "pi/2") for gap in ("0.1", "1e-1", "1/10", Fraction(1, 10), Decimal("0.100"))}
    assert len(written) == 1
    others = {fingerprint(0.1, "pi/2"), fingerprint("0.1", np.pi / 2), fingerprint(0.1, np.pi / 2)}
    assert len(others | written) == 4
    # In matrices of one's own as well: stops, loads and offsets.
    for exact, double in (("0.1", 0.1), ("1/3", 1 / 3)):
        made = []
        for x in (exact, double):
            for stop, load, offset in ((x, double, double), (double, x, double), (double, double, x)):
                contact = sb.Contact([1.0], sb.Stops(None, stop, stiffness=9.0), sb.Constant(offset))
                made.append(sb.System.from_matrices([[1.0]], [[1.0]], None, [([1.0], sb.Constant(load))], [contact]))
        assert len({system.fingerprint for system in made}) == 4


@pytest.mark.parametrize(
    ("table", "cells", "end", "wanted"),
    [
        pytest.param(14, 8, 0.9, None, marks=pytest.mark.slow),
        pytest.param(12, 50, 0.2, [655, 664], marks=pytest.mark.campaign),
    ],
)
def test_the_numbers_as_written_and_their_doubles_make_other_motions_past_the_horizon(table, cells, end, wanted):
    """Another program, matrix exponentials of the finite differences in ball arithmetic, counted these impacts."""
    systems = [system_of(dataclasses.replace(sb.paper_case(table), cells=cells), doubles) for doubles in (False, True)]
    assert sb.reference(systems[0], end).horizon < 0.8 * end
    written, doubles = (sb.reference(system, end, "multiprecision").impacts.count for system in systems)
    assert written != doubles
    assert wanted in (None, [written, doubles])
