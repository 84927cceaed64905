"""Kvaerno's ESDIRK methods of diffrax, on JAX."""

from __future__ import annotations

import hashlib
import math
import os
import pickle
import platform
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from functools import cache, partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from ...basics import storage
from ...basics.arrays import Array
from ...basics.validation import InputError
from ...model.contact import linear
from ...model.right_hand_side import RightHandSide
from ...model.right_hand_side_jax import Kind, numbers_of, rate_with_integrals
from ...model.time_functions import require_closed_form
from ...trajectory.trajectory import Reference
from ..registry import REFERENCES, Request
from .adaptive import Solver, reference_from
from .scipy import Cubic, Stepping

CAPACITY = 128  # steps per call of a program: bounds its memory and lets an interrupt through
FIRST_STEPS = 2  # of the first call after a start, twice as many in each that follows: an event makes the rest waste
MOST = 1 << 28  # bytes of compiled programs that are kept on disk, some 4e5 each
WORST = 1e-8  # error of the inverse in eigenvectors, relative, with which it is used
LEAST_STEP = 1e-14  # of the time reached: with shorter ones a solver has failed
_PROGRAMS: dict[tuple[Any, ...], Any] = {}


def solve(request: Request) -> Reference:
    """Kvaerno's L-stable, stiffly accurate methods of order 3 and 5 in float64.

    diffrax makes the steps and chooses their lengths. A root is looked for at the ends of every step; where one ends
    a phase, a step of the full order leads to it, and another to every output time, since dense output is of third
    order only. The solver starts anew at every event. Newton's method takes the dense Jacobian by automatic
    differentiation, and the eigenvectors of the Jacobian where it is constant, see ``Modal``. A program is compiled
    once for each shape of the system, and read from disk by later processes (``provenance["compile_seconds"]`` is the
    time of either). Takes time functions
    made of Harmonic, Constant and Sampled, which JAX can trace. At tight tolerances order 3 needs minutes for a tenth
    of a time unit.
    """
    import diffrax
    import jax

    system, method = request.system, request.method
    require_closed_form(system.time_functions, method)
    name = REFERENCES[method].solver
    assert hasattr(diffrax, name) and jax is not None  # noqa: PT018 - both are named where one is missing

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        return Stepping(method, partial(Stepper, Programs(rhs, name)), rhs, rtol, atol, steps_to_outputs=True).run

    return reference_from(request, solver)


class Modal(NamedTuple):
    """The constant Jacobian Re(V diag(rates) W) of the n states. Of two conjugate eigenvectors V has one, twice.

    vectors: [Re V, -Im V] (n, 2m). back: W likewise, (2m, n), rows of V^-1. rates: (m,), complex. Zeros fill all
    three up to a round m, so that regimes share programs. iterations: None for each, which is structure to JAX and
    no number: a loop would cost as much as an iteration.

    Between events under a linear law y' is linear in y. The equations of a stage, (I - c J) d = r, are then solved by
    two products with V and W for any c, without a Jacobian or a factorisation in the step. Each iteration leaves the
    rounding of W times the error before it.
    """

    vectors: Any
    back: Any
    rates: Any
    iterations: tuple[None, ...]


class Arguments(NamedTuple):
    """Arguments of a program. numbers: of the right-hand side. modal: its Jacobian in its eigenvectors, None where
    Newton's method takes it in every step."""

    numbers: Any
    modal: Modal | None


class Programs:
    """The compiled programs of a solver of diffrax for one right-hand side, whose regime and window change."""

    def __init__(self, rhs: RightHandSide, name: str) -> None:
        import diffrax

        self.rhs, self.name = rhs, name
        self._kind = numbers_of(rhs.equations)[0]
        # The first stage of a step is the last one of the step before (FSAL).
        self.stages = len(getattr(diffrax, name).tableau.b_sol) - 1
        # Modal needs y' linear in y.
        self._linear = linear(rhs.first_order.system.contacts)
        self._numbers: Any = None
        self._modal: dict[bytes, Modal | None] = {}
        self._iterations = 0
        self._ready: dict[tuple[Any, tuple[int, int] | None], Any] = {}

    def arguments(self, rtol: float) -> Arguments:
        """Numbers of the regime and the window of now; all others lie on the device."""
        import jax

        rhs, regime = self.rhs, self.rhs.regime.tobytes()
        if self._numbers is None:
            self._numbers = jax.device_put(numbers_of(rhs.equations)[1])
        if regime not in self._modal:
            linear = self._linear
            modal = _modal(rhs.jacobian(0.0, rhs.z0)[: rhs.states, : rhs.states], rtol) if linear else None
            if modal is not None:
                # A regime that needs fewer iterations takes the program of one before: to compile another takes longer.
                self._iterations = max(self._iterations, len(modal.iterations))
                modal = modal._replace(iterations=(None,) * self._iterations)
            self._modal[regime] = jax.device_put(modal)
        numbers = self._numbers._replace(regime=rhs.regime.copy(), window=np.array(rhs.window))
        return Arguments(numbers, self._modal[regime])

    def __call__(self, function: Callable[..., Any], arguments: Arguments, *rest: Any) -> Any:
        """``function`` of the name, the kind and these arguments, compiled at its first call."""
        modal = arguments.modal
        key = (function, None if modal is None else (len(modal.rates), len(modal.iterations)))
        if key not in self._ready:
            self._ready[key] = self._compiled(function, arguments, *rest)
        return self._ready[key](arguments, *rest)

    def _compiled(self, function: Callable[..., Any], *arguments: Any) -> Any:
        import jax

        # The numbers of the system are arguments of the program: systems of one shape share it.
        shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(np.shape(x), np.asarray(x).dtype), arguments)
        key = (function, self.name, self._kind, jax.tree.structure(shapes), *jax.tree.leaves(shapes))
        if key not in _PROGRAMS:
            # Processor time, as ``clock`` counts it: other programs on the machine do not lengthen it.
            begun = time.process_time()
            _PROGRAMS[key] = _program(jax.jit(partial(function, self.name, self._kind)).lower(*shapes))
            self.rhs.compile_seconds += time.process_time() - begun
        return _PROGRAMS[key]


def _program(lowered: Any) -> Any:
    """The compiled program, read from the cache directory where an earlier process compiled it: XLA takes seconds.

    The name of the file tells the program's text and what else decides the machine code.
    """
    from jax.experimental.serialize_executable import deserialize_and_load, serialize

    processor = [platform.machine()]
    with suppress(OSError):  # not on Linux
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor += sorted({x for x in lines if x.startswith(("model name", "flags", "Features", "CPU part"))})
    made_of = version("jax"), version("jaxlib"), os.environ.get("XLA_FLAGS", ""), *processor, lowered.as_text()
    file = storage.directory() / "jax" / f"{hashlib.sha256(repr(made_of).encode()).hexdigest()}.xla"
    with suppress(Exception):  # no such file, or whatever unpickling makes of a damaged one
        program = deserialize_and_load(*pickle.loads(file.read_bytes()))
        file.touch()  # used last
        return program
    program = lowered.compile()
    with suppress(Exception):  # a full disk, or a program that this version of JAX cannot write
        storage.write_whole(file, pickle.dumps(serialize(program)))
        storage.forget(file.parent, "*.xla", MOST)
    return program


class Stepper:
    """A solver of diffrax with the attributes of SciPy's ``OdeSolver``, its steps made in calls of many.

    first_step: the first one's length. outputs: the times that ``reach`` will be asked for. t_old, t, y: of the last
    step. made: times (k,) and states (k, n) at the ends of the steps that follow it and are computed.
    """

    def __init__(
        self, programs: Programs, _: Any, t0: float, y0: Array, t_bound: float, *, rtol: float, atol: Array,
        max_step: float = math.inf, first_step: float | None = None, outputs: Array | None = None,
    ) -> None:  # fmt: skip
        self.t, self.y, self.t_bound, self.status = t0, np.asarray(y0), t_bound, "running"
        self.t_old: float = t0
        self._programs, self._rtol, self._atol, self._max_step = programs, rtol, atol, max_step
        self._old = self.y
        # The first length is only a guess, which error control corrects. A stated one leads to an event or an output:
        # the caller needs that one step.
        self._next = 1e-3 * rtol**0.2 * min(t_bound - t0, max_step) if first_step is None else first_step
        self._steps = 1 if first_step is not None else FIRST_STEPS
        self.made: tuple[Array, Array] = (np.empty(0), np.empty((0, len(self.y))))
        self._outputs = np.empty(0) if outputs is None else outputs
        self._reached: dict[float, Array | None] = {}
        self.counters = {"steps": 0, "stages": 0}
        with float64_on_the_processor():
            self._arguments = programs.arguments(rtol)

    @property
    def nfev(self) -> int:
        """Stages, at least as many as evaluations of the right-hand side."""
        return self.counters["stages"]

    def step(self) -> str | None:
        """Make one step; return the reason where it fails."""
        if not len(self.made[0]) and not self._fill():
            self.status = "failed"
            return "no step is short enough for the tolerances"
        self.skip(1)
        return None

    def skip(self, count: int) -> None:
        """Make ``count`` of the steps in ``made``."""
        times, states = self.made
        if count > 1:
            self.t, self.y = float(times[count - 2]), states[count - 2]
        self.t_old, self._old = self.t, self.y
        self.t, self.y = float(times[count - 1]), states[count - 1]
        self.made = times[count:], states[count:]
        if self.t >= self.t_bound:
            self.status = "finished"

    def _fill(self) -> bool:
        """Make up to ``_steps`` steps ahead; return False where there are none."""
        with float64_on_the_processor():
            # One call of the compiled march makes many steps, since each call from Python has its cost.
            ts, ys, made, tried, self._next = self._programs(
                _march, self._arguments, self.t, self.y, self._next, self.t_bound, self._rtol, self._atol,
                self._max_step, self._steps,
            )  # fmt: skip
            made = int(made)
            self.made = np.array(ts)[:made], np.array(ys)[:made]
        self._steps = min(CAPACITY, 2 * self._steps)
        # A rejected step takes as many stages as an accepted one.
        self._count(int(tried))
        return made > 0

    def reach(self, t: float) -> Array | None:
        """The state at t in the last step, by a step of the full order from where that begins; None if the error of
        this step is too large."""
        if t not in self._reached:
            # All outputs in the steps made so far are reached in one call.
            ends = np.concatenate([[self.t_old, self.t], self.made[0]])
            lefts = np.concatenate([[self._old, self.y], self.made[1]])
            first, last = np.searchsorted(self._outputs, [t, ends[-1]])
            times = self._outputs[first:last][:CAPACITY]
            times = times if t in times else np.array([t])
            begins = np.searchsorted(ends[1:], times)
            count = len(times)
            starts, ahead, states = np.zeros(CAPACITY), np.ones(CAPACITY), np.zeros((CAPACITY, len(self.y)))
            starts[:count], ahead[:count], states[:count] = ends[begins], times, lefts[begins]
            with float64_on_the_processor():
                reached, fits = self._programs(
                    _reach, self._arguments, starts, states, ahead, self._rtol, self._atol, count
                )
                reached, fits = np.asarray(reached), np.asarray(fits)
            self._reached = {float(x): reached[i] if fits[i] else None for i, x in enumerate(times)}
            self._count(count)
        return self._reached[t]

    def _count(self, steps: int) -> None:
        self.counters["steps"] += steps
        self.counters["stages"] += steps * self._programs.stages

    def dense_output(self) -> Cubic:
        """The cubic with the states and rates at both ends of the last step."""
        return Cubic(self._programs.rhs, self.t_old, self._old, self.t, self.y)


def _modal(jacobian: Array, rtol: float) -> Modal | None:
    """The Jacobian in its eigenvectors; None where these are so ill-conditioned that it needs many iterations."""
    # Scaled first, so that the units of the unknowns do not count.
    balanced, (scale, _) = scipy.linalg.matrix_balance(jacobian, permute=False, separate=True)
    rates: Any
    vectors: Any
    rates, vectors = np.linalg.eig(balanced)
    loss = float(np.linalg.cond(vectors)) * np.finfo(float).eps
    if not loss < WORST:
        return None
    # The errors of the stages are to stay far below those of the steps.
    iterations = max(1, math.ceil(math.log(1e-3 * rtol) / math.log(loss)))
    inverse: Any = np.linalg.inv(vectors) / scale
    # Of two conjugate terms, whose sum is real, one is taken twice.
    kept = rates.imag >= 0.0
    vectors = scale[:, None] * vectors[:, kept] * np.where(rates[kept].imag > 0.0, 2.0, 1.0)
    count, quarter = int(np.sum(kept)), -(-len(rates) // 4)
    more = (0, min(len(rates), -(-count // quarter) * quarter) - count)
    rates, vectors = np.pad(rates[kept], more).astype(complex), np.pad(vectors, ((0, 0), more))
    inverse = np.pad(inverse[kept], (more, (0, 0)))
    # Re(V x) as a product of real matrices, which is several times as fast.
    stacked = np.hstack([vectors.real, -vectors.imag]), np.vstack([inverse.real, inverse.imag])
    return Modal(*stacked, rates, (None,) * iterations)


def _method(name: str, kind: Kind, arguments: Arguments, rtol: Any, atol: Any) -> tuple[Any, Any]:
    """The solver of diffrax and its term."""
    import diffrax
    import optimistix

    term = diffrax.ODETerm(lambda t, z, x: rate_with_integrals(kind, t, z, x.numbers))
    # To the tolerances of the steps, as diffrax.diffeqsolve sets it.
    finder: Any = diffrax.VeryChord if arguments.modal is None else _modal_root_finder()
    return getattr(diffrax, name)(root_finder=finder(rtol=rtol, atol=atol, norm=optimistix.rms_norm)), term


def _march(
    name: str, kind: Kind, arguments: Any, t: Any, z: Any, dt: Any, end: Any, rtol: Any, atol: Any, max_step: Any,
    count: Any,
) -> tuple[Any, Any, Any, Any, Any]:  # fmt: skip
    """Up to ``count`` accepted steps from (t, z) towards ``end``: their times and states, the numbers of accepted and
    of tried steps, and the length of the next."""
    import diffrax
    import jax.numpy as jnp
    from jax import lax

    solver, term = _method(name, kind, arguments, rtol, atol)
    controller = diffrax.PIDController(rtol=rtol, atol=atol, dtmax=max_step)
    order = solver.error_order(term)
    _, control = controller.init(term, t, end, z, dt, arguments, solver.func, order)

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
        new, error, _, new_memory, _ = solver.step(term, now, until, state, arguments, memory, False)
        keep, _, ahead, _, control, _ = controller.adapt_step_size(
            now, until, state, new, arguments, error, order, control
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

    memory = solver.init(term, t, end, z, arguments)
    zero = jnp.zeros((), jnp.int64)
    # Arrays of fixed size, as a compiled loop needs them; ``count`` is at most CAPACITY.
    buffers = jnp.zeros(CAPACITY), jnp.zeros((CAPACITY, len(z)))
    _, _, length, _, _, made, tried, times, states = lax.while_loop(
        going_on, one, (t, z, dt, memory, control, zero, zero, *buffers)
    )
    return times, states, made, tried, length


def _reach(
    name: str, kind: Kind, arguments: Any, starts: Any, states: Any, ends: Any, rtol: Any, atol: Any, count: Any
) -> tuple[Any, Any]:
    """One step from each of the first ``count`` starts to its end: the states there, and whether the error fits."""
    import jax.numpy as jnp
    import optimistix
    from jax import lax

    solver, term = _method(name, kind, arguments, rtol, atol)

    def one(k: Any, carry: Any) -> Any:
        reached, fits = carry
        t, end, z = starts[k], ends[k], states[k]
        memory = solver.init(term, t, end, z, arguments)
        new, error, _, _, _ = solver.step(term, t, end, z, arguments, memory, False)
        # The norm of PIDController.
        size = optimistix.rms_norm(error / (atol + rtol * jnp.maximum(jnp.abs(z), jnp.abs(new))))
        return reached.at[k].set(new), fits.at[k].set((size < 1.0) & jnp.all(jnp.isfinite(new)))

    return lax.fori_loop(0, count, one, (jnp.zeros_like(states), jnp.zeros(len(starts), bool)))


@cache
def _modal_root_finder() -> Any:
    """The root finder for the stages f = f(y + c f) where the Jacobian of the states is constant, see ``Modal``."""
    import jax.numpy as jnp
    import optimistix

    class Chord(optimistix.AbstractRootFinder[Any, Any, Any, Any]):
        """The iterations of ``Modal``, all in ``postprocess``.

        The loop of optimistix, with its tests of convergence, costs as much as an iteration, and so does a state,
        which diffrax hands from stage to stage.
        """

        rtol: Any
        atol: Any
        norm: Any

        def init(
            self, fn: Any, y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any
        ) -> tuple[()]:
            return ()

        def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> tuple[Any, Any, Any]:
            return y, state, fn(y, args)[1]

        def terminate(
            self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any
        ) -> tuple[Any, optimistix.RESULTS]:
            return jnp.array(True), optimistix.RESULTS.successful

        def postprocess(
            self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: Any, tags: Any, result: Any
        ) -> tuple[Any, Any, dict[str, Any]]:
            _, diagonal, *_, arguments, h = args
            modal = arguments.modal
            n, m = len(modal.vectors), len(modal.rates)
            inverse = 1.0 / (1.0 - h * diagonal * modal.rates)
            residual = fn(y, args)[0]
            for k in range(len(modal.iterations)):
                residual = fn(y, args)[0] if k else residual
                x = modal.back @ residual[:n]
                x = inverse * (x[:m] + 1j * x[m:])
                y = y.at[:n].add(-modal.vectors @ jnp.concatenate([x.real, x.imag]))
            # No rate depends on the integrals, so that theirs follow from the states at once. A further iteration moves
            # these by rounding only: its residual has the integrals of the states too.
            if len(modal.iterations) == 1:
                residual = fn(y, args)[0]
            y = y.at[n:].add(-residual[n:])
            return y, aux, {}

    return Chord


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


def _chosen(keep: Any, new: Any, old: Any) -> Any:
    """The tree ``new`` if the step is kept, else ``old``."""
    import jax
    import jax.numpy as jnp

    return jax.tree.map(lambda a, b: jnp.where(keep, a, b), new, old)
