"""What a scheme, its label or a subclass may not be: one sentence with rule, value and remedy."""

from __future__ import annotations

import re

import numpy as np
import pytest
from systems import three_masses, with_stops

import stiffbeam as sb
from stiffbeam.schemes.labels import parse_run

LABELS = {
    "hhtt": "scheme must be a registered scheme, got 'hhtt': did you mean HHT?",
    "xyz": "known: BDF2, SDIRK, HHT",
    "": "scheme must read name(parameter=value, ...)@form, got ''",
    "mine_1e-05.csv": "compared in Python, by sb.compare([t, tip], reference)",
    "HHT(alpha=-0.1": "scheme must read name(parameter=value, ...)@form",
    "HHT@displacement@displacement": "for example HHT(alpha=-0.1)@displacement",
    "HHT(alpha=small)": "scheme must give each parameter a number, True or False, got 'HHT(alpha=small)'",
    "HHT(alpha=0, alpha=-0.1)": "scheme must name every parameter, and each once",
    "HHT(**{})": "HHT's parameter must be one of its own",
    "hht(alpha)": "scheme must name every parameter",
    "hht(alhpa=-0.1)": "'alhpa'",
    "HHT(alpha=0.1)": "alpha must lie in [-0.333333, 0], got 0.1: if your alpha is in [0, 1/3], pass -alpha",
    "HHT(alpha='-0.1')": "alpha must be a number, got '-0.1'",
    "SDIRK(gamma=0.1)": "outside it the scheme is not L-stable",
    "SDIRK(gamma=0.18)": "outside it the scheme is not L-stable",
    "SDIRK(gamma=0.25777)": "coefficients",
    "SDIRK(gamma=0.29289)": "coefficients",
    "SDIRK(gamma=0.60507)": "coefficients",
    "Theta(theta=0.3)": "theta",
    "PrintedSgma": "did you mean PrintedSigma",
    "BDF2@displacment": "form must be one that there is, got 'displacment': did you mean displacement?",
    "no_such_module:Central": "can be imported",
    "test_bad_schemes.py:Own": "write test_bad_schemes:Own",
    "test_bad_schemes:Onw": "did you mean Own",
    "test_bad_schemes:zzzz": "known: ",
    "test_bad_schemes:np": "Scheme class",
    "test_bad_schemes:Own(gamma=1)": "one of its own",
}


@pytest.mark.parametrize("text", LABELS)
def test_a_label(text):
    with pytest.raises(sb.InputError, match=re.escape(LABELS[text])):
        parse_run(text)


class Own(sb.Scheme):
    """Implicit Euler, to be broken in one way at a time."""

    def step(self, equation, dt, z, loads, reactions):
        y = z + dt * equation.implicit_rate(dt, z, loads[0] + reactions[0])
        return y, [y]


class Nonlinear(Own):
    def step(self, equation, dt, z, loads, reactions):
        return super().step(equation, dt, z**2, loads, reactions)


class TwoNodes(Own):
    nodes = (0.5, 1.0)


class LooksAhead(TwoNodes):
    def step(self, equation, dt, z, loads, reactions):
        y, [stage] = super().step(equation, dt, z, loads[1:], reactions[1:])
        return y, [stage, stage]


class RadauIIA(Own):
    nodes = (1 / 3, 1.0)

    def step(self, equation, dt, z, loads, reactions):
        stages = dt * np.array([[5 / 12, -1 / 12], [3 / 4, 1 / 4]])
        rates = equation.implicit_rate(stages, z, np.stack(loads) + np.stack(reactions))
        return z + stages[-1] @ rates, list(z + stages @ rates)


class Remembers(Own):
    calls = 0

    def step(self, equation, dt, z, loads, reactions):
        type(self).calls += 1
        y, [stage] = super().step(equation, dt, z, loads, reactions)
        return y * (1.0 + 1e-3 * (self.calls > 3)), [stage]


class Mixing(Own):
    def step(self, equation, dt, z, loads, reactions):
        y, [stage] = super().step(equation, dt, z, loads, reactions)
        return y + 0.1 * np.sum(y, axis=-1, keepdims=True), [stage]


class Clipping(sb.BDF2):
    def predict(self, equation, dt, z):
        return [np.clip(x, -0.1, 0.1) for x in super().predict(equation, dt, z)]


class Starting(sb.BDF2):
    @property
    def starter(self):
        return Mixing()


STEPS = [
    (Nonlinear(), "linear"), (LooksAhead(), r"causal.*fully implicit.*system\.ode\(\)"), (TwoNodes(), "and 2 y"),
    (RadauIIA(), r"one number.*fully implicit.*solve\(system, dt, t_end\)"), (Remembers(), "linear|same for the same"),
    (Mixing(), "do not mix"), (Clipping(), "linear"), (Starting(), "mix"),
]  # fmt: skip


@pytest.mark.parametrize(("scheme", "words"), STEPS)
def test_a_step_that_breaks_the_contract(scheme, words):
    with pytest.raises(sb.InputError, match=words):
        sb.integrate(three_masses(), scheme, 0.01, 0.1)


ROW, ONE, PLAIN = np.ones(1), np.eye(1), sb.Stops(upper=1.0, stiffness=1.0)


@pytest.mark.parametrize("kind", [sb.Stops, sb.Harmonic, sb.System, sb.Contact, sb.BeamProblem, sb.PointLoad])
def test_a_subclass_whose_methods_would_be_ignored(kind):
    with pytest.raises(sb.InputError, match=r"itself.*what a subclass overrides would be ignored"):
        type("Own", (kind,), {})


def conserving(scheme=None, **law):
    stops = sb.Stops(-0.1, 0.1, stiffness=1e3, **law)
    system = sb.semidiscretise(sb.BeamProblem(stiffness=300.0, stops=stops), 6)
    return lambda: sb.integrate(system, scheme or sb.Trapezoidal(), 1e-3, 0.1, contact="conserving")


def damped_members():
    system = sb.System.from_matrices(ONE, ONE, contacts=[sb.Contact(ROW, PLAIN)])
    members = [with_stops(system, sb.Stops(upper=0.1, stiffness=10.0, damping=1.0))]
    return sb.integrate_ensemble(system, sb.Trapezoidal(), 1e-3, 0.1, members, contact="conserving")


CALLS = [
    (lambda: sb.HHT(0.1), "pass -alpha"),
    (lambda: sb.integrate(three_masses(), "hht", 0.01, 0.1), "be a"),
    (lambda: sb.integrate(three_masses(), sb.HHT, 0.01, 0.1), "be a"),
    (lambda: sb.integrate("beam", sb.HHT(), 0.01, 0.1), "be a"),
    (lambda: sb.System.from_matrices(ONE, ONE, loads=[(ROW, sb.Harmonic)], observe=ROW), "loads must be a Harmonic"),
    *((conserving(scheme), "ExponentialFlow")
      for scheme in (sb.HHT(-0.1), sb.BDF2(), sb.SDIRK(), sb.Theta(0.6), sb.Bathe())),
    (conserving(dissipation=0.1), r"stops\.dissipation.*implicit contact"), (damped_members, r"stops\.damping"),
    (lambda: sb.amplification(sb.HHT(), [0.1, -1.0]), "positive"), (lambda: sb.amplification(sb.HHT(), []), "one or"),
    (lambda: sb.amplification(sb.HHT(), np.ones((2, 2))), "one or more"),
    (lambda: sb.amplification(sb.HHT(), 0.1, 1.0), r"\[0, 1\)"),
    (lambda: sb.amplification(sb.HHT(), 0.1, 0.0, "theory"), "closed form"),
    (lambda: sb.amplification(Own(), 0.1, source="closed form"), "kernel"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "words"), CALLS)
def test_a_call(call, words):
    with pytest.raises(sb.InputError, match=words):
        call()
