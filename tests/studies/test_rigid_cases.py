"""A case with rigid stops: its own schemes in every study, its references, and no peak of an impact."""

from __future__ import annotations

import pytest

import stiffbeam as sb
from stiffbeam.files.cases import parse_case
from stiffbeam.measures.report import report
from stiffbeam.schemes import RIGID, SCHEMES
from stiffbeam.studies.common import chosen
from stiffbeam.studies.comparison import CaseComparison

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
    result = CaseComparison(CASE)
    list(result.run())
    assert [r.provenance["method"] for r in result.references] == ["exact"]
    assert not result.failures
    asked = CaseComparison(CASE)
    list(asked.run(references=("exact", "cvode")))
    assert asked.refused == {"cvode@displacement"}
    said = str(report(asked.comparisons, asked.references, asked.failures, asked.refused))
    assert said.count("refused  cvode@displacement") == 1
    assert "failed" not in said
