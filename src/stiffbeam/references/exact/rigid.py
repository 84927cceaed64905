"""Restitution 1 on a node with mass: where compliant stops on a given mesh go for kappa -> infinity.

At a finite mesh the tip has mass, and a spring that grows without bound turns its velocity round:

    q'+ = q'- - 2 (row q'-)/(row M^-1 row^T) M^-1 row^T     where the gap closes, nothing elsewhere.

No energy is lost, as in the compliant contact. It is the limit on this mesh, not that of the body: impacts grow in
number with the cells, and a body whose contact nodes have no mass (``System.massless_contacts``) does not chatter so.
Between impacts the free modes hold the solution in
closed form, so this shares nothing with the compliant solution but those and the search for a crossing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...basics.arrays import Array
from ...basics.compiled import clock
from ...basics.validation import InputError, numbers, positive
from ...model.drive import Drive
from ...model.system import System, require_system
from ...piecewise.audit import audit, within_float64
from ...piecewise.follow import DONE, follow
from ...piecewise.motion import Motion
from ...piecewise.regimes import Regimes, Source
from ...piecewise.tracer import QUIET
from ...trajectory.impacts import Impacts
from ...trajectory.trajectory import Reference, SolverFailure
from .piecewise import reference_of, refuse

MOST_IMPACTS = 200_000


def rigid_limit(system: System, t_end: float, t_eval: Array | None = None) -> Reference:
    """The solution on [0, t_end] with the stops of ``system``'s one contact made rigid, restitution 1, node with mass.

    Takes what the exact solution without damping takes. The Reference has impacts with impulses
    |M (q'+ - q'-)| along the row, no forces (they are impulses) and no horizon; its ledger leaves the
    stops' energy out. Raises InputError for other systems, or for more than 200 000 impacts; SolverFailure
    where a load presses the contact on its stop at rest, which no impact describes, and where the energy
    balance is open.
    """
    begun = clock()
    require_system(system)
    t_end = positive("t_end", t_end)
    t_eval = None if t_eval is None else numbers("t_eval", t_eval)
    refuse(system, t_end)
    if len(system.contacts) != 1 or system.damped:
        raise InputError(
            "system",
            "a damped one, or not one contact",
            "be undamped with one contact for rigid stops",
            "take stiffbeam.reference, or a scheme for rigid stops",
        )
    if Drive.of(system).records:
        raise InputError(
            "time function",
            Drive.of(system).records[0],
            "be Harmonic or Constant for rigid stops",
            "take stiffbeam.reference, or a scheme for rigid stops",
        )
    if system.contacts[0].offset is not None:
        remedy = "take stiffbeam.reference, or a scheme for rigid stops"
        raise InputError("contact.offset", system.contacts[0].offset, "be None for rigid stops", remedy)
    with within_float64("rigid", t_end):
        return _solve(system, t_end, t_eval, begun)


def _solve(system: System, t_end: float, t_eval: Array | None, begun: float) -> Reference:
    row = system.contacts[0].row
    mass = 1.0 / float(row @ np.linalg.solve(system.mass, row))  # what the stop feels
    q, v = system.q0, system.v0
    if system.contacts[0].stops.state(row @ q):
        remedy = "start the contact point inside the gap"
        raise InputError("initial displacement", float(row @ q), "lie between rigid stops", remedy)
    regimes = Regimes(Source(system))
    q, v = regimes.start(q, v, t_end)  # alone: the loop ends where another regime would begin
    assert regimes.free is not None
    row = kick = regimes.free.force(row)  # M^-1 row in the modes
    table, K = regimes.table, regimes.table.sigma.shape[1]
    out = np.empty(1), np.empty(1, np.int64), np.empty((1, 1), np.int64), *np.empty((2, 1, K))
    sides, switched, unused = np.zeros(1, np.int64), np.zeros(1, np.int64), np.empty(system.size)
    found: list[tuple[Array, ...]] = []
    stops: list[int] = []
    impulses: list[float] = []
    t, evaluations = 0.0, 0
    while True:
        why, _, used, t = follow(table, t, t_end, q, v, unused, unused, sides, switched, QUIET, 0.0, *out, None)
        found.append(tuple(x.copy() for x in out))
        evaluations += used
        if why == DONE:
            break
        if len(found) > MOST_IMPACTS:
            raise InputError("t_end", t_end, f"hold at most {MOST_IMPACTS} impacts", f"end before t = {t:.6g}")
        approach = float(row @ v)
        if not int(sides[0]) * approach > 0.0:
            raise SolverFailure("rigid", t, "the contact is pressed on its stop without speed", "use compliant stops")
        v -= 2.0 * mass * approach * kick
        stops.append(int(sides[0]))
        impulses.append(2.0 * mass * abs(approach))
        sides[0] = 0
    times, regime, chi, x, y = (np.concatenate(z) for z in zip(*found, strict=True))
    solution = Motion(regimes, times, chi, regime, x, y, evaluations)
    audit(system, solution, t_end, "rigid")
    reference = reference_of(system, solution, t_end, t_eval, begun, "rigid", {})
    times = solution.times[1:]
    impacts = Impacts.at(times, stops, "event", ends=times, impulses=impulses)
    record = replace(
        reference.contacts[0],
        force=np.full(len(reference.t), np.nan),
        impacts=impacts,
        peak_force=float("nan") if len(times) else 0.0,
        impulse=float(np.sum(impulses)),
    )
    return replace(reference, contacts=(record,))
