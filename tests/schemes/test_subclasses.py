"""What is not understood is refused: a subclass's own behaviour is never left out in silence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import stiffbeam as sb
from stiffbeam.schemes import registered
from stiffbeam.schemes.scheme import check_contract
from stiffbeam.studies.common import chosen


@dataclass(frozen=True)
class Hertz(sb.Stops):
    def force(self, v):
        return -self.stiffness * np.sign(v) * np.abs(self.penetration(v)) ** 1.5


@dataclass(frozen=True)
class Unchecked(sb.Stops):
    """Its own constructor checks nothing, so that whoever takes it must look."""

    def __post_init__(self) -> None:
        pass


@dataclass(frozen=True)
class Chirp(sb.Harmonic):
    def value(self, t):
        return self.amplitude * np.sin(self.frequency * np.asarray(t) ** 2)


@dataclass(frozen=True)
class Ramp(sb.Constant):
    def value(self, t):
        return self.level * np.asarray(t)


@dataclass(frozen=True)
class Moving(sb.PointLoad):
    speed: float = 1.0


class Sagging(sb.System):
    def load(self, t):
        return super().load(t) - 9.81


class Ringing:
    """A function of time through the protocol: its methods are asked, so it stays allowed."""

    def value(self, t):
        return np.sin(3.0 * np.asarray(t) ** 2)

    def rate(self, t):
        return 6.0 * np.asarray(t) * np.cos(3.0 * np.asarray(t) ** 2)

    def acceleration(self, t):
        t = np.asarray(t)
        return 6.0 * np.cos(3.0 * t**2) - 36.0 * t**2 * np.sin(3.0 * t**2)


ROW, ONE = np.ones(1), np.eye(1)
STOPS = Unchecked(upper=1.0, stiffness=1.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Hertz(upper=0.1, stiffness=1e4),
        lambda: sb.Contact(ROW, STOPS),
        lambda: sb.BeamProblem(stiffness=1.0, stops=STOPS),
        lambda: Chirp(1.0, 2.0),
        lambda: Ramp(1.0),
        lambda: sb.BeamProblem(stiffness=1.0, loads=(Moving(0.5, sb.Constant(1.0)),)),
        lambda: Sagging.from_matrices(ONE, ONE, observe=ROW),
        lambda: type("MyContact", (sb.Contact,), {})(ROW, sb.Stops(upper=1.0, stiffness=1.0)),
        lambda: type("MyBeam", (sb.BeamProblem,), {})(stiffness=1.0),
        lambda: sb.varied_members(
            sb.System.from_matrices(ONE, ONE, contacts=[sb.Contact(ROW, sb.Stops(upper=1.0, stiffness=1.0))]),
            stops=[STOPS],
        ),
    ],
)
def test_a_subclass_is_refused_with_the_remedy(make):
    with pytest.raises(sb.InputError, match=r"itself.*what a subclass overrides would be ignored"):
        make()


def test_a_function_of_time_of_ones_own_is_asked_for_its_values():
    """A unit mass on a unit spring under sin(3 t^2): the scheme against the solver that calls the function."""
    system = sb.System.from_matrices(ONE, ONE, loads=[(ROW, Ringing())], observe=ROW)
    run = sb.integrate(system, sb.SDIRK(), 1e-3, 2.0, every=100)
    wanted = sb.reference(system, 2.0, "dop853", run.t, rtol=1e-10).tip
    assert np.max(np.abs(run.tip - wanted)) < 1e-6 * np.max(np.abs(wanted))


def test_a_class_in_place_of_a_function_is_refused():
    with pytest.raises(sb.InputError, match="not a class"):
        sb.System.from_matrices(ONE, ONE, loads=[(ROW, sb.Harmonic)], observe=ROW)


class Stiffer(sb.HHT):
    """HHT with another step; without a name of its own."""

    def step(self, equation, dt, z, loads, reactions):
        return super().step(equation, 0.9 * dt, z, loads, reactions)


class Impostor(Stiffer):
    name = "hht"


def test_a_changed_scheme_never_goes_by_the_name_of_the_one_it_changes():
    assert str(Stiffer(-0.2)) == "Stiffer(alpha=-0.2)"
    assert str(sb.HHT(-0.2).printed()) == "HHT(alpha=-0.2).printed(unweighted)"
    case = sb.paper_case(10)
    assert list(chosen(case, [Stiffer(-0.2), Impostor()])) == [
        "Stiffer(alpha=-0.2)", "Impostor(alpha=-0.1)",
    ]  # fmt: skip
    assert list(chosen(case, [sb.HHT(-0.2), "bdf2"])) == ["HHT(alpha=-0.2)", "BDF2"]


class Forgetful(sb.BDF2):
    calls = 0

    def step(self, equation, dt, z, loads, reactions):
        type(self).calls += 1
        z, positions = super().step(equation, dt, z, loads, reactions)
        return z * (1.0 + 1e-3 * (self.calls > 3)), positions


class Mixing(sb.BDF2):
    def step(self, equation, dt, z, loads, reactions):
        z, positions = super().step(equation, dt, z, loads, reactions)
        return z + 0.1 * np.sum(z, axis=-1, keepdims=True), positions


class Clipping(sb.BDF2):
    def predict(self, equation, dt, z):
        return [np.clip(x, -0.1, 0.1) for x in super().predict(equation, dt, z)]


class Starting(sb.BDF2):
    @property
    def starter(self):
        return Mixing()


@pytest.mark.parametrize(
    ("scheme", "rule"),
    [(Forgetful(), "linear|same for the same"), (Mixing(), "do not mix"), (Clipping(), "linear"), (Starting(), "mix")],
)
def test_what_a_march_would_not_see_of_a_scheme_is_refused(three_masses, scheme, rule):
    with pytest.raises(sb.InputError, match=rule):
        sb.integrate(three_masses, scheme, 1e-2, 0.1)


def test_every_registered_scheme_keeps_the_contract():
    for scheme in registered():
        check_contract(scheme)
