"""A beam that bends in two planes inside round holes: each the true circle or a polygon of stops.

    circle:  depth |r| - c, force along r = (x, y), see ``Contact``
    polygon: gap of side k = cos(theta_k) x + sin(theta_k) y - c,   theta_k = 2 pi k/n,   k = 0 .. n - 1

with the displacements x and y of a cross-section, the radial clearance c and n sides around the circle |r| = c. The
force of the circle turns with the position: schemes and adaptive references take it, the exact solution needs fixed
rows. Errors of the polygon:

* A corner lies c (sec(pi/n) - 1) outside the circle.
* At the depth d = |r| - c every side with |theta - theta_k| < acos(c/|r|) presses. Several together are stiffer than
  one: more sides are better only for small d/c. ``force_ratio`` gives the range of the force over kappa d.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from ..basics.arrays import Array
from ..basics.validation import InputError, instance, integer, positive
from .contact import Contact
from .problem import BeamProblem
from .semidiscretisation import semidiscretise
from .system import System


@dataclass(frozen=True, eq=False)
class TwoPlanes:
    """A beam in two planes. The unknowns are those of the first plane, x, then those of the second, y.

    Parameters
    ----------
    system : System
        Its contacts are those of the first hole, one for each pair of opposite sides, then those of the next hole. A
        circle is one contact.
    normals, tangents : array (contacts, n), of circles (contacts, 2, n)
        Rows of the displacement along the normal theta_k of each contact and at right angles to it, of a circle along x
        and y and at right angles to these. ``contact_rates`` takes the tangents, for the sliding work.
    sides : int, None for circles
    """

    system: System
    normals: Array
    tangents: Array
    sides: int | None

    @property
    def gap_error(self) -> float:
        """sec(pi/n) - 1, the distance of a corner from the circle over the clearance; 0 of the circle."""
        return 0.0 if self.sides is None else 1.0 / float(np.cos(np.pi / self.sides)) - 1.0

    def force_ratio(self, depth: float) -> tuple[float, float]:
        """Least and largest force over kappa d, of all directions, at a depth d of ``depth`` clearances."""
        radius = 1.0 + positive("depth", depth)
        if self.sides is None:
            return 1.0, 1.0
        directions = np.linspace(0.0, np.pi / self.sides, 201)  # from the middle of a side to a corner
        off = directions[:, None] - 2.0 * np.pi * np.arange(self.sides) / self.sides
        pressed = np.maximum(radius * np.cos(off) - 1.0, 0.0)
        force = np.hypot(np.sum(pressed * np.cos(off), axis=1), np.sum(pressed * np.sin(off), axis=1)) / depth
        return float(np.min(force)), float(np.max(force))


def two_planes(
    problem: BeamProblem,
    cells: int,
    second: BeamProblem | None = None,
    sides: int | None = 12,
    form: str = "displacement",
) -> TwoPlanes:
    """Return the system of a beam that bends in two planes, with a round hole for each of its stops.

    Parameters
    ----------
    problem : BeamProblem
        The first plane. Its stops are holes with the radial clearance ``upper`` = -``lower``.
    cells : int
    second : BeamProblem, optional
        The second plane, for its loads and initial data; by default the same beam at rest without loads.
    sides : int, optional
        Even, at least 4. None for the true circle, which the exact solution does not take.
    form : str
        As in ``semidiscretise``.

    Returns
    -------
    TwoPlanes
        ``system`` has the tip in the first plane as its ``.tip``, and the units of the problem.

    Raises
    ------
    InputError
        For stops that are no round holes, stops and bases that move, and odd ``sides``.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> hole = sb.Stops(lower=-0.01, upper=0.01, stiffness=100.0)
    >>> problem = sb.BeamProblem(stiffness=3.0, stops=hole, initial_velocity=sb.PolynomialProfile((0.0, 0.0, 0.5)))
    >>> tube = sb.two_planes(problem, cells=4, sides=8)
    >>> len(tube.system.contacts), round(tube.gap_error, 3)
    (4, 0.082)
    """
    if sides is not None and integer("sides", sides, 4) % 2:
        raise InputError("sides", sides, "be even", "opposite sides are one contact")
    instance("problem", problem, BeamProblem, "for example stiffbeam.BeamProblem(stiffness=3.0)")
    if second is None:
        second = replace(problem, loads=(), initial_displacement=None, initial_velocity=None)
    instance("second", second, BeamProblem, "leave it out for the same beam without loads")
    # The holes are the same in both planes: ``second`` needs no stops.
    planes = [semidiscretise(replace(x, stops=problem.stops), cells, form) for x in (problem, second)]
    if planes[0].size != planes[1].size:
        raise InputError("second", second, "be a beam with the same supports", "change loads and initial data only")
    for contact in (contact for plane in planes for contact in plane.contacts):
        if contact.offset is not None:
            remedy = "leave base and motion out, or move the load"
            raise InputError("problem", "a base or stop that moves", "be at rest in two planes", remedy)
        if contact.stops.lower is None or contact.stops.upper is None or contact.stops.lower != -contact.stops.upper:
            raise InputError(
                "stops", contact.stops, "have lower = -upper, the radial clearance", "for a hole give both"
            )
    x, y = planes
    nothing = np.zeros(x.size)
    # Half the directions: opposite sides are the two stops of one contact.
    turns = [] if sides is None else 2.0 * np.pi / sides * np.arange(sides // 2)
    normals, tangents, contacts = [], [], []
    for contact in x.contacts:
        stops = replace(contact.stops, position=None, motion=None)
        for turn in turns:
            along, across = np.cos(turn) * contact.row, np.sin(turn) * contact.row
            normals.append(np.concatenate([along, across]))
            tangents.append(np.concatenate([-across, along]))
            contacts.append(Contact(normals[-1], stops))
        if sides is None:
            normals.append(np.kron(np.eye(2), contact.row))
            tangents.append(np.kron([[0.0, -1.0], [1.0, 0.0]], contact.row))
            contacts.append(Contact(normals[-1], replace(stops, lower=None)))
    system = System.from_matrices(
        *(block_diag(getattr(x, name), getattr(y, name)) for name in ("mass", "stiffness", "damping")),
        loads=[
            *((np.concatenate([vector, nothing]), time) for vector, time in x.loads),
            *((np.concatenate([nothing, vector]), time) for vector, time in y.loads),
        ],
        contacts=contacts,
        observe=np.concatenate([x.channels[x.tip_channel][0], nothing]),
        initial_displacement=np.concatenate([x.q0, y.q0]),
        initial_velocity=np.concatenate([x.v0, y.v0]),
        units=problem.units,
    )
    return TwoPlanes(system, np.array(normals), np.array(tangents), sides)
