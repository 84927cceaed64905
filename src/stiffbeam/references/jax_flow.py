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
    """A ``quantity`` of the exact solution at fixed times ``t`` (k,) as a function of the p parameters ``wrt``, see
    ``sb.jax_flow``. ``start`` (p,) are their values in the system itself."""

    def __init__(self, system: System, wrt: Sequence[str], t: Array, quantity: str) -> None:
        import jax

        self.system, self.wrt, self.t, self.quantity = system, tuple(wrt), t, quantity
        self.start = np.array([value_at(system, path) for path in self.wrt])
        # JAX asks for the value and for the derivative at one place in two calls: they share one solution.
        self._solved = lru_cache(maxsize=1)(self._solve)
        # Solve once at the start: refusals come here, not inside JAX, and a callback needs the shapes.
        run = self._solved(*self.start.tolist())
        if run.horizon < t[-1]:
            raise InputError(
                "t", t[-1], f"end before the horizon of the solution, {run.horizon:.4g}", "ask for less time"
            )
        values, slopes = (
            # The solver takes one system at a time, so vmap calls it member by member.
            partial(jax.pure_callback, f, jax.ShapeDtypeStruct(f(self.start).shape, float), vmap_method="sequential")
            for f in (self._values, self._slopes)
        )
        self._flow = jax.custom_jvp(values)
        # Linear in the tangent, so that JAX can transpose it.
        self._flow.defjvp(lambda x, tangents: (values(*x), slopes(*x) @ tangents[0]))

    def __call__(self, values: Any) -> Any:
        """Return the quantity for these values of the parameters, a JAX array (k,), of the state (k, 2n).

        It is NaN past the horizon, and so is its derivative past its own, or where none exists. Raises InputError for
        arrays of another shape, and for values that the system does not allow.
        """
        import jax.numpy as jnp

        values = jnp.asarray(values)
        if values.shape != self.start.shape:
            raise InputError("values", f"shape {values.shape}", f"have shape {self.start.shape}", "one per path")
        return self._flow(values)

    def _solve(self, *values: float) -> Reference:
        system = with_values(self.system, dict(zip(self.wrt, values, strict=True)))
        return reference(system, float(self.t[-1]), t_eval=self.t)

    def _values(self, values: ArrayLike) -> Array:
        run = self._solved(*np.asarray(values, float).tolist())
        found = np.hstack(run.states) if self.quantity == "state" else getattr(run, self.quantity)
        return self._until(run.horizon, found)

    def _slopes(self, values: ArrayLike) -> Array:
        """The derivative, with the parameters as last axis."""
        derivative = self._solved(*np.asarray(values, float).tolist()).derivative(self.wrt)
        return self._until(derivative.horizon, getattr(derivative, self.quantity))

    def _until(self, horizon: float, found: Array) -> Array:
        """A copy that is NaN past a horizon."""
        past = (self.t > horizon).reshape(-1, *[1] * (found.ndim - 1))
        return np.where(past, np.nan, found)


def jax_flow(system: System, wrt: Sequence[str], t: ArrayLike, quantity: str = "tip") -> JaxFlow:
    """Return the exact solution at fixed times as a function of parameters, for ``jax.grad``, ``jit`` and ``vmap``.

    Value and derivative are those of ``sb.reference`` and ``Reference.derivative``. No second derivatives.

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
    times, paths = (
        numbers("t", t).ravel(),
        sequence("wrt", wrt, "be paths to numbers", 'give a list: ["stops.stiffness"]'),
    )
    for path in paths:
        try:
            value_at(system, path)
        except LookupError as error:
            rule = "be a path to a number of the system"
            raise InputError("wrt", path, rule, near(path, paths_of(system))) from error
    return JaxFlow(system, paths, output_times(times, float(times[-1])), quantity)
