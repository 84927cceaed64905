"""How long contacts last: against a dense sampling of the exact motion, and a mass that bounces on a spring."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.files.cases import Case, paper_case
from stiffbeam.studies import study
from stiffbeam.studies.contact_duration import half_time

SMALL = replace(paper_case(10), cells=8, t_end=0.3)


def test_half_of_the_time_is_spent_in_contacts_at_least_so_long():
    assert half_time(np.array([3.0, 1.0, 1.0, 1.0])) == 1.0
    assert half_time(np.array([4.0, 1.0, 1.0, 1.0])) == 4.0
    assert half_time(np.array([2.0])) == 2.0


@pytest.mark.slow
def test_durations_are_those_that_a_fine_grid_sees(monkeypatch):
    """One exact member, inside its horizon: every contact lasts as long as u is beyond the stop on a grid."""
    monkeypatch.setattr(
        import_module("stiffbeam.studies.contact_duration"), "SPREAD", 1e-12
    )  # it is the case itself, to the horizon
    records = study("contact_duration", SMALL, schemes=[], members=1)
    exact = sb.reference(sb.semidiscretise(SMALL.problem, 8), SMALL.t_end)
    assert exact.horizon == SMALL.t_end
    fine = 2e-7
    u = exact.at(np.arange(0.0, SMALL.t_end, fine))[0]
    stops = SMALL.problem.stops
    assert np.any(u > stops.upper_bound)
    for name, beyond in (("upper", u > stops.upper_bound), ("lower", u < stops.lower_bound)):
        changes = np.flatnonzero(np.diff(beyond.astype(int)))
        lengths = np.sort(fine * np.diff(changes)[::2])  # whole contacts: in at an even change, out at the next
        rows = [r for r in records.found if r["kind"] == "summary" and r["stop"] == name and r["method"] == "exact"]
        assert len(rows) == bool(len(lengths))
        if not rows:
            continue
        (row,) = rows
        assert row["contacts"] == len(lengths) > 3
        for found, wanted in (
            (row["mean"], np.mean(lengths)), (row["median"], np.median(lengths)),
            (row["longest"], lengths[-1]), (row["half_time"], half_time(lengths)),
        ):  # fmt: skip
            assert found == pytest.approx(wanted, abs=2 * fine)


@pytest.mark.parametrize("scheme", ["trapezoidal", "HHT(alpha=-0.1)", "bdf2", "SDIRK(gamma=0.4359, nystrom=True)"])
def test_a_scheme_s_contact_of_a_free_mass_lasts_half_a_period(scheme, monkeypatch):
    """m x'' = -kappa (x - g)_+ from outside: the contact lasts pi sqrt(m/kappa), to the scheme's order."""
    mass, kappa = 2.0, 5e3
    exact = np.pi * np.sqrt(mass / kappa)
    contact = sb.Contact([1.0], sb.Stops(upper=0.1, stiffness=kappa))
    free = sb.System.from_matrices([[mass]], [[0.0]], contacts=[contact], initial_velocity=[1.0])
    monkeypatch.setattr(Case, "system", lambda case, form=None: free)
    case = replace(SMALL, t_end=0.5)
    records = study("contact_duration", case, schemes=[scheme], dt=exact / 10.0, halvings=6, impacts=1, members=1)
    (row,) = [r for r in records.found if r["kind"] == "summary" and r["method"] == "exact"]
    assert row["median"] == pytest.approx(exact, rel=1e-10)
    pairs = [r for r in records.found if r["kind"] == "pairs" and r["exact"]]
    assert all(r["pairs"] == r["exact"] == 1 for r in pairs)
    # Entry and exit fall somewhere into their steps: the order holds over several halvings, not over each.
    slope = np.polyfit(np.log([r["dt"] for r in pairs]), np.log([r["error"] for r in pairs]), 1)[0]
    assert slope > 1.5
    assert pairs[-1]["error"] < 1e-3
