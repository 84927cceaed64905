"""The bouncing bar's closed form, and what the study of schemes on it has to show."""

from __future__ import annotations

from fractions import Fraction as F

import numpy as np
import pytest
from bouncing_bar import CONTACTS, IMPULSE, PERIOD, pressure

from stiffbeam.studies import bouncing_bar as bar
from stiffbeam.studies import study


def test_heights_and_forces_in_rational_numbers():
    heights = {2: F(5, 3), F(7, 3): F(40, 9), F(5, 2): F(145, 36), F(8, 3): F(35, 9), 3: F(40, 9), F(10, 3): F(5, 3),
               F(29, 6): F(15, 4), F(16, 3): F(5)}  # fmt: skip
    for t, height in heights.items():
        wave, slope, closed, start = bar.pieces(20)[int(3 * t)]
        s = t - F(int(3 * t), 3)
        assert start + wave * s + slope * s * s / 2 == height
        assert not closed
    t = np.linspace(0.001, 5.3, 1000)
    assert np.allclose(bar.pressure(t), pressure(t), rtol=1e-12, atol=1e-9)
    assert np.allclose(bar.foot(t + PERIOD), bar.foot(t), atol=1e-12)
    for a, b in CONTACTS:  # the force is linear in time
        assert np.mean(bar.pressure(np.linspace(a, b, 9)[1:-1])) * (b - a) == pytest.approx(IMPULSE)


@pytest.mark.slow
def test_the_closed_form_is_where_many_elements_go():
    """L1 distance of the foot, massless and exact in time: first order in the size of the elements."""
    import stiffbeam as sb

    t = np.linspace(0.0, 3.0, 3001)
    found = []
    for cells in (50, 200):
        system = bar.bar(cells, sb.Stops(lower=0.0, stiffness=np.inf)).massless_contacts()
        height = np.maximum(sb.reference(system, 3.0, t_eval=t).tip, 0.0)
        found.append(np.mean(np.abs(height - bar.foot(t))))
    assert found[1] < 0.35 * found[0]
    assert found[1] < 0.01


@pytest.mark.slow
def test_what_the_study_shows():
    records = study("rigid-bar", schemes=["trapezoidal", "moreau-jean", "contact-stabilised"], cells=[50], starts=3)
    rows = {}
    for row in records.found:
        name = (row["scheme"].partition("(")[0], row["wall"], row["conserving"], row["restitution"])
        rows.setdefault(name, []).append(row)

    def middle(name, key):
        return np.median([row[key] for row in rows[name]])

    best = ("trapezoidal", "massless node", True, None)
    assert abs(middle(best, "energy")) < 1e-11
    assert middle(best, "pressure") < 0.01
    assert middle(best, "penetration") == 0.0
    assert middle(("trapezoidal", "rigid", False, None), "energy") > 10.0  # blows up
    assert abs(middle(("moreau-jean", "rigid", False, 1.0), "energy")) < 1e-11
    assert middle(("moreau-jean", "rigid", False, 1.0), "pressure") > 0.9  # zero, then twice the force
    assert middle(("moreau-jean", "rigid", False, 0.0), "pressure") < 0.01
    assert -0.2 < middle(("contact-stabilised", "rigid", False, None), "energy") < -0.03
    assert middle(("contact-stabilised", "rigid", False, None), "penetration") < 1e-14
