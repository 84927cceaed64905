"""The exact solution as a function of parameters that JAX differentiates with its exact derivative."""

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError, numbers, one_of, require_jax_float64, sequence
from ..model.members import value_at, with_values
from ..model.system import System, require_system
from ..model.system_data import slopes
from . import reference
from .exact.solution import refuse


def jax_flow(system: System, wrt: Sequence[str], t: ArrayLike, quantity: str = "tip") -> Any:
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
        "tip" or "tip_velocity".

    Returns
    -------
    function
        f(values), a JAX array (k,), for values (p,); NaN past the horizon, and so is its derivative past its own, or
        where none exists. ``f.start`` (p,): the values in the system. ``f.t``: the times.

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
    import jax

    require_system(system)
    require_jax_float64()
    one_of("quantity", quantity, ("tip", "tip_velocity"))
    times = numbers("t", t).ravel()
    end, paths = float(times[-1]), sequence("wrt", wrt, "be paths to numbers", 'give a list: ["stops.stiffness"]')
    slopes(system, paths)  # which refuses wrong paths
    refuse(system, end, "differentiate a solver of system.ode().jax")
    start = np.array([value_at(system, path) for path in paths])

    @lru_cache(maxsize=1)  # JAX asks for the value and for the derivative at one place in two calls
    def solved(*values: float) -> Any:
        return reference(with_values(system, dict(zip(paths, values, strict=True))), end, t_eval=times)

    def read(differentiate: bool, values: ArrayLike) -> Array:
        run = solved(*np.asarray(values, float).tolist())
        found = run.derivative(paths) if differentiate else run
        return np.where(times > found.horizon, np.nan, getattr(found, quantity).T).T

    # Solve once at the start: refusals come here, not inside JAX, and a callback needs the shapes.
    if (horizon := solved(*start.tolist()).horizon) < end:
        raise InputError("t", end, f"end before the horizon of the solution, {horizon:.4g}", "ask for less time")
    # The solver takes one system at a time, so vmap calls it member by member.
    callback, reads = partial(jax.pure_callback, vmap_method="sequential"), (partial(read, False), partial(read, True))
    values, slope = (partial(callback, f, jax.ShapeDtypeStruct(f(start).shape, float)) for f in reads)

    @jax.custom_jvp
    def flow(x: Any) -> Any:
        if np.shape(x) != start.shape:
            raise InputError("values", f"shape {np.shape(x)}", f"have shape {start.shape}", "one per path")
        return values(x)

    flow.defjvp(lambda x, tangents: (values(*x), slope(*x) @ tangents[0]))  # linear, so that JAX can transpose it
    flow.start, flow.t = start, times  # type: ignore[attr-defined]
    return flow
