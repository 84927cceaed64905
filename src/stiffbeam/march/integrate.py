"""integrate: a scheme on a system. Modal blocks where the modes decouple, else the direct march."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array
from ..first_order import FirstOrderSystem
from ..ledger import Ledger, step_ledger
from ..modal import modes
from ..recorder import SampledImpacts, Seen, record
from ..schemes import Scheme
from ..schemes.contract import check_contract
from ..system import System
from ..trajectory import Diverged, Trajectory, Work, versions
from ..validation import InputError, integer, positive, step_count
from .direct_march import direct_pieces
from .layout import OVERFLOW
from .modal_march import RUNS, March, engine_for, initial_channels, warm_up
from .pieces import Piece
from .replay import modal_ledger, replay

CONTACTS = ("implicit", "extrapolated")


def integrate(
    system: System | FirstOrderSystem,
    scheme: Scheme,
    dt: float,
    t_end: float,
    contact: str = "implicit",
    every: int = 1,
    progress: Callable[[int], None] | None = None,
    engine: str = "auto",
) -> Trajectory:
    """March ``scheme`` over [0, t_end] with the fixed step ``dt``.

    contact "implicit": every stage solves v = r + s F(v), in closed form for one contact.
    "extrapolated": the force at a node is F(v*), v* predicted from known values, as in the paper;
    it can overflow. ``every`` thins the outputs only: impacts, peaks and the ledger see every step.
    ``progress`` is called with the number of steps done. engine: "numba" or "numpy", equal to rounding
    and each bit-identical to itself; "auto" is numba but for short runs while nothing is compiled yet
    (``provenance["engine"]`` says which).

    A System whose damping decouples is marched in modal coordinates by the compiled block kernel; any
    other, and a FirstOrderSystem, step by step with factorised matrices (``provenance["march"]``).
    Raises InputError for bad arguments and Diverged where the run overflows.
    """
    begun = time.perf_counter()
    if engine == "jax":
        raise InputError("engine", engine, "be numba, numpy or auto for one run", "use integrate_ensemble")
    plan = Plan.of(system, scheme, dt, t_end, contact, every, engine)
    compile_seconds = warm_up() if plan.engine == "numba" else 0.0
    if plan.modal is not None:
        flight = plan.modal.start([plan.system], plan.steps, every)
        for done in flight.fly():
            if progress is not None and not flight.state.diverged[0]:
                progress(done)
        seen, march_seconds = flight.seen(0), flight.seconds
    else:
        seen, march_seconds = _direct(plan, system, every, progress)
    if not np.isnan(seen.diverged):
        remedy = "use contact='implicit' or a smaller dt" if contact == "extrapolated" else "use a smaller dt"
        hint = f"{remedy} (omega_max dt is {plan.omega_max * dt:.3g})"
        raise Diverged(str(scheme), seen.diverged, hint)
    return Trajectory(
        t=np.arange(0, plan.steps + 1, every) * dt,
        tip=seen.tip,
        tip_velocity=seen.tip_velocity,
        contacts=seen.contacts,
        work=Work(plan.steps, time.perf_counter() - begun - compile_seconds, march_seconds),
        provenance=plan.provenance(every),
        system=plan.system,
        pieces=lambda: plan.states(system),
        ledger=lambda: plan.ledger(system, every),
        fingerprint=plan.system.fingerprint,
    )


@dataclass(frozen=True, eq=False)
class Plan:
    """A run whose arguments have been checked. ``modal``: the block march, None where modes do not decouple."""

    system: System
    scheme: Scheme
    dt: float
    steps: int
    t_end: float
    contact: str
    form: str
    omega_max: float
    engine: str
    modal: March | None

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
        if not isinstance(system, (System, FirstOrderSystem)):
            remedy = "make it with semidiscretise or from_matrices"
            raise InputError("system", type(system).__name__, "be a System", remedy)
        if not isinstance(scheme, Scheme):
            raise InputError("scheme", scheme, "be a Scheme object", "for example stiffbeam.HHT(alpha=-0.1)")
        steps = step_count(positive("dt", dt), positive("t_end", t_end))
        integer("every", every, 1)
        if contact not in CONTACTS:
            raise InputError("contact", contact, f"be one of {CONTACTS}")
        if engine not in (*RUNS, "auto"):
            raise InputError("engine", engine, f"be one of {('auto', *RUNS)}")
        if scheme.second_order_only and isinstance(system, FirstOrderSystem):
            rule = f"be of second order for {scheme}"
            raise InputError("system", "a FirstOrderSystem", rule, "pass the System itself")
        parent = system if isinstance(system, System) else system.system
        basis = modes(system) if isinstance(system, System) else None
        omega_max = float(basis.omega[-1]) if basis else _omega_max(parent)
        scheme.check(omega_max, dt)
        check_contract(scheme)
        form = parent.form if isinstance(system, System) else f"{parent.form}, first order"
        if basis is None:
            return cls(parent, scheme, dt, steps, t_end, contact, form, omega_max, "numpy", None)
        engine = engine_for(steps) if engine == "auto" else engine
        modal = March.of(parent, basis, scheme, dt, contact, engine)
        return cls(parent, scheme, dt, steps, t_end, contact, form, omega_max, engine, modal)

    def provenance(self, every: int | None) -> dict[str, Any]:
        return {
            "method": str(self.scheme),
            "form": self.form,
            "contact": self.contact,
            "dt": float(self.dt),
            "t_end": float(self.t_end),
            "every": 0 if every is None else int(every),
            "march": "direct" if self.modal is None else "modal blocks",
            "engine": self.engine,
            **versions(),
        }

    def seen(self, members: Sequence[System], every: int | None, since: int = 0) -> list[Seen]:
        """What members of the system have seen at the end, of their contacts after step ``since``; outputs
        where ``every`` is given."""
        if self.modal is None:
            return [_direct(self, member, every, None, since)[0] for member in members]
        flight = self.modal.start(members, self.steps, every, since)
        for _ in flight.fly():
            pass
        return [flight.seen(i) for i in range(len(members))]

    def states(self, system: System | FirstOrderSystem) -> Iterator[tuple[Array, Array, Array]]:
        """Times, q and q' of a run at every step, piece by piece with shared end points."""
        parent = system if isinstance(system, System) else system.system
        if self.modal is not None:
            return replay(self.modal, parent, self.steps)
        return _states(parent, direct_pieces(system, self.scheme, self.dt, self.steps, self.contact), self.dt)

    def ledger(self, system: System | FirstOrderSystem, every: int) -> Ledger:
        """The energy ledger of a run, added up at every step and kept at every ``every``-th."""
        parent = system if isinstance(system, System) else system.system
        if self.modal is not None:
            return modal_ledger(self.modal, parent, self.steps, every)
        return step_ledger(parent, self.states(system), np.arange(0, self.steps + 1, every) * self.dt)


def _direct(
    plan: Plan,
    system: System | FirstOrderSystem,
    every: int | None,
    progress: Callable[[int], None] | None,
    since: int = 0,
) -> tuple[Seen, float]:
    """The direct march piece by piece, in bounded memory; also the seconds it took."""
    parent = system if isinstance(system, System) else system.system
    u0, v0 = initial_channels(parent)
    thin = every or plan.steps + 1
    positions, velocities = np.empty((2, plan.steps // thin + 1, len(u0)))
    positions[0], velocities[0] = u0, v0
    starts = zip(parent.contacts, u0.tolist(), v0.tolist(), strict=False)
    samplers = [SampledImpacts(c.stops, plan.dt, u, v, since) for c, u, v in starts]
    seconds, diverged = 0.0, np.nan
    for piece in direct_pieces(system, plan.scheme, plan.dt, plan.steps, plan.contact):
        seconds += piece.seconds
        bad = ~np.all(np.abs(piece.positions) < OVERFLOW, axis=1)
        if np.any(bad):
            diverged = (piece.first + 1 + int(np.argmax(bad))) * plan.dt
            break
        done = piece.first + len(piece.positions)
        here = np.arange(piece.first // thin + 1, done // thin + 1)
        positions[here] = piece.positions[here * thin - piece.first - 1]
        velocities[here] = piece.velocities[here * thin - piece.first - 1]
        for i, sampler in enumerate(samplers):
            sampler.feed(piece.positions[:, i], piece.velocities[:, i])
        if progress is not None:
            progress(done)
    if every is None:
        positions, velocities = positions[:0], velocities[:0]
    tip = parent.tip_channel
    contacts = tuple(
        record(s.stops, positions[:, i], velocities[:, i], s.tally, s.events, plan.steps)
        for i, s in enumerate(samplers)
    )
    return Seen(positions[:, tip], velocities[:, tip], contacts, diverged), seconds


def _omega_max(system: System) -> float:
    import scipy.linalg

    squares = scipy.linalg.eigh(system.stiffness, system.mass, eigvals_only=True)
    return float(np.sqrt(max(0.0, squares[-1])))


def _states(system: System, pieces: Iterator[Piece], dt: float) -> Iterator[tuple[Array, Array, Array]]:
    """The run's states at every step, piece by piece with shared end points."""
    q_last, v_last = system.q0[None], system.v0[None]
    for piece in pieces:
        q, v = piece.states()
        q, v = np.concatenate([q_last, q]), np.concatenate([v_last, v])
        yield (piece.first + np.arange(len(q))) * dt, q, v
        q_last, v_last = q[-1:], v[-1:]
