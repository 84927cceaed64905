"""The registry of reference solvers: complete, and the only place that lists them."""

from __future__ import annotations

import dataclasses
import re
from importlib import import_module

import numpy as np
import pytest
from test_house import MODULES, arrows

import stiffbeam as sb
from stiffbeam.references import METHODS, REFERENCES, registry, solve
from stiffbeam.references.registry import ADAPTIVE, COMPARED, EXACT, MULTIPRECISION, Method

KINDS = {"exact": EXACT, "multiprecision": MULTIPRECISION, "adaptive": ADAPTIVE}  # a room of references each


@pytest.mark.parametrize("method", REFERENCES.values(), ids=lambda method: method.name)
def test_every_method_stands_in_the_room_of_its_kind_and_says_how_it_solves(method):
    assert KINDS[method.module.partition(".")[0]] == method.kind
    assert callable(import_module(f"stiffbeam.references.{method.module}").solve)
    assert "missing" not in method.versions().values()


def test_every_adaptive_solver_has_a_look_of_its_own_and_the_exact_ones_that_of_the_exact_motion():
    from stiffbeam.figures.chart import look, short

    assert len({method.look for method in REFERENCES.values()}) == len(METHODS)
    looks = {name: str(look(name)) for name in METHODS}
    exact = {looks.pop(name) for name in METHODS if REFERENCES[name].kind != ADAPTIVE}
    assert exact == {str(look("reference"))}
    assert len({*looks.values(), *exact}) == len(looks) + 1
    assert len({short(name) for name in METHODS}) == len(METHODS)


def test_no_other_file_lists_the_solvers():
    """Who names more than the two that a remedy may name has a list of its own."""
    named = {}
    for name, path in MODULES.items():
        found = set(re.findall(r"\"([a-z0-9-]+)\"", path.read_text(encoding="utf-8"))) & set(METHODS)
        adaptive = {m for m in found if REFERENCES[m].kind == ADAPTIVE}
        if len(adaptive) > 2 and name not in ("references", "references.registry"):  # its docstring, and the registry
            named[name] = adaptive
    assert not named


def test_the_rooms_of_references_part():
    """Who reads an adaptive solver passes no search for switches, and the exact one needs no adaptive solver."""
    for room, others in (("adaptive", ("exact", "multiprecision")), ("exact", ("adaptive", "multiprecision"))):
        for module, targets in arrows().items():
            if module.startswith(f"references.{room}."):
                assert not [t for t in targets if t.startswith(tuple(f"references.{other}" for other in others))]
    # The call finds solvers by their names in the registry, which no import shows: none of them may import it.
    # An ensemble is a client of the call.
    clients = {m for m, targets in arrows().items() if m.startswith("references.") and "references" in targets}
    assert clients == {"references.ensemble", "references.jax_flow"}


def test_a_method_that_is_added_needs_its_file_and_its_line_only(monkeypatch):
    """Seen by the call, the horizon, the cache's key and the picture."""
    from stiffbeam.figures.chart import look, short

    added = Method("bulirsch", "adaptive.sundials", "Bulirsch", 99, 0.2, libraries={"numpy": "numpy"})
    monkeypatch.setitem(registry.REFERENCES, "bulirsch", added)
    system = sb.semidiscretise(sb.paper_case(10).problem, 8)
    run = sb.reference(system, 0.01, "bulirsch", rtol=1e-8)
    assert run.provenance["method"] == "bulirsch"
    assert run.provenance["numpy"] == np.__version__
    assert run.horizon == 0.01
    assert sb.cached_reference(system, 0.01, "bulirsch", rtol=1e-8).horizon == 0.01
    assert short("bulirsch") == "Bulirsch"
    assert look("bulirsch") != look("cvode")


def test_what_a_method_cannot_take_is_refused(table10_system):
    assert set(COMPARED) <= set(METHODS)
    with pytest.raises(sb.InputError, match="max_step must be left out for exact"):
        sb.reference(table10_system, 0.01, "exact", max_step=1e-3)
    with pytest.raises(sb.InputError, match=r"method must be a reference method.*cvode"):
        sb.cached_reference(table10_system, 0.01, "cvodes")


def test_a_library_that_fails_inside_is_no_missing_method(table10_system, monkeypatch):
    """A module of another name that is missing is a fault to be seen, not one to be installed away."""
    monkeypatch.setitem(registry.REFERENCES, "cvode", dataclasses.replace(REFERENCES["cvode"], module="adaptive.none"))
    with pytest.raises(ModuleNotFoundError, match=re.escape("stiffbeam.references.adaptive.none")):
        solve(table10_system, 0.01, "cvode", None, 1e-6, None)
