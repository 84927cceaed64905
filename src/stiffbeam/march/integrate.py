"""integrate: check the arguments, choose the march, return the run as a trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ..basics.arrays import Array
from ..basics.resources import afford, clock, silent
from ..basics.units import KNOWN
from ..basics.validation import InputError, function, integer, itself, one_of, positive, step_count
from ..model.contact import Contact
from ..model.equations import FirstOrderSystem
from ..model.members import EnsembleMembers
from ..model.modes import modes
from ..model.system import System
from ..model.time_functions import covered
from ..schemes import RigidScheme, Scheme
from ..schemes.labels import label_of_run
from ..schemes.scheme import check_contract, require_scheme
from ..trajectory.ensemble import Runs
from ..trajectory.recorder import Reactions, SampledImpacts, overflow, record
from ..trajectory.records import Ledger, step_ledger
from ..trajectory.trajectory import Diverged, Trajectory, Work, versions
from .block_march import RUNS, Stepper, initial_channels
from .choice import CONTACTS, is_rigid, pays, require_rigid, rule_of, scheme_for
from .direct_march import Piece, direct_pieces
from .kernels.blocks import OVERFLOW
from .probe import InModes, Together
from .replay import block_ledger, replay
from .rigid_march import rigid_pieces

DIRECT, RIGID = "direct", "rigid steps"


@dataclass(frozen=True, eq=False)
class Plan:
    """A run whose arguments have been checked. ``stepper``: of the march in blocks, None if blocks do not pay or the
    stops are rigid. ``rigid``: True for rigid stops.

    A pickled one is made again from ``given``, the System or FirstOrderSystem, and its other arguments.
    """

    given: System | FirstOrderSystem
    system: System
    scheme: Scheme
    dt: float
    steps: int
    t_end: float
    contact: str
    form: str
    omega_max: float
    engine: str
    stepper: Stepper | None
    rigid: bool = False
    _steppers: dict[int, Stepper] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        system: System | FirstOrderSystem,
        scheme: Scheme,
        dt: float,
        t_end: float,
        contact: str,
        every: int,
        engine: str,
    ) -> Plan:
        """Raises InputError for bad arguments."""
        # Every argument by itself, then in combination.
        kind = FirstOrderSystem if isinstance(system, FirstOrderSystem) else System
        itself("system", system, kind, "make it with semidiscretise or from_matrices")
        require_scheme(scheme)
        dt, t_end = positive("dt", dt), positive("t_end", t_end)
        steps = step_count(dt, t_end)
        # X1
        if not 1e-150 <= dt <= 1e150:
            raise InputError("dt", dt, "have a square in float64", "count time in another unit")
        integer("every", every, 1)
        one_of("contact", contact, CONTACTS)
        scheme = scheme_for(scheme, contact)
        one_of("engine", engine, (*RUNS, DIRECT), f"be {', '.join(RUNS)} or {DIRECT}")
        if scheme.second_order_only and isinstance(system, FirstOrderSystem):
            rule = f"be of second order for {scheme}"
            raise InputError("system", "a FirstOrderSystem", rule, "pass the System itself")
        if isinstance(system, FirstOrderSystem) and not system.is_of_its_system():
            remedy = "change the System and call first_order() of that"
            raise InputError(
                "system", "a FirstOrderSystem that is not its system's", "be what first_order() made", remedy
            )
        parent = system if isinstance(system, System) else system.system
        covered(parent.time_functions, t_end)
        # None where the damping couples the modes, and for a FirstOrderSystem: all unknowns then step together.
        basis = modes(system) if isinstance(system, System) else None
        # For the check of the time step, and for the message of a run that overflows.
        omega_max = float(basis.omega[-1]) if basis else _omega_max(parent)
        scheme.check(omega_max, dt)
        check_contract(scheme)
        # Rigid stops take another march. For compliant ones the contact laws must fit the treatment of contact.
        rigid = is_rigid(parent, scheme)
        if rigid:
            require_rigid(parent, scheme, contact)
        else:
            rule_of(parent.contacts, contact)
        form = parent.form if isinstance(system, System) else f"{parent.form}, first order"
        if rigid:
            if isinstance(system, FirstOrderSystem):
                raise InputError(
                    "system", "a FirstOrderSystem", "be of second order for rigid stops", "pass the System"
                )
            if engine != "numba":
                raise InputError("engine", engine, "be numba for rigid stops", "leave engine out")
            return cls(system, parent, scheme, dt, steps, t_end, contact, form, omega_max, engine, None, True)
        turns = any(each.radial for each in parent.contacts)
        coordinates = Together.of(system) if basis is None or turns else InModes(parent, basis)
        # Single steps where the user asks for them, where forces turn, or where blocks with their set-up take longer.
        if engine == DIRECT or turns or not pays(coordinates, scheme, steps):
            return cls(system, parent, scheme, dt, steps, t_end, contact, form, omega_max, DIRECT, None)
        stepper = Stepper.of(coordinates, scheme, dt, contact, engine)
        return cls(system, parent, scheme, dt, steps, t_end, contact, form, omega_max, engine, stepper)

    def afford(self, members: int, every: int | None) -> None:
        """Raise InputError for outputs that exceed the memory and for runs that take too long."""
        contacts = len(self.system.contacts)
        kept = 0 if every is None else self.steps // every + 1
        remedy = "give a larger `every`" if every is not None else "take fewer members"
        # For every output: position and velocity of each channel, the force of each contact, the time.
        floats = float(members) * (kept * (2.0 * len(self.system.channels) + contacts + 1.0) + 100.0)
        afford("every", every, remedy, floats=floats)
        seconds = self.step_seconds * self.steps * members
        afford("dt", self.dt, "give a larger dt, or fewer members", seconds=seconds)

    @property
    def step_seconds(self) -> float:
        """Rough time of a step of one member on one core."""
        return 2e-5 + 3e-9 * self.system.size**2 if self.stepper is None else self.stepper.step_seconds

    def stepper_for(self, contacts: Sequence[Contact]) -> Stepper:
        """The block march for the contacts of a member. Their law may be of another kind than that of the system."""
        assert self.stepper is not None
        rule = rule_of(contacts, self.contact)
        # Kept by rule: nodes of linear stops and of other laws read different entries of a block.
        if rule not in self._steppers:
            own = self.stepper
            made = own if rule == own.rule else Stepper.of(
                own.coordinates, self.scheme, self.dt, self.contact, self.engine, rule
            )  # fmt: skip
            self._steppers[rule] = made
        return self._steppers[rule]

    def __reduce__(self) -> tuple[Any, ...]:
        # The 1 stands for ``every``, which is checked and not stored.
        return Plan.of, (self.given, self.scheme, self.dt, self.t_end, self.contact, 1, self.engine)

    def provenance(self, every: int | None) -> dict[str, Any]:
        """Provenance of the run."""
        units = self.system.units
        return {
            "method": label_of_run(self.scheme),
            "form": self.form,
            "units": {name: getattr(units, name) for name in KNOWN},
            "contact": self.contact,
            "dt": float(self.dt),
            "t_end": float(self.t_end),
            "every": 0 if every is None else int(every),
            "march": self.kind,
            "engine": "numpy" if self.engine == DIRECT else self.engine,
            **versions(),
        }

    @property
    def kind(self) -> str:
        """Name of the march in ``provenance["march"]``."""
        return (RIGID if self.rigid else DIRECT) if self.stepper is None else self.stepper.kind

    def pieces(self, system: System | FirstOrderSystem) -> Iterator[Piece]:
        """The run in pieces, if it is not computed in blocks."""
        if self.rigid and isinstance(system, System):  # it may be a member with stops of its own
            if not is_rigid(system, self.scheme):
                raise InputError("members", "compliant stops", "have rigid ones where one has", "integrate them apart")
            require_rigid(system, self.scheme, self.contact)
            return rigid_pieces(system, self.scheme, self.dt, self.steps)
        return direct_pieces(system, self.scheme, self.dt, self.steps, self.contact)

    def runs(self, members: EnsembleMembers, every: int | None, since: int = 0) -> Runs:
        """Runs of the members, with contacts after step ``since``, and with outputs if ``every`` is given."""
        if self.stepper is None:
            return Runs.of([seen_directly(self, member, every, None, since) for member in members])
        contacts = members.all_contacts()
        # By identity: members that share their contacts need one look-up.
        steppers = {key: self.stepper_for(each) for key, each in {id(each): each for each in contacts}.items()}
        kinds = [steppers[id(each)] for each in contacts]
        parts, places = [], []
        # Members of one rule march together; ``places`` restores the order of the members.
        for stepper in dict.fromkeys(kinds):
            places_of_kind = [i for i, kind in enumerate(kinds) if kind is stepper]
            march = stepper.start(members.subset(places_of_kind), self.steps, every, since)
            for _ in march.advance():
                pass
            parts.append(march.runs())
            places += places_of_kind
        return Runs.joined(parts, places)

    def states(self, system: System | FirstOrderSystem) -> Iterator[tuple[Array, Array, Array, Array]]:
        """See ``Pieces``."""
        parent = system if isinstance(system, System) else system.system
        if self.stepper is not None:
            return replay(self.stepper_for(parent.contacts), parent, self.steps)
        if self.rigid:
            reactions = self._with_reactions(parent)
            return ((t, q, v, np.concatenate([np.full_like(R[:1], np.nan), R])) for t, q, v, R in reactions)
        return _states(parent, self.pieces(system), self.dt)

    def ledger(self, system: System | FirstOrderSystem, every: int) -> Ledger:
        """The energy ledger of a run, added up at every step and kept at every ``every``-th."""
        parent = system if isinstance(system, System) else system.system
        if self.stepper is not None:
            return block_ledger(self.stepper_for(parent.contacts), parent, self.steps, every)
        outputs = np.arange(0, self.steps + 1, every) * self.dt
        if self.rigid:
            impacts = isinstance(self.scheme, RigidScheme) and self.scheme.restitutes
            return step_ledger(parent, self._with_reactions(parent), outputs, impacts)
        return step_ledger(parent, self.states(system), outputs)

    def _with_reactions(self, system: System) -> Iterator[tuple[Array, Array, Array, Array]]:
        means: list[Array] = []

        def noted() -> Iterator[Piece]:
            for piece in self.pieces(system):
                means.append(piece.means if piece.means is not None else np.zeros((0, 0)))
                yield piece

        # ``_states`` yields once a piece and passes on states only: the list holds the means of that piece.
        for t, q, v, _ in _states(system, noted(), self.dt):
            yield t, q, v, means.pop()


def seen_directly(
    plan: Plan,
    system: System | FirstOrderSystem,
    every: int | None,
    progress: Callable[[int], None] | None,
    since: int = 0,
) -> Trajectory:
    """The direct march piece by piece, in bounded memory."""
    parent = system if isinstance(system, System) else system.system
    (u0,), (v0,) = initial_channels([parent], parent.q0[None], parent.v0[None])
    # Without outputs the interval is longer than the run, so that only the start has a row.
    thin = every or plan.steps + 1
    positions, velocities = np.empty((2, plan.steps // thin + 1, len(u0)))
    positions[0], velocities[0] = u0, v0
    node_forces = np.full((len(positions), len(parent.contacts)), np.nan)
    starts = zip(parent.contacts, u0.tolist(), v0.tolist(), strict=False)
    sampler_of = Reactions if plan.rigid else SampledImpacts
    samplers = [sampler_of(c.stops, plan.dt, u, v, since) for c, u, v in starts]
    seconds, diverged = 0.0, np.nan
    for piece in plan.pieces(system):
        seconds += piece.seconds
        # The first step beyond the bound ends the run.
        bad = ~np.all(np.abs(piece.positions) < OVERFLOW, axis=1)
        if np.any(bad):
            diverged = (piece.first + 1 + int(np.argmax(bad))) * plan.dt
            break
        done = piece.first + len(piece.positions)
        # Outputs of this piece: the multiples of ``thin`` among its steps first + 1 to done.
        here = np.arange(piece.first // thin + 1, done // thin + 1)
        positions[here] = piece.positions[here * thin - piece.first - 1]
        velocities[here] = piece.velocities[here * thin - piece.first - 1]
        if piece.node_forces is not None:
            node_forces[here] = piece.node_forces[here * thin - piece.first - 1]
        # Impacts and peaks are taken from every step, output or not.
        for i, sampler in enumerate(samplers):
            own = (None if x is None else x[:, i] for x in (piece.means, piece.node_forces))
            sampler.feed(piece.positions[:, i], piece.velocities[:, i], *own)
        if progress is not None:
            progress(done)
    if every is None:
        positions, velocities, node_forces = positions[:0], velocities[:0], node_forces[:0]
    tip = parent.tip_channel
    contacts = tuple(
        s.record(positions[:, i], velocities[:, i], thin) if isinstance(s, Reactions)
        else record(s.stops, positions[:, i], velocities[:, i], s.tally, s.events, plan.steps, node_forces[:, i])
        for i, s in enumerate(samplers)
    )  # fmt: skip
    # A force may overflow although every position stays below the bound.
    diverged = overflow(contacts, plan.t_end) if np.isnan(diverged) else diverged
    return Trajectory(
        t=np.arange(0.0, len(positions) * thin, thin) * plan.dt,
        tip=positions[:, tip],
        tip_velocity=velocities[:, tip],
        contacts=contacts,
        work=Work(plan.steps, march_seconds=seconds),
        provenance={"march": plan.kind},
        diverged=diverged,
    )


def _omega_max(system: System) -> float:
    import scipy.linalg

    squares = scipy.linalg.eigh(system.stiffness, system.mass, eigvals_only=True)
    return float(np.sqrt(max(0.0, squares[-1])))


def _states(system: System, pieces: Iterator[Piece], dt: float) -> Iterator[tuple[Array, Array, Array, Array]]:
    """See ``Pieces``."""
    none = np.full((1, len(system.contacts)), np.nan)
    last = system.q0[None], system.v0[None], none
    for piece in pieces:
        q, v = piece.states()
        new = q, v, np.repeat(none, len(q), axis=0) if piece.node_forces is None else piece.node_forces
        # Pieces share end points: each begins with the last state of the one before.
        q, v, node_forces = (np.concatenate(both) for both in zip(last, new, strict=True))
        yield (piece.first + np.arange(len(q))) * dt, q, v, node_forces
        last = q[-1:], v[-1:], node_forces[-1:]


def integrate(
    system: System | FirstOrderSystem,
    scheme: Scheme,
    dt: float,
    t_end: float,
    contact: str = "implicit",
    every: int = 1,
    progress: Callable[[int], None] | None = None,
    engine: str = "numba",
) -> Trajectory:
    """Return the run of a fixed-step scheme over [0, t_end].

    Parameters
    ----------
    system : System or FirstOrderSystem
        The system to integrate; rigid stops need a scheme with an impact law, such as ``MoreauJean``.
    scheme : Scheme
        For example ``HHT(alpha=-0.1)``, ``BDF2()``, ``SDIRK()``.
    dt : float
        The time step, which must divide t_end.
    t_end : float
        End of the run, in the system's unit of time.
    contact : {"implicit", "extrapolated", "conserving", "averaged"}
        "implicit": every stage solves v = r + s F(v, v'), in closed form for one contact and the linear law.
        "extrapolated": the force at a node is F(v*), v* predicted from known values, as in the paper; it can overflow,
        and takes no damped stops. "conserving": the mean force over the step that keeps the sum of kinetic, elastic and
        stop energy (see ``stage``), for schemes that conserve energy without contact; impulses are then
        those of the mean forces. "averaged": the force averaged over a step around the node, for schemes with one force
        in a step; derivatives of the run in parameters and initial data then have order 2, as the run itself.
    every : int
        Keep every so many steps as output. Impacts, peaks and the energy ledger see every step.
    progress : callable, optional
        Called with the number of steps done.
    engine : {"numba", "direct"}
        "numba": blocks compiled once for each version and kept on disk. "direct": step by step in NumPy, a hundred
        times slower. They are equal to rounding, and each is bit-identical to itself whatever ran before.

    Returns
    -------
    Trajectory
        ``provenance["march"]`` names the march: "modal blocks" where the damping decouples, "dense blocks" of all
        unknowns together for other damping and for a FirstOrderSystem, "direct" with factorised matrices where a run is
        too short or too large for these. They are equal to rounding and do not depend on ``every``.

    Raises
    ------
    InputError
        For bad arguments.
    Diverged
        If the run overflows.
    SolverFailure
        If the forces of several contacts at once are not found.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> run = sb.integrate(system, sb.HHT(alpha=-0.1), dt=1e-4, t_end=1.0)
    >>> run.t.shape, run.contacts[0].impacts.count > 100
    ((10001,), True)
    """
    begun = clock()
    function("progress", silent if progress is None else progress)
    plan = Plan.of(system, scheme, dt, t_end, contact, every, engine)
    plan.afford(1, every)
    if plan.stepper is not None:
        march = plan.stepper.start([plan.system], plan.steps, every)
        for done in march.advance():
            if progress is not None and not march.state.diverged[0]:
                progress(done)
        run = march.seen(0)
    else:
        run = seen_directly(plan, system, every, progress)
    if not np.isnan(run.diverged):
        remedy = "use the implicit contact or a smaller dt" if contact == "extrapolated" else "use a smaller dt"
        hint = f"{remedy} (omega_max dt is {plan.omega_max * dt:.3g})"
        raise Diverged(str(scheme), run.diverged, hint)
    # States and energy are computed on demand, in a second march.
    return replace(
        run,
        work=replace(run.work, seconds=clock() - begun),
        provenance=plan.provenance(every) | run.provenance,
        system=plan.system,
        pieces=partial(plan.states, system),
        ledger=partial(plan.ledger, system, every),
    )
