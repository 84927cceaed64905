"""Runge-Kutta solvers of diffrax on JAX: Kvaerno's ESDIRK methods, and any other that estimates its error."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from typing import Any

import numpy as np

from ...basics.arrays import Array
from ...basics.resources import stopped_clock
from ...basics.validation import InputError
from ...model.right_hand_side import Kind, RightHandSide, numbers_of, rate_with_integrals
from ...model.right_hand_side_kernels import THROUGH
from ...model.time_functions import require_closed_form
from ...trajectory.trajectory import Reference
from ..registry import REFERENCES, RESTART, Request
from .adaptive import Solver, reference_from
from .scipy import Cubic, stepping

CAPACITY = 128  # steps per call of a program: bounds its memory and lets an interrupt through
FIRST_STEPS = 2  # of the first call after a start, twice as many in each that follows: an event makes the rest waste
LEAST_STEP = 1e-14  # of the time reached: with shorter ones a solver has failed
_PROGRAMS: dict[tuple[Any, ...], Any] = {}


def solve(request: Request) -> Reference:
    """Kvaerno's L-stable, stiffly accurate methods of order 3 and 5, or "diffrax:NAME", in float64.

    diffrax makes the steps and chooses their lengths. A root is looked for at the ends of every step; where one ends
    a phase, a step of the full order leads to it, and another to every output time, since dense output is of third
    order only. The solver starts anew at every event. Newton's method takes the dense Jacobian by automatic
    differentiation. A program is compiled once a process for each shape of the system (its time is
    ``provenance["compile_seconds"]``). Takes time functions made of Harmonic, Constant and Sampled, which JAX can
    trace. At tight tolerances order 3 needs minutes for a tenth of a time unit.
    """
    import diffrax
    import jax

    system, method = request.system, request.method
    require_closed_form(system.time_functions, method)
    name = REFERENCES[method].solver
    assert hasattr(diffrax, name) and jax is not None  # noqa: PT018 - both are named where one is missing

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        rhs.callbacks = "JAX"
        return stepping(method, partial(Stepper, rhs, name), steps_to_outputs=True)(rhs, rtol, atol)

    return reference_from(request, solver, RESTART)


class Stepper:
    """A solver of diffrax with the attributes of SciPy's ``OdeSolver``, its steps made in calls of many.

    first_step: the first one's length. t_old, t, y: of the last step.
    """

    def __init__(
        self, rhs: RightHandSide, name: str, _: Any, t0: float, y0: Array, t_bound: float, *, rtol: float, atol: Array,
        max_step: float = math.inf, first_step: float | None = None, jac: Any = None,
    ) -> None:  # fmt: skip
        self.t, self.y, self.t_bound, self.status = t0, np.asarray(y0), t_bound, "running"
        self.t_old: float = t0
        self._rhs, self._rtol, self._atol, self._max_step = rhs, rtol, atol, max_step
        self._old = self.y
        # The first length is only a guess, which error control corrects. A stated one leads to an event or an output:
        # the caller needs that one step.
        self._next = 1e-3 * rtol**0.2 * min(t_bound - t0, max_step) if first_step is None else first_step
        self._steps = 1 if first_step is not None else FIRST_STEPS
        self._made: list[tuple[float, Array]] = []
        self.counters = {"steps": 0, "stages": 0}
        kind, self._numbers = numbers_of(rhs)
        self._program, self._stages = _program(name, kind, self._numbers, rhs)

    @property
    def nfev(self) -> int:
        """Stages, at least as many as evaluations of the right-hand side."""
        return self.counters["stages"]

    def step(self) -> str | None:
        """Make one step; return the reason where it fails."""
        if not self._made and not self._fill():
            self.status = "failed"
            return "no step is short enough for the tolerances"
        self.t_old, self._old = self.t, self.y
        self.t, self.y = self._made.pop(0)
        if self.t >= self.t_bound:
            self.status = "finished"
        return None

    def _fill(self) -> bool:
        """Make up to ``_steps`` steps ahead; return False where there are none."""
        with float64_on_the_processor():
            # One call of the compiled march makes many steps, since each call from Python has its cost.
            ts, ys, made, tried, self._next = self._program(
                self._numbers, self.t, self.y, self._next, self.t_bound, self._rtol, self._atol, self._max_step,
                self._steps,
            )  # fmt: skip
            made, tried = int(made), int(tried)
            times, states = np.asarray(ts)[:made].tolist(), np.asarray(ys)[:made]
        self._made = list(zip(times, states, strict=True))
        self._steps = min(CAPACITY, 2 * self._steps)
        # A rejected step takes as many stages as an accepted one.
        self.counters["steps"] += tried
        self.counters["stages"] += tried * self._stages
        return made > 0

    def dense_output(self) -> Cubic:
        """The cubic with the states and rates at both ends of the last step."""
        return Cubic(self._rhs, self.t_old, self._old, self.t, self.y)


def _program(name: str, kind: Kind, numbers: Any, rhs: RightHandSide) -> tuple[Callable[..., Any], int]:
    """The compiled march of a solver for systems of one shape, and its stages a step."""
    import diffrax

    # The numbers of the system are arguments of the program: systems of one shape share it.
    key = (name, kind, rhs.size, *(np.shape(x) for x in numbers))
    if key not in _PROGRAMS:
        import jax

        scalar, integer = jax.ShapeDtypeStruct((), np.float64), jax.ShapeDtypeStruct((), np.int64)
        vector = jax.ShapeDtypeStruct((rhs.size,), np.float64)
        # Processor time, as ``clock`` counts it: other programs on the machine do not lengthen it.
        begun = time.process_time()
        with stopped_clock(), float64_on_the_processor():
            shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(np.shape(x), np.asarray(x).dtype), numbers)
            arguments = (shapes, scalar, vector, scalar, scalar, scalar, vector, scalar, integer)
            _PROGRAMS[key] = jax.jit(partial(_march, name, kind)).lower(*arguments).compile()
        rhs.compile_seconds += time.process_time() - begun
    # If the first stage of a step is the last one of the step before (FSAL), a step has one stage less.
    tableau: Any = getattr(diffrax, name).tableau
    return _PROGRAMS[key], len(tableau.b_sol) - int(tableau.fsal)


def _march(
    name: str, kind: Kind, numbers: Any, t: Any, z: Any, dt: Any, end: Any, rtol: Any, atol: Any, max_step: Any,
    count: Any,
) -> tuple[Any, Any, Any, Any, Any]:  # fmt: skip
    """Up to ``count`` accepted steps from (t, z) towards ``end``: their times and states, the numbers of accepted and
    of tried steps, and the length of the next."""
    import diffrax
    import jax.numpy as jnp
    import optimistix
    from jax import lax

    # Between events under a linear law all but the viscous power is linear, and one iteration is exact.
    plain = set(kind.exponents) <= {1.0} and set(kind.seconds) <= {-1} and not kind.damped
    linear = plain and not numbers.damping.shape[0]
    once = jnp.all(numbers.regime != THROUGH) if linear else False
    term = diffrax.ODETerm(partial(rate_with_integrals, kind))
    controller = diffrax.PIDController(rtol=rtol, atol=atol, dtmax=max_step)
    kind_of_solver = getattr(diffrax, name)
    implicit = issubclass(kind_of_solver, diffrax.AbstractImplicitSolver)
    finder: dict[str, Any] = {}
    if implicit:  # to the tolerances of the steps, as diffrax.diffeqsolve sets it
        finder["root_finder"] = _chord()(rtol=rtol, atol=atol, norm=optimistix.rms_norm, once=once)
    solver = kind_of_solver(**finder)
    order = solver.error_order(term)
    _, control = controller.init(term, t, end, z, dt, numbers, solver.func, order)

    def going_on(carry: Any) -> Any:
        # The march ends also where steps become too short. ``step`` reports a march without any step as a failure.
        now, _, length, _, _, made, _, _, _ = carry
        return (made < count) & (now < end) & (length > LEAST_STEP * jnp.abs(now)) & jnp.isfinite(length)

    def one(carry: Any) -> Any:
        now, state, length, memory, control, made, tried, times, states = carry
        length = jnp.minimum(length, max_step)
        # A step that ends a little before ``end`` is stretched to it: the rest would be a billionth of it.
        last = now + (1.0 + 1e-9) * length >= end
        until = jnp.where(last, end, now + length)
        new, error, _, new_memory, _ = solver.step(term, now, until, state, numbers, memory, False)
        keep, _, ahead, _, control, _ = controller.adapt_step_size(
            now, until, state, new, numbers, error, order, control
        )
        # A state with infinities is rejected, whatever its error estimate.
        keep = keep & jnp.all(jnp.isfinite(new))
        proposed = ahead - jnp.where(keep, until, now)
        # A step cut short by the end does not tell that the next has to be as short.
        proposed = jnp.where(keep & last, jnp.maximum(proposed, length), proposed)
        memory = _chosen(keep, new_memory, memory)
        times = times.at[made].set(jnp.where(keep, until, times[made]))
        states = states.at[made].set(jnp.where(keep, new, states[made]))
        return (
            jnp.where(keep, until, now), jnp.where(keep, new, state), proposed, memory, control, made + keep,
            tried + 1, times, states,
        )  # fmt: skip

    memory = solver.init(term, t, end, z, numbers)
    zero = jnp.zeros((), jnp.int64)
    # Arrays of fixed size, as a compiled loop needs them; ``count`` is at most CAPACITY.
    buffers = jnp.zeros(CAPACITY), jnp.zeros((CAPACITY, len(z)))
    _, _, length, _, _, made, tried, times, states = lax.while_loop(
        going_on, one, (t, z, dt, memory, control, zero, zero, *buffers)
    )
    return times, states, made, tried, length


def jax_devices() -> list[Any]:
    """The devices of JAX. Raises InputError where one does not start: a card without free memory, or one that
    JAX_PLATFORMS names and that is not there."""
    import jax

    try:
        return jax.local_devices()
    except (RuntimeError, AssertionError) as error:  # JAX 0.10 asserts that some device has started
        reason = str(error).partition(" (you may")[0] or "none"
        raise InputError("JAX", reason, "start its devices", "set JAX_PLATFORMS=cpu in the environment") from None


@contextmanager
def float64_on_the_processor() -> Generator[None]:
    """A context in which JAX computes in float64 on the processor; outside it stays as it was.

    A step of a small stiff system is a chain of hundreds of short operations. Each of them costs a launch on a
    graphics card, which JAX takes by default where there is one. Raises InputError where no device starts.
    """
    import jax

    # A switch of the whole process in older versions of JAX moved out of ``experimental``.
    home = jax if hasattr(jax, "enable_x64") else import_module("jax.experimental")
    jax_devices()
    try:
        processor = jax.local_devices(backend="cpu")[0]
    except RuntimeError:  # JAX_PLATFORMS leaves the processor out
        processor = None
    with home.enable_x64(True), jax.default_device(processor):
        yield


@cache
def _chord() -> Any:
    """The chord method of diffrax, ended after one iteration where ``once`` is True."""
    import diffrax

    class Chord(diffrax.VeryChord):
        once: Any = False

        def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
            # The second iteration measures the convergence. Under linear equations it only confirms the first.
            ended, result = super().terminate(fn, y, args, options, state, tags)
            return ended | (self.once & (state.step > 0)), result

    return Chord


def _chosen(keep: Any, new: Any, old: Any) -> Any:
    """The tree ``new`` if the step is kept, else ``old``."""
    import jax
    import jax.numpy as jnp

    return jax.tree.map(lambda a, b: jnp.where(keep, a, b), new, old)
