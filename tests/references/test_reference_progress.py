"""References from Python say how far they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import stiffbeam as sb

STOP = sb.Contact(np.ones(1), sb.Stops(upper=0.5, stiffness=4.0))


def test_a_reference_tells_the_solutions_it_makes_and_is_silent_unless_asked(table10, capsys):
    system = sb.semidiscretise(table10, 8)
    told: list[tuple[str, int, int]] = []
    asked = sb.reference(system, 0.05, progress=lambda what, done, total: told.append((what, done, total)))
    assert told[0] == ("exact: solving", 0, 0)
    assert [(done, total) for _, done, total in told[1:]] == [(k, 9) for k in range(1, 9)]
    told.clear()
    sb.reference(system, 0.02, "cvode", rtol=1e-6, progress=lambda *x: told.append(x))
    assert [x[0] for x in told] == ["cvode: solving", "cvode: a second solution for its horizon"]
    quiet = sb.reference(system, 0.05, progress=True)  # neither a terminal nor a notebook
    assert quiet.horizon == asked.horizon
    assert capsys.readouterr() == ("", "")


def test_a_study_shows_its_points(capsys):
    shown: list[tuple[str, int, int]] = []
    case, options = sb.paper_case(10), {"schemes": ["BDF2", "bathe"], "steps": 200}
    study = sb.study("modes", case, progress=lambda *x: shown.append(x), **options)
    assert shown[0] == ("modes: planning", 0, 0)
    assert shown[-1][1:] == (shown[-1][2],) * 2 > (0, 0)
    again = sb.study("modes", case, progress=True, **options)  # neither a terminal nor a notebook
    assert again.table.equals(study.table)
    assert capsys.readouterr() == ("", "")


def test_an_advice_past_the_horizon_shows_its_exact_motions(table10):
    shown: list[tuple[str, int, int]] = []
    system = sb.semidiscretise(table10, 8)
    advice = sb.advise(
        system, {"impacts": 0.2}, 1.0, [sb.Trapezoidal()], most_steps=64, members=4,
        progress=lambda *x: shown.append(x),
    )  # fmt: skip
    assert advice.horizon < 1.0
    assert [x[1:] for x in shown if x[0] == "advise: 4 exact motions"][-1] == (4, 4)


def test_a_printed_reference_states_its_error():
    units = sb.Units("mm", "ms", "N")
    system = sb.System.from_matrices([[1.0]], [[4.0]], contacts=[STOP], initial_velocity=[2.0], units=units)
    exact = sb.reference(system, 3.0)
    first, statement = str(exact).splitlines()
    assert first == repr(exact)
    tolerance = exact.provenance["horizon_tolerance"]
    assert statement.startswith(f"Valid to t = 3 ms: {tolerance} ms. Compared with 8 copies of the problem, its")
    assert str(sb.reference(system, 3.0, "dop853")).endswith("ms. Compared with the exact solution.")
    more = str(sb.reference(system, 3.0, "multiprecision"))
    assert " the same events. Compared with itself with " in more
    assert str(replace(exact, horizon=float("nan"))).endswith("Its error is not known: it was compared with nothing.")
