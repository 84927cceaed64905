"""The right-hand side in JAX. It can be traced, and the system's numbers are an argument: one program for each
shape."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from ..basics.validation import InputError
from .contact_law import Law, pressure
from .right_hand_side_kernels import THROUGH

if TYPE_CHECKING:
    from .right_hand_side import RightHandSide


class Numbers(NamedTuple):
    """Arrays of ``right_hand_side_kernels.Equations`` for JAX, the matrices of y' and of the viscous power dense."""

    matrix: Any
    damping: Any
    frequencies: Any
    edges: Any
    records: Any  # (edges, R, P)
    loads: Any
    power: Any
    pushes: Any
    position_rows: Any
    velocity_rows: Any
    offsets: Any
    law: Any
    regime: Any
    window: Any


class Kind(NamedTuple):
    """Constants of a compiled program beside the shapes: the exponent of every contact, and whether stops damp."""

    exponents: tuple[float, ...]
    damped: bool


def numbers_of(rhs: RightHandSide) -> tuple[Kind, Numbers]:
    """Kind and numbers of a right-hand side, its regime and window those of now.

    Raises InputError for functions of time that JAX cannot trace, and for one with a mass.
    """
    import numpy as np

    if rhs.in_python:
        rule = "be made of Harmonic, Constant and Sampled for JAX"
        raise InputError("time function", "a callable", rule, "use the adaptive solver cvode")
    e, first_order = rhs.equations, rhs.first_order
    system = first_order.system
    n = rhs.states
    damping = first_order.to_v.T @ system.damping @ first_order.to_v if system.damped else np.zeros((0, n))
    records = e.loads.shape[0] - 1 - 2 * len(e.frequencies)
    table = e.records.reshape(len(e.edges), records, -1) if records else np.zeros((0, 0, 0))
    kind = Kind(tuple(float(p) for p in e.law[:, 3]), rhs.damped)
    return kind, Numbers(
        first_order.matrix, damping, e.frequencies, e.edges, table, e.loads, e.power, e.pushes, e.position_rows,
        e.velocity_rows, e.offsets, e.law, rhs.regime.copy(), np.array(rhs.window),
    )  # fmt: skip


def functions_of_time(t: Any, numbers: Numbers) -> tuple[Any, Any]:
    """1, sin w_1 t, cos w_1 t, ..., the records, (d + R,); and their rates."""
    import jax.numpy as jnp

    w = numbers.frequencies
    s, c = jnp.sin(w * t), jnp.cos(w * t)
    g, rate = jnp.stack([s, c], axis=1).ravel(), jnp.stack([w * c, -w * s], axis=1).ravel()
    values = rates = jnp.zeros(numbers.records.shape[1])
    if numbers.records.size:
        edges = numbers.edges
        inside = jnp.clip(t, numbers.window[0], numbers.window[1])
        # At the end of a window the polynomial before it holds.
        before = jnp.minimum(inside, jnp.nextafter(numbers.window[1], -jnp.inf))
        k = jnp.clip(jnp.searchsorted(edges, before, side="right") - 1, 0, len(edges) - 2)
        tau = inside - edges[k]
        for j in range(numbers.records.shape[2] - 1, -1, -1):  # Horner's scheme
            rates = rates * tau + values
            values = values * tau + numbers.records[k, :, j]
    return jnp.concatenate([jnp.ones(1), g, values]), jnp.concatenate([jnp.zeros(1), rate, rates])


def contact_forces(kind: Kind, t: Any, y: Any, numbers: Numbers) -> tuple[list[Any], list[Any], list[Any]]:
    """Forces of the contacts on y, their velocities, and the part of these that is their offsets'."""
    import jax.numpy as jnp

    g, g_rate = functions_of_time(t, numbers)
    positions = numbers.position_rows @ y + g @ numbers.offsets
    offset_rates = g_rate @ numbers.offsets
    velocities = numbers.velocity_rows @ y + offset_rates
    forces = []
    for c, p in enumerate(kind.exponents):
        kappa, g1, g2, _, damping, dissipation = numbers.law[c]
        stop = Law(kappa, g1, g2, p, damping, dissipation)  # type: ignore[arg-type]
        force: Any = 0.0
        for side in (1, -1):
            bound = g2 if side > 0 else g1
            there = jnp.isfinite(bound)
            depth = jnp.where(there, side * (positions[c] - jnp.where(there, bound, 0.0)), -1.0)
            rate = side * velocities[c]
            by_law = jnp.where(depth > 0.0, jnp.maximum(0.0, pressure(depth, rate, stop)), 0.0)
            closed = jnp.where(numbers.regime[c] == side, pressure(depth, rate, stop), 0.0)
            force = force - side * jnp.where(numbers.regime[c] == THROUGH, by_law, closed)
        forces.append(force)
    return forces, list(velocities), list(offset_rates)


def rate_of_state(kind: Kind, t: Any, y: Any, numbers: Numbers) -> Any:
    """y' (n,)."""
    g, _ = functions_of_time(t, numbers)
    rate = numbers.matrix @ y + g @ numbers.loads
    for c, force in enumerate(contact_forces(kind, t, y, numbers)[0]):
        rate = rate + numbers.pushes[c] * force
    return rate


def rate_with_integrals(kind: Kind, t: Any, z: Any, numbers: Numbers) -> Any:
    """z' of ``RightHandSide``: y' with the rates of the ledger's integrals."""
    import jax.numpy as jnp

    y = z[: numbers.matrix.shape[0]]
    g, _ = functions_of_time(t, numbers)
    forces, velocities, offset_rates = contact_forces(kind, t, y, numbers)
    rate, given, absorbed = numbers.matrix @ y + g @ numbers.loads, g @ numbers.power @ y, 0.0
    for c, force in enumerate(forces):
        rate = rate + numbers.pushes[c] * force
        given = given - force * offset_rates[c]
        dissipative = (numbers.law[c, 4] > 0.0) | (numbers.law[c, 5] > 0.0)
        absorbed = absorbed - jnp.where(dissipative, force * velocities[c], 0.0)
    viscous = y @ numbers.damping @ y if numbers.damping.shape[0] else 0.0 * given
    integrals = [given, viscous, *(-force for force in forces), *([absorbed] if kind.damped else [])]
    return jnp.concatenate([rate, jnp.stack(integrals)])
