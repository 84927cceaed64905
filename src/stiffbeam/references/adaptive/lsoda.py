"""LSODA of ODEPACK, through SciPy: a multistep solver that shares no code with SUNDIALS."""

from __future__ import annotations

from ...trajectory.trajectory import Reference
from ..request import RESTART, Request
from .adaptive import in_phases, reference_from
from .scipy import stepping


def solve(request: Request) -> Reference:
    """Adams orders 1-12 with functional iteration, or BDF orders 1-5 with Newton's method and the analytic Jacobian.

    It changes between the two by itself, by which of them allows the longer step, and starts anew at every
    switch. A root is looked for at the ends of every step; gaps that open and close inside one show by the sign
    of their rate. Measured on Tables 5 and 10: the time of CVODE's BDF at rtol 1e-8 and half of it at 1e-10, with
    errors 25 to 115 times smaller; CVODE's Adams takes half to four fifths of LSODA's time at the same rtol.
    """
    from scipy.integrate import LSODA

    return reference_from(request, in_phases("lsoda", stepping("lsoda", LSODA)), RESTART)
