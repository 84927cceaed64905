"""The notation of runs: a label reads back as what it was made from."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

import stiffbeam as sb
from stiffbeam.schemes import GAMMA_THIRD_ORDER, registered
from stiffbeam.schemes.labels import parse_run, split_runs
from stiffbeam.schemes.sdirk import GAMMA_MIN

PRINTED = [sb.HHT(-0.2).printed(), sb.SDIRK().printed("sigma"), sb.SDIRK(1.0, nystrom=True).printed("stage-matrix")]


@pytest.mark.parametrize("form", ["displacement", "velocity-curvature"])
@pytest.mark.parametrize("scheme", [*registered(), sb.Theta(0.75), *PRINTED], ids=str)
def test_a_run_reads_back_from_its_own_label(scheme, form):
    again, same_form = parse_run(f"{scheme}@{form}")
    assert type(again) is type(scheme)
    assert (again.parameters, again.erratum, same_form) == (scheme.parameters, scheme.erratum, form)


@given(st.integers(-333, 0))
def test_a_parameter_of_three_digits_reads_back_from_the_label(thousandths):
    scheme = sb.HHT(thousandths / 1000.0)
    assert parse_run(str(scheme))[0].alpha == scheme.alpha


@pytest.mark.parametrize("scheme", [sb.HHT(-1.0 / 3.0), sb.HHT(-0.12345678), sb.SDIRK(GAMMA_MIN)], ids=repr)
def test_a_parameter_of_many_digits_reads_back_from_the_label(scheme):
    assert parse_run(str(scheme))[0].parameters == scheme.parameters


def test_a_run_may_leave_out_what_has_a_default():
    scheme, form = parse_run(" hht ")
    assert (type(scheme), scheme.alpha, form) == (sb.HHT, -0.1, "displacement")
    assert parse_run("bdf2", "velocity-curvature")[1] == "velocity-curvature"
    assert parse_run("SDIRK.printed")[0].erratum == "sigma"
    sdirk = parse_run("sdirk( gamma = 0.4359 , nystrom=TRUE ) @ displacement")[0]
    assert (sdirk.gamma, sdirk.nystrom) == (GAMMA_THIRD_ORDER, True)  # the paper's digits mean the root
    assert str(sdirk) == "SDIRK(gamma=0.4359, nystrom=True)"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hhtt", "scheme must be a registered scheme, got 'hhtt': did you mean HHT?"),
        ("xyz", "known: BDF2, SDIRK, HHT"),
        ("", "scheme must read name(parameter=value, ...)@form, got ''"),
        ("mine_1e-05.csv", "compared in Python, by sb.compare([t, tip], reference)"),
        ("HHT(alpha=-0.1", "scheme must read name(parameter=value, ...)@form"),
        ("HHT@displacement@displacement", "e.g. HHT(alpha=-0.1)@displacement"),
        ("HHT(alpha=small)", "scheme must give alpha a number, true or false, got 'HHT(alpha=small)'"),
        ("hht(alpha)", "scheme must name every parameter"),
        ("hht(alhpa=-0.1)", "'alhpa'"),
        ("HHT(alpha=0.1)", "alpha must lie in [-0.333333, 0], got 0.1: if your alpha is in [0, 1/3], pass -alpha"),
        ("HHT(alpha='-0.1')", "alpha must lie in [-0.333333, 0], got '-0.1'"),
        ("SDIRK(gamma=0.1)", "outside it the scheme is not L-stable"),
        ("SDIRK.printed(sgma)", "erratum must be one the paper prints for this scheme, got 'sgma': did you mean sigma"),
        ("bdf2.printed", "have a printed form"),
        ("BDF2@displacment", "form must be one that there is, got 'displacment': did you mean displacement?"),
    ],
)
def test_a_bad_run_is_refused_with_the_way_out(text, message):
    with pytest.raises(sb.InputError, match=re.escape(message)):
        parse_run(text)


def test_commas_inside_parentheses_belong_to_the_run():
    text = "bdf2, SDIRK(gamma=0.5, nystrom=True)@displacement,SDIRK.printed(sigma),"
    assert [part.strip() for part in split_runs(text)] == [
        "bdf2",
        "SDIRK(gamma=0.5, nystrom=True)@displacement",
        "SDIRK.printed(sigma)",
    ]
