"""What the page says of the paper's claims: decided by the spread, judged twice, and never the end of the page."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stiffbeam as sb
from dumont2002 import claims as judging
from dumont2002.claims import Claim, judge, judged
from dumont2002.ensembles import add_ensembles, lines
from dumont2002.evidence import Evidence, NotMeasured
from dumont2002.figures import panels
from dumont2002.reading import Reading
from dumont2002.sample import Sample, above, below
from dumont2002.table import make_table
from dumont2002.verdicts import FAILS, HOLDS, NOT_MEASURED, OPEN, Finding
from stiffbeam.model.beam import natural_frequencies
from stiffbeam.trajectory.trajectory import Diverged

NOTHING = Evidence({n: {"runs": {}, "exact": {}, "failures": {"(4.13)": "overflow"}, "apart": {}, "span": {
    "t_end": 1.0, "periods": 10, "members": 2, "exact_members": 2}} for n in range(1, 18)}, [], Reading())  # fmt: skip


def sample(*values: float) -> Sample:
    return Sample(np.array(values, float))


# ---------------------------------------------------------------- what the spread decides


def test_the_spread_decides_or_leaves_open():
    near, far = sample(1.0, 1.2, 0.8, 1.1), sample(5.0, 5.2, 4.9, 5.1)
    assert above(far, near) is True
    assert below(far, near) is False
    assert above(near, sample(1.1, 0.9, 1.0, 1.2)) is None
    assert above(near, 1.05) is None
    assert above(sample(2.0, 2.0), 1.0) is True  # members that do not differ decide by themselves
    assert above(sample(2.0), sample(1.0, 1.1)) is None or above(sample(2.0), sample(1.0, 1.1)) is True
    assert above(sample(2.0, 2.5), sample(1.0)) is None  # one degree of freedom decides little


def test_a_line_is_its_complex_amplitude_on_the_clock():
    t = np.arange(0.0, 4.0 * np.pi + 1e-9, 2.0 * np.pi / 1000)
    u = 3.0 + 0.5 * np.cos(2.0 * t + 0.3) - 0.2 * np.sin(6.0 * t)
    found = np.array(lines(t, u, 2.0))
    c = found[:, 0] + 1j * found[:, 1]
    assert c[0] == pytest.approx(0.5 * np.exp(0.3j))
    assert c[2] == pytest.approx(0.2j)  # -sin = Re(i e^{i x})
    assert np.max(np.abs(np.delete(c, [0, 2]))) < 1e-12


# ---------------------------------------------------------------- judged twice, and never the end of the page


def test_a_verdict_that_reseeding_changes_is_open():
    check = lambda e: Finding("Measured.", FAILS if e.seeds == (2,) else HOLDS)  # noqa: E731
    found = judge(Claim("5", "words", "rule", check, tables=(10,)), NOTHING)
    assert found.verdict == OPEN
    assert "holds with seeds 1; does not hold with seeds 2; holds with both" in found.measured
    same = judge(Claim("5", "words", "rule", lambda e: Finding("Measured.", FAILS), tables=(10,)), NOTHING)
    assert same == Finding("Measured.", FAILS)


@pytest.mark.parametrize(
    "error", [NotMeasured("gone"), Diverged("hht", 1.0, "a smaller step"), sb.InputError("x", 1, "be 2", "add 1")]
)
def test_what_cannot_be_measured_says_so(error, monkeypatch):
    def fail(e):
        raise error

    good = Claim("6", "after", "rule", lambda e: Finding("Fine.", HOLDS), evidence="none")
    monkeypatch.setattr(judging, "CLAIMS", [Claim("5", "before", "rule", fail, evidence="none"), good])
    first, second = judged(NOTHING)
    assert (first["verdict"], second["verdict"]) == (NOT_MEASURED, HOLDS)
    assert str(error) in first["measured"]


# ---------------------------------------------------------------- what is measured


@pytest.fixture(scope="module")
def short():
    """Table 17 to half a time unit with the exact solution in float64: five periods, twice its horizon."""
    return make_table(replace(sb.paper_case(17), t_end=0.5), Reading())


@pytest.mark.slow
def test_ensembles_are_drawn_twice_over_ten_periods(short):
    found: dict = {"runs": {"(4.13)": {}}, "exact": {"displacement": {}}, "failures": {}}
    add_ensembles(found, short, 3, 2)
    assert found["span"]["periods"] == 10
    ensemble = found["runs"]["(4.13)"]["ensemble"]
    assert not set(ensemble["1"]["fraction"]) & set(ensemble["2"]["fraction"])
    e = Evidence({17: found | {"reading": None}}, [], Reading())
    assert len(e.values(17, "(4.13)", "impacts")) == 6
    assert len(e.of(2).values(17, "displacement", "impacts")) == 2
    own, between = (e.apart(17, "(4.13)", name) for name in ("(4.13)", "displacement"))
    assert 0.0 < own.mean < np.sqrt(2.0) * 1.2
    assert 0.0 < between.mean < np.sqrt(2.0) * 1.2
    # The tip is one of the members' own, so that its impacts to T are those of its solo run.
    system = short.systems["displacement"]
    solo = sb.integrate(sb.perturbed_members(system, 3, rng=1)[1], sb.HHT(-0.1), short.case.dt, short.case.t_end)
    assert ensemble["1"]["impacts"][1] == solo.impacts.count


def test_the_schemes_hardly_lengthen_the_first_mode():
    """Against a long free oscillation: the angle of q + i q'/w after n steps gives the period."""
    omega, dt, steps = float(natural_frequencies(sb.paper_case(2).problem, 1)[0]), 1e-4, 200_000
    free = sb.System.from_matrices([[1.0]], [[omega**2]], observe=[1.0], initial_displacement=[1.0])
    run = sb.integrate(free, sb.HHT(-0.1), dt, steps * dt, every=steps)
    angle = np.angle(run.tip[-1] - 1j * run.tip_velocity[-1] / omega) + 2.0 * np.pi * np.round(
        omega * dt * steps / (2 * np.pi)
    )
    found = omega * dt * steps / angle - 1.0
    # tip and velocity turn a phase (w dt)^2 apart, the same at both ends: 4e-5 of 1218 rad.
    assert sb.amplification(sb.HHT(-0.1), [omega * dt / (2.0 * np.pi)]).period_elongation[0] == pytest.approx(
        found, abs=1e-7
    )
    assert found == pytest.approx(4e-6, rel=0.1)


# ---------------------------------------------------------------- what is drawn


def labels(made, letter: str) -> dict[str, tuple]:
    """The curves of a panel and how their lines are dashed."""
    from matplotlib.figure import Figure

    axis = Figure().subplots()
    next(panel for panel in panels(made) if panel.letter == letter).draw(axis)
    return {str(line.get_label()): line._unscaled_dash_pattern[1] for line in axis.get_lines()}


def test_past_its_horizon_float64_is_drawn_as_one_realisation(short):
    for letter in ("a", "b", "c"):
        found = labels(short, letter)
        assert found["exact to the horizon, displacement"] is None or letter == "b"
        assert found["one realisation, displacement"] is not None  # dotted
        assert not any(label.startswith("true") for label in found)
    assert "exact to the horizon, displacement" not in labels(short, "d")  # a spectrum takes the whole span
