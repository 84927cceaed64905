"""What commands and studies print is so: seconds, shares of the energy, times, verdicts; what they have no use for is
refused."""

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb

OSCILLATOR = """
[[case]]
name = "oscillator"
dt = 2e-3
t_end = 14.594
runs = ["trapezoidal"]

[case.system]
mass = [[1.0]]
stiffness = [[100.0]]
loads = [{ row = [1.0], amplitude = 8.0, frequency = 5.0 }]

[[case.system.contacts]]
row = [1.0]
upper = 0.05
stiffness = 1e4
"""


@pytest.fixture
def case(tmp_path):
    file = tmp_path / "oscillator.toml"
    file.write_text(OSCILLATOR)
    return next(iter(sb.load_cases(str(file)).values()))


def trapezoidal_by_hand(dt, steps):
    """Energy, work of the load and loss of x'' + 100 x + F(x) = 8 sin 5t, every step solved side by side."""
    kappa, g, x, v, work, most = 1e4, 0.05, 0.0, 0.0, 0.0, 0.0

    def energy(x, v):
        return 0.5 * v * v + 50.0 * x * x + 0.5 * kappa * max(0.0, x - g) ** 2

    def acceleration(x, t):
        return 8.0 * np.sin(5.0 * t) - 100.0 * x - kappa * max(0.0, x - g)

    for k in range(steps):
        a, b = 8.0 * np.sin(5.0 * k * dt), 8.0 * np.sin(5.0 * (k + 1) * dt)
        # x1 = x + dt v + dt^2/4 (a0 + a1): linear on either side of the stop
        known = x + dt * v + 0.25 * dt**2 * (acceleration(x, k * dt) + b)
        free = known / (1.0 + 25.0 * dt**2)
        x1 = free if free <= g else (known + 0.25 * dt**2 * kappa * g) / (1.0 + 0.25 * dt**2 * (100.0 + kappa))
        v1 = v + 0.5 * dt * (acceleration(x, k * dt) + acceleration(x1, (k + 1) * dt))
        work += 0.5 * (a + b) * (x1 - x)
        x, v, most = x1, v1, max(most, work)
    return energy(x, v), work, work - energy(x, v), most


def test_a_load_that_takes_its_work_back_makes_no_loss_of_any_size(case):
    """-2e5 % was said to be lost of all energy: at that moment the load had taken back what it had put in."""
    run = sb.integrate(case.system(), sb.Trapezoidal(), 2e-3, 14.594)
    energy, work, loss, most = trapezoidal_by_hand(2e-3, 7297)
    ledger = run.energy
    assert ledger.energy[-1] == pytest.approx(energy, rel=1e-6)
    assert ledger.loss[-1] == pytest.approx(loss, rel=1e-6)
    assert work < 1e-3 * most
    assert ledger.lost_fraction() == pytest.approx(loss / most, rel=1e-6)
    assert -0.05 < ledger.lost_fraction() < 0.0
    assert ledger.supplied == pytest.approx([np.max(ledger.input[: k + 1]) for k in range(len(ledger.t))])


def test_a_short_blow_perturbs_by_the_motion_it_makes():
    """An impulse of 4e-3 in 2e-5 on a unit mass: its speed is 4e-3, not 400 over a radian."""
    blow = sb.Sampled([0.0, 1e-5, 2e-5, 9.0], [0.0, 400.0, 0.0, 0.0], "linear")
    system = one_mass(100.0, sb.Stops(upper=1.0, stiffness=1e3), load=blow)
    members = sb.perturbed_members(system, 200)
    speeds = np.array([member.v0[0] for member in members])
    assert 0.9e-3 * 4e-3 < np.max(np.abs(speeds)) <= 1e-3 * 4e-3
