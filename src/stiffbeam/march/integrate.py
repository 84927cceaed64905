"""integrate: check the arguments, choose the march, return the run as a trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg

from ..basics.arrays import Array
from ..basics.progress import silent, working
from ..basics.resources import afford, clock
from ..basics.validation import InputError, function, integer, one_of, positive, step_count
from ..model.contact import Contact
from ..model.members import EnsembleMembers
from ..model.modes import modes
from ..model.system import System, require_system
from ..model.time_functions import covered
from ..schemes import Scheme
from ..schemes.labels import label_of_run
from ..schemes.scheme import check_contract, require_scheme
from ..trajectory.ensemble import Runs
from ..trajectory.records import Ledger
from ..trajectory.trajectory import Diverged, Trajectory, versions
from .block_march import Stepper, block_length
from .probe import InModes, Together
from .replay import block_ledger, replay
from .rigid_march import RIGID, is_rigid, require_rigid, rigid_ledger, rigid_run, rigid_states
from .treatment import TREATMENTS, Treatment


@dataclass(frozen=True, eq=False)
class Plan:
    """A run whose arguments have been checked. ``stepper``: of the march in blocks, None for rigid stops.

    A pickled one is made again from its arguments.
    """

    system: System
    scheme: Scheme
    dt: float
    steps: int
    t_end: float
    treatment: Treatment
    omega_max: float
    stepper: Stepper | None
    _steppers: dict[int, Stepper] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, system: System, scheme: Scheme, dt: float, t_end: float, contact: str, every: int) -> Plan:
        """Raises InputError for bad arguments."""
        # Every argument by itself, then in combination.
        require_system(system)
        require_scheme(scheme)
        dt, t_end = positive("dt", dt), positive("t_end", t_end)
        steps = step_count(dt, t_end)
        if not 1e-150 <= dt <= 1e150:
            raise InputError("dt", dt, "have a square in float64", "count time in another unit")
        integer("every", every, 1)
        treatment = TREATMENTS[one_of("contact", contact, TREATMENTS)]
        scheme = treatment.form_of(scheme)
        covered(system.time_functions, t_end)
        # None where the damping couples the modes: all unknowns then step together.
        basis = modes(system)
        # For the check of the time step, and for the message of a run that overflows.
        omega_max = float(basis.omega[-1]) if basis else _omega_max(system)
        scheme.check(omega_max, dt)
        check_contract(scheme)
        if is_rigid(system, scheme):
            require_rigid(system, scheme, treatment)
            return cls(system, scheme, dt, steps, t_end, treatment, omega_max, None)
        rule = treatment.rule(system.contacts, system.gyroscopic)
        coordinates = Together(system) if basis is None else InModes(system, basis)
        length = block_length(coordinates, scheme, steps)
        stepper = Stepper.of(coordinates, scheme, dt, treatment, length, rule)
        return cls(system, scheme, dt, steps, t_end, treatment, omega_max, stepper)

    def afford(self, members: int, every: int | None) -> None:
        """Raise InputError for outputs that exceed the memory."""
        contacts = len(self.system.contacts)
        kept = 0 if every is None else self.steps // every + 1
        remedy = "give a larger `every`" if every is not None else "take fewer members"
        # For every output: position and velocity of each channel, the force of each contact, the time.
        floats = float(members) * (kept * (2.0 * len(self.system.channels) + contacts + 1.0) + 100.0)
        afford("every", every, remedy, floats=floats)

    def stepper_for(self, contacts: Sequence[Contact]) -> Stepper:
        """The block march for the contacts of a member. Their law may be of another kind than that of the system."""
        assert self.stepper is not None
        rule = self.treatment.rule(contacts, self.system.gyroscopic)
        # Kept by rule: nodes of linear stops and of other laws read different entries of a block.
        if rule not in self._steppers:
            own = self.stepper
            self._steppers[rule] = own if rule == own.rule else Stepper.of(
                own.coordinates, self.scheme, self.dt, self.treatment, own.block.steps, rule
            )  # fmt: skip
        return self._steppers[rule]

    def __reduce__(self) -> tuple[Any, ...]:
        # The 1 stands for ``every``, which is checked and not stored.
        return Plan.of, (self.system, self.scheme, self.dt, self.t_end, self.treatment.name, 1)

    def provenance(self, every: int | None) -> dict[str, Any]:
        """Provenance of the run."""
        return {
            "method": label_of_run(self.scheme),
            "form": self.system.form,
            "units": list(self.system.units),
            "contact": self.treatment.name,
            "dt": float(self.dt),
            "t_end": float(self.t_end),
            "every": 0 if every is None else int(every),
            "march": RIGID if self.stepper is None else self.stepper.kind,
            **versions(),
        }

    def run(
        self, system: System, every: int | None, progress: Callable[[int], None] | None, since: int = 0
    ) -> Trajectory:
        """The run of the system, or of a member, with contacts recorded after step ``since``."""
        if self.stepper is None:
            return rigid_run(system, self.scheme, self.dt, self.steps, every, progress, since)
        march = self.stepper_for(system.contacts).start([system], self.steps, every, since)
        for done in march.advance():
            if progress is not None and not march.state.diverged[0]:
                progress(done)
        return march.seen(0)

    def runs(self, members: EnsembleMembers, every: int | None, since: int = 0) -> Runs:
        """Runs of the members, with contacts after step ``since``, and with outputs if ``every`` is given."""
        if self.stepper is None:
            for member in members:
                if not is_rigid(member, self.scheme):
                    raise InputError(
                        "members", "compliant stops", "have rigid ones where one has", "integrate them apart"
                    )
                require_rigid(member, self.scheme, self.treatment)
            return Runs.of([self.run(member, every, None, since) for member in members])
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

    def states(self, system: System) -> Iterator[tuple[Array, Array, Array, Array]]:
        """See ``Pieces``."""
        if self.stepper is None:
            return rigid_states(system, self.scheme, self.dt, self.steps)
        return replay(self.stepper_for(system.contacts), system, self.steps)

    def ledger(self, system: System, every: int) -> Ledger:
        """The energy ledger of a run, added up at every step and kept at every ``every``-th."""
        if self.stepper is None:
            return rigid_ledger(system, self.scheme, self.dt, self.steps, every)
        return block_ledger(self.stepper_for(system.contacts), system, self.steps, every)


def _omega_max(system: System) -> float:
    squares = scipy.linalg.eigh(system.stiffness, system.mass, eigvals_only=True)
    return float(np.sqrt(max(0.0, squares[-1])))


@working("integrating")
def integrate(
    system: System,
    scheme: Scheme,
    dt: float,
    t_end: float,
    contact: str = "implicit",
    every: int = 1,
    progress: Callable[[int], None] | None = None,
) -> Trajectory:
    """Return the run of a fixed-step scheme over [0, t_end].

    Parameters
    ----------
    system : System
        The system to integrate; rigid stops need a scheme with an impact law, such as ``MoreauJean``.
    scheme : Scheme
        For example ``HHT(alpha=-0.1)``, ``BDF2()``, ``SDIRK()``.
    dt : float
        The time step, which must divide t_end.
    t_end : float
        End of the run, in the system's unit of time.
    contact : {"implicit", "extrapolated", "conserving"}
        "implicit": every stage solves v = r + s F(v, v'), in closed form for one contact and the linear law.
        "extrapolated": the force at a node is F(v*), v* predicted from known values, as in the paper; it can overflow,
        and takes no damped stops. "conserving": the mean force over the step that keeps the sum of kinetic, elastic and
        stop energy (see ``stage``), for schemes that conserve energy without contact; impulses are then
        those of the mean forces.
    every : int
        Keep every so many steps as output. Impacts, peaks and the energy ledger see every step.
    progress : callable, optional
        Called with the number of steps done.

    Returns
    -------
    Trajectory
        ``provenance["march"]`` names the march: "modal blocks" where the damping decouples, "dense blocks" of all
        unknowns together for other damping, "rigid steps" for rigid stops. It does not depend on ``every``.

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
    plan = Plan.of(system, scheme, dt, t_end, contact, every)
    plan.afford(1, every)
    run = plan.run(system, every, progress)
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
