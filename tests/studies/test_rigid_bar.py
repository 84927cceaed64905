"""The bouncing bar's closed form, and what the study of schemes on it has to show."""

from __future__ import annotations

from fractions import Fraction as F

import numpy as np
import pytest
from bouncing_bar import CONTACTS, IMPULSE, PERIOD, pressure

from stiffbeam.studies import rigid_bar, study


def test_heights_and_forces_in_rational_numbers():
    heights = {2: F(5, 3), F(7, 3): F(40, 9), F(5, 2): F(145, 36), F(8, 3): F(35, 9), 3: F(40, 9), F(10, 3): F(5, 3),
               F(29, 6): F(15, 4), F(16, 3): F(5)}  # fmt: skip
    for t, height in heights.items():
        wave, slope, closed, start = rigid_bar.segments(20)[int(3 * t)]
        s = t - F(int(3 * t), 3)
        assert start + wave * s + slope * s * s / 2 == height
        assert not closed
    t = np.linspace(0.001, 5.3, 1000)
    assert np.allclose(rigid_bar.pressure(t), pressure(t), rtol=1e-12, atol=1e-9)
    assert np.allclose(rigid_bar.foot(t + PERIOD), rigid_bar.foot(t), atol=1e-12)
    for a, b in CONTACTS:  # the force is linear in time
        assert np.mean(rigid_bar.pressure(np.linspace(a, b, 9)[1:-1])) * (b - a) == pytest.approx(IMPULSE)


def by_characteristics(height, speed, gravity, steps):
    """Nodes u (21,), and foot and mean pressure after every second step, of a bar thrown down at a wall in fractions:
    E = 900, rho = 1, L = 10. Of central differences in steps of dx/c, which are d'Alembert's solution, the half that
    the even nodes at even steps and the odd ones at odd steps are: contact begins and ends at even steps."""
    dx, dt = F(1, 2), F(1, 60)
    u = [F(height) if j % 2 == 0 else height - speed * dt - gravity * dt * dt / 2 for j in range(21)]
    feet, pressures = [u[0]], []
    for n in range(2, steps + 1):
        for j in range(n % 2, 21, 2):
            u[j] = (2 * u[abs(j - 1)] if j in (0, 20) else u[j - 1] + u[j + 1]) - u[j] - gravity * dt * dt
        if n % 2 == 0:
            pressures.append(max(F(0), -u[0]) * 900 / (2 * dx))
            u[0] = max(F(0), u[0])
            feet.append(u[0])
    return u, feet, pressures


def test_a_bar_thrown_at_a_wall():
    """In contact for 2 L/c = 2/3 under rho c v, and off again as it came."""
    u, feet, pressures = by_characteristics(0, 10, 0, 81)
    assert [k for k, foot in enumerate(feet) if not foot] == list(range(21))
    assert pressures[:20] == [300] * 20
    assert not any(pressures[20:])
    later, _, _ = by_characteristics(0, 10, 0, 83)
    assert [(b - a) * 30 for a, b in zip(u, later, strict=True)] == [10] * 21


def test_the_closed_form_is_that_of_the_characteristics():
    _, feet, pressures = by_characteristics(5, 0, 10, 320)
    assert np.allclose(rigid_bar.foot(np.arange(161) / 30.0), np.array(feet, float), rtol=0.0, atol=1e-12)
    known = {
        60: F(5, 3),
        70: F(40, 9),
        75: F(145, 36),
        80: F(35, 9),
        90: F(40, 9),
        100: F(5, 3),
        145: F(15, 4),
        160: F(5),
    }
    assert {k: feet[k] for k in known} == known
    assert pressures[30:50] == [300 * (1 + F(2 * k + 1, 60)) for k in range(20)]
    assert pressures[110:130] == [500 - 300 * F(2 * k + 1, 60) for k in range(20)]
    assert sum(pressures[:80]) / 30 == sum(pressures[80:]) / 30 == F(800, 3)


@pytest.mark.slow
def test_what_the_study_shows():
    records = study(
        "rigid-bar", schemes=["Trapezoidal", "MoreauJean", "ContactStabilisedNewmark"], cells=[50], starts=3
    )
    rows = {}
    for row in records.found:
        name = (row["scheme"].partition("(")[0], row["wall"], row["conserving"], row["restitution"])
        rows.setdefault(name, []).append(row)

    def middle(name, key):
        return np.median([row[key] for row in rows[name]])

    assert middle(("Trapezoidal", "rigid", False, None), "energy") > 10.0  # blows up
    assert abs(middle(("MoreauJean", "rigid", False, 1.0), "energy")) < 1e-11
    assert middle(("MoreauJean", "rigid", False, 1.0), "pressure") > 0.9  # zero, then twice the force
    assert middle(("MoreauJean", "rigid", False, 0.0), "pressure") < 0.01
    assert -0.2 < middle(("ContactStabilisedNewmark", "rigid", False, None), "energy") < -0.03
    assert middle(("ContactStabilisedNewmark", "rigid", False, None), "penetration") < 1e-14
