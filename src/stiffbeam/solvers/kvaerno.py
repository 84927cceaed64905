"""Kvaerno's ESDIRK methods of order 3 and 5, through diffrax on JAX."""

from __future__ import annotations

import time

import numpy as np

from ..arrays import Array
from ..double_precision import double_precision
from ..drive import Drive
from ..system import System
from ..trajectory import Reference, SolverFailure
from ..validation import InputError
from .adaptive import Solve, reference_from
from .rhs import RightHandSide

# Output points per compiled call: bounds the memory of a call and lets an interrupt through.
POINTS_PER_CALL = 500


def solve_kvaerno(
    system: System, t_end: float, t_eval: Array | None, rtol: float, atol: float | None, method: str
) -> Reference:
    """method "kvaerno3" or "kvaerno5": L-stable, stiffly accurate, adaptive, in float64.

    The solver steps onto the output times, since its dense output is of third order only. No events:
    diffrax ends a solve at one, so impacts are the sampled ones at the output times, and error control
    alone handles the switches. Compilation is timed apart (``provenance["compile_seconds"]``). Takes
    Harmonic and Constant time functions, which JAX can trace. The Jacobian is dense; at tight
    tolerances order 3 needs minutes for a tenth of a time unit.
    """
    import diffrax
    import jax
    import jax.numpy as jnp

    drive = Drive.of(system)
    if drive.split(system.loads, system.size)[1] or drive.offsets(system)[1]:
        raise InputError("time function", "a callable", f"be Harmonic or Constant for {method}", "use method='cvode'")

    def solve(rhs: RightHandSide, t: Array, rtol: float, atol: float) -> Solve:
        with double_precision():
            field = _vector_field(rhs, drive)
            controller = diffrax.PIDController(rtol=rtol, atol=atol)
            solver = {"kvaerno3": diffrax.Kvaerno3, "kvaerno5": diffrax.Kvaerno5}[method]()

            def advance(y, dt0, times):
                return diffrax.diffeqsolve(
                    diffrax.ODETerm(field), solver, times[0], times[-1], dt0, y,
                    saveat=diffrax.SaveAt(ts=times),
                    stepsize_controller=diffrax.ClipStepSizeController(controller, step_ts=times),
                    max_steps=None,
                    adjoint=diffrax.ForwardMode(),
                    throw=False,
                )  # fmt: skip

            path, steps, seconds, compiling, y = [rhs.first_order.y0[None]], 0, 0.0, 0.0, rhs.first_order.y0
            step = 1e-3 * float(rtol) ** 0.2 * (t[1] - t[0])
            programs: dict = {}
            for first in range(0, len(t) - 1, POINTS_PER_CALL):
                times = jnp.asarray(t[first : first + POINTS_PER_CALL + 1])
                arguments = (jnp.asarray(y), jnp.asarray(step), times)
                begun = time.perf_counter()
                if len(times) not in programs:
                    programs[len(times)] = jax.jit(advance).lower(*arguments).compile()
                compiling += time.perf_counter() - begun
                begun = time.perf_counter()
                solution = programs[len(times)](*arguments)
                ys = np.asarray(solution.ys)
                seconds += time.perf_counter() - begun
                if solution.result != diffrax.RESULTS.successful or not np.all(np.isfinite(ys)):
                    reached = float(times[int(np.argmin(np.all(np.isfinite(ys), axis=1)))])
                    raise SolverFailure(method, reached, str(solution.result), "loosen rtol or use method='cvode'")
                steps += int(solution.stats["num_steps"])
                path.append(ys[1:])
                y = ys[-1]
        counters = {"steps": steps}
        return Solve(np.concatenate(path), None, counters, seconds, compiling)

    versions = {"diffrax": diffrax.__version__, "jax": jax.__version__}
    return reference_from(system, t_end, t_eval, rtol, atol, method, versions, solve)


def _vector_field(rhs: RightHandSide, drive: Drive):
    """f(t, y) in JAX from the same arrays as the compiled one."""
    import jax.numpy as jnp

    first_order = rhs.first_order
    basis, _ = drive.split(first_order.loads, rhs.size)
    A, basis, frequencies = jnp.asarray(first_order.matrix), jnp.asarray(basis), jnp.asarray(drive.frequencies)
    offsets = drive.offsets(first_order.system)[0]
    contacts = [
        (jnp.asarray(c.row), jnp.asarray(c.column), jnp.asarray(offsets[:, i]), c.contact.stops)
        for i, c in enumerate(first_order.contacts)
    ]

    def field(t, y, args):
        phase = frequencies * t
        g = jnp.concatenate([jnp.ones(1), jnp.stack([jnp.sin(phase), jnp.cos(phase)], axis=1).ravel()])
        rate = A @ y + g @ basis
        for row, column, offset, stops in contacts:
            u = row @ y + g @ offset
            rate = rate + column * stops.stiffness * (jnp.clip(u, stops.g1, stops.g2) - u)
        return rate

    return field
