"""A case with rigid stops: its own schemes in every study, its references, and no peak of an impact."""

from __future__ import annotations

import pytest

from stiffbeam.files.cases import parse_case
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


@pytest.mark.slow
def test_a_comparison_asks_the_exact_solution_only():
    result = CaseComparison(CASE)
    list(result.run())
    assert [r.provenance["method"] for r in result.references] == ["exact"]
    assert not result.failures
    asked = CaseComparison(CASE)
    list(asked.run(references=("exact", "cvode")))
    assert [failure[:2] for failure in asked.failures] == [("refused", "cvode@displacement")]
    assert str(asked.report()).count("refused  cvode@displacement") == 1
