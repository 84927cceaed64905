"""integrate: a scheme on a system. Modal blocks where the modes decouple, else the direct march."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..basics.compiled import clock
from ..basics.validation import InputError
from ..model.first_order import FirstOrderSystem
from ..model.system import System
from ..schemes import Scheme
from ..trajectory.trajectory import Diverged, Trajectory
from .leap import start
from .plan import Plan, seen_directly
from .warm import wait


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
    """March ``scheme`` over [0, t_end] with the fixed step ``dt``.

    contact "implicit": every stage solves v = r + s F(v, v'), in closed form for one contact and the linear law.
    "extrapolated": the force at a node is F(v*), v* predicted from known values, as in the paper;
    it can overflow, and takes no damped stops. "conserving": the mean force over the step that keeps the sum of
    kinetic, elastic and stop energy (see discrete_gradient), for schemes that conserve energy without contact;
    impulses are then those of the mean forces. ``every`` thins the outputs only: impacts, peaks and the ledger
    see every step. ``progress`` is called with the number of steps done. engine: "numba", compiled once for each
    version and kept on disk, or "numpy", a hundred times slower; equal to rounding, and each bit-identical to
    itself whatever ran before. ``provenance["engine"]`` says which.

    A System whose damping decouples is marched in modal coordinates: in compiled blocks, or where a run is
    long and changes contact seldom in leaps from one change to the next, equal to rounding. Any other, and a
    FirstOrderSystem, in compiled blocks of all unknowns together, or where a run is too short or too large for these
    (see march.choice) step by step with factorised matrices. ``provenance["march"]``: "modal blocks", "modal leaps",
    "dense blocks" or "direct"; which does not depend on ``every``. Raises InputError for bad arguments, Diverged
    where the run overflows, and SolverFailure where the forces of several contacts at once are not found.
    """
    begun = clock()
    if isinstance(engine, str) and engine == "jax":
        raise InputError("engine", engine, "be numba or numpy for one run", "use integrate_ensemble")
    plan = Plan.of(system, scheme, dt, t_end, contact, every, engine)
    plan.afford(1, every)
    if plan.engine == "numba":
        wait()
    if plan.stepper is not None:
        march = start(plan.stepper, [plan.system], plan.steps, every)
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
    return replace(
        run,
        work=replace(run.work, seconds=clock() - begun),
        provenance=plan.provenance(every) | run.provenance,
        system=plan.system,
        pieces=partial(plan.states, system),
        ledger=partial(plan.ledger, system, every),
    )
