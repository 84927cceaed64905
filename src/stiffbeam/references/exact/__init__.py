"""The exact solution in float64, based on the package piecewise. In reading order:

piecewise                          compliant stops: refusals, the Reference, perturbed copies
lyapunov                           growth of perturbations along the solution
rigid_reference, rigid_motion      rigid stops with restitution: the Reference, and what is read of a motion
impacting, taylor                  its solver, from event to event, and the first zero of a series
derivative, orbit                  derivatives in parameters; periodic orbits
continuation, grazing              branches of orbits; their touches of a stop that begin or end
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...trajectory.trajectory import Reference
    from ..request import Request


def solve(request: Request) -> Reference:
    """Return the exact solution; of a request it takes system, t_end and t_eval."""
    from .piecewise import solve_exact
    from .rigid_reference import solve_rigid

    rigid = any(contact.stops.rigid for contact in request.system.contacts)
    return (solve_rigid if rigid else solve_exact)(request.system, request.t_end, request.t_eval)
