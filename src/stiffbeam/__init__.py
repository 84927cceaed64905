"""stiffbeam: fixed-step schemes beside adaptive and exact solutions of vibro-impact systems.

    problem -> semidiscretise -> System -> integrate (scheme) or reference (solver) -> Trajectory -> compare

Names are loaded on first use; SUNDIALS, jax and matplotlib only by the functions that need them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .cases import Case, load_cases, paper_case
    from .contact import Contact, Stops
    from .march import integrate
    from .measures.comparison import Comparison, compare
    from .problem import BeamProblem, DistributedLoad, PointLoad, Units
    from .schemes import BDF2, HHT, SDIRK, Scheme, Theta
    from .semidiscretisation import semidiscretise
    from .solvers import reference
    from .solvers.tangent import Growth, lyapunov
    from .store import load
    from .system import FirstOrderSystem, System
    from .time_functions import Constant, Harmonic, TimeFunction
    from .trajectory import Diverged, Impacts, Reference, SolverFailure, Trajectory
    from .validation import InputError

_HOME = {
    "cases": ("Case", "load_cases", "paper_case"),
    "contact": ("Contact", "Stops"),
    "march": ("integrate",),
    "measures.comparison": ("Comparison", "compare"),
    "problem": ("BeamProblem", "DistributedLoad", "PointLoad", "Units"),
    "schemes": ("BDF2", "HHT", "SDIRK", "Scheme", "Theta"),
    "semidiscretisation": ("semidiscretise",),
    "solvers": ("reference",),
    "solvers.tangent": ("Growth", "lyapunov"),
    "store": ("load",),
    "system": ("FirstOrderSystem", "System"),
    "time_functions": ("Constant", "Harmonic", "TimeFunction"),
    "trajectory": ("Diverged", "Impacts", "Reference", "SolverFailure", "Trajectory"),
    "validation": ("InputError",),
}
_MODULE = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "BDF2",
    "HHT",
    "SDIRK",
    "BeamProblem",
    "Case",
    "Comparison",
    "Constant",
    "Contact",
    "DistributedLoad",
    "Diverged",
    "FirstOrderSystem",
    "Growth",
    "Harmonic",
    "Impacts",
    "InputError",
    "PointLoad",
    "Reference",
    "Scheme",
    "SolverFailure",
    "Stops",
    "System",
    "Theta",
    "TimeFunction",
    "Trajectory",
    "Units",
    "compare",
    "integrate",
    "load",
    "load_cases",
    "lyapunov",
    "paper_case",
    "reference",
    "semidiscretise",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module 'stiffbeam' has no attribute {name!r}")
    value = getattr(import_module(f".{_MODULE[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
