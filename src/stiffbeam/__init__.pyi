"""The public names: the one list of them, which ``__init__.py`` reads too."""

from .basics.units import Units as Units
from .basics.validation import InputError as InputError
from .figures.paper import paper_figure as paper_figure
from .figures.runs import mode_shapes as mode_shapes
from .files.cases import Case as Case
from .files.cases import load_cases as load_cases
from .files.cases import paper_case as paper_case
from .files.reference_cache import cached_reference as cached_reference
from .files.store import load as load
from .march.ensemble import integrate_ensemble as integrate_ensemble
from .march.integrate import integrate as integrate
from .measures.amplification import Amplification as Amplification
from .measures.amplification import amplification as amplification
from .measures.comparison import Comparison as Comparison
from .measures.comparison import compare as compare
from .measures.errors import stays_within as stays_within
from .measures.rates import ContactRates as ContactRates
from .measures.rates import contact_rates as contact_rates
from .model.contact import Contact as Contact
from .model.contact import Stops as Stops
from .model.equations import FirstOrderSystem as FirstOrderSystem
from .model.members import EnsembleMembers as EnsembleMembers
from .model.members import perturbed_members as perturbed_members
from .model.members import varied_members as varied_members
from .model.modes import modal_damping as modal_damping
from .model.natural_modes import NaturalModes as NaturalModes
from .model.natural_modes import modes as modes
from .model.natural_modes import static_equilibrium as static_equilibrium
from .model.problem import BeamProblem as BeamProblem
from .model.problem import BeamSection as BeamSection
from .model.problem import DistributedLoad as DistributedLoad
from .model.problem import PointLoad as PointLoad
from .model.problem import PolynomialProfile as PolynomialProfile
from .model.radial import TwoPlanes as TwoPlanes
from .model.radial import two_planes as two_planes
from .model.reduction import ReducedModel as ReducedModel
from .model.reduction import reduce_model as reduce_model
from .model.sampled import Sampled as Sampled
from .model.sampled import noise as noise
from .model.sampled import random_phases as random_phases
from .model.semidiscretisation import semidiscretise as semidiscretise
from .model.system import System as System
from .model.time_functions import Constant as Constant
from .model.time_functions import Harmonic as Harmonic
from .model.time_functions import Superposition as Superposition
from .model.time_functions import TimeFunction as TimeFunction
from .model.uncertain import Uncertain as Uncertain
from .model.uncertain import uncertain_members as uncertain_members
from .references import reference as reference
from .references.ensemble import reference_ensemble as reference_ensemble
from .references.exact.continuation import Branch as Branch
from .references.exact.continuation import continuation as continuation
from .references.exact.derivative import Derivative as Derivative
from .references.exact.orbit import Orbit as Orbit
from .references.exact.orbit import periodic_orbit as periodic_orbit
from .references.exact.rigid_reference import rigid_limit as rigid_limit
from .references.horizon import PerturbationGrowth as PerturbationGrowth
from .references.horizon import lyapunov as lyapunov
from .references.jax_flow import JaxFlow as JaxFlow
from .references.jax_flow import jax_flow as jax_flow
from .references.orbit_proof import OrbitProof as OrbitProof
from .schemes import *  # noqa: F403
from .studies import study as study
from .studies.advice import Advice as Advice
from .studies.advice import advise as advise
from .studies.doubt import Doubt as Doubt
from .studies.doubt import doubt as doubt
from .testset.problem import EnclosedAnswer as EnclosedAnswer
from .testset.problem import FrozenOrbit as FrozenOrbit
from .testset.problem import Problem as Problem
from .testset.problem import frozen_orbit as frozen_orbit
from .testset.problem import frozen_orbits as frozen_orbits
from .testset.problem import problem as problem
from .testset.problem import problems as problems
from .testset.score import score as score
from .testset.scorecard import Scorecard as Scorecard
from .trajectory.ensemble import Ensemble as Ensemble
from .trajectory.records import Impacts as Impacts
from .trajectory.trajectory import (
    Diverged as Diverged,
)
from .trajectory.trajectory import (
    Reference as Reference,
)
from .trajectory.trajectory import (
    SolverFailure as SolverFailure,
)
from .trajectory.trajectory import (
    Trajectory as Trajectory,
)

__version__: str
