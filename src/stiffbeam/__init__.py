"""stiffbeam: fixed-step schemes beside adaptive and exact solutions of vibro-impact systems."""

from __future__ import annotations

from .contact import Contact, Stops
from .march import integrate
from .problem import BeamProblem, DistributedLoad, PointLoad, Units
from .schemes import BDF2, HHT, SDIRK, Scheme, Theta
from .semidiscretisation import semidiscretise
from .system import FirstOrderSystem, System
from .time_functions import Constant, Harmonic, TimeFunction
from .trajectory import Diverged, Impacts, Reference, SolverFailure, Trajectory
from .validation import InputError
