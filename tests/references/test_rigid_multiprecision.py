"""Rigid stops in many digits: closed forms to those digits, and the float64 solution, which shares no code with it."""

from __future__ import annotations

import ast
from itertools import pairwise
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
import rigid_witness
from flint import ctx

import stiffbeam as sb
from stiffbeam import InputError, SolverFailure
from stiffbeam.files.reference_cache import cached_reference
from stiffbeam.files.store import freeze
from stiffbeam.references.multiprecision import rigid

INF = float("inf")


@pytest.fixture(autouse=True)
def digits():
    with mp.workdps(70):
        yield


def one(K, e, load, q=0.0, v=0.0, **gaps):
    """x'' + K x = load."""
    contact = sb.Contact([1.0], sb.Stops(**gaps, stiffness=INF, restitution=e))
    start = {"initial_displacement": [q], "initial_velocity": [v]}
    return sb.System.from_matrices([[1.0]], [[K]], loads=[([1.0], load)], contacts=[contact], **start)


def solved(system, t_end, **options):
    return sb.reference(system, t_end, "multiprecision", t_eval=np.linspace(0.0, t_end, 41), **options)


def precise(x):
    """An mpmath number from what the solution holds."""
    before, ctx.prec = ctx.prec, 400
    try:
        return mp.mpf(x.mid().str(90, radius=False))
    finally:
        ctx.prec = before


def impact_times(found):
    return [precise(impact.time) for impact in found.solution.motion.impacts]


def test_a_bouncing_ball_to_forty_digits():
    """t_1 = sqrt(2 h/g), flights 2 e^k t_1, at rest from t_1 (1 + e)/(1 - e) on."""
    found = solved(one(0.0, 0.5, sb.Constant("-9.81"), q=1.0, lower=0.0), 2.0)
    first = mp.sqrt(2 / mp.mpf("9.81"))
    wanted = [first * (3 - 4 * mp.mpf(0.5) ** (k + 1)) for k in range(found.impacts.count)]
    assert found.impacts.count > 20
    assert max(abs(a - b) for a, b in zip(impact_times(found), wanted, strict=True)) < mp.mpf(10) ** -40
    assert abs(precise(found.solution.motion.stuck[0][0]) - 3 * first) < mp.mpf(10) ** -40
    assert found.provenance["chatter_left_out"] == 0.0  # gravity is constant: the series is geometric
    assert found.contact_force[-1] == pytest.approx(9.81, rel=1e-15)
    assert found.energy.stop_dissipation[-1] == pytest.approx(9.81, rel=1e-14)
    assert abs(found.energy.loss[-1]) < 1e-14
    assert found.contacts[0].impulse == pytest.approx(9.81 * 2.0, rel=1e-14)
    assert found.horizon == 2.0


@pytest.mark.parametrize("e", [0.5, pytest.param(0.9, marks=pytest.mark.slow)])
def test_a_preloaded_oscillator_to_thirty_digits(e):
    """x'' + x = c from the stop with speed c: flights 2 atan(e^k), then it sticks for ever."""
    found = solved(one(1.0, e, sb.Constant(0.75), v=-0.75, upper=0.0), 50.0 if e > 0.5 else 5.0)
    flights = [2 * mp.atan(mp.mpf(e) ** k) for k in range(2000)]
    gaps = np.diff([0, *impact_times(found)])
    assert max(abs(a - b) for a, b in zip(gaps, flights, strict=False)) < mp.mpf(10) ** -40
    end = precise(found.solution.motion.stuck[0][0])
    assert abs(end - mp.fsum(flights)) < mp.mpf(10) ** -40
    assert e != 0.5 or mp.nstr(end, 19) == "3.486573240944680007"
    assert found.contact_force[-1] == pytest.approx(-0.75, rel=1e-15)


def test_the_impact_oscillator_repeats_itself():
    """x'' + x = A cos(2 t + pi/2), x <= 0, e = 1/2: V = 8 A/3 at every impact, one each period."""
    found = solved(one(1.0, 0.5, sb.Harmonic(0.375, 2.0, "pi"), v=-0.5, upper=0.0), 13.0)
    wanted = [k * mp.pi for k in (1, 2, 3, 4)]
    assert max(abs(a - b) for a, b in zip(impact_times(found), wanted, strict=True)) < mp.mpf(10) ** -40
    assert found.impacts.impulses == pytest.approx([1.5] * 4, rel=1e-15)


def sticking_period():
    """(T_f, |u_1'|, time held) of u'' + [[2, -1], [-1, 1]] u = 0, u_2 <= 1, from the sums over its modes."""
    squares = [(3 - mp.sqrt(5)) / 2, (3 + mp.sqrt(5)) / 2]
    modes = []
    for square in squares:
        norm = mp.sqrt(1 + (2 - square) ** 2)
        first, second = 1 / norm, (2 - square) / norm
        modes.append((mp.sqrt(square), first, second, first + second))
    free = mp.findroot(lambda T: sum(w * b * c * mp.tan(w * T / 2) for w, _, b, c in modes), mp.mpf("5.954663"))
    speed = abs(sum(w * a * c * mp.tan(w * free / 2) for w, a, _, c in modes))
    return free, speed, mp.sqrt(2) * mp.atan(mp.sqrt(2) * speed)


@pytest.mark.slow
def test_two_masses_that_stick_once_a_period():
    """In units of the speed, u = 1 + speed x: x_1' = -1, x_2 = 0 at the start, the load -1/speed on mass 1.

    The gap ends like a cube: 66 digits of the speed make 22 of the touch; the release has them all.
    """
    free, speed, held = sticking_period()
    assert mp.nstr(free, 20) == "5.9546631408379963171"
    assert mp.nstr(held, 20) == "2.0516840715372104998"
    assert mp.nstr(free + held, 20) == "8.0063472123752068168"
    assert mp.nstr(speed, 20) == "5.8624393719567412909"
    assert mp.nstr(speed**2 / 2 + mp.mpf(0.5), 20) == "17.684097694934275633"
    stops = sb.Stops(upper=0.0, stiffness=INF, restitution=0.5)
    load = ([-1.0, 0.0], sb.Constant(mp.nstr(1 / speed, 66)))
    chain = sb.System.from_matrices(
        np.eye(2), [[2, -1], [-1, 1]], None, [load], [sb.Contact([0, 1], stops)], initial_velocity=[-1.0, 0.0]
    )
    found = solved(chain, 17.0)
    stretches = found.solution.motion.stretches
    changes = [precise(b.t) for a, b in pairwise(stretches) if a.regime.held != b.regime.held]
    wanted = [free, free + held, 2 * free + held, 2 * (free + held)]
    for k, (a, b) in enumerate(zip(changes, wanted, strict=True)):
        assert abs(a - b) < mp.mpf(10) ** (-20 if k % 2 == 0 else -40)
    assert found.contacts[0].fraction == pytest.approx(float(2 * held) / 17.0, rel=1e-14)


def test_a_flat_bar_on_two_stops_stays_flat():
    """Impacts at one time are one problem: with inertia between them, one after the other would turn the bar."""
    stops = sb.Stops(lower=0.0, stiffness=INF, restitution=0.5)
    mass, ends = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0, np.eye(2)
    bar = sb.System.from_matrices(
        mass, np.zeros((2, 2)), loads=[([-4.0, -4.0], sb.Constant(1.0))], contacts=[sb.Contact(x, stops) for x in ends],
        initial_displacement=[1.0, 1.0],
    )  # fmt: skip
    found = solved(bar, 2.0)
    assert found.contacts[0].impacts.times == pytest.approx(found.contacts[1].impacts.times, abs=1e-16)
    assert precise(found.solution.motion.stuck[0][0]) == pytest.approx(1.5, abs=1e-15)  # t_1 = 1/2


def agrees(seed):
    """Random systems of one to three unknowns, damped, pressed, with moving stops: float64 within its rounding."""
    system = rigid_witness.random_system(seed)
    found, other = solved(system, 3.0), sb.reference(system, 3.0, t_eval=np.linspace(0.0, 3.0, 41))
    assert found.horizon == 3.0
    assert other.horizon == 3.0
    scale = np.max(np.abs(found.tip))
    assert np.max(np.abs(found.tip - other.tip)) < 1e-12 * scale  # at most 2e-14 in the first 62
    for a, b in zip(found.contacts, other.contacts, strict=True):
        assert a.impacts.times == pytest.approx(b.impacts.times, abs=1e-12)
        assert np.array_equal(a.impacts.stops, b.impacts.stops)
        assert a.impacts.ends == pytest.approx(b.impacts.ends, abs=1e-12, nan_ok=True)
        assert a.impacts.impulses == pytest.approx(b.impacts.impulses, rel=1e-8, abs=1e-12, nan_ok=True)
        assert a.fraction == pytest.approx(b.fraction, abs=1e-6)  # that the end of chatter takes
        assert a.impulse == pytest.approx(b.impulse, rel=1e-12, abs=1e-12)
    gave = rigid_witness.signed_impulses(system, found, 3.0)
    for contact, each in zip(gave, found.contacts, strict=True):
        if len(set(each.impacts.stops)) < 2:  # else it was pushed both ways
            assert each.impulse == pytest.approx(abs(contact), rel=1e-10, abs=1e-10)  # by quadrature across releases
    assert np.max(np.abs(found.energy.loss)) < 1e-12 * (1.0 + np.max(found.energy.energy))


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(seed, marks=() if seed < 4 else pytest.mark.slow if seed % 3 else pytest.mark.campaign)
        for seed in range(60)
    ],
)
def test_random_systems_against_float64(seed):
    agrees(seed)


@pytest.mark.slow
def test_contacts_that_throw_each_other_off_are_refused():
    """Inertia between two contacts: each impact, e = 0, opens the other contact, again and again."""
    with pytest.raises(SolverFailure, match="at one time"):
        solved(rigid_witness.random_system(133), 3.0)


@pytest.mark.parametrize("kind", ["linear", "cubic"])
@pytest.mark.fast(1)
def test_sampled_loads_and_a_sampled_stop(kind):
    t = np.linspace(0.0, 2.0, 26)
    load = ([1.0, 0.0], sb.Sampled(t, 20.0 * np.sin(5.0 * t), kind=kind))
    moving = sb.Contact([0.0, 1.0], sb.Stops(upper=0.2, stiffness=INF, restitution=0.3), sb.Sampled(t, t**2, "cubic"))
    contacts = [sb.Contact([1.0, 0.0], sb.Stops(-0.1, 0.1, stiffness=INF, restitution=0.6)), moving]
    system = sb.System.from_matrices(np.eye(2), [[5.0, -2.0], [-2.0, 4.0]], None, [load], contacts)
    found, other = solved(system, 2.0), sb.reference(system, 2.0, t_eval=np.linspace(0.0, 2.0, 41))
    assert np.max(np.abs(found.tip - other.tip)) < 1e-12
    for a, b in zip(found.contacts, other.contacts, strict=True):
        assert a.impacts.times == pytest.approx(b.impacts.times, abs=1e-12)
    assert found.contacts[1].fraction > 0.1
    assert np.max(np.abs(found.energy.loss)) < 1e-12


def test_what_chatter_leaves_out_is_what_more_digits_find():
    """Damped and driven: the end of the impacts from 20 digits is off by less than it says, and by nearly that."""
    system = rigid_witness.random_system(16)
    coarse, fine = (rigid.Solved.of(system, 3.0, digits).motion for digits in (20, 40))
    assert len(coarse.stuck) == 2
    off = max(abs(precise(a[0]) - precise(b[0])) for a, b in zip(coarse.stuck, fine.stuck, strict=True))
    assert 1e-3 * coarse.left_out < off < coarse.left_out
    assert coarse.left_out < 1e-50


@pytest.mark.parametrize(
    ("system", "error", "named"),
    [
        (one(1.0, None, sb.Constant(1.0), upper=0.1), InputError, "restitution must be given"),
        (one(1.0, 0.5, sb.Constant(1.0), q=0.2, upper=0.1), InputError, "between"),
        (one(1.0, 0.5, np.sin, upper=0.1), InputError, "Harmonic"),
        (one(0.0, 0.5, sb.Constant(-8.0), v=4.0, upper=1.0), SolverFailure, "touched.*move the stop"),
    ],
)
def test_what_is_refused(system, error, named):
    """The last rises to the stop with v^2 = 2 g h, and no number of digits tells whether it hits."""
    with pytest.raises(error, match=named):
        solved(system, 1.0)


def test_a_fixed_number_of_digits_has_the_horizon_it_has():
    found = solved(one(0.0, 0.5, sb.Constant(-2.0), q=1.0, lower=0.0), 2.0, digits=25)
    assert found.provenance["digits"] == 47
    assert found.provenance["digits_confirmed_with"] == 25
    assert found.at([0.25])[0] == pytest.approx(1.0 - 0.0625, abs=1e-16)
    with pytest.raises(InputError, match="digits"):
        solved(one(0.0, 0.5, sb.Constant(-2.0), q=1.0, lower=0.0), 2.0, digits=5)


def test_it_shares_no_code_with_the_solution_in_float64():
    folder, seen, waiting = Path(rigid.__file__).parent, set(), ["rigid"]
    while waiting:
        name = waiting.pop()
        seen.add(name)
        for node in ast.walk(ast.parse((folder / f"{name}.py").read_text())):
            if isinstance(node, ast.ImportFrom):
                assert not (node.level == 2 and (node.module or "").startswith("exact")), name
                own = node.module if node.level == 1 else None
                waiting += [own] if own and own not in seen else []
    assert {"impacting", "linear_flow", "rational"} <= seen


def test_it_is_kept_by_its_outputs(own_cache):
    """Float64 cannot march between rigid stops from stored states: the cache and files hold what was asked for."""
    ball, times = one(0.0, 0.5, sb.Constant(-2.0), q=1.0, lower=0.0), np.linspace(0.0, 2.0, 5)
    first, again = (cached_reference(ball, 2.0, "multiprecision", times) for _ in range(2))
    assert not again.work.seconds > first.work.seconds
    assert np.array_equal(first.tip, again.tip)
    assert np.array_equal(first.impacts.times, again.impacts.times)
    with pytest.raises(InputError, match="compliant"):
        freeze(first, "", own_cache / "ball.nc")
