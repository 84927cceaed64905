"""The regimes of a system and of its perturbed copies: what they share, and the table of the compiled loop."""

from itertools import product

import numpy as np

import stiffbeam as sb
from stiffbeam.piecewise.linear import Perturbation
from stiffbeam.piecewise.regimes import Regimes, Source


def test_a_reference_and_its_copies_have_one_source(table10_system, monkeypatch):
    made, init = [], Source.__init__

    def noted(self, *arguments, **options):
        made.append(self)
        init(self, *arguments, **options)

    monkeypatch.setattr(Source, "__init__", noted)
    reference = sb.reference(table10_system, 0.02)
    assert made == [reference.solution.regimes.source]


def test_the_random_numbers_of_a_copy_depend_on_its_seed_and_the_place():
    def numbers(seed, *place):
        return Perturbation(1e-16, 1e-16, seed).random(*place).uniform(size=5)

    assert np.array_equal(numbers(3, 2, 99), np.random.default_rng([3, 2, 99]).uniform(size=5))
    assert not np.any(numbers(3, 2, 99) == numbers(3, 99, 2))


def test_a_table_that_grows_keeps_its_regimes(three_masses):
    """Nine regimes of two contacts: the table has room for three at first."""
    contacts = tuple(sb.Contact(row, sb.Stops(-0.5, 0.5, stiffness=1e3)) for row in np.eye(3)[:2])
    system = sb.System.from_matrices(
        three_masses.mass, three_masses.stiffness, loads=three_masses.loads, contacts=contacts
    )
    regimes = Regimes(Source(system))
    every = list(product((0, -1, 1), repeat=2))
    assert [regimes.at(sides, 1.0) for sides in every] == list(range(9))
    for r, sides in enumerate(every):
        alone = Regimes(Source(system))
        at = alone.at(sides, 1.0)
        assert tuple(regimes.table.sides[r]) == sides
        for name in ("sizes", "omega", "speeds", "order", "outward", "inward", "response", "rows", "waves"):
            assert np.array_equal(getattr(regimes.table, name)[r], getattr(alone.table, name)[at]), (sides, name)
