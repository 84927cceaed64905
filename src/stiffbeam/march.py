"""integrate: a scheme on a system. Modal blocks where the modes decouple, else the direct march."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from .arrays import Array
from .direct_march import direct_pieces
from .modal import modes
from .modal_march import modal_pieces, warm_up
from .pieces import Piece
from .recorder import SampledImpacts
from .schemes import Scheme
from .schemes.contract import check_contract
from .system import FirstOrderSystem, System, offset_rate
from .trajectory import Diverged, Trajectory, Work
from .validation import InputError, positive, step_count

CONTACTS = ("implicit", "extrapolated")
OVERFLOW = 1e100


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
    if not isinstance(system, (System, FirstOrderSystem)):
        raise InputError("system", type(system).__name__, "be a System", "make it with semidiscretise or from_matrices")
    if not isinstance(scheme, Scheme):
        raise InputError("scheme", scheme, "be a Scheme object", "for example stiffbeam.HHT(alpha=-0.1)")
    steps = step_count(positive("dt", dt), positive("t_end", t_end))
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
    check_contract(scheme)

    def pieces() -> Iterator[Piece]:
        if isinstance(system, System) and basis is not None:
            return modal_pieces(system, basis, scheme, dt, steps, contact)
        return direct_pieces(system, scheme, dt, steps, contact)

    compile_seconds = warm_up(len(parent.contacts))
    outputs = np.arange(0, steps + 1, every)
    positions = np.empty((len(outputs), len(parent.channels)))
    velocities = np.empty_like(positions)
    positions[0], velocities[0] = _initial_channels(parent)
    samplers = [SampledImpacts(c.stops, dt, float(positions[0, i])) for i, c in enumerate(parent.contacts)]
    march_seconds, last_velocity = 0.0, velocities[0]
    for piece in pieces():
        _check_overflow(piece, scheme, dt, contact, omega_max)
        march_seconds += piece.seconds
        here = outputs[piece.first // every + 1 : (piece.first + len(piece.positions)) // every + 1]
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
