"""The exact solution as a function of parameters that JAX differentiates with its exact derivative."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError, near, numbers, one_of, require_jax_float64, sequence
from ..model.members import paths_of, value_at, with_values
from ..model.system import System, require_system
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
        self._known: tuple[bytes, tuple[Array, Array]] | None = None
        # Solve once at the start: refusals come here, not inside JAX, and a callback needs the shapes.
        values, slopes = self._solved(self.start, derive=True)
        if np.any(np.isnan(values)):
            horizon = float(t[np.argmax(np.isnan(values).reshape(len(t), -1).any(axis=1))])
            raise InputError("t", t[-1], f"end before the horizon of the solution, {horizon:.4g}", "ask for less time")
        flow = jax.custom_jvp(self._called)
        flow.defjvp(self._derived)
        self._flow = flow
        self._shapes = values.shape, slopes.shape

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

    def _solved(self, values: ArrayLike, derive: bool) -> tuple[Array, Array]:
        """Return the quantity at the times and, if asked, its derivative with the parameters as last axis.

        JAX asks for the value and for the derivative at one place in two calls; the second finds the first.
        """
        values = np.asarray(values, float)
        key = values.tobytes()
        if self._known is not None and self._known[0] == key and (len(self._known[1][1]) or not derive):
            return self._known[1]
        system = with_values(self.system, dict(zip(self.wrt, values.tolist(), strict=True)))
        run = reference(system, float(self.t[-1]), t_eval=self.t)
        states = np.concatenate(run.states, axis=1) if self.quantity == "state" else None
        # A copy: NaN must not enter the Reference.
        result = np.array(getattr(run, self.quantity) if states is None else states)
        result[self.t > run.horizon] = np.nan
        slopes = np.empty(0)
        if derive:
            derivative = run.derivative(self.wrt)
            slopes = np.array(getattr(derivative, self.quantity))
            slopes[self.t > derivative.horizon] = np.nan
        self._known = key, (result, slopes)
        return self._known[1]

    def _called(self, values: Any) -> Any:
        """Return the quantity; JAX calls back into the exact solver."""
        import jax

        shape = jax.ShapeDtypeStruct(self._shapes[0], np.float64)
        # The solver takes one system at a time, so vmap calls it member by member.
        return jax.pure_callback(lambda x: self._solved(x, False)[0], shape, values, vmap_method="sequential")

    def _derived(self, primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
        """Return the quantity and its derivative along the tangent, linear in it, so that JAX can transpose it."""
        import jax

        shapes = [jax.ShapeDtypeStruct(shape, np.float64) for shape in self._shapes]
        values, slopes = jax.pure_callback(lambda x: self._solved(x, True), shapes, *primals, vmap_method="sequential")
        return values, slopes @ tangents[0]


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
