"""What a run of one's own does not tell is not said of it, and what is observed has its name."""

from __future__ import annotations

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.figures.chart import tip_name, tip_symbol

TUBE = {"length": 1.2, "stiffness": 700.0, "mass_per_length": 1.2, "supports": "pinned-pinned"}


@pytest.fixture(scope="module")
def tube():
    """A beam held at both ends, with a stop away from where it is observed."""
    stops = sb.Stops(upper=4e-4, stiffness=2e6, damping=50.0, position=0.7)
    load = sb.PointLoad(0.5, sb.Harmonic(10.0, 168.0))
    return sb.semidiscretise(sb.BeamProblem(**TUBE, stops=stops, loads=load), 4, form="hermite")


def test_impacts_of_positions_elsewhere_do_not_match_to_the_horizon(tube):
    reference = sb.reference(tube, 0.05, t_eval=np.linspace(0.0, 0.05, 501))
    own = sb.compare([reference.t, reference.tip], reference)
    assert np.isnan(own.matched_until)
    assert "right to" not in str(own)  # a column of dashes is left out
    whole = sb.compare(sb.Trajectory.from_arrays(reference.t, system=tube, states=reference.states), reference)
    assert whole.matched_until == reference.horizon


def test_a_file_of_columns_is_not_called_damaged(tube, tmp_path):
    run = sb.integrate(tube, sb.Trapezoidal(), 1e-4, 0.01)
    for name in ("run.csv", "run.json"):
        run.save(tmp_path / name)
        with pytest.raises(sb.InputError, match="from_arrays"):
            sb.load(tmp_path / name)


def test_the_middle_of_a_held_beam_is_called_so(tube, table10):
    assert (tip_name(tube.problem), tip_symbol(tube.problem)) == ("mid-span", "$u(L/2, t)$")
    assert (tip_name(table10), tip_symbol(table10)) == ("tip", "$u(1, t)$")
    energy = sb.integrate(tube, sb.Trapezoidal(), 1e-4, 0.05).plot().axes[3]
    assert "taken by stops" in [line.get_label() for line in energy.lines]
