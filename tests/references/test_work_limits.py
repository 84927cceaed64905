"""A solver that cannot finish in reasonable time says so: before it starts where that is known, else on its way."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.integrate

import stiffbeam as sb
from stiffbeam.basics import resources
from stiffbeam.references.adaptive import restarts
from stiffbeam.references.adaptive.scipy import MOST_STEPS, STABLE


def dashpot(rate):
    """x'' + rate x' + x = 0, one mode that decays at ``rate``."""
    return sb.System.from_matrices([[1.0]], [[1.0]], [[rate]], observe=[1.0], initial_displacement=[1.0])


def test_the_stability_limit_of_dop853():
    """R(z) = 1 + z b^T (I - z A)^-1 1 from the coefficients: nothing farther than STABLE is stable, -6.3 is."""
    method = scipy.integrate.DOP853
    A, b = method.A[: len(method.B), : len(method.B)], method.B

    def R(z):
        return 1.0 + z * (b @ np.linalg.solve(np.eye(len(b)) - z * A, np.ones(len(b))))

    angles = np.linspace(0.5 * np.pi, np.pi, 181)
    assert all(abs(R(r * np.exp(1j * a))) > 1.0 for a in angles for r in np.linspace(STABLE, 40.0, 60))
    assert abs(R(-6.3)) < 1.0


def test_an_explicit_method_on_a_stiff_system_is_refused_before_it_starts():
    rate, t_end = 1e6, 4.0
    with pytest.raises(sb.InputError, match=r"500000 steps to be stable.*5\.9e\+05.*use the solver cvode"):
        sb.reference(dashpot(rate), t_end, "dop853")
    assert rate * t_end / STABLE > MOST_STEPS
    assert sb.reference(dashpot(rate), t_end, "cvode", [0.0, t_end]).work.counters["rhs"] < 2000
    hard = 1.0 / np.sqrt(np.array([1e-16, 1.0]))
    with pytest.raises(sb.InputError, match="dop853"):
        sb.reference(sb.System.from_matrices(np.diag(hard**-2), np.eye(2), observe=[0.0, 1.0]), 1.0, "dop853")


def test_the_estimate_is_what_stability_costs():
    """At a tenth of a per mille of the limit the steps taken are those that were estimated, up to a third more."""
    rate, t_end = 1e4, 2.0
    found = sb.reference(dashpot(rate), t_end, "dop853", [0.0, t_end])
    steps = found.work.counters["rhs"] / 12.0
    assert 1.0 < steps / (rate * t_end / STABLE) < 1.4


@pytest.mark.fast(2)
@pytest.mark.parametrize("method", ["cvode", "cvode-adams", "ida", "dop853", "radau", "kvaerno3"])
def test_work_without_end_is_given_up(method, monkeypatch):
    monkeypatch.setattr(restarts, "MOST_EVALUATIONS", 300)
    system = sb.System.from_matrices([[1.0]], [[1.0]], observe=[1.0], initial_displacement=[1.0])
    with pytest.raises(sb.SolverFailure, match="more than 300; loosen rtol") as failure:
        sb.reference(system, 500.0, method)
    assert 0.0 < failure.value.t < 500.0


def test_what_no_pass_repeats_takes_its_time_from_all(monkeypatch):
    """Of 20 s for 10 passes 10 s of compiling leave 1 s for each."""
    now = [0.0]
    monkeypatch.setattr(resources, "clock", lambda: now[0])
    with resources.deadline(20.0, 10.0):
        with resources.once():
            now[0] = 10.0
        now[0] = 10.9
        resources.in_time(0.5)
        now[0] = 11.1
        with pytest.raises(resources.OutOfTime):
            resources.in_time(0.5)
