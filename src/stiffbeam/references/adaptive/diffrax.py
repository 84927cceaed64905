"""Kvaerno's ESDIRK methods of diffrax, on JAX."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from scipy.integrate import OdeSolver
from scipy.interpolate import CubicHermiteSpline

from ...basics import storage
from ...basics.arrays import Array
from ...basics.resources import once
from ...basics.validation import InputError, require_jax_threads
from ...model.right_hand_side import RightHandSide, numbers_of, rate_with_integrals
from ...trajectory.trajectory import Reference
from ..registry import REFERENCES, Request
from .adaptive import reference_from
from .restarts import Solver
from .scipy import NO_TIMES, Stepping

CAPACITY = 128  # steps per call of the program: bounds its memory and lets an interrupt through
FIRST_STEPS = 2  # of the first call after a start, twice as many in each that follows: an event makes the rest waste
WORST = 1e-8  # error of the inverse in eigenvectors, relative, with which it is used: two iterations leave rounding
LEAST_STEP = 1e-14  # of the time reached: with shorter ones a solver has failed


def solve(request: Request) -> Reference:
    """Kvaerno's L-stable, stiffly accurate methods of order 3 and 5 in float64.

    diffrax makes the steps and chooses their lengths, and a step ends at every output, since dense output is of third
    order only. A root is looked for at the ends of every step; where one ends a phase, a step of the full order leads
    to it. Newton's method takes the dense Jacobian by automatic differentiation, and the eigenvectors of the Jacobian
    where it is constant, see ``Modal``. The program is compiled once for each shape of the system, before the time of
    the solution counts; JAX keeps it on disk for later processes. Takes time functions made of Harmonic, Constant and
    Sampled, which JAX can trace. At tight tolerances order 3 needs minutes for a tenth of a time unit.
    """
    require_jax_threads()
    with once():
        import diffrax
        import jax

    system, method = request.system, request.method
    system.drive.require_closed_form(method)
    kind = getattr(diffrax, REFERENCES[method].label)
    if jax.config.values["jax_compilation_cache_dir"] is None:
        jax.config.update("jax_compilation_cache_dir", str(storage.directory() / "jax"))

    def solver(rhs: RightHandSide, rtol: float, atol: Array) -> Solver:
        return Stepping(method, partial(Stepper, Program(rhs, kind, rtol, atol)))

    return reference_from(request, solver)


class Modal(NamedTuple):
    """The constant Jacobian Re(V diag(rates) W) of the n states: vectors [Re V, -Im V] (n, 2n), back [Re W; Im W]
    (2n, n) with W = V^-1, rates (n,).

    Between events under a linear law y' is linear in y. The equations of a stage, (I - c J) d = r, are then solved by
    two products with V and W for any c, without a Jacobian or a factorisation in the step. Each iteration leaves the
    rounding of W times the error before it. Real matrices make a product several times as fast as complex ones.
    """

    vectors: Any
    back: Any
    rates: Any


class Program:
    """The compiled march of a solver of diffrax for one right-hand side, whose regime and window change."""

    def __init__(self, rhs: RightHandSide, kind: Any, rtol: float, atol: Array) -> None:
        import jax

        self.rhs, self.rtol, self._tolerances = rhs, rtol, (rtol, atol)
        # The first stage of a step is the last one of the step before (FSAL).
        self.stages = len(kind.tableau.b_sol) - 1
        self._modal: dict[bytes, Modal | None] = {}
        with float64_on_the_processor():
            exponents, numbers = numbers_of(rhs)
            self._numbers, self._march = jax.device_put(numbers), _compiled(kind, exponents)
        with once():
            self(0.0, rhs.z0, 1.0, 1.0, np.empty(0), 1.0, 0)  # compiles

    def __call__(
        self, t: float, z: Array, length: float, end: float, outputs: Array, max_step: float, count: int
    ) -> tuple[Any, ...]:
        """``_march`` in the regime of now: up to ``count`` steps from (t, z) towards ``end``, the first of this length,
        one to each of the outputs, CAPACITY at most."""
        rhs, regime = self.rhs, self.rhs.regime.tobytes()
        if regime not in self._modal:
            self._modal[regime] = _modal(rhs)
        numbers = self._numbers | {"regime": rhs.regime.copy(), "window": rhs.window.copy()}
        ahead = np.full(CAPACITY, np.inf)
        ahead[: len(outputs)] = outputs
        with float64_on_the_processor():
            span = t, z, length, end, ahead, max_step, count
            return tuple(map(np.asarray, self._march((numbers, self._modal[regime]), self._tolerances, span)))


@cache
def _compiled(kind: Any, exponents: tuple[float, ...]) -> Any:
    """The march, compiled for every shape of its arguments once: systems of one shape share it."""
    import jax

    return jax.jit(partial(_march, kind, exponents))


class Stepper(OdeSolver):
    """A solver of diffrax as an ``OdeSolver`` of SciPy, its steps made in calls of many.

    first_step: the first one's length. outputs: times at which steps end. nfev: stages, at least as many as evaluations
    of the right-hand side.
    """

    unit = "stages"

    def __init__(
        self, program: Program, t0: float, y0: Array, t_bound: float, *, max_step: float = math.inf,
        first_step: float | None = None, outputs: Array = NO_TIMES,
    ) -> None:  # fmt: skip
        super().__init__(program.rhs.value, t0, y0, t_bound, vectorized=False)
        self._program, self._ahead = program, self._made_ahead(outputs, max_step, first_step)

    def _step_impl(self) -> tuple[bool, str | None]:
        following = next(self._ahead, None)
        if following is None:
            return False, "no step is short enough for the tolerances"
        self._y_old, self.t, self.y = self.y, float(following[0]), following[1]
        return True, None

    def _made_ahead(self, outputs: Array, max_step: float, first_step: float | None) -> Iterator[tuple[Any, Array]]:
        """Times and states of the steps, until there are none.

        One call of the compiled march makes many steps, since each call from Python has its cost.
        """
        # The first length is only a guess, which error control corrects. A stated one leads to an event: the caller
        # needs that one step.
        length = first_step or 1e-3 * self._program.rtol**0.2 * min(self.t_bound - self.t, max_step)
        count, made = FIRST_STEPS if first_step is None else 1, True
        while made:
            first = int(np.searchsorted(outputs, self.t, "right"))
            due = outputs[first : first + CAPACITY]
            end = float(due[-1]) if len(due) == CAPACITY else self.t_bound
            times, states, made, tried, length = self._program(self.t, self.y, length, end, due, max_step, count)
            # A rejected step takes as many stages as an accepted one.
            self.nfev += int(tried) * self._program.stages
            length, count = float(length), min(CAPACITY, 2 * count)
            yield from zip(times[:made], states[:made], strict=True)

    def _dense_output_impl(self) -> Any:
        """The cubic with the states and rates at both ends of the last step."""
        times, states = np.array([self.t_old, self.t]), [self._y_old, self.y]
        spline = CubicHermiteSpline(times, states, list(map(self._program.rhs.value, times.tolist(), states)))
        return lambda t: np.asarray(spline(t)).T


def _modal(rhs: RightHandSide) -> Modal | None:
    """The Jacobian in its eigenvectors, None where these are too ill-conditioned, or where y' is not linear in y in
    every phase, as it is with any dashpots."""
    laws = [contact.stops.law for contact in rhs.system.contacts]
    if any(law.p != 1.0 or law.lam != 0.0 for law in laws):
        return None
    jacobian = rhs.jacobian(0.0, rhs.z0)[: rhs.states, : rhs.states]
    # Scaled first, so that the units of the unknowns do not count.
    balanced, (scale, _) = scipy.linalg.matrix_balance(jacobian, permute=False, separate=True)
    rates, vectors = np.linalg.eig(balanced)
    if not float(np.linalg.cond(vectors)) * float(np.finfo(float).eps) < WORST:
        return None
    back: Any = np.linalg.inv(vectors) / scale
    vectors: Any = scale[:, None] * vectors
    stacked = np.hstack([vectors.real, -vectors.imag]), np.vstack([back.real, back.imag])
    return Modal(*stacked, rates.astype(complex))


def _march(
    kind: Any, exponents: tuple[float, ...], arguments: Any, tolerances: tuple[Any, Any], span: tuple[Any, ...]
) -> tuple[Any, Any, Any, Any, Any]:
    """The accepted steps of a span: their times and states, the numbers of accepted and of tried steps, and the length
    of the next. arguments: of the right-hand side, and ``Modal`` or None. span: the arguments of ``Program``."""
    import diffrax
    import jax
    import jax.numpy as jnp
    import optimistix
    from jax import lax

    (rtol, atol), (t, z, dt, end, outputs, max_step, count) = tolerances, span
    term = diffrax.ODETerm(lambda t, z, x: rate_with_integrals(exponents, t, z, x[0]))
    # To the tolerances of the steps, as diffrax.diffeqsolve sets it.
    finder: Any = diffrax.VeryChord if arguments[1] is None else _chord()
    solver = kind(root_finder=finder(rtol=rtol, atol=atol, norm=optimistix.rms_norm))
    controller = diffrax.PIDController(rtol=rtol, atol=atol, dtmax=max_step)
    order = solver.error_order(term)
    _, control = controller.init(term, t, end, z, dt, arguments, solver.func, order)

    def going_on(carry: Any) -> Any:
        # The march ends also where steps become too short. ``step`` reports a march without any step as a failure.
        (now, *_), _, length, made, *_ = carry
        return (made < count) & (now < end) & (length > LEAST_STEP * jnp.abs(now)) & jnp.isfinite(length)

    def one(carry: Any) -> Any:
        (now, state, memory), control, length, made, tried, times, states = carry
        # An output too close for a step of its own lies in the next one.
        due = jnp.minimum(end, jnp.min(jnp.where(outputs > now + 10.0 * LEAST_STEP * jnp.abs(now), outputs, jnp.inf)))
        # A step that ends a little before ``due`` is stretched to it: the rest would be a billionth of it.
        last = now + (1.0 + 1e-9) * length >= due
        until = jnp.where(last, due, now + length)
        new, error, _, new_memory, _ = solver.step(term, now, until, state, arguments, memory, False)
        keep, _, ahead, _, control, _ = controller.adapt_step_size(
            now, until, state, new, arguments, error, order, control
        )
        # A state with infinities is rejected, whatever its error estimate.
        keep = keep & jnp.all(jnp.isfinite(new))
        proposed = ahead - jnp.where(keep, until, now)
        # A step cut short by an output does not tell that the next has to be as short.
        proposed = jnp.where(keep & last, jnp.maximum(proposed, length), proposed)
        # The next step is written over a rejected one.
        times, states = times.at[made].set(until), states.at[made].set(new)
        reached = jax.tree.map(lambda x, y: jnp.where(keep, x, y), (until, new, new_memory), (now, state, memory))
        return reached, control, proposed, made + keep, tried + 1, times, states

    start = t, z, solver.init(term, t, end, z, arguments)
    zero = jnp.zeros((), jnp.int64)
    # Arrays of fixed size, as a compiled loop needs them; ``count`` is at most CAPACITY.
    buffers = jnp.zeros(CAPACITY), jnp.zeros((CAPACITY, len(z)))
    _, _, length, made, tried, times, states = lax.while_loop(
        going_on, one, (start, control, jnp.minimum(dt, max_step), zero, zero, *buffers)
    )
    return times, states, made, tried, length


@cache
def _chord() -> Any:
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

        def init(self, *_: Any, **__: Any) -> tuple[()]:
            return ()

        def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> tuple[Any, Any, Any]:
            return y, state, fn(y, args)[1]

        def terminate(self, *_: Any, **__: Any) -> tuple[Any, optimistix.RESULTS]:
            return jnp.array(True), optimistix.RESULTS.successful

        def postprocess(self, fn: Any, y: Any, aux: Any, args: Any, *rest: Any, **named: Any) -> tuple[Any, Any, Any]:
            diagonal, (_, modal), h = args[1], *args[-2:]
            n = len(modal.vectors)
            inverse = 1.0 / (1.0 - h * diagonal * modal.rates)
            for _ in range(2):  # the second takes what rounding of the eigenvectors left
                residual = fn(y, args)[0]
                x = modal.back @ residual[:n]
                x = inverse * (x[:n] + 1j * x[n:])
                y = y.at[:n].add(-modal.vectors @ jnp.concatenate([x.real, x.imag]))
            # No rate depends on the integrals, so that theirs follow from the states at once.
            y = y.at[n:].add(-fn(y, args)[0][n:])
            return y, aux, {}

    return Chord


@contextmanager
def float64_on_the_processor() -> Generator[None]:
    """A context in which JAX computes in float64 on the processor; outside it stays as it was.

    A step of a small stiff system is a chain of hundreds of short operations. Each of them costs a launch on a
    graphics card, which JAX takes by default where there is one. Raises InputError where a device does not start: a
    card without free memory, one that JAX_PLATFORMS names and that is not there, or a processor that it leaves out.
    """
    import jax

    # A switch of the whole process in older versions of JAX moved out of ``experimental``.
    home = jax if hasattr(jax, "enable_x64") else import_module("jax.experimental")
    try:
        jax.local_devices()
        processor = jax.local_devices(backend="cpu")[0]
    except (RuntimeError, AssertionError) as error:  # JAX 0.10 asserts that some device has started
        reason = str(error).partition(" (you may")[0] or "none"
        raise InputError("JAX", reason, "start its devices", "set JAX_PLATFORMS=cpu in the environment") from None
    with home.enable_x64(True), jax.default_device(processor):
        yield
