"""stiffbeam: fixed-step schemes beside adaptive and exact solutions of vibro-impact systems.

    problem -> semidiscretise -> System -> integrate (scheme) or reference (solver) -> Trajectory -> compare
    study: a registered question asked of a case, records out

Names are loaded on first use; SUNDIALS, jax and matplotlib only by the functions that need them.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .basics.units import Units
    from .basics.validation import InputError
    from .figures.mode_shapes import mode_shapes
    from .files.cases import Case, load_cases, paper_case
    from .files.reference_cache import cached_reference
    from .files.store import load
    from .march.ensemble import integrate_ensemble
    from .march.integrate import integrate
    from .measures.amplification import Amplification, amplification
    from .measures.comparison import Comparison, compare
    from .measures.tip_error import stays_within
    from .model.contact import Contact, Stops
    from .model.first_order import FirstOrderSystem
    from .model.members import Members, perturbed, varied
    from .model.modal_damping import modal_damping
    from .model.natural_modes import NaturalModes, modes, static_equilibrium
    from .model.noise import noise, random_phases
    from .model.problem import BeamProblem, DistributedLoad, PointLoad
    from .model.profiles import PolynomialProfile
    from .model.reduction import Reduced, reduced
    from .model.sampled import Sampled
    from .model.sections import Section
    from .model.semidiscretisation import semidiscretise
    from .model.system import System
    from .model.time_functions import Constant, Harmonic, Sum, TimeFunction
    from .references import reference
    from .references.ensemble import reference_ensemble
    from .references.exact.rigid import rigid_limit
    from .references.exact.tangent import Growth, lyapunov
    from .schemes import (
        BDF2,
        HHT,
        SDIRK,
        Bathe,
        ContactStabilisedNewmark,
        ExponentialFlow,
        GeneralisedAlpha,
        MoreauJean,
        MoreauJeanBilbao,
        NonsmoothGeneralisedAlpha,
        PaoliSchatzman,
        Scheme,
        Theta,
        Trapezoidal,
    )
    from .studies import study
    from .studies.advice import Advice, advise
    from .testset.problem import Problem, problem, problems
    from .testset.score import score
    from .testset.scorecard import Scorecard
    from .trajectory.ensemble import Ensemble
    from .trajectory.impacts import Impacts
    from .trajectory.trajectory import Diverged, Reference, SolverFailure, Trajectory

_HOME = {
    "figures.mode_shapes": ("mode_shapes",),
    "files.cases": ("Case", "load_cases", "paper_case"),
    "model.contact": ("Contact", "Stops"),
    "march.ensemble": ("integrate_ensemble",),
    "march.integrate": ("integrate",),
    "measures.amplification": ("Amplification", "amplification"),
    "measures.comparison": ("Comparison", "compare"),
    "model.members": ("Members", "perturbed", "varied"),
    "model.natural_modes": ("NaturalModes", "modes", "static_equilibrium"),
    "model.noise": ("noise", "random_phases"),
    "model.problem": ("BeamProblem", "DistributedLoad", "PointLoad"),
    "model.profiles": ("PolynomialProfile",),
    "files.reference_cache": ("cached_reference",),
    "schemes": (
        "BDF2",
        "HHT",
        "SDIRK",
        "Bathe",
        "ContactStabilisedNewmark",
        "ExponentialFlow",
        "GeneralisedAlpha",
        "MoreauJean",
        "MoreauJeanBilbao",
        "NonsmoothGeneralisedAlpha",
        "PaoliSchatzman",
        "Scheme",
        "Theta",
        "Trapezoidal",
    ),
    "model.reduction": ("Reduced", "reduced"),
    "model.modal_damping": ("modal_damping",),
    "model.sections": ("Section",),
    "model.semidiscretisation": ("semidiscretise",),
    "references": ("reference",),
    "references.ensemble": ("reference_ensemble",),
    "references.exact.rigid": ("rigid_limit",),
    "references.exact.tangent": ("Growth", "lyapunov"),
    "files.store": ("load",),
    "measures.tip_error": ("stays_within",),
    "studies": ("study",),
    "studies.advice": ("Advice", "advise"),
    "testset.problem": ("Problem", "problem", "problems"),
    "testset.score": ("score",),
    "testset.scorecard": ("Scorecard",),
    "model.first_order": ("FirstOrderSystem",),
    "model.system": ("System",),
    "model.sampled": ("Sampled",),
    "model.time_functions": ("Constant", "Harmonic", "Sum", "TimeFunction"),
    "trajectory.ensemble": ("Ensemble",),
    "trajectory.impacts": ("Impacts",),
    "trajectory.trajectory": ("Diverged", "Reference", "SolverFailure", "Trajectory"),
    "basics.units": ("Units",),
    "basics.validation": ("InputError",),
}
_MODULE = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "BDF2",
    "HHT",
    "SDIRK",
    "Advice",
    "Amplification",
    "Bathe",
    "BeamProblem",
    "Case",
    "Comparison",
    "Constant",
    "Contact",
    "ContactStabilisedNewmark",
    "DistributedLoad",
    "Diverged",
    "Ensemble",
    "ExponentialFlow",
    "FirstOrderSystem",
    "GeneralisedAlpha",
    "Growth",
    "Harmonic",
    "Impacts",
    "InputError",
    "Members",
    "MoreauJean",
    "MoreauJeanBilbao",
    "NaturalModes",
    "NonsmoothGeneralisedAlpha",
    "PaoliSchatzman",
    "PointLoad",
    "PolynomialProfile",
    "Problem",
    "Reduced",
    "Reference",
    "Sampled",
    "Scheme",
    "Scorecard",
    "Section",
    "SolverFailure",
    "Stops",
    "Sum",
    "System",
    "Theta",
    "TimeFunction",
    "Trajectory",
    "Trapezoidal",
    "Units",
    "advise",
    "amplification",
    "cached_reference",
    "compare",
    "integrate",
    "integrate_ensemble",
    "load",
    "load_cases",
    "lyapunov",
    "modal_damping",
    "mode_shapes",
    "modes",
    "noise",
    "paper_case",
    "perturbed",
    "problem",
    "problems",
    "random_phases",
    "reduced",
    "reference",
    "reference_ensemble",
    "rigid_limit",
    "score",
    "semidiscretise",
    "static_equilibrium",
    "stays_within",
    "study",
    "varied",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return version("stiffbeam")
    if name not in _MODULE:
        raise AttributeError(f"module 'stiffbeam' has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULE[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
