"""What commands and studies print is so: seconds, shares of the energy, times, verdicts; what they have no use for is
refused."""

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb
from stiffbeam.studies import chaos


def test_a_load_that_takes_its_work_back_makes_no_loss_of_any_size():
    """-2e5 % was said to be lost of all energy: at that moment the load had taken back what it had put in."""
    system = one_mass(100.0, sb.Stops(upper=0.05, stiffness=1e4), load=sb.Harmonic(8.0, 5.0))
    ledger = sb.integrate(system, sb.Trapezoidal(), 2e-3, 14.594).energy
    most = np.max(ledger.input)
    assert ledger.input[-1] < 1e-3 * most
    assert ledger.lost_fraction() == pytest.approx(ledger.loss[-1] / most, rel=1e-6)
    assert -0.05 < ledger.lost_fraction() < 0.0
    assert ledger.supplied == pytest.approx([np.max(ledger.input[: k + 1]) for k in range(len(ledger.t))])


def test_chaos_fits_no_distances_that_are_rounding():
    """Neighbours of q'' + 2 q' + 25 q = sin t converge with the exponent -1, and soon differ by rounding only."""
    system = one_mass(25.0, sb.Stops(upper=1e3, stiffness=1e3), damping=2.0, load=sb.Harmonic(1.0, 1.0), q=1.0)
    found = sb.study("chaos", system, dt=1e-2, t_end=60.0, span=25.0, starts=12, schemes=["trapezoidal", "bdf2"])
    exponents = [
        row["exponent"]
        for row in found.table.to_dict("records")
        if row["pair"] == row["pair"] and row["exponent"] == row["exponent"]
    ]
    assert len(exponents) >= 36
    assert np.mean(exponents) == pytest.approx(-1.0, abs=0.05)


def one(stiffness, restitution=None, speed=0.0, start=0.0):
    """u'' + u = 0 below a stop at 0.3: no motion of it is chaotic."""
    stop = sb.Stops(upper=0.3, stiffness=stiffness, restitution=restitution)
    return one_mass(1.0, stop, q=start, v=speed)


PAIR = sb.System.from_matrices(
    np.eye(2), [[1.0, -1.0], [-1.0, 1.0]], observe=[1.0, 0.0], initial_displacement=[1.0, 0.2]
)
BALL = one_mass(0.0, sb.Stops(lower=0.0, upper=2.0, stiffness=np.inf, restitution=1.0), q=1.0, v=-1.0)


@pytest.mark.parametrize(
    ("system", "t_end", "scheme"),
    [
        (PAIR, 5.0, "Trapezoidal"),  # two free masses drift apart like t
        (PAIR, 500.0, "Trapezoidal"),
        (one(100.0, speed=1.0), 50.0, "Trapezoidal"),  # its period hangs on its energy: like t
        (one(100.0, speed=1.0), 200.0, "Trapezoidal"),
        pytest.param(one(np.inf, 1.0, start=-1.0), 50.0, "MoreauJean", marks=pytest.mark.slow),
        (one(np.inf, 0.0, start=-1.0), 50.0, "MoreauJean"),  # parts once, where one grazes
        pytest.param(BALL, 50.0, "MoreauJean", marks=pytest.mark.campaign),
    ],
)
def test_neighbours_that_part_like_a_power_of_time_have_no_exponent(system, t_end, scheme):
    found = sb.study("chaos", system, dt=t_end / 20000, t_end=t_end, schemes=[scheme], jobs=1)
    methods = {row["method"] for row in found.table.to_dict("records")}
    assert methods == {"exact", next(m for m in methods if m.startswith(scheme))}
    assert set(chaos.exponents(found.table).values()) == {None}
    assert found.answer.verdict.startswith("No exponential change of the distance is seen for exact, ")


def test_a_short_blow_perturbs_by_the_motion_it_makes():
    """An impulse of 4e-3 in 2e-5 on a unit mass: its speed is 4e-3, not 400 over a radian."""
    blow = sb.Sampled([0.0, 1e-5, 2e-5, 9.0], [0.0, 400.0, 0.0, 0.0], "linear")
    system = one_mass(100.0, sb.Stops(upper=1.0, stiffness=1e3), load=blow)
    members = sb.perturbed_members(system, 200)
    speeds = np.array([member.v0[0] for member in members])
    assert 0.9e-3 * 4e-3 < np.max(np.abs(speeds)) <= 1e-3 * 4e-3
