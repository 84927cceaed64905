"""A case with rigid stops: its own schemes in every study, its references, and no peak of an impact."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

import stiffbeam as sb
from stiffbeam.files.cases import parse_case
from stiffbeam.measures.report import report
from stiffbeam.schemes import RIGID, SCHEMES
from stiffbeam.studies.common import chosen
from stiffbeam.studies.comparison import compare_case

CASE = parse_case(
    """
[[case]]
name = "wall"
cells = 6
dt = 1e-4
t_end = 0.1
runs = ["MoreauJean(theta=0.6)"]
[case.problem]
stiffness = 300.0
stops = { lower = -0.1, upper = 0.1, stiffness = inf, restitution = 0.5 }
base = { amplitude = 0.2, frequency = 10.0 }
""",
    "wall.toml",
)


def test_studies_run_the_schemes_of_the_case_and_those_for_rigid_stops():
    labels = chosen(CASE)
    assert "MoreauJean(theta=0.6)" in labels
    with_impacts = {kind.__name__ for kind in RIGID.values() if kind().restitutes}
    assert {label.partition("(")[0] for label in labels} == with_impacts
    assert {label.partition("(")[0] for label in chosen(sb.paper_case(10))} == {
        kind.__name__ for kind in SCHEMES.values()
    } - {"Theta"}


@pytest.mark.slow
def test_a_comparison_asks_the_exact_solution_only():
    result = compare_case(CASE)
    assert [r.provenance["method"] for r in result.references] == ["exact"]
    assert not result.failures
    asked = compare_case(CASE, references=("exact", "cvode"))
    assert asked.refused == {"cvode@displacement"}
    said = io.StringIO()
    tables = report(asked.comparisons, asked.references, asked.failures, asked.truths, asked.refused).rich()
    Console(file=said, width=200).print(tables)
    assert said.getvalue().count("refused  cvode@displacement") == 1
    assert "failed" not in said.getvalue()


def test_impacts_have_impulses_and_no_peak():
    """A ball that meets a wall at speed 1 takes 1.5 from it, in one step or at once: no force of that is largest."""
    stops = sb.Stops(upper=0.5, stiffness=np.inf, restitution=0.5)
    contacts = [sb.Contact([1.0], stops)]
    ball = sb.System.from_matrices([[1.0]], [[0.0]], contacts=contacts, initial_velocity=[1.0])
    for run in (sb.integrate(ball, sb.MoreauJean(), 0.01, 1.0), sb.reference(ball, 1.0)):
        assert run.impacts.count == 1
        assert np.isnan(run.impacts.peaks[0])
        assert np.isnan(run.contacts[0].peak_force)
        assert abs(run.impacts.impulses[0] - 1.5) < 1e-12
    for run in (sb.integrate(ball, sb.MoreauJean(), 0.01, 0.2), sb.reference(ball, 0.2)):
        assert run.contacts[0].peak_force == 0.0
