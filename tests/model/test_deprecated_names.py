"""Old names work, warn, and name the new one."""

from __future__ import annotations

import pytest

import stiffbeam as sb
from stiffbeam.basics.validation import Renamed
from stiffbeam.studies.advice import Advice
from stiffbeam.trajectory.records import Ledger

OLD = {
    "Growth": "PerturbationGrowth",
    "Members": "EnsembleMembers",
    "Section": "BeamSection",
    "Sum": "Superposition",
    "perturbed": "perturbed_members",
    "reduced": "reduce_model",
    "varied": "varied_members",
}


@pytest.mark.parametrize("old", OLD)
def test_a_name_of_the_package_is_found_under_its_old_name(old):
    with pytest.warns(DeprecationWarning, match=rf"^stiffbeam\.{old} is called stiffbeam\.{OLD[old]} now$") as caught:
        value = getattr(sb, old)
    assert value is getattr(sb, OLD[old])
    assert caught[0].filename == __file__
    assert old not in dir(sb)


def ball() -> sb.System:
    stops = [sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=100.0))]
    return sb.System.from_matrices([[1.0]], [[4.0]], contacts=stops, initial_velocity=[1.0])


OBJECTS = {
    "Stops": (lambda: sb.Stops(upper=0.1, stiffness=1.0), {"g1": "lower_bound", "g2": "upper_bound"}),
    "BeamProblem": (lambda: sb.paper_case(10).problem, {"one_stops": "single_stops"}),
    "EnsembleMembers": (lambda: sb.perturbed_members(ball(), 2), {"chosen": "subset"}),
    "Trajectory": (lambda: sb.integrate(ball(), sb.HHT(), 0.01, 0.1), {"read_for": "stored_fingerprint"}),
    "Advice": (
        lambda: sb.advise(ball(), {"tip": 0.1}, 0.2, [sb.HHT()], most_steps=256),
        {"chosen": "recommendation", "cannot": "unattainable", "tried": "candidates", "want_met": "attainable"},
    ),
}


@pytest.mark.parametrize("kind", OBJECTS)
def test_an_attribute_is_found_under_its_old_name(kind):
    make, names = OBJECTS[kind]
    thing = make()
    for old, new in names.items():
        with pytest.warns(DeprecationWarning, match=rf"^{kind}\.{old} is called {kind}\.{new} now$") as caught:
            value = getattr(thing, old)
        assert value == getattr(thing, new) or value is getattr(thing, new)
        assert caught[0].filename == __file__


def test_every_renamed_attribute_has_its_test():
    listed = {name for _, names in OBJECTS.values() for name in names}
    kinds = (sb.Stops, sb.BeamProblem, sb.EnsembleMembers, sb.Trajectory, Advice)
    renamed = {name for kind in kinds for name, value in vars(kind).items() if isinstance(value, Renamed)}
    assert listed == renamed
    assert {"sure", "given", "contact", "free"} <= set(vars(Ledger))
