"""The page of gradients through contact: its tables are its records, and the quick engines give these again."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

import stiffbeam as sb

STUDIES = Path(__file__).parents[2] / "studies"


@pytest.fixture(scope="module")
def gradients():
    pytest.importorskip("heyoka")
    before = list(sys.path)
    yield runpy.run_path(str(STUDIES / "gradients.py"))
    sys.path[:] = before


def test_the_tables_are_those_of_the_records(gradients):
    page = (STUDIES / "guide" / "derivatives.md").read_text(encoding="utf-8")
    for engines, names in (("ENGINES", "COMPLIANT"), ("OF_RIGID", "RIGID")):
        assert "\n".join(gradients["table"](gradients[engines], gradients[names])) in page


@pytest.mark.fast(2)
@pytest.mark.parametrize(
    ("label", "name", "bound"),
    [
        ("heyoka, variational equations", "bilinear-gap", 1e-10),
        ("SciPy DOP853, rtol 1e-12, restarted at events", "bilinear-gap", 1e-5),
        ("exact solution, `reference.derivative`", "bilinear-gap", 1e-10),
        ("trapezoidal, conserving contact", "bilinear-gap", 1e-2),
    ],
)
def test_a_quick_engine_gives_its_record_again(label, name, bound, gradients):
    """Errors of rounding differ from machine to machine; larger ones do not."""
    import json

    problem = sb.problem(name)
    known = json.loads((STUDIES / "gradients.json").read_text(encoding="utf-8"))[label][name]
    value, gradient = gradients["errors"](problem, gradients["ENGINES"][label](problem))
    assert gradient < bound
    assert known["gradient"] < bound
    if known["gradient"] > 1e-4:
        assert gradient == pytest.approx(known["gradient"], rel=1e-3)
        assert value == pytest.approx(known["value"], rel=1e-3)


def test_the_known_derivative_itself_is_the_measure(gradients):
    problem = sb.problem("bilinear-gap")
    right = {path: answer.value for path, answer in problem.derivatives["tip"].items()}
    tip = problem.answers["tip"].value[-1]
    assert gradients["errors"](problem, (tip, right)) == (0.0, 0.0)
    wrong = right | {"q0[0]": 1.5 * right["q0[0]"]}
    assert gradients["errors"](problem, (tip, wrong))[1] == pytest.approx(0.5)
