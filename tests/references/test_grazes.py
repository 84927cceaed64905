"""Contacts, and moments between two, that are too short for float64: many digits decide what was passed over."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.references.multiprecision import multiprecision

EPS = np.finfo(float).eps
# Depths in units of the motion, exact. A time is good to a rounding of itself.
SEEN = [Fraction(1, 10**13), Fraction(1, 10**15), Fraction(3, 10**16), Fraction(1, 10**17), Fraction(3, 10**18)]
UNSEEN = [Fraction(0), Fraction(1, 10**20), Fraction(-1, 10**17), Fraction(-1, 10**14)]


def exactly(x):
    return mpmath.mpf(x.numerator) / x.denominator


def oscillator(depth, how):
    """u = sin t under a stop at 1 - depth; alone, or beside a mass with a stop of its own."""
    contacts = [sb.Contact([1.0], sb.Stops(upper=1 - depth, stiffness=50))]
    if how == "alone":
        return sb.System.from_matrices(np.eye(1), np.eye(1), contacts=contacts, initial_velocity=[1])
    contacts = [sb.Contact([1.0, 0.0], contacts[0].stops), sb.Contact([0.0, 1.0], sb.Stops(lower=-2, stiffness=3))]
    start = [1, Fraction(3, 10)]
    return sb.System.from_matrices(np.eye(2), np.diag([1.0, 2.0]), contacts=contacts, initial_velocity=start)


@pytest.mark.fast(2)
@pytest.mark.parametrize("how", ["alone", "beside another"])
@pytest.mark.parametrize("depth", SEEN)
def test_a_contact_that_float64_does_not_see_is_taken(depth, how):
    with mpmath.workdps(60):
        begin = mpmath.asin(1 - exactly(depth))
        length = float(2 * mpmath.acos(1 - exactly(depth)))
        begin = float(begin)
    found = sb.reference(oscillator(depth, how), 4.0, "multiprecision").contacts[0].impacts
    assert found.count == 1
    assert abs(found.times[0] - begin) <= 2 * EPS * begin
    # In contact the stop shortens what is left of the way by a share kappa length^2: nothing here.
    assert abs(found.ends[0] - found.times[0] - length) <= 4 * EPS * begin + 1e-4 * length


@pytest.mark.fast(2)
@pytest.mark.parametrize("how", ["alone", "beside another"])
@pytest.mark.parametrize("depth", UNSEEN)
def test_a_touch_and_what_stays_short_of_it_are_none(depth, how):
    assert sb.reference(oscillator(depth, how), 4.0, "multiprecision").contacts[0].impacts.count == 0


@pytest.mark.fast(1)
@pytest.mark.parametrize("depth", SEEN)
def test_every_one_of_several_is_taken(depth):
    found = sb.reference(oscillator(depth, "alone"), 40.0, "multiprecision")
    assert found.impacts.count == 7  # tops at pi/2 + 2 pi k < 40, the contacts too small to change them
    assert found.horizon == 40.0
    assert np.allclose(np.diff(found.impacts.times), 2.0 * np.pi, rtol=0.0, atol=1e-7)


@pytest.mark.fast(2)
@pytest.mark.parametrize("share", [*SEEN, Fraction(0)])
def test_a_moment_between_two_contacts_is_taken(share):
    """u - g = f/kappa (1 + (1 + share) cos(w t)) of a mass that f = 3/4 presses on its stop at g: open at w t = pi."""
    kappa = 12
    system = sb.System.from_matrices(
        np.eye(1),
        np.zeros((1, 1)),
        loads=[([0.75], sb.Constant(1.0))],
        contacts=[sb.Contact([1.0], sb.Stops(upper=-share / 16, stiffness=kappa))],
        initial_displacement=[0.125],
    )
    found = sb.reference(system, 1.5, "multiprecision").impacts
    assert found.count == (1 if share else 0)  # contact at the start is none
    if share:
        with mpmath.workdps(60):
            open_at = float(mpmath.acos(-1 / (1 + exactly(share))) / mpmath.sqrt(kappa))
            half = float(mpmath.acos(1 / (1 + exactly(share))) / mpmath.sqrt(kappa))
        # The free flight under f lasts as long as the arc in contact would, to the square of its length.
        assert abs(found.times[0] - (open_at + 2.0 * half)) <= 4.0 * EPS + 1e-4 * half


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_random_damped_oscillators_by_their_first_top(seed):
    """u'' + c u' + k u = 0 from u' = 1 has its first top at w t = atan(2 w/c), w^2 = k - c^2/4, exp(-c t/2)/sqrt(k)
    high; there u'' = -k u. A second mass with stops of its own goes beside it."""
    rng = np.random.default_rng(seed)
    depth = Fraction(int(rng.integers(1, 10)), 10 ** int(rng.integers(11, 18))) * int(rng.choice([1, 1, -1]))
    c, k = int(rng.integers(1, 40)) / 32, int(rng.integers(8, 200)) / 16
    with mpmath.workdps(60):
        w = mpmath.sqrt(k - mpmath.mpf(c) ** 2 / 4)
        turn = mpmath.atan(2 * w / c) / w
        top = mpmath.exp(-c * turn / 2) / mpmath.sqrt(k)
        stop = Fraction(mpmath.nstr(top * (1 - exactly(depth)), 50))
        half = mpmath.sqrt(2 * exactly(abs(depth)) / k)
        begin, half, t_end = float(turn - half), float(half), 1.5 * float(turn)
    contacts = [
        sb.Contact([1.0, 0.0], sb.Stops(upper=stop, stiffness=10.0 ** rng.uniform(-1.0, 5.0))),
        sb.Contact([0.0, 1.0], sb.Stops(lower=-0.05, upper=0.06, stiffness=10.0)),
    ]
    K, C = np.diag([k, 3.0 * k]), c * np.eye(2)
    system = sb.System.from_matrices(np.eye(2), K, C, contacts=contacts, initial_velocity=[1.0, 0.7])
    found = sb.reference(system, t_end, "multiprecision")
    assert found.horizon == t_end
    assert found.contacts[0].impacts.count == (1 if depth > 0 else 0)
    if depth > 0:  # the parabola of the top is off by its square
        assert abs(found.contacts[0].impacts.times[0] - begin) <= 4.0 * EPS * begin + 10.0 * np.sqrt(k) * half**2


def test_more_looks_than_there_is_time_for_are_said(monkeypatch):
    monkeypatch.setattr(multiprecision, "MOST_LOOKS", 8)
    found = sb.reference(oscillator(Fraction(1, 10**15), "alone"), 4.0, "multiprecision")
    assert found.impacts.count == 0
    assert "by float64, to 1e-12" in found.provenance["grazes"]
    monkeypatch.undo()
    found = sb.reference(oscillator(Fraction(1, 10**15), "alone"), 4.0, "multiprecision")
    assert found.provenance["grazes"] == "by many digits, to 1e-18 of the motion"
