"""A case with rigid stops is compared with the exact solution alone."""

from __future__ import annotations

import pytest

import stiffbeam as sb
from stiffbeam.files.cases import case_of
from stiffbeam.studies.comparison import CaseComparison


@pytest.mark.slow
def test_a_comparison_asks_the_exact_solution_only():
    stops = sb.Stops(-0.1, 0.1, stiffness=float("inf"), restitution=0.5)
    beam = sb.BeamProblem(stiffness=300.0, stops=stops, base=sb.Harmonic(0.2, 10.0))
    case = case_of(sb.semidiscretise(beam, 6), 1e-4, 0.1)
    result = CaseComparison(case)
    list(result.run())
    assert [r.provenance["method"] for r in result.references] == ["exact"]
    assert not result.failures
    asked = CaseComparison(case)
    list(asked.run(references=("exact", "cvode")))
    assert [failure[:2] for failure in asked.failures] == [("refused", "cvode@displacement")]
    assert str(asked.report()).count("refused  cvode@displacement") == 1
