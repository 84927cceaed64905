"""The registry of reference solvers."""

from __future__ import annotations

import dataclasses
import re
from importlib import import_module

import pytest

from stiffbeam.references import REFERENCES, registry, solve
from stiffbeam.references.registry import ADAPTIVE, EXACT, MULTIPRECISION

KINDS = {"exact": EXACT, "multiprecision": MULTIPRECISION, "adaptive": ADAPTIVE}  # a room of references each


@pytest.mark.parametrize("method", REFERENCES.values(), ids=lambda method: method.name)
def test_every_method_stands_in_the_room_of_its_kind_and_says_how_it_solves(method):
    assert KINDS[method.module.partition(".")[0]] == method.kind
    assert callable(import_module(f"stiffbeam.references.{method.module}").solve)
    assert "missing" not in method.versions().values()


def test_a_library_that_fails_inside_is_no_missing_method(table10_system, monkeypatch):
    """A module of another name that is missing is a fault to be seen, not one to be installed away."""
    monkeypatch.setitem(registry.REFERENCES, "cvode", dataclasses.replace(REFERENCES["cvode"], module="adaptive.none"))
    with pytest.raises(ModuleNotFoundError, match=re.escape("stiffbeam.references.adaptive.none")):
        solve(table10_system, 0.01, "cvode", None, 1e-6, None)
