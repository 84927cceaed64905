"""A system as an ordinary differential equation, for solvers of other packages."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.text import several
from ..basics.validation import InputError, one_of, require_jax_float64
from ..kernels.rhs import function_address
from .right_hand_side import RightHandSide, numbers_of, on_positions, on_velocities, rate_with_integrals
from .time_functions import breakpoints_of, require_closed_form

if TYPE_CHECKING:
    from .system import System

FORMS = ("explicit", "descriptor")


class ODE:
    """y' = f(t, y) of a system, or E y' = f(t, y), as every reference solver of this package integrates it.

    Parameters
    ----------
    system : System
        With compliant stops: rigid ones have no force that depends on the state alone.
    form : {"explicit", "descriptor"}
        "explicit": y' = f(t, y). "descriptor": E y' = f(t, y), the mass on the left, as IDA takes it.

    Attributes
    ----------
    y0 : (n,) array
        The state at t = 0. ``displacement(y)`` and ``velocity(y)`` give q and q', ``state(q, v)`` the way back;
        ``tip(t, y)`` the observed position. The order of the unknowns is (q_1, q'_1, q_2, q'_2, ...).
    mass : (n, n) array
        E; the identity in the explicit form.
    bandwidths : (int, int) or None
        Lower and upper bandwidth of ``jac`` and ``mass``; None where a banded solver does not pay.
    events : tuple of Event
        One per side of every contact that has a stop there: > 0 while the stop presses.
    breakpoints : tuple of float
        Times at which a load or an offset is not smooth: samples of records, and those that a function states.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> from scipy.integrate import solve_ivp
    >>> system = sb.problem("bilinear-oscillator").system
    >>> ode = system.ode()
    >>> solution = solve_ivp(ode.rhs, (0.0, 1.0), ode.y0, method="Radau", jac=ode.jac, rtol=1e-8, atol=1e-10)
    >>> run = sb.Trajectory.from_arrays(solution.t, ode.tip(solution.t, solution.y))
    """

    def __init__(self, system: System, form: str = "explicit", sides: ArrayLike | None = None) -> None:
        self.system, self.form = system, one_of("form", form, FORMS)
        for contact in system.contacts:
            contact.stops.require_compliant("a differential equation", "use a large one, 1e8 for example")
        self._rhs = RightHandSide(system, descriptor=form == "descriptor")
        self._n = self._rhs.states
        self.y0 = self._rhs.z0[: self._n].copy()
        self.mass = self._rhs.mass
        self.bandwidths = self._rhs.bandwidths
        # A segment between events has its sides; without them every contact follows its law.
        if sides is not None:
            given = np.asarray(sides)
            if given.shape != self._rhs.regime.shape or not np.all(np.isin(given, (-1, 0, 1))):
                rule = f"hold -1, 0 or 1 for each of {len(self._rhs.regime)} contacts"
                raise InputError("sides", sides, rule, "0 leaves a contact open, 1 closes its upper stop")
            self._rhs.regime[:] = given
        self.events = tuple(Event(partial(self._pressed, k), *side) for k, side in enumerate(self._rhs.sides))

    def __repr__(self) -> str:
        form = "" if self.form == FORMS[0] else f", {self.form}"
        return f"<ODE of {self.system!r}: {several(self._n, 'unknown')}, {several(len(self.events), 'event')}{form}>"

    def rhs(self, t: float, y: ArrayLike) -> Array:
        """Return f(t, y), (n,)."""
        self._rhs.ask(float(t))
        return self._rhs.equations.state_rate(float(t), np.asarray(y, float))

    def jac(self, t: float, y: ArrayLike) -> Array:
        """Return df/dy, (n, n)."""
        return self._rhs.jacobian(float(t), self._padded(y))[: self._n, : self._n]

    def state(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the state y, (n,), of a displacement q and a velocity v, (dof,) each."""
        return on_positions(np.asarray(q, float)) + on_velocities(np.asarray(v, float))

    def displacement(self, y: ArrayLike) -> Array:
        """Return q, (dof,) or (k, dof), of a state (n,) or of k states, (k, n) or as SciPy has them (n, k)."""
        return self._states(y)[..., ::2]

    def velocity(self, y: ArrayLike) -> Array:
        """Return q' in the same way."""
        return self._states(y)[..., 1::2]

    def tip(self, t: ArrayLike, y: ArrayLike) -> Array:
        """Return the observed position, (k,), of k states at the times (k,)."""
        times, states = np.atleast_1d(np.asarray(t, float)), np.atleast_2d(self._states(y))
        return self._rhs.channels(times, states)[0][:, self.system.tip_channel]

    def segment(self, sides: ArrayLike) -> ODE:
        """Return the equation between two events, smooth on both sides of them.

        Parameters
        ----------
        sides : (contacts,) array of int
            1 where the upper stop of a contact presses, -1 the lower one, 0 where it is open.
        """
        return ODE(self.system, self.form, sides)

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which a load or an offset is not smooth."""
        times = {t for function in self.system.time_functions for t in breakpoints_of(function).tolist()}
        return tuple(sorted(times))

    @cached_property
    def cfunc(self) -> tuple[int, int]:
        """Addresses (function, data) of the compiled right-hand side: ``void f(double t, const double *y, double *f,
        void *data)``. They hold as long as this object does.

        Raises InputError where a load or an offset is a Python function.
        """
        remedy = "sample it: Sampled(t, values, 'cubic')"
        require_closed_form(self.system.time_functions, "compiled code", remedy)
        return function_address("state_rate"), self._rhs.equations.c

    @cached_property
    def jax(self) -> Callable[..., Any]:
        """f(t, y, args=None) in JAX, the explicit form; traceable and differentiable.

        Raises InputError where JAX works in single precision, and where a load or an offset is a Python function.
        """
        require_jax_float64()
        if self.form != FORMS[0]:
            raise InputError("form", self.form, "be 'explicit' for JAX", "system.ode().jax")
        exponents, numbers = numbers_of(self._rhs.equations)
        return lambda t, y, args=None: rate_with_integrals(exponents, t, y, numbers)[: self._n]

    def _pressed(self, number: int, t: float, y: ArrayLike) -> float:
        """Return the event function of this number."""
        return float(self._rhs.event_functions(float(t), self._padded(y))[number])

    def _states(self, y: ArrayLike) -> Array:
        """``y`` as (n,) or (k, n). Raises InputError where k = n leaves open which axis is which."""
        states, n = np.asarray(y, float), self._n
        if states.ndim not in (1, 2) or n not in states.shape or states.shape == (n, n):
            rule = f"be a state ({n},) or states (k, {n}) or ({n}, k) with another k"
            raise InputError("y", states.shape, rule, "take one time more or less")
        return states if states.shape[-1] == n else states.T

    def _padded(self, y: ArrayLike) -> Array:
        """Return the state with the integrals of the ledger, which act on nothing."""
        z = np.zeros(self._rhs.size)
        z[: self._n] = y
        return z


class Event:
    """Entry into a stop and exit from it: a function of (t, y), > 0 while the stop presses, with SciPy's attributes.

    Attributes
    ----------
    contact, side : int
        Index of the contact; 1 for its upper stop, -1 for the lower one.
    direction : float
        0: zeros in both directions.
    terminal : bool
        False; set it to True to restart there with ``ODE.segment``, and ``direction`` to 1 where the contact is open,
        to -1 where it is closed: otherwise SciPy stops at the event at which it starts.
    """

    def __init__(self, value: Callable[[float, ArrayLike], float], contact: int, side: int) -> None:
        self._value = value
        self.contact, self.side = contact, side
        self.direction, self.terminal = 0.0, False

    def __repr__(self) -> str:
        return f"<Event of contact {self.contact}, {'upper' if self.side > 0 else 'lower'} stop>"

    def __call__(self, t: float, y: ArrayLike) -> float:
        """Return the event function at one time and state."""
        return self._value(t, y)
