"""Every study on every system that a user may bring: numbers with labels on every axis, or a refusal named here."""

from __future__ import annotations

import re

import numpy as np
import pytest
from every_system import BENCHES, at_rest_on_its_stops

import stiffbeam as sb
from stiffbeam.basics.validation import InputError
from stiffbeam.files.cases import case_of
from stiffbeam.studies.base import chosen_schemes, takes

# What may be refused, by the study that may refuse it: no other reason is good enough.
REFUSED = {
    "chaos": "the motion at the observed point is rounding",
    "space": "be a beam with a grid",
    "rigid": "at one place|for a limit of rigid stops",
    "sweep": "without a period|move at the drive's frequency|exactly one Harmonic drive",
    "orbits": "a linear law|one drive frequency|exactly one Harmonic drive|be a multiple of 2 pi",
    "modes": "does not oscillate|no mode oscillates",  # over-damped, or without any stiffness beside the stops
}
NAMES = ("chaos", "converge", "energy", "ensemble", "modes", "orbits", "rigid", "space", "sweep")
OPTIONS = {  # of a run of seconds
    "chaos": {"schemes": ["HHT(alpha=-0.1)"], "starts": 6},
    "converge": {"integrators": ["BDF2", "SDIRK(gamma=0.4359)"], "halvings": 4, "impacts": 2,
                 "views": ["order", "work", "impacts"]},
    "energy": {"schemes": ["HHT(alpha=-0.1)", "BDF2"]},
    "ensemble": {"schemes": ["HHT(alpha=-0.1)"], "members": 4},
    "modes": {"schemes": ["BDF2", "HHT(alpha=-0.1)"], "steps": 4000},
    "orbits": {},
    "rigid": {"factors": [16.0, 256.0, 4096.0], "impacts": 2},
    "space": {"cells": [6, 8, 12], "finest": 20},
    "sweep": {"periods": 3, "transient": 1},
}  # fmt: skip
MOST = 1e4  # per cent in a sentence or a table
FAST = {("energy", "pressed on a rigid stop"), ("chaos", "pressed on a rigid stop"),
        ("modes", "feeder"), ("converge", "feeder"), ("chaos", "feeder"), ("energy", "chain"),
        ("sweep", "two bodies with a dashpot between"), ("ensemble", "rigid impact damper")}  # fmt: skip


def cells() -> list:
    """Every study times every system: FAST, else every third one slow, the others in campaigns."""
    found = []
    for i, study in enumerate(NAMES):
        for j, name in enumerate(BENCHES):
            rarely = pytest.mark.campaign if (i + j) % 3 - 1 else pytest.mark.slow
            marks = () if (study, name) in FAST else (rarely,)
            found.append(pytest.param(study, name, id=f"{study}-{name.replace(' ', '-')}", marks=marks))
    return found


@pytest.mark.parametrize(("study", "name"), cells())
def test_every_study_answers_or_refuses_for_a_reason_named_here(study, name):
    answers_or_refuses(study, *BENCHES[name])


@pytest.mark.fast(0, slow=5)
@pytest.mark.parametrize("name", BENCHES)
def test_every_study_of_bodies_at_rest_on_their_stops(name):
    """``orbits`` of these takes half a minute each."""
    for study in NAMES:
        if study != "orbits":
            answers_or_refuses(study, *at_rest_on_its_stops(BENCHES[name]), "|must move, got")


def answers_or_refuses(study: str, system: sb.System, dt: float, t_end: float, more: str = "") -> None:
    allowed = REFUSED.get(study, "(?!)") + more + ("" if system.contacts else "|have stops")
    options, case = dict(OPTIONS[study]), case_of(system, dt, t_end)
    for name in {"schemes", "integrators"} & set(options):  # others where they do not take rigid stops
        if study != "modes" and not all(takes(case, x) for x in chosen_schemes(case, options[name]).values()):
            options[name] = [str(case.runs[0][0])]
    if study in ("orbits", "sweep") and len(system.drive.frequencies) == 1:
        options["values"] = np.linspace(0.7, 1.3, 4) * system.drive.frequencies[0]
    refused = ""
    try:
        records = sb.study(study, system, dt=dt, t_end=t_end, **options)
    except InputError as error:
        refused = str(error)
    if refused:
        assert re.search(allowed, refused), refused
        return
    for reason in records.lost:
        assert re.search(allowed, reason), reason
    if not len(records.found):
        assert records.lost
        return
    answer = records.answer.verdict + records.answer.notes
    assert any(c.isdigit() for c in answer) or answer.startswith("No orbit was found: ")
    for share in re.findall(r"(-?[\d.]+(?:e[+-]\d+)?) %", str(records)):
        assert abs(float(share)) <= MOST, str(records)  # a share of nothing, or of what cancels, is none
    figure = records.figure()
    for axis in figure.axes:
        drawn = axis.get_xlabel() or axis.texts  # a panel without curves says why
        assert drawn or axis.get_label() == "<colorbar>" or axis.get_shared_x_axes().get_siblings(axis) != [axis]
    assert_legends_hide_nothing(figure)


def assert_legends_hide_nothing(figure) -> None:
    """Every legend lies in the picture, and beside all bars and their numbers; a single panel has no letter."""
    figure.draw_without_rendering()
    whole, legends = figure.bbox, [*figure.legends, *filter(None, (axis.get_legend() for axis in figure.axes))]
    for legend in legends:
        box = legend.get_window_extent()
        assert whole.x0 - 1.0 <= box.x0 <= box.x1 <= whole.x1 + 1.0, [x.get_text() for x in legend.get_texts()]
        for axis in figure.axes:
            covered = [*axis.patches, *axis.texts]
            assert not any(box.overlaps(x.get_window_extent()) for x in covered if x is not axis.patch)
    if len(figure.axes) == 1:
        assert not figure.axes[0].get_title(loc="left").startswith("(")
