"""Lag and decay of a free run, mode by mode: known ones are found, and those of the schemes are as theory says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.files.cases import paper_case
from stiffbeam.measures.amplification import free_mode_errors
from stiffbeam.model.modes import modes
from stiffbeam.references.exact.contacts import within_float64
from stiffbeam.schemes import registered
from stiffbeam.studies import study
from stiffbeam.trajectory.trajectory import SolverFailure, Trajectory, Work


def signal(system: sb.System, late: np.ndarray, decay: np.ndarray, noise: float) -> Trajectory:
    """A run whose mode j turns by late_j too slowly and decays decay_j too fast, with a ripple upon it."""
    basis = modes(system)
    assert basis is not None
    t = np.arange(0.0, 4.0, 0.005)
    own = 0.5 * basis.damping
    turning = np.sqrt(basis.omega**2 - own**2)
    z = np.exp(np.outer(t, -(own + decay) + 1j * (turning - late)))
    z = z * (1.0 + noise * np.cos(37.0 * t)[:, None]) * (1.0 + noise * 1j * np.sin(41.0 * t)[:, None])
    # z = c' - conj(lambda) c with lambda = -own + i turning
    c = z.imag / turning
    rate = z.real - own * c
    q, v = (x @ basis.shapes.T for x in (c, rate))
    return Trajectory(
        t=t, tip=q[:, -1], tip_velocity=v[:, -1], contacts=(), work=Work(), provenance={"dt": 0.005}, system=system,
        pieces=lambda: iter([(t, q, v, np.zeros((len(t), 0)))]),
    )  # fmt: skip


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_a_lag_and_a_decay_put_into_a_run_are_found_within_the_stated_error(noise, damping):
    stiffness = np.array([[500.0, -200.0], [-200.0, 300.0]])
    system = sb.System.from_matrices(np.diag([1.0, 2.0]), stiffness, damping=damping * stiffness, observe=[0.0, 1.0])
    basis = modes(system)
    assert basis is not None
    late, decay = np.array([0.11, -0.3]), np.array([0.02, 0.3])
    found = free_mode_errors(signal(system, late, decay, noise))
    own = 0.5 * basis.damping
    turning = np.sqrt(basis.omega**2 - own**2)
    elongation = turning / (turning - late) - 1.0
    ratio = (own + decay) / np.hypot(own + decay, turning - late)
    # Rounding: ln z and its phase are good to some eps over a span of a few units.
    assert np.all(np.abs(found.period_elongation - elongation) <= found.elongation_error + 1e-12)
    assert np.all(np.abs(found.damping_ratio - ratio) <= found.damping_error + 1e-12)
    assert np.all(found.elongation_error < (1e-10 if noise == 0.0 else 0.1 * np.abs(elongation)))


def test_a_run_that_is_not_free_is_refused(table10):
    system = sb.semidiscretise(table10, 6)
    with pytest.raises(InputError, match="free"):
        free_mode_errors(sb.integrate(system, sb.HHT(), 1e-3, 0.1))


@pytest.mark.parametrize("viscosity", [0.0, 0.02])
def test_every_scheme_is_as_late_and_as_damped_as_theory_says(viscosity):
    case = paper_case(10)
    case = replace(case, cells=6, problem=replace(case.problem, viscosity=viscosity))
    labels = [str(scheme) for scheme in registered()]
    records = study("modes", case, schemes=labels, dt=2e-4, steps=1500)
    assert not records.lost
    measured = [row for row in records.table.to_dict("records") if np.isfinite(row["period_elongation"])]
    assert {row["scheme"] for row in measured if row["mode"] == 1} == set(labels)
    assert len(measured) > 0.8 * len(records.table)
    for row in measured:
        for name in ("period_elongation", "damping_ratio"):
            # The modal coordinates are good to eps (w_max/w_1)^2 of the basis.
            distance = abs(row[name] - row[f"{name}_theory"])
            assert distance <= row[f"{name}_error"] + 1e-10, (row["scheme"], row["mode"], name)


def falling_bar(n: int, stiffness: float) -> tuple[np.ndarray, np.ndarray, list[tuple[np.ndarray, sb.Constant]]]:
    """M, K and the weight of a free elastic bar of uneven springs, whose K times a uniform displacement is rounding."""
    M = np.diag([0.5, *np.ones(n - 1), 0.5]) / n
    K = np.zeros((n + 1, n + 1))
    for i in range(n):
        K[i : i + 2, i : i + 2] += stiffness * n * (1.0 + 0.1 * np.sin(i)) * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return M, K, [(np.diag(M).copy(), sb.Constant(1.0))]


@pytest.mark.parametrize(("n", "stiffness", "kappa"), [(10, 1e6, 1e5), (10, 1e10, 1e5)])
def test_a_free_bar_falls_from_a_uniform_displacement(n, stiffness, kappa):
    """q^T K q of a motion without strain is rounding, which may be negative: no energy is lost by it."""
    M, K, weight = falling_bar(n, stiffness)
    contact = sb.Contact(np.eye(n + 1)[-1], sb.Stops(upper=0.1, stiffness=kappa))
    system = sb.System.from_matrices(M, K, loads=weight, contacts=[contact], initial_displacement=np.full(n + 1, -0.3))
    run = sb.reference(system, 1.2)
    assert run.horizon > 0.7
    assert run.impacts.times[0] == pytest.approx(np.sqrt(0.8), rel=1e-9)  # a fall by 0.4


def test_only_an_overflow_is_called_one():
    """Message of ``within_float64`` by the kind of error."""
    for numbers, reason in (((1e200, 1e200), "overflows float64"), ((np.inf, 0.0), "has no result")):
        with pytest.raises(SolverFailure, match=reason), within_float64("exact", 1.0):
            np.multiply(*numbers)
