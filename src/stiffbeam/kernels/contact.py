"""The contacts of one node: u = r + S F, u' = w + S' F, every F_c after its own law.

F_c may also be the mean force of the stop over the step, which neither gains nor loses energy:

    F = -(U(u+) - U(u0))/(u+ - u0),   u+ = r + s F

u0 at the start of the step, r where it would end without the force. F does the work F (u+ - u0) = U(u0) - U(u+)
whatever the step is, so that a scheme which conserves the energy of the linear system under a force that is
constant over the step conserves the sum of both. U is convex, so its secant slope grows with u+ and there is
one F. Source: Gonzalez, J. Nonlinear Sci. 6 (1996) 449-467; Simo and Tarnow, ZAMP 43 (1992) 757-792.
"""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np

from ..basics.arrays import Array
from .library import Int, address, filled, library
from .march import LAW


@cache
def _functions() -> ctypes.CDLL:
    lib, at = library(), ctypes.c_void_p
    lib.solve_node.argtypes, lib.solve_node.restype = [Int, *4 * [at]], Int
    lib.solve_stage.argtypes, lib.solve_stage.restype = [Int, Int, *7 * [at]], Int
    lib.contact_forces.argtypes, lib.contact_forces.restype = [Int, *5 * [at]], None
    return lib


def solve_node(r: Array, compliance: Array, law: Array) -> Array:
    """The forces F (m,) with v = r + S F and F_c = F_c(v_c) of springs or rigid stops; law (m, 3): stiffness, lower and
    upper stop, or more columns.

    S = ``compliance`` is symmetric positive semidefinite. They minimise 1/2 F^T S F + r^T F + sum_c (F_c^2/(2 kappa_c)
    - g_c F_c), g_c the stop that F_c comes from, which Lawson and Hanson's active set finds in finitely many steps.
    """
    m, F = len(law), np.empty(len(law))
    r, compliance, linear = np.ascontiguousarray(r), np.ascontiguousarray(compliance), np.zeros((m, LAW))
    linear[:, :3] = law[:, :3]
    at = address(r, (m,)), address(compliance, (m, m)), address(linear, (m, LAW)), address(F, (m,))
    filled(_functions().solve_node(m, *at))
    return F


def solve_stage(r: Array, w: Array, S: Array, S_rate: Array, u0: Array, rule: int, law: Array) -> Array:
    """The forces (m,) under any law; NaN where the search fails. r, w, u0 (m,); S, S_rate (m, m); law (m, 6).

    Contact c by itself, the others' forces given, has one force f_c. H(F) = F - f(F) vanishes at the solution:
    a semismooth Newton method with a line search on |H|; where that does not lower |H|, every contact takes its
    own f_c in turn (Gauss-Seidel), which for forces that have an energy cannot fail.
    """
    m, F = len(law), np.empty(len(law))
    r, w, S, S_rate, u0 = (np.ascontiguousarray(x) for x in (r, w, S, S_rate, u0))
    vectors, matrices = [address(x, (m,)) for x in (r, w)], [address(x, (m, m)) for x in (S, S_rate)]
    at = *vectors, *matrices, address(u0, (m,)), address(law, (m, LAW)), address(F, (m,))
    filled(_functions().solve_stage(m, rule, *at))
    return F


def contact_forces(u: Array, v: Array, law: Array, energy: Array | None = None) -> Array:
    """F(u, u') on the beam, of the shape of u and v; law (.., 6), of each or of all. ``energy`` takes U(u)."""
    shape = np.shape(u)
    law = law if law.shape == (*shape, LAW) else np.broadcast_to(law, (*shape, LAW))
    u, v, law, F = *(np.asarray(x, float, order="C") for x in (u, v, law)), np.empty(shape)
    at = address(u, shape), address(v, shape), address(law, (*shape, LAW)), address(F, shape)
    _functions().contact_forces(F.size, *at, address(energy, shape, wanted=energy is not None))
    return F
