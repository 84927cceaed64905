"""Every system that a user may bring, through every command and every study: an answer with numbers, or a refusal that
this file names."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_system import BENCHES, ball

import stiffbeam as sb
from stiffbeam import references
from stiffbeam.basics.validation import InputError
from stiffbeam.files.cases import case_of
from stiffbeam.studies import STUDIES, comparison, find_study
from stiffbeam.studies import references as stored
from stiffbeam.studies.common import smoke_options

# What may be refused, by the study that may refuse it: no other reason is good enough.
REFUSED = {
    "space": "be a beam with a grid",
    "first_impact": "be a beam with a grid",
    "rigid_beam": "be a beam with stops",
    "rigid": "0 for rigid stops|at one place|at rest for rigid stops|for a limit of rigid stops",
    "sweep": "without a period|move at the drive's frequency|exactly one Harmonic drive",
    "orbits": "a linear law|one drive frequency|exactly one Harmonic drive|be a multiple of 2 pi",
    "errata": "keep the printed|have a misprint",  # some grow at some steps; HHT has none beside its contact
    "modes": "does not oscillate|no mode oscillates",  # over-damped, or without any stiffness beside the stops
    "chaos": "neighbouring motions become equal",  # by blows with e = 0, after which nothing of a neighbour is left
}
NONE = "(?!)"  # which matches nothing
WITHOUT_STOPS = "have stops"

OPTIONS: dict[str, dict[str, Any]] = {  # beside the smoke options: longer where these are too short, else cheaper
    "modes": {"steps": 4000},
    "ensemble": {"members": 4},
    "impacts": {"members": 2},
    "contact_duration": {"members": 2},
}
ANY_CASE = ("amplification", "restitution", "rigid_bar")  # which ask nothing of the case
COMMANDS = ("compare", "advise", "reference", "agree", "animate")
FAST = {  # a cheap cell of what once failed
    ("modes", "feeder"),
    ("converge", "feeder"),
    ("errata", "one-sided Hertz chain"),
    ("impacts", "rigid impact damper"),
    ("chaos", "feeder"),
    ("sweep", "two bodies with a dashpot between"),
    ("reference", "ball on a vibrating table"),
    ("compare", "feeder"),
}
WAITING: dict[tuple[str, str], str] = {}  # cells that fail yet, with the reason


def cells(names: tuple[str, ...]) -> list[Any]:
    """Every system times these commands or studies: FAST, else every second one slow as on a chessboard, or a campaign.

    Those that wait are expected to fail.
    """
    order = list(BENCHES)

    def cell(what: str, name: str) -> Any:
        odd = (names.index(what) + order.index(name)) % 2
        marks = [] if (what, name) in FAST else [pytest.mark.campaign if odd else pytest.mark.slow]
        if (what, name) in WAITING:
            marks += [pytest.mark.xfail(reason=WAITING[what, name], strict=True)]
        return pytest.param(what, name, id=f"{what}-{name.replace(' ', '-')}", marks=marks)

    return [cell(what, name) for what in names for name in (order[:1] if what in ANY_CASE else order)]


@pytest.mark.parametrize(("study", "name"), cells(tuple(STUDIES)))
def test_every_study_answers_or_refuses_for_a_reason_named_here(study, name):
    system, dt, t_end = BENCHES[name]()
    options = smoke_options(find_study(study), case_of(system, dt, t_end)) | OPTIONS.get(study, {})
    records, refused = None, ""
    try:
        records = sb.study(study, system, dt=dt, t_end=t_end, **options)
    except InputError as error:
        refused = str(error)
    if records is None:
        allowed = REFUSED.get(study, NONE) + ("" if system.contacts else f"|{WITHOUT_STOPS}")
        assert re.search(allowed, refused), refused
        return
    assert not records.failures, records.failures[0]["failed"]
    for row in records.refusals:
        assert re.search(REFUSED.get(study, NONE), row["refused"]), row["refused"]
    if records.refusals and not records.found:
        return
    assert any(c.isdigit() for c in records.answer)
    assert "No point" not in records.answer
    assert records.figure().axes


def toml(system: sb.System, dt: float, t_end: float) -> str:
    """The system as a case file."""

    def function(f: Any) -> str:
        if isinstance(f, sb.Constant):
            return f"constant = {f.level!r}"
        if isinstance(f, sb.Sampled):
            return f"sampled = {{ t = {f.t.tolist()}, values = {f.values.tolist()} }}"
        return f"amplitude = {f.amplitude!r}, frequency = {f.frequency!r}, phase = {f.phase!r}"

    lines = ["[[case]]", 'name = "own"', f"dt = {dt}", f"t_end = {t_end}", "[case.system]"]
    lines += [f"{x} = {getattr(system, x).tolist()}" for x in ("mass", "stiffness", "damping")]
    lines += [f"initial_displacement = {system.q0.tolist()}", f"initial_velocity = {system.v0.tolist()}"]
    lines += [f"observe = {system.channels[system.tip_channel][0].tolist()}"]
    loads = ", ".join(f"{{ row = {vector.tolist()}, {function(f)} }}" for vector, f in system.loads)
    lines += [f"loads = [{loads}]"]
    for contact in system.contacts:
        lines += ["[[case.system.contacts]]", f"row = {contact.row.tolist()}"]
        lines += [f"{key} = {value!r}" for key, value in contact.stops.data.items()]
        lines += [] if contact.offset is None else [f"offset = {{ {function(contact.offset)} }}"]
    return "\n".join(lines)


def asked(what: str, file: str) -> list[str]:
    """The command line that asks ``what`` of a case file."""
    return {
        "compare": ["compare", file, "--json", "-"],
        "advise": ["advise", file, "--most-steps", "2048", "--members", "4", "--json", "-"],
        "reference": ["reference", file, "--json", "-"],
        "agree": ["reference", file, "--method", "all", "--budget", "2", "--json", "-"],
        "animate": ["animate", file, "--seconds", "0.1", "--json", "-"],
    }[what]


PYTHON = re.compile(r"stiffbeam\.[A-Z]|sb\.|\w+='|\w+\(\w*=")  # what only a programmer can write


@pytest.fixture
def uncompiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the solvers that compile for half a minute for each system: their own tests run them."""

    def solve(system: sb.System, t_end: float, method: str, *options: Any) -> sb.Reference:
        if method.startswith("kvaerno"):
            raise InputError("method", method, "start within seconds", "see its own tests")
        return references.solve(system, t_end, method, *options)

    monkeypatch.setattr(stored, "solve", solve)
    monkeypatch.setattr(comparison, "COMPARED", tuple(m for m in comparison.COMPARED if not m.startswith("kvaerno")))


@pytest.mark.usefixtures("uncompiled")
@pytest.mark.parametrize(("what", "name"), cells(COMMANDS))
def test_every_command_answers(what: str, name: str, command: Callable[..., tuple[int, str, str]]):
    Path("own.toml").write_text(toml(*BENCHES[name]()), encoding="utf-8")
    code, out, err = command(*asked(what, "own.toml"))
    found = json.loads(out)
    if what == "compare":
        assert found["comparisons"], found["failures"]
        assert all(c["reference"] for c in found["comparisons"])
        assert not found["failures"]
    elif what == "advise":
        assert found["recommendation"] or found["unattainable"]
        assert code == (0 if found["recommendation"] else 1)
        return
    elif what == "reference":
        assert found["references"][0]["horizon"] > 0.0
    elif what == "agree":
        assert found["references"][0]["horizons"]
        said = " ".join(found["references"][0]["skipped"].values())
        assert not PYTHON.search(said), said
    else:
        assert Path(found["file"]).is_file()
    assert code == 0, err


def test_a_remedy_of_a_command_is_none_of_python(command):
    """Of the exact solution on a law it does not take, and of a scheme without an impact law."""
    Path("own.toml").write_text(toml(*BENCHES["drop on a Hunt-Crossley stop"]()), encoding="utf-8")
    code, _, err = command("reference", "own.toml", "--method", "exact")
    assert (code, "use the adaptive solver cvode" in err) == (2, True)
    Path("own.toml").write_text(toml(*BENCHES["rigid impact damper"]()), encoding="utf-8")
    code, _, err = command("compare", "own.toml", "--schemes", "bdf2")
    assert (code, "use moreau-jean" in err) == (2, True)
    assert not PYTHON.search(err)


@pytest.mark.parametrize("method", ["exact", "multiprecision"])
def test_the_remedy_for_a_stop_that_moves_along_a_polygon_is_one_of_case_files(method, command):
    system = ball(sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.5), 0.5)
    polygon = sb.Sampled([0.0, 1.0, 2.0], [0.0, 0.1, 0.0])
    moved = replace(system, contacts=(replace(system.contacts[0], offset=polygon),))
    Path("own.toml").write_text(toml(moved, 1e-3, 1.0), encoding="utf-8")
    code, _, err = command("reference", "own.toml", "--method", method)
    assert (code, 'take samples of kind "cubic"' in err) == (2, True), err
    assert not PYTHON.search(err)


@pytest.mark.fast(1)
@pytest.mark.parametrize("rounding", [-1e-17, 0.0, 1e-17])
def test_a_ball_that_rests_on_a_moving_table_starts_there_but_for_rounding(rounding):
    """The gap is a difference of the two heights: their size, not the gap's, says what rounding is."""
    table = sb.Harmonic(0.01, 40.0, 0.7)
    system = ball(sb.Stops(lower=0.0, stiffness=np.inf, restitution=0.0), 0.0, table)
    system = replace(system, q0=-table.value(0.0) * np.ones(1) + rounding, v0=-table.rate(0.0) * np.ones(1))
    exact, precise = (sb.reference(system, 0.1, method=method) for method in ("exact", "multiprecision"))
    run = sb.integrate(system, sb.MoreauJean(), 1e-3, 0.1)
    assert np.max(np.abs(run.tip - exact.at(run.t)[0])) < 1e-4
    assert np.max(np.abs(precise.tip - exact.at(precise.t)[0])) < 1e-14
