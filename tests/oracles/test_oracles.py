"""The witnesses share no code with what they witness, and know the closed forms themselves."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from witness import Case, Contact, solve, wave_value

HERE = Path(__file__).parent
WITNESSES = ("oracles", "witness", "random_systems")
ALLOWED = {"numpy", "scipy", "mpmath", *WITNESSES}
ONE = np.ones((1, 1))


def oscillator(m, k, kappa, stop, v0, t_end, **changes) -> Case:
    """One mass on a spring below an upper stop."""
    return Case(
        m * ONE, 0.0 * ONE, k * ONE, np.zeros(1), np.array([v0]), changes.get("loads", ()),
        (Contact(np.ones(1), changes.get("lower", -np.inf), stop, kappa, changes.get("offset")),), np.ones(1), t_end,
    )  # fmt: skip


@pytest.mark.parametrize("name", WITNESSES)
def test_a_witness_imports_nothing_of_the_package(name):
    import sys

    found = set()
    for node in ast.walk(ast.parse((HERE / f"{name}.py").read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level
            found.add(str(node.module).split(".")[0])
    others = {module for module in found if module not in sys.stdlib_module_names}
    assert others <= ALLOWED, others - ALLOWED
    assert not found & {"importlib", "stiffbeam"}


def test_a_dip_between_two_grid_points_is_seen():
    """A graze that is a hundredth of a grid interval long."""
    w, depth = 2.0, 1e-9
    case = oscillator(1.0, w**2, 100.0, (1.0 - depth) / w, 1.0, 1.5)
    [episode] = solve(case).episodes(0)
    assert episode.end - episode.begin < 2.1 * np.sqrt(2.0 * depth) * 1.01
    assert abs(episode.begin + episode.end - np.pi / w) < 1e-7


@pytest.mark.slow
def test_every_regime_of_records_dashpots_and_moving_stops_against_a_runge_kutta_method():
    """DOP853 restarted at every sample of the record and every event: its own tolerance is 1e-12."""
    rng = np.random.default_rng(5)
    mass = np.diag([1.0, 0.6])
    stiffness = np.array([[60.0, -20.0], [-20.0, 20.0]])
    damping = np.diag([0.0, 0.3])
    loads = (
        (np.array([1.0, 2.0]), ("sampled", np.array([0.0, 0.35, 0.4, 0.5, 3.0]), np.array([0.0, 0.0, 30.0, 0.0, 0.0]))),
        (np.array([0.0, 1.0]), ("harmonic", 5.0, 4.0, 0.3)),
        (np.array([1.0, 0.0]), ("constant", 2.0)),
    )
    contacts = (
        Contact(np.array([0.0, 1.0]), -0.3, 0.25, 800.0, ("harmonic", 0.05, 3.0, 0.1)),
        Contact(np.array([1.0, 0.2]), -np.inf, 0.15, 500.0),
    )
    case = Case(mass, damping, stiffness, np.zeros(2), rng.normal(size=2), loads, contacts, np.array([0.0, 1.0]), 1.0)

    def rate(t, y):
        q, v = y[:2], y[2:]
        force = -stiffness @ q - damping @ v + sum(p * float(wave_value(w, t)) for p, w in loads)
        for c in contacts:
            u = c.row @ q + (0.0 if c.offset is None else float(wave_value(c.offset, t)))
            force = force - c.kappa * (max(u - c.upper, 0.0) - max(c.lower - u, 0.0)) * c.row
        return np.concatenate([v, np.linalg.solve(mass, force)])

    motion = solve(case)
    ends = np.append(motion.starts[1:], case.t_end)
    y, inside = np.concatenate([case.q0, case.v0]), 1e-9
    for begin, end in zip(motion.starts, ends, strict=True):
        run = solve_ivp(rate, (begin, end), y, method="DOP853", rtol=1e-12, atol=1e-14)
        y = run.y[:, -1]
        q, v = motion.states(np.array([end - inside * (end - begin)]))
        assert np.max(np.abs(np.concatenate([q[0], v[0]]) - y)) < 1e-7  # the last 1e-9 of the piece apart
    many = solve(case, 40).states(np.linspace(0.0, 1.0, 11))
    few = motion.states(np.linspace(0.0, 1.0, 11))
    assert sum(len(motion.episodes(i)) for i in range(2)) > 3
    assert max(np.max(np.abs(a - b)) for a, b in zip(many, few, strict=True)) < 1e-11
