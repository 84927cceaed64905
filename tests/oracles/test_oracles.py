"""The witnesses share no code with what they witness, and know the closed forms themselves."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import numpy as np
import pytest
from witness import Case, Contact, solve

HERE = Path(__file__).parent
WITNESSES = ("oracles", "witness", "random_systems")
ALLOWED = {"numpy", "scipy", "mpmath", *WITNESSES}


@pytest.mark.parametrize("name", WITNESSES)
def test_a_witness_imports_nothing_of_the_package(name):
    nodes = list(ast.walk(ast.parse((HERE / f"{name}.py").read_text())))
    found = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    found |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    assert {module.partition(".")[0] for module in found} - sys.stdlib_module_names <= ALLOWED
    assert "importlib" not in found


def test_a_dip_between_two_grid_points_is_seen():
    """A graze that is a hundredth of a grid interval long."""
    w, depth = 2.0, 1e-9
    one, none, stop = np.ones((1, 1)), np.zeros(1), (1.0 - depth) / w
    case = Case(one, 0 * one, w**2 * one, none, np.ones(1), (), (Contact(one[0], -np.inf, stop, 100.0),), one[0], 1.5)
    [episode] = solve(case).episodes(0)
    assert episode.end - episode.begin < 2.1 * np.sqrt(2.0 * depth) * 1.01
    assert abs(episode.begin + episode.end - np.pi / w) < 1e-7
