"""Refusals of systems: each names a remedy that its own caller can apply, and applied as code it works."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from systems import one_mass

import stiffbeam as sb

INF, T, PERIOD = np.inf, np.linspace(0.0, 8.0, 161), 2.0 * np.pi / 5.0
DRIVE, RECORD = sb.Harmonic(50.0, 5.0), sb.Sampled(T, 50.0 * np.sin(5.0 * T), "cubic")
MOVED = sb.Sampled(T, 0.01 * np.sin(T), "cubic")
STOP = {"upper": 0.1, "stiffness": 1e4}
HARD = {"upper": 0.1, "stiffness": INF, "restitution": 0.8}


def python(t):
    return 50.0 * np.sin(5.0 * np.asarray(t))


def oscillator(stop, load=DRIVE, damping=1.0, offset=None):
    """One mass, driven against stops."""
    return one_mass(100.0, sb.Stops(**stop), damping=damping, load=load, offset=offset)


def two(first, second):
    """Two masses, each with a stop."""
    contacts = [sb.Contact(row, sb.Stops(**stop)) for row, stop in zip(np.eye(2), (first, second), strict=True)]
    return sb.System.from_matrices(np.eye(2), 100.0 * np.eye(2), loads=[([1.0, 0.9], DRIVE)], contacts=contacts)


LINEAR, HERTZ = oscillator(STOP), oscillator(STOP | {"exponent": 1.5})
FREE, GIVES = oscillator(STOP, damping=0.0), oscillator(STOP, damping=-0.1)
DASHPOT = oscillator(STOP | {"damping": 5.0})
RIGID, LAWLESS, STIFF = (
    oscillator(HARD),
    oscillator(HARD | {"restitution": None}),
    oscillator(STOP | {"stiffness": 1e8}),
)
PYTHON, SAMPLED = oscillator(STOP, python), oscillator(STOP, RECORD)
RECORDED = oscillator(STOP | {"damping": 5.0}, offset=MOVED)  # a dashpot that a record moves
MIXED, STIFFER = two(HARD, STOP), two(STOP | {"stiffness": 1e7}, STOP)
TWICE = replace(RIGID, contacts=RIGID.contacts * 2)


def exact(system, method="exact"):
    return sb.reference(system, 0.3, method)


def march(system, scheme, contact="implicit"):
    return sb.integrate(system, scheme, 1e-3, 0.3, contact=contact)


def members(system, **more):
    return sb.reference_ensemble(system, 0.3, sb.perturbed_members(system, 3, t_end=0.3), **more)


def derivative(system, method="exact"):
    return exact(system, method).derivative("stops.upper")


def differences(system):
    return [exact(x, "cvode").tip for x in sb.varied_members(system, {"stops.upper": [0.0999, 0.1001]}).systems]


def jacobian(system):
    import jax

    ode = system.ode()
    return jax.jacobian(lambda y: ode.jax(0.0, y))(ode.y0)


def reduced(modes):
    return sb.reduce_model(np.diag([1.0, 1.0, 0.0]), np.diag([1.0, 2.0, 3.0]), modes=modes, observe=[1.0, 0.0, 0.0])


study = partial(sb.study, dt=1e-2, t_end=1.0, jobs=1)
chaos = partial(study, "chaos", starts=6, span=0.2, schemes=["HHT(alpha=-0.1)"])
orbits = partial(study, "orbits", values=[4.8, 5.2])
sweep = partial(study, "sweep", values=[4.8, 5.2], periods=1)
limit = partial(study, "rigid", factors=[1.0], impacts=1)
orbit, lyapunov = partial(sb.periodic_orbit, period=PERIOD), partial(sb.lyapunov, t_end=1.0)
flow = partial(sb.jax_flow, wrt=["stops.upper"], t=[0.1, 0.2])
SAMPLE, OTHER, GIVE = "sample it: Sampled(t, values, 'cubic')", ", or use the solver cvode-adams", "give one, or"
LEAST, LARGE, CHAOS = "leave it out", "use a large one, 1e8", ', or take the study "chaos"'
STOPPED, SUM = "leave out what gives energy", "write it as a sum of harmonics"
JAX = ", or differentiate a solver of system.ode().jax"
ALL = "take stiff ones for inf"
# Refused call, words of its remedies, the calls that apply each of them.
REMEDIES = [
    ((exact, HERTZ), LEAST + OTHER, (exact, LINEAR), (exact, HERTZ, "cvode-adams")),
    ((exact, GIVES), STOPPED + OTHER, (exact, FREE), (exact, GIVES, "cvode-adams")),
    ((exact, RECORDED), "leave the damping out" + OTHER, (exact, oscillator(STOP, offset=MOVED)),
     (exact, RECORDED, "cvode-adams")),
    ((exact, PYTHON), SAMPLE, (exact, SAMPLED)),
    ((exact, oscillator(HARD, python)), SAMPLE, (exact, oscillator(HARD, RECORD))),
    ((exact, LAWLESS), GIVE, (exact, RIGID)),
    ((exact, MIXED), ALL, (exact, STIFFER)),
    ((exact, TWICE), "leave one out", (exact, RIGID)),
    ((exact, oscillator(HARD, offset=sb.Sampled(T, 0.01 * np.sin(T)))), 'samples of kind "cubic"',
     (exact, oscillator(HARD, offset=MOVED))),
    ((exact, oscillator(STOP, sb.Sampled(T + 5.0, T))), "let it begin at 0",
     (exact, oscillator(STOP, sb.Sampled(T, T)))),
    ((exact, HERTZ, "multiprecision"), LEAST + OTHER, (exact, LINEAR, "multiprecision"), (exact, HERTZ, "cvode-adams")),
    ((exact, RIGID, "multiprecision"), "use the method exact, or a large one", (exact, RIGID),
     (exact, STIFF, "multiprecision")),
    ((exact, SAMPLED, "multiprecision"), "use the method exact", (exact, SAMPLED)),
    ((exact, PYTHON, "multiprecision"), "use the method exact, and sample Python functions for it", (exact, SAMPLED)),
    ((exact, RIGID, "cvode"), "use the method exact, or a large one", (exact, RIGID), (exact, STIFF, "cvode")),
    ((exact, PYTHON, "kvaerno5"), SAMPLE, (exact, SAMPLED, "kvaerno5")),
    ((lyapunov, HERTZ), LEAST + CHAOS, (lyapunov, LINEAR), (chaos, HERTZ)),
    ((lyapunov, GIVES), STOPPED + CHAOS, (lyapunov, FREE), (chaos, GIVES)),
    ((lyapunov, RECORDED), "leave the damping out" + CHAOS, (lyapunov, oscillator(STOP, offset=MOVED)),
     (chaos, RECORDED)),
    ((lyapunov, PYTHON), SAMPLE, (lyapunov, SAMPLED)),
    ((lyapunov, LAWLESS), GIVE, (lyapunov, RIGID)),
    ((orbit, HERTZ), LEAST, (orbit, LINEAR)),
    ((orbit, GIVES), STOPPED, (orbit, LINEAR)),
    ((orbit, PYTHON), SUM, (orbit, LINEAR)),
    ((orbit, SAMPLED), SUM, (orbit, LINEAR)),
    ((orbit, LAWLESS), GIVE, (orbit, RIGID)),
    ((derivative, LINEAR, "cvode"), "solve it here: sb.reference(system, t_end)", (derivative, LINEAR)),
    ((derivative, HERTZ, "cvode"), "without an exact solution take differences of two", (differences, HERTZ)),
    ((flow, HERTZ), LEAST + JAX, (flow, LINEAR), (jacobian, HERTZ)),
    ((flow, GIVES), STOPPED + JAX, (flow, FREE), (jacobian, GIVES)),
    ((flow, PYTHON), SAMPLE, (flow, SAMPLED)),
    ((sb.System.ode, RIGID), LARGE, (sb.System.ode, STIFF)),
    ((lambda x: x.ode().cfunc, PYTHON), SAMPLE, (lambda x: x.ode().cfunc, SAMPLED)),
    ((jacobian, PYTHON), SAMPLE, (jacobian, SAMPLED)),
    ((march, RIGID, sb.HHT()), "use MoreauJean(), PaoliSchatzman(), NonsmoothGeneralisedAlpha(), or a large finite",
     (march, RIGID, sb.MoreauJean()), (march, RIGID, sb.PaoliSchatzman()),
     (march, RIGID, sb.NonsmoothGeneralisedAlpha()), (march, STIFF, sb.HHT())),
    ((march, RIGID, sb.HHT(), "conserving"), "use MoreauJean()", (march, RIGID, sb.MoreauJean())),
    ((march, RIGID, sb.MoreauJean(), "conserving"), LEAST, (march, RIGID, sb.MoreauJean())),
    ((march, LINEAR, sb.MoreauJean()), "as Trapezoidal, or give stiffness = inf", (march, LINEAR, sb.Trapezoidal()),
     (march, RIGID, sb.MoreauJean())),
    ((march, LAWLESS, sb.MoreauJean()), "give the stops a restitution", (march, RIGID, sb.MoreauJean())),
    ((march, MIXED, sb.HHT()), "very stiff ones for inf", (march, STIFFER, sb.HHT())),
    ((march, TWICE, sb.MoreauJean()), "leave out contacts that follow from others", (march, RIGID, sb.MoreauJean())),
    ((march, DASHPOT, sb.HHT(), "extrapolated"), "use the implicit contact", (march, DASHPOT, sb.HHT())),
    ((march, LINEAR, sb.HHT(), "conserving"), "use Trapezoidal or ExponentialFlow",
     (march, LINEAR, sb.Trapezoidal(), "conserving"), (march, LINEAR, sb.ExponentialFlow(), "conserving")),
    ((members, HERTZ, {"since": 0.1}), "record contacts from the start", (members, HERTZ)),
    ((members, LAWLESS), GIVE, (members, RIGID)),
    ((reduced, 3), "ask for fewer", (reduced, 1)),
    ((orbits, HERTZ), LEAST, (orbits, LINEAR)),
    ((orbits, SAMPLED), "drive it by one Harmonic", (orbits, LINEAR)),
    ((limit, oscillator(STOP | {"exponent": 1.5}, damping=0.0)), LEAST, (limit, FREE)),
    ((limit, RIGID), LARGE, (limit, oscillator(STOP | {"stiffness": 1e8}, damping=0.0))),
    ((sweep, HERTZ, {"method": "exact"}), "name a scheme as method, or transient=0", (sweep, HERTZ, {"method": "HHT"}),
     (sweep, HERTZ, {"method": "exact", "transient": 0})),
]  # fmt: skip


def _call(function, *arguments):
    *others, options = arguments
    return function(*others, **options) if isinstance(options, dict) else function(*arguments)


@pytest.mark.usefixtures("jax_in_float64")
@pytest.mark.parametrize(("refused", "remedy", "applied"), [pytest.param(a, b, c, id=b[:40]) for a, b, *c in REMEDIES])
def test_a_remedy_can_be_applied_where_it_is_given(refused, remedy, applied):
    with pytest.raises(sb.InputError, match=re.escape(remedy)):
        _call(*refused)
    for call in applied:
        assert _call(*call) is not None
