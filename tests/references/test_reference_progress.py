"""References from Python say how far they are."""

from __future__ import annotations

import stiffbeam as sb


def test_a_reference_tells_the_solutions_it_makes_and_is_silent_unless_asked(table10, capsys):
    system = sb.semidiscretise(table10, 8)
    told: list[tuple[str, int, int]] = []
    asked = sb.reference(system, 0.05, progress=lambda what, done, total: told.append((what, done, total)))
    assert told[0] == ("exact: solving", 0, 0)
    assert [(done, total) for _, done, total in told[1:]] == [(k, 5) for k in range(1, 5)]
    told.clear()
    sb.reference(system, 0.02, "cvode", rtol=1e-6, progress=lambda *x: told.append(x))
    assert [x[0] for x in told] == ["cvode: solving", "cvode: a second solution for its horizon"]
    quiet = sb.reference(system, 0.05, progress=True)  # neither a terminal nor a notebook
    assert quiet.horizon == asked.horizon
    assert capsys.readouterr() == ("", "")
