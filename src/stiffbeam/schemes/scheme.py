"""What a scheme is: a linear step from (state, forces at the nodes) to (new state, positions there)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from ..arrays import Array
from ..validation import InputError


class Scheme(ABC):
    """A fixed-step scheme on M q'' + C q' + K q = f, or on y' = A y + f.

    ``nodes`` are the c_i in t_n + c_i dt at which the scheme asks for the force. ``step`` must be
    linear in (state, forces), and the position at node i must not depend on the force at a later
    node; ``integrate`` checks both. The state z has shape (components, ..., n) and starts with y (see
    equations). A subclass with ``nodes`` and ``step`` can be given to ``integrate`` as it is; its name
    is the class's in small letters unless it has one.
    """

    name: ClassVar[str] = ""
    paper: ClassVar[str] = ""  # the paper's equation numbers
    erratum: ClassVar[str] = ""  # the name of the misprint, for a printed form
    nodes: tuple[float, ...] = (1.0,)
    order: int = 2  # on smooth problems
    history: ClassVar[int] = 1  # number of past y that ``initial`` takes
    second_order_only: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.name = cls.name or cls.__name__.lower()

    @property
    def starter(self) -> Scheme | None:
        """The one-step scheme that makes the first ``history - 1`` steps."""
        return None

    def initial(self, equation: Any, history: list[Array], force: Array) -> Array:
        """The state at t_n from the past y, newest first, and the total force at t_n."""
        return history[0]

    @abstractmethod
    def step(self, equation: Any, dt: float, z: Array, forces: list[Array]) -> tuple[Array, list[Array]]:
        """(z at t_{n+1}, positions at the nodes) from z at t_n and the forces at the nodes."""

    def predict(self, equation: Any, dt: float, z: Array) -> list[Array]:
        """Positions at the nodes from known values, for the extrapolated contact: q + c_i dt q'.

        The paper names no formula but for BDF2; this one survives its Tables 10-13, v* = q does not.
        """
        y = z[: equation.order]
        velocity = equation.velocity(y)
        return [y[0] + c * dt * velocity for c in self.nodes]

    def characteristic(self, x: float, xi: float) -> Array | None:
        """Coefficients, highest first, of the polynomial whose roots amplify q'' + 2 xi w q' + w^2 q = 0, x = w dt.

        In closed form, for theory beside the step itself; None where a scheme states none. A scheme on
        y' = z y gives that of z = ``oscillator(x, xi)``; the conjugate roots belong to it.
        """
        return None

    def printed(self, *errata: str) -> Scheme:
        """The scheme as the paper prints it: the named errata, or all that run at any step."""
        from . import errata as printed_forms

        return printed_forms.printed(self, errata)

    def check(self, omega_max: float, dt: float) -> None:
        """Raise InputError where the scheme cannot be used with this step; omega_max is the top frequency."""
        return

    @property
    def parameters(self) -> dict[str, Any]:
        """The arguments that make this scheme again, for labels and provenance."""
        return {}

    def __str__(self) -> str:
        inside = ", ".join(f"{name}={str(value).lower()}" for name, value in self.parameters.items())
        label = f"{self.name}({inside})" if inside else self.name
        return f"{label}.printed({self.erratum})" if self.erratum else label

    __repr__ = __str__


def oscillator(x: float, xi: float) -> complex:
    """z = dt times the eigenvalue of q'' + 2 xi w q' + w^2 q = 0 in the upper half plane, x = w dt."""
    return x * complex(-xi, (1.0 - xi * xi) ** 0.5)


def in_interval(field: str, value: Any, low: float, high: float, remedy: str = "") -> float:
    """``value`` as a float in [low, high]."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)) or not low <= value <= high:
        raise InputError(field, value, f"lie in [{low:.6g}, {high:.6g}]", remedy)
    return float(value)
