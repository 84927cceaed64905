"""stiffbeam: fixed-step schemes beside adaptive and exact solutions of vibro-impact systems.

    problem -> semidiscretise -> System -> integrate (scheme) or reference (solver) -> Trajectory -> compare
    study: a registered question asked of a case, records out

Names are loaded on first use; SUNDIALS, jax and matplotlib only by the functions that need them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .cases import Case, load_cases, paper_case
    from .contact import Contact, Stops
    from .first_order import FirstOrderSystem
    from .march.ensemble import Ensemble, integrate_ensemble, reference_ensemble
    from .march.integrate import integrate
    from .march.members import Members, perturbed, varied
    from .measures.amplification import Amplification, amplification
    from .measures.comparison import Comparison, compare
    from .problem import BeamProblem, DistributedLoad, PointLoad, Units
    from .reference_cache import cached_reference
    from .schemes import BDF2, HHT, SDIRK, Bathe, GeneralisedAlpha, Scheme, Theta, Trapezoidal
    from .semidiscretisation import semidiscretise
    from .solvers import reference
    from .solvers.rigid import rigid_limit
    from .solvers.tangent import Growth, lyapunov
    from .store import load
    from .studies import study
    from .system import System
    from .time_functions import Constant, Harmonic, TimeFunction
    from .trajectory import Diverged, Impacts, Reference, SolverFailure, Trajectory
    from .validation import InputError

_HOME = {
    "cases": ("Case", "load_cases", "paper_case"),
    "contact": ("Contact", "Stops"),
    "march.ensemble": ("Ensemble", "integrate_ensemble", "reference_ensemble"),
    "march.integrate": ("integrate",),
    "measures.amplification": ("Amplification", "amplification"),
    "measures.comparison": ("Comparison", "compare"),
    "march.members": ("Members", "perturbed", "varied"),
    "problem": ("BeamProblem", "DistributedLoad", "PointLoad", "Units"),
    "reference_cache": ("cached_reference",),
    "schemes": ("BDF2", "HHT", "SDIRK", "Bathe", "GeneralisedAlpha", "Scheme", "Theta", "Trapezoidal"),
    "semidiscretisation": ("semidiscretise",),
    "solvers": ("reference",),
    "solvers.rigid": ("rigid_limit",),
    "solvers.tangent": ("Growth", "lyapunov"),
    "store": ("load",),
    "studies": ("study",),
    "first_order": ("FirstOrderSystem",),
    "system": ("System",),
    "time_functions": ("Constant", "Harmonic", "TimeFunction"),
    "trajectory": ("Diverged", "Impacts", "Reference", "SolverFailure", "Trajectory"),
    "validation": ("InputError",),
}
_MODULE = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "BDF2",
    "HHT",
    "SDIRK",
    "Amplification",
    "Bathe",
    "BeamProblem",
    "Case",
    "Comparison",
    "Constant",
    "Contact",
    "DistributedLoad",
    "Diverged",
    "Ensemble",
    "FirstOrderSystem",
    "GeneralisedAlpha",
    "Growth",
    "Harmonic",
    "Impacts",
    "InputError",
    "Members",
    "PointLoad",
    "Reference",
    "Scheme",
    "SolverFailure",
    "Stops",
    "System",
    "Theta",
    "TimeFunction",
    "Trajectory",
    "Trapezoidal",
    "Units",
    "amplification",
    "cached_reference",
    "compare",
    "integrate",
    "integrate_ensemble",
    "load",
    "load_cases",
    "lyapunov",
    "paper_case",
    "perturbed",
    "reference",
    "reference_ensemble",
    "rigid_limit",
    "semidiscretise",
    "study",
    "varied",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module 'stiffbeam' has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULE[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
