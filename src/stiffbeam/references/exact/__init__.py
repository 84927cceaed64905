"""The exact solution in float64, based on the package piecewise. In reading order:

piecewise                          compliant stops: refusals, the Reference, perturbed copies
lyapunov                           growth of perturbations along the solution
rigid_reference, rigid_motion      rigid stops with restitution: the Reference; a motion and its series
impacting                          its solver, from event to event
derivative, orbit                  derivatives in parameters; periodic orbits and their distance from a graze
continuation                       branches of orbits
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...trajectory.trajectory import Reference
    from ..registry import Request


def solve(request: Request) -> Reference:
    """Return the exact solution; of a request it takes system, t_end and t_eval."""
    from .piecewise import solve_exact
    from .rigid_reference import solve_rigid

    rigid = request.system.rigid
    return (solve_rigid if rigid else solve_exact)(request.system, request.t_end, request.t_eval)
