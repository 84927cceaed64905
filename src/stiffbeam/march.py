"""integrate: a scheme on a system. Modal blocks where the modes decouple, else the direct march."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from . import kernel
from .contact import solve_several
from .equations import Equation, FirstOrder, Matrices
from .modal import Modes, modes
from .propagator import LANES, Propagator, aligned, build
from .recorder import SampledImpacts
from .schemes import Scheme
from .system import FirstOrderSystem, System, offset_rate, offset_values
from .trajectory import Diverged, Trajectory, Work
from .validation import InputError, positive

Array = NDArray[np.float64]
CONTACTS = ("implicit", "extrapolated")
NODES_PER_BLOCK = 48  # longer blocks pay more for the contact than they save
STEPS_PER_PIECE = 4096
OVERFLOW = 1e100


@dataclass(frozen=True, eq=False)
class Piece:
    """Consecutive steps first + 1 .. first + k of a run; valid until the next piece is made."""

    first: int
    positions: Array  # (k, channels) at the ends of the steps
    velocities: Callable[[NDArray[np.int64]], Array]  # 1..k -> (len, channels)
    states: Callable[[], tuple[Array, Array]]  # q, q' at the ends of the steps, each (k, n)
    seconds: float


def integrate(
    system: System | FirstOrderSystem,
    scheme: Scheme,
    dt: float,
    t_end: float,
    contact: str = "implicit",
    every: int = 1,
    progress: Callable[[int], None] | None = None,
) -> Trajectory:
    """March ``scheme`` over [0, t_end] with the fixed step ``dt``.

    contact "implicit": every stage solves v = r + s F(v), in closed form for one contact.
    "extrapolated": the force at a node is F(v*), v* predicted from known values, as in the paper;
    it can overflow. ``every`` thins the outputs only: impacts, peaks and the ledger see every step.
    ``progress`` is called with the number of steps done.

    A System whose damping decouples is marched in modal coordinates by the compiled block kernel; any
    other, and a FirstOrderSystem, step by step with factorised matrices (``provenance["march"]``).
    Raises InputError for bad arguments and Diverged where the run overflows.
    """
    steps = _steps(positive("dt", dt), positive("t_end", t_end))
    if isinstance(every, bool) or not isinstance(every, (int, np.integer)) or every < 1:
        raise InputError("every", every, "be an integer >= 1")
    if contact not in CONTACTS:
        raise InputError("contact", contact, f"be one of {CONTACTS}")
    if scheme.second_order_only and isinstance(system, FirstOrderSystem):
        raise InputError("system", "a FirstOrderSystem", f"be of second order for {scheme}", "pass the System itself")
    parent = system if isinstance(system, System) else system.system
    begun = time.perf_counter()
    basis = modes(system) if isinstance(system, System) else None
    omega_max = float(basis.omega[-1]) if basis else _omega_max(parent)
    scheme.check(omega_max, dt)

    def pieces() -> Iterator[Piece]:
        if isinstance(system, System) and basis is not None:
            return _modal_pieces(system, basis, scheme, dt, steps, contact)
        return _direct_pieces(system, scheme, dt, steps, contact)

    compile_seconds = _warm_up(len(parent.contacts))
    outputs = np.arange(0, steps + 1, every)
    positions = np.empty((len(outputs), len(parent.channels)))
    velocities = np.empty_like(positions)
    positions[0], velocities[0] = _initial_channels(parent)
    samplers = [SampledImpacts(c.stops, dt, float(positions[0, i])) for i, c in enumerate(parent.contacts)]
    march_seconds, last_velocity = 0.0, velocities[0]
    for piece in pieces():
        _check_overflow(piece, scheme, dt, contact, omega_max)
        march_seconds += piece.seconds
        here = outputs[(outputs > piece.first) & (outputs <= piece.first + len(piece.positions))]
        positions[here // every] = piece.positions[here - piece.first - 1]
        velocities[here // every] = piece.velocities(here - piece.first)
        for i, sampler in enumerate(samplers):

            def velocity(k: NDArray[np.int64], i: int = i, piece: Piece = piece, before: Array = last_velocity):
                known = piece.velocities(np.maximum(k, 1))[:, i]
                return np.where(k == 0, before[i], known)

            sampler.feed(piece.positions[:, i], velocity)
        last_velocity = piece.velocities(np.array([len(piece.positions)]))[0]
        if progress is not None:
            progress(piece.first + len(piece.positions))
    seconds = time.perf_counter() - begun - compile_seconds
    tip = parent.tip_channel
    return Trajectory(
        t=outputs * dt,
        tip=positions[:, tip],
        tip_velocity=velocities[:, tip],
        contacts=tuple(s.record(positions[:, i], velocities[:, i]) for i, s in enumerate(samplers)),
        work=Work(steps=steps, seconds=seconds, march_seconds=march_seconds),
        provenance={
            "method": str(scheme),
            "form": parent.form if isinstance(system, System) else f"{parent.form}, first order",
            "contact": contact,
            "dt": float(dt),
            "t_end": float(t_end),
            "every": int(every),
            "march": "modal blocks" if basis is not None else "direct",
            "stiffbeam": version("stiffbeam"),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        system=parent,
        pieces=lambda: _states(parent, pieces(), dt),
        fingerprint=parent.fingerprint,
    )


def _steps(dt: float, t_end: float) -> int:
    steps = round(t_end / dt)
    if steps < 1 or abs(steps * dt - t_end) > 1e-9 * t_end:
        nearest = t_end / max(1, steps)
        raise InputError("dt", dt, f"divide t_end = {t_end:g} to 1e-9", f"the nearest step that does is {nearest!r}")
    return steps


def _omega_max(system: System) -> float:
    import scipy.linalg

    squares = scipy.linalg.eigh(system.stiffness, system.mass, eigvals_only=True)
    return float(np.sqrt(max(0.0, squares[-1])))


def _initial_channels(system: System) -> tuple[Array, Array]:
    """Positions and velocities of the channels at t = 0."""
    positions = system.positions(0.0, system.q0)
    velocities = [system.v0 @ row + offset_rate(offset, 0.0) for row, offset in system.channels]
    return positions, np.array(velocities)


def _check_overflow(piece: Piece, scheme: Scheme, dt: float, contact: str, omega_max: float) -> None:
    bad = ~np.all(np.abs(piece.positions) < OVERFLOW, axis=1)
    if np.any(bad):
        t = (piece.first + 1 + int(np.argmax(bad))) * dt
        remedy = "use contact='implicit'" if contact == "extrapolated" else "the scheme is unstable on this system"
        raise Diverged(str(scheme), t, f"{remedy} or a smaller dt (omega_max dt is {omega_max * dt:.3g})")


def _states(system: System, pieces: Iterator[Piece], dt: float) -> Iterator[tuple[Array, Array, Array]]:
    """The run's states at every step, piece by piece with shared end points."""
    q_last, v_last = system.q0[None], system.v0[None]
    for piece in pieces:
        q, v = piece.states()
        q, v = np.concatenate([q_last, q]), np.concatenate([v_last, v])
        yield (piece.first + np.arange(len(q))) * dt, q, v
        q_last, v_last = q[-1:], v[-1:]


# ---------------------------------------------------------------- modal blocks


def block_length(scheme: Scheme, contacts: int) -> int:
    """The largest power of two of steps with at most NODES_PER_BLOCK force nodes."""
    nodes = len(scheme.nodes) * max(1, contacts)
    return 2 ** max(0, int(np.log2(NODES_PER_BLOCK / nodes)))


def _modal_pieces(system: System, basis: Modes, scheme: Scheme, dt: float, steps: int, contact: str) -> Iterator[Piece]:
    """The starter's steps one by one, then blocks."""
    y = np.stack([basis.to_modal(system.q0), basis.to_modal(system.v0)])
    history, first = [y], 0
    positions = system.positions(0.0, system.q0)
    force = basis.force(_total_force(system, 0.0, positions))
    starter = scheme.starter
    if starter is not None:
        one = build(starter, system, basis, dt, 1, contact)
        z = one.pack(starter.initial(basis.equation, history, force))
        for piece in _blocks(one, one, system, basis, z, 0, min(steps, scheme.history - 1)):
            yield piece
            history.insert(0, one.unpack(z)[:2].copy())
            first += 1
            force = basis.force(_total_force(system, first * dt, piece.positions[-1]))
    if first < steps:
        z0 = scheme.initial(basis.equation, history, force)
        block = build(scheme, system, basis, dt, block_length(scheme, len(system.contacts)), contact)
        one_step: list[Propagator] = []

        def one() -> Propagator:
            if not one_step:
                one_step.append(build(scheme, system, basis, dt, 1, contact))
            return one_step[0]

        yield from _blocks(block, one, system, basis, block.pack(z0), first, steps - first)


def _total_force(system: System, t: float, positions: Array) -> Array:
    """Load plus contact force at time t."""
    force = system.load(t)
    for c, contact in enumerate(system.contacts):
        force = force + contact.row * contact.stops.force(positions[c])
    return force


def _blocks(
    block: Propagator,
    one: Propagator | Callable[[], Propagator],
    system: System,
    basis: Modes,
    z: Array,
    first: int,
    steps: int,
) -> Iterator[Piece]:
    """``steps`` steps from the packed state z (advanced in place) at step ``first``."""
    K, dt = block.steps, block.dt
    per_piece = max(1, STEPS_PER_PIECE // K) if K > 1 else 1
    R, N, D = block.reading.shape[0], block.push.shape[0], z.size
    g1 = np.array([s.g1 for s in block.stops])
    g2 = np.array([s.g2 for s in block.stops])
    kappa = np.array([s.stiffness for s in block.stops])
    single = block.contacts <= 1
    march = kernel.march if single else kernel.march_several
    law = tuple(x[0] if len(x) else default for x, default in ((kappa, 0.0), (g1, -np.inf), (g2, np.inf)))
    law = law if single else (kappa, g1, g2)
    last = (first + steps) * dt
    most = min(per_piece, -(-steps // K))
    buffers = [aligned((most, width)) for width in (R, N, D)]
    done = 0
    while done < steps:
        begun = time.perf_counter()
        blocks = min(most, -(-(steps - done) // K))
        starts_at = (first + done + K * np.arange(blocks)) * dt
        entries, forces, starts = (buffer[:blocks] for buffer in buffers)
        inflow, inflow_state, values = block.inflow(starts_at, last)
        march(
            z, block.reading, block.transition, block.push, block.push_state, *law,
            block.drive.coefficients(starts_at), block.drive_state, inflow, inflow_state, entries, forces, starts,
        )  # fmt: skip
        valid = min(blocks * K, steps - done)
        positions = entries[:, block.end_entry].reshape(blocks * K, -1)[:valid]
        seconds = time.perf_counter() - begun

        def velocities(k, values=values, forces=forces, starts=starts):
            rows, inside = np.divmod(np.asarray(k) - 1, K)
            used, where = np.unique(rows, return_inverse=True)
            every = (
                np.tensordot(starts[used], block.velocity, (1, 2))
                + np.tensordot(forces[used], block.velocity_push, (1, 2))
                + np.tensordot(values[used], block.velocity_samples, (1, 2))
            )
            speeds = every[where, inside]
            for c, (unit, _) in enumerate(block.offset_samples):
                del c
                channel = int(np.argmax(unit))
                t = starts_at_of(rows, inside)
                speeds[:, channel] += offset_rate(system.channels[channel][1], t)
            return speeds

        def starts_at_of(rows, inside, starts_at=starts_at):
            return starts_at[rows] + (inside + 1) * dt

        def states(forces=forces, starts=starts, valid=valid, at=first + done):
            single_step = one() if callable(one) else one
            times = (at + np.arange(valid)) * dt
            _, inflow_one, _ = single_step.inflow(times, last)
            out = aligned((valid, D))
            by_step = np.ascontiguousarray(forces.reshape(-1, N // K)[:valid])
            kernel.fill(
                starts[0].copy(), single_step.transition, single_step.push_state, by_step,
                block.drive.coefficients(times), single_step.drive_state, inflow_one, out,
            )  # fmt: skip
            z_all = single_step.unpack(out)
            return basis.to_nodal(z_all[:, 0]), basis.to_nodal(z_all[:, 1])

        yield Piece(first + done, positions, velocities, states, seconds)
        done += valid


def _warm_up(contacts: int) -> float:
    """Compile or load the kernels on empty input; the seconds it took."""
    begun = time.perf_counter()
    empty, cube = np.zeros((0, LANES)), np.zeros((1, 1, LANES))
    state, law = np.zeros(LANES), np.ones(2)
    square = np.zeros((LANES, LANES))
    if contacts <= 1:
        kernel.march(state, square, cube, square, square, 1.0, 0.0, 0.0, *[empty] * 7)
    else:
        kernel.march_several(state, square, cube, square, square, law, law, law, *[empty] * 7)
    index = np.zeros(1, np.int64)
    kernel.scan(np.zeros(1), 0.0, 0.0, 1.0, 1.0, 0, index, index, np.zeros(1), np.zeros(1))
    kernel.first_crossing(1.0, -1.0, 0.0, -1.0)
    return time.perf_counter() - begun


# ---------------------------------------------------------------- direct march


def _direct_pieces(
    system: System | FirstOrderSystem, scheme: Scheme, dt: float, steps: int, contact: str
) -> Iterator[Piece]:
    """Step by step with the scheme's own ``step`` on matrices; contact by superposition.

    A step is linear in the contact forces, so the step is taken without them, the forces are found
    node by node from its positions and the probed compliances, and their responses are added.
    """
    view = _View.of(system)
    history, done = [view.y0], 0
    starter = scheme.starter
    if starter is not None:
        count = min(steps, scheme.history - 1)
        for piece, z in _direct_blocks(view, starter, dt, history, 0, count, contact, 1):
            history.insert(0, z[: view.equation.order])
            done += 1
            yield piece
    if done < steps:
        for piece, _ in _direct_blocks(view, scheme, dt, history, done, steps - done, contact, STEPS_PER_PIECE // 4):
            yield piece


@dataclass(frozen=True, eq=False)
class _View:
    """System and FirstOrderSystem as one: y of shape (order, n), forces and rows acting on positions."""

    equation: Equation
    system: System
    y0: Array
    loads: tuple
    rows: Array  # (channels, n), contacts first
    columns: Array  # (contacts, n): what a unit contact force adds to the right-hand side
    to_states: Callable[[Array], tuple[Array, Array]]  # z (k, order, n) -> q, q'

    @classmethod
    def of(cls, system: System | FirstOrderSystem) -> _View:
        if isinstance(system, System):
            return cls(
                equation=Matrices(system.mass, system.damping, system.stiffness),
                system=system,
                y0=np.stack([system.q0, system.v0]),
                loads=system.loads,
                rows=np.array([row for row, _ in system.channels]),
                columns=np.array([c.row for c in system.contacts]).reshape(-1, system.size),
                to_states=lambda y: (y[:, 0], y[:, 1]),
            )
        rows = [c.row for c in system.contacts] + ([] if system.observe is None else [system.observe])
        return cls(
            equation=FirstOrder(system.matrix),
            system=system.system,
            y0=system.y0[None],
            loads=system.loads,
            rows=np.array(rows),
            columns=np.array([c.column for c in system.contacts]).reshape(-1, len(system.y0)),
            to_states=lambda y: (y[:, 0] @ system.to_q.T, y[:, 0] @ system.to_v.T),
        )

    def load(self, t: Array) -> Array:
        """Load vectors, t.shape + (n,)."""
        from .time_functions import evaluate

        total = np.zeros((*t.shape, self.y0.shape[-1]))
        for vector, function in self.loads:
            total += evaluate(function, t)[..., None] * vector
        return total


def _direct_blocks(
    view: _View, scheme: Scheme, dt: float, history: list[Array], first: int, steps: int, contact: str, length: int
) -> Iterator[tuple[Piece, Array]]:
    equation, system, order = view.equation, view.system, view.equation.order
    nodes, stops = scheme.nodes, [c.stops for c in system.contacts]
    S, m = len(nodes), len(stops)
    offsets = [offset for _, offset in system.channels]
    t0 = np.asarray(first * dt)
    at_start = np.array([row @ history[0][0] + offset_values(o, t0) for row, o in zip(view.rows, offsets, strict=True)])
    force = view.load(t0) + sum(
        s.force(x) * column for s, x, column in zip(stops, at_start, view.columns, strict=False)
    )
    z = scheme.initial(equation, history, force)

    # Responses to a unit force of contact c at node s: state and contact positions at the nodes.
    zero = np.zeros_like(z)
    none = [np.zeros_like(history[0][0])] * S
    response_z = np.empty((S, m, *z.shape))
    response = np.zeros((S, m, S, m))  # [node, contact] of the force, [node, contact] of the position
    for s in range(S):
        for c in range(m):
            forces = list(none)
            forces[s] = view.columns[c]
            response_z[s, c], at_nodes = scheme.step(equation, dt, zero, forces)
            if contact == "implicit":
                response[s, c] = np.array(at_nodes) @ view.rows[:m].T

    for start in range(first, first + steps, length):
        begun = time.perf_counter()
        count = min(length, first + steps - start)
        times = (start + np.arange(count))[:, None] * dt + np.array(nodes) * dt
        loads = view.load(times)
        shifts = np.stack([offset_values(o, times) for o in offsets[:m]], axis=-1) if m else np.zeros((count, S, 0))
        path = np.empty((count, *z.shape))
        for k in range(count):
            predicted = scheme.predict(equation, dt, z) if contact == "extrapolated" else None
            z, at_nodes = scheme.step(equation, dt, z, list(loads[k]))
            if m:
                arguments = np.array(predicted or at_nodes) @ view.rows[:m].T + shifts[k]
                for s in range(S):
                    if m == 1:
                        f = stops[0].solve(arguments[s], response[s, 0, s, 0])
                    else:
                        f = solve_several(arguments[s], response[s, :, s].T, stops)
                    if np.any(f):
                        arguments = arguments + np.tensordot(f, response[s], 1)
                        z = z + np.tensordot(f, response_z[s], 1)
            path[k] = z
        seconds = time.perf_counter() - begun
        y = path[:, :order]
        ends = (start + 1 + np.arange(count)) * dt
        positions = np.stack(
            [y[:, 0] @ row + offset_values(o, ends) for row, o in zip(view.rows, offsets, strict=True)], axis=-1
        )

        def velocities(k, y=y, ends=ends):
            speed = equation.velocity(np.moveaxis(y[k - 1], 1, 0)) @ view.rows.T
            return speed + np.stack([offset_rate(o, ends[k - 1]) for o in offsets], axis=-1)

        yield Piece(start, positions, velocities, lambda y=y: view.to_states(y), seconds), z
