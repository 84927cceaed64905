"""The exact solution: between switches the system is linear, so only the switching times are sought.

With linear compliance every contact is free or on one of its stops, and each combination is a linear
system with a solution in closed form. The time to the next switch is approached by steps that provably
contain none (switching.py).
"""

from __future__ import annotations

import time
from typing import Any

from ..arrays import Array
from ..drive import Drive
from ..modal import Modes
from ..system import System
from ..trajectory import Reference, Work, versions
from ..validation import InputError, positive
from .adaptive import output_times
from .exact_measures import Solution, contact_record, exact_ledger
from .exponential_tracer import ExponentialTracer
from .undamped_tracer import Perturbation, Tracer


def solve_exact(
    system: System,
    t_end: float,
    t_eval: Array | None = None,
    perturbation: Perturbation | None = None,
    known: dict[float, Modes] | None = None,
    since: float = 0.0,
) -> Reference:
    """The exact piecewise-linear solution in float64, with crossings that cannot be missed.

    Takes any damping, any number of contacts, Harmonic and Constant time functions; raises InputError
    with the reason for other time functions, for a resonant drive without damping, and where regimes
    are too close to critical damping or to a rigid-body motion for their eigenvectors. Without damping
    and with at most one contact all of it is compiled; else regimes are made as they are met. ``known``
    keeps the modes of systems that share their matrices and contact row, see ``Tracer``. Contacts are
    recorded from ``since`` on.

    With u the gap's position, u' its rate and B >= |u''| on the rest of the piece, no switch lies
    before the smaller positive root s of (g2 - u) - u' s - B s^2/2 = 0 and (u - g1) + u' s - B s^2/2 = 0;
    B = sum_j |row_j| (amplitude of eta_j'') + that of the drive. Stepping by s approaches a transversal
    crossing quadratically and from before. After an event the gap is exactly 0 and s = 2 |u'|/B; where
    u' vanishes too (grazing) u'' and a bound on u''' take their place.
    """
    begun = time.perf_counter()
    positive("t_end", t_end)
    refuse(system)
    tracer = tracer_of(system, perturbation, known)
    solution = tracer.solve(t_end)
    frequencies = "SVD of the curvature factor" if system.stiffness_factor is not None else "eigh"
    notes = {"frequencies": frequencies}
    return reference_of(system, solution, t_end, t_eval, begun + tracer.compile_seconds, "exact", notes, since)


def general(system: System) -> bool:
    """Whether it takes sums of complex exponentials: damping, or several contacts."""
    return system.damped or len(system.contacts) > 1


def tracer_of(
    system: System, perturbation: Perturbation | None = None, known: dict[float, Modes] | None = None
) -> Tracer | ExponentialTracer:
    """What follows solutions of the system in float64; ``known``: modes to share, where the tracer has some."""
    return ExponentialTracer(system, perturbation) if general(system) else Tracer(system, perturbation, known)


def reference_of(
    system: System,
    solution: Solution,
    t_end: float,
    t_eval: Array | None,
    begun: float,
    method: str,
    notes: dict[str, Any],
    since: float = 0.0,
) -> Reference:
    """A piecewise solution as a Reference; ``begun`` is the clock when the work on it began."""
    t = output_times(t_eval, t_end)

    def evaluate(times: Array, channel: int) -> tuple[Array, Array]:
        u, v = solution.observed(times, system.channels[channel][0])
        shift, shift_rate = solution.offset(system, channel)(times)
        return u + shift, v + shift_rate

    tip, velocity = evaluate(t, system.tip_channel)
    contacts = tuple(contact_record(system, solution, i, t, t_end, since) for i in range(len(system.contacts)))
    seconds = time.perf_counter() - begun
    return Reference(
        t=t,
        tip=tip,
        tip_velocity=velocity,
        contacts=contacts,
        work=Work(
            seconds=seconds,
            march_seconds=seconds,
            counters={"evaluations": solution.evaluations, "switches": len(solution.times) - 1},
        ),
        provenance={
            "method": method,
            "form": system.form,
            "t_end": float(t_end),
            **notes,
            **versions(),
        },
        system=system,
        fingerprint=system.fingerprint,
        evaluate=evaluate,
        state_at=solution.states,
        ledger=lambda: exact_ledger(system, solution, t),
        solution=solution,
    )


def refuse(system: System) -> None:
    """Raise InputError for time functions without a closed form."""
    drive = Drive.of(system)
    rest = drive.split(system.loads, system.size)[1] + drive.offsets(system)[1]
    if rest:
        raise InputError(
            "time function", rest[0][1], "be Harmonic or Constant for the exact solution", "use method='cvode'"
        )
