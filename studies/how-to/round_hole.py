"""A tube in a round hole: a regular polygon of ordinary contacts stands for the circle.

    python studies/how-to/round_hole.py

Side k of n has the gap cos(theta_k) x + sin(theta_k) y - c, theta_k = 2 pi k/n, with the displacements x and y of the
section and the radial clearance c. Two opposite sides are the two stops of one contact. Corners of the polygon lie
c (1/cos(pi/n) - 1) outside the circle. At the depth d all sides within acos(c/(c + d)) of the direction of the
displacement press, and together they are stiffer than the hole. The script prints the least and the largest force of
the polygon over that of the circle: choose n where both are near 1 at the depth of your motion.
"""

import numpy as np
from scipy.linalg import block_diag

import stiffbeam as sb

CLEARANCE, KAPPA = 3e-4, 1e6  # m, N/m
TUBE = {"length": 1.2, "stiffness": 668.0, "mass_per_length": 0.647, "viscosity": 0.15}


def directions(sides: int) -> np.ndarray:
    """Unit normals (sides/2, 2), one for each pair of opposite sides."""
    turns = 2.0 * np.pi / sides * np.arange(sides // 2)
    return np.stack([np.cos(turns), np.sin(turns)], axis=1)


def tube_in_hole(sides: int, cells: int = 6) -> sb.System:
    """Return the tube that bends in two planes, its end in the hole; the unknowns of x stand before those of y."""
    loads = (sb.Harmonic(12.0, 138.0), sb.Harmonic(5.0, 138.0, phase=1.0))
    x, y = (sb.semidiscretise(sb.BeamProblem(**TUBE, loads=(sb.PointLoad(0.9, f),)), cells) for f in loads)
    (to_x, f), (to_y, g) = x.loads[0], y.loads[0]
    end, none = np.eye(x.size)[-1], np.zeros(x.size)
    hole = sb.Stops(lower=-CLEARANCE, upper=CLEARANCE, stiffness=KAPPA)
    return sb.System.from_matrices(
        *(block_diag(getattr(x, name), getattr(y, name)) for name in ("mass", "stiffness", "damping")),
        loads=[(np.r_[to_x, none], f), (np.r_[none, to_y], g)],
        contacts=[sb.Contact(np.r_[a * end, b * end], hole) for a, b in directions(sides)],
        observe=np.r_[end, none],
    )


def force_ratio(sides: int, depth: float) -> tuple[float, float]:
    """Least and largest force over that of the circle, over all directions, at a depth of ``depth`` clearances."""
    way = np.linspace(0.0, np.pi / sides, 201)  # from the middle of a side to a corner
    along = (1.0 + depth) * np.stack([np.cos(way), np.sin(way)], axis=1) @ directions(sides).T
    force = (along - np.clip(along, -1.0, 1.0)) @ directions(sides) / depth
    sizes = np.hypot(*force.T)
    return float(np.min(sizes)), float(np.max(sizes))


if __name__ == "__main__":
    for sides in (4, 8, 12, 16):
        exact = sb.reference(tube_in_hole(sides), t_end=0.1)
        force = np.hypot(*(directions(sides).T @ np.array([contact.force for contact in exact.contacts])))
        least, most = force_ratio(sides, 0.11)
        print(f"{sides:2} sides: peak {np.max(force):.2f} N, {least:.2f} to {most:.2f} of the force of the circle")
    assert force_ratio(12, 0.11)[0] > 0.95
