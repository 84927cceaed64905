"""A rigid stop at a node without mass, which is an ordinary compliant stop.

    python studies/how-to/massless_contact.py

On a mesh the contact node b hits a rigid stop with its own mass, and forces and impacts change with the mesh. Without
this mass the node is at rest under its forces, K_bb q_b + K_bi q_i = p_b f + F. Static condensation takes it out:

    M_ii q_i'' + (K_ii - K_ib K_bi/K_bb) q_i = (p_i + r p_b) f + r F(r q_i + o),   r = -K_bi/K_bb,   o = p_b f/K_bb

F is the force of a stop of stiffness K_bb on the position that the node would have without the stop. The node itself is
never beyond the stop. It needs no restitution. The mass of the node goes to its neighbour. Source: Khenous, Laborde and
Renard, Eur. J. Mech. A 27 (2008) 918-932. The script throws an elastic rod against a wall.
"""

import numpy as np

import stiffbeam as sb


def condensed(mass, stiffness, node: int, upper: float, load=None, time=None, **options) -> sb.System:
    """Return the system without the unknown ``node``, whose mass goes to the unknown that it is coupled to most.

    options: of ``System.from_matrices``, for the other unknowns.
    """
    M, K = np.array(mass, float), np.asarray(stiffness, float)
    p = np.zeros(len(M)) if load is None else np.asarray(load, float)
    if np.any(np.delete(M[node], node)):
        raise ValueError("lump the mass: the node must not be coupled in the mass matrix")
    i = np.delete(np.arange(len(M)), node)
    held, row = K[node, node], -K[node, i] / K[node, node]
    heir = i[np.argmax(np.abs(row))]
    M[heir, heir] += M[node, node]
    offset = sb.Superposition(terms=[(p[node] / held, time)]) if p[node] else None
    return sb.System.from_matrices(
        M[np.ix_(i, i)],
        K[np.ix_(i, i)] - held * np.outer(row, row),
        loads=[(p[i] + row * p[node], time)] if load is not None else [],
        contacts=[sb.Contact(row, sb.Stops(upper=upper, stiffness=held), offset)],
        **options,
    )


def rod(elements: int) -> sb.System:
    """Return a free rod with EA = rho A = L = 1 and the speed 1, its end .1 from a wall."""
    ends = np.r_[1.0, np.full(elements - 1, 2.0), 1.0]
    stiffness = elements * (np.diag(ends) - np.eye(elements + 1, k=1) - np.eye(elements + 1, k=-1))
    return condensed(np.diag(ends) / (2 * elements), stiffness, elements, 0.1, initial_velocity=np.ones(elements))


if __name__ == "__main__":
    for elements in (20, 40, 80):
        wall = sb.reference(rod(elements), t_end=3.0).contacts[0]
        duration = wall.impacts.durations[0]
        print(f"{elements} elements: impulse {wall.impulse:.3f}, exactly 2; in contact for {duration:.3f}, exactly 2")
    assert abs(wall.impulse - 2.0) < 0.02
