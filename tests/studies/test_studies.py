"""The studies: every one runs, answers, draws and saves, and says what went wrong."""

from __future__ import annotations

import json
import pkgutil
import random
from dataclasses import replace
from functools import cache
from importlib import import_module

import matplotlib.image
import numpy as np
import pandas
import pytest
from matplotlib.figure import Figure

import stiffbeam as sb
import stiffbeam.studies
from stiffbeam.basics.validation import InputError
from stiffbeam.figures import chart
from stiffbeam.figures.chart import EXACT, in_lines, look, short
from stiffbeam.files.cases import paper_case, parse_case
from stiffbeam.schemes import registered
from stiffbeam.studies import STUDIES, Records, find_study, study

SMALL = replace(paper_case(10), cells=8, t_end=0.8)


FREE = """
[[case]]
name = "free"
cells = 6
dt = 1e-3
t_end = 0.5
[case.problem]
stiffness = 300.0
base = { amplitude = 0.1, frequency = 10.0 }
"""

HEAVY = ("first_impact", "rigid", "rigid_bar", "rigid_beam", "chaos", "space", "converge")
BY_WEIGHT = [pytest.param(name, marks=pytest.mark.slow) if name in HEAVY else name for name in STUDIES]


@cache
def smoke(name: str) -> Records:
    """The smoke configuration on a small grid, once for all tests."""
    return study(name, SMALL, **find_study(name).smoke)


def test_the_registry_names_every_study_there_is():
    """A study is a module with a STUDY; each stands in the registry under its own name."""
    found = set()
    for module in pkgutil.iter_modules(stiffbeam.studies.__path__):
        one = getattr(import_module(f"stiffbeam.studies.{module.name}"), "STUDY", None)
        if one is not None:
            assert one.name == module.name
            found.add(one.name)
    assert found == set(STUDIES)


@pytest.mark.fast(4)
@pytest.mark.parametrize("name", BY_WEIGHT)
def test_a_study_answers_in_numbers_from_flat_rows(name):
    records = smoke(name)
    assert records.rows
    assert not records.failures
    assert any(c.isdigit() for c in records.answer)
    assert find_study(name).question.endswith("?")
    assert json.loads(json.dumps(records.rows)) is not None
    assert all(isinstance(v, (int, float, str, bool, type(None))) for row in records.rows for v in row.values())
    # Rows of one kind have one set of keys, whatever their scheme found; pairs are rates and distances.
    kinds: dict[str, set[frozenset[str]]] = {}
    parameters = {p for scheme in registered() for p in scheme.parameters} if name == "amplification" else set()
    for row in records.rows:
        kind = row.get("scheme") if row.get("scheme") in (*EXACT, None) else "a scheme"
        kinds.setdefault(str(row.get("kind", kind)), set()).add(frozenset(row) - parameters)
    assert all(len(keys) <= (2 if kind == "pairs" else 1) for kind, keys in kinds.items())
    assert len(records.to_dataframe()) == len(records.rows)


@pytest.mark.fast(3)
@pytest.mark.parametrize("name", BY_WEIGHT)
def test_a_study_draws_named_axes(name):
    figure = smoke(name).figure()
    assert figure.axes
    for axis in figure.axes:
        if axis.get_lines() or axis.patches or axis.collections:
            # A category axis has names for ticks instead.
            named = axis.get_ylabel() or axis.get_shared_y_axes().get_siblings(axis)[1:]
            assert named or any(c.isalpha() for tick in axis.get_yticklabels() for c in tick.get_text())
            assert axis.get_xlabel() or axis.get_shared_x_axes().get_siblings(axis)[1:] or axis.get_xticklabels()
            assert axis.get_title(loc="left") or axis.get_shared_x_axes().get_siblings(axis)[1:]
    assert figure.get_suptitle()


@pytest.mark.fast(1)
@pytest.mark.parametrize("name", STUDIES)
def test_a_study_saves_what_it_found(name, tmp_path, monkeypatch):
    write = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda figure, file, dpi, format: write(figure, file, dpi=dpi / 4, format=format)
    )  # for speed
    text, table, picture = smoke(name).save(tmp_path / "folder")
    document = json.loads(text.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert document["study"] == name
    assert document["answer"] == smoke(name).answer
    assert len(document["rows"]) == len(pandas.read_csv(table)) == len(smoke(name).rows)
    pixels = matplotlib.image.imread(picture)[..., :3]
    assert pixels.shape[1] == 11 * 200 // 4
    assert np.mean(np.any(pixels < 0.9, axis=-1)) > 0.005


def variants(rows, keys):
    """Rows as they may come: none, all failed, half of them, one scheme only, with holes, without a number."""
    rng = random.Random(1)
    numbers = {k for row in rows for k, v in row.items() if isinstance(v, float) and k not in keys}
    failed = [{k: v for k, v in row.items() if k in keys} | {"failed": "it overflowed"} for row in rows]
    lost = {str(row): rng.random() < 0.5 for row in failed}  # the rows of a point fail together
    who = "method" if "method" in rows[0] else "scheme"
    yield []
    yield failed
    yield [other if lost[str(other)] else one for one, other in zip(rows, failed, strict=True)]
    yield [row for row in rows if row.get(who) == rows[-1].get(who)]
    yield [{k: None if k in numbers and rng.random() < 0.3 else v for k, v in row.items()} for row in rows]
    yield [{k: float("nan") if k in numbers else v for k, v in row.items()} for row in rows]


@pytest.mark.fast(3)
@pytest.mark.parametrize("name", BY_WEIGHT)
def test_a_picture_survives_failed_missing_and_single_rows(name):
    records = smoke(name)
    keys = set().union(*find_study(name).plan(SMALL, **find_study(name).smoke))
    keys |= {"dt", "kappa", "t", "dt_over_period", "omega"}
    for rows in variants(records.rows, keys):
        replace(records, rows=rows).figure().canvas.draw()


@pytest.mark.parametrize("name", BY_WEIGHT)
def test_an_answer_does_not_need_every_point(name):
    """Some points may fail: whatever remains, one row or those of the truth alone, there is a sentence."""
    records = smoke(name)
    for rows in (records.rows[:1], records.rows[-1:], []):
        assert replace(records, rows=rows).answer.endswith((".", "evaluated: "))


@pytest.mark.fast(3)
@pytest.mark.parametrize("name", [n for n in STUDIES if not find_study(n).needs_stops])
def test_a_beam_without_stops_is_studied_too(name):
    case = parse_case(FREE, "free.toml")
    options = {k: v for k, v in find_study(name).smoke.items() if k != "t_end"}
    records = study(name, case, **options)
    assert [row for row in records.rows if "failed" not in row]
    records.figure().canvas.draw()
    assert records.answer


@pytest.mark.parametrize("name", [n for n in STUDIES if find_study(n).needs_stops])
def test_a_study_of_contact_wants_stops(name):
    with pytest.raises(InputError, match="have stops"):
        study(name, parse_case(FREE, "free.toml"))


def test_runs_of_other_programs_differ_in_colour(monkeypatch):
    """Their labels alone would give the first and the last one colour."""
    monkeypatch.setattr(chart, "_COLOUR_OF", {})
    labels = ["mine:midpoint", "mine:sundae", "mine:dfx"]
    colours = [look(label)["color"] for label in labels]
    assert len(set(colours)) == 3
    assert colours == [look(label)["color"] for label in labels]


def test_a_line_of_a_title_does_not_begin_with_a_sign():
    title = "Schemes lose 47 % (BDF2) of the energy to t = 3, the exact flow none"
    for width in range(14, 60):
        lines = in_lines(title, width).splitlines()
        assert " ".join(lines) == title
        assert not any(line.startswith(("%", "=")) or line.endswith("=") for line in lines)


def test_a_scheme_looks_the_same_everywhere_and_unlike_the_others():
    labels = [str(scheme) for scheme in registered()]
    assert short("SDIRK(gamma=0.4359, nystrom=True)") == short("sdirk") == "SDIRK(gamma=0.4359)"
    assert short("HHT(alpha=-0.1)") == "HHT(alpha=-0.1)"
    looks = {short(label): str(look(label)) for label in labels}
    assert all(str(look(label)) == looks[short(label)] for label in labels)
    assert len(set(looks.values())) == len(looks)
    # In grey print dashes and marker must do.
    defaults = [look(name) for name in sb.schemes.SCHEMES]
    assert len({(str(one["linestyle"]), one["marker"]) for one in defaults}) == len(defaults)
    assert look("exact")["color"] == look("reference")["color"] == "black"
    assert look("cvode") != look("ida")


def test_a_point_that_fails_is_a_row_and_the_others_are_there():
    """Extrapolated contact is unstable: kappa dt^2 over the mass at the tip is far above its limit here."""
    options = {"schemes": ["trapezoidal"], "forms": ["displacement"], "contact": "extrapolated", "dt": 1e-3}
    records = study("energy", SMALL, **options)
    (failed,) = records.failures
    assert failed["scheme"] == "Trapezoidal"
    assert "overflowed at t = 0." in failed["failed"]
    assert {row["scheme"] for row in records.rows} == {"exact", "Trapezoidal"}
    records.figure().canvas.draw()
    # A misprint refused at this step is bad input of that point, not of the study.
    refused = study("errata", SMALL, schemes=["SDIRK(nystrom=True)"], halvings=1, impacts=1)
    assert any("keep the printed (4.14)" in row["refused"] for row in refused.refusals)
    assert not refused.failures
    assert refused.found


def test_a_study_none_of_whose_points_succeed_says_why():
    records = study("errata", SMALL, schemes=["SDIRK(nystrom=True)"], halvings=1, impacts=1)
    assert "keep the printed" in replace(records, rows=records.refusals).answer


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: study("impact"), "did you mean impacts"),
        (lambda: study("impacts", SMALL, scheme=["bdf2"]), "did you mean schemes"),
        (lambda: study("amplification", "table99"), "be a table of the paper"),
        (lambda: study("amplification", SMALL, schemes=["bdf3"]), "BDF2"),
        (lambda: study("converge", SMALL, kinds=["bumpy"]), "smooth"),
        (lambda: study("amplification", SMALL, jobs=0), "jobs"),
        (lambda: study("converge", SMALL, kinds=["contact"], impacts=0), "impacts"),
        (lambda: study("rigid", SMALL, impacts=0), "impacts"),
    ],
)
def test_bad_input_is_named_with_its_remedy(call, words):
    with pytest.raises(InputError, match=words):
        call()


@pytest.mark.slow
@pytest.mark.parametrize(
    "scheme",
    [sb.HHT(-0.1), *(pytest.param(s, marks=pytest.mark.campaign) for s in (sb.Trapezoidal(), sb.ExponentialFlow()))],
    ids=str,
)
def test_the_means_of_fine_steps_are_those_of_exact_members(scheme):
    """Table 10 at dt = 1.6e-6. With starts 1e-12 apart HHT was 10 % off, of which +-3 % was said."""
    system, dt, members = paper_case(10).system("displacement"), 1e-4 / 64, 48
    exact = sb.reference_ensemble(system, 5.0, sb.perturbed_members(system, 192)).contacts[0].impact_count
    found = sb.integrate_ensemble(system, scheme, dt, 5.0, sb.perturbed_members(system, members))
    count = found.contacts[0].impact_count
    deviation = np.sqrt(np.var(exact, ddof=1) / len(exact) + np.var(count, ddof=1) / members)
    assert abs(np.mean(count) - np.mean(exact)) < 4.0 * deviation
    assert deviation < 0.02 * np.mean(exact)
