"""Kvaerno's ESDIRK methods of order 3 and 5, through diffrax on JAX."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ...basics.arrays import Array, double_precision
from ...basics.validation import InputError
from ...model.drive import Drive, Term
from ...model.time_functions import in_closed_form
from ...trajectory.trajectory import Reference, SolverFailure
from ..request import KEEP, Request
from .adaptive import Solve, Task, reference_from
from .rhs import RightHandSide

# Output points per compiled call: bounds the memory of a call and lets an interrupt through.
POINTS_PER_CALL = 500
STAGES = {"kvaerno3": 3, "kvaerno5": 6}  # implicit ones, a step
MOST_STEPS = 10_000_000  # per call: minutes, after which it fails and says so


def solve(request: Request) -> Reference:
    """method "kvaerno3" or "kvaerno5": L-stable, stiffly accurate, adaptive, in float64.

    The solver steps onto the output times, since its dense output is of third order only. No events:
    diffrax ends a solve at one, so impacts are the sampled ones at the output times, and it goes through
    the switches by error control alone. Compilation is timed apart
    (``provenance["compile_seconds"]``). Takes time functions made of Harmonic, Constant and Sampled, which JAX
    can trace.
    The Jacobian is dense; at tight tolerances order 3 needs minutes for a tenth of a time unit.
    """
    import diffrax
    import jax
    import jax.numpy as jnp

    system, method = request.system, request.method
    drive = Drive.of(system)
    for function in (*(f for _, f in system.loads), *(offset for _, offset in system.channels)):
        if not in_closed_form(function):
            rule = f"be made of Harmonic, Constant and Sampled for {method}"
            raise InputError("time function", function, rule, "use the adaptive solver cvode")

    def run(task: Task) -> Solve:
        rhs, rtol = task.rhs, task.rtol
        rhs.signed = False
        t, kept = _grid(task.t, [piece.end for piece in task.pieces.pieces])
        longest = min(piece.max_step for piece in task.pieces.pieces)
        with double_precision():
            field = _vector_field(rhs, drive)
            controller = diffrax.PIDController(
                rtol=rtol, atol=jnp.asarray(task.atol), dtmax=None if math.isinf(longest) else longest
            )
            solver = {"kvaerno3": diffrax.Kvaerno3, "kvaerno5": diffrax.Kvaerno5}[method]()

            def advance(y: Any, dt0: Any, times: Any) -> Any:
                return diffrax.diffeqsolve(
                    diffrax.ODETerm(field), solver, times[0], times[-1], dt0, y,
                    saveat=diffrax.SaveAt(ts=times),
                    stepsize_controller=diffrax.ClipStepSizeController(controller, step_ts=times),
                    max_steps=MOST_STEPS,
                    adjoint=diffrax.ForwardMode(),
                    throw=False,
                )  # fmt: skip

            path, count, seconds, compiling, y = [rhs.z0[None]], 0, 0.0, 0.0, rhs.z0
            step = 1e-3 * float(rtol) ** 0.2 * (t[1] - t[0])
            programs: dict[int, Any] = {}
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
                    raise SolverFailure(method, reached, str(solution.result), "loosen rtol or use the solver cvode")
                count += int(solution.stats["num_steps"])
                path.append(ys[1:])
                y = ys[-1]
        z = np.concatenate(path)
        return Solve(z[kept], None, {"steps": count, "stages": STAGES[method] * count}, z[-1], seconds, compiling)

    return reference_from(request, run, KEEP)


def _grid(t: Array, ends: list[float]) -> tuple[Array, Array]:
    """Output times with 0 and the ends of the pieces among them, and where the outputs are."""
    grid = np.unique(np.concatenate([[0.0], ends, t]))
    return grid, np.searchsorted(grid, t)


def _with_records(drive: Drive, basis: Array, rest: list[Term]) -> Array:
    """The basis (d, width) of ``Drive.split`` with the amplitudes of the records below it, (d + R, width)."""
    return np.concatenate([basis, drive.recorded(rest, basis.shape[1])])


def _vector_field(rhs: RightHandSide, drive: Drive) -> Callable[[Any, Any, Any], Any]:
    """f(t, z) in JAX from the same arrays as the compiled one, z = (y, input, viscous, impulses)."""
    import jax.numpy as jnp

    first_order, system = rhs.first_order, rhs.first_order.system
    # One row per harmonic coefficient, and one per record.
    basis = _with_records(drive, *drive.split(first_order.loads, rhs.states))
    power = _with_records(drive, *drive.split([(first_order.to_v.T @ p, f) for p, f in system.loads], rhs.states))
    A, basis, frequencies = jnp.asarray(first_order.matrix), jnp.asarray(basis), jnp.asarray(drive.frequencies)
    power, damping = jnp.asarray(power), jnp.asarray(first_order.to_v.T @ system.damping @ first_order.to_v)
    offsets = _with_records(drive, *drive.offsets(system))
    contacts = [
        (
            jnp.asarray(c.row),
            jnp.asarray(c.column),
            jnp.asarray(o),
            c.contact.stops,
            jnp.asarray(first_order.velocity_row(c)),
        )
        for c, o in zip(first_order.contacts, offsets.T, strict=False)
    ]
    edges, table = jnp.asarray(drive.edges), jnp.asarray(drive.polynomials(drive.edges))

    def inputs(t: Any) -> tuple[Any, Any]:
        """g and the records at t, and their rates."""
        phase = frequencies * t
        s, c = jnp.sin(phase), jnp.cos(phase)
        g, g_rate = jnp.stack([s, c], axis=1).ravel(), jnp.stack([frequencies * c, -frequencies * s], axis=1).ravel()
        values = rates = jnp.zeros(0)
        if drive.records:
            k = jnp.clip(jnp.searchsorted(edges, t, side="right") - 1, 0, len(edges) - 2)
            tau, values, rates = t - edges[k], jnp.zeros(len(drive.records)), jnp.zeros(len(drive.records))
            for j in range(drive.order - 1, -1, -1):  # Horner's scheme
                rates = rates * tau + values
                values = values * tau + table[k, :, j]
        return jnp.concatenate([jnp.ones(1), g, values]), jnp.concatenate([jnp.zeros(1), g_rate, rates])

    def field(t: Any, z: Any, args: Any) -> Any:
        y, (g, g_rate) = z[: rhs.states], inputs(t)
        rate = A @ y + g @ basis
        given, impulses, absorbed = g @ power @ y, [], 0.0
        for row, column, offset, stops, velocity_row in contacts:
            offset_rate = g_rate @ offset
            u = row @ y + g @ offset
            force = stops.force_in(jnp, u, velocity_row @ y + offset_rate if stops.dissipative else None)
            if stops.dissipative:
                absorbed = absorbed - force * (velocity_row @ y + offset_rate)
            rate = rate + column * force
            given = given - force * offset_rate
            impulses.append(jnp.abs(force))
        integrals = [given, y @ damping @ y, *impulses, *([absorbed] if rhs.damped else [])]
        return jnp.concatenate([rate, jnp.stack(integrals)])

    return field
