"""What users call, with arguments that work: ``fuzz.py`` puts wild values in their place."""

from __future__ import annotations

import contextlib
import functools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from systems import one_mass
from wild_values import near, wild

import stiffbeam as sb
from stiffbeam.basics.text import shown
from stiffbeam.measures.amplification import Amplification
from stiffbeam.model.members import EnsembleMembers
from stiffbeam.references import REFERENCES
from stiffbeam.references.horizon import PerturbationGrowth
from stiffbeam.trajectory.ensemble import Ensemble


@dataclass(frozen=True)
class Surface:
    """call(**arguments) with ``good`` arguments; ``weight`` is how often it is tried beside the others."""

    name: str
    call: Callable[..., Any]
    good: dict[str, Any]
    weight: int = 4

    def try_one(self, rng: np.random.Generator) -> Any:
        arguments = dict(self.good)
        count = min(len(arguments), int(rng.choice([1, 1, 1, 2, 3])))
        changed = rng.choice(list(arguments), count, replace=False)
        for name in changed:
            arguments[name] = near(rng, arguments[name]) if rng.random() < 0.4 else wild(rng)
        try:
            return self.call(**arguments)
        except Exception as error:
            error.add_note(shown({name: arguments[name] for name in changed}))
            raise


STOPS = {"lower": -0.1, "upper": 0.1, "stiffness": 1e4}
BEAM = {"stiffness": 300.0, "stops": sb.Stops(**STOPS), "base": sb.Harmonic(0.2, 10.0)}


@functools.cache
def beam() -> sb.System:
    return sb.semidiscretise(sb.BeamProblem(**BEAM), 4)


def mass(stops: Any = None, load: Any = None, offset: Any = None, **given: Any) -> sb.System:
    """q'' + 25 q = load between stops."""
    stops, load = sb.Stops(**STOPS) if stops is None else stops, sb.Harmonic(3.0, 4.0) if load is None else load
    return one_mass(25.0, stops, load=load, offset=offset, **given)


@functools.cache
def run() -> sb.Trajectory:
    return sb.integrate(beam(), sb.HHT(), 1e-3, 0.05)


@functools.cache
def exact() -> sb.Reference:
    return sb.reference(beam(), 0.05)


def marched(system: Any, dt: float = 1e-3) -> list[Any]:
    """A constructor's result is put to use: a thousand steps and the exact solution where there is one."""
    found: list[Any] = [sb.integrate(system, sb.HHT(), dt, 10 * dt)]
    with contextlib.suppress(sb.InputError, sb.SolverFailure):
        found.append(sb.reference(system, 10 * dt))
    return found


def of_stops(**given: Any) -> Any:
    return marched(mass(stops=sb.Stops(**given)))


def of_problem(make: Callable[..., Any], form: str = "displacement", **given: Any) -> Any:
    return marched(sb.semidiscretise(make(**given), 4, form))


def of_time(make: Callable[..., Any], **given: Any) -> Any:
    function = make(**given)
    return [np.asarray(function.value(np.linspace(0.0, 1e-2, 5))), *marched(mass(load=function))]


def of_scheme(make: Callable[..., Any], **given: Any) -> Any:
    return sb.integrate(beam(), make(**given), 1e-3, 0.01)


def saved(suffix: Any) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        return run().save(f"{folder}/run{suffix}" if isinstance(suffix, str) else suffix)


CONSTRUCTORS = [
    Surface("Harmonic", functools.partial(of_time, sb.Harmonic), {"amplitude": 0.2, "frequency": 10.0, "phase": 0.3}),
    Surface("Constant", functools.partial(of_time, sb.Constant), {"level": 0.1}, 2),
    Surface("Superposition", lambda a, b: of_time(lambda: sb.Superposition(a, b)),
            {"a": sb.Constant(1.0), "b": sb.Harmonic(1.0, 2.0)}),
    Surface("Sampled", functools.partial(of_time, sb.Sampled),
            {"t": [0.0, 0.5, 1.0, 2.0], "values": [0.0, 1.0, 0.0, 0.0], "kind": "cubic", "derivative": 0}),
    Surface("Stops", of_stops, STOPS | {"exponent": 1.5, "damping": 2.0, "dissipation": 0.1}, 8),
    Surface("Contact", lambda **x: marched(sb.System.from_matrices(
        np.eye(3), np.eye(3), contacts=[sb.Contact(**x)])),
            {"row": [0.0, 1.0, 0.0], "stops": sb.Stops(**STOPS), "offset": sb.Harmonic(0.1, 3.0)}),
    Surface("PointLoad", lambda **x: of_problem(sb.BeamProblem, **BEAM, loads=sb.PointLoad(**x)),
            {"position": 0.5, "time": sb.Constant(1.0)}),
    Surface("DistributedLoad", lambda **x: of_problem(sb.BeamProblem, **BEAM, loads=sb.DistributedLoad(**x)),
            {"shape": sb.PolynomialProfile((1.0, 2.0)), "time": sb.Constant(1.0)}),
    Surface("PolynomialProfile", lambda **x: of_problem(sb.BeamProblem, stiffness=1.0,
                                                        initial_velocity=sb.PolynomialProfile(**x)),
            {"coefficients": (0.0, 0.0, 1.0)}),
    Surface("BeamProblem", functools.partial(of_problem, sb.BeamProblem),
            BEAM | {"viscosity": 0.01, "length": 1.0, "mass_per_length": 1.0, "loads": (),
                    "initial_displacement": sb.PolynomialProfile((0.0, 0.0, 1.0)), "initial_velocity": lambda x: 0 * x,
                    "units": ("m", "s", "N"), "tip_mass": 0.1, "mass_damping": 0.2}, 12),
    Surface("BeamProblem hermite", lambda **x: of_problem(sb.BeamProblem, "hermite", stiffness=300.0, **x),
            {"supports": "clamped-pinned", "stops": [sb.Stops(**STOPS, position=0.4)], "viscosity": 0.01}),
    Surface("System.from_matrices", lambda **x: marched(sb.System.from_matrices(**x)),
            {"mass": np.eye(3), "stiffness": 9.0 * np.eye(3), "damping": 0.1 * np.eye(3), "loads": (),
             "contacts": [sb.Contact([0.0, 0.0, 1.0], sb.Stops(**STOPS))], "observe": [0.0, 1.0, 0.0],
             "initial_displacement": np.zeros(3), "initial_velocity": np.ones(3)}, 12),
    Surface("HHT", functools.partial(of_scheme, sb.HHT), {"alpha": -0.1}, 2),
    Surface("SDIRK", functools.partial(of_scheme, sb.SDIRK), {"gamma": 0.4359, "nystrom": True}, 2),
    Surface("GeneralisedAlpha", functools.partial(of_scheme, sb.GeneralisedAlpha), {"rho": 0.5}, 2),
    Surface("Theta", functools.partial(of_scheme, sb.Theta), {"theta": 0.6}, 2),
    Surface("Bathe", functools.partial(of_scheme, sb.Bathe), {"split": 0.5}, 2),
    Surface("Trajectory.from_arrays", sb.Trajectory.from_arrays,
            {"t": np.linspace(0.0, 1.0, 11), "tip": np.zeros(11), "tip_velocity": np.zeros(11), "system": mass(),
             "name": "mine"}),
    Surface("Members", lambda **x: sb.integrate_ensemble(beam(), sb.HHT(), 1e-3, 0.01, EnsembleMembers(**x)),
            {"system": beam(), "systems": [beam(), beam()], "parameters": {"start": [1.0, 2.0]}}),
]  # fmt: skip

FUNCTIONS = [
    Surface("semidiscretise", lambda **x: marched(sb.semidiscretise(**x)),
            {"problem": sb.BeamProblem(**BEAM), "cells": 6, "form": "velocity-curvature"}),
    Surface("integrate", sb.integrate,
            {"system": beam(), "scheme": sb.HHT(), "dt": 1e-3, "t_end": 0.1, "contact": "implicit", "every": 1}, 12),
    Surface("integrate, one mass", lambda **x: sb.integrate(mass(), **x),
            {"scheme": sb.BDF2(), "dt": 1e-3, "t_end": 0.1, "every": 3}),
    Surface("integrate_ensemble", sb.integrate_ensemble,
            {"system": beam(), "scheme": sb.HHT(), "dt": 1e-3, "t_end": 0.1, "members": [beam(), beam()],
             "contact": "implicit", "every": 10, "since": 0.05}, 8),
    *(Surface(f"reference {method}", functools.partial(sb.reference, method=method),
              {"system": mass(), "t_end": 0.5, "t_eval": [0.0, 0.1, 0.5], "rtol": 1e-7, "atol": 1e-9, "digits": "auto",
               "breakpoints": (0.2,)}, 1 if "kvaerno" in method else 3)
      for method in REFERENCES),
    *(Surface(f"reference {method}, few arguments", functools.partial(sb.reference, method=method),
              {"system": beam(), "t_end": 0.02}, 1 if "kvaerno" in method else 2) for method in REFERENCES),
    Surface("reference", sb.reference, {"system": mass(), "t_end": 0.5, "method": "exact"}),
    Surface("cached_reference", sb.cached_reference,
            {"system": mass(), "t_end": 0.5, "method": "cvode", "t_eval": [0.0, 0.1, 0.5], "rtol": 1e-7}),
    Surface("reference_ensemble", sb.reference_ensemble, {"system": mass(), "t_end": 0.5, "members": [mass(), mass()]}),
    Surface("lyapunov", sb.lyapunov, {"system": mass(), "t_end": 0.5}),
    Surface("compare", sb.compare, {"run": run(), "reference": exact()}),
    Surface("modes", sb.modes, {"system": beam()}, 1),
    Surface("perturbed", lambda **x: list(sb.perturbed_members(**x)[:3]),
            {"system": beam(), "members": 3, "size": 1e-12, "t_end": 1.0}, 6),
    *(Surface(f"varied {name}", lambda name=name, **x: marched(sb.varied_members(beam(), {name: x["values"]})[0]),
              {"values": values}) for name, values in (("frequency", [9.0, 10.0]), ("amplitude", [0.1, 0.2]))),
    Surface("amplification", sb.amplification,
            {"scheme": sb.HHT(), "dt_over_period": [0.01, 0.1], "damping_ratio": 0.1, "source": "kernel"}, 6),
    Surface("load", sb.load, {"file": "run.nc", "system": beam(), "t_eval": None}),
    Surface("load_cases", sb.load_cases, {"file": "case.toml"}, 2),
    Surface("paper_case", sb.paper_case, {"table": 3}, 2),
    Surface("study", sb.study, {"name": "modes", "case": "table10", "schemes": ["hht"], "jobs": 1}),
    Surface("run.save", saved, {"suffix": ".nc"}, 1),
    Surface("run.displacement", lambda x: run().displacement(x), {"x": [0.1, 0.5]}),
    Surface("reference.at", lambda **x: exact().at(**x), {"t": [0.0, 0.01], "contact": 0}, 6),
    Surface("reference.impacts_sampled", lambda **x: exact().impacts_sampled(**x),
            {"dt": 1e-3, "t_end": 0.05, "contact": 0}, 6),
    Surface("impacts.until", lambda t: exact().impacts.until(t), {"t": 0.03}),
]  # fmt: skip


def numbers_in(found: Any) -> Any:
    """(name, array) of every float that a result holds and that has to be finite."""
    if isinstance(found, (list, tuple)):
        for item in found:
            yield from numbers_in(item)
    elif isinstance(found, np.ndarray) and found.dtype.kind == "f":
        yield "array", found
    elif isinstance(found, sb.Trajectory):
        yield from ((name, getattr(found, name)) for name in ("t", "tip", "tip_velocity"))
        for contact in found.contacts:
            rigid = found.provenance["method"] == "rigid"
            yield from ((name, getattr(contact, name)) for name in ("position", "velocity", "fraction", "impulse"))
            if not rigid:
                yield from ((name, getattr(contact, name)) for name in ("force", "peak_force"))
            yield "impacts.times", contact.impacts.times
        if found.ledger is not None and found.provenance.get("source") != "arrays":
            yield from ((f"energy.{x.name}", getattr(found.energy, x.name)) for x in fields(found.energy))
    elif isinstance(found, sb.System):
        yield from ((name, getattr(found, name)) for name in ("mass", "stiffness", "damping", "q0", "v0"))
    elif isinstance(found, Ensemble):
        whole = np.isnan(found.diverged)
        yield from (("fraction", c.fraction[whole]) for c in found.contacts)
        yield from (("peak_force", c.peak_force[whole]) for c in found.contacts)
    elif isinstance(found, Amplification):
        yield "spectral_radius", found.spectral_radius
    elif isinstance(found, PerturbationGrowth):
        yield "log_growth", found.log_growth
