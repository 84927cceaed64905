"""The exact solution as a function of parameters that JAX differentiates with its exact derivative."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError, near, numbers, one_of, require_jax_float64, sequence
from ..model.members import paths_of, value_at, with_values
from ..model.system import System, require_system
from ..trajectory.trajectory import Reference
from . import reference
from .registry import output_times

QUANTITIES = ("tip", "tip_velocity", "state")


class JaxFlow:
    """A quantity of the exact solution at fixed times as a function of p parameters, see ``sb.jax_flow``.

    Attributes
    ----------
    wrt : tuple of str
        The p paths.
    start : (p,) array
        Values of the parameters in the system itself.
    t : (k,) array
        Times of the values.
    quantity : str
        Name of the quantity.
    """

    def __init__(self, system: System, wrt: Sequence[str], t: Array, quantity: str) -> None:
        import jax

        self.system, self.wrt, self.t, self.quantity = system, tuple(wrt), t, quantity
        self.start = np.array([value_at(system, path) for path in self.wrt])
        # JAX asks for the value and for the derivative at one place in two calls: they share one solution.
        self._solved = lru_cache(maxsize=1)(self._solve)
        # Solve once at the start: refusals come here, not inside JAX, and a callback needs the shapes.
        values = self._values(self.start)
        if np.any(np.isnan(values)):
            horizon = float(t[np.argmax(np.isnan(values).reshape(len(t), -1).any(axis=1))])
            raise InputError("t", t[-1], f"end before the horizon of the solution, {horizon:.4g}", "ask for less time")
        shapes = [jax.ShapeDtypeStruct(x.shape, np.float64) for x in (values, self._slopes(self.start))]
        # The solver takes one system at a time, so vmap calls it member by member.
        values_at = partial(jax.pure_callback, self._values, shapes[0], vmap_method="sequential")
        slopes_at = partial(jax.pure_callback, self._slopes, shapes[1], vmap_method="sequential")
        self._flow = jax.custom_jvp(values_at)
        # Linear in the tangent, so that JAX can transpose it.
        self._flow.defjvp(lambda x, tangents: (values_at(*x), slopes_at(*x) @ tangents[0]))

    def __call__(self, values: Any) -> Any:
        """Return the quantity for these values of the parameters, a JAX array (k,), of the state (k, 2n).

        It is NaN past the horizon, and so is its derivative past its own, or where none exists. Raises InputError for
        arrays in single precision, of another shape, and for values that the system does not allow.
        """
        import jax.numpy as jnp

        values = jnp.asarray(values)
        if values.shape != self.start.shape:
            raise InputError("values", f"shape {values.shape}", f"have shape {self.start.shape}", "one per path")
        return self._flow(values)

    def __repr__(self) -> str:
        return f"<JaxFlow of {self.quantity} in {', '.join(self.wrt)}, {len(self.t)} times to {self.t[-1]:.6g}>"

    def _solve(self, *values: float) -> Reference:
        system = with_values(self.system, dict(zip(self.wrt, values, strict=True)))
        return reference(system, float(self.t[-1]), t_eval=self.t)

    def _values(self, values: ArrayLike) -> Array:
        """Return the quantity at the times, NaN past the horizon."""
        run = self._solved(*np.asarray(values, float).tolist())
        found = np.hstack(run.states) if self.quantity == "state" else getattr(run, self.quantity)
        return _until(run.horizon, self.t, found)

    def _slopes(self, values: ArrayLike) -> Array:
        """Return its derivative with the parameters as last axis, NaN past its own horizon."""
        derivative = self._solved(*np.asarray(values, float).tolist()).derivative(self.wrt)
        return _until(derivative.horizon, self.t, getattr(derivative, self.quantity))


def _until(horizon: float, t: Array, numbers: Array) -> Array:
    """A copy, since NaN must not enter the Reference."""
    numbers = np.array(numbers)
    numbers[t > horizon] = np.nan
    return numbers


def jax_flow(system: System, wrt: Sequence[str], t: ArrayLike, quantity: str = "tip") -> JaxFlow:
    """Return the exact solution at fixed times as a function of parameters, for ``jax.grad``, ``jit`` and ``vmap``.

    Value and derivative are those of ``sb.reference`` and ``Reference.derivative``, without time step or tolerance.
    Limitation: no second derivatives.

    Parameters
    ----------
    system : System
        Linear stops or rigid ones, functions of time in closed form: what the exact solution takes.
    wrt : sequence of str
        Paths of the parameters, for example ``["stops.stiffness", "loads[0].time.amplitude"]``.
    t : (k,) array_like
        Increasing times, the last one inside the horizon.
    quantity : str
        "tip", "tip_velocity" or "state", the last one (q, q').

    Returns
    -------
    JaxFlow
        f(values) with ``.start``, the values in the system.

    Raises
    ------
    InputError
        If JAX works in single precision, for a path that is not one number, and for times past the horizon.

    Examples
    --------
    >>> import jax, stiffbeam as sb
    >>> jax.config.update("jax_enable_x64", True)
    >>> flow = sb.jax_flow(sb.paper_case(10).system(), ["stops.stiffness", "base.amplitude"], [0.01, 0.02])
    >>> jax.jacobian(flow)(flow.start).shape
    (2, 2)
    """
    require_system(system)
    require_jax_float64()
    one_of("quantity", quantity, QUANTITIES)
    times = numbers("t", t).ravel()
    paths = sequence("wrt", wrt, "be paths to numbers", 'give a list: ["stops.stiffness"]')
    for path in paths:
        try:
            value_at(system, path)
        except LookupError as error:
            raise InputError(
                "wrt", path, "be a path to a number of the system", near(path, paths_of(system))
            ) from error
    return JaxFlow(system, paths, output_times(times, float(times[-1])), quantity)
