"""The method-of-lines right-hand side of a system as C, JAX and solvers of other packages call it.

y' = A y + ..., contacts included, y = (q_1, q_1', ..., q_n, q_n'): the order of (3.5)
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.typing import ArrayLike

from ..basics.arrays import Array
from ..basics.validation import InputError, require_jax_float64
from ..kernels.library import Structure, address, library
from .beam import velocity_curvature_matrices
from .contact import Law, channel_motion, channel_position, laws, pressure
from .time_functions import evaluate

if TYPE_CHECKING:
    from .system import System

THROUGH = 2  # regime of a contact that follows its law on both sides of its events
EQUATIONS = Structure("rhs.h", "Equations")


def on_positions(row: Array) -> Array:
    """The row on y, (..., 2n), of a row on q."""
    out = np.zeros((*row.shape[:-1], 2 * row.shape[-1]))
    out[..., ::2] = row
    return out


def on_velocities(row: Array) -> Array:
    """The row on y, (..., 2n), of a row on q'; also the column of a force on q''."""
    return np.roll(on_positions(row), 1, axis=-1)


def first_order(stiffness: Array, damping: Array) -> Array:
    """A (2n, 2n) of y' = A y, where q'' = -stiffness q - damping q'."""
    n = len(stiffness)
    A = np.zeros((2 * n, 2 * n))
    A[::2, 1::2] = np.eye(n)
    A[1::2, ::2] = 0.0 - stiffness  # no signed zeros in the Jacobian
    A[1::2, 1::2] = 0.0 - damping
    return A


def over_mass(system: System) -> tuple[Array, Array, Callable[[Array], Array]]:
    """M^-1 K, M^-1 C, and x -> M^-1 x."""
    diagonal = np.diag(system.mass)
    if not np.any(system.mass - np.diag(diagonal)):
        # By reciprocals: on the paper's grids they are whole numbers, and their products with its stencils exact. A
        # rounding of each entry would perturb the lowest frequency by eps (w_max/w_1)^2.
        reciprocal = 1.0 / diagonal
        divide = lambda x: (x.T * reciprocal).T  # noqa: E731
    else:
        factor = scipy.linalg.cho_factor(system.mass)
        divide = lambda x: scipy.linalg.cho_solve(factor, x)  # noqa: E731
    if system.form != "velocity-curvature":
        return divide(system.stiffness), divide(system.damping), divide
    # M^-1 K = EI/m R L of (3.12), since P R = L^T Q: banded, where P^-1 is not; and no damping.
    assert system.origin is not None
    M, problem = system.size, system.origin.problem
    _, _, L, R = velocity_curvature_matrices(M, float(M))  # h = 1: whole multiples of 1/4
    stiffness = problem.stiffness / problem.mass_per_length * (M / problem.length) ** 4 * (R @ L)
    return stiffness, np.zeros((M, M)), divide


class RightHandSide:
    """z' = f(t, z) of a system, z = (y, input, viscous, impulse of every contact); of a ``descriptor`` E z' = f(t, z),
    with the mass in E and not inverted.

        input'   = sum_k f_k p_k^T q' - sum_c F_c o_c',   viscous' = q'^T C q',   impulse_c' = -F_c

    integrate with the motion what nobody could add up from its outputs. The impulse has a sign, > 0 on the upper
    stop: -F is as smooth as the motion, |F| would have a kink of its own where a narrow gap is crossed. Where a
    stop damps there is one more, absorbed' = -sum_c F_c u_c' of those that do: stored and dissipated together, which is
    as smooth as the motion too. The arrays are those of ``kernels/rhs.h``, ``c`` the structure that C reads. A solver
    writes to ``lengths``, ``levels``, ``regime`` and ``window``, the times at which functions of time may be asked.
    ``in_python`` is True where one of these is a bare callable, which Python calls once per evaluation.
    """

    def __init__(self, system: System, descriptor: bool = False) -> None:
        contacts, n, m = system.contacts, 2 * system.size, len(system.contacts)
        self.system, self.states, self.damped = system, n, any(c.stops.law.damps for c in contacts)
        self.size = n + 2 + m + self.damped
        self.z0 = np.pad(on_positions(system.q0) + on_velocities(system.v0), (0, self.size - n))
        stiffness, damping, divide = system.stiffness, system.damping, lambda x: x
        self.mass = np.eye(n)
        if descriptor:
            self.mass[1::2, 1::2] = system.mass
        else:
            stiffness, damping, divide = over_mass(system)
        self.matrix = first_order(stiffness, damping)
        self.viscous = np.zeros((n, n) if system.damped else (0, 0))
        self.viscous[1::2, 1::2] = system.damping[: len(self.viscous) // 2, : len(self.viscous) // 2]
        # Rows of the velocity and acceleration of every contact. With E on the left C has E y': they take E^-1 along.
        rows = np.array([c.row for c in contacts]).reshape(m, system.size)
        self.positions, self.velocities = on_positions(rows), on_velocities(rows)
        self.pushes = on_velocities(np.array([divide(row) for row in rows]).reshape(rows.shape))
        self.accelerations = self.velocities
        self._factor = scipy.linalg.lu_factor(self.mass) if descriptor else None
        if self._factor is not None:
            solved = scipy.linalg.lu_solve(self._factor, self.velocities.T, trans=1)
            self.accelerations = np.ascontiguousarray(solved.T)
        # Functions of time: amplitudes of those in closed form, then of those that Python has to call.
        drive = system.drive
        self.frequencies, self.edges, self.records = np.array(drive.frequencies), drive.edges, drive.table
        nodal, self.offsets = system.load_amplitudes, drive.amplitudes([c.offset for c in contacts])
        self.loads, self.power = on_velocities(divide(nodal.T).T), on_velocities(nodal)
        called = drive.called
        of_offsets = np.any(self.offsets[len(self.offsets) - len(called) :], axis=1)
        self._called: list[Any] = [(f, getattr(f, "value", f), x) for f, x in zip(called, of_offsets, strict=True)]
        self.in_python, self.given = bool(called), np.zeros((3, len(called)))
        # (contact, +1 upper or -1 lower) of every gap, and what a solver sets.
        self.law, self.sides = laws(contacts), [(i, side) for i, c in enumerate(contacts) for side in c.stops.sides]
        self.lengths, self.levels = np.ones(m), np.zeros((3 if self.damped else 2) * len(self.sides))
        self.regime, self.window = np.full(m, THROUGH, np.int64), np.array([-np.inf, np.inf])
        # Lower and upper bandwidth of E and df/dz, None where a band does not pay.
        felt = self.positions + self.velocities
        pattern = (self.matrix != 0.0) | (self.mass != 0.0) | ((self.pushes != 0.0).T @ (felt != 0.0))
        lower, upper = scipy.linalg.bandwidth(pattern)
        self.bandwidths = (lower, upper) if lower + upper + 1 < n // 3 else None
        self.c = self._structure()

    def _structure(self) -> Any:
        """The structure that C reads."""
        descriptor = self._factor is not None
        inertia: Any = scipy.linalg.block_diag(self.mass, np.eye(self.size - self.states))
        matrices = {"A": self.matrix, "D": self.viscous, "E": inertia if descriptor else np.zeros((0, 0))}
        rows = dict[str, Any]()
        for name, matrix in matrices.items():
            sparse = scipy.sparse.csr_array(matrix)
            columns = {"starts": sparse.indptr.astype(np.int64), "columns": sparse.indices.astype(np.int64)}
            rows[name] = EQUATIONS.parts["Rows"](columns | {"entries": sparse.data})
        # Entry (i, j) of a Jacobian at first + i + j stride: the storage of SUNDIALS.
        first, stride = 0, self.size
        if self.bandwidths is not None:
            first = min(self.size - 1, sum(self.bandwidths))  # upper bandwidth of the factors
            stride = first + self.bandwidths[0]
        structure = EQUATIONS(
            vars(self), size=self.size, first=first, stride=stride, damped=self.damped, viscous=self.system.damped,
            inertia=descriptor, **rows,
        )  # fmt: skip
        structure.rows = rows  # which keep their arrays
        return structure

    def value(self, t: float, z: Array) -> Array:
        """f(t, z)."""
        return self._evaluated("right_hand_side", t, z, self.size)

    def rate(self, t: float, z: Array) -> Array:
        """z', which is f(t, z) where no mass is given."""
        out = self.value(t, z)
        if self._factor is not None:
            out[: self.states] = scipy.linalg.lu_solve(self._factor, out[: self.states])
        return out

    def jacobian(self, t: float, z: Array) -> Array:
        """df/dz, (size, size), without the rows of the integrals: they act on nothing."""
        self.ask(t)
        J = np.zeros((self.size, self.size))
        at = address(J, J.shape)
        library().jacobian(t, address(z, (self.size,)), 0.0, 1.0, at, 0, self.size, self.c)
        return J.T

    def event_functions(self, t: float, z: Array) -> Array:
        """The event functions less their ``levels``, (roots,), see ``kernels/rhs.h``."""
        return self._evaluated("event_functions", t, z, len(self.levels))

    def _evaluated(self, name: str, t: float, z: Array, results: int) -> Array:
        """The results of a function of the library."""
        self.ask(t)
        address(z, (self.size,))  # a check
        out = (ctypes.c_double * results)()
        # Solvers call this for each evaluation: ctypes takes bytes in a tenth of the time of an array's address.
        getattr(library(), name)(t, z.tobytes(), out, self.c)
        return np.frombuffer(out)  # type: ignore[call-overload]

    def ask(self, t: float) -> None:
        """Call the functions of time that are not in closed form, for C to read."""
        for k, (function, value, moves) in enumerate(self._called):
            inside = self._inside(t)
            result = value(np.asarray(inside))
            if np.iscomplexobj(result) or not math.isfinite(result):
                result = evaluate(function, inside)  # which says what is wrong
            self.given[0, k] = result
            if moves:
                self.given[1, k] = function.rate(inside)
            if moves and self.damped:  # in the rate of a damped stop's force
                self.given[2, k] = function.acceleration(inside)

    def pressing(self, t: float, z: Array, k: int) -> float:
        """|F| of side k in contact."""
        i, side = self.sides[k]
        contact, y = self.system.contacts[i], z[: self.states]
        u, v = channel_motion(contact.row, contact.offset, self._inside(t), y[::2], y[1::2])
        depth = side * (u - contact.stops.sides[side])
        return max(0.0, pressure(max(0.0, float(depth)), side * float(v), contact.stops.law))

    def stored(self, t: float, z: Array) -> Array:
        """Energy (contacts,) in the stops at t, with the functions of time of the window."""
        t, q = self._inside(t), z[: self.states : 2]
        energies = [c.stops.energy(channel_position(c.row, c.offset, t, q)) for c in self.system.contacts]
        return np.array(energies, float)

    def jumped(self, t: float, z: Array, stored: Array) -> Array:
        """z where stops that held the energy ``stored`` jump at t: the rest of their energy is input, and those that
        damp have absorbed it."""
        gained = self.stored(t, z) - stored
        if not np.any(gained):
            return z
        z = z.copy()
        z[self.states] += np.sum(gained)
        if self.damped:
            z[-1] += np.sum(gained[[c.stops.law.damps for c in self.system.contacts]])
        return z

    def _inside(self, t: float) -> float:
        first, last = self.window.tolist()
        return min(max(t, first), last)


# ---------------------------------------------------------------- in JAX, from the numbers that C reads


Numbers = dict[str, Any]  # arrays by their names in a RightHandSide


def numbers_of(rhs: RightHandSide) -> tuple[tuple[float, ...], Numbers]:
    """Exponents of the contacts, constants of a compiled program, and numbers of a right-hand side, its regime and
    window those of now. Functions of time have to be in closed form: JAX cannot trace others.

    All that is ``linear`` stands in one matrix (n + 3 m + d, n + 2 d), since JAX takes longer to start a small product
    than to compute it. Its columns are the state, the functions of time and their rates; its rows are the state's rate,
    position, velocity and offset's rate of every contact, and the powers of the loads.
    """
    (m, n), d = rhs.pushes.shape, len(rhs.loads)
    linear = np.zeros((n + 3 * m + d, n + 2 * d))
    rate, positions, velocities, offset_rates, power = np.split(linear, np.cumsum([n, m, m, m]))
    rate[:, :n], rate[:, n : n + d] = rhs.matrix, rhs.loads.T
    positions[:, :n], positions[:, n : n + d] = rhs.positions, rhs.offsets.T
    velocities[:, :n], velocities[:, n + d :] = rhs.velocities, rhs.offsets.T
    offset_rates[:, n + d :], power[:, :n] = rhs.offsets.T, rhs.power
    names = ("viscous", "frequencies", "edges", "records", "pushes", "law", "regime", "window")
    return tuple(rhs.law[:, 3].tolist()), {"linear": linear} | {name: vars(rhs)[name].copy() for name in names}


def functions_of_time(t: Any, numbers: Numbers) -> tuple[Any, Any]:
    """1, sin w_1 t, cos w_1 t, ..., the records, (d,); and their rates."""
    import jax.numpy as jnp

    w, edges, records, window = (numbers[name] for name in ("frequencies", "edges", "records", "window"))
    # Sines and cosines in the order of ``Drive``, with their rates.
    s, c = jnp.sin(w * t), jnp.cos(w * t)
    g, rate = jnp.stack([s, c], axis=1).ravel(), jnp.stack([w * c, -w * s], axis=1).ravel()
    values = rates = jnp.zeros(records.shape[1])
    if records.size:
        inside = jnp.clip(t, window[0], window[1])
        # At the end of a window the polynomial before it holds.
        before = jnp.minimum(inside, jnp.nextafter(window[1], -jnp.inf))
        k = jnp.clip(jnp.searchsorted(edges, before, side="right") - 1, 0, len(edges) - 2)
        tau = inside - edges[k]
        for j in range(records.shape[2] - 1, -1, -1):  # Horner's scheme
            rates = rates * tau + values
            values = values * tau + records[k, :, j]
    return jnp.concatenate([jnp.ones(1), g, values]), jnp.concatenate([jnp.zeros(1), rate, rates])


def contact_force(u: Any, v: Any, regime: Any, stop: Law) -> Any:
    """F at a position and velocity relative to the stops, after a regime or the law."""
    import jax.numpy as jnp

    force: Any = 0.0
    # The regime is data, not structure: one compiled program computes both sides and selects.
    for side in (1, -1):
        bound: Any = stop.g2 if side > 0 else stop.g1
        # A side without a stop counts as open, its infinite bound outside the arithmetic.
        there = jnp.isfinite(bound)
        depth = jnp.where(there, side * (u - jnp.where(there, bound, 0.0)), -1.0)
        pressed = pressure(depth, side * v, stop)
        by_law = jnp.where(depth > 0.0, jnp.maximum(0.0, pressed), 0.0)
        force = force - side * jnp.where(regime == THROUGH, by_law, jnp.where(regime == side, pressed, 0.0))
    return force


def rate_with_integrals(exponents: tuple[float, ...], t: Any, z: Any, numbers: Numbers) -> Any:
    """z' of ``RightHandSide``: y' with the rates of the ledger's integrals; of z only its first n entries count."""
    import jax.numpy as jnp

    m, n = numbers["pushes"].shape
    y, (g, g_rate) = z[:n], functions_of_time(t, numbers)
    rows = numbers["linear"] @ jnp.concatenate([y, g, g_rate])
    rate, u, v, offset_rates, power = jnp.split(rows, np.cumsum([n, m, m, m]))
    given, absorbed, pushes = g @ power, 0.0, []
    for c, p in enumerate(exponents):
        stop: Any = Law(*numbers["law"][c])
        force = contact_force(u[c], v[c], numbers["regime"][c], stop._replace(p=p))  # p is a constant of the program
        rate = rate + numbers["pushes"][c] * force
        given = given - force * offset_rates[c]
        absorbed = absorbed - jnp.where(stop.damps, force * v[c], 0.0)
        pushes.append(-force)
    viscous = y @ numbers["viscous"] @ y if len(numbers["viscous"]) else 0.0 * given
    return jnp.concatenate([rate, jnp.stack([given, viscous, *pushes, absorbed])])[: max(n, len(z))]


# ---------------------------------------------------------------- for solvers of other packages


class ODE:
    """y' = f(t, y) of a system, as every reference solver of this package integrates it.

    Parameters
    ----------
    system : System
        With compliant stops: rigid ones have no force that depends on the state alone.

    Attributes
    ----------
    y0 : (n,) array
        The state at t = 0, in the order (q_1, q'_1, q_2, q'_2, ...): q is y[::2], q' is y[1::2].
    bandwidths : (int, int) or None
        Lower and upper bandwidth of ``jac``; None where a banded solver does not pay.
    events : tuple of functions of (t, y)
        One per side of every contact that has a stop there: > 0 while the stop presses. Each has the attributes
        ``contact`` and ``side``, 1 upper or -1 lower, and SciPy's ``direction`` and ``terminal``. Those of ``segment``
        end it: terminal, with direction 1 where the side is open and -1 where it is closed.
    breakpoints : tuple of float
        Times at which a load or an offset is not smooth: samples of records.

    Examples
    --------
    >>> import stiffbeam as sb
    >>> from scipy.integrate import solve_ivp
    >>> system = sb.problem("bilinear-oscillator").system
    >>> ode = system.ode()
    >>> solution = solve_ivp(ode.rhs, (0.0, 1.0), ode.y0, method="Radau", jac=ode.jac, rtol=1e-8, atol=1e-10)
    >>> run = sb.Trajectory.from_arrays(solution.t, ode.tip(solution.t, solution.y))
    """

    def __init__(self, system: System) -> None:
        for contact in system.contacts:
            contact.stops.require_compliant("a differential equation")
        self.system, self._rhs = system, RightHandSide(system)
        self._n, self.bandwidths = self._rhs.states, self._rhs.bandwidths
        self.y0 = self._rhs.z0[: self._n].copy()
        self.breakpoints = tuple(system.drive.edges.tolist())
        self.events = self._events()

    def rhs(self, t: float, y: ArrayLike) -> Array:
        """Return f(t, y), (n,)."""
        return self._rhs.value(float(t), self._padded(y))[: self._n]

    def jac(self, t: float, y: ArrayLike) -> Array:
        """Return df/dy, (n, n)."""
        return self._rhs.jacobian(float(t), self._padded(y))[: self._n, : self._n]

    def tip(self, t: ArrayLike, y: ArrayLike) -> Array:
        """Return the observed position, (k,), of k states at the times (k,): (k, n), or as SciPy has them (n, k)."""
        times, states, n = np.atleast_1d(np.asarray(t, float)), np.atleast_2d(np.asarray(y, float)), self._n
        if states.shape not in ((len(times), n), (n, len(times))) or len(times) == n:
            rule = f"be states (k, {n}) or ({n}, k) at another number k of times"
            raise InputError("y", states.shape, rule, "take one time more or less")
        states = states if states.shape[-1] == n else states.T
        return self.system.positions(times, states[:, ::2])[:, self.system.tip_channel]

    def segment(self, sides: ArrayLike) -> ODE:
        """Return the equation between two events, smooth on both sides of them.

        Parameters
        ----------
        sides : (contacts,) array of int
            1 where the upper stop of a contact presses, -1 the lower one, 0 where it is open.
        """
        ode, given = ODE(self.system), np.asarray(sides)
        regime = ode._rhs.regime
        if given.shape != regime.shape or not np.all(np.isin(given, (-1, 0, 1))):
            rule = f"hold -1, 0 or 1 for each of {len(regime)} contacts"
            raise InputError("sides", sides, rule, "0 leaves a contact open, 1 closes its upper stop")
        regime[:] = given
        ode.events = ode._events(terminal=True)
        return ode

    @cached_property
    def cfunc(self) -> tuple[int, int]:
        """Addresses (function, data) of the compiled right-hand side: ``void f(double t, const double *y, double *f,
        void *data)``. They hold as long as this object does.

        Raises InputError where a load or an offset is a Python function.
        """
        self.system.drive.require_closed_form("compiled code")
        address = ctypes.cast(library().state_rate, ctypes.c_void_p).value
        return address or 0, ctypes.addressof(self._rhs.c)

    @cached_property
    def jax(self) -> Callable[..., Any]:
        """f(t, y, args=None) in JAX; traceable and differentiable.

        Raises InputError where JAX works in single precision, and where a load or an offset is a Python function.
        """
        require_jax_float64()
        self.system.drive.require_closed_form("JAX")
        exponents, numbers = numbers_of(self._rhs)
        return lambda t, y, args=None: rate_with_integrals(exponents, t, y, numbers)

    def _events(self, terminal: bool = False) -> tuple[Any, ...]:
        """An event function for each side. A segment holds up to its next event, which is ``terminal``: both directions
        would also find the event at which it begins."""

        def pressed(number: int, t: float, y: ArrayLike) -> float:
            return float(self._rhs.event_functions(float(t), self._padded(y))[number])

        functions = list[Any]()
        for number, (contact, side) in enumerate(self._rhs.sides):
            direction = (-1.0 if self._rhs.regime[contact] == side else 1.0) if terminal else 0.0
            functions.append(function := partial(pressed, number))
            vars(function).update(contact=contact, side=side, direction=direction, terminal=terminal)
        return tuple(functions)

    def _padded(self, y: ArrayLike) -> Array:
        """Return the state with the integrals of the ledger, which act on nothing."""
        state = np.asarray(y, float)
        if state.shape != (self._n,):
            raise InputError("y", state.shape, f"be a state ({self._n},)", "evaluate states one by one")
        z = np.zeros(self._rhs.size)
        z[: self._n] = state
        return z
