"""integrate and integrate_ensemble: check the arguments, choose the march, return the runs of one or many members."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Sequence
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from ..basics.arrays import Array, Recent
from ..basics.resources import afford, clock, current, over, working
from ..basics.validation import InputError, integer, one_of, positive, step_count
from ..model.members import EnsembleMembers, as_members, march_apart
from ..model.modes import decoupled_modes, undamped_modes
from ..model.system import System, require_system
from ..schemes import RigidScheme, Scheme
from ..schemes.labels import label_of_run
from ..schemes.scheme import check_contract, is_known, require_scheme
from ..trajectory.ensemble import Ensemble, record_from, slim
from ..trajectory.records import Ledger
from ..trajectory.trajectory import Diverged, Trajectory, Work, versions
from .block_march import Stepper, block_length
from .propagator import Coordinates
from .rigid_march import RigidStepper
from .treatment import TREATMENTS

LARGEST = 256  # unknowns of a system that is kept alive by its recent plans


class Plan:
    """A run whose arguments have been checked: InputError for bad ones. A pickled one is made again from them."""

    def __init__(self, system: System, scheme: Scheme, dt: float, t_end: float, contact: str) -> None:
        # Every argument by itself, then in combination.
        self.system, self.given = require_system(system), require_scheme(scheme)
        self.dt, self.t_end = positive("dt", dt), positive("t_end", t_end)
        self.steps = step_count(self.dt, self.t_end)
        if not 1e-150 <= self.dt <= 1e150:
            raise InputError("dt", dt, "have a square in float64", "count time in another unit")
        self.treatment = TREATMENTS[one_of("contact", contact, TREATMENTS)]
        self.rule = self.treatment.rule(system, self.given)  # of the contacts of ``system``
        if (form := self.treatment.form_of(self.given)) is None:
            rule = f"conserve the energy of the linear system for the conserving contact, as {scheme} does not"
            raise InputError("scheme", str(scheme), rule, "use Trapezoidal or ExponentialFlow")
        self.scheme = form
        system.drive.require_samples(self.t_end)
        if not is_known(self.given):
            check_contract(self.scheme)
        # The modes, or where the damping couples them all unknowns, which then step together.
        coordinates = Coordinates(system, decoupled_modes(system))
        if isinstance(self.scheme, RigidScheme):
            self.stepper = RigidStepper(coordinates, self.scheme, self.dt)
        else:
            length = block_length(coordinates, self.scheme, self.steps)
            self.stepper = Stepper(coordinates, self.scheme, self.dt, self.treatment, length, self.rule)

    @classmethod
    def recent(cls, system: System, scheme: Scheme, dt: float, t_end: float, contact: str) -> Plan:
        """The plan, where one of these very objects may have been made lately."""
        # Of the package's schemes alone, which their numbers define; a system cannot change.
        if not isinstance(system, System) or system.size > LARGEST or not is_known(scheme):
            return cls(system, scheme, dt, t_end, contact)
        numbers = positive("dt", dt), positive("t_end", t_end), one_of("contact", contact, TREATMENTS)
        key = system, type(scheme), pickle.dumps(vars(scheme)), *numbers
        return _RECENT.get(key, lambda: cls(system, scheme, *numbers))

    def afford(self, members: int, every: int | None) -> None:
        """Raise InputError for outputs that exceed the memory."""
        contacts = len(self.system.contacts)
        kept = 0 if every is None else self.steps // every + 1
        remedy = "give a larger `every`" if every is not None else "take fewer members"
        # For every output: position and velocity of each channel, the force of each contact, the time.
        floats = float(members) * (kept * (2.0 * len(self.system.channels) + contacts + 1.0) + 100.0)
        afford("every", every, remedy, floats=floats)

    def of(self, member: System, apart: bool) -> Plan:
        """The plan of a member: its own where members march ``apart``, or where its law is of another kind."""
        if not apart and (member is self.system or self.treatment.rule(member, self.scheme) == self.rule):
            return self
        return Plan(member, self.given, self.dt, self.t_end, self.treatment.name)

    def __reduce__(self) -> tuple[Any, ...]:
        return Plan, (self.system, self.given, self.dt, self.t_end, self.treatment.name)

    def provenance(self, every: int | None) -> dict[str, Any]:
        """Provenance of the run."""
        return {
            "method": label_of_run(self.given),
            "form": self.system.form,
            "units": list(self.system.units),
            "contact": self.treatment.name,
            "dt": float(self.dt),
            "t_end": float(self.t_end),
            "every": 0 if every is None else int(every),
            "march": self.stepper.kind,
            **versions(),
        }

    def run(self, system: System, every: int | None, since: int = 0, begun: float | None = None) -> Trajectory:
        """The run of the system, or of a member, with contacts recorded after step ``since``; begun: when its seconds
        begin, by default now."""
        started = clock()
        fields = self.stepper.run(system, self.steps, every, since)
        ended = clock()
        # States and energy are computed on demand, in a second march.
        return Trajectory(
            **fields,
            work=Work(self.steps, ended - (started if begun is None else begun), ended - started),
            provenance=self.provenance(every),
            system=system,
            pieces=partial(self.states, system),
            ledger=partial(self.ledger, system, every or self.steps),
        )

    def run_of(self, member: System, apart: bool, every: int | None, since: int) -> Trajectory:
        """The run of a member, without the motion of its contacts."""
        return slim(self.of(member, apart).run(member, every, since))

    def states(self, system: System) -> Iterator[tuple[Array, Array, Array, Array]]:
        """See ``Pieces``; of the plan, which can be sent to another process."""
        return self.stepper.states(system, self.steps)

    @working("adding up the energy balance")
    def ledger(self, system: System, every: int) -> Ledger:
        """The energy ledger of a run, added up at every step and kept at every ``every``-th."""
        return self.stepper.ledger(system, self.steps, np.arange(0, self.steps + 1, every) * self.dt)


_RECENT: Recent[Plan] = Recent(8)


@working("integrating")
def integrate(
    system: System,
    scheme: Scheme,
    dt: float,
    t_end: float,
    contact: str = "implicit",
    every: int = 1,
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
        stop energy (see ``Treatment``), for schemes that conserve energy without contact; impulses are of mean forces.
    every : int
        Keep every so many steps as output. Impacts, peaks and the energy ledger see every step.

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
    plan = Plan.recent(system, scheme, dt, t_end, contact)
    plan.afford(1, integer("every", every, 1))
    run = plan.run(system, every, begun=begun)
    if not np.isnan(run.diverged):
        remedy = "use the implicit contact or a smaller dt" if contact == "extrapolated" else "use a smaller dt"
        hint = f"{remedy} (omega_max dt is {undamped_modes(system).omega[-1] * dt:.3g})"
        raise Diverged(str(scheme), run.diverged, hint)
    return run


@working("integrating an ensemble")
def integrate_ensemble(
    system: System,
    scheme: Scheme,
    dt: float,
    t_end: float,
    members: EnsembleMembers | Sequence[System],
    contact: str = "implicit",
    every: int | None = None,
    since: float = 0.0,
) -> Ensemble:
    """Return the runs of all members of an ensemble, on all cores; each equals its single run to rounding.

    ``joblib.parallel_config`` has processes compute the members, on this machine or on others.

    Parameters
    ----------
    system : System
    scheme : Scheme
    dt, t_end : float
    members : EnsembleMembers or sequence of System
        From ``perturbed_members`` or ``varied_members``, or systems with as many unknowns and contacts. Members with
        records (Sampled) or matrices of their own are set up one by one.
    contact : {"implicit", "extrapolated", "conserving"}
        As in ``integrate``.
    every : int, optional
        Keep tip and tip velocity every so many steps. None keeps none; memory then grows with the impacts only.
    since : float
        Contacts are recorded after this time, a whole number of steps. A contact that is there then is no impact.
        Impulses are the sum of dt F over the steps after it, without half weights at the ends.

    Returns
    -------
    Ensemble
        A member that overflows is marked in ``diverged``; the others go on.

    Raises
    ------
    InputError
        For bad arguments.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> system = sb.paper_case(10).system()
    >>> many = sb.integrate_ensemble(system, sb.HHT(alpha=-0.1), 1e-4, 0.5, sb.perturbed_members(system, 16))
    >>> many.contacts[0].impact_count.shape
    (16,)
    """
    begun = perf_counter()
    members = as_members(system, members)
    plan = Plan(system, scheme, dt, t_end, contact)
    plan.afford(len(members), every if every is None else integer("every", every, 1))
    # Members with records, or with other matrices, share no propagator and are set up one by one.
    apart, show = march_apart(members), current()
    passed = round(record_from(since, plan.t_end) / plan.dt)
    if abs(passed * plan.dt - since) > 1e-9 * plan.t_end:
        remedy = f"for example {plan.dt * int(since / plan.dt):.12g}"
        raise InputError("since", since, f"be a whole number of steps dt = {plan.dt:g}", remedy)
    march = partial(plan.run_of, apart=apart, every=every, since=passed)
    report = lambda done: show(f"{scheme}: members", done, len(members))  # noqa: E731
    runs = list(over(march, members, report))
    seconds = perf_counter() - begun
    return Ensemble.of(
        runs,
        members=members,
        t=np.arange(0, plan.steps + 1, every) * plan.dt if every is not None else np.zeros(0),
        work=Work(len(members) * plan.steps, seconds, seconds),
        provenance=plan.provenance(every) | {"members": len(members), "varied": list(members.parameters)},
        ledger=partial(_ledger, plan, members, every or plan.steps, apart),
    )


def _ledger(plan: Plan, members: EnsembleMembers, every: int, apart: bool, i: int) -> Ledger:
    return plan.of(members[i], apart).ledger(members[i], every)
